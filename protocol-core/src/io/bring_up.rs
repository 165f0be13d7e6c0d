//! First contact and safe ways of working: plain functions over any [`Runner`].
//!
//! They wait for what they ask; use them before a control loop runs, not inside one. Set-points and
//! events of other motors are passed over meanwhile.

use core::fmt;

use crate::command::{
    BrakeCommand, BusId, CommunicationLossProtection, Mode, ModelName, ReadModel,
    ReadMultiTurnAngle, ReadMultiTurnEncoderOffset, ReadRunTime, ReadRunningMode, ReadStatus1,
    ReadVersionDate, ReleaseBrake, Reset, SetCurrentPositionZero, Shutdown, Status1, VersionDate,
};
use crate::error::RequestError;
use crate::id::MotorId;
use crate::io::runner::{CallError, LONGEST_IDLE, Runner};
use crate::master::{Event, Failure, MotorSet, Patience};
use crate::opcode::Opcode;
use crate::time::{Duration, Instant};
use crate::units::{Angle, EncoderPulses, Milliseconds};

/// Why a motor could not be brought up as asked.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub enum BringUpError<E> {
    /// A call on the way has no answer.
    #[error(transparent)]
    Call(#[from] CallError<E>),
    /// The motor did not answer within the time given.
    #[error("motor {0} does not answer")]
    NotThere(MotorId),
    /// The id that is to be given is somebody's already.
    #[error("a motor with id {0} is on the bus already")]
    IdTaken(MotorId),
    /// The id can only be changed with this one motor connected, for every motor obeys the command.
    /// These answered.
    #[error(fmt = not_alone)]
    NotAlone(MotorSet),
    /// More than one motor answers under this id, as those from the factory do.
    #[error("two motors or more answer as motor {0}: connect only the one to change")]
    IdShared(MotorId),
    /// After the restart the zero is not where it was put.
    #[error(
        "the zero was not kept: stored at {stored}, after the restart the offset is {found} and the angle {angle}"
    )]
    ZeroNotKept {
        /// The offset that the motor said it stored.
        stored: EncoderPulses,
        /// The offset that it has now.
        found: EncoderPulses,
        /// The angle that it reads now.
        angle: Angle,
    },
    /// The drive does not return release as its brake's last command.
    #[error("the brake was told to release and says {0}")]
    BrakeNotReleased(BrakeCommand),
}

impl<E> From<RequestError> for BringUpError<E> {
    fn from(error: RequestError) -> Self {
        Self::Call(CallError::Request(error))
    }
}

fn not_alone(motors: &MotorSet, f: &mut fmt::Formatter<'_>) -> fmt::Result {
    if motors.is_empty() {
        return f.write_str("no motor answers on the bus");
    }
    write!(
        f,
        "every connected motor obeys an id change: connect only the one to change (there are: {motors})"
    )
}

/// Two quick attempts: for asking whether a motor is there at all.
const QUICK: Patience = Patience { reply_timeout: Duration::from_millis(10), attempts: 2 };
/// How long a brake takes to open at the most.
const BRAKE_OPENING: Duration = Duration::from_millis(150);
/// How far a new zero may be from 0 after a restart, 0.01 degrees: the shaft may settle meanwhile.
const ZERO_TOLERANCE: i32 = 100;

/// Finds out which of `candidates` are on the bus, as many at a time as the master has places free.
/// `on_answer` gets each motor that is asked, and whether it is there, as soon as that is
/// known.
///
/// # Errors
/// [`CallError`]; [`RequestError::TooManyMotors`] if the master has no place free at all.
pub fn scan<R: Runner<N>, const N: usize>(
    runner: &mut R,
    candidates: MotorSet,
    mut on_answer: impl FnMut(MotorId, bool),
) -> Result<MotorSet, CallError<R::Error>> {
    let known = runner.master().motors();
    let (mut waiting, mut asked, mut found) = (candidates, MotorSet::EMPTY, MotorSet::EMPTY);
    while !(waiting.is_empty() && asked.is_empty()) {
        for motor in waiting.iter() {
            match runner.master().request_with(motor, ReadStatus1, QUICK) {
                Ok(_ticket) => {
                    waiting.remove(motor);
                    asked.insert(motor);
                }
                Err(RequestError::TooManyMotors { .. }) if !asked.is_empty() => break,
                // It is asked again when the request under way is over.
                Err(RequestError::Busy) => {}
                // What reports by itself is there.
                Err(RequestError::Reported(_)) => {
                    waiting.remove(motor);
                    found.insert(motor);
                    on_answer(motor, true);
                }
                Err(error) => return Err(error.into()),
            }
        }
        let Some(event) = runner.poll().map_err(CallError::Bus)? else {
            let until = runner.now() + LONGEST_IDLE;
            runner.idle(until);
            continue;
        };
        let (motor, there) = match event {
            Event::Reply { ticket, .. } => (ticket.motor(), true),
            Event::Failed { ticket, failure } => (ticket.motor(), failure != Failure::NoReply),
            Event::Report { motor, .. } | Event::LostMaster { motor } => (motor, true),
            _ => continue,
        };
        if there {
            found.insert(motor);
        }
        if matches!(event, Event::Reply { .. } | Event::Failed { .. }) && asked.contains(motor) {
            asked.remove(motor);
            on_answer(motor, found.contains(motor));
            if !known.contains(motor) {
                runner.master().forget(motor);
            }
        }
    }
    Ok(found)
}

