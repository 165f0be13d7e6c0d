//! Finds out which motors are there.

use crate::command::ReadStatus1;
use crate::error::RequestError;
use crate::id::MotorId;
use crate::io::asking::CallError;
use crate::io::async_runner::AsyncRunner;
use crate::io::calls::{Calls, SPOKEN_TO_EVERY};
use crate::io::keep_alive::KeptAlive;
use crate::io::on_drop::OnDrop;
use crate::io::outcome::BringUpError;
use crate::io::runner::{LONGEST_IDLE, LONGEST_STOP, LONGEST_TURN};
use crate::master::{Event, Failure, MotorSet};
use crate::time::Duration;

/// How often a motor is asked whether it is there at all.
const ATTEMPTS: u8 = 2;

/// As [`bring_up::scan`](crate::io::bring_up::scan). If this future is dropped on the way, ids that were asked keep
/// their places in the master, even those without a motor. Until these are [forgotten](crate::master::Master::forget),
/// a stop of all waits for them, and the next scan may find no free place.
pub async fn scan<R: AsyncRunner<N>, const N: usize>(
    runner: &mut R,
    candidates: MotorSet,
    on_answer: impl FnMut(MotorId, bool),
) -> Result<MotorSet, CallError<R::Error>> {
    // However this ends, a stop of all reaches the motors that were found.
    let mut scan = OnDrop::new((runner, MotorSet::EMPTY), |(runner, found): &mut (&mut R, _)| {
        runner.master().note_found(*found);
    });
    let (runner, found) = &mut scan.it;
    find(*runner, candidates, found, on_answer).await?;
    Ok(*found)
}

/// Finds out which motors are there, and leaves the master the places that it had free.
pub(super) async fn find<R: AsyncRunner<N>, const N: usize>(
    runner: &mut R,
    candidates: MotorSet,
    found: &mut MotorSet,
    on_answer: impl FnMut(MotorId, bool),
) -> Result<(), CallError<R::Error>> {
    let all = KeptAlive::new(runner, MotorSet::ALL);
    all.during(async |bus| look_for(bus, candidates, found, on_answer).await).await
}

async fn look_for<R: AsyncRunner<N>, const N: usize>(
    runner: &mut KeptAlive<'_, R>,
    candidates: MotorSet,
    found: &mut MotorSet,
    mut on_answer: impl FnMut(MotorId, bool),
) -> Result<(), CallError<R::Error>> {
    let patience = runner.master().patience(ATTEMPTS);
    let known = runner.master().motors();
    let (mut waiting, mut asked, mut left) = (candidates, MotorSet::EMPTY, MotorSet::EMPTY);
    // Why no more are asked. The answers of those that were asked are still waited for: nothing else takes back the
    // places of ids without a motor.
    let mut given_up = None;
    // Until when those answers are waited for; and until when a busy motor is waited for while no other is asked.
    let mut turn_ends = runner.now() + LONGEST_TURN;
    while !(waiting.is_empty() && asked.is_empty()) {
        for motor in waiting.iter() {
            // Known motors are asked in between: on RS485 a question that waits is before theirs.
            if runner.master().config().is_rs485() && !asked.is_empty() {
                break;
            }
            match runner.master().request_with(motor, ReadStatus1, patience) {
                Ok(_ticket) => {
                    waiting.remove(motor);
                    asked.insert(motor);
                }
                Err(RequestError::TooManyMotors { .. }) if !asked.is_empty() => break,
                // It is asked again when the request under way ends. A stop on a bus that is down may never end.
                Err(RequestError::Busy) if !asked.is_empty() || runner.now() < turn_ends => {}
                // A motor that reports on its own is there.
                Err(RequestError::Reported(_)) => {
                    waiting.remove(motor);
                    found.insert(motor);
                    on_answer(motor, true);
                }
                Err(refusal) => return Err(CallError::Refused { motor, refusal }),
            }
        }
        let soon = runner.now() + LONGEST_IDLE;
        let outcome = runner.run(Some(soon)).await;
        if given_up.is_none() && !asked.is_empty() {
            turn_ends = runner.now() + LONGEST_TURN;
        }
        let event = match outcome {
            Ok(event) => event,
            Err(error) => {
                given_up.get_or_insert(CallError::Bus(error));
                None
            }
        };
        match event {
            Some(Event::Failed { ticket, failure })
                if failure == Failure::BusDown || is_stop(failure) =>
            {
                given_up.get_or_insert(CallError::Failed { motor: ticket.motor(), failure });
            }
            _ => {}
        }
        if given_up.is_some() {
            waiting = MotorSet::EMPTY;
            if turn_ends <= runner.now() {
                break;
            }
        }
        let Some(event) = event else { continue };
        let (motor, there) = match event {
            Event::Reply { ticket, .. } => (ticket.motor(), true),
            Event::Failed { ticket, failure } => (ticket.motor(), shows_motor(failure)),
            // Whatever it says: a motor that reports on its own may answer nothing.
            Event::Report { motor, .. }
            | Event::LostMaster { motor }
            | Event::Stray { motor, .. } => (motor, true),
            _ => continue,
        };
        if there && candidates.contains(motor) {
            found.insert(motor);
        }
        if matches!(event, Event::Reply { .. } | Event::Failed { .. }) && asked.contains(motor) {
            asked.remove(motor);
            if !known.contains(motor) && !runner.master().forget(motor) {
                left.insert(motor);
            }
            if there || given_up.is_none() {
                on_answer(motor, found.contains(motor));
            }
        }
    }
    forget_silent_ones(runner, left).await;
    given_up.map_or(Ok(()), Err)
}

