//! The cost of serving simulated drives in real time, and the accuracy of their response times:
//! `cargo bench -p myactuator-tests --bench serving`. Other work of the machine may spoil a
//! measurement, so up to three are made.
//!
//! 64 drives, 32 on CAN and 32 on RS485:
//!
//! - While nobody asks: the server's processor time.
//! - Then a program asks a motor on each bus over its pseudo-terminal, one exchange after the other: the time from the
//!   command's last byte to the reply's, compared with the same exchange under virtual time.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::ExitCode;
use std::sync::mpsc;
use std::thread;
use std::time::{Duration as WallDuration, Instant};

use embedded_can::nb::Can as _;
use embedded_io::{Read as _, ReadReady as _, Write as _};
use myactuator_host_std::serve::Server;
use myactuator_host_std::sim::Fleet;
use myactuator_host_std::sim::bus::rs485::TransceiverConfig;
use myactuator_protocol_core::command::ReadMultiTurnAngle;
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::wire::can::{self, SimpleFrame};
use myactuator_protocol_core::wire::rs485::Frame;
use myactuator_protocol_core::{MotorId, Packet};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use rustix::time::{ClockId, clock_gettime};

const RESPONSE: Duration = Duration::from_micros(800);
const IDLE: WallDuration = WallDuration::from_secs(5);
const EXCHANGES: usize = 1_000;
/// The largest share of a core that the server may take while nobody asks.
const MOST_IDLE: f64 = 0.10;
/// The largest error of the median time, either way.
const MOST_OFF_US: i64 = 100;
const MEASUREMENTS: usize = 3;

fn main() -> ExitCode {
    if (0..MEASUREMENTS).any(|_| is_good()) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Measures everything once.
fn is_good() -> bool {
    let (told, paths) = mpsc::channel();
    let (stop, stopped) = UnixStream::pair().expect("sockets");
    let server = thread::spawn(move || {
        let can = fleet().on_can(1_000_000).expect("drives");
        let line = fleet().on_rs485(1_000_000).expect("drives");
        let mut server = Server::new();
        server.host_can(&can);
        let slcan = server.serve_adapter(&can).expect("a pseudo-terminal");
        let rs485 = server.serve_line(&line, TransceiverConfig::default());
        told.send([slcan, rs485.expect("a pseudo-terminal")]).expect("a reader");
        server.run(stopped, |notice| println!("note: {notice}")).expect("it serves");
    });
    let [slcan, rs485] = paths.recv().expect("paths");

    let before = processor_time();
    thread::sleep(IDLE);
    // The waiting threads of this program take next to nothing.
    let share = (processor_time() - before).as_secs_f64() / IDLE.as_secs_f64();
    println!(
        "64 idle drives take {:.1} % of a core (at most {:.0} %)",
        share * 100.0,
        MOST_IDLE * 100.0
    );

    let ask = ReadMultiTurnAngle.packet(MotorId::MIN);
    let line_command = Frame::from_packet(&ask).expect("a frame").encode();
    let on_line = median(&rs485, &line_command, 13, exact_on_line(&line_command));
    let mut adapter = open(&slcan);
    adapter.write_all(b"S8\rO\r").expect("an adapter");
    adapter.read_exact(&mut [0; 2]).expect("an adapter that answers");
    // The reply is `z\r` for the command, and a line of 22 bytes.
    let on_can = median(&slcan, b"t14189200000000000000\r", 24, exact_on_can(&ask));
    drop(stop);
    server.join().expect("it ends");

    let late = [("RS485", on_line), ("CAN", on_can)];
    for (bus, late_us) in late {
        println!(
            "{bus}: the median answer is {late_us} us later than bus and drive take (at most \
             {MOST_OFF_US})"
        );
    }
    share <= MOST_IDLE && late.iter().all(|(_, late_us)| late_us.abs() <= MOST_OFF_US)
}

fn fleet() -> Fleet {
    Fleet::new(32).response(RESPONSE, RESPONSE)
}

/// The time of an exchange on RS485, with the drive's response.
fn exact_on_line(command: &[u8]) -> WallDuration {
    let line = fleet().on_rs485(1_000_000).expect("drives");
    let mut port = line.world.port();
    let mut reply = Vec::<u8>::new();
    let _ = port.write(command).expect("room");
    while reply.len() < command.len() {
        assert!(line.world.step(), "no reply");
        let mut chunk = [0; 16];
        if port.read_ready().expect("a port") {
            let length = port.read(&mut chunk).expect("a port");
            reply.extend(&chunk[..length]);
        }
    }
    WallDuration::from_micros(line.world.now().as_micros())
}

/// The time of an exchange on CAN, with the drive's response.
fn exact_on_can(ask: &Packet) -> WallDuration {
    let can = fleet().on_can(1_000_000).expect("drives");
    let mut port = can.world.port();
    let frame: SimpleFrame = can::encode(ask).expect("a frame");
    let _ = port.transmit(&frame).expect("room");
    while port.receive().is_err() {
        assert!(can.world.step(), "no reply");
    }
    WallDuration::from_micros(can.world.now().as_micros())
}

fn processor_time() -> WallDuration {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    WallDuration::new(
        time.tv_sec.unsigned_abs(),
        time.tv_nsec.unsigned_abs().try_into().unwrap_or(0),
    )
}

fn open(path: &Path) -> File {
    let port = File::options().read(true).write(true).open(path).expect("the terminal");
    let mut raw = tcgetattr(&port).expect("a terminal");
    raw.make_raw();
    tcsetattr(&port, OptionalActions::Now, &raw).expect("a terminal");
    port
}

/// How much longer the median exchange takes than the `exact` time, µs.
fn median(path: &Path, command: &[u8], length: usize, exact: WallDuration) -> i64 {
    let mut port = open(path);
    let mut reply = vec![0; length];
    let mut times: Vec<WallDuration> = (0..EXCHANGES)
        .map(|_| {
            port.write_all(command).expect("a command");
            let sent = Instant::now();
            port.read_exact(&mut reply).expect("a reply");
            sent.elapsed()
        })
        .collect();
    times.sort_unstable();
    times[EXCHANGES / 2].as_micros() as i64 - exact.as_micros() as i64
}
