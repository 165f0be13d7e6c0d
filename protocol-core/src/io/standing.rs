//! Whether a motor turns, runs something, or was stopped.

use crate::command::{ReadRunningMode, ReadStatus2};
use crate::error::RequestError;
use crate::id::MotorId;
use crate::io::asking::CallError;
use crate::io::calls::Calls;
use crate::io::outcome::BringUpError;
use crate::master::Failure;
use crate::time::Duration;
use crate::units::CoarseSpeed;

/// Up to this speed a shaft stands, degrees per second.
const STANDS_DPS: u16 = 2;
/// The time between two looks at a shaft that is to come to rest.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// At so many looks in a row a shaft stands that has come to rest: one that swings stands for a moment, too. A number
/// and not a time, since a program that is suspended does not look.
const STANDING_LOOKS: u8 = 6;

/// Refuses a motor for which a stop is in force: the stop may hold it, and it must not be switched off then.
pub(super) fn check_not_stopped<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<(), CallError<B::Error>> {
    match bus.may_move(motor) {
        Err(refusal @ RequestError::Stopped) => Err(CallError::Refused { motor, refusal }),
        _ => Ok(()),
    }
}

/// Refuses a motor that turns: if it were switched off, it would run on.
pub(super) async fn check_stands<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
) -> Result<(), BringUpError<B::Error>> {
    let speed = bus.ask(motor, ReadStatus2).await?.speed;
    if turns(speed) { Err(BringUpError::Turns { motor, speed }) } else { Ok(()) }
}

/// As [`bring_up::wait_until_stands`](crate::io::bring_up::wait_until_stands).
pub async fn wait_until_stands<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    time: Duration,
) -> Result<(), BringUpError<B::Error>> {
    let deadline = bus.now() + time;
    let mut stood: u8 = 0;
    loop {
        // The motor may have come to rest since it said how fast it turns, if the caller was held up.
        let asked_at = bus.now();
        let looked = bus.ask(motor, ReadStatus2).await;
        match looked.map(|reply| reply.speed) {
            Ok(speed) if !turns(speed) => {
                stood += 1;
                if stood == STANDING_LOOKS {
                    return Ok(());
                }
            }
            Ok(speed) if asked_at >= deadline => return Err(BringUpError::Turns { motor, speed }),
            Ok(_) => stood = 0,
            // Somebody has stopped the motor once more, which drops questions.
            Err(CallError::Failed { failure: Failure::Stopped, .. }) if asked_at < deadline => {
                stood = 0;
            }
            Err(error) => return Err(error.into()),
        }
        let answered_at = bus.now();
        bus.wait_until(answered_at + LOOK_EVERY).await?;
    }
}

/// Whether the motor runs something, so that it can stop or hold its shaft; `None` if it does not answer that.
pub(super) async fn runs<B: Calls<N>, const N: usize>(bus: &mut B, motor: MotorId) -> Option<bool> {
    // Asked once: a short protection does not outlast more.
    let reply = bus.ask_often(motor, ReadRunningMode, Some(1)).await;
    match reply {
        Ok(reply) => Some(reply.mode.runs()),
        // It has heard nothing for too long, and has cut its output.
        Err(CallError::Failed { failure: Failure::NotExecuted, .. }) => Some(false),
        Err(_) => None,
    }
}

/// Whether a motor that reports this speed turns. Up to 2 dps it stands, since feedback may flicker by a step.
pub fn turns(speed: CoarseSpeed) -> bool {
    speed.raw().unsigned_abs() > STANDS_DPS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speed_of_2_dps_or_less_is_standing() {
        for (raw, is_turning) in [(0, false), (2, false), (-2, false), (3, true), (i16::MIN, true)]
        {
            assert_eq!(turns(CoarseSpeed::from_raw(raw)), is_turning, "{raw}");
        }
    }
}
