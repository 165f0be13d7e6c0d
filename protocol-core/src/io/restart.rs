//! Restarts a drive.

use crate::command::{LockBrake, ReadRunTime, Reset};
use crate::id::MotorId;
use crate::io::asking::CallError;
use crate::io::brake::{BRAKE_MOVES, switch_off};
use crate::io::calls::Calls;
use crate::io::outcome::BringUpError;
use crate::io::presence::wait_until_there;
use crate::io::standing::check_not_stopped;
use crate::master::Failure;
use crate::time::{Duration, Instant};

/// How often a drive that goes on running is told to restart.
const RESTARTS: u8 = 3;
/// How often a run time is asked that came too late to tell anything.
const RUN_TIMES: u8 = 3;
/// How long a motor that is to restart is asked whether it is there: a line may be out for as long.
const LONGEST_SILENCE: Duration = Duration::from_millis(200);
/// How long a drive may take to answer again.
const LONGEST_RESTART: Duration = Duration::from_secs(5);

/// As [`bring_up::restart`](crate::io::bring_up::restart). If this future is dropped, the motor may be off, with only
/// its brake to hold a load, or have restarted; moves may then be refused until
/// [`resume`](crate::master::Master::resume): read its angle first.
pub async fn restart<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    then: MotorId,
) -> Result<(), BringUpError<B::Error>> {
    check_not_stopped(bus, motor)?;
    let is_there = match wait_until_there(bus, motor, LONGEST_SILENCE).await {
        Ok(()) => true,
        Err(BringUpError::NotThere(_)) => {
            // It may still hear.
            let has_answered = bus.ask(motor, LockBrake).await.is_ok();
            let locked = bus.now() + BRAKE_MOVES;
            bus.wait_until(locked).await?;
            has_answered
        }
        Err(error) => return Err(error),
    };
    if is_there {
        match switch_off(bus, motor).await {
            // The load falls in any case; an error that keeps the motor from holding ends with the restart.
            Ok(()) | Err(BringUpError::BrakeSlips { holds: Some(false), .. }) => {}
            Err(error) => return Err(error),
        }
    }
    restart_what_is_off(bus, motor, then).await
}

/// The same for a motor that holds nothing.
pub(super) async fn restart_what_is_off<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    then: MotorId,
) -> Result<(), BringUpError<B::Error>> {
    let mut fails = BringUpError::NotRestarted(motor);
    for _ in 0..RESTARTS {
        // A motor with a new id may already answer under that one; a motor that does not answer may still hear.
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
            // It may hear the old id and answer under the new one.
            Err(BringUpError::NotThere(_)) if then != motor => {
                fails = BringUpError::NotThere(then);
                continue;
            }
            result => result.map(|()| then)?,
        };
        // If it is not known how long it had run before, any run time since then is that of a restart.
        let has_restarted = there != motor
            || has_started_since(bus, motor, told_at, ran).await?.unwrap_or(ran == Duration::ZERO);
        if has_restarted {
            // This restart was intended.
            bus.resume(there);
            return if there == then { Ok(()) } else { Err(BringUpError::NotThere(then)) };
        }
    }
    Err(fails)
}

/// Whether the drive has started since `then`, when it had run for `ran`; `None` if its answers come too late to tell.
/// The master concludes what it can from the same answer, but a handle learns of that later than of the answer, and the
/// master does not ask whether a drive has obeyed 0x76.
pub(super) async fn has_started_since<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    then: Instant,
    ran: Duration,
) -> Result<Option<bool>, CallError<B::Error>> {
    // Without a restart its run time would be longer by `ran`. Half of that allows for a clock that differs from ours.
    let has_started = |runs: Duration, by: Instant| runs.times(2) <= (by - then).times(2) + ran;
    for _ in 0..RUN_TIMES {
        let asked_at = bus.now();
        let runs = bus.ask(motor, ReadRunTime).await?.run_time.into();
        // The caller may have been held up before it had the answer.
        let answered_by = bus.now();
        if has_started(runs, asked_at) == has_started(runs, answered_by) {
            return Ok(Some(has_started(runs, asked_at)));
        }
    }
    Ok(None)
}
