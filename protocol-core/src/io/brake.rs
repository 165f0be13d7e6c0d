//! Opening and locking a holding brake, so that no load falls.

use crate::command::{
    BrakeCommand, Command, LockBrake, ReadStatus1, ReadStatus2, ReleaseBrake, Shutdown, Status1,
    Stop,
};
use crate::id::MotorId;
use crate::io::asking::CallError;
use crate::io::bring_up::BringUpError;
use crate::io::calls::Calls;
use crate::io::on_drop::OnDrop;
use crate::io::standing::{check_stands, runs, turns};
use crate::master::{Failure, StopKind};
use crate::time::Duration;
use crate::units::CoarseSpeed;

/// How long a brake takes to open or to lock at the most: 50 to 150 ms were seen of such that open.
pub const BRAKE_MOVES: Duration = Duration::from_millis(200);
/// How often a motor is spoken to that is waited for: its communication-loss protection may be short.
pub(super) const SPOKEN_TO_EVERY: Duration = Duration::from_millis(10);
/// In so long a load turns a shaft that nothing holds.
const LOAD_SHOWS: Duration = Duration::from_millis(200);
/// How often a brake is told to open that does not answer.
const RELEASES: u8 = 3;
/// How often a brake is told to lock that does not answer, with the time to lock between: what is said then may be lost
/// for longer than a question is repeated.
const LOCKS: u8 = 2;
/// How often the bus may fail while a load hangs on what is asked.
const LOOKS: u8 = 10;

/// As [`bring_up::release_brake`](crate::io::bring_up::release_brake). If this future is dropped from when the brake is
/// told to open until the motor has confirmed that it holds, the stop is in force, and the first thing that any other
/// future of the loop sends. Behind that it goes on holding, and nobody looks for errors.
pub async fn release_brake<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<(), BringUpError<B::Error>> {
    // One that has lost its master obeys the third command (2.31.1).
    look(bus, motor, ReadStatus1).await?;
    let fails = |status: Status1| BringUpError::Fault { motor, errors: status.errors };
    let has_errors = |status: &Status1| !status.errors.is_empty();
    let before = look(bus, motor, ReadStatus1).await?;
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
    let turns = turns_within(bus, motor, Duration::ZERO).await?;
    if turns.is_some() && runs(bus, motor).await != Some(true) {
        // Somebody has switched it off since, as far as it says.
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

/// Gives a brake the time to open or to lock, unless it is over before; how its drive is then.
async fn moved<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    is_over: impl Fn(&Status1) -> bool,
) -> Result<Status1, CallError<B::Error>> {
    let end = bus.now() + BRAKE_MOVES;
    loop {
        // Without a word its communication-loss protection would lock it, and switch its motor off.
        let status = look(bus, motor, ReadStatus1).await?;
        let now = bus.now();
        if now >= end || is_over(&status) {
            return Ok(status);
        }
        let _ = bus.wait_until(end.min(now + SPOKEN_TO_EVERY)).await;
    }
}

/// As [`bring_up::lock_brake`](crate::io::bring_up::lock_brake). If this future is dropped, the brake may have been told to
/// lock, and nobody looks whether it holds.
pub async fn lock_brake<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<(), BringUpError<B::Error>> {
    let status = bus.ask(motor, ReadStatus1).await?;
    let held = may_hold(bus, motor, &status).await?;
    lock_and_look(bus, motor, held).await
}

/// Switches a motor off, its brake locked before if it has one, and sees that nothing falls. If this future is dropped,
/// nobody does.
pub(super) async fn switch_off<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<(), BringUpError<B::Error>> {
    let status = bus.ask(motor, ReadStatus1).await?;
    let held = may_hold(bus, motor, &status).await?;
    if held || status.brake != BrakeCommand::LOCK {
        match lock_and_look(bus, motor, held).await {
            // It has none, or does not know the command; or something has opened it again.
            Err(
                BringUpError::BrakeNotLocked { .. }
                | BringUpError::Call(CallError::Failed { failure: Failure::NoReply, .. }),
            ) => check_stands(bus, motor).await?,
            outcome => outcome?,
        }
    }
    bus.ask(motor, Shutdown).await?;
    match held {
        true => holds_without_motor(bus, motor, LOAD_SHOWS, held).await,
        false => Ok(()),
    }
}

/// Whether the motor may hold its shaft, which stands: unless it says that it runs nothing, and that its brake is locked.
/// Some may not say that they run motion mode. One that turns and runs something is refused.
async fn may_hold<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    status: &Status1,
) -> Result<bool, BringUpError<B::Error>> {
    let speed = bus.ask(motor, ReadStatus2).await?.speed;
    let is_open = status.brake != BrakeCommand::LOCK;
    let runs = runs(bus, motor).await;
    match status.errors.is_empty() {
        true if turns(speed) && runs.unwrap_or(is_open) => {
            Err(BringUpError::Turns { motor, speed })
        }
        is_sound => Ok(is_sound && !turns(speed) && (is_open || runs != Some(false))),
    }
}

