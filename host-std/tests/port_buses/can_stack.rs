//! Tries CAN interfaces of Linux: `vcan0`, and `can0` and `can1` on one bus. It sets them up itself,
//! with `ip` and `tc`, so it has to run as root where they are nobody's: `.ci/can-stack` runs it in an
//! emulated computer. It ends with an error if anything is not as it should be.

mod drive;

use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::JoinHandle;

use drive::{answer, ask_and_stop, motor, open};
use embedded_can::nb::Can as _;
use embedded_can::{Frame as _, StandardId};
use myactuator_host_std::open::BusError;
use myactuator_host_std::port::{HostClock, PortError, SocketCan};
use myactuator_protocol_core::command::{self, ReadMultiTurnAngle};
use myactuator_protocol_core::io::{Clock as _, Runner};
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::Current;
use myactuator_protocol_core::wire::can::{self, Received};
use socketcan::{CanErrorFrame, CanFrame, CanSocket, Socket as _, SocketOptions as _};

const TORQUE: u8 = 0xA1;
const READ_ANGLE: u8 = 0x92;

fn main() {
    check("what cannot be opened is told", interfaces_that_cannot_be_opened_are_reported);
    check("a master asks over vcan0", || a_master_asks("vcan0", "vcan0"));
    check("a master asks on can0, drives are on can1", || a_master_asks("can0", "can1"));
    check("own frames are not received", own_frames_are_not_received);
    check("a dead bus gets nothing that moves", dead_bus_gets_no_moves);
    check("a master drops motion on a dead bus", a_master_drops_motion_on_a_dead_bus);
    check("an interface goes down and up", an_interface_goes_down_and_up);
    check("the kernel holds few frames", the_kernel_holds_few_frames);
    check("an interface that is taken away is told", deleted_interface_is_reported_as_gone);
}

fn check(what: &str, run: impl FnOnce()) {
    run();
    println!("ok: {what}");
}

/// Runs a program; its words are divided by spaces.
fn run(command: &str) {
    let mut words = command.split(' ');
    let status = Command::new(words.next().unwrap()).args(words).status();
    assert!(status.is_ok_and(|status| status.success()), "failed: {command}");
}

fn frame(first: u8) -> CanFrame {
    CanFrame::new(StandardId::new(0x141).unwrap(), &[first, 0, 0, 0, 0, 0, 0, 0]).unwrap()
}

/// The first byte of the next frame; gives up after four seconds.
fn hear(can: &mut SocketCan, clock: &HostClock) -> u8 {
    let end = clock.now() + Duration::from_secs(4);
    loop {
        match can.receive() {
            Ok(frame) => return frame.data()[0],
            Err(nb::Error::Other(error)) => panic!("{error}"),
            Err(nb::Error::WouldBlock) => assert!(clock.now() < end, "nothing came"),
        }
        clock.idle(end);
    }
}

fn opened(interface: &str) -> (SocketCan, HostClock) {
    let can = SocketCan::open(interface).unwrap();
    let clock = can.clock().unwrap();
    (can, clock)
}

/// Whether a frame that moves is refused, and why.
fn refusal(can: &mut SocketCan) -> Option<PortError> {
    assert!(matches!(can.receive(), Err(nb::Error::WouldBlock)));
    match can.transmit(&frame(TORQUE)) {
        Ok(_) => None,
        Err(nb::Error::Other(error)) => Some(error),
        Err(nb::Error::WouldBlock) => panic!("the interface takes nothing"),
    }
}

/// Motors 1 and 2, until told to end. Counts the torque commands that they hear.
struct Drives {
    end: Arc<AtomicBool>,
    torques: Arc<AtomicUsize>,
    thread: JoinHandle<()>,
}

impl Drives {
    fn on(interface: &str) -> Self {
        let (mut can, clock) = opened(interface);
        let (end, torques) = (Arc::<AtomicBool>::default(), Arc::<AtomicUsize>::default());
        let (ends, count) = (end.clone(), torques.clone());
        let thread = std::thread::spawn(move || {
            while !ends.load(Ordering::Relaxed) {
                match can.receive() {
                    Ok(frame) => {
                        let Received::Packet(command) = can::decode(&frame) else { continue };
                        if command.data[0] == TORQUE {
                            count.fetch_add(1, Ordering::Relaxed);
                        }
                        if let Some(reply) = answer(&command) {
                            can.transmit(&can::encode(&reply).unwrap()).unwrap();
                        }
                    }
                    Err(_) => clock.idle(clock.now() + Duration::from_millis(5)),
                }
            }
        });
        Self { end, torques, thread }
    }

