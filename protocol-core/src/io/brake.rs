//! Opens and locks a holding brake so that no load falls.

use crate::command::{
    BrakeCommand, Command, Feedback, LockBrake, ReadRunTime, ReadStatus1, ReadStatus2,
    ReleaseBrake, Shutdown, Status1, Stop,
};
use crate::error::RequestError;
use crate::id::MotorId;
use crate::io::asking::CallError;
use crate::io::calls::{Calls, SPOKEN_TO_EVERY};
use crate::io::elapsed::Elapsed;
use crate::io::on_drop::OnDrop;
use crate::io::outcome::BringUpError;
use crate::io::standing::{check_not_stopped, check_stands, runs, turns};
use crate::master::{Failure, StopKind};
use crate::time::{Duration, Instant};
use crate::units::CoarseSpeed;

/// How long a brake takes to open or to lock at most. To open, 50 to 150 ms were seen.
pub const BRAKE_MOVES: Duration = Duration::from_millis(200);
/// How long a motor may take to bring a load to rest that it catches.
const COMES_TO_REST: Duration = Duration::from_millis(500);
/// Within this time a load turns a shaft that nothing holds.
const LOAD_SHOWS: Duration = Duration::from_millis(200);
/// How often a brake that does not answer is told to open.
const RELEASES: u8 = 3;
/// How often a brake that does not answer is told to lock, with the time to lock in between: a line may be out for
/// longer than a question is repeated.
const LOCKS: u8 = 2;
/// How long something is asked again and again while a load depends on the answer.
const INSISTS_FOR: Duration = Duration::from_millis(300);

/// As [`bring_up::release_brake`](crate::io::bring_up::release_brake). If this future is dropped between telling the
/// brake to open and the motor's confirmation that it holds, the stop is in force, and is the first thing that any
/// other future of the loop sends. If it is dropped later, the motor goes on holding, and nobody checks for errors.
pub async fn release_brake<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<(), BringUpError<B::Error>> {
    // A drive that has lost its master obeys the third command (2.31.1). What the first reads shows the master whether
    // the motor has restarted: then it does not move on.
    if bus.ask(motor, ReadRunTime).await.is_err() {
        insist(bus, motor, ReadStatus1).await?;
    }
    let before = insist(bus, motor, ReadStatus1).await?;
    if !before.errors.is_empty() {
        if before.brake != BrakeCommand::LOCK {
            leave_to_brake(bus, motor).await;
        }
        return Err(BringUpError::Fault { motor, errors: before.errors });
    }
    open(bus, motor).await
}

/// Opens a brake while the motor holds from the beginning, and checks that it does hold.
async fn open<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<(), BringUpError<B::Error>> {
    open_and_hold(bus, motor).await?;
    let Some(fails) = fails_to_hold(bus, motor).await? else { return Ok(()) };
    leave_to_brake(bus, motor).await;
    Err(fails)
}

/// Gives a brake the time to open. Returns why nothing holds the shaft, as soon as nothing does.
async fn fails_to_hold<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<Option<BringUpError<B::Error>>, BringUpError<B::Error>> {
    let end = bus.now() + BRAKE_MOVES;
    loop {
        // What the motor says is no older than that, however long the caller is held up.
        let asked_at = bus.now();
        let Status1 { errors, brake: says, .. } = insist(bus, motor, ReadStatus1).await?;
        let switched_off = match check_not_stopped(bus, motor) {
            // A stop may hold it as well.
            Err(stopped) if runs(bus, motor).await == Some(false) => Some(stopped),
            _ => None,
        };
        if !errors.is_empty() {
            return Ok(Some(BringUpError::Fault { motor, errors }));
        }
        if let Some(stopped) = switched_off {
            return Ok(Some(stopped.into()));
        }
        if asked_at < end {
            wait_on(bus, end).await;
            continue;
        }
        if says != BrakeCommand::RELEASE {
            return Err(BringUpError::BrakeNotReleased { motor, says });
        }
        let speed = turned_by_load(bus, motor, true).await?;
        return Ok(speed.map(|speed| BringUpError::NotHeld { motor, speed }));
    }
}