/// What a motor is and how it does.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Identity {
    /// Its model (0xB5); `None` if it does not answer that, as firmware V4.4 does not.
    pub model: Option<ModelName>,
    /// The date of its software (0xB2).
    pub version: VersionDate,
    /// How long it has run since its last start (0xB1).
    pub run_time: Milliseconds,
    /// Which control loop runs (0x70).
    pub mode: Mode,
    /// Temperatures, brake, voltage and errors (0x9A).
    pub status: Status1,
}

/// Reads what a motor is and how it does.
///
/// # Errors
/// [`CallError`].
pub fn identify<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
) -> Result<Identity, CallError<R::Error>> {
    let model = match runner.ask(motor, ReadModel) {
        Ok(reply) => Some(reply.model),
        Err(CallError::Failed(Failure::NoReply)) => None,
        Err(error) => return Err(error),
    };
    Ok(Identity {
        model,
        version: runner.ask(motor, ReadVersionDate)?.version_date,
        run_time: runner.ask(motor, ReadRunTime)?.run_time,
        mode: runner.ask(motor, ReadRunningMode)?.mode,
        status: runner.ask(motor, ReadStatus1)?,
    })
}

/// Waits until a motor answers: after power-on or [`Reset`].
///
/// # Errors
/// [`BringUpError::NotThere`] if it does not within `time`; [`BringUpError::Call`] for other errors.
pub fn wait_until_there<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
    time: Duration,
) -> Result<(), BringUpError<R::Error>> {
    let deadline = runner.now() + time;
    loop {
        match runner.ask_with(motor, ReadStatus1, Some(QUICK), |_| {}) {
            Ok(_) | Err(CallError::Failed(Failure::Unreadable(_))) => return Ok(()),
            Err(CallError::Failed(_)) if runner.now() < deadline => {}
            Err(CallError::Failed(_)) => return Err(BringUpError::NotThere(motor)),
            Err(error) => return Err(error.into()),
        }
    }
}

/// Makes the current position the zero and sees that it is kept: stores it (0x64), restarts the
/// drive (0x76), and reads offset and angle back. The motor's output is switched off first, so the
/// shaft must be held by other means if a load pulls at it. Gives the new offset.
///
/// # Errors
/// [`BringUpError::ZeroNotKept`], [`BringUpError::NotThere`], [`BringUpError::Call`].
pub fn zero_here<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
) -> Result<EncoderPulses, BringUpError<R::Error>> {
    runner.ask(motor, Shutdown)?;
    let stored = runner.ask(motor, SetCurrentPositionZero)?.offset;
    restart(runner, motor, motor)?;
    let found = runner.ask(motor, ReadMultiTurnEncoderOffset)?.offset;
    let angle = runner.ask(motor, ReadMultiTurnAngle)?.angle;
    if found == stored && angle.raw().unsigned_abs() <= ZERO_TOLERANCE.unsigned_abs() {
        Ok(stored)
    } else {
        Err(BringUpError::ZeroNotKept { stored, found, angle })
    }
}

