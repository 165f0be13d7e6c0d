//! `myactuator motion`: one set-point of motion (MIT) mode, for a while.

use std::str::FromStr;

use myactuator_host_std::BusKind;
use myactuator_protocol_core::Opcode;
use myactuator_protocol_core::command::{
    MotionLimits, MotionRanges, MotionSetPoint, check_on_rs485,
};
use myactuator_protocol_core::master::StopKind;

use super::run_for::{self, Run, Span};
use super::session::{Outcome, Unfinished};
use crate::cli::tell;

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
    /// The scales of the motor's firmware: v4.3, or the largest position, velocity, kp, kd and torque
    /// as in 12.5,45,500,5,24. Wrong ones multiply the torque [default: v4.3].
    #[arg(long, value_parser = ranges)]
    ranges: Option<MotionRanges>,
}

const V4_3: &str = "v4.3";

fn ranges(text: &str) -> Result<MotionRanges, String> {
    if text.eq_ignore_ascii_case(V4_3) {
        return Ok(MotionRanges::V4_3);
    }
    let numbers: Result<Vec<f32>, _> = text.split(',').map(f32::from_str).collect();
    match numbers.as_deref() {
        Ok(&[position_rad, velocity_rad_s, kp, kd, torque_nm]) => {
            MotionRanges::new(MotionLimits { position_rad, velocity_rad_s, kp, kd, torque_nm })
                .map_err(|error| error.to_string())
        }
        _ => Err(format!(
            "expected {V4_3} or five numbers such as 12.5,45,500,5,24, found \"{text}\""
        )),
    }
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    if arguments.span.on.bus.kind() == BusKind::Rs485 {
        check_on_rs485(Opcode::Motion)
            .map_err(|error| Unfinished::Usage(format!("--bus: {error}")))?;
    }
    let set_point = MotionSetPoint {
        position_rad: arguments.position_rad,
        velocity_rad_s: arguments.velocity_rad_s,
        kp: arguments.kp,
        kd: arguments.kd,
        torque_nm: arguments.torque_nm,
    };
    let ranges = arguments.ranges.unwrap_or(MotionRanges::V4_3);
    let command =
        ranges.quantise(&set_point).map_err(|error| Unfinished::Usage(error.to_string()))?;
    if arguments.ranges.is_none() {
        tell(
            "motion ranges",
            "those of protocol V4.3 are taken; on other firmware they multiply the torque, so tell its own by --ranges",
        );
    }
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
    run_for::run(&arguments.span, &run, |raw| {
        let feedback = ranges.feedback(raw);
        format!(
            "{:8.3} rad {:8.3} rad/s {:8.3} N·m",
            feedback.position_rad, feedback.velocity_rad_s, feedback.torque_nm
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_named_or_told_number_by_number() {
        assert_eq!(ranges("V4.3"), Ok(MotionRanges::V4_3));
        assert_eq!(ranges("12.5,45,500,5,24"), Ok(MotionRanges::V4_3));
        assert_ne!(ranges("12.566,45,500,5,60"), Ok(MotionRanges::V4_3));
        let told = ranges("12.5,45").unwrap_err();
        assert_eq!(
            told,
            "expected v4.3 or five numbers such as 12.5,45,500,5,24, found \"12.5,45\""
        );
        assert!(ranges("12.5,45,500,5,-24").is_err());
    }
}
