//! First contact and safe ways of working: plain functions over any [`Runner`]. For tasks there are the
//! same in [`async_bring_up`](crate::io::async_bring_up).
//!
//! They wait for what they ask; use them before a control loop runs, not inside one. Set-points and
//! events of other motors are passed over meanwhile.

use core::ops::ControlFlow;

use embassy_futures::block_on;

use crate::command::{BrakeCommand, ErrorFlags, Mode, ModelName, Status1, VersionDate};
use crate::id::MotorId;
use crate::io::asking::CallError;
use crate::io::async_bring_up as task;
pub use crate::io::brake::BRAKE_MOVES;
pub use crate::io::move_to::{
    MoveCommand, MoveFailure, MoveLimits, MoveProgress, NotArrived, WhenStalled,
};
use crate::io::on_drop::OnDrop;
use crate::io::polled::Polled;
use crate::io::runner::Runner;
pub use crate::io::standing::turns;
use crate::master::{Failure, MotorSet, StopKind};
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
    /// The id that is to be given is somebody's already.
    #[error("a motor with id {0} is on the bus already")]
    IdTaken(MotorId),
    /// The motor has not acknowledged its new id. It was not restarted, and is off; whether it has kept the id
    /// shows when its supply was switched off and on.
    #[error(
        "motor {from} has not acknowledged id {to}, so it was not restarted, and is off: {}what it has kept \
         shows when its supply was switched off and on",
        if *is_alone { "" } else { "connect it alone, so that 0x79 can be tried as well; " }
    )]
    IdNotTaken {
        /// The id that it had.
        from: MotorId,
        /// The id that it was given.
        to: MotorId,
        /// Whether it was the only motor. If not, 0x79 was not tried: all motors obey it.
        is_alone: bool,
    },
    /// More than one motor answers under this id, as those from the factory do.
    #[error(
        "two motors seem to have id {0}: it answers some questions twice or not at all; connect only one of them"
    )]
    IdShared(MotorId),
    /// The motor turns, and would run on when it is switched off. Stop it, wait until it stands and lift that stop.
    /// Nothing was written, and it was not switched off.
    #[error("motor {motor} turns at {speed}: stop it first")]
    Turns {
        /// The motor.
        motor: MotorId,
        /// How fast it turns.
        speed: CoarseSpeed,
    },
    /// The drive was told to restart, again and again, and goes on running. What was written to its ROM before, a zero or
    /// an id, may be in force after its next start.
    #[error(
        "motor {0} was told to restart and goes on running: what was written to its ROM may be in force after its next \
         start; switch its supply off and on"
    )]
    NotRestarted(MotorId),
    /// The drive was told its new zero or id, and this came then, so that nobody knows what is in its ROM. It may come
    /// into force with any later start.
    #[error(
        "motor {motor} may have its new zero or id in its ROM, in force from its next start on: {why}; restart it, and \
         read its angle, or scan, before it moves"
    )]
    MayBeWritten {
        /// The motor, as it was called before.
        motor: MotorId,
        /// What came of the command that writes, or of what followed it.
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
    /// The drive does not return release as its brake's last command.
    #[error("motor {motor}: the brake was told to release and says {says}")]
    BrakeNotReleased {
        /// The motor.
        motor: MotorId,
        /// What its drive says that the brake was told last.
        says: BrakeCommand,
    },
    /// The drive reports an error, so that nothing would hold the shaft behind a brake that opens. It is locked, or was
    /// told to be, whether that was answered or not.
    #[error(
        "motor {motor} reports an error ({errors}): nothing would hold its shaft behind an open brake"
    )]
    Fault {
        /// The motor.
        motor: MotorId,
        /// What its drive reports.
        errors: ErrorFlags,
    },
    /// The shaft turns, its brake open, and the motor runs nothing that could hold it, or draws no current where it does
    /// not say (0x70): something has switched it off since it was told to hold, or it did not obey. Its brake is locked, or
    /// was told to be.
    #[error(
        "motor {0} turns though it was told to hold while its brake opened: the brake is told to lock again"
    )]
    LetGo(MotorId),
    /// The shaft turns behind a brake that was told to lock and has had the time to, or behind a motor that was switched
    /// off then: some brakes show only then that they slip, and some motors have none. A motor that may have held before
    /// is told to hold again. Where it does not: a stop in force refuses that until it is
    /// [lifted](crate::master::Master::lift_stop_of), and whoever reports an error holds nothing;
    /// [open the brake](release_brake), or cut in otherwise. Nothing was written.
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
        /// Whether its brake is open again, and it has confirmed that it holds; `None` if it was told to, and has not.
        holds: Option<bool>,
    },
    /// The drive does not return lock as its brake's last command: it may have none. What holds a load is to go on.
    #[error(
        "motor {motor}: the brake was told to lock and says {says}: do not switch off what holds a load"
    )]
    BrakeNotLocked {
        /// The motor.
        motor: MotorId,
        /// What its drive says that the brake was told last.
        says: BrakeCommand,
    },
}

