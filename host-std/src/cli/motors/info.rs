//! `myactuator info`: what motors are.

use myactuator_protocol_core::command::{
    Model, ReadMultiTurnEncoderOffset, RunTime, RunningMode, Version,
};
use myactuator_protocol_core::io::bring_up;
use myactuator_protocol_core::{MotorId, Target};

use super::group::Group;
use super::session::{OnBus, Outcome, Session, Unfinished};
use super::status::tell_each;
use crate::cli::arguments as parse;

/// Tell what motors are: model, software, run time, mode, state and zero
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
    let is = bring_up::identify(&mut session.master, motor).map_err(Unfinished::of_motor(motor))?;
    let zero = session.ask(motor, ReadMultiTurnEncoderOffset)?;
    let made =
        Group::default().and(&Model { model: is.model }).and(&Version { version_date: is.version });
    let runs = Group::default()
        .and(&RunTime { run_time: is.run_time })
        .and(&RunningMode { mode: is.mode })
        .and(&zero);
    Ok(vec![made, runs, Group::default().and(&is.status)])
}
