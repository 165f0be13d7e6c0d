//! `myactuator motion`: one set-point of motion (MIT) mode, for a while.

use myactuator_host_std::BusKind;
use myactuator_protocol_core::command::{
    MotionRanges, MotionSetPoint, ReadVersionDate, check_on_rs485,
};
use myactuator_protocol_core::master::StopKind;
use myactuator_protocol_core::{Firmware, Opcode};

use super::run_for::{self, Run, Span};
use super::session::{Outcome, Session, Unfinished};
use crate::cli::arguments as parse;

/// Run a motor in motion (MIT) mode at one set-point for a while, then stop it (0x81); CAN only
///
/// A locked brake is released first and stays open, for the motor holds still at the end. Ctrl-C and
/// errors stop the motor (0x81) at once. Exit status: 0 if it has run, 1 if not, 2 for wrong usage,
/// 130 if interrupted.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Arguments {
    #[command(flatten)]
    span: Span,
    /// Wanted position, rad.
    #[arg(long, allow_hyphen_values = true)]
    position_rad: f32,
    /// Wanted velocity, rad/s.
    #[arg(long, allow_hyphen_values = true, default_value_t = 0.0)]
    velocity_rad_s: f32,
    /// Gain on the position error, N·m/rad.
    #[arg(long, allow_hyphen_values = true)]
    kp: f32,
    /// Gain on the velocity error, N·m·s/rad.
    #[arg(long, allow_hyphen_values = true)]
    kd: f32,
    /// Torque added to both, N·m.
    #[arg(long, allow_hyphen_values = true, default_value_t = 0.0)]
    torque_nm: f32,
    /// The revision of the protocol that the motor speaks, such as v4.3, where its version date (0xB2)
    /// does not lead to it.
    #[arg(long, value_parser = parse::firmware)]
    firmware: Option<Firmware>,
    /// The scales of its motion mode: the largest position, velocity, kp, kd and torque, as in
    /// 12.5,45,500,5,24. Wrong ones multiply the torque.
    #[arg(long, value_parser = parse::ranges)]
    ranges: Option<MotionRanges>,
}

/// The scales that were given, or those of the firmware, for which the motor is asked. They are never
/// guessed: V4.3's sent to a V4.4 have given 2.5 times the torque.
fn scales(arguments: &Arguments, session: &mut Session) -> Outcome<MotionRanges> {
    let motor = arguments.span.motor.id;
    if let Some(ranges) = arguments.ranges {
        return Ok(ranges);
    }
    let firmware = match arguments.firmware {
        Some(firmware) => firmware,
        None => {
            let date = session.ask(motor, ReadVersionDate)?.version_date;
            Firmware::of_version_date(date).ok_or_else(|| {
                Unfinished::Failed(format!(
                    "motor {motor} reports version date {}, and which firmware that is, is not known: \
                     wrong scales multiply its torque, so nothing was sent; give --firmware v4.3 if \
                     its manual says so, or its own scales by --ranges",
                    date.raw()
                ))
            })?
        }
    };
    firmware.motion_ranges().ok_or_else(|| {
        Unfinished::Failed(format!(
            "the scales of motion mode of firmware {firmware} depend on the motor: give them by --ranges"
        ))
    })
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    if arguments.span.motor.on.bus.kind() == BusKind::Rs485 {
        check_on_rs485(Opcode::Motion.into())
            .map_err(|error| Unfinished::Usage(format!("--bus: {error}")))?;
    }
    let set_point = MotionSetPoint {
        position_rad: arguments.position_rad,
        velocity_rad_s: arguments.velocity_rad_s,
        kp: arguments.kp,
        kd: arguments.kd,
        torque_nm: arguments.torque_nm,
    };
    let mut session = arguments.span.motor.open_to_change()?;
    let ranges = scales(arguments, &mut session)?;
    let command =
        ranges.quantise(&set_point).map_err(|error| Unfinished::Usage(error.to_string()))?;
    let run = Run {
        command,
        does: format!(
            "run in motion mode to {} rad at {} rad/s (kp {}, kd {}, {} N·m)",
            arguments.position_rad,
            arguments.velocity_rad_s,
            arguments.kp,
            arguments.kd,
            arguments.torque_nm
        ),
        needs_open_brake: true,
        end: StopKind::Hold,
    };
    run_for::run(&mut session, &arguments.span, &run, |raw| {
        let feedback = ranges.feedback(raw);
        format!(
            "{:8.3} rad {:8.3} rad/s {:8.3} N·m",
            feedback.position_rad, feedback.velocity_rad_s, feedback.torque_nm
        )
    })
}
