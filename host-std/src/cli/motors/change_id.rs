//! `myactuator id`: another id for the only motor on a bus.

use myactuator_protocol_core::io::bring_up::{self, BringUpError};
use myactuator_protocol_core::{MotorId, Target};

use super::on_bus::OnBus;
use super::session::{Consent, Session, say};
use crate::cli::{Outcome, Unfinished, arguments as parse};

/// Give the only motor on a bus another id
///
/// Every connected motor obeys an id change, so exactly one must be connected. It keeps the id in its
/// ROM and restarts. Exit status: 0 if it answers under the new id, 1 if not, 2 for wrong usage.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Arguments {
    #[command(flatten)]
    on: OnBus,
    /// The id that it has, 1 to 32, if that is known.
    #[arg(long, value_parser = parse::motor_id, allow_hyphen_values = true)]
    id: Option<MotorId>,
    /// The id that it gets, 1 to 32.
    #[arg(long, value_parser = parse::motor_id, allow_hyphen_values = true)]
    new_id: MotorId,
    #[command(flatten)]
    consent: Consent,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let to = arguments.new_id;
    let mut session = Session::open_to_change(&arguments.on, arguments.consent)?;
    let found = session.meant(Target::All)?;
    let mut motors = found.iter();
    let (Some(motor), None) = (motors.next(), motors.next()) else {
        return Err(BringUpError::NotAlone(found).into());
    };
    if let Some(id) = arguments.id.filter(|&id| id != motor) {
        return Err(Unfinished::Failed(format!("the only motor has id {motor}, not {id}")));
    }
    if motor == to {
        return say(&format!("motor {motor} has this id already"));
    }
    session.standing(motor)?;
    session.confirm(&format!(
        "Motor {motor} will get id {to} in its ROM, and restart: hold the shaft if a load pulls at it."
    ))?;
    bring_up::change_id(&mut session.master, motor, to)?;
    say(&format!("motor {motor} is motor {to} now"))
}