/// Takes the places back of those of these motors that were never heard. A stop that was called for meanwhile goes to
/// them, too, and is waited for: one of them may be there all the same.
pub(super) async fn forget_silent_ones<R: AsyncRunner<N> + ?Sized, const N: usize>(
    runner: &mut R,
    motors: MotorSet,
) {
    let end = runner.now() + LONGEST_STOP;
    loop {
        let master = runner.master();
        let is_silent = |&motor: &MotorId| master.health(motor).last_seen.is_none();
        let known = master.motors().iter().filter(|&motor| motors.contains(motor));
        let silent: MotorSet = known.filter(is_silent).collect();
        let left: MotorSet = silent.iter().filter(|motor| !master.forget(*motor)).collect();
        let now = runner.now();
        if left.is_empty() || now >= end {
            return;
        }
        let _ = runner.run(Some(now + LONGEST_IDLE)).await;
    }
}

/// Whether a motor that was asked in vain is there: it has said something.
fn shows_motor(failure: Failure) -> bool {
    matches!(failure, Failure::Unreadable(_) | Failure::NotExecuted)
}

/// Whether a stop took the place of the question, which says nothing about the motor.
fn is_stop(failure: Failure) -> bool {
    matches!(failure, Failure::Stopped | Failure::StopUnconfirmed)
}

/// As [`bring_up::is_there`](crate::io::bring_up::is_there).
pub async fn is_there<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<bool, CallError<B::Error>> {
    bus.is_there(motor).await
}

/// Whether anything answers under this id, which keeps its place in the master.
pub(super) async fn answers<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<bool, CallError<B::Error>> {
    match bus.ask_often(motor, ReadStatus1, Some(ATTEMPTS)).await {
        Ok(_) | Err(CallError::Refused { refusal: RequestError::Reported(_), .. }) => Ok(true),
        Err(CallError::Failed { failure, .. }) if !is_stop(failure) => Ok(shows_motor(failure)),
        Err(error) => Err(error),
    }
}

/// As [`bring_up::wait_until_there`](crate::io::bring_up::wait_until_there).
pub async fn wait_until_there<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    time: Duration,
) -> Result<(), BringUpError<B::Error>> {
    let deadline = bus.now() + time;
    loop {
        let asked_at = bus.now();
        let answer = bus.is_there(motor).await;
        let answered_at = bus.now();
        match answer {
            Ok(true) => return Ok(()),
            Ok(false) if asked_at >= deadline => return Err(BringUpError::NotThere(motor)),
            Ok(false) => {}
            // Another question to it waits until it has had the time to restart.
            Err(CallError::Refused { refusal: RequestError::Busy, .. })
                if answered_at < deadline => {}
            // A stop went to it instead.
            Err(CallError::Failed { failure, .. })
                if is_stop(failure) && answered_at < deadline => {}
            // It has not confirmed an earlier stop either.
            Err(CallError::Failed { failure: Failure::StopUnconfirmed, .. }) => {
                return Err(BringUpError::NotThere(motor));
            }
            Err(error) => return Err(error.into()),
        }
        // On a bus that takes nothing the outcome comes at once.
        bus.wait_until(answered_at + SPOKEN_TO_EVERY).await?;
    }
}
