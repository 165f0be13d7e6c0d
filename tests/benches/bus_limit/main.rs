//! How close the master comes to the limit of the bus and the drives:
//! `cargo bench -p myactuator-tests --bench bus_limit`.
//!
//! Everything runs under the virtual clock against simulated drives that answer after 0.7 to 0.9 ms, so the figures are
//! the same on every machine and in every run.
//!
//! # What is measured
//! A *cycle* is one command to each of N motors and its reply. In a feedback cycle the command is 0x9C, in a motion
//! mode cycle a set-point at 0x400 + id. Each motor gets its next command as soon as it has answered the last. The
//! cycle time is the mean time from one answer of a motor to its next, over all motors.
//!
//! # The bound
//! No master can be faster than both of these:
//!
//! - *The wire.* It carries one frame at a time, so a cycle takes at least the sum of all its frames. On CAN these are
//!   the bits that were really on the wire, including stuffing and the three bits of intermission. On RS485 they are 13
//!   bytes of ten bits each.
//! - *The drive.* A motor's next command follows its reply, so a cycle takes at least one command, the drive's response
//!   and one reply. On a busy bus the trace does not show when a drive is ready to reply. So the mean response of 0.8
//!   ms is taken, less three standard errors of that mean.
//!
//! On CAN the bound is the larger of the two. On RS485 the line carries one exchange at a time, so it
//! is N times command, response, reply and the pause that lets the drives turn around.
//!
//! # Other controllers, other hosts, and loss
//! The last table is measured with light drives that only answer, for the mean of all motors and for the slowest motor.
//!
//! The controllers:
//!
//! - a FIFO of ten frames;
//! - three mailboxes that send in the order in which they were filled, like those of the boards of `mcu-example`;
//! - three mailboxes that send by priority, in which a more urgent frame pushes another out.
//!
//! The hosts: one looks at once. The other looks after pauses of 0 to 1 ms, whatever has arrived. Its bound is the
//! largest of three:
//!
//! - The wire, as above. Mailboxes do not lower it: three frames at each look, every 0.5 ms on average, are more than
//!   the wire carries.
//! - A turn. The command of a look is answered after two frames and the response, and the first look after that finds
//!   the answer. The bound is the mean of this time over all looks. (Uniform pauses D up to 1 ms make a reply wait for
//!   E[D²] / 2E[D] = 1/3 ms on average.)
//! - Both together. All motors whose replies one look finds get their commands at once, and these queue up on a wire
//!   that was idle before. That cost has no formula. So a master without any rule runs against the same looks and gives
//!   each motor its next command as soon as there is room for it. It is not fair, so only its throughput counts. With 3
//!   to 8 motors this bound is up to a fifth above the other two.
//!
//! Loss: each frame is lost with a probability of 1 % and has used the wire in vain. A lost frame may cost its own
//! exchange and no more, so the bound of a motor is the time of its answers plus that of its lost frames. Neither a
//! stream of set-points nor a repeated request reaches that bound, so both have ceilings. Lost feedback is waited for
//! until it cannot be expected any more. A request waits for `Config::reply_timeout`, and keeps the next request of its
//! kind back for `Config::late_window`, so that no answer goes to the wrong request.
//!
//! # One at a time
//! The one-at-a-time master asks a motor, waits for its reply and goes on to the next.

mod case;
mod drive;
mod host;
mod reference;
mod stage;

use std::collections::BTreeMap;
use std::process::ExitCode;
use std::sync::{Arc, Mutex};
use std::thread;

use myactuator_host_std::sim::Fleet;
use myactuator_host_std::sim::bus::{Medium, World, trace};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{MotionRanges, MotionSetPoint, RawMotion, ReadStatus2};
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::master::{Config, Event};
use myactuator_protocol_core::time::{Duration, Instant};

const RESPONSE_MIN: Duration = Duration::from_micros(700);
const RESPONSE_MAX: Duration = Duration::from_micros(900);
/// Simulated time of one measurement, after [`SETTLE`].
const SPAN: Duration = Duration::from_millis(1_000);
const SETTLE: Duration = Duration::from_millis(50);
/// The largest allowed ratio.
const LIMIT: f64 = 1.05;

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Feedback,
    Motion,
}

impl Kind {
    const fn name(self) -> &'static str {
        match self {
            Self::Feedback => "feedback",
            Self::Motion => "motion mode",
        }
    }
}

