//! Eight motors in motion (MIT) mode at 500 Hz: on simulated drives here, and by the same `run` on a real
//! bus, where `AnyMaster::open` gives the `bus`, and in firmware.
//!
//! `cargo run -p myactuator-host-std --example control_loop`

use std::array;
use std::error::Error;
use std::f32::consts::TAU;
use std::fmt::Debug;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use myactuator_host_std::sim::Fleet;
use myactuator_protocol_core::command::{
    AnyReply, MotionFeedback, MotionRanges, MotionSetPoint, RawMotion, ReadMultiTurnAngle,
    ReadVersionDate,
};
use myactuator_protocol_core::io::{Guard, LoopError, Runner, Watch};
use myactuator_protocol_core::master::{MotorSet, StopKind};
use myactuator_protocol_core::quantity::MotionScale;
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::{Firmware, MotorId};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

/// Moves eight motors at 500 Hz until `plan` has nothing more to say. `scale` is that of their firmware:
/// never guess it. However this is left, by an error or by its end, the motors are stopped; `stop_all` after it
/// returns those that have not confirmed that. Lost cycles are not made up for.
fn run<R: Runner<8>>(
    bus: &mut R,
    scale: &MotionRanges,
    mut plan: impl FnMut(MotorId, Option<MotionFeedback>) -> Option<RawMotion>,
) -> Result<(), LoopError<R::Error>> {
    let mut bus = Guard::new(bus, StopKind::Hold);
    let arm: MotorSet = MotorId::all().take(8).collect();
    let mut next = bus.now();
    let mut watch = Watch::new(arm, next);
    loop {
        let now = bus.now();
        watch.look(bus.master(), now)?;
        for motor in arm.iter() {
            let measured = match bus.master().latest_feedback(motor) {
                Some((AnyReply::Motion(raw), _)) => Some(scale.feedback(&raw)),
                _ => None,
            };
            let Some(wanted) = plan(motor, measured) else { return Ok(()) };
            bus.set_point(motor, wanted)?;
        }
        next = bus.now().max(next + Duration::from_millis(2));
        bus.run_until(next, |event| watch.note(&event))?;
    }
}

/// The scale of all motors, and where their shafts are, in radians: in motion mode a motor turns to its set-point at
/// once, over any number of turns.
fn ready<R: Runner<8>>(bus: &mut R) -> Result<(MotionRanges, [f32; 8]), Box<dyn Error>>
where
    R::Error: Debug + 'static,
{
    let arm: [MotorId; 8] = array::from_fn(|index| MotorId::new(index as u8 + 1).expect("1 to 8"));
    let mut scales = Vec::new();
    for answer in bus.ask_together(arm.map(|motor| (motor, ReadVersionDate))) {
        let firmware = Firmware::of_version_date(answer?.version_date);
        let firmware = firmware.ok_or("which firmware is this?")?;
        scales.push(firmware.motion_ranges().ok_or("its scales depend on the motor")?);
    }
    let scale = scales[0];
    if scales.iter().any(|&other| other != scale) {
        return Err("the motors differ in their scales".into());
    }
    let (min, max) = scale.ends(MotionScale::Position);
    let mut home_rad = [0.0; 8];
    let angles = bus.ask_together(arm.map(|motor| (motor, ReadMultiTurnAngle)));
    for ((motor, answer), home_rad) in arm.into_iter().zip(angles).zip(&mut home_rad) {
        let angle = answer?.angle;
        *home_rad = angle.degrees().to_radians();
        if !(min..=max).contains(home_rad) {
            return Err(format!("motor {motor} is at {angle}, beyond its scale").into());
        }
    }
    Ok((scale, home_rad))
}

/// Set by Ctrl-C, a hang-up or a request to end, which would end the program without a stop otherwise.
fn interruption() -> io::Result<Arc<AtomicBool>> {
    let is_interrupted = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGHUP, SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&is_interrupted))?;
    }
    Ok(is_interrupted)
}

