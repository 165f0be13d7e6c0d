//! `myactuator brake`: the holding brake, by hand.

use clap::ValueEnum;
use myactuator_protocol_core::command::{BrakeCommand, LockBrake, ReadStatus1};
use myactuator_protocol_core::io::bring_up;

use super::session::{OneMotor, Session, say};
use crate::cli::{Outcome, Unfinished};

/// Release or lock a motor's brake
///
/// A turning motor's brake is not locked: stop the motor first. Exit status: 0 if the motor says that
/// its brake was told so, 1 if not, 2 for wrong usage.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Arguments {
    /// What to do with it.
    #[arg(value_enum)]
    action: Action,
    #[command(flatten)]
    motor: OneMotor,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Action {
    /// Let the shaft go (0x77): a load can turn it then.
    Release,
    /// Hold the shaft (0x78).
    Lock,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let motor = arguments.motor.id;
    match arguments.action {
        Action::Release => {
            let mut session = arguments.motor.open_to_change()?;
            session.ask(motor, ReadStatus1)?;
            session.confirm(&format!(
                "Motor {motor}'s brake will let the shaft go: a load can turn it then."
            ))?;
            bring_up::release_brake(&mut session.master, motor)?;
            say(&format!("motor {motor}: brake released"))
        }
        Action::Lock => {
            let mut session = Session::open_to_stop(&arguments.motor.on)?;
            session.standing(motor)?;
            session.ask(motor, LockBrake)?;
            match session.ask(motor, ReadStatus1)?.brake {
                BrakeCommand::LOCK => say(&format!("motor {motor}: brake locked")),
                other => Err(Unfinished::Failed(format!(
                    "motor {motor}: the brake was told to lock and says {other}"
                ))),
            }
        }
    }
}