/// How long each frame occupies the wire, in nanoseconds, including `pause_ns` after it.
fn watch<B: Medium>(world: &World<B>, pause_ns: u64) -> Arc<Mutex<Vec<u64>>> {
    let frames = Arc::new(Mutex::new(Vec::new()));
    let noted = Arc::clone(&frames);
    world.observe(move |record| {
        if let trace::Event::Carried { started_ns, .. } = record.event {
            noted.lock().unwrap().push(record.at_ns - started_ns + pause_ns);
        }
    });
    frames
}

/// A set-point that lets the motor swing gently.
fn swing(motor: MotorId, now: Instant) -> RawMotion {
    let time = now.as_micros() as f32 / 1e6;
    let set_point = MotionSetPoint {
        position_rad: 0.2 * (time * 6.0 + f32::from(motor.get())).sin(),
        kp: 20.0,
        kd: 1.0,
        ..MotionSetPoint::default()
    };
    MotionRanges::V4_3.quantise(&set_point).expect("in range")
}

/// Lets the motor swing gently, or asks it for its feedback.
fn command<R: Runner<32>>(bus: &mut R, motor: MotorId, kind: Kind) {
    match kind {
        Kind::Feedback => {
            let _ticket = bus.master().request(motor, ReadStatus2).expect("the motor is free");
        }
        Kind::Motion => {
            let raw = swing(motor, bus.now());
            bus.set_point(motor, raw).expect("the bus carries motion mode");
        }
    }
}

fn answering(event: &Event) -> Option<MotorId> {
    match event {
        Event::Reply { ticket, .. } => Some(ticket.motor()),
        Event::Feedback { motor, .. } => Some(*motor),
        Event::Failed { failure, .. } => panic!("a request failed on a clean bus: {failure}"),
        Event::SetPointUnanswered { motor } => {
            panic!("motor {motor} did not answer on a clean bus")
        }
        _ => None,
    }
}

/// Runs until `until`. Each answer leads to the next command. Returns when each motor answered.
fn run<R: Runner<32>>(
    bus: &mut R,
    kind: Kind,
    until: Instant,
    mut next: impl FnMut(MotorId) -> MotorId,
) -> Vec<Vec<Instant>> {
    let mut answers = vec![Vec::new(); MotorId::COUNT];
    while bus.now() < until {
        match bus.poll() {
            Ok(Some(event)) => {
                if let Some(motor) = answering(&event) {
                    answers[motor.index()].push(bus.now());
                    command(bus, next(motor), kind);
                }
            }
            Ok(None) => bus.idle(until),
            Err(error) => panic!("the simulated bus fails: {error:?}"),
        }
    }
    answers
}

/// Mean time from one answer to the next.
fn cycle_s(answers: &[Instant]) -> f64 {
    let [first, .., last] = answers else { panic!("hardly any answers") };
    (*last - *first).as_micros() as f64 / 1e6 / (answers.len() - 1) as f64
}

struct Measured {
    cycle_s: f64,
    wire_s: f64,
    frame_s: f64,
}

/// Cycle time of `motors` motors, all at once or one at a time.
fn measure<R: Runner<32>>(
    bus: &mut R,
    wire: &Mutex<Vec<u64>>,
    kind: Kind,
    motors: u8,
    one_at_a_time: bool,
) -> Measured {
    let ids: Vec<MotorId> = MotorId::all().take(motors.into()).collect();
    let successor = |motor: MotorId| ids[(motor.index() + 1) % ids.len()];
    let next = |motor| if one_at_a_time { successor(motor) } else { motor };
    for &motor in ids.iter().take(if one_at_a_time { 1 } else { ids.len() }) {
        command(bus, motor, kind);
    }
    let settled = bus.now() + SETTLE;
    run(bus, kind, settled, next);
    wire.lock().unwrap().clear();
    let start = bus.now();
    let answers = run(bus, kind, start + SPAN, next);
    let cycles = ids.iter().map(|motor| cycle_s(&answers[motor.index()]));
    let frames_ns = wire.lock().unwrap();
    let frame_s = frames_ns.iter().sum::<u64>() as f64 / 1e9 / frames_ns.len() as f64;
    Measured {
        cycle_s: cycles.sum::<f64>() / f64::from(motors),
        wire_s: frame_s * 2.0 * f64::from(motors),
        frame_s,
    }
}

/// The mean response of `answers` draws from the uniform distribution, less three standard errors.
fn response_s(answers: f64) -> f64 {
    let (min, max) = (RESPONSE_MIN.as_micros() as f64 / 1e6, RESPONSE_MAX.as_micros() as f64 / 1e6);
    let deviation = (max - min) / 12.0_f64.sqrt();
    f64::midpoint(min, max) - 3.0 * deviation / answers.sqrt()
}

