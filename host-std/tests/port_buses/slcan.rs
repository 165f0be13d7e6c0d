//! A master on an SLCAN adapter that is played at the other end of the serial port.

use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Instant;

use embedded_can::nb::Can as _;
use embedded_can::{Frame as _, StandardId};
use myactuator_host_std::open::{AnyMaster, BusError};
use myactuator_host_std::port::{HostClock, PortError, Slcan};
use myactuator_host_std::text::slcan::{AdapterCodec, AdapterCommand, Answer, Rate};
use myactuator_protocol_core::command::{ReadMultiTurnAngle, Torque};
use myactuator_protocol_core::io::{Clock as _, Runner as _};
use myactuator_protocol_core::master::{MotorSet, StopKind};
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::Current;
use myactuator_protocol_core::wire::can::{self, Received, SimpleFrame};
use rustix::event::{PollFd, PollFlags, poll};

use crate::drive::{self, answer, ask_and_stop, motor};
use crate::pty;

/// What kind of adapter is played.
#[derive(Clone, Copy, Default)]
struct Adapter {
    /// It answers nothing to commands.
    is_silent: bool,
    /// It refuses to be opened.
    refuses_to_open: bool,
    /// It cannot send torque commands.
    refuses_torque: bool,
    /// It restarts when it is sent a torque command.
    restarts_at_torque: bool,
    /// What it says before every frame that it received.
    noise: &'static [u8],
    /// What it says before it answers, for another program had sent it something.
    to_another: &'static [u8],
}

/// How long an adapter may take to answer.
const ANSWER_TIME: std::time::Duration = std::time::Duration::from_millis(100);

const TORQUE: u8 = 0xA1;
const READ_ANGLE: u8 = 0x92;

fn frame(first: u8) -> SimpleFrame {
    SimpleFrame::new(StandardId::new(0x141).unwrap(), &[first, 0, 0, 0, 0, 0, 0, 0]).unwrap()
}

/// Plays adapter and drives until the port is closed; gives the commands heard.
fn play(mut line: File, adapter: Adapter) -> JoinHandle<Vec<AdapterCommand>> {
    std::thread::spawn(move || {
        let mut codec = AdapterCodec::default();
        let (mut chunk, mut heard, mut is_open) = ([0; 64], Vec::new(), false);
        while let Ok(length @ 1..) = line.read(&mut chunk) {
            for command in chunk[..length].iter().filter_map(|&byte| codec.feed(byte)) {
                let mut told = adapter.to_another.to_vec();
                let mut tell = |answer: Answer| {
                    if !adapter.is_silent {
                        answer.encode(&mut told);
                    }
                };
                match command {
                    AdapterCommand::Open if adapter.refuses_to_open => tell(Answer::Refused),
                    AdapterCommand::Close if !is_open => tell(Answer::Refused),
                    AdapterCommand::Open | AdapterCommand::Close => {
                        is_open = command == AdapterCommand::Open;
                        tell(Answer::Done);
                    }
                    AdapterCommand::Transmit(frame)
                        if adapter.refuses_torque && frame.data()[0] == TORQUE =>
                    {
                        tell(Answer::Refused);
                    }
                    AdapterCommand::Transmit(frame)
                        if adapter.restarts_at_torque && frame.data()[0] == TORQUE =>
                    {
                        is_open = false;
                        tell(Answer::Refused);
                    }
                    AdapterCommand::Transmit(frame) if is_open => {
                        tell(Answer::Accepted { is_extended: false });
                        if let Received::Packet(packet) = can::decode(&frame)
                            && let Some(reply) = answer(&packet)
                        {
                            told.extend_from_slice(adapter.noise);
                            Answer::Frame(can::encode(&reply).unwrap()).encode(&mut told);
                        }
                    }
                    AdapterCommand::Transmit(_) | AdapterCommand::Unknown => tell(Answer::Refused),
                    _ => tell(Answer::Done),
                }
                heard.push(command);
                // The port may be closed already.
                let _ = line.write_all(&told);
            }
        }
        heard
    })
}

fn open(path: &Path) -> Result<AnyMaster<2>, BusError> {
    drive::open(&format!("slcan:{}@1000000", path.display()))
}