/// Tells a brake to lock, and sees whether it does and holds. What has held the shaft until then is to hold it again if
/// not.
async fn lock_and_look<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    held: bool,
) -> Result<(), BringUpError<B::Error>> {
    let mut outcome = Ok(());
    for _ in 0..LOCKS {
        let told = bus.ask(motor, LockBrake).await;
        if let Err(refused @ CallError::Refused { .. }) = told {
            return Err(refused.into());
        }
        // It may have heard that all the same.
        let says = moved(bus, motor, |_| false).await?.brake;
        holds_without_motor(bus, motor, Duration::ZERO, held).await?;
        if says == BrakeCommand::LOCK {
            return Ok(());
        }
        let is_answered = told.is_ok();
        outcome =
            Err(told
                .map_or_else(BringUpError::Call, |_| BringUpError::BrakeNotLocked { motor, says }));
        if is_answered {
            break;
        }
    }
    if held && runs(bus, motor).await == Some(false) {
        // Something has opened it again and let the motor go, and it does not turn yet.
        hold_again(bus, motor).await;
    }
    outcome
}

/// Whether the shaft stands for so long behind a motor that does not hold it any more. What has held it until then is to
/// hold it again if not.
async fn holds_without_motor<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    time: Duration,
    held: bool,
) -> Result<(), BringUpError<B::Error>> {
    let Some(speed) = turns_within(bus, motor, time).await? else { return Ok(()) };
    let holds = if held { hold_again(bus, motor).await } else { Some(false) };
    Err(BringUpError::BrakeSlips { motor, speed, holds })
}

/// Opens the brake again, since no drive holds behind a locked one, and has the motor hold. Whether it does, if that is
/// known.
async fn hold_again<B: Calls<N>, const N: usize>(bus: &mut B, motor: MotorId) -> Option<bool> {
    match release_brake(bus, motor).await {
        Ok(()) => Some(true),
        Err(
            BringUpError::Fault { .. }
            | BringUpError::LetGo(_)
            | BringUpError::Call(CallError::Refused { .. }),
        ) => Some(false),
        Err(_) => None,
    }
}

/// How fast the shaft turns, if it does within so long: at two looks in a row, since one may find it swing.
async fn turns_within<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    time: Duration,
) -> Result<Option<CoarseSpeed>, CallError<B::Error>> {
    let end = bus.now() + time;
    let mut turned = false;
    loop {
        let speed = look(bus, motor, ReadStatus2).await?.speed;
        let now = bus.now();
        match turns(speed) {
            true if turned => return Ok(Some(speed)),
            false if now >= end => return Ok(None),
            turns => turned = turns,
        }
        let _ = bus.wait_until(now + SPOKEN_TO_EVERY).await;
    }
}

/// Asks again where the bus fails: a load hangs on what is done then.
async fn look<B: Calls<N>, C: Command + Copy, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    command: C,
) -> Result<C::Reply, CallError<B::Error>> {
    let mut looks = 1;
    loop {
        match bus.ask(motor, command).await {
            Err(CallError::Bus(_)) if looks < LOOKS => looks += 1,
            outcome => return outcome,
        }
    }
}