impl<E> BringUpError<E> {
    /// The same behind a write: what a drive was told to write may be in its ROM, whatever has come then.
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

/// How far a motor has confirmed its communication-loss protection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub enum Protection {
    /// It replied with the time that it was given: 0 where it was switched off.
    Confirmed,
    /// It replied with this time instead; the manual's own example replies 0. No command reads the
    /// setting back, so try it: stop sending and see that the motor stops.
    AcknowledgedOnly(Milliseconds),
}

/// Finds out which of `candidates` are on the bus, as many at a time as the master has places free.
/// `on_answer` gets each motor that is asked, and whether it is there, as soon as that is
/// known. Motors that share an id, as those from the factory do, are found as one on CAN; on RS485 their
/// answers collide, and nobody may be found: connect one at a time.
///
/// [`stop_all`](Runner::stop_all) and a [`Guard`](crate::io::Guard) reach those that were found, however this ends. If
/// the master has too few places for all of them, none keeps one that it did not have before: then
/// these get the one stop that goes to all, and confirm nothing. Ids without a motor take no place.
///
/// # Errors
/// [`CallError`]; [`Failure::BusDown`], of any of the candidates, if the bus
/// carries nothing, as CAN does when nobody is there to acknowledge;
/// [`TooManyMotors`](crate::error::RequestError::TooManyMotors) if the master has no place free at all.
pub fn scan<R: Runner<N>, const N: usize>(
    runner: &mut R,
    candidates: MotorSet,
    on_answer: impl FnMut(MotorId, bool),
) -> Result<MotorSet, CallError<R::Error>> {
    block_on(task::scan(&mut Polled(runner), candidates, on_answer))
}

/// Reads what a motor is and how it does.
///
/// # Errors
/// [`CallError`].
pub fn identify<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
) -> Result<Identity, CallError<R::Error>> {
    block_on(task::identify(&mut Polled(runner), motor))
}

/// Whether anything answers under this id. An id that nobody answers at gets no place in the master that it did not
/// have.
///
/// # Errors
/// [`CallError`], but not that nobody answers.
pub fn is_there<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
) -> Result<bool, CallError<R::Error>> {
    block_on(task::is_there(&mut Polled(runner), motor))
}

/// Waits until a motor answers: after power-on or a restart (0x76).
///
/// # Errors
/// [`BringUpError::NotThere`] if it does not within `time`; [`BringUpError::Call`] for other errors.
pub fn wait_until_there<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
    time: Duration,
) -> Result<(), BringUpError<R::Error>> {
    block_on(task::wait_until_there(&mut Polled(runner), motor, time))
}

/// Makes the current position the zero and sees that it is kept: stores it (0x64), restarts the
/// drive (0x76), and reads offset and angle back. The motor's output is switched off first. What it holds, its
/// brake is told to hold before (0x78). A load that falls all the same, of a motor without a brake say, is held again, and
/// refused: hold such a shaft by other means. A motor that turns is refused. Gives the new offset. Where several motors
/// have this id all of them do this: see first whether it [is shared](is_shared).
///
/// # Errors
/// [`BringUpError::Turns`], [`BringUpError::BrakeSlips`]; [`BringUpError::Call`] if it was not told;
/// [`BringUpError::ZeroNotKept`], [`BringUpError::NotRestarted`] and [`BringUpError::MayBeWritten`] if it was.
pub fn zero_here<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
) -> Result<EncoderPulses, BringUpError<R::Error>> {
    block_on(task::zero_here(&mut Polled(runner), motor))
}

/// Gives a motor another id: switches it off, writes the id to its ROM and restarts it. Function 5 (0x20)
/// names the motor; if it does not acknowledge that and is the only one on the bus, 0x79 is tried, which all
/// connected motors obey. What the motor holds, its brake is told to hold before (0x78); a load that falls all the same is
/// held again, and refused. A motor that turns is refused.
///
/// It asks all ids first, and both of these afterwards, so the master needs a place for each of them besides those of
/// the other motors that it knows: `CanMaster<_, _, 8>` for six motors, say. Without them nothing is written.
///
/// # Errors
/// [`BringUpError::NotThere`], [`BringUpError::IdTaken`], [`BringUpError::IdShared`], [`BringUpError::Turns`],
/// [`BringUpError::BrakeSlips`]; [`BringUpError::Call`] if it was not told; [`BringUpError::IdNotTaken`],
/// [`BringUpError::NotRestarted`] and [`BringUpError::MayBeWritten`] if it was.
pub fn change_id<R: Runner<N>, const N: usize>(
    runner: &mut R,
    from: MotorId,
    to: MotorId,
) -> Result<(), BringUpError<R::Error>> {
    block_on(task::change_id(&mut Polled(runner), from, to))
}

