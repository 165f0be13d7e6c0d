//! `myactuator info`: what motors are. `myactuator status`: their present state.

use std::iter;

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{
    Model, ReadMultiTurnAngle, ReadMultiTurnEncoderOffset, ReadRunningMode, ReadStatus1,
    ReadStatus2, ReadStatus3, RunTime, RunningMode, Version,
};
use myactuator_protocol_core::io::bring_up;

use super::group::Group;
use super::session::{Motors, Session, say};
use crate::cli::{Outcome, Unfinished, report};

/// Which motors, and how they are printed.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Arguments {
    #[command(flatten)]
    motors: Motors,
    /// Print one JSON object a motor.
    #[arg(long)]
    json: bool,
}

pub(super) fn info(arguments: &Arguments) -> Outcome {
    print_each(arguments, what_it_is)
}

pub(super) fn status(arguments: &Arguments) -> Outcome {
    print_each(arguments, how_it_does)
}

fn what_it_is(session: &mut Session, motor: MotorId) -> Outcome<Vec<Group>> {
    let is = bring_up::identify(&mut session.master, motor)?;
    let zero = session.ask(motor, ReadMultiTurnEncoderOffset)?;
    let model = is.model.map_or(Group::default(), |model| Group::default().and(&Model { model }));
    let made = model.and(&Version { version_date: is.version });
    let runs = Group::default()
        .and(&RunTime { run_time: is.run_time })
        .and_mode(&RunningMode { mode: is.mode })
        .and(&zero);
    Ok(vec![made, runs, Group::default().and(&is.status)])
}

fn how_it_does(session: &mut Session, motor: MotorId) -> Outcome<Vec<Group>> {
    let feedback = session.ask(motor, ReadStatus2)?;
    let mode = session.ask(motor, ReadRunningMode)?;
    let phases = session.ask(motor, ReadStatus3)?;
    let state = session.ask(motor, ReadStatus1)?;
    let angle = session.ask(motor, ReadMultiTurnAngle)?;
    // The finer angle replaces the feedback's, and status 1 also has the temperature.
    let moves =
        Group::default().and(&angle).and_but(&feedback, &["angle", "temperature"]).and_mode(&mode);
    let phases = Group::default().and_but(&phases, &["temperature"]);
    Ok(vec![moves, phases, Group::default().and(&state)])
}

/// Reads each motor that is meant, and prints its groups of fields: a line each, or one object.
fn print_each(
    arguments: &Arguments,
    read: impl Fn(&mut Session, MotorId) -> Outcome<Vec<Group>>,
) -> Outcome {
    let mut session = Session::open(&arguments.motors.on)?;
    let mut outcome = Ok(());
    for motor in session.meant(arguments.motors.id)?.iter() {
        match read(&mut session, motor) {
            Ok(groups) => {
                let lines = described(&mut session, motor, groups, arguments.json);
                lines.iter().try_for_each(|line| say(line))?;
            }
            // The other motors are still read.
            Err(Unfinished::Failed(sentence)) => {
                report("error", sentence);
                outcome = Err(Unfinished::FailedAndReported);
            }
            Err(other) => return Err(other),
        }
    }
    outcome
}

/// The lines about what was read of a motor, or its object. Reads of two motors with one id may be of either.
fn described(
    session: &mut Session,
    motor: MotorId,
    groups: Vec<Group>,
    as_json: bool,
) -> Vec<String> {
    let note = session.note_shared(motor);
    if as_json {
        return vec![session.json(motor, &groups, note).to_string()];
    }
    let lines = groups.iter().map(|group| format!("  {group}"));
    iter::once(format!("motor {motor}")).chain(lines).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use myactuator_host_std::sim::Fleet;

    #[test]
    fn json_carries_the_note_that_what_was_read_may_be_of_either_of_two_motors() {
        let note = |fleet: Fleet| {
            let fleet = fleet.on_can(1_000_000).unwrap();
            let session = &mut Session::on(&fleet);
            let groups = how_it_does(session, MotorId::MIN).unwrap();
            let object = described(session, MotorId::MIN, groups, true);
            serde_json::from_str::<serde_json::Value>(&object[0]).unwrap().get("note").cloned()
        };
        let told = "two motors seem to have id 1: connect only one of them";
        assert_eq!(note(Fleet::new(2).all_with_id(MotorId::MIN)), Some(told.into()));
        assert_eq!(note(Fleet::new(1)), None);
    }
}
