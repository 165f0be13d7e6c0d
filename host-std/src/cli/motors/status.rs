//! `myactuator info`: what motors are. `myactuator status`: their present state.

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
            Ok(groups) if arguments.json => say(&session.json(motor, &groups).to_string())?,
            Ok(groups) => {
                say(&format!("motor {motor}"))?;
                for group in groups {
                    say(&format!("  {group}"))?;
                }
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
