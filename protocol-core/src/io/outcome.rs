//! What ways of working return, and why they fail.

use core::fmt;

use crate::command::{BrakeCommand, ErrorFlags, Feedback, Mode, ModelName, Status1, VersionDate};
use crate::id::MotorId;
use crate::io::asking::CallError;
use crate::master::Failure;
use crate::time::Duration;
use crate::units::{Angle, CoarseSpeed, EncoderPulses, Milliseconds};

/// Why a motor could not be brought up as asked.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub enum BringUpError<E> {
    /// A call on the way has no answer.
    #[error(transparent)]
    Call(#[from] CallError<E>),
    /// The motor did not answer within the time given.
    #[error("motor {0} does not answer")]
    NotThere(MotorId),
    /// The new id already belongs to another motor.
    #[error("a motor with id {0} is on the bus already")]
    IdTaken(MotorId),
    /// The motor has not acknowledged its new id. It was not restarted, and is off. Switch its supply off and on to see
    /// which id it has kept.
    #[error(
        "motor {from} has not acknowledged id {to}, so it was not restarted, and is off: {}a scan shows what it has \
         kept when its supply was switched off and on",
        if *is_alone {
            ""
        } else {
            "connect it alone, to a line without noise, and try again with a new master, which can use 0x79 as well; "
        }
    )]
    IdNotTaken {
        /// The id that it had.
        from: MotorId,
        /// The id that it was given.
        to: MotorId,
        /// Whether it certainly was the only motor. If not, 0x79 was not tried: all motors obey it.
        is_alone: bool,
    },
    /// More than one motor answers under this id, as those from the factory do.
    #[error(
        "two motors seem to have id {0}: it answers some questions twice or not at all; connect only one of them"
    )]
    IdShared(MotorId),
    /// RS485: bytes that are no frame come also while nobody is asked, so that it is not known who has this id. Nothing
    /// was written.
    #[error(
        "the line is too noisy to tell who has id {0}: check its ends and its ground, or connect the motor alone"
    )]
    Noise(MotorId),
    /// The motor turns, and would run on if it were switched off. Stop it, wait until it stands and lift that stop.
    /// Nothing was written, and it was not switched off.
    #[error("motor {motor} turns at {speed}: stop it first, and wait until it stands")]
    Turns {
        /// The motor.
        motor: MotorId,
        /// How fast it turns.
        speed: CoarseSpeed,
    },
    /// The drive was told to restart several times and goes on running. What was written to its ROM before, a zero or
    /// an id, may be in force after its next start.
    #[error(
        "motor {0} was told to restart and goes on running: what was written to its ROM may be in force after its next \
         start; switch its supply off and on"
    )]
    NotRestarted(MotorId),
    /// The drive was told its new zero or id, and then this failed. So it is not known what is in its ROM; what was
    /// written may come into force with any later start.
    #[error(
        "motor {motor} may have its new zero or id in its ROM, in force from its next start on: {why}; restart it, and \
         read its angle, or scan, before it moves"
    )]
    MayBeWritten {
        /// The motor, by the id that it had before.
        motor: MotorId,
        /// Why the command that writes, or what followed it, has failed.
        why: CallError<E>,
    },
    /// The drive was told its protection time, and has not confirmed it: it may be the new or the old one.
    #[error(
        "motor {motor} may have the new protection time, or still the old one: {why}; set it again"
    )]
    MayBeProtected {
        /// The motor.
        motor: MotorId,
        /// Why the command has no answer.
        why: CallError<E>,
    },
    /// After the restart the zero is not where it was put.
    #[error(
        "motor {motor} has not kept its zero: stored at {stored}, after the restart the offset is {found} and the angle {angle}"
    )]
    ZeroNotKept {
        /// The motor.
        motor: MotorId,
        /// The offset that the motor said it stored.
        stored: EncoderPulses,
        /// The offset that it has now.
        found: EncoderPulses,
        /// The angle that it reads now.
        angle: Angle,
    },
    /// The drive does not report release as its brake's last command: it may have restarted meanwhile, or have heard
    /// nothing for longer than its protection (0xB3) allows.
    #[error("motor {motor}: the brake was told to release and says {says}")]
    BrakeNotReleased {
        /// The motor.
        motor: MotorId,
        /// The brake's last command, as the drive reports it.
        says: BrakeCommand,
    },
    /// The drive reports an error, so nothing would hold the shaft after the brake opens. The brake is locked, or was
    /// told to lock, whether the drive answered that or not.
    #[error(
        "motor {motor} reports an error ({errors}): nothing would hold its shaft behind an open brake"
    )]
    Fault {
        /// The motor.
        motor: MotorId,
        /// What its drive reports.
        errors: ErrorFlags,
    },
    /// The brake is open, and the motor does not hold its shaft, which turns. Either the motor runs nothing or, if it
    /// does not answer that (0x70), draws no current: something has switched it off since it was told to hold, or it
    /// did not obey. Or it runs, and has not brought the shaft to rest within half a second: the load may be too heavy.
    /// The brake is locked, or was told to lock.
    #[error(
        "motor {motor} turns at {speed} behind its open brake: it does not hold, or was switched off meanwhile; the brake \
         is told to lock again"
    )]
    NotHeld {
        /// The motor.
        motor: MotorId,
        /// How fast it turned.
        speed: CoarseSpeed,
    },
    /// The shaft turns although its brake was told to lock and has had the time to, or after the motor was then
    /// switched off. Some brakes slip only then, and some motors have none. Nothing was written.
    ///
    /// A motor that may have held the shaft before is told to hold it again. It does not if a stop in force refuses
    /// that, until it is [lifted](crate::master::Master::lift_stop_of), or if the motor reports an error. Then [open
    /// the brake](crate::io::bring_up::release_brake), or intervene by other means.
    #[error(
        "motor {motor}: its brake was told to lock (0x78) and does not hold: the shaft turns at {speed}{}",
        match *holds {
            Some(true) => "; it is open again, and the motor holds: do not switch it off",
            Some(false) => "",
            None => "; it has not confirmed that it is open again and that the motor holds",
        }
    )]
    BrakeSlips {
        /// The motor.
        motor: MotorId,
        /// How fast it turns.
        speed: CoarseSpeed,
        /// Whether its brake is open again and the motor has confirmed that it holds; `None` if it was told to and has
        /// not confirmed.
        holds: Option<bool>,
    },
    /// The drive does not report lock as its brake's last command; it may have no brake. Whatever holds a load must go
    /// on holding it.
    #[error(
        "motor {motor}: the brake was told to lock and says {says}: do not switch off what holds a load"
    )]
    BrakeNotLocked {
        /// The motor.
        motor: MotorId,
        /// The brake's last command, as the drive reports it.
        says: BrakeCommand,
    },
}