/// The adapter may also answer nothing, or lines that mean nothing.
#[test]
fn a_master_asks_through_an_adapter() {
    let noise = b"t24189C00\r\rV1013\rT1234567F\rhello\r\xFF\r\n";
    for adapter in [
        Adapter::default(),
        Adapter { is_silent: true, ..Adapter::default() },
        Adapter { noise, ..Adapter::default() },
    ] {
        let (line, path) = pty::open();
        let device = play(line, adapter);
        let mut master = open(&path).unwrap();
        ask_and_stop(&mut master, 20);
        drop(master);
        let heard = device.join().unwrap();
        use AdapterCommand as C;
        let (start, frames) = heard.split_at(4);
        // Who does not say that it has closed may have heard of that what is no command, and is told once more.
        let told_to_close = if adapter.is_silent { 4 } else { 2 };
        let (frames, end) = frames.split_at(frames.len() - told_to_close);
        assert_eq!(start, [C::Unknown, C::Close, C::SetRate(Rate::Mbit1), C::Open]);
        assert!(frames.iter().all(|command| matches!(command, C::Transmit(_))), "{frames:?}");
        assert!(frames.len() >= 42);
        assert_eq!(end, &[C::Nothing, C::Close, C::Unknown, C::Close][..told_to_close]);
    }
}

/// What comes of this where no answer of the adapter can have been late: one that is played on a busy machine may be,
/// and counts as one that answers nothing then.
fn in_time<T>(attempt: impl Fn() -> T) -> T {
    let outcome = (0..500).find_map(|_| {
        let begun = Instant::now();
        let outcome = attempt();
        (begun.elapsed() < ANSWER_TIME).then_some(outcome)
    });
    outcome.expect("one in time")
}

#[test]
fn last_frame_is_not_lost_when_the_port_is_closed() {
    for _ in 0..20 {
        let heard = in_time(|| {
            let (line, path) = pty::open();
            let device = play(line, Adapter::default());
            let mut can = Slcan::open(&path, Rate::Mbit1).unwrap();
            can.transmit(&frame(TORQUE)).unwrap();
            drop(can);
            device.join().unwrap()
        });
        use AdapterCommand as C;
        let end = [C::Transmit(frame(TORQUE)), C::Nothing, C::Close];
        assert!(heard.ends_with(&end), "{heard:?}");
    }
}

#[test]
fn adapter_that_refuses_to_open_is_reported() {
    let open_one = || {
        let (line, path) = pty::open();
        let device = play(line, Adapter { refuses_to_open: true, ..Adapter::default() });
        let opened = open(&path).map(drop);
        device.join().unwrap();
        opened.err()
    };
    // One that is late is opened as one that answers nothing.
    let error = (0..5).find_map(|_| open_one()).expect("one in time");
    assert!(matches!(error, BusError::Port(PortError::Refused(_))), "{error}");
}

/// The closed adapter refuses (BEL) what another program sends, before it hears the commands of this one.
#[test]
fn refusals_meant_for_another_program_do_not_keep_a_port_from_opening() {
    let heard = in_time(|| {
        let (line, path) = pty::open();
        let device = play(line, Adapter { to_another: b"\x07\x07", ..Adapter::default() });
        let can = Slcan::open(&path, Rate::Mbit1);
        drop(can.unwrap());
        device.join().unwrap()
    });
    use AdapterCommand as C;
    assert_eq!(heard[..4], [C::Unknown, C::Close, C::SetRate(Rate::Mbit1), C::Open]);
}

/// The other program also takes the answers to this one's commands, and leaves it refusals.
#[test]
fn stop_is_sent_through_an_adapter_that_another_program_keeps_busy() {
    let is_stopped = || {
        let (mut line, path) = pty::open();
        let mut refusals = line.try_clone().unwrap();
        let is_over = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&is_over);
        let another = std::thread::spawn(move || {
            let mut longest_pause = std::time::Duration::ZERO;
            while !ends.load(Ordering::Relaxed) {
                let begun = Instant::now();
                // Before the port is open and after that nobody hears it.
                let _ = refusals.write_all(b"\x07");
                std::thread::sleep(std::time::Duration::from_millis(2));
                longest_pause = longest_pause.max(begun.elapsed());
            }
            longest_pause
        });
        let stop = frame(0x81);
        let device = std::thread::spawn(move || {
            let (mut codec, mut chunk) = (AdapterCodec::default(), [0; 64]);
            while let Ok(length @ 1..) = line.read(&mut chunk) {
                let mut commands = chunk[..length].iter().filter_map(|&byte| codec.feed(byte));
                if commands.any(|command| command == AdapterCommand::Transmit(stop)) {
                    return true;
                }
            }
            false
        });
        let opened = Slcan::open(&path, Rate::Mbit1);
        let sent = opened.map(|mut can| can.transmit(&stop).map(|_| can));
        // The port stays open until it is heard.
        let is_heard = device.join().unwrap();
        is_over.store(true, Ordering::Relaxed);
        // On a busy machine the other program pauses, too, and what it had refused counts.
        if another.join().unwrap() > std::time::Duration::from_millis(20) {
            return None;
        }
        sent.unwrap().unwrap();
        Some(is_heard)
    };
    assert_eq!((0..100).find_map(|_| is_stopped()), Some(true));
}

