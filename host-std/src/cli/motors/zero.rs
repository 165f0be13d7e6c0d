//! `myactuator zero`: the present position becomes the zero, and stays it.

use myactuator_protocol_core::command::ReadMultiTurnAngle;
use myactuator_protocol_core::io::bring_up;

use super::session::{OneMotor, say};
use crate::cli::Outcome;

/// Make a motor's present position its zero, and check that it is kept
///
/// The motor is switched off (0x80), stores its position as zero in its ROM (0x64) and restarts
/// (0x76); then zero and angle are read back. Exit status: 0 if the zero is kept, 1 if not, 2 for
/// wrong usage.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Arguments {
    #[command(flatten)]
    motor: OneMotor,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let motor = arguments.motor.id;
    let mut session = arguments.motor.open_to_change()?;
    session.standing(motor)?;
    let before = session.ask(motor, ReadMultiTurnAngle)?.angle;
    session.confirm(&format!(
        "Motor {motor} will be switched off, make its present position ({before}) the zero in its ROM, and restart: hold the shaft if a load pulls at it."
    ))?;
    // It may have been turned while the user was asked.
    let before = session.ask(motor, ReadMultiTurnAngle)?.angle;
    let offset = bring_up::zero_here(&mut session.master, motor)?;
    let after = session.ask(motor, ReadMultiTurnAngle)?.angle;
    say(&format!(
        "motor {motor}: what was {before} is the zero (offset {offset}); after its restart the motor reads {after}"
    ))
}
