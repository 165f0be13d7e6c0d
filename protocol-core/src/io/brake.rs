//! Opening and locking a holding brake, so that no load falls.

use crate::command::{
    BrakeCommand, LockBrake, ReadStatus1, ReadStatus2, ReleaseBrake, Status1, Stop,
};
use crate::id::MotorId;
use crate::io::asking::CallError;
use crate::io::async_bring_up::SPOKEN_TO_EVERY;
use crate::io::bring_up::BringUpError;
use crate::io::calls::Calls;
use crate::io::on_drop::OnDrop;
use crate::io::standing::{check_stands, runs, turns};
use crate::master::{Failure, StopKind};
use crate::time::Duration;
use crate::units::CoarseSpeed;

/// How long a brake takes to open or to lock at the most: 50 to 150 ms were seen of such that open.
pub const BRAKE_MOVES: Duration = Duration::from_millis(200);
/// How often a brake is told to open that does not answer.
const RELEASES: u8 = 3;

/// As [`bring_up::release_brake`](crate::io::bring_up::release_brake). If this future is dropped from when the brake is
/// told to open until the motor has confirmed that it holds, the stop is in force, and the first thing that any other
/// future of the loop sends. Behind that it goes on holding, and nobody looks for errors.
pub async fn release_brake<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<(), BringUpError<B::Error>> {
    // One that has lost its master obeys the third command (2.31.1).
    bus.ask(motor, ReadStatus1).await?;
    let fails = |status: Status1| BringUpError::Fault { motor, errors: status.errors };
    let has_errors = |status: &Status1| !status.errors.is_empty();
    let before = bus.ask(motor, ReadStatus1).await?;
    if has_errors(&before) {
        if before.brake != BrakeCommand::LOCK {
            let _ = bus.ask(motor, LockBrake).await;
        }
        return Err(fails(before));
    }
    open_and_hold(bus, motor).await?;
    let status = moved(bus, motor, has_errors).await?;
    if has_errors(&status) {
        // Only the brake can hold the shaft now. What comes of that changes nothing.
        let _ = bus.ask(motor, LockBrake).await;
        return Err(fails(status));
    }
    if status.brake != BrakeCommand::RELEASE {
        return Err(BringUpError::BrakeNotReleased { motor, says: status.brake });
    }
    if turns_still(bus, motor).await?.is_some() && runs(bus, motor).await == Some(false) {
        // Somebody has switched it off since.
        let _ = bus.ask(motor, LockBrake).await;
        return Err(BringUpError::LetGo(motor));
    }
    Ok(())
}

/// Leaves a motor that holds, or whose stop is in force, unless its brake was not told to open.
async fn open_and_hold<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<(), CallError<B::Error>> {
    let opening = OnDrop::new(bus, |bus: &mut &mut B| bus.begin_stop(motor, StopKind::Hold));
    let mut told = Ok(());
    for round in 0..RELEASES {
        told = opening.it.ask_often(motor, ReleaseBrake, Some(1)).await.map(drop);
        let is_unsent = matches!(
            told,
            Err(CallError::Refused { .. } | CallError::Failed { failure: Failure::Stopped, .. })
        );
        if is_unsent && round == 0 {
            opening.end();
            return told;
        }
        if is_unsent || matches!(told, Err(CallError::Bus(_))) {
            return told;
        }
        // At once, answered or not: it may open all the same, a load falls then, and behind a locked one a stop may do
        // nothing.
        opening.it.ask(motor, Stop).await?;
        if told.is_ok() {
            opening.end();
            return told;
        }
    }
    told
}

/// As [`bring_up::lock_brake`](crate::io::bring_up::lock_brake). If this future is dropped, the brake may have been told to
/// lock, and nobody looks whether it holds.
pub async fn lock_brake<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<(), BringUpError<B::Error>> {
    let status = bus.ask(motor, ReadStatus1).await?;
    let held = may_hold(bus, motor, &status).await?;
    bus.ask(motor, LockBrake).await?;
    see_locked(bus, motor, held).await
}

/// Whether the motor may hold its shaft: it runs something, or does not say, and its brake is open. One that turns then
/// is refused.
async fn may_hold<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    status: &Status1,
) -> Result<bool, BringUpError<B::Error>> {
    let speed = bus.ask(motor, ReadStatus2).await?.speed;
    let is_open = status.brake != BrakeCommand::LOCK;
    let runs = runs(bus, motor).await.unwrap_or(is_open);
    match runs && status.errors.is_empty() {
        true if turns(speed) => Err(BringUpError::Turns { motor, speed }),
        may_hold => Ok(may_hold),
    }
}

/// Sees whether the brake holds that was told to lock. What has held the shaft until then is to hold it again if not.
async fn see_locked<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    held: bool,
) -> Result<(), BringUpError<B::Error>> {
    let says = moved(bus, motor, |_| false).await?.brake;
    if says != BrakeCommand::LOCK {
        return Err(BringUpError::BrakeNotLocked { motor, says });
    }
    let Some(speed) = turns_still(bus, motor).await? else { return Ok(()) };
    // No drive holds behind a locked brake.
    let holds = held && release_brake(bus, motor).await.is_ok();
    Err(BringUpError::BrakeSlips { motor, speed, holds })
}

/// Locks the brake of a motor that is about to be switched off, if it has one and it is open, so that nothing falls.
pub(super) async fn lock_if_there<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<(), BringUpError<B::Error>> {
    let status = bus.ask(motor, ReadStatus1).await?;
    if status.brake == BrakeCommand::LOCK {
        return Ok(());
    }
    let held = may_hold(bus, motor, &status).await?;
    let locked = match bus.ask(motor, LockBrake).await {
        Ok(_) => see_locked(bus, motor, held).await,
        Err(error) => Err(error.into()),
    };
    match locked {
        // It has none, or does not know the command; or something has opened it again.
        Err(
            BringUpError::BrakeNotLocked { .. }
            | BringUpError::Call(CallError::Failed { failure: Failure::NoReply, .. }),
        ) => check_stands(bus, motor).await,
        outcome => outcome,
    }
}

/// How fast the shaft turns, if it does: one look may find it swing.
async fn turns_still<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<Option<CoarseSpeed>, CallError<B::Error>> {
    let mut speed = bus.ask(motor, ReadStatus2).await?.speed;
    if turns(speed) {
        let now = bus.now();
        bus.wait_until(now + SPOKEN_TO_EVERY).await?;
        speed = bus.ask(motor, ReadStatus2).await?.speed;
    }
    Ok(Some(speed).filter(|speed| turns(*speed)))
}

/// Gives a brake the time to open or to lock, unless it is over before; how the drive is then.
async fn moved<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    is_over: impl Fn(&Status1) -> bool,
) -> Result<Status1, CallError<B::Error>> {
    let moved = bus.now() + BRAKE_MOVES;
    loop {
        // Without a word its communication-loss protection would lock it, and switch its motor off.
        let status = bus.ask(motor, ReadStatus1).await?;
        let now = bus.now();
        if now >= moved || is_over(&status) {
            return Ok(status);
        }
        bus.wait_until(moved.min(now + SPOKEN_TO_EVERY)).await?;
    }
}
