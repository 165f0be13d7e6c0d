//! `myactuator motion`: one set-point of motion (MIT) mode, for a while.

use myactuator_protocol_core::command::{MotionRanges, MotionSetPoint, ReadMultiTurnAngle};
use myactuator_protocol_core::master::StopKind;
use myactuator_protocol_core::quantity::MotionScale;
use myactuator_protocol_core::{MotorId, Opcode};

use super::help::{HOLDS, SIGNALS, STOPS, paragraphs};
use super::revision::MotorRevision;
use super::run_for::{self, Run, Span};
use super::session::Session;
use crate::cli::{Outcome, Unfinished, arguments as parse};

/// Run a motor in motion (MIT) mode at one set-point for a while, then stop it (0x81); CAN only
///
/// A locked brake is released first. It stays open, because the motor holds still at the end.
///
/// A shaft beyond the scale of positions is not moved. Ctrl-C and errors stop the motor (0x81) at once.
///
/// Exit status: 0 has run, 1 not, 2 wrong usage.
#[derive(Debug, clap::Args)]
#[command(after_help = paragraphs([STOPS, SIGNALS, HOLDS]))]
pub(in crate::cli) struct Arguments {
    #[command(flatten)]
    span: Span,
    /// Wanted position, rad.
    #[arg(long, value_parser = parse::single, allow_hyphen_values = true)]
    position_rad: f32,
    /// Wanted velocity, rad/s.
    #[arg(long, value_parser = parse::single, allow_hyphen_values = true, default_value = "0")]
    velocity_rad_s: f32,
    /// Gain on the position error, N·m/rad.
    #[arg(long, value_parser = parse::single, allow_hyphen_values = true)]
    kp: f32,
    /// Gain on the velocity error, N·m·s/rad.
    #[arg(long, value_parser = parse::single, allow_hyphen_values = true)]
    kd: f32,
    /// Torque added to both, N·m.
    #[arg(long, value_parser = parse::single, allow_hyphen_values = true, default_value = "0")]
    torque_nm: f32,
    #[command(flatten)]
    revision: MotorRevision,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let bus = arguments.span.motor.on.to_act()?.kind();
    parse::check_bus(Opcode::Motion.into(), bus)?;
    run_on(&mut arguments.span.motor.open_to_send(Opcode::Motion)?, arguments)
}

fn run_on(session: &mut Session, arguments: &Arguments) -> Outcome {
    let &Arguments { position_rad, velocity_rad_s, kp, kd, torque_nm, .. } = arguments;
    let set_point = MotionSetPoint { position_rad, velocity_rad_s, kp, kd, torque_nm };
    let ranges = arguments.revision.scales(session, arguments.span.motor.id)?;
    let command = ranges.quantise(&set_point).map_err(|error| error.to_string())?;
    let run = Run {
        command,
        does: format!(
            "run in motion mode to {position_rad} rad at {velocity_rad_s} rad/s (kp {kp}, kd {kd}, \
             {torque_nm} N·m)"
        ),
        needs_open_brake: true,
        end: StopKind::Hold,
    };
    let may_run = |session: &mut Session| is_on_scale(session, arguments.span.motor.id, &ranges);
    run_for::run(session, &arguments.span, &run, may_run, |raw| {
        let feedback = ranges.feedback(raw);
        format!(
            "{:8.3} rad {:8.3} rad/s {:8.3} N·m",
            feedback.position_rad, feedback.velocity_rad_s, feedback.torque_nm
        )
    })
}

/// Fails if the shaft is beyond the scale. There the feedback of motion mode is the scale's end, and the motor would
/// turn back to the set-point, over any number of turns.
fn is_on_scale(session: &mut Session, motor: MotorId, ranges: &MotionRanges) -> Outcome {
    let here = session.ask(motor, ReadMultiTurnAngle)?.angle;
    let (min, max) = ranges.ends(MotionScale::Position);
    let here_rad = here.degrees_f64().to_radians();
    if (f64::from(min)..=f64::from(max)).contains(&here_rad) {
        return Ok(());
    }
    Err(Unfinished::Failed(format!(
        "motor {motor} is at {here} ({here_rad:.2} rad), and motion mode reaches from {min} to {max} rad: move it back first \
         ({}), or make its present position the zero ({})",
        session.hint("move --angle-deg 0", motor),
        session.hint("zero", motor)
    )))
}

