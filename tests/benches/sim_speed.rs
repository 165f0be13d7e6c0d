//! How much faster than real time a full bus of simulated drives runs.
//!
//! 32 drives with their whole physics, each with an arm on its shaft, are on one bus. A master gives each its next
//! set-point as soon as it has answered the last. Run it with
//!
//! ```text
//! cargo bench -p myactuator-tests --bench sim_speed
//! ```
//!
//! It fails if a simulated second on CAN takes longer than [`LIMIT`] on one core. The figure of RS485 has no limit.

use std::time::{Duration as WallDuration, Instant as WallInstant};

use myactuator_host_std::sim::Fleet;
use myactuator_host_std::sim::plant::{Arm, Load, MotorParameters};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{AbsolutePosition, MotionRanges, MotionSetPoint};
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::master::Event;
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::{Angle, MaxSpeed};
use myactuator_tests::values::GRAVITY_M_S2;

const MOTORS: u8 = MotorId::COUNT as u8;
const BIT_RATE: u32 = 1_000_000;
const SIMULATED: Duration = Duration::from_secs(1);

/// The longest time that a simulated second may take.
const LIMIT: WallDuration = WallDuration::from_millis(200);

/// How often a run is timed. Other work of the machine makes a run longer, never shorter, so the shortest counts.
const ATTEMPTS: usize = 5;

/// Gives the motor its set-point for this time: a swing of ±0.5 rad with a period of one second.
type GiveSetPoint<R> = fn(&mut R, MotorId, seconds: f32);

/// In motion mode, which demands the most of a drive and of the master.
fn by_motion<R: Runner<32>>(master: &mut R, motor: MotorId, seconds: f32) {
    let (sin, cos) = (std::f32::consts::TAU * seconds).sin_cos();
    let set_point = MotionSetPoint {
        position_rad: 0.5 * sin,
        velocity_rad_s: 0.5 * std::f32::consts::TAU * cos,
        kp: 40.0,
        kd: 2.0,
        torque_nm: 0.0,
    };
    let motion = MotionRanges::V4_3.quantise(&set_point).expect("a set-point of numbers");
    master.set_point(motor, motion).expect("a place for each motor");
}

/// By absolute positions: motion mode exists on CAN only.
fn by_position<R: Runner<32>>(master: &mut R, motor: MotorId, seconds: f32) {
    let degrees = (0.5 * (std::f32::consts::TAU * seconds).sin()).to_degrees();
    let angle = Angle::from_degrees(degrees).expect("an angle in range");
    let max_speed = MaxSpeed::from_dps(360.0).expect("a speed in range");
    master.set_point(motor, AbsolutePosition { max_speed, angle }).expect("a place for each motor");
}

/// Streams for [`SIMULATED`] and returns the number of answers.
fn stream<R: Runner<32>>(master: &mut R, give: GiveSetPoint<R>) -> u32 {
    let start = master.now();
    let end = start + SIMULATED;
    for motor in MotorId::all() {
        give(master, motor, 0.0);
    }
    let mut answers = 0;
    while master.now() < end {
        match master.poll().expect("a bus without faults") {
            Some(Event::Feedback { motor, .. }) => {
                answers += 1;
                let seconds = (master.now() - start).as_secs_f32();
                give(master, motor, seconds);
            }
            Some(_) => {}
            None => master.idle(end),
        }
    }
    answers
}

/// Drives with arms of half a metre. The weight of an arm needs half of the rated torque.
fn fleet() -> Fleet {
    let model = MotorParameters::named("RMD-X8-P20-120").expect("a model of the library");
    let mass_kg = 0.5 * model.rating.torque_nm / (GRAVITY_M_S2 * 0.5);
    let arm = Arm { mass_kg, length_m: 0.5, down_deg: 0.0 };
    Fleet::new(MOTORS).model(model).load(Load { arm: Some(arm), ..Load::NONE })
}

fn second_on_can() -> u32 {
    let fleet = fleet().on_can(BIT_RATE).expect("a bus of the model");
    stream(&mut fleet.master::<32>(), by_motion)
}

fn second_on_rs485() -> u32 {
    let fleet = fleet().on_rs485(BIT_RATE).expect("a bus of the model");
    stream(&mut fleet.master::<32>(), by_position)
}

/// The shortest time of [`ATTEMPTS`] runs, and the answers in one run, which are the same in each.
fn timed(second: fn() -> u32) -> (WallDuration, u32) {
    let runs = (0..ATTEMPTS).map(|_| {
        let start = WallInstant::now();
        let answers = second();
        (start.elapsed(), answers)
    });
    runs.min().expect("at least one run")
}

fn report(bus: &str, (took, answers): (WallDuration, u32)) {
    println!(
        "{bus}: {MOTORS} drives, {answers} set-points answered in one simulated second, which took \
         {:.3} s: {:.1} times faster than real time",
        took.as_secs_f64(),
        1.0 / took.as_secs_f64(),
    );
}

fn main() {
    // Only as a benchmark: a debug build may be slow.
    if !std::env::args().any(|argument| argument == "--bench") {
        return;
    }
    let can = timed(second_on_can);
    report("CAN", can);
    report("RS485", timed(second_on_rs485));
    let (took, _) = can;
    if took > LIMIT {
        eprintln!("error: expected a simulated second on CAN within {LIMIT:?}, found {took:?}");
        std::process::exit(1);
    }
}
