//! Going on after a stop of all: here after an emergency stop during which one drive has reported an error and another
//! has lost its power. By the same functions on a real bus and in firmware.
//!
//! `cargo run -p myactuator-host-std --example going_on`

use std::error::Error;
use std::fmt::Display;
use std::ops::ControlFlow;

use myactuator_host_std::protocol::MotorId;
use myactuator_host_std::protocol::command::{
    AbsolutePosition, Command, ErrorFlags, ReadMultiTurnAngle, ReadRunTime, ReadStatus1, Status1,
};
use myactuator_host_std::protocol::io::bring_up::{self, BringUpError};
use myactuator_host_std::protocol::io::{CallError, Guard, KeepAlive, Runner};
use myactuator_host_std::protocol::master::{Event, MotorSet, StopKind};
use myactuator_host_std::protocol::time::Duration;
use myactuator_host_std::protocol::units::{Angle, MaxSpeed, Milliseconds};
use myactuator_host_std::sim::Fleet;
use myactuator_host_std::sim::plant::Load;

type Arm = [MotorId; 3];

/// Asks all at once.
fn statuses<R: Runner<8>>(
    bus: &mut R,
    arm: Arm,
) -> impl Iterator<Item = (MotorId, Result<Status1, CallError<R::Error>>)> + use<R> {
    arm.into_iter().zip(bus.ask_together(arm.map(|motor| (motor, ReadStatus1))))
}

/// Waits under the stop until somebody says that the arm may go on. Meanwhile it speaks to all motors, so that their
/// protection (0xB3) lets none go, and locks the brake of one that reports an error: it confirms the stop, but holds
/// nothing.
fn wait_for_person<R: Runner<8>>(bus: &mut R, mut may_go_on: impl FnMut() -> bool)
where
    R::Error: Display,
{
    let mut keep_alive = KeepAlive::new();
    let (mut in_error, mut locked) = (MotorSet::EMPTY, MotorSet::EMPTY);
    while !may_go_on() || keep_alive.is_waiting() {
        let now = bus.now();
        keep_alive.ask(MotorSet::ALL, bus.master(), now);
        // After an error of the bus, too, the motors have to be spoken to.
        let _ = bus.run_until(now + Duration::from_millis(5), |event| {
            keep_alive.takes(&event, now);
            if let Event::Reply { ticket, data, .. } = event
                && ReadStatus1::decode_reply(&data).is_ok_and(|status| !status.errors.is_empty())
            {
                in_error.insert(ticket.motor());
            }
        });
        if keep_alive.is_waiting() {
            continue;
        }
        for motor in in_error.without(locked).iter() {
            match bring_up::lock_brake(bus, motor) {
                // It is tried again.
                Err(BringUpError::Call(_)) => {}
                Ok(()) => locked.insert(motor),
                Err(error) => {
                    println!("{error}: hold its load by other means");
                    locked.insert(motor);
                }
            }
        }
    }
}

/// Makes the arm ready to move again, and returns the angles of its shafts, where the next movement has to begin. All
/// loops that move it have left.
///
/// If this fails before the stop is lifted, the stop stays in force. So does one that was called for since there were
/// `stops`.
fn go_on<R: Runner<8>>(
    bus: &mut R,
    arm: Arm,
    stops: u32,
    is_possible: impl Fn(MotorId, Angle) -> bool,
) -> Result<[Angle; 3], Box<dyn Error>>
where
    R::Error: 'static,
{
    for motor in arm {
        // With its supply back, a drive takes a second or two to start.
        bring_up::wait_until_there(bus, motor, Duration::from_millis(3_000))?;
    }
    // From here on a drive that has restarted is known to have, and not moved.
    for run_time in bus.ask_together(arm.map(|motor| (motor, ReadRunTime))) {
        run_time?;
    }
    check_angles(bus, arm, &is_possible)?;
    for motor in arm {
        if bus.master().has_restarted(motor) {
            println!("motor {motor} may have restarted");
            bus.master().resume(motor);
        }
    }
    if !bus.master().lift_stop_if(stops) {
        return Err("the arm was stopped again".into());
    }
    for (motor, status) in statuses(bus, arm) {
        let errors = status?.errors;
        if !errors.is_empty() {
            println!("motor {motor} is restarted: {errors}");
            bring_up::restart(bus, motor, motor)?;
        }
    }
    let angles = check_angles(bus, arm, is_possible)?;
    for motor in arm {
        bring_up::release_brake(bus, motor)?;
    }
    Ok(angles)
}

/// A drive that has restarted may have lost its turns: then its angle is off by whole ones.
fn check_angles<R: Runner<8>>(
    bus: &mut R,
    arm: Arm,
    is_possible: impl Fn(MotorId, Angle) -> bool,
) -> Result<[Angle; 3], Box<dyn Error>>
where
    R::Error: 'static,
{
    let [base, shoulder, elbow] = bus.ask_together(arm.map(|motor| (motor, ReadMultiTurnAngle)));
    let angles = [base?.angle, shoulder?.angle, elbow?.angle];
    match arm.into_iter().zip(angles).find(|&(motor, angle)| !is_possible(motor, angle)) {
        Some((motor, angle)) => {
            Err(format!("motor {motor} cannot be at {angle}: set its zero anew").into())
        }
        None => Ok(angles),
    }
}

fn reach<R: Runner<8>>(bus: &mut R, arm: Arm, degrees: f32) -> Result<(), Box<dyn Error>>
where
    R::Error: 'static,
{
    let there = AbsolutePosition {
        max_speed: MaxSpeed::from_dps(90.0)?,
        angle: Angle::from_degrees(degrees)?,
    };
    for motor in arm {
        let go_on = |_: &_| ControlFlow::Continue(());
        let arrival = bring_up::move_to(bus, motor, there, &Default::default(), go_on)?;
        println!("motor {motor} is at {}", arrival.angle);
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let weight = Load { torque_nm: -2.0, ..Load::NONE };
    let fleet = Fleet::new(3).brakes(true).load(weight).on_can(1_000_000)?;
    let mut bus = fleet.master::<8>();
    // However this is left, all motors are stopped.
    let mut bus = Guard::new(&mut bus, StopKind::Hold);
    let arm = [1, 2, 3].map(|id| MotorId::new(id).expect("1 to 32"));
    for motor in arm {
        bring_up::protect(&mut bus, motor, Milliseconds::from_raw(500))?;
        bring_up::release_brake(&mut bus, motor)?;
    }
    reach(&mut bus, arm, 30.0)?;

    let unconfirmed = bus.stop_all(StopKind::Hold, arm.into_iter().collect());
    assert!(unconfirmed.is_empty(), "cut the power of motors {unconfirmed}");
    fleet.drives[1].with(|drive| drive.raise_fault(ErrorFlags::STALL));
    fleet.world.reset(fleet.drives[2].station());

    // A person who needs three seconds.
    let released_at = bus.now() + Duration::from_millis(3_000);
    wait_for_person(&mut bus, || fleet.world.now() >= released_at);
    let stops = bus.master().stop_count();
    let angles = go_on(&mut bus, arm, stops, |_, angle| angle.degrees().abs() < 180.0)?;
    for (motor, angle) in arm.into_iter().zip(angles) {
        println!("motor {motor} goes on at {angle}");
    }
    reach(&mut bus, arm, 10.0)?;
    let unconfirmed = bus.finish();
    if unconfirmed.is_empty() {
        Ok(())
    } else {
        Err(format!("cut the power of {unconfirmed}").into())
    }
}

#[test]
fn it_runs() {
    main().unwrap();
}