struct Row {
    cycle_s: f64,
    bound_s: f64,
    one_at_a_time_s: f64,
}

fn fleet(motors: u8) -> Fleet {
    Fleet::new(motors).response(RESPONSE_MIN, RESPONSE_MAX)
}

fn on_can(bit_rate: u32, kind: Kind, motors: u8) -> Row {
    let run = |one_at_a_time| {
        let fleet = fleet(motors).on_can(bit_rate).expect("a fleet");
        let wire = watch(&fleet.world, 3 * 1_000_000_000 / u64::from(bit_rate));
        measure(&mut fleet.master::<32>(), &wire, kind, motors, one_at_a_time)
    };
    let all = run(false);
    let answers = SPAN.as_micros() as f64 / 1e6 / all.cycle_s * f64::from(motors);
    let drive_s = 2.0 * all.frame_s + response_s(answers);
    Row {
        cycle_s: all.cycle_s,
        bound_s: all.wire_s.max(drive_s),
        one_at_a_time_s: run(true).cycle_s,
    }
}

fn on_rs485(bit_rate: u32, motors: u8) -> Row {
    let run = |one_at_a_time| {
        let fleet = fleet(motors).on_rs485(bit_rate).expect("a fleet");
        let wire = watch(&fleet.world, 0);
        measure(&mut fleet.master::<32>(), &wire, Kind::Feedback, motors, one_at_a_time)
    };
    let all = run(false);
    let myactuator_protocol_core::master::Bus::Rs485 { turnaround, .. } =
        Config::rs485(bit_rate, false).bus
    else {
        unreachable!("a configuration for RS485")
    };
    let answers = SPAN.as_micros() as f64 / 1e6 / all.cycle_s * f64::from(motors);
    let waiting = response_s(answers) + turnaround.as_micros() as f64 / 1e6;
    let bound_s = all.wire_s + waiting * f64::from(motors);
    Row { cycle_s: all.cycle_s, bound_s, one_at_a_time_s: run(true).cycle_s }
}

/// The results for 1 to 32 motors, in this order, worked out on all processors.
fn for_each_count<T: Send>(of: impl Fn(u8) -> T + Sync) -> impl Iterator<Item = (u8, T)> {
    let waiting = Mutex::new(1..=MotorId::COUNT as u8);
    let next = || waiting.lock().unwrap().next();
    let done = Mutex::new(BTreeMap::new());
    let work = || {
        while let Some(motors) = next() {
            let result = of(motors);
            done.lock().unwrap().insert(motors, result);
        }
    };
    thread::scope(|scope| {
        for _ in 0..thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(work);
        }
    });
    done.into_inner().unwrap().into_iter()
}

/// Prints one table and returns its worst ratio.
fn table(title: &str, row: impl Fn(u8) -> Row + Sync) -> f64 {
    println!("\n{title}\n  motors   cycle ms   bound ms   ratio   one at a time ms   gain");
    let mut worst = 0.0_f64;
    for (motors, row) in for_each_count(row) {
        let ratio = row.cycle_s / row.bound_s;
        worst = worst.max(ratio);
        println!(
            "  {motors:6} {:10.3} {:10.3} {:7.3} {:18.3} {:5.1}x",
            row.cycle_s * 1e3,
            row.bound_s * 1e3,
            ratio,
            row.one_at_a_time_s * 1e3,
            row.one_at_a_time_s / row.cycle_s,
        );
    }
    println!("  worst ratio here {worst:.3}");
    worst
}

fn main() -> ExitCode {
    let mut worst = 0.0_f64;
    for bit_rate in [1_000_000, 500_000] {
        for kind in [Kind::Feedback, Kind::Motion] {
            let title = format!("CAN at {} kbit/s, {} cycles", bit_rate / 1000, kind.name());
            worst = worst.max(table(&title, |motors| on_can(bit_rate, kind, motors)));
        }
    }
    for bit_rate in [115_200, 500_000, 1_000_000, 1_500_000, 2_500_000] {
        let title = format!("RS485 at {bit_rate} bit/s, feedback cycles");
        worst = worst.max(table(&title, |motors| on_rs485(bit_rate, motors)));
    }
    println!("worst ratio {worst:.2}");
    let is_within = case::table();
    if worst <= LIMIT && is_within { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