#[cfg(test)]
mod tests {
    use myactuator_host_std::sim::Fleet;
    use myactuator_protocol_core::command::{AbsolutePosition, VersionDate};
    use myactuator_protocol_core::time::Duration;
    use myactuator_protocol_core::units::{Angle, MaxSpeed};
    use myactuator_protocol_core::{Channel, Firmware};

    use super::super::simulated::{sent, typed};
    use super::*;

    /// Moves by half a radian with these options. Returns the outcome, the angle of the shaft, and whether motion
    /// frames were sent.
    fn to_half_a_radian(fleet: &Fleet, options: &str) -> (Outcome, f64, bool) {
        let fleet = fleet.on_can(1_000_000).unwrap();
        let log = fleet.world.log();
        let arguments = typed(&format!("--id 1 --position-rad 0.5 --kp 40 --kd 2 {options}"));
        let outcome = run_on(&mut Session::on(&fleet), &arguments);
        let moved = sent(&log).iter().any(|p| p.channel == Channel::Motion(MotorId::MIN));
        let degrees = fleet.drives[0].with(|drive| drive.plant().output_angle_deg());
        (outcome, degrees, moved)
    }

    fn refused(fleet: &Fleet, options: &str) -> String {
        match to_half_a_radian(fleet, options) {
            (Err(Unfinished::Failed(sentence)), 0.0, false) => sentence,
            other => panic!("{other:?}"),
        }
    }

    fn runs(fleet: &Fleet, options: &str) {
        let (outcome, degrees, _) = to_half_a_radian(fleet, options);
        assert_eq!(outcome, Ok(()));
        // Where friction holds it: 1.6 N·m over 40 N·m/rad are 2.3 degrees.
        assert!((degrees - 28.6).abs() < 2.3, "{degrees}");
    }

    #[test]
    fn scales_that_depend_on_the_motor_must_be_given() {
        // The scales of a large motor.
        let ranges = "12.566,45,500,5,60";
        let fleet = Fleet::new(1).firmware(Firmware::V4_4);
        let fleet = fleet.motion_ranges(parse::ranges(ranges).unwrap());
        let message = refused(&fleet, "--for-s 1");
        assert!(message.starts_with("motor 1 speaks v4.4: --ranges is missing: "), "{message}");
        // The wrong firmware is refused.
        let message = refused(&fleet, "--firmware v4.3");
        assert!(message.contains("version date 2026042402, which is v4.4's"), "{message}");
        runs(&fleet, &format!("--ranges {ranges}"));
    }

    #[test]
    fn a_motor_of_unknown_firmware_gets_no_motion_frame() {
        // A build that was seen on real motors; no report says which protocol it speaks.
        let fleet = Fleet::new(1).version_date(VersionDate::from_raw(2_025_070_202));
        let message = refused(&fleet, "--for-s 1");
        assert!(
            message.contains("version date 2025070202, which is not that of a known firmware"),
            "{message}"
        );
        runs(&fleet, "--firmware v4.3");
        runs(&fleet, "--ranges 12.5,45,500,5,24");
    }

    /// The motor once swung over many turns, because beyond the scale it reports the end of the scale.
    #[test]
    fn a_shaft_beyond_the_scale_is_not_moved() {
        // 12.5 rad are 716.2 degrees.
        for (degrees, is_beyond) in [(710, false), (-710, false), (721, true), (-3_266, true)] {
            let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
            let mut session = Session::on(&fleet);
            let angle = Angle::from_raw(degrees * 100);
            let max_speed = MaxSpeed::from_raw(2_000);
            session.ask(MotorId::MIN, AbsolutePosition { max_speed, angle }).unwrap();
            fleet.world.run_for(Duration::from_secs(30));
            let log = fleet.world.log();
            let arguments = typed("--id 1 --position-rad 0 --kp 0 --kd 0 --for-s 0.1");
            let outcome = run_on(&mut session, &arguments);
            let moved = sent(&log).iter().any(|p| p.channel == Channel::Motion(MotorId::MIN));
            assert_eq!(moved, !is_beyond, "{outcome:?}");
            if is_beyond {
                let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
                let found = format!("motor 1 is at {degrees}");
                assert!(message.starts_with(&found), "{message}");
                assert!(message.contains("-12.5 to 12.5 rad"), "{message}");
            }
        }
    }
}
