//! `myactuator move`: moves a motor to an angle and watches it arrive.

use std::ops::ControlFlow;
use std::sync::atomic::Ordering;

use myactuator_protocol_core::command::{
    AbsolutePosition, ForcePosition, IncrementalPosition, ReadMultiTurnAngle,
};
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::io::bring_up::{
    self, MoveCommand, MoveFailure, MoveLimits, MoveProgress, NotArrived, WhenStalled,
};
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::{Angle, MaxSpeed, MaxTorque};
use myactuator_protocol_core::{MotorId, Opcode};

use super::help::{HOLDS, SIGNALS, STOPS, paragraphs};
use super::progress::Progress;
use super::run_for::seconds;
use super::session::Session;
use super::session::{OneMotor, say};
use crate::cli::{Outcome, Unfinished, arguments as parse};

/// What ends the holding; whether it is set cannot be read back.
const UNLESS_PROTECTED: &str = " unless its protection (0xB3) ends that";

/// Move a motor to an angle, or by one, and watch it arrive
///
/// The motor has arrived when it stands within 0.2 degrees of the target. It then holds its position until it gets
/// another command.
///
/// If it does not arrive in time or reports an error, or if Ctrl-C is pressed, it is stopped (0x81) and holds with all
/// its torque. With --press it is not stopped where it has met something: it goes on pressing.
///
/// Exit status: 0 arrived or pressing, 1 not, 2 wrong usage.
#[derive(Debug, clap::Args)]
#[command(after_help = paragraphs([STOPS, SIGNALS, HOLDS]))]
pub(in crate::cli) struct Arguments {
    #[command(flatten)]
    motor: OneMotor,
    /// Where to go, or with --relative how far, degrees of the output shaft over many turns.
    #[arg(long, value_parser = parse::angle, allow_hyphen_values = true)]
    angle_deg: Angle,
    /// Go on by the angle from where the shaft is.
    #[arg(long)]
    relative: bool,
    /// The fastest turning on the way, degrees per second; 0 may set no limit.
    #[arg(long, value_parser = parse::max_speed, allow_hyphen_values = true, default_value = "90")]
    max_speed_dps: MaxSpeed,
    /// The largest torque, % of the rated current, 1 to 255: moves by force-limited position (0xA9).
    #[arg(long, value_parser = parse::max_torque, allow_hyphen_values = true)]
    max_torque_pct: Option<MaxTorque>,
    /// Go on pressing with that torque against what is in the way.
    #[arg(long, requires = "max_torque_pct")]
    press: bool,
    /// How long it may take, s [default: 5 s and three times what the way takes at full speed].
    #[arg(long, value_parser = parse::seconds, allow_hyphen_values = true)]
    timeout_s: Option<Duration>,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    if arguments.max_torque_pct.is_some_and(|torque| torque.raw() == 0) {
        return Err(Unfinished::Usage(
            "--max-torque-pct: 0 leaves no torque to move with: give 1 to 255, or leave it out"
                .to_owned(),
        ));
    }
    // The move becomes one of three commands; all need the same consent.
    let mut session = arguments.motor.open_to_send(Opcode::AbsolutePosition)?;
    let motor = arguments.motor.id;
    session.ready(motor)?;
    let here = session.ask(motor, ReadMultiTurnAngle)?.angle;
    let target = target(arguments, here)?;
    let max_speed = arguments.max_speed_dps;
    let speed = match max_speed.raw() {
        0 => "at a speed that may have no limit (0)".to_owned(),
        _ => format!("at up to {max_speed}"),
    };
    let torque = arguments
        .max_torque_pct
        .map(|torque| format!(", with at most {torque}"))
        .unwrap_or_default();
    session.confirm(
        motor,
        &format!("Motor {motor} will move from {here} to {target} {speed}{torque}."),
    )?;
    let when_stalled = if arguments.press { WhenStalled::Press } else { WhenStalled::Stop };
    let limits = MoveLimits { time: arguments.timeout_s, when_stalled, ..MoveLimits::default() };
    let angle = arguments.angle_deg;
    session.moving(motor, |session| match (arguments.max_torque_pct, arguments.relative) {
        (Some(max_torque), _) => {
            go(session, motor, ForcePosition { max_torque, max_speed, angle: target }, &limits)
        }
        (None, false) => go(session, motor, AbsolutePosition { max_speed, angle }, &limits),
        (None, true) => go(session, motor, IncrementalPosition { max_speed, angle }, &limits),
    })
}

fn target(arguments: &Arguments, here: Angle) -> Outcome<Angle> {
    if !arguments.relative {
        return Ok(arguments.angle_deg);
    }
    let raw = here.raw().checked_add(arguments.angle_deg.raw()).ok_or_else(|| {
        Unfinished::Usage(format!(
            "--angle-deg: from {here}, {} more is further than an angle can be",
            arguments.angle_deg
        ))
    })?;
    Ok(Angle::from_raw(raw))
}

