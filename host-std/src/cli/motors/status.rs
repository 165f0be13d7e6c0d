//! `myactuator status`: how motors do.

use myactuator_protocol_core::command::{
    ReadMultiTurnAngle, ReadRunningMode, ReadStatus1, ReadStatus2, ReadStatus3,
};
use myactuator_protocol_core::{MotorId, Target};
use serde_json::{Value, json};

use super::group::Group;
use super::session::{OnBus, Outcome, Session, Unfinished, say};
use crate::cli::{arguments as parse, tell};

/// Tell how motors do: angle, speed, currents, temperatures, voltage, brake and errors
///
/// Exit status: 0 if every motor was read, else 1.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Arguments {
    #[command(flatten)]
    on: OnBus,
    /// The motor, 1 to 32, or all that answer.
    #[arg(long, value_parser = parse::target, allow_hyphen_values = true, default_value = "all")]
    id: Target,
    /// Print one JSON object a motor.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let mut session = Session::open(&arguments.on)?;
    tell_each(&mut session, arguments.id, arguments.json, read)
}

fn read(session: &mut Session, motor: MotorId) -> Outcome<Vec<Group>> {
    let feedback = session.ask(motor, ReadStatus2)?;
    let mode = session.ask(motor, ReadRunningMode)?;
    let phases = session.ask(motor, ReadStatus3)?;
    let state = session.ask(motor, ReadStatus1)?;
    let angle = session.ask(motor, ReadMultiTurnAngle)?;
    // The finer angle takes the place of the feedback's, and status 1 has the temperature too.
    let moves =
        Group::default().and(&angle).and_but(&feedback, &["angle", "temperature"]).and(&mode);
    let phases = Group::default().and_but(&phases, &["temperature"]);
    Ok(vec![moves, phases, Group::default().and(&state)])
}

/// Reads each motor that is meant, and tells it in groups of fields: a line each, or one object.
pub(super) fn tell_each(
    session: &mut Session,
    target: Target,
    as_json: bool,
    read: impl Fn(&mut Session, MotorId) -> Outcome<Vec<Group>>,
) -> Outcome {
    let mut outcome = Ok(());
    for motor in session.meant(target)?.iter() {
        match read(session, motor) {
            Ok(groups) if as_json => {
                let mut object = json!({ "bus": session.address.to_string(), "id": motor.get() });
                if let Value::Object(object) = &mut object {
                    object.extend(groups.iter().flat_map(Group::values));
                }
                say(&object.to_string())?;
            }
            Ok(groups) => {
                say(&format!("motor {motor}"))?;
                for group in groups {
                    say(&format!("  {group}"))?;
                }
            }
            // The others are told all the same.
            Err(Unfinished::Failed(sentence)) => {
                tell("error", sentence);
                outcome = Err(Unfinished::FailedAndTold);
            }
            Err(other) => return Err(other),
        }
    }
    outcome
}