    /// Ends them, and gives the torque commands heard.
    fn end(self) -> usize {
        self.end.store(true, Ordering::Relaxed);
        self.thread.join().unwrap();
        self.torques.load(Ordering::Relaxed)
    }
}

fn interfaces_that_cannot_be_opened_are_reported() {
    let error = |interface| SocketCan::open(interface).unwrap_err();
    let PortError::NoSuchInterface { there, .. } = error("can9") else {
        panic!("{}", error("can9"))
    };
    assert!(
        ["vcan0", "can0", "can1"].iter().all(|name| there.iter().any(|one| one == name)),
        "{there:?}"
    );
    assert!(matches!(error("lo"), PortError::NotCan(_)), "{}", error("lo"));
    for interface in ["vcan0", "can0"] {
        let error = error(interface);
        assert!(matches!(error, PortError::InterfaceDown(_)), "{error}");
        println!("    {error}");
    }
    run("ip link set vcan0 up");
    run("ip link set can0 up type can bitrate 1000000");
    run("ip link set can1 up type can bitrate 1000000");
}

fn a_master_asks(here: &str, there: &str) {
    let drives = Drives::on(there);
    let mut master = open(here).unwrap();
    ask_and_stop(&mut master, 100);
    drives.end();
}

fn own_frames_are_not_received() {
    for (here, there) in [("vcan0", "vcan0"), ("can0", "can1")] {
        let ((mut can, _), (mut other, clock)) = (opened(here), opened(there));
        can.transmit(&frame(READ_ANGLE)).unwrap();
        assert_eq!(hear(&mut other, &clock), READ_ANGLE);
        assert!(matches!(can.receive(), Err(nb::Error::WouldBlock)));
    }
}

/// Reports as controllers make them, `linux/can/error.h`: class, and the data with the state of the
/// controller in byte 1. Each is delivered when this returns, to all sockets in one go.
fn reporter() -> impl Fn(u32, u8) {
    let socket = CanSocket::open("vcan0").unwrap();
    socket.set_recv_own_msgs(true).unwrap();
    socket.set_error_filter_accept_all().unwrap();
    move |class, state| {
        let report = CanErrorFrame::new_error(class, &[0, state, 0, 0, 0, 0, 0, 0]).unwrap();
        socket.write_frame(&CanFrame::from(report)).unwrap();
        while !matches!(socket.read_frame().unwrap(), CanFrame::Error(_)) {}
    }
}

const CONTROLLER: u32 = 0x004;
const NOT_ACKNOWLEDGED: u32 = 0x020;
const BUS_OFF: u32 = 0x040;
const RESTARTED: u32 = 0x100;
const SENDING_PASSIVE: u8 = 0x20;
const ACTIVE: u8 = 0x40;

fn dead_bus_gets_no_moves() {
    let ((mut can, clock), (mut other, other_clock)) = (opened("vcan0"), opened("vcan0"));
    let report = reporter();
    assert!(refusal(&mut can).is_none());
    assert_eq!(hear(&mut other, &other_clock), TORQUE);

    report(BUS_OFF, 0);
    assert!(matches!(refusal(&mut can), Some(PortError::BusOff(_))));
    report(RESTARTED, 0);
    assert!(refusal(&mut can).is_none());

    report(CONTROLLER, SENDING_PASSIVE);
    assert!(matches!(refusal(&mut can), Some(PortError::NotAcknowledged(_))));
    report(CONTROLLER, ACTIVE);
    assert!(refusal(&mut can).is_none());

    report(NOT_ACKNOWLEDGED, 0);
    assert!(matches!(refusal(&mut can), Some(PortError::NotAcknowledged(_))));
    can.transmit(&frame(READ_ANGLE)).unwrap();
    for expected in [TORQUE, TORQUE, READ_ANGLE] {
        assert_eq!(hear(&mut other, &other_clock), expected);
    }
    // Any frame shows that the bus is alive.
    other.transmit(&frame(READ_ANGLE)).unwrap();
    assert_eq!(hear(&mut can, &clock), READ_ANGLE);
    assert!(refusal(&mut can).is_none());
}

