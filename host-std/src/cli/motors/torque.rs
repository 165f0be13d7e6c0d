//! `myactuator torque`: running at a torque current, for a while.

use myactuator_protocol_core::Opcode;
use myactuator_protocol_core::command as c;
use myactuator_protocol_core::master::StopKind;
use myactuator_protocol_core::units::Current;

use super::help::{HOLDS, SIGNALS, STOPS, paragraphs};
use super::run_for::{self, Run, Span};
use super::speed::told;
use crate::cli::{Outcome, arguments as parse};

/// Run a motor at a torque current for a while, then stop it (0x81), lock its brake (0x78) and switch it off (0x80)
///
/// A locked brake is released first. A motor that ran something before, or that has no brake, is not switched off at
/// the end: it holds still (0x81), so that no load falls.
///
/// Nothing limits the speed. Ctrl-C and errors stop the motor (0x81) at once: it holds still, with its brake open.
///
/// Exit status: 0 has run, 1 not, 2 wrong usage.
#[derive(Debug, clap::Args)]
#[command(after_help = paragraphs([STOPS, SIGNALS, HOLDS]))]
pub(in crate::cli) struct Arguments {
    #[command(flatten)]
    span: Span,
    /// The torque current, A.
    #[arg(long, value_parser = parse::current, allow_hyphen_values = true)]
    current_a: Current,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let current = arguments.current_a;
    let run = Run {
        command: c::Torque { current },
        does: format!("run at {current} without a limit of speed"),
        needs_open_brake: true,
        end: StopKind::Off,
    };
    let session = &mut arguments.span.motor.open_to_send(Opcode::Torque)?;
    run_for::run(session, &arguments.span, &run, |_| Ok(()), told)
}
