//! Asking several motors at once, one set-point with its feedback, a watched move, and the stop: on
//! simulated drives here, and by the same `work` on a real bus and in firmware.
//!
//! `cargo run -p myactuator-host-std --example ask_move_stop`

use std::error::Error;
use std::fmt::Debug;
use std::ops::ControlFlow;

use myactuator_host_std::sim::Fleet;
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{AbsolutePosition, ReadMultiTurnAngle, Torque};
use myactuator_protocol_core::io::bring_up::{self, MoveLimits};
use myactuator_protocol_core::io::{Guard, Runner};
use myactuator_protocol_core::master::{MotorSet, StopKind};
use myactuator_protocol_core::units::{Angle, Current, MaxSpeed};

/// However this is left, by `?` or by its end, the motors are stopped; gives those that have not confirmed
/// it: cut their power.
fn work<R: Runner<8>>(bus: &mut R, arm: [MotorId; 4]) -> Result<MotorSet, Box<dyn Error>>
where
    R::Error: Debug + 'static,
{
    let mut bus = Guard::new(bus, StopKind::Hold);
    // All at once, in the time of the slowest.
    for answer in bus.ask_together(arm.map(|motor| (motor, ReadMultiTurnAngle))) {
        println!("{}", answer?.angle);
    }
    // One set-point and its feedback.
    let elbow = arm[2];
    let feedback =
        bus.set_point_and_wait(elbow, Torque { current: Current::from_amperes(0.1)? })?;
    println!("{} at {}", feedback.temperature, feedback.speed);
    // Moved, and watched until it stands there. If anything is wrong, it is stopped.
    let there = AbsolutePosition {
        max_speed: MaxSpeed::from_dps(90.0)?,
        angle: Angle::from_degrees(45.0)?,
    };
    let arrival = bring_up::move_to(&mut bus, elbow, there, &MoveLimits::default(), |look| {
        if look.feedback.current.amperes() > 5.0 {
            return ControlFlow::Break(());
        }
        ControlFlow::Continue(())
    })?;
    println!("{} after {}", arrival.angle, arrival.time);
    // These may still move. After `Master::lift_stop` motors may be moved again.
    Ok(bus.finish())
}

fn main() -> Result<(), Box<dyn Error>> {
    let fleet = Fleet::new(4).on_can(1_000_000)?;
    let arm = [1, 2, 3, 4].map(|id| MotorId::new(id).expect("1 to 32"));
    let running = work(&mut fleet.master(), arm)?;
    if running.is_empty() { Ok(()) } else { Err(format!("cut the power of {running}").into()) }
}

#[test]
fn it_runs() {
    main().unwrap();
}