fn a_master_drops_motion_on_a_dead_bus() {
    let drives = Drives::on("vcan0");
    let mut master = open("vcan0").unwrap();
    let torque = command::Torque { current: Current::from_raw(100) };
    master.ask(motor(1), ReadMultiTurnAngle).unwrap();
    let report = reporter();
    report(CONTROLLER, SENDING_PASSIVE);
    master.set_point(motor(1), torque).unwrap();
    let error = master.poll().unwrap_err();
    assert!(matches!(error, BusError::Port(PortError::NotAcknowledged(_))), "{error}");
    report(CONTROLLER, ACTIVE);
    // The set-point is gone; asking goes on.
    for _ in 0..10 {
        master.ask(motor(1), ReadMultiTurnAngle).unwrap();
    }
    assert_eq!(drives.end(), 0);
}

fn an_interface_goes_down_and_up() {
    let ((mut can, clock), (mut other, other_clock)) = (opened("vcan0"), opened("vcan0"));
    run("ip link set vcan0 down");
    let Err(nb::Error::Other(PortError::InterfaceDown(_))) = can.receive() else {
        panic!("an interface that went down is not told")
    };
    assert!(matches!(refusal(&mut can), Some(PortError::InterfaceDown(_))));
    let _ = other.receive();
    run("ip link set vcan0 up");
    assert!(matches!(refusal(&mut can), Some(PortError::InterfaceDown(_))));
    can.transmit(&frame(READ_ANGLE)).unwrap();
    assert_eq!(hear(&mut other, &other_clock), READ_ANGLE);
    other.transmit(&frame(READ_ANGLE)).unwrap();
    assert_eq!(hear(&mut can, &clock), READ_ANGLE);
    assert!(refusal(&mut can).is_none());
}

/// What the documentation of [`SocketCan`] says about frames that wait in the kernel.
fn the_kernel_holds_few_frames() {
    let (taken, heard) = frames_taken_and_heard(None);
    println!("    {taken} frames taken, {heard} of them sent after the socket was closed");
    assert!((2..=10).contains(&taken));
    assert_eq!(heard, taken, "closing a socket does take frames back: tell so");
    let (taken, heard) = frames_taken_and_heard(Some("ip link set can0 down"));
    println!("    {taken} frames taken, {heard} of them sent in spite of 'ip link set can0 down'");
    assert!(heard < taken && heard <= 2);
}

/// How many frames the kernel takes for a bus that is almost at a standstill, and how many of them are
/// sent when it goes on, after the socket was closed and this was run.
fn frames_taken_and_heard(run_while_closed: Option<&str>) -> (usize, usize) {
    let (mut other, other_clock) = opened("can1");
    // One frame in 16 seconds.
    run("tc qdisc replace dev can0 root tbf rate 8bit burst 16b limit 1600b");
    let (mut can, clock) = opened("can0");
    let taken = (0..100).take_while(|_| can.transmit(&frame(TORQUE)).is_ok()).count();
    assert!(matches!(can.transmit(&frame(TORQUE)), Err(nb::Error::WouldBlock)));
    drop((can, clock));
    if let Some(command) = run_while_closed {
        run(command);
        run("ip link set can0 up");
    }
    run("tc qdisc replace dev can0 root tbf rate 1mbit burst 1600b limit 1600b");

    let (mut can, _clock) = opened("can0");
    can.transmit(&frame(READ_ANGLE)).unwrap();
    let heard = (0..).take_while(|_| hear(&mut other, &other_clock) == TORQUE).count();
    run("tc qdisc del dev can0 root");
    (taken, heard)
}

fn deleted_interface_is_reported_as_gone() {
    let (mut can, _clock) = opened("vcan0");
    run("ip link del vcan0");
    let Err(nb::Error::Other(PortError::InterfaceGone(_))) = can.receive() else {
        panic!("an interface that has gone is not told")
    };
    let Err(nb::Error::Other(PortError::InterfaceGone(_))) = can.transmit(&frame(READ_ANGLE))
    else {
        panic!("an interface that has gone takes frames")
    };
}