impl<E> BringUpError<E> {
    /// The same error after a write: what a drive was told to write may be in its ROM, whatever came then.
    pub(super) fn behind_a_write(self, motor: MotorId) -> Self {
        match self {
            Self::Call(why) => Self::MayBeWritten { motor, why },
            Self::NotThere(silent) => {
                let why = CallError::Failed { motor: silent, failure: Failure::NoReply };
                Self::MayBeWritten { motor, why }
            }
            error => error,
        }
    }
}

/// What a motor is, and its state.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Identity {
    /// Its model (0xB5); `None` if it does not answer that, as with firmware V4.4.
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

/// How far a motor has confirmed its communication-loss protection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub enum Protection {
    /// It replied with the time that it was given; 0 where the protection was switched off.
    Confirmed,
    /// It replied with this time instead; in the manual's own example it replies 0. No command reads the setting back,
    /// so try it: stop sending and check that the motor stops.
    AcknowledgedOnly(Milliseconds),
}

/// A look at a motor on its way.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct MoveProgress {
    /// Where the move began.
    pub from: Angle,
    /// Where it is to end.
    pub target: Angle,
    /// How long the move has taken so far.
    pub time: Duration,
    /// Where the motor is.
    pub angle: Angle,
    /// Its temperature, torque current and speed.
    pub feedback: Feedback,
}

