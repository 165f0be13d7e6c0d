//! `myactuator stop` and `myactuator shutdown`: what must work without thinking.
//!
//! Nothing is asked, and nobody is looked for first: the command itself goes to every id, and those
//! that confirm are told. Exit status: 0 if the motor, or any motor if all are meant, has confirmed,
//! else 1.

use myactuator_protocol_core::command::{Command, Shutdown, Stop};
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::master::{MotorSet, StopKind};
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::{MotorId, Target};

use super::moving::named;
use super::session::{Motors, Session, nobody_on, say};
use crate::cli::Outcome;

/// How often ids are tried that do not confirm.
const ROUNDS: usize = 3;
/// For how long a bus that reports errors is tried again.
const LONGEST_OUTAGE: Duration = Duration::from_secs(1);
const LONGEST_IDLE: Duration = Duration::from_millis(10);

pub(super) fn stop(arguments: &Motors) -> Outcome {
    let (mut session, motors) = halt(arguments, StopKind::Hold)?;
    say(&session.stopped(motors))
}

pub(super) fn shut_down(arguments: &Motors) -> Outcome {
    let (_, motors) = halt(arguments, StopKind::Off)?;
    let are = match motors.len() {
        1 => "is off (0x80): its shaft is free unless a brake holds it",
        _ => "are off (0x80): their shafts are free unless brakes hold them",
    };
    say(&format!("{} {are}", named(motors)))
}

/// Gives the motors that have confirmed, on their bus.
fn halt(arguments: &Motors, kind: StopKind) -> Outcome<(Session, MotorSet)> {
    let mut session = Session::open_to_stop(&arguments.on)?;
    let motors = match (arguments.id, kind) {
        (Target::Motor(motor), _) => {
            session.stop(kind, motor.into())?;
            motor.into()
        }
        (Target::All, StopKind::Hold) => tell_all(&mut session, Stop)?,
        (Target::All, StopKind::Off) => tell_all(&mut session, Shutdown)?,
    };
    Ok((session, motors))
}

/// Sends a command to every id, first once to each and then again to those that were silent.
fn tell_all<C: Command + Copy>(session: &mut Session, command: C) -> Outcome<MotorSet> {
    let mut confirmed = MotorSet::EMPTY;
    for _ in 0..ROUNDS {
        for motor in once(session, MotorSet::ALL.without(confirmed), command)?.iter() {
            confirmed.insert(motor);
        }
    }
    if confirmed.is_empty() { Err(nobody_on(&session.address)) } else { Ok(confirmed) }
}

/// Sends a command once to each of these ids and gives those that have answered.
fn once<C: Command + Copy>(
    session: &mut Session,
    motors: MotorSet,
    command: C,
) -> Outcome<MotorSet> {
    let patience = session.master.master().patience(1);
    let now = session.master.now();
    let mut waiting = Vec::with_capacity(MotorId::COUNT);
    for motor in motors.iter() {
        let ticket = session.master.master().request_with(motor, command, patience);
        waiting.push((motor, ticket.map_err(myactuator_protocol_core::io::CallError::from)?));
    }
    let mut answered = MotorSet::EMPTY;
    while !waiting.is_empty() {
        let event = match session.master.poll() {
            Ok(Some(event)) => event,
            // One refused frame must not keep the others from being stopped.
            Err(error) if session.master.now() - now > LONGEST_OUTAGE => return Err(error.into()),
            Ok(None) | Err(_) => {
                let soon = session.master.now() + LONGEST_IDLE;
                session.master.idle(soon);
                continue;
            }
        };
        waiting.retain(|(motor, ticket)| match ticket.outcome(&event) {
            None => true,
            Some(outcome) => {
                if outcome.is_ok() {
                    answered.insert(*motor);
                }
                false
            }
        });
    }
    Ok(answered)
}