/// Gives the only motor on the bus another id (0x79) and restarts it. Every connected motor obeys
/// that command, so it is sent only if exactly `from` answers, and once.
///
/// # Errors
/// [`BringUpError::NotAlone`], [`BringUpError::IdShared`], [`BringUpError::IdTaken`],
/// [`BringUpError::NotThere`] if nobody answers
/// under the new id, [`BringUpError::Call`].
pub fn change_id<R: Runner<N>, const N: usize>(
    runner: &mut R,
    from: MotorId,
    to: MotorId,
) -> Result<(), BringUpError<R::Error>> {
    let there = scan(runner, MotorSet::ALL, |_, _| {})?;
    if from != to && there.contains(to) {
        return Err(BringUpError::IdTaken(to));
    }
    if there != MotorSet::from(from) {
        return Err(BringUpError::NotAlone(there));
    }
    if is_shared(runner, from)? {
        return Err(BringUpError::IdShared(from));
    }
    runner.master().broadcast(BusId::Write(to), to.into())?;
    // The reply is not needed: what counts is who answers after the restart.
    run_until(runner, None, |event| matches!(event, Event::BroadcastDone { .. }))?;
    restart(runner, from, to)?;
    runner.master().forget(from);
    Ok(())
}

/// Whether one question to this id is answered more than once. It is one whose answers differ, for equal
/// frames of two motors may become one on a CAN bus.
fn is_shared<R: Runner<N>, const N: usize>(
    runner: &mut R,
    id: MotorId,
) -> Result<bool, CallError<R::Error>> {
    const BOTH_HAVE_ANSWERED: Duration = Duration::from_millis(50);
    let is_second = |event: &Event| {
        let byte = Opcode::ReadRunTime.byte();
        matches!(event, Event::Stray { motor, data } if *motor == id && Some(data[0]) == byte)
    };
    let mut is_shared = false;
    runner.ask_with(id, ReadRunTime, None, |event| is_shared |= is_second(&event))?;
    let until = runner.now() + BOTH_HAVE_ANSWERED;
    Ok(is_shared || run_until(runner, Some(until), is_second)?)
}

/// Opens a motor's brake and waits until it is open, so that torque does not work against it (0x77,
/// 2.19.1).
///
/// # Errors
/// [`BringUpError::BrakeNotReleased`], [`BringUpError::Call`].
pub fn release_brake<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
) -> Result<(), BringUpError<R::Error>> {
    runner.ask(motor, ReleaseBrake)?;
    let open = runner.now() + BRAKE_OPENING;
    run_until(runner, Some(open), |_| false)?;
    match runner.ask(motor, ReadStatus1)?.brake {
        BrakeCommand::RELEASE => Ok(()),
        other => Err(BringUpError::BrakeNotReleased(other)),
    }
}

/// How far a motor has confirmed its communication-loss protection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub enum Protection {
    /// It replied with the time that it was given.
    Confirmed,
    /// It replied with this time instead; the manual's own example replies 0. No command reads the
    /// setting back, so try it: stop sending and see that the motor stops.
    AcknowledgedOnly(Milliseconds),
}

/// Sets after how long without a command a motor stops by itself (0xB3). It is kept in ROM.
///
/// # Errors
/// [`CallError`].
pub fn protect<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
    timeout: Milliseconds,
) -> Result<Protection, CallError<R::Error>> {
    let told = runner.ask(motor, CommunicationLossProtection { timeout })?.timeout;
    Ok(if told == timeout { Protection::Confirmed } else { Protection::AcknowledgedOnly(told) })
}

/// Restarts a drive (0x76) and waits until it answers, under another id perhaps.
///
/// # Errors
/// [`BringUpError::NotThere`] if it does not answer within 5 s, [`BringUpError::Call`].
pub fn restart<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
    then: MotorId,
) -> Result<(), BringUpError<R::Error>> {
    const LONGEST_RESTART: Duration = Duration::from_secs(5);
    runner.ask(motor, Reset)?;
    wait_until_there(runner, then, LONGEST_RESTART)?;
    // It was meant to.
    runner.master().resume(then);
    Ok(())
}

/// Runs the bus until then, or until the event has come, and says whether it has.
fn run_until<R: Runner<N>, const N: usize>(
    runner: &mut R,
    until: Option<Instant>,
    is_it: impl Fn(&Event) -> bool,
) -> Result<bool, CallError<R::Error>> {
    while until.is_none_or(|until| runner.now() < until) {
        match runner.poll().map_err(CallError::Bus)? {
            Some(event) if is_it(&event) => return Ok(true),
            Some(_) => {}
            None => runner.idle(until.unwrap_or(runner.now() + LONGEST_IDLE)),
        }
    }
    Ok(false)
}