/// Whether more than one motor seems to have this id, as far as that can be heard: some questions are
/// answered twice, or not at all, since answers collide. They are asked again and again, since equal frames
/// of two motors may become one on a CAN bus. Takes half a second. `true`, too, if nobody answers: ask
/// [`is_there`] first.
///
/// `true`, too, of one motor that another master asks the same, or that it has had report by itself (0xB6), for each
/// report is like a second answer. Have that master end it, or [end the reports](crate::command::ActiveReply) here,
/// which does two motors no harm, and ask again. Reports that this master has switched on itself are an error: a motor
/// may not answer what it reports. Those of errors (function 3) are told apart.
///
/// # Errors
/// [`CallError`]; [`Reported`](crate::error::RequestError::Reported) for what this master has had the motor report.
pub fn is_shared<R: Runner<N>, const N: usize>(
    runner: &mut R,
    id: MotorId,
) -> Result<bool, CallError<R::Error>> {
    block_on(task::is_shared(&mut Polled(runner), id))
}

/// Opens a motor's brake and waits until it is open, so that torque does not work against it (0x77,
/// 2.19.1). The motor holds its shaft from the beginning (0x81), so that no load falls; one that moves is stopped by that,
/// whoever moves it. A shaft that is to turn freely is let go behind it, by [`Shutdown`](crate::command::Shutdown).
///
/// Speed and position commands open a brake by themselves, and hold.
///
/// # Errors
/// [`BringUpError::Fault`], [`BringUpError::BrakeNotReleased`], [`BringUpError::LetGo`], [`BringUpError::Call`]. If the
/// motor does not answer that its brake is to open, or that it is to hold, or the bus fails then, the brake may be open
/// all the same: it is [stopped](crate::master::Master::stop), until that is lifted. It is told to hold when an answer is
/// late, so let [`Config::reply_timeout`](crate::master::Config::reply_timeout) be no longer than a load may fall. Where
/// somebody else has switched it off meanwhile, its brake may be open, too: lock that, which no stop refuses.
pub fn release_brake<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
) -> Result<(), BringUpError<R::Error>> {
    block_on(task::release_brake(&mut Polled(runner), motor))
}

/// Locks the brake of a motor that stands, and waits until it has had the time to (0x78, 2.28). The motor can be switched
/// off behind it, as it is when nobody speaks to it any more and its protection is set (0xB3): before that, a load falls
/// until the brake holds.
///
/// ```
/// use myactuator_protocol_core::io::Runner;
/// use myactuator_protocol_core::io::bring_up::{self, BringUpError};
/// use myactuator_protocol_core::master::StopKind;
/// use myactuator_protocol_core::MotorId;
///
/// /// Whether it has confirmed that it is off. Before that it has to stand.
/// fn put_down<R: Runner<8>>(bus: &mut R, arm: MotorId) -> Result<bool, BringUpError<R::Error>> {
///     bring_up::lock_brake(bus, arm)?;
///     let is_off = bus.stop(arm, StopKind::Off);
///     if let Err(slips) = bring_up::check_brake(bus, arm) {
///         // The motor holds behind an open brake only.
///         bus.master().lift_stop_of(arm);
///         bring_up::release_brake(bus, arm)?;
///         return Err(slips);
///     }
///     Ok(is_off)
/// }
/// ```
///
/// It looks at the shaft behind the brake: where that slips, a motor that ran something or drew a current is told to hold
/// again, as by [`release_brake`], and a stop may be left in force as there. Some show only when the motor is off that they
/// slip: [look again](check_brake) then. A motor that turns is refused while it runs and can be stopped; where it runs
/// nothing, or reports an error, its brake is to catch what falls.
///
/// # Errors
/// [`BringUpError::Turns`], [`BringUpError::BrakeNotLocked`], [`BringUpError::BrakeSlips`], [`BringUpError::Call`].
pub fn lock_brake<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
) -> Result<(), BringUpError<R::Error>> {
    block_on(task::lock_brake(&mut Polled(runner), motor))
}

/// Sees whether the shaft of a motor that is off stands, behind a brake that was told to [lock](lock_brake): for the
/// 200 ms in which a load turns one that nothing holds. What falls is not held again.
///
/// # Errors
/// [`BringUpError::BrakeSlips`], [`BringUpError::Call`].
pub fn check_brake<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
) -> Result<(), BringUpError<R::Error>> {
    block_on(task::check_brake(&mut Polled(runner), motor))
}

