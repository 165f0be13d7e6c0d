//! `myactuator move`: to an angle, watched until the motor is there.

use std::ops::Range;

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{
    AbsolutePosition, Command, ForcePosition, IncrementalPosition, ReadMultiTurnAngle, ReadStatus1,
    ReadStatus2,
};
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::master::Patience;
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::{Angle, MaxSpeed, MaxTorque};

use super::moving::ENDS;
use super::progress::Progress;
use super::run_for::seconds;
use super::session::{OneMotor, Session, healthy, say};
use crate::cli::{Outcome, Unfinished, arguments as parse};

/// So near counts as arrived, degrees.
const NEAR_DEG: f64 = 0.2;
/// How often the motor is looked at.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// How often its errors are looked at, in looks.
const ERRORS_EVERY: u32 = 5;
/// The time that every way is given, and how many times as long as it should take besides.
const START_S: f64 = 5.0;
const TIMES: f64 = 3.0;
/// What a motor without a limit of speed is expected to reach, degrees per second.
const UNLIMITED_DPS: f64 = 90.0;
/// How often a command that names a place is sent if no reply comes.
const ATTEMPTS: u8 = 3;

/// Move a motor to an angle, or by one, and watch it arrive
///
/// It has arrived when it stands within 0.2 degrees of the target; then it holds its position until it
/// is told something else. If it does not arrive in time, reports an error or Ctrl-C is pressed, it is
/// stopped (0x81). Exit status: 0 if it has arrived, 1 if not, 2 for wrong usage, 130 if interrupted.
#[derive(Debug, clap::Args)]
#[command(after_help = ENDS)]
pub(in crate::cli) struct Arguments {
    #[command(flatten)]
    motor: OneMotor,
    /// Where to go, or with --relative how far, degrees of the output shaft over many turns.
    #[arg(long, value_parser = parse::angle, allow_hyphen_values = true)]
    angle_deg: Angle,
    /// Go on by the angle from where the shaft is.
    #[arg(long)]
    relative: bool,
    /// The fastest turning on the way, degrees per second; 0 for the drive's own limit.
    #[arg(long, value_parser = parse::max_speed, allow_hyphen_values = true, default_value = "90")]
    max_speed_dps: MaxSpeed,
    /// The largest torque, % of the rated current, 1 to 255: moves by force-limited position (0xA9).
    #[arg(long, value_parser = parse::max_torque, allow_hyphen_values = true)]
    max_torque_pct: Option<MaxTorque>,
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
    let mut session = arguments.motor.open_to_change()?;
    let motor = arguments.motor.id;
    session.ready(motor)?;
    let here = session.ask(motor, ReadMultiTurnAngle)?.angle;
    let target = target(arguments, here)?;
    let (from, to) = (here.degrees_f64(), target.degrees_f64());
    let max_speed = arguments.max_speed_dps;
    let time = arguments.timeout_s.unwrap_or_else(|| usual_time(from, to, max_speed));
    let speed = match max_speed.raw() {
        0 => "as fast as its own limits allow".to_owned(),
        _ => format!("at up to {max_speed}"),
    };
    let torque = arguments
        .max_torque_pct
        .map(|torque| format!(", with at most {torque}"))
        .unwrap_or_default();
    session
        .confirm(&format!("Motor {motor} will move from {here} to {target} {speed}{torque}."))?;
    session.moving(motor, |session| {
        match (arguments.max_torque_pct, arguments.relative) {
            (Some(max_torque), _) => send(
                session,
                motor,
                ForcePosition { max_torque, max_speed, angle: target },
                ATTEMPTS,
            ),
            (None, false) => {
                send(session, motor, AbsolutePosition { max_speed, angle: target }, ATTEMPTS)
            }
            // Sent twice, it moves twice.
            (None, true) => {
                let angle = arguments.angle_deg;
                send(session, motor, IncrementalPosition { max_speed, angle }, 1)
            }
        }?;
        watch(session, motor, from..to, time)
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

/// How long a motor usually takes at the most.
fn usual_time(from: f64, to: f64, max_speed: MaxSpeed) -> Duration {
    let dps = match max_speed.raw() {
        0 => UNLIMITED_DPS,
        raw => f64::from(raw),
    };
    let seconds = START_S + TIMES * (to - from).abs() / dps;
    Duration::from_micros((seconds * 1e6) as u64)
}

fn send<C: Command>(session: &mut Session, motor: MotorId, command: C, attempts: u8) -> Outcome {
    let patience = Patience { reply_timeout: session.address.config().reply_timeout, attempts };
    session
        .master
        .ask_with(motor, command, Some(patience), |_| {})
        .map_err(Unfinished::of_motor(motor))?;
    Ok(())
}

/// Looks at the motor until it has gone this way, in degrees.
fn watch(session: &mut Session, motor: MotorId, way: Range<f64>, time: Duration) -> Outcome {
    let Range { start: from, end: to } = way;
    let start = session.master.now();
    let seconds = |session: &Session| seconds(session.master.now() - start);
    let mut progress = Progress::new(start);
    for look in 0.. {
        session.wait_until(start + LOOK_EVERY.times(look))?;
        let angle = session.ask(motor, ReadMultiTurnAngle)?.angle;
        let feedback = session.ask(motor, ReadStatus2)?;
        let degrees = angle.degrees_f64();
        if (degrees - to).abs() <= NEAR_DEG && feedback.speed.raw() == 0 {
            drop(progress);
            return say(&format!(
                "motor {motor} has arrived at {degrees:.2} deg after {:.2} s and holds its position",
                seconds(session)
            ));
        }
        if look % ERRORS_EVERY == 0 {
            healthy(motor, session.ask(motor, ReadStatus1)?.errors)?;
        }
        let now = session.master.now();
        progress.show(now, (degrees - from) / (to - from), || {
            format!(
                "{:6.2} s {degrees:9.2} deg {:>9} {:>8}",
                seconds(session),
                feedback.speed.to_string(),
                feedback.current.to_string()
            )
        })?;
        if now - start > time {
            return Err(Unfinished::Failed(format!(
                "motor {motor} is at {degrees:.2} deg after {:.2} s and not at {to:.2}: does a load or a limit of angle (functions 6 and 7) hold it, or is the time too short?",
                seconds(session)
            )));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_way_is_given_three_times_what_it_takes_and_five_seconds() {
        let time = |from, to, dps| usual_time(from, to, MaxSpeed::from_raw(dps)).as_millis();
        assert_eq!(time(0.0, 90.0, 90), 8_000);
        assert_eq!(time(10.0, -80.0, 45), 11_000);
        assert_eq!(time(0.0, 90.0, 0), 8_000);
    }
}