/// All swing about where they are for two seconds, or until somebody ends that; motor 1 says where it is.
fn swing(
    scale: &MotionRanges,
    home_rad: [f32; 8],
    is_interrupted: &AtomicBool,
) -> impl FnMut(MotorId, Option<MotionFeedback>) -> Option<RawMotion> {
    let mut tick = 0;
    move |motor, measured| {
        if motor == MotorId::MIN {
            tick += 1;
            if let (0, Some(measured)) = (tick % 100, measured) {
                println!("{:.1} s: {:6.3} rad", tick as f32 / 500.0, measured.position_rad);
            }
        }
        let phase = TAU * tick as f32 / 500.0;
        let wanted = MotionSetPoint {
            position_rad: home_rad[motor.index()] + 0.5 * phase.sin(),
            velocity_rad_s: 0.5 * TAU * phase.cos(),
            kp: 40.0,
            kd: 2.0,
            torque_nm: 0.0,
        };
        // Nothing that the scale cannot say is ever sent: it ends the plan.
        let goes_on = tick <= 1_000 && !is_interrupted.load(Ordering::Relaxed);
        scale.quantise(&wanted).ok().filter(|_| goes_on)
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let is_interrupted = interruption()?;
    let fleet = Fleet::new(8).on_can(1_000_000)?;
    let mut bus = fleet.master::<8>();

    let (scale, home_rad) = ready(&mut bus)?;
    let left = run(&mut bus, &scale, swing(&scale, home_rad, &is_interrupted));
    let running = bus.stop_all(StopKind::Hold, MotorSet::EMPTY);
    if !running.is_empty() {
        eprintln!("the loop has ended: {left:?}");
        return Err(format!("motors {running} have not confirmed the stop: cut their power").into());
    }
    left.map_err(|error| error.to_string().into())
}

#[cfg(test)]
mod tests {
    use myactuator_host_std::sim::CanFleet;
    use myactuator_protocol_core::time::Instant;

    use super::*;

    /// Has the program held in its tenth cycle for so long. Gives how it ends, and when each cycle began, in
    /// milliseconds.
    fn held_for(millis: u64) -> (Result<(), String>, Vec<u64>) {
        let fleet = Fleet::new(8).on_can(1_000_000).unwrap();
        let mut bus = fleet.master::<8>();
        let scale = Firmware::V4_3.motion_ranges().unwrap();
        let rest = MotionSetPoint {
            position_rad: 0.0,
            velocity_rad_s: 0.0,
            kp: 0.0,
            kd: 1.0,
            torque_nm: 0.0,
        };
        let mut begun = Vec::new();
        let left = run(&mut bus, &scale, |motor, _| {
            if motor == MotorId::MIN {
                begun.push(fleet.world.now().as_micros() / 1_000);
                if begun.len() == 10 {
                    fleet.world.run_for(Duration::from_millis(millis));
                }
            }
            scale.quantise(&rest).ok().filter(|_| begun.len() <= 20)
        });
        assert!(bus.set_point(MotorId::MIN, scale.quantise(&rest).unwrap()).is_err(), "stopped");
        (left.map_err(|error| error.to_string()), begun)
    }

    /// A fleet of this firmware whose motor 3 is turned, by degrees.
    fn turned(firmware: Firmware, degrees: f64) -> CanFleet {
        let fleet = Fleet::new(8).firmware(firmware).on_can(1_000_000).unwrap();
        fleet.drives[2].with(|drive| drive.plant_mut().set_output_angle_deg(degrees)).unwrap();
        fleet
    }

    #[test]
    fn loop_begins_where_the_shafts_are() {
        let fleet = turned(Firmware::V4_3, 200.0);
        let mut bus = fleet.master::<8>();
        let (scale, home_rad) = ready(&mut bus).unwrap();
        let is_interrupted = AtomicBool::new(false);
        let mut plan = swing(&scale, home_rad, &is_interrupted);
        run(&mut bus, &scale, |motor, measured| {
            let at_deg = fleet.drives[2].with(|drive| drive.plant().output_angle_deg());
            // It swings by 0.5 rad.
            assert!((at_deg - 200.0).abs() < 30.0, "{at_deg}");
            plan(motor, measured)
        })
        .unwrap();
    }

    #[test]
    fn shaft_beyond_the_scale_is_not_moved() {
        let refused = ready(&mut turned(Firmware::V4_3, 800.0).master::<8>()).unwrap_err();
        assert_eq!(refused.to_string(), "motor 3 is at 800 deg, beyond its scale");
    }

    #[test]
    fn missed_cycles_are_not_made_up_for() {
        let (left, begun) = held_for(20);
        assert_eq!(left, Ok(()));
        // Every 2 ms from 0 and, after the hold of 20 ms at 18 ms, from 38 ms.
        let expected: Vec<u64> =
            (0..10).map(|n| 2 * n).chain((0..11).map(|n| 38 + 2 * n)).collect();
        assert_eq!(begun, expected);
    }

    #[test]
    fn control_loop_held_up_for_over_100_ms_ends() {
        let (left, begun) = held_for(90);
        assert_eq!((left, begun.len()), (Ok(()), 21));
        let (left, begun) = held_for(101);
        assert_eq!(left, Err("the control loop was held up for 101 ms".to_owned()));
        assert_eq!(begun.len(), 10);
    }

    /// Runs for ten seconds on a bus on which this goes wrong. Gives how it ends, and when it last planned anything.
    fn ten_seconds_with(fault: &str) -> (Result<(), String>, Duration) {
        let fleet = Fleet::new(8).faults([fault.parse().unwrap()]).on_can(1_000_000).unwrap();
        let mut bus = fleet.master::<8>();
        let scale = Firmware::V4_3.motion_ranges().unwrap();
        let end = Duration::from_secs(10);
        let rest = scale.quantise(&MotionSetPoint { kd: 1.0, ..MotionSetPoint::default() });
        let mut planned = Duration::ZERO;
        let left = run(&mut bus, &scale, |_, _| {
            planned = fleet.world.now() - Instant::ZERO;
            rest.ok().filter(|_| planned < end)
        });
        (left.map_err(|error| error.to_string()), planned)
    }

    #[test]
    fn random_losses_do_not_end_the_loop_but_a_cut_cable_does() {
        let (left, _) = ten_seconds_with("lose=0.05");
        assert_eq!(left, Ok(()));
        let (left, after) = ten_seconds_with("cut@3+5s");
        assert!(
            left.as_ref().is_err_and(|why| why.starts_with("motor 3 is not heard")),
            "{left:?}"
        );
        let within = Duration::from_millis(98)..=Duration::from_millis(102);
        assert!(within.contains(&(after - Duration::from_secs(5))), "{after}");
    }

    /// The drive goes on giving feedback in either case. Each motor is asked for both within 160 ms.
    #[test]
    fn drive_error_and_drive_restart_end_the_loop() {
        for (fault, why) in [
            ("stall@5+5s", "motor 5 reports an error (motor stalled), and may hold nothing"),
            ("reset@6+5s", "motor 6 has restarted"),
        ] {
            let (left, after) = ten_seconds_with(fault);
            assert!(left.as_ref().is_err_and(|left| left.starts_with(why)), "{left:?}");
            let within = Duration::ZERO..=Duration::from_millis(170);
            assert!(within.contains(&(after - Duration::from_secs(5))), "{after}");
        }
    }

    #[test]
    fn every_signal_that_ends_the_program_stops_the_motors_first() {
        for signal in [SIGINT, SIGHUP, SIGTERM] {
            let is_interrupted = interruption().unwrap();
            let fleet = Fleet::new(8).on_can(1_000_000).unwrap();
            let mut bus = fleet.master::<8>();
            let scale = Firmware::V4_3.motion_ranges().unwrap();
            let mut plan = swing(&scale, [0.0; 8], &is_interrupted);
            let ended = run(&mut bus, &scale, |motor, measured| {
                if motor == MotorId::MIN && fleet.world.now().as_micros() == 100_000 {
                    signal_hook::low_level::raise(signal).unwrap();
                }
                plan(motor, measured)
            });
            assert_eq!(ended, Ok(()), "{signal}");
            let ended_us = fleet.world.now().as_micros();
            assert!(ended_us < 110_000, "{signal}: {ended_us}");
            let moved =
                bus.set_point(MotorId::MIN, scale.quantise(&MotionSetPoint::default()).unwrap());
            assert!(moved.is_err(), "{signal}: stopped");
        }
    }
}
