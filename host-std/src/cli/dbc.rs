//! `myactuator dbc`: the table of commands for other makers' tools.

use std::io::{self, Write};

use myactuator_host_std::explain::Dbc;
use myactuator_host_std::protocol::MotorId;

use super::Outcome;
use super::arguments::{self as parse, Revision};

/// Print a DBC file, with which other tools decode the CAN frames of these motors
///
/// Signals are multiplexed by the command byte. They are named after command, field and unit, such as
/// absolute_position_angle_deg.
///
/// Exit status: 0 printed, 2 wrong usage.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Write the file for this motor only, 1 to 32 [default: all motors].
    #[arg(long, value_parser = parse::motor_id, allow_hyphen_values = true)]
    id: Option<MotorId>,
    #[command(flatten)]
    revision: Revision,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let Arguments { id, revision } = arguments;
    let file = Dbc { firmware: revision.firmware, ranges: revision.motion_ranges(), motor: *id };
    Ok(io::stdout().lock().write_all(file.to_string().as_bytes())?)
}
