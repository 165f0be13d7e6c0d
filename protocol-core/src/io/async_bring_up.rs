//! First contact and safe ways of working over any [`AsyncRunner`](crate::io::AsyncRunner):
//! [`bring_up`](crate::io::bring_up) for tasks. The functions there run these.
//!
//! If one of these futures is dropped, its work ends where it is: a motor may have been given its new id and not have
//! been restarted, for example. Those that move a motor or open its brake then put a stop in force, which the next
//! future of the loop sends.

use crate::command::{
    CommunicationLossProtection, ReadModel, ReadMultiTurnAngle, ReadMultiTurnEncoderOffset,
    ReadRunTime, ReadRunningMode, ReadStatus1, ReadVersionDate, SetCurrentPositionZero,
};
use crate::id::MotorId;
use crate::io::asking::CallError;
use crate::io::brake::switch_off;
pub use crate::io::brake::{check_brake, lock_brake, release_brake};
pub use crate::io::calls::Calls;
pub use crate::io::change_id::{change_id, is_shared};
pub use crate::io::move_to::move_to;
use crate::io::outcome::{BringUpError, Identity, Protection};
pub use crate::io::presence::{is_there, scan, wait_until_there};
pub use crate::io::restart::restart;
use crate::io::restart::restart_what_is_off;
pub use crate::io::standing::wait_until_stands;
use crate::io::standing::{check_not_stopped, check_stands};
use crate::master::Failure;
use crate::units::{EncoderPulses, Milliseconds};

/// How far a new zero may be from 0 after a restart, 0.01 degrees: the shaft may settle meanwhile.
const ZERO_TOLERANCE: u32 = 100;

/// As [`bring_up::identify`](crate::io::bring_up::identify).
pub async fn identify<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<Identity, CallError<B::Error>> {
    let model = match bus.ask(motor, ReadModel).await {
        Ok(reply) => Some(reply.model),
        Err(CallError::Failed { failure: Failure::NoReply, .. }) => None,
        Err(error) => return Err(error),
    };
    Ok(Identity {
        model,
        version: bus.ask(motor, ReadVersionDate).await?.version_date,
        run_time: bus.ask(motor, ReadRunTime).await?.run_time,
        mode: bus.ask(motor, ReadRunningMode).await?.mode,
        status: bus.ask(motor, ReadStatus1).await?,
    })
}

/// As [`bring_up::zero_here`](crate::io::bring_up::zero_here). If this future is dropped, the motor may be off, with
/// only its brake to hold a load, and the new zero may be in its ROM, in force from its next start on: read its angle
/// before it moves.
pub async fn zero_here<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<EncoderPulses, BringUpError<B::Error>> {
    check_not_stopped(bus, motor)?;
    check_stands(bus, motor).await?;
    switch_off(bus, motor).await?;
    let stored = match bus.ask(motor, SetCurrentPositionZero).await {
        Ok(reply) => reply.offset,
        Err(refused @ CallError::Refused { .. }) => return Err(refused.into()),
        Err(why) => return Err(BringUpError::MayBeWritten { motor, why }),
    };
    keeps_zero(bus, motor, stored).await.map_err(|error| error.behind_a_write(motor))
}

/// Restarts a drive and checks that its zero is where it was put.
async fn keeps_zero<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    stored: EncoderPulses,
) -> Result<EncoderPulses, BringUpError<B::Error>> {
    restart_what_is_off(bus, motor, motor).await?;
    let found = bus.ask(motor, ReadMultiTurnEncoderOffset).await?.offset;
    let angle = bus.ask(motor, ReadMultiTurnAngle).await?.angle;
    if found == stored && angle.raw().unsigned_abs() <= ZERO_TOLERANCE {
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
) -> Result<Protection, BringUpError<B::Error>> {
    check_not_stopped(bus, motor)?;
    check_stands(bus, motor).await?;
    let told = match bus.ask(motor, CommunicationLossProtection { timeout }).await {
        Ok(reply) => reply.timeout,
        Err(refused @ CallError::Refused { .. }) => return Err(refused.into()),
        Err(why) => return Err(BringUpError::MayBeProtected { motor, why }),
    };
    Ok(if told == timeout { Protection::Confirmed } else { Protection::AcknowledgedOnly(told) })
}