fn go(
    session: &mut Session,
    motor: MotorId,
    command: impl MoveCommand,
    limits: &MoveLimits,
) -> Outcome {
    let mut progress = Progress::new(session.master.now());
    let start = session.master.now();
    let interrupted = session.interrupted.clone();
    let stopped = session.master.stopped.clone();
    let mut shown = Ok(());
    let outcome = bring_up::move_to(&mut session.master, motor, command, limits, |look| {
        shown = progress.show(start + look.time, share(look), || line(look));
        let is_over = interrupted.load(Ordering::Relaxed) || !stopped.get().is_empty();
        if shown.is_err() || is_over { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    drop(progress);
    let tolerance = limits.tolerance.raw().unsigned_abs();
    match outcome {
        Ok(end) if end.angle.raw().abs_diff(end.target.raw()) > tolerance => say(&format!(
            "motor {motor} has met something at {:.2} deg after {:.2} s and presses against it{UNLESS_PROTECTED}",
            end.angle.degrees_f64(),
            seconds(end.time)
        )),
        Ok(arrival) => say(&format!(
            "motor {motor} has arrived at {:.2} deg after {:.2} s and holds its position{UNLESS_PROTECTED}",
            arrival.angle.degrees_f64(),
            seconds(arrival.time)
        )),
        Err(NotArrived { why: MoveFailure::GivenUp, .. }) => {
            shown?;
            session.check_interrupted()?;
            session.check_stopped_elsewhere()
        }
        Err(NotArrived { why: MoveFailure::Call(error), .. }) => Err(error.into()),
        Err(NotArrived { why: MoveFailure::Fault(errors), .. }) => session.healthy(motor, errors),
        Err(NotArrived { why, .. }) => {
            Err(Unfinished::Failed(format!("motor {motor} has not arrived: {why}")))
        }
    }
}

/// How much of the way is done.
fn share(look: &MoveProgress) -> f64 {
    let from = look.from.degrees_f64();
    (look.angle.degrees_f64() - from) / (look.target.degrees_f64() - from)
}

fn line(look: &MoveProgress) -> String {
    format!(
        "{:6.2} s {:9.2} deg {:>9} {:>8}",
        seconds(look.time),
        look.angle.degrees_f64(),
        look.feedback.speed.to_string(),
        look.feedback.current.to_string()
    )
}

#[cfg(test)]
mod tests {
    use myactuator_host_std::sim::Fleet;
    use myactuator_protocol_core::time::Instant;

    use super::super::simulated::{CtrlC, OtherMaster, Sends, to_first};
    use super::*;

    #[test]
    fn restart_during_a_move_is_reported_without_advice_to_resume() {
        let faults = ["reset@1+1.5s".parse().unwrap()];
        let fleet = Fleet::new(1).faults(faults).on_can(1_000_000).unwrap();
        let (max_speed, angle) = (MaxSpeed::from_raw(360), Angle::from_raw(90_000));
        let command = AbsolutePosition { max_speed, angle };
        let limits = MoveLimits::default();
        let outcome = go(&mut Session::on(&fleet), MotorId::MIN, command, &limits);
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        assert!(message.starts_with("motor 1 has restarted, or was silent"), "{message}");
        assert!(!message.contains("resume"), "{message}");
    }

    #[test]
    fn ctrl_c_during_a_move_stops_the_motor_at_once() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        CtrlC::attach(&fleet, &session, Duration::from_millis(300));
        // It would take two seconds.
        let (max_speed, angle) = (MaxSpeed::from_raw(90), Angle::from_raw(18_000));
        let outcome = session.moving(MotorId::MIN, |session| {
            let command = AbsolutePosition { max_speed, angle };
            go(session, MotorId::MIN, command, &MoveLimits::default())
        });
        let message = "interrupted; motor 1 is stopped and holds still (0x81) unless its protection (0xB3) ends that";
        assert_eq!(outcome, Err(Unfinished::Interrupted(message.to_owned())));
        let angle_deg = fleet.drives[0].with(|drive| drive.plant().output_angle_deg());
        // 27 degrees in 300 ms.
        assert!((1.0..35.0).contains(&angle_deg), "{angle_deg}");
    }

    #[test]
    fn move_that_another_master_stops_ends_at_once_and_reports_that() {
        for (first, how) in [
            (0x81, "is stopped and holds still (0x81) unless its protection (0xB3) ends that"),
            (0x80, "is off (0x80): its shaft is free unless a brake holds it"),
        ] {
            let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
            let stop = to_first([first, 0, 0, 0, 0, 0, 0, 0]);
            OtherMaster::attach(&fleet, stop, Sends::Once(Duration::from_millis(300)));
            let mut session = Session::on(&fleet);
            let (max_speed, angle) = (MaxSpeed::from_raw(90), Angle::from_raw(18_000));
            let outcome = session.moving(MotorId::MIN, |session| {
                let command = AbsolutePosition { max_speed, angle };
                go(session, MotorId::MIN, command, &MoveLimits::default())
            });
            let message = format!("something else on this bus has stopped motor 1; motor 1 {how}");
            assert_eq!(outcome, Err(Unfinished::Failed(message)));
            let is_on = fleet.drives[0].with(|drive| drive.state().output_on);
            assert_eq!(is_on, first == 0x81);
            let latest = session.master.now();
            assert!(latest < Instant::from_millis(750), "{latest:?}");
        }
    }
}
