//! First contact and safe ways of working over any [`AsyncRunner`]: [`bring_up`](crate::io::bring_up) for
//! tasks, whose functions run these.
//!
//! A future of these that is dropped leaves off where it is: a motor may have been given its new id and
//! not have been restarted. Those that move a motor or open its brake put a stop then.

use crate::command::{
    CommunicationLossProtection, LockBrake, ReadModel, ReadMultiTurnAngle,
    ReadMultiTurnEncoderOffset, ReadRunTime, ReadRunningMode, ReadStatus1, ReadVersionDate, Reset,
    SetCurrentPositionZero,
};
use crate::error::RequestError;
use crate::id::MotorId;
use crate::io::asking::CallError;
use crate::io::async_runner::AsyncRunner;
use crate::io::brake::{BRAKE_MOVES, SPOKEN_TO_EVERY, switch_off};
pub use crate::io::brake::{check_brake, lock_brake, release_brake};
use crate::io::bring_up::{BringUpError, Identity, Protection};
pub use crate::io::calls::Calls;
pub use crate::io::change_id::{change_id, is_shared};
pub use crate::io::move_to::move_to;
use crate::io::on_drop::OnDrop;
use crate::io::runner::{LONGEST_IDLE, LONGEST_TURN};
use crate::io::standing::check_stands;
use crate::master::{Event, Failure, MotorSet};
use crate::time::{Duration, Instant};
use crate::units::{EncoderPulses, Milliseconds};

/// How often a motor is asked whether it is there at all.
const ATTEMPTS: u8 = 2;
/// How often a drive is told to restart that goes on running.
const RESTARTS: u8 = 3;
/// How long a motor is asked whether it is there that is to restart: a line may be out for as long.
const LONGEST_SILENCE: Duration = Duration::from_millis(200);
/// How far a new zero may be from 0 after a restart, 0.01 degrees: the shaft may settle meanwhile.
const ZERO_TOLERANCE: i32 = 100;

/// As [`bring_up::scan`](crate::io::bring_up::scan). If this future is dropped on the way, ids that were asked keep
/// their places in the master, also those without a motor: a stop of all waits for them, and the next scan may find no
/// place free, until they are [forgotten](crate::master::Master::forget).
pub async fn scan<R: AsyncRunner<N>, const N: usize>(
    runner: &mut R,
    candidates: MotorSet,
    on_answer: impl FnMut(MotorId, bool),
) -> Result<MotorSet, CallError<R::Error>> {
    // However this ends.
    let mut scan = OnDrop::new((runner, MotorSet::EMPTY), |(runner, found): &mut (&mut R, _)| {
        runner.master().note_found(*found);
    });
    let (runner, found) = &mut scan.it;
    find(*runner, candidates, found, on_answer).await?;
    Ok(*found)
}

/// Finds out who is there, and leaves the master the places that it had free.
pub(super) async fn find<R: AsyncRunner<N>, const N: usize>(
    runner: &mut R,
    candidates: MotorSet,
    found: &mut MotorSet,
    mut on_answer: impl FnMut(MotorId, bool),
) -> Result<(), CallError<R::Error>> {
    let patience = runner.master().patience(ATTEMPTS);
    let known = runner.master().motors();
    let (mut waiting, mut asked) = (candidates, MotorSet::EMPTY);
    // Why no more are asked. The answers of who was asked are waited for all the same: nobody else takes back the places
    // of ids without a motor.
    let mut given_up = None;
    // Until when, and until when somebody who is busy is waited for while nobody is asked.
    let mut turn_ends = runner.now() + LONGEST_TURN;
    while !(waiting.is_empty() && asked.is_empty()) {
        for motor in waiting.iter() {
            match runner.master().request_with(motor, ReadStatus1, patience) {
                Ok(_ticket) => {
                    waiting.remove(motor);
                    asked.insert(motor);
                }
                Err(RequestError::TooManyMotors { .. }) if !asked.is_empty() => break,
                // It is asked again when the request under way is over. A stop on a bus that is down may never be.
                Err(RequestError::Busy) if !asked.is_empty() || runner.now() < turn_ends => {}
                // What reports by itself is there.
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
                runner.master().poll_event()
            }
        };
        if let Some(Event::Failed { ticket, failure: failure @ Failure::BusDown }) = event {
            given_up.get_or_insert(CallError::Failed { motor: ticket.motor(), failure });
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
            // Whatever it says: one that reports by itself may answer nothing.
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
            if !known.contains(motor) {
                runner.master().forget(motor);
            }
            if there || given_up.is_none() {
                on_answer(motor, found.contains(motor));
            }
        }
    }
    given_up.map_or(Ok(()), Err)
}