/// How fast the shaft turns, if a load turns it: at two looks in a row, since a single look may find it swinging. A
/// motor that `holds` may take its time to bring the shaft to rest, and once it rests this ends. It does not hold if it
/// runs nothing that could or, where it does not say that, draws no current.
async fn turned_by_load<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    holds: bool,
) -> Result<Option<CoarseSpeed>, CallError<B::Error>> {
    let end = bus.now() + if holds { COMES_TO_REST } else { LOAD_SHOWS };
    let mut turned = false;
    loop {
        // A load may have begun to turn the shaft, or have come to rest, since the motor said how fast it turns.
        let asked_at = bus.now();
        let Feedback { speed, current, .. } = insist(bus, motor, ReadStatus2).await?;
        let turns = turns(speed);
        let may_rest = holds && asked_at < end;
        if turned && turns && !(may_rest && runs(bus, motor).await.unwrap_or(current.raw() != 0)) {
            return Ok(Some(speed));
        }
        if !turns && asked_at >= end || holds && speed.raw() == 0 {
            return Ok(None);
        }
        turned = turns;
        let answered_at = bus.now();
        let _ = bus.wait_until(answered_at + SPOKEN_TO_EVERY).await;
    }
}

/// Afterwards the motor holds or its stop is in force, unless its brake was not told to open.
async fn open_and_hold<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<(), CallError<B::Error>> {
    let opening = OnDrop::new(bus, |bus: &mut &mut B| bus.begin_stop(motor, StopKind::Hold));
    let mut told = Ok(());
    for round in 0..RELEASES {
        told = opening.it.ask_often(motor, ReleaseBrake, Some(1)).await.map(drop);
        if let Err(CallError::Refused { .. }) = told {
            if round > 0 {
                break;
            }
            opening.end();
            return told;
        }
        // Right after the release, answered or not, and whatever the bus reports: the brake may open all the same, and
        // then a load falls. Not before it: behind a locked brake a stop may do nothing.
        match insist(&mut *opening.it, motor, Stop).await {
            Ok(_) if told.is_ok() => {
                opening.end();
                return told;
            }
            Ok(_) => {}
            Err(error) => {
                if let CallError::Refused { refusal: RequestError::Stopped, .. }
                | CallError::Failed { failure: Failure::Stopped, .. } = error
                {
                    // Somebody has switched the motor off meanwhile, or stops it again and again.
                    leave_to_brake(&mut *opening.it, motor).await;
                }
                told = Err(error);
                break;
            }
        }
    }
    // Sent before this returns: nobody may run the loop soon.
    let _ = opening.it.stop(motor, StopKind::Hold).await;
    opening.end();
    told
}

/// Waits until `end`, or until the motor is to be spoken to again: in silence its communication-loss protection would
/// lock the brake and switch it off.
async fn wait_on<B: Calls<N>, const N: usize>(bus: &mut B, end: Instant) {
    let now = bus.now();
    let _ = bus.wait_until(end.min(now + SPOKEN_TO_EVERY)).await;
}

/// As [`bring_up::lock_brake`](crate::io::bring_up::lock_brake). If this future is dropped, the brake may have been
/// told to lock, and nobody checks whether it holds.
pub async fn lock_brake<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<(), BringUpError<B::Error>> {
    let status = bus.ask(motor, ReadStatus1).await?;
    let held = may_hold(bus, motor, &status).await?;
    lock_and_look(bus, motor, held).await?.map_or(Ok(()), Err)
}

/// Locks a motor's brake if it has one, switches the motor off, and checks that nothing falls. If this future is
/// dropped, nobody checks.
pub(super) async fn switch_off<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<(), BringUpError<B::Error>> {
    let status = bus.ask(motor, ReadStatus1).await?;
    let held = may_hold(bus, motor, &status).await?;
    if held || status.brake != BrakeCommand::LOCK {
        match lock_and_look(bus, motor, held).await? {
            None => {}
            // It has no brake, or does not know the command; or something has opened the brake again.
            Some(
                BringUpError::BrakeNotLocked { .. }
                | BringUpError::Call(CallError::Failed { failure: Failure::NoReply, .. }),
            ) => check_stands(bus, motor).await?,
            Some(why) => return Err(why),
        }
    }
    // Somebody may have stopped it meanwhile, to hold.
    check_not_stopped(bus, motor)?;
    let told = bus.ask(motor, Shutdown).await;
    // It may have obeyed without answering.
    if held && !matches!(told, Err(CallError::Refused { .. })) {
        stands_by_itself(bus, motor, held).await?;
    }
    told.map(drop).map_err(Into::into)
}

