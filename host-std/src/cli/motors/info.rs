//! `myactuator info`: what motors are.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{
    Model, ReadMultiTurnEncoderOffset, RunTime, RunningMode, Version,
};
use myactuator_protocol_core::io::bring_up;

use super::group::Group;
use super::session::Session;
use super::status::{Arguments, tell_each};
use crate::cli::{Outcome, Unfinished};

pub(super) fn run(arguments: &Arguments) -> Outcome {
    tell_each(arguments, read)
}

fn read(session: &mut Session, motor: MotorId) -> Outcome<Vec<Group>> {
    let is = bring_up::identify(&mut session.master, motor).map_err(Unfinished::of_motor(motor))?;
    let zero = session.ask(motor, ReadMultiTurnEncoderOffset)?;
    let model = is.model.map_or(Group::default(), |model| Group::default().and(&Model { model }));
    let made = model.and(&Version { version_date: is.version });
    let runs = Group::default()
        .and(&RunTime { run_time: is.run_time })
        .and(&RunningMode { mode: is.mode })
        .and(&zero);
    Ok(vec![made, runs, Group::default().and(&is.status)])
}