/// Sets after how long without a command a motor stops by itself (0xB3); 0 switches that off. It is kept in ROM.
///
/// From then on the motor has to be spoken to without longer pauses, also while a stop holds it; whoever speaks is
/// enough, a thread that reads temperatures while the loop hangs, too. After a longer pause it may answer and not obey
/// until it is spoken to steadily again (2.31.1). A load falls until its brake holds: [lock](lock_brake) that before you
/// fall silent on purpose. Its brake has locked by then, which torque and motion
/// commands do not open: [release](release_brake) it again. What waits here speaks to its own motor alone,
/// [`move_to`] every 20 ms: below 50 ms the protection may end a move.
///
/// # Errors
/// [`CallError`].
pub fn protect<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
    timeout: Milliseconds,
) -> Result<Protection, CallError<R::Error>> {
    block_on(task::protect(&mut Polled(runner), motor, timeout))
}

/// Restarts a drive (0x76) and waits until it answers, under another id perhaps. One that goes on running, as 0xB1 says or
/// because it answers under its old id, has not heard that, and is told again. Its output goes off: what the motor holds,
/// its brake is told to hold before (0x78) and it is switched off, and one that turns while it runs, or falls then, is
/// refused. So is the brake told of one that answers nothing, which may hear all the same. A stop in force refuses this.
/// Whole turns are lost unless multi-turn saving ([function 4](crate::command::FunctionControl::SaveMultiTurn)) is on, and
/// it may be moved at once afterwards: read its angle first.
///
/// # Errors
/// [`BringUpError::Turns`], [`BringUpError::BrakeSlips`]; [`BringUpError::NotThere`] if it does not answer within 5 s,
/// [`BringUpError::NotRestarted`] if it goes on running; [`BringUpError::Call`].
pub fn restart<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
    then: MotorId,
) -> Result<(), BringUpError<R::Error>> {
    block_on(task::restart(&mut Polled(runner), motor, then))
}

/// Moves a motor to an angle, or by one, and watches it until it stands there; then it holds its position. It
/// must be ready to move: its brake open, no error.
///
/// `on_look` gets every look at the motor, some fifty a second, and may give the move up. Nobody watches the motor
/// while it takes its time, nor hears of errors that others report: where others hold loads, move with set-points, or run
/// the bus in a thread of its own.
///
/// ```no_run
/// # use core::ops::ControlFlow;
/// # use myactuator_protocol_core::command::AbsolutePosition;
/// # use myactuator_protocol_core::io::{Runner, bring_up};
/// # use myactuator_protocol_core::units::{Angle, MaxSpeed};
/// # use myactuator_protocol_core::MotorId;
/// # fn reach<R: Runner<8>>(bus: &mut R, elbow: MotorId) -> Result<(), Box<dyn std::error::Error>>
/// # where R::Error: 'static {
/// let command = AbsolutePosition {
///     max_speed: MaxSpeed::from_dps(90.0)?,
///     angle: Angle::from_degrees(45.0)?,
/// };
/// let go_on = |_: &_| ControlFlow::Continue(());
/// let arrival = bring_up::move_to(bus, elbow, command, &Default::default(), go_on)
///     .map_err(|error| error.to_string())?;
/// # let _ = arrival; Ok(()) }
/// ```
///
/// # Errors
/// [`NotArrived`], after a stop, which stays in force until [`lift_stop_of`](crate::master::Master::lift_stop_of): it
/// has stalled ([a gripper may](WhenStalled::Press)), is driven away or has let go, its time is up, it reports
/// an error, has restarted or does not answer, `on_look` gave it up, or the move is one that is not sent
/// ([`MoveFailure::NoTorque`], [`MoveFailure::OutOfRange`]). A panic of `on_look` stops it, too.
pub fn move_to<R: Runner<N>, C: MoveCommand, const N: usize>(
    runner: &mut R,
    motor: MotorId,
    command: C,
    limits: &MoveLimits,
    on_look: impl FnMut(&MoveProgress) -> ControlFlow<()>,
) -> Result<MoveProgress, NotArrived<R::Error>> {
    // A panic leaves no future that the stop could go out with, which that one has put: whom it lets go stays so.
    let moving = OnDrop::new(runner, |runner: &mut &mut R| {
        let _is_stopped = runner.stop(motor, StopKind::Hold);
    });
    let result = block_on(task::move_to(&mut Polled(moving.it), motor, command, limits, on_look));
    moving.end();
    result
}
