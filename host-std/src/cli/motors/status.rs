//! `myactuator status`: how motors do.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{
    ReadMultiTurnAngle, ReadRunningMode, ReadStatus1, ReadStatus2, ReadStatus3,
};

use super::group::Group;
use super::session::{Motors, Session, say};
use crate::cli::{Outcome, Unfinished, tell};

/// Exit status: 0 if every motor was read, else 1.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Arguments {
    #[command(flatten)]
    motors: Motors,
    /// Print one JSON object a motor.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    tell_each(arguments, read)
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
    arguments: &Arguments,
    read: impl Fn(&mut Session, MotorId) -> Outcome<Vec<Group>>,
) -> Outcome {
    let mut session = Session::open(&arguments.motors.on)?;
    let mut outcome = Ok(());
    for motor in session.meant(arguments.motors.id)?.iter() {
        match read(&mut session, motor) {
            Ok(groups) if arguments.json => say(&session.json(motor, &groups))?,
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