/// Whether there is a motor that was asked in vain: it has said something.
fn shows_motor(failure: Failure) -> bool {
    matches!(failure, Failure::Unreadable(_) | Failure::NotExecuted)
}

/// As [`bring_up::identify`](crate::io::bring_up::identify).
pub async fn identify<R: AsyncRunner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
) -> Result<Identity, CallError<R::Error>> {
    let model = match runner.ask(motor, ReadModel).await {
        Ok(reply) => Some(reply.model),
        Err(CallError::Failed { failure: Failure::NoReply, .. }) => None,
        Err(error) => return Err(error),
    };
    Ok(Identity {
        model,
        version: runner.ask(motor, ReadVersionDate).await?.version_date,
        run_time: runner.ask(motor, ReadRunTime).await?.run_time,
        mode: runner.ask(motor, ReadRunningMode).await?.mode,
        status: runner.ask(motor, ReadStatus1).await?,
    })
}

/// As [`bring_up::is_there`](crate::io::bring_up::is_there).
pub async fn is_there<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<bool, CallError<B::Error>> {
    bus.is_there(motor).await
}

/// The same, of one that keeps its place.
pub(super) async fn answers<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<bool, CallError<B::Error>> {
    match bus.ask_often(motor, ReadStatus1, Some(ATTEMPTS)).await {
        Ok(_) | Err(CallError::Refused { refusal: RequestError::Reported(_), .. }) => Ok(true),
        Err(CallError::Failed { failure, .. }) => Ok(shows_motor(failure)),
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
    while !bus.is_there(motor).await? {
        let now = bus.now();
        if now >= deadline {
            return Err(BringUpError::NotThere(motor));
        }
        // A bus that takes nothing answers at once.
        bus.wait_until(now + SPOKEN_TO_EVERY).await?;
    }
    Ok(())
}

/// Refuses what a stop refuses, before a motor that it holds is switched off.
pub(super) fn check_not_stopped<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<(), CallError<B::Error>> {
    match bus.may_move(motor) {
        Err(refusal @ RequestError::Stopped) => Err(CallError::Refused { motor, refusal }),
        _ => Ok(()),
    }
}

/// As [`bring_up::zero_here`](crate::io::bring_up::zero_here).
pub async fn zero_here<R: AsyncRunner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
) -> Result<EncoderPulses, BringUpError<R::Error>> {
    check_not_stopped(runner, motor)?;
    check_stands(runner, motor).await?;
    switch_off(runner, motor).await?;
    let stored = match runner.ask(motor, SetCurrentPositionZero).await {
        Ok(reply) => reply.offset,
        Err(refused @ CallError::Refused { .. }) => return Err(refused.into()),
        Err(why) => return Err(BringUpError::MayBeWritten { motor, why }),
    };
    keeps_zero(runner, motor, stored).await.map_err(may_be_written(motor))
}

/// What a drive was told to write may be in its ROM, whatever has come then.
pub(super) fn may_be_written<E>(motor: MotorId) -> impl Fn(BringUpError<E>) -> BringUpError<E> {
    move |error| match error {
        BringUpError::Call(why) => BringUpError::MayBeWritten { motor, why },
        BringUpError::NotThere(silent) => {
            let why = CallError::Failed { motor: silent, failure: Failure::NoReply };
            BringUpError::MayBeWritten { motor, why }
        }
        error => error,
    }
}

