//! A round trip over a CAN interface of Linux, one motor, one at a time. Compares the time of a master's `ask` with
//! that of one `write` and one blocking `read` of a bare socket, in turns on the same interface. The drive is a process
//! that answers at once.
//!
//! ```sh
//! can_round_trip vcan0            # the comparison
//! can_round_trip vcan0 ask 1000   # so many round trips of a master alone, for strace -c
//! ```

use std::env;
use std::process::{Child, Command, ExitCode};
use std::time::Instant;

use embedded_can::{Frame as _, Id, StandardId};
use myactuator_host_std::open::{AnyMaster, BusAddress};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::ReadMultiTurnAngle;
use myactuator_protocol_core::io::Runner as _;
use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::time::Duration;
use socketcan::{CanFrame, CanSocket, Socket as _};

/// The aim for the ratio of the master's time to that of the bare socket, and the most that it may be today. A master
/// makes four system calls instead of two: before it sends it takes what has come, and it waits no longer than its
/// deadlines allow. `.ci/can-stack` measures this in an emulated PC whose time counts instructions.
const BUDGET: f64 = 1.1;
const CEILING: f64 = 1.38;
/// Round trips of one kind before the other kind's turn.
const BLOCK: u32 = 500;
const BLOCKS: usize = 15;
/// Manual 2.12: command and reply of 0x92, at 0 degrees.
const READ_ANGLE: [u8; 8] = [0x92, 0, 0, 0, 0, 0, 0, 0];
const COMMAND: StandardId = StandardId::new(0x141).unwrap();
const REPLY: StandardId = StandardId::new(0x241).unwrap();

fn main() -> ExitCode {
    let arguments: Vec<String> = env::args().skip(1).filter(|word| word != "--bench").collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        [interface, "drive"] => drive(interface),
        [interface, "ask", count] => {
            let _drive = Drive::on(interface);
            ask(interface, count.parse().expect("a number of round trips"));
            ExitCode::SUCCESS
        }
        [interface] => compare(interface),
        _ => compare("vcan0"),
    }
}

/// A process that plays the drive.
struct Drive(Child);

impl Drive {
    fn on(interface: &str) -> Self {
        let program = env::current_exe().expect("this program");
        let drive = Command::new(program).args([interface, "drive"]).spawn().expect("a process");
        let drive = Self(drive);
        // Wait until it answers.
        let socket = CanSocket::open(interface).expect("a CAN interface");
        socket.set_read_timeout(std::time::Duration::from_millis(50)).expect("a time-out");
        let command = CanFrame::new(COMMAND, &READ_ANGLE).expect("a frame");
        while socket.write_frame(&command).and_then(|()| socket.read_frame()).is_err() {}
        drive
    }
}

impl Drop for Drive {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Answers every command, at once.
fn drive(interface: &str) -> ExitCode {
    let socket = CanSocket::open(interface).expect("a CAN interface");
    let reply = CanFrame::new(REPLY, &READ_ANGLE).expect("a frame");
    loop {
        let frame = socket.read_frame().expect("a frame");
        if frame.id() == Id::Standard(COMMAND) {
            socket.write_frame(&reply).expect("room for a frame");
        }
    }
}

/// Seconds that a round trip takes.
fn timed(count: u32, mut round_trip: impl FnMut()) -> f64 {
    let start = Instant::now();
    (0..count).for_each(|_| round_trip());
    start.elapsed().as_secs_f64() / f64::from(count)
}

fn bare(interface: &str, count: u32) -> f64 {
    let socket = CanSocket::open(interface).expect("a CAN interface");
    let command = CanFrame::new(COMMAND, &READ_ANGLE).expect("a frame");
    timed(count, || {
        socket.write_frame(&command).expect("room for a frame");
        let reply = socket.read_frame().expect("a frame");
        assert_eq!((reply.id(), reply.data()), (Id::Standard(REPLY), &READ_ANGLE[..]));
    })
}

fn ask(interface: &str, count: u32) -> f64 {
    let address = BusAddress::SocketCan { interface: interface.to_owned() };
    // There is no wire, and the drive answers at once.
    let config = Config { shortest_response: Duration::ZERO, ..address.config() };
    let mut master = AnyMaster::<1>::open_with(&address, config).expect("a CAN interface");
    timed(count, || {
        let reading = master.ask(MotorId::MIN, ReadMultiTurnAngle).expect("an answer");
        assert_eq!(reading.angle.raw(), 0);
    })
}

fn compare(interface: &str) -> ExitCode {
    let _drive = Drive::on(interface);
    let _ = (bare(interface, BLOCK), ask(interface, BLOCK));
    let mut ratios = Vec::new();
    println!("round trip over {interface}: bare us, ask us, ratio");
    for _ in 0..BLOCKS {
        let (bare, ask) = (bare(interface, BLOCK), ask(interface, BLOCK));
        println!("  {:8.2} {:8.2} {:6.3}", bare * 1e6, ask * 1e6, ask / bare);
        ratios.push(ask / bare);
    }
    ratios.sort_by(f64::total_cmp);
    let median = ratios[BLOCKS / 2];
    println!(
        "median ratio of a round trip over {interface}: {median:.2}, ceiling {CEILING}, budget {BUDGET}"
    );
    if median <= CEILING { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
