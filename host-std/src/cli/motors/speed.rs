//! `myactuator speed`: turning at a speed, for a while.

use myactuator_protocol_core::Opcode;
use myactuator_protocol_core::command::{self as c, Feedback};
use myactuator_protocol_core::master::StopKind;
use myactuator_protocol_core::units::{MaxTorque, SpeedTarget};

use super::help::{HOLDS, SIGNALS, STOPS, paragraphs};
use super::run_for::{self, Run, Span};
use crate::cli::{Outcome, arguments as parse};

/// Turn a motor at a speed for a while, then stop it: it holds still (0x81)
///
/// Ctrl-C and errors stop it (0x81) at once.
///
/// Exit status: 0 has run, 1 not, 2 wrong usage.
#[derive(Debug, clap::Args)]
#[command(after_help = paragraphs([STOPS, SIGNALS, HOLDS]))]
pub(in crate::cli) struct Arguments {
    #[command(flatten)]
    span: Span,
    /// The speed of the output shaft, degrees per second.
    #[arg(long, value_parser = parse::speed, allow_hyphen_values = true)]
    speed_dps: SpeedTarget,
    /// The largest torque, % of the rated current; 0 for no limit but the stall current.
    #[arg(long, value_parser = parse::max_torque, allow_hyphen_values = true, default_value = "0")]
    max_torque_pct: MaxTorque,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let (speed, max_torque) = (arguments.speed_dps, arguments.max_torque_pct);
    let torque = match max_torque.raw() {
        0 => " with no limit of torque".to_owned(),
        _ => format!(" with at most {max_torque}"),
    };
    let run = Run {
        command: c::Speed { max_torque, speed },
        does: format!("turn at {speed}{torque}"),
        needs_open_brake: false,
        end: StopKind::Hold,
    };
    let session = &mut arguments.span.motor.open_to_send(Opcode::Speed)?;
    run_for::run(session, &arguments.span, &run, |_| Ok(()), told)
}

/// Angle, speed and current in columns.
pub(super) fn told(feedback: &Feedback) -> String {
    let Feedback { angle, speed, current, .. } = feedback;
    format!("{:>10} {:>9} {:>9}", angle.to_string(), speed.to_string(), current.to_string())
}