/// Restarts a drive and sees whether its zero is where it was put.
async fn keeps_zero<R: AsyncRunner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
    stored: EncoderPulses,
) -> Result<EncoderPulses, BringUpError<R::Error>> {
    restart_what_is_off(runner, motor, motor).await?;
    let found = runner.ask(motor, ReadMultiTurnEncoderOffset).await?.offset;
    let angle = runner.ask(motor, ReadMultiTurnAngle).await?.angle;
    if found == stored && angle.raw().unsigned_abs() <= ZERO_TOLERANCE.unsigned_abs() {
        Ok(stored)
    } else {
        Err(BringUpError::ZeroNotKept { motor, stored, found, angle })
    }
}

/// As [`bring_up::protect`](crate::io::bring_up::protect).
pub async fn protect<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    timeout: Milliseconds,
) -> Result<Protection, CallError<B::Error>> {
    let told = bus.ask(motor, CommunicationLossProtection { timeout }).await?.timeout;
    Ok(if told == timeout { Protection::Confirmed } else { Protection::AcknowledgedOnly(told) })
}

/// As [`bring_up::restart`](crate::io::bring_up::restart).
pub async fn restart<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    then: MotorId,
) -> Result<(), BringUpError<B::Error>> {
    check_not_stopped(bus, motor)?;
    let mut is_there = match wait_until_there(bus, motor, LONGEST_SILENCE).await {
        Ok(()) => true,
        Err(BringUpError::NotThere(_)) => false,
        Err(error) => return Err(error),
    };
    if !is_there {
        // It may hear all the same.
        is_there = bus.ask(motor, LockBrake).await.is_ok();
        let locked = bus.now() + BRAKE_MOVES;
        bus.wait_until(locked).await?;
    }
    if is_there {
        match switch_off(bus, motor).await {
            // It falls all the same; an error that keeps it from holding goes with the restart.
            Ok(()) | Err(BringUpError::BrakeSlips { holds: Some(false), .. }) => {}
            Err(error) => return Err(error),
        }
    }
    restart_what_is_off(bus, motor, then).await
}

/// The same, of a motor that holds nothing.
pub(super) async fn restart_what_is_off<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    then: MotorId,
) -> Result<(), BringUpError<B::Error>> {
    const LONGEST_RESTART: Duration = Duration::from_secs(5);
    let mut fails = BringUpError::NotRestarted(motor);
    for _ in 0..RESTARTS {
        // One with a new id may answer under that already; one that does not answer may hear all the same.
        let ran = match then == motor {
            true => match bus.ask(motor, ReadRunTime).await {
                Ok(reply) => reply.run_time.into(),
                Err(CallError::Failed { failure: Failure::NoReply, .. }) => Duration::ZERO,
                Err(error) => return Err(error.into()),
            },
            false => Duration::ZERO,
        };
        let told_at = bus.now();
        bus.ask(motor, Reset).await?;
        let there = match wait_until_there(bus, then, LONGEST_RESTART).await {
            Err(BringUpError::NotThere(_)) if then != motor && bus.is_there(motor).await? => motor,
            // It may hear the old id and answer as the new one.
            Err(BringUpError::NotThere(_)) if then != motor => {
                fails = BringUpError::NotThere(then);
                continue;
            }
            result => result.map(|()| then)?,
        };
        let has_restarted = there != motor || has_started_since(bus, motor, told_at, ran).await?;
        if has_restarted {
            // It was meant to.
            bus.resume(there);
            return if there == then { Ok(()) } else { Err(BringUpError::NotThere(then)) };
        }
    }
    Err(fails)
}

/// Whether its drive has started since then, when it had run for so long. The master concludes from the same answer what
/// it can, but a handle hears of that later than of the answer, and whether a drive has obeyed 0x76 it does not ask.
pub(super) async fn has_started_since<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    then: Instant,
    ran: Duration,
) -> Result<bool, CallError<B::Error>> {
    let runs = Duration::from(bus.ask(motor, ReadRunTime).await?.run_time);
    // Else it is longer by all that it had run before. Its clock need not agree with ours.
    Ok(runs.times(2) <= (bus.now() - then).times(2) + ran)
}