/// Why a motor has not arrived.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub enum MoveFailure<E> {
    /// A call on the way has no answer.
    #[error(transparent)]
    Call(#[from] CallError<E>),
    /// A relative move ends further away than an angle can be.
    #[error("from {here} the move ends further than an angle can be")]
    OutOfRange {
        /// Where the motor is.
        here: Angle,
    },
    /// The torque limit is 0 % (0xA9). The manual does not say what that does, and for 0xA2 a 0 means no limit. No move
    /// was sent.
    #[error("a move with at most 0 % of the torque may be one without a limit: give 1 to 255 %")]
    NoTorque,
    /// The drive reports errors, for which it cuts its output. Its brake was told to lock: nothing else holds its shaft,
    /// although it confirms the stop.
    #[error("the drive reports an error ({0}): only a locked brake holds its shaft")]
    Fault(ErrorFlags),
    /// It came no nearer for a while, and stands.
    #[error(
        "it is at {at} and comes no nearer to {target} (a load, a brake, a limit of angle or what it grips already may \
         hold it, or something else commands it)"
    )]
    Stalled {
        /// Where it is.
        at: Angle,
        /// Where it should be.
        target: Angle,
    },
    /// It came no nearer for a while, and does not stand either: a load drives it away, it swings, or something else
    /// commands it.
    #[error(
        "it is at {at}, turns at {speed} and comes no nearer to {target}: a load drives it away, it swings, or something else \
         commands it"
    )]
    Turning {
        /// Where it is.
        at: Angle,
        /// Where it should be.
        target: Angle,
        /// How fast it turned last.
        speed: CoarseSpeed,
    },
    /// Its drive runs nothing any more: something else has switched it off, or it heard nothing for longer than its
    /// protection (0xB3) allows. Its shaft is free unless a brake holds it.
    #[error(
        "it is at {at} and runs nothing: it was switched off, or heard nothing for longer than its protection (0xB3) \
         allows"
    )]
    LetGo {
        /// Where it is.
        at: Angle,
    },
    /// It has not answered the move, or nothing since. It may have moved, in part or all the way: check where it is
    /// before you send a relative move again.
    #[error("it was at {at} and does not answer: it may have moved since, in part or all the way")]
    Silent {
        /// Where it was last.
        at: Angle,
    },
    /// The time is up.
    #[error("it is at {at} and not at {target} when its time is up")]
    TimedOut {
        /// Where it is.
        at: Angle,
        /// Where it should be.
        target: Angle,
    },
    /// `on_look` gave the move up.
    #[error("the move was given up")]
    GivenUp,
    /// Another call is moving the motor, and goes on. This call has sent it nothing, not even a stop. Only handles that
    /// threads share know of each other's moves.
    #[error("another move of it is under way and goes on: wait for its end, or stop the motor")]
    UnderWay,
}

/// A motor has not arrived, and was told to stop because of that, unless [another move](MoveFailure::UnderWay) has it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct NotArrived<E> {
    /// The motor.
    pub motor: MotorId,
    /// Why.
    pub why: MoveFailure<E>,
    /// Whether it has confirmed the [stop](crate::io::bring_up::MoveLimits::stop). If not, **cut its power**, unless
    /// another move [is under way](MoveFailure::UnderWay): that one goes on. Also a motor
    /// [with an error](MoveFailure::Fault) confirms, and holds nothing.
    pub is_stopped: bool,
}

impl<E: fmt::Debug> fmt::Display for NotArrived<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "motor {} has not arrived: ", self.motor)?;
        match &self.why {
            // The motor is named already.
            MoveFailure::Call(CallError::Failed { failure, .. }) => failure.fmt(f)?,
            MoveFailure::Call(CallError::Refused { refusal, .. }) => refusal.fmt(f)?,
            why => why.fmt(f)?,
        }
        f.write_str(match (&self.why, self.is_stopped) {
            // Nobody has told it to stop.
            (MoveFailure::UnderWay, _) => "",
            (_, true) => "; it has confirmed the stop, which stays in force until it is lifted",
            (_, false) => "; it has not confirmed the stop: cut its power",
        })
    }
}

impl<E: fmt::Debug> core::error::Error for NotArrived<E> {}
