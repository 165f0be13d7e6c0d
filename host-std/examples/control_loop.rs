//! Eight motors in motion (MIT) mode at 500 Hz: on simulated drives here, and by the same `run` on a real
//! bus, where `AnyMaster::open` gives the `bus`, and in firmware.
//!
//! `cargo run -p myactuator-host-std --example control_loop`

use std::error::Error;
use std::f32::consts::TAU;

use myactuator_host_std::sim::Fleet;
use myactuator_protocol_core::command::{
    AnyReply, MotionFeedback, MotionRanges, MotionSetPoint, RawMotion, ReadVersionDate,
};
use myactuator_protocol_core::io::{CallError, Guard, Runner};
use myactuator_protocol_core::master::{Failure, MotorSet, Presence, StopKind};
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::{Firmware, MotorId};

/// Moves eight motors at 500 Hz until `plan` has nothing more to say. `scale` is that of their firmware:
/// never guess it. However this is left, by an error or by its end, the motors are stopped; gives those that
/// have not confirmed the stop: cut their power.
fn run<R: Runner<8>>(
    bus: &mut R,
    scale: &MotionRanges,
    mut plan: impl FnMut(MotorId, Option<MotionFeedback>) -> Option<RawMotion>,
) -> Result<MotorSet, CallError<R::Error>> {
    let mut bus = Guard::new(bus, StopKind::Hold);
    let mut next = bus.now();
    loop {
        for motor in MotorId::all().take(8) {
            let master = bus.master();
            if master.health(motor).presence == Presence::Silent {
                return Err(CallError::Failed(Failure::NoReply));
            }
            let measured = match master.latest_feedback(motor) {
                Some((AnyReply::Motion(raw), _time)) => Some(scale.feedback(&raw)),
                _ => None,
            };
            let Some(wanted) = plan(motor, measured) else { return Ok(bus.finish()) };
            bus.set_point(motor, wanted)?;
        }
        next += Duration::from_millis(2);
        bus.run_until(next, |_event| {})?;
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let fleet = Fleet::new(8).on_can(1_000_000)?;
    let mut bus = fleet.master::<8>();

    let date = bus.ask(MotorId::MIN, ReadVersionDate)?.version_date;
    let firmware = Firmware::of_version_date(date).ok_or("which firmware is this?")?;
    let scale = firmware.motion_ranges().ok_or("its scales depend on the motor")?;

    // All swing for two seconds; motor 1 says where it is.
    let mut tick = 0;
    let plan = |motor, measured: Option<MotionFeedback>| {
        if motor == MotorId::MIN {
            tick += 1;
            if let (0, Some(measured)) = (tick % 100, measured) {
                println!("{:.1} s: {:6.3} rad", tick as f32 / 500.0, measured.position_rad);
            }
        }
        let phase = TAU * tick as f32 / 500.0;
        let wanted = MotionSetPoint {
            position_rad: 0.5 * phase.sin(),
            velocity_rad_s: 0.5 * TAU * phase.cos(),
            kp: 40.0,
            kd: 2.0,
            torque_nm: 0.0,
        };
        // Nothing that the scale cannot say is ever sent: it ends the plan.
        scale.quantise(&wanted).ok().filter(|_| tick <= 1_000)
    };
    let running = run(&mut bus, &scale, plan)?;
    if running.is_empty() { Ok(()) } else { Err(format!("cut the power of {running}").into()) }
}