/// As [`bring_up::check_brake`](crate::io::bring_up::check_brake).
pub async fn check_brake<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<(), BringUpError<B::Error>> {
    stands_by_itself(bus, motor, false).await
}

/// Whether the motor may hold its shaft, which stands: it runs something, or draws a current. In motion mode it may
/// draw one and not say that it runs. A motor that reports errors holds nothing. Refuses any other that turns and runs
/// something, or that turns behind an open brake and does not say what it runs.
async fn may_hold<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    status: &Status1,
) -> Result<bool, BringUpError<B::Error>> {
    let Feedback { speed, current, .. } = bus.ask(motor, ReadStatus2).await?;
    let runs = runs(bus, motor).await;
    if !status.errors.is_empty() {
        return Ok(false);
    }
    let is_open = status.brake != BrakeCommand::LOCK;
    match turns(speed) {
        true if runs.unwrap_or(is_open) => Err(BringUpError::Turns { motor, speed }),
        is_turning => Ok(!is_turning && (runs == Some(true) || current.raw() != 0)),
    }
}

/// Tells a brake to lock, and checks whether it holds. If the shaft stands although the brake is not locked, returns
/// why it is not.
async fn lock_and_look<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    held: bool,
) -> Result<Option<BringUpError<B::Error>>, BringUpError<B::Error>> {
    let mut locks = 0;
    loop {
        let told = bus.ask(motor, LockBrake).await;
        if let Err(refused @ CallError::Refused { .. }) = told {
            return Err(refused.into());
        }
        // It may have heard the command all the same.
        let end = bus.now() + BRAKE_MOVES;
        let says = loop {
            let asked_at = bus.now();
            let says = insist(bus, motor, ReadStatus1).await?.brake;
            if asked_at >= end {
                break says;
            }
            wait_on(bus, end).await;
        };
        stands_by_itself(bus, motor, held).await?;
        locks += 1;
        match told {
            _ if says == BrakeCommand::LOCK => return Ok(None),
            Ok(_) => return Ok(Some(BringUpError::BrakeNotLocked { motor, says })),
            Err(error) if locks == LOCKS => return Ok(Some(error.into())),
            Err(_) => {}
        }
    }
}

/// Checks whether the shaft stands without its motor. If not, a motor that has held it until then is told to hold it
/// again.
async fn stands_by_itself<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    held: bool,
) -> Result<(), BringUpError<B::Error>> {
    let Some(speed) = turned_by_load(bus, motor, false).await? else {
        return Ok(());
    };
    let holds = if held { hold_again(bus, motor).await } else { Some(false) };
    Err(BringUpError::BrakeSlips { motor, speed, holds })
}

/// Opens the brake again, since no drive holds behind a locked one, and tells the motor to hold. Returns whether it
/// does, if that is known.
async fn hold_again<B: Calls<N>, const N: usize>(bus: &mut B, motor: MotorId) -> Option<bool> {
    // Only a known error prevents this: the load is falling.
    if insist(bus, motor, ReadStatus1).await.is_ok_and(|status| !status.errors.is_empty()) {
        return Some(false);
    }
    match open(bus, motor).await {
        Ok(()) => Some(true),
        Err(
            BringUpError::Fault { .. }
            | BringUpError::NotHeld { .. }
            | BringUpError::Call(CallError::Refused { .. }),
        ) => Some(false),
        Err(_) => None,
    }
}

/// Only the brake can hold the shaft now: it is told to lock. Whether it answers changes nothing else.
pub(super) async fn leave_to_brake<B: Calls<N>, const N: usize>(bus: &mut B, motor: MotorId) {
    let _ = insist(bus, motor, LockBrake).await;
}

/// Asks again for a while if no answer comes, whatever the reason: a load depends on what is done next.
async fn insist<B: Calls<N>, C: Command + Copy, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    command: C,
) -> Result<C::Reply, CallError<B::Error>> {
    let mut insisted = Elapsed::default();
    loop {
        let asked_at = bus.now();
        let is_last = insisted.at(asked_at) >= INSISTS_FOR;
        match bus.ask(motor, command).await {
            Err(CallError::Bus(_) | CallError::Failed { .. }) if !is_last => {}
            outcome => return outcome,
        }
        let answered_at = bus.now();
        let _ = bus.wait_until(answered_at + SPOKEN_TO_EVERY).await;
    }
}