/// Receives until this gives something; gives up after four seconds.
fn until<T>(
    can: &mut Slcan,
    clock: &HostClock,
    mut look: impl FnMut(&mut Slcan) -> Option<T>,
) -> T {
    let end = clock.now() + Duration::from_secs(4);
    loop {
        if let Some(found) = look(can) {
            return found;
        }
        assert!(clock.now() < end, "nothing came");
        clock.idle((clock.now() + Duration::from_millis(1)).min(end));
    }
}

#[test]
fn moves_are_refused_after_a_refusal_until_a_reply_arrives() {
    let (mut can, device) = in_time(|| {
        let (line, path) = pty::open();
        let device = play(line, Adapter { refuses_torque: true, ..Adapter::default() });
        (Slcan::open(&path, Rate::Mbit1).unwrap(), device)
    });
    let clock = can.clock().unwrap();

    can.transmit(&frame(TORQUE)).unwrap();
    let error = until(&mut can, &clock, |can| {
        assert!(matches!(can.receive(), Err(nb::Error::WouldBlock)));
        match can.transmit(&frame(TORQUE)) {
            Err(nb::Error::Other(error)) => Some(error),
            _ => None,
        }
    });
    assert!(matches!(error, PortError::Refused(_)), "{error}");
    assert!(error.is_outage());

    can.transmit(&frame(READ_ANGLE)).unwrap();
    let reply = until(&mut can, &clock, |can| can.receive().ok());
    assert_eq!(reply.id(), StandardId::new(0x241).unwrap().into());
    can.transmit(&frame(TORQUE)).unwrap();
    drop((can, clock));
    device.join().unwrap();
}

/// Some adapters say that they have accepted a read, although the bus carries nothing.
#[test]
fn only_a_frame_ends_what_a_refusal_has_begun() {
    let (mut line, path) = pty::open();
    let mut can = Slcan::open(&path, Rate::Mbit1).unwrap();
    let mut says = |can: &mut Slcan, text: &[u8]| {
        line.write_all(text).unwrap();
        let has_come = || rustix::io::ioctl_fionread(&*can).unwrap() as usize == text.len();
        while !has_come() {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        can.receive()
    };
    assert!(says(&mut can, b"\x07").is_err());
    for text in [&b"\r"[..], b"z\r", b"Z\r", b"t24192\r", b"V1013\r", b"F00\r", b"?\r"] {
        assert!(says(&mut can, text).is_err());
        let refused = can.transmit(&frame(TORQUE));
        let why = String::from_utf8_lossy(text);
        assert!(matches!(refused, Err(nb::Error::Other(PortError::Refused(_)))), "{why:?}");
    }
    assert!(says(&mut can, b"t24189200000000000000\r").is_ok());
    assert!(can.transmit(&frame(TORQUE)).is_ok());
}

/// The program does not read the answers, so the adapter may have restarted all the while.
#[test]
fn refusing_adapter_is_reopened_at_most_ten_times_a_second() {
    let (line, path) = pty::open();
    let device = play(line, Adapter { refuses_torque: true, ..Adapter::default() });
    let begun = Instant::now();
    let mut can = Slcan::open(&path, Rate::Mbit1).unwrap();
    let clock = can.clock().unwrap();
    can.transmit(&frame(TORQUE)).unwrap();
    until(&mut can, &clock, |can| {
        let _ = can.receive();
        can.transmit(&frame(TORQUE)).is_err().then_some(())
    });
    for _ in 0..50 {
        can.transmit(&frame(READ_ANGLE)).unwrap();
    }
    let tenths = begun.elapsed().as_millis() / 100;
    drop((can, clock));
    let heard = device.join().unwrap();
    let opened = heard.iter().filter(|command| **command == AdapterCommand::Open).count();
    assert!(opened as u128 <= 1 + tenths, "{opened} in {tenths}");
}

#[test]
fn frames_that_a_stalled_adapter_does_not_take_are_discarded() {
    let (_line, path) = pty::open();
    let mut can = Slcan::open(&path, Rate::Mbit1).unwrap();
    let clock = can.clock().unwrap();
    let error = until(&mut can, &clock, |can| {
        for _ in 0..1_000 {
            match can.transmit(&frame(READ_ANGLE)) {
                Ok(_) => {}
                Err(nb::Error::WouldBlock) => return None,
                Err(nb::Error::Other(error)) => return Some(error),
            }
        }
        None
    });
    assert!(matches!(error, PortError::Stalled(_)), "{error}");
    match can.transmit(&frame(TORQUE)) {
        Err(nb::Error::WouldBlock | nb::Error::Other(PortError::Stalled(_))) => {}
        other => panic!("{other:?}"),
    }
}

/// It has sent more than one call reads.
#[test]
fn receive_returns_while_an_adapter_babbles() {
    let (mut line, path) = pty::open();
    let mut can = Slcan::open(&path, Rate::Mbit1).unwrap();
    let clock = can.clock().unwrap();
    line.write_all(&[b'?'; 8_000]).unwrap();
    line.write_all(b"\rt24189200000000000000\r").unwrap();
    assert!(matches!(can.receive(), Err(nb::Error::WouldBlock)));
    let reply = until(&mut can, &clock, |can| can.receive().ok());
    assert_eq!(reply.id(), StandardId::new(0x241).unwrap().into());
}

/// All of a move but its line end lies in the adapter, from a program that was killed.
#[test]
fn line_begun_by_a_killed_program_is_not_completed() {
    let (line, path) = pty::open();
    let mut killed = File::options().write(true).open(&path).unwrap();
    killed.write_all(b"t1418A100000032000000").unwrap();
    // By then nobody can throw it away any more.
    let mut has_come = [PollFd::new(&line, PollFlags::IN)];
    assert_eq!(poll(&mut has_come, None), Ok(1));
    let device = play(line, Adapter::default());
    let can = Slcan::open(&path, Rate::Mbit1).unwrap();
    drop((can, killed));
    let heard = device.join().unwrap();
    let is_frame = |command: &AdapterCommand| matches!(command, AdapterCommand::Transmit(_));
    assert!(!heard.iter().any(is_frame), "{heard:?}");
}

/// An adapter to which a line was begun, and that takes nothing more. Also how many frames the port has taken.
fn stuck(frame: &SimpleFrame) -> (File, Slcan, usize) {
    let (line, path) = pty::open();
    let mut can = Slcan::open(&path, Rate::Mbit1).unwrap();
    let taken = (0..10_000).take_while(|_| can.transmit(frame).is_ok()).count();
    wait_until_full(&line);
    (line, can, taken)
}

/// The terminal keeps some four thousand bytes that nobody can throw away any more.
fn wait_until_full(line: &File) {
    let is_full = (0..5_000).any(|_| {
        std::thread::sleep(std::time::Duration::from_millis(1));
        rustix::io::ioctl_fionread(line).unwrap() >= 4_000
    });
    assert!(is_full);
}

/// The lines that are heard up to this one, or until the port is closed for good.
fn heard_up_to(mut line: File, last: &str) -> Vec<String> {
    let (mut heard, mut chunk) = (Vec::new(), [0; 256]);
    let last = format!("\r{last}\r");
    while !heard.ends_with(last.as_bytes())
        && let Ok(length @ 1..) = line.read(&mut chunk)
    {
        heard.extend_from_slice(&chunk[..length]);
    }
    String::from_utf8(heard).unwrap().split('\r').map(str::to_owned).collect()
}

/// Those that are heard until the port is closed for good.
fn heard_on(line: File) -> Vec<String> {
    heard_up_to(line, "no line")
}

const TORQUE_LINE: &str = "t1418A100000000000000";
const STOP_LINE: &str = "t14188100000000000000";
const LONGEST_KEPT: usize = 165;

/// How many torque commands these are. Each line is whole, or so long that an adapter has no place for how it began: some
/// firmware makes a frame of whatever begins as one, and has place for the 165 characters of a CAN FD frame.
fn torques_among(lines: &[String]) -> usize {
    let known = ["", "C", "S8", "O", TORQUE_LINE, STOP_LINE];
    let is_sound = |line: &&String| known.contains(&line.as_str()) || line.len() > LONGEST_KEPT;
    let odd: Vec<_> = lines.iter().filter(|line| !is_sound(line)).collect();
    assert!(odd.is_empty(), "{odd:?}");
    lines.iter().filter(|line| *line == TORQUE_LINE).count()
}

#[test]
fn stalled_port_discards_its_bytes_and_joins_no_line_from_the_rest() {
    let (line, mut can, taken) = stuck(&frame(TORQUE));
    let clock = can.clock().unwrap();
    let error = until(&mut can, &clock, |can| match can.transmit(&frame(TORQUE)) {
        Err(nb::Error::Other(error)) => Some(error),
        _ => None,
    });
    assert!(matches!(error, PortError::Stalled(_)), "{error}");
    // When the port is closed more is thrown away.
    let device = std::thread::spawn(move || heard_up_to(line, STOP_LINE));
    until(&mut can, &clock, |can| can.transmit(&frame(0x81)).ok());
    until(&mut can, &clock, |can| {
        let _ = can.receive();
        device.is_finished().then_some(())
    });
    // The last one is lost in any case.
    assert!(2 * torques_among(&device.join().unwrap()) < taken);
}

/// A sender that has to wait keeps it, and sends a newer one or a stop in its place.
#[test]
fn frame_is_not_taken_before_the_port_has_taken_the_one_before() {
    let refusal = || {
        let (_line, path) = pty::open();
        let mut can = Slcan::open(&path, Rate::Mbit1).unwrap();
        (0..10_000).find_map(|_| can.transmit(&frame(TORQUE)).err()).expect("the port has an end")
    };
    let is_told_to_wait = |_| matches!(refusal(), nb::Error::WouldBlock);
    // On a busy machine it may take long enough to be a stall.
    assert!((0..5).any(is_told_to_wait));
}

#[test]
fn closing_a_stalled_port_does_not_complete_a_begun_line() {
    let (line, can, taken) = stuck(&frame(TORQUE));
    drop(can);
    let heard = heard_on(line);
    assert!(2 * torques_among(&heard) < taken);
    assert!(heard.ends_with(&["C", ""].map(str::to_owned)), "{:?}", heard.last_chunk::<3>());
}

#[test]
fn frames_that_a_silent_adapter_did_not_take_are_lost_with_the_port() {
    let (line, path) = pty::open();
    let mut can = Slcan::open(&path, Rate::Mbit1).unwrap();
    // More than the terminal keeps for good, and less than it takes.
    const TAKEN: usize = 500;
    (0..TAKEN).for_each(|_| assert!(can.transmit(&frame(TORQUE)).is_ok()));
    wait_until_full(&line);
    drop(can);
    assert!(torques_among(&heard_on(line)) < TAKEN);
}

#[test]
fn frame_is_sent_no_more_than_once_however_the_port_takes_it() {
    let (line, mut can, taken) = stuck(&frame(TORQUE));
    let device = std::thread::spawn(move || heard_on(line));
    // What is left of the last one goes on, unless the machine is busy for so long that it is stale.
    for _ in 0..20 {
        let _ = can.receive();
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    drop(can);
    let sent = torques_among(&device.join().unwrap());
    assert!((1..=taken).contains(&sent), "{sent} of {taken}");
}

/// The adapter's supply fails for a moment, and its serial port does not: it is off the bus.
#[test]
fn stop_is_sent_through_an_adapter_that_has_restarted() {
    let (line, path) = pty::open();
    let device = play(line, Adapter { restarts_at_torque: true, ..Adapter::default() });
    let mut master = open(&path).unwrap();
    master.ask(motor(1), ReadMultiTurnAngle).unwrap();
    let torque = Torque { current: Current::from_raw(100) };
    assert!(master.set_point_and_wait(motor(1), torque).is_err());
    assert_eq!(master.stop_all(StopKind::Hold, MotorSet::EMPTY), MotorSet::EMPTY);
    // It stays open: nobody tells it so again and again.
    master.ask(motor(1), ReadMultiTurnAngle).unwrap();
    drop(master);
    let heard = device.join().unwrap();
    let opened = heard.iter().filter(|command| **command == AdapterCommand::Open).count();
    let rates = heard.iter().filter(|it| **it == AdapterCommand::SetRate(Rate::Mbit1)).count();
    assert_eq!((opened, rates), (2, 2), "{heard:?}");
}
