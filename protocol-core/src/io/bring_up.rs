//! First contact and safe ways of working: plain functions over any [`Runner`]. For tasks the same functions are in
//! [`async_bring_up`](crate::io::async_bring_up).
//!
//! They wait for what they ask. Meanwhile the caller can put no set-points, and events of other motors are ignored. So
//! use them before a control loop runs, not inside one. A function that waits asks all motors that have a place in the
//! master for their run times (0xB1) all the while, so that none lets go because it [hears nothing](protect). It cannot
//! speak to motors of another bus: with several buses, give each a thread or a task of its own.
//!
//! All motors that have the named id obey, on a bus of motors as they come from the factory often several. Find out
//! first whether an id [is shared](is_shared).
//!
//! **After a crash or a watchdog's reset motors may still run as they were told.** Stop those of your robot first, by
//! their ids: `bus.stop_all(StopKind::Hold, ids)`. They may have lost their master (0xB3), so each has to answer three
//! times before that counts as confirmed.
//!
//! # While a function here waits
//! Some take seconds. To look at a button meanwhile, or to feed a watchdog, give them a loop of your own around that of
//! the bus. A stop that it calls for is sent before anything else. It ends the function, unless that only waits
//! ([`wait_until_there`], [`wait_until_stands`], and a [brake](release_brake) that opens behind a motor that is to hold).
//! Before you lift a stop, look whether there was another: [`lift_stop_if`](crate::master::Master::lift_stop_if).
//!
//! ```
//! use myactuator_protocol_core::io::Runner;
//! use myactuator_protocol_core::master::{Event, Master, MotorSet, StopKind};
//! use myactuator_protocol_core::time::Instant;
//!
//! struct Attended<R, B> {
//!     bus: R,
//!     /// Whether the button was pressed since this was last called. Also feeds the watchdog.
//!     was_pressed: B,
//! }
//!
//! impl<R: Runner<8>, B: FnMut() -> bool> Runner<8> for Attended<R, B> {
//!     type Error = R::Error;
//!
//!     fn master(&mut self) -> &mut Master<8> {
//!         self.bus.master()
//!     }
//!
//!     fn now(&self) -> Instant {
//!         self.bus.now()
//!     }
//!
//!     fn poll(&mut self) -> Result<Option<Event>, R::Error> {
//!         if (self.was_pressed)() {
//!             // It is refused only if the master has no place for a motor that is named.
//!             let _ = self.bus.master().stop_all(StopKind::Hold, MotorSet::EMPTY);
//!         }
//!         self.bus.poll()
//!     }
//!
//!     fn idle(&mut self, until: Instant) {
//!         self.bus.idle(until);
//!     }
//! }
//! ```
//!
//! # Functions that switch a motor off
//! [`zero_here`], [`change_id`] and [`restart`] are refused while a stop is in force for the motor, and switch it off
//! before they write or restart anything. If it may hold a load, its brake is told to lock (0x78) before. If the load
//! falls all the same, of a motor without a brake for example, the motor is told to hold it again, and is refused: hold
//! such a shaft by other means.

use core::ops::ControlFlow;

use embassy_futures::block_on;

use crate::id::MotorId;
use crate::io::asking::CallError;
use crate::io::async_bring_up as task;
pub use crate::io::brake::BRAKE_MOVES;
pub use crate::io::move_to::{MoveCommand, MoveLimits, WhenStalled};
use crate::io::on_drop::OnDrop;
pub use crate::io::outcome::{
    BringUpError, Identity, MoveFailure, MoveProgress, NotArrived, Protection,
};
use crate::io::polled::Polled;
use crate::io::runner::Runner;
pub use crate::io::standing::turns;
use crate::master::{MotorSet, StopKind};
use crate::time::Duration;
use crate::units::{EncoderPulses, Milliseconds};

/// Finds out which of `candidates` are on the bus. Asks as many at a time as the master has free places. As soon as the
/// outcome for a motor is known, `on_answer` gets the motor and whether it is there.
///
/// Motors that share an id, as those from the factory do, are found as one on CAN. On RS485 their answers collide, and
/// none may be found: connect one at a time.
///
/// Each id is asked twice at most. On a bus that loses frames a motor may not be found: compare what was found with the
/// motors that your robot has, before anything moves.
///
/// [`stop_all`](Runner::stop_all) and a [`Guard`](crate::io::Guard) reach the motors that were found, however this
/// ends. If the master has too few places for all of them, none keeps a place that it did not have before; they then
/// get the one stop that goes to all, and confirm nothing. Ids without a motor take no place. A stop ends the search,
/// as soon as all that were asked have answered it or have not.
///
/// # Errors
/// [`CallError`], among them:
///
/// - [`Failure::BusDown`](crate::master::Failure::BusDown), of any of the candidates, if the bus carries nothing,
///   such as a CAN bus on which no other node is there to acknowledge.
/// - [`TooManyMotors`](crate::error::RequestError::TooManyMotors) if the master has no free place at all.
pub fn scan<R: Runner<N>, const N: usize>(
    runner: &mut R,
    candidates: MotorSet,
    on_answer: impl FnMut(MotorId, bool),
) -> Result<MotorSet, CallError<R::Error>> {
    block_on(task::scan(&mut Polled(runner), candidates, on_answer))
}

/// Reads what a motor is, and its state.
///
/// # Errors
/// [`CallError`].
pub fn identify<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
) -> Result<Identity, CallError<R::Error>> {
    block_on(task::identify(&mut Polled(runner), motor))
}

/// Whether anything answers under this id. If nothing does, the id gets no place in the master that it did not have.
///
/// # Errors
/// [`CallError`]; but no answer is `false`, not an error.
pub fn is_there<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
) -> Result<bool, CallError<R::Error>> {
    block_on(task::is_there(&mut Polled(runner), motor))
}

/// Waits until a motor answers, after power-on or a restart (0x76) for example. A stop does not end this.
///
/// # Errors
/// [`BringUpError::NotThere`] if it does not answer within `time`; [`BringUpError::Call`] for other errors.
pub fn wait_until_there<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
    time: Duration,
) -> Result<(), BringUpError<R::Error>> {
    block_on(task::wait_until_there(&mut Polled(runner), motor, time))
}

/// Waits until a motor stands: after a stop, which is confirmed while the shaft still turns, and before
/// [`lock_brake`], [`zero_here`] or [`restart`], which refuse a motor that turns. Looks at it every 20 ms, until it
/// stands at six looks in a row: a load that swings stands for a moment, too. A stop in force does not refuse this, and
/// one that comes meanwhile does not end it.
///
/// # Errors
/// [`BringUpError::Turns`] if it turns after `time`; [`BringUpError::Call`].
pub fn wait_until_stands<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
    time: Duration,
) -> Result<(), BringUpError<R::Error>> {
    block_on(task::wait_until_stands(&mut Polled(runner), motor, time))
}

/// Makes the current position the zero, checks that it is kept, and returns the new offset. Stores the zero (0x64),
/// restarts the drive (0x76), and reads offset and angle back.
///
/// - The motor is [switched off](self#functions-that-switch-a-motor-off) first. One that turns is refused. Any other is
///   off afterwards.
/// - If several motors have this id, all of them do this: check first whether the id [is shared](is_shared).
///
/// # Errors
/// - [`BringUpError::Turns`], [`BringUpError::BrakeSlips`], and [`BringUpError::Call`] if the motor was not told to
///   store its zero;
/// - [`BringUpError::ZeroNotKept`], [`BringUpError::NotRestarted`] and [`BringUpError::MayBeWritten`] if it was.
pub fn zero_here<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
) -> Result<EncoderPulses, BringUpError<R::Error>> {
    block_on(task::zero_here(&mut Polled(runner), motor))
}

/// Gives a motor another id: [switches it off](self#functions-that-switch-a-motor-off), writes the id to its ROM and
/// restarts it.
///
/// - Function 5 (0x20) names the motor, so it comes first. If the motor does not acknowledge that and is the only one
///   on the bus, 0x79 is tried, which all connected motors obey. It does not count as the only one if the master knows
///   another ([forget](crate::master::Master::forget) those that are not connected any more), or if bytes came that are
///   no frame: that may be two motors with one id (RS485).
/// - A motor that turns is refused.
/// - This asks all ids first, and both of these afterwards. So the master needs a place for each of the two besides
///   those of the other motors that it knows: `CanMaster<_, _, 8>` for six motors, for example. Without them nothing is
///   written.
///
/// # Errors
/// - [`BringUpError::NotThere`], [`BringUpError::IdTaken`], [`BringUpError::IdShared`], [`BringUpError::Noise`],
///   [`BringUpError::Turns`], [`BringUpError::BrakeSlips`], and [`BringUpError::Call`] if the motor was not told its
///   id;
/// - [`BringUpError::IdNotTaken`], [`BringUpError::NotRestarted`] and [`BringUpError::MayBeWritten`] if it was, and
///   [`BringUpError::IdShared`] if another motor answers under either id then.
pub fn change_id<R: Runner<N>, const N: usize>(
    runner: &mut R,
    from: MotorId,
    to: MotorId,
) -> Result<(), BringUpError<R::Error>> {
    block_on(task::change_id(&mut Polled(runner), from, to))
}

/// Whether more than one motor seems to have this id, as far as that can be heard: some questions are answered twice,
/// or not at all because answers collide. The questions are repeated, since equal frames of two motors may become one
/// on a CAN bus. Takes half a second, or a whole one if it is shared.
///
/// Also returns `true`:
///
/// - if nobody answers: ask [`is_there`] first;
/// - of one motor that another master asks the same, or has told to report (0xB6): each report looks like a second
///   answer. Have that master end it, or [end the reports](crate::command::ActiveReply) here, which does no harm to two
///   motors, and ask again;
/// - on a bus that doubles frames now and then.
///
/// Reports that this master has switched on are an error, because a motor may not answer what it reports. Reports of
/// errors (function 3) do not count as second answers.
///
/// # Errors
/// [`CallError`]; [`Reported`](crate::error::RequestError::Reported) for what this master has told the motor to report.
pub fn is_shared<R: Runner<N>, const N: usize>(
    runner: &mut R,
    id: MotorId,
) -> Result<bool, CallError<R::Error>> {
    block_on(task::is_shared(&mut Polled(runner), id))
}

/// Opens a motor's brake and waits until it is open, so that torque does not work against it (0x77, 2.19.1).
///
/// The motor is told to hold (0x81) right after 0x77, when that is answered or one reply time-out later: a brake takes
/// longer to open, so no load falls. That also stops a motor that moves, whoever moves it. If the load has begun to
/// turn the shaft, this waits until the motor has brought it to rest, and locks the brake again if that takes more than
/// half a second. To let the shaft turn freely, send [`Shutdown`](crate::command::Shutdown) afterwards.
///
/// The motor is first asked for its run time (0xB1): one that has [restarted](crate::master::Event::Restarted) unnoticed
/// is not moved on by a later set-point.
///
/// Call this before speed and position commands, too. Simulated drives open their brakes for those on their own; the
/// manual does not say whether real ones do.
///
/// # Errors
/// [`BringUpError::Fault`], [`BringUpError::BrakeNotReleased`], [`BringUpError::NotHeld`], [`BringUpError::Call`].
///
/// If the motor does not answer that its brake is to open or that it is to hold, or if the bus fails or somebody else
/// stops the motor then, the brake may be open all the same. The motor is then [stopped](crate::master::Master::stop)
/// before this returns, until that is lifted. In any other case no stop of this function is in force. If a stop
/// switches the motor off while its brake opens, the brake is told to lock as soon as that is noticed.
///
/// The motor is told to hold when an answer is late, so let
/// [`Config::reply_timeout`](crate::master::Config::reply_timeout) be no longer than a load may fall.
pub fn release_brake<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
) -> Result<(), BringUpError<R::Error>> {
    block_on(task::release_brake(&mut Polled(runner), motor))
}

/// Locks the brake of a motor that stands, and waits until it has had the time to (0x78, 2.28). After that the motor
/// can be switched off; its protection (0xB3), if set, does so when nobody speaks to it any more. Before that, a load
/// falls until the brake holds.
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
///         // The motor holds behind an open brake only, and a stop, of one or of all, refuses to open it.
///         bus.master().lift_stop();
///         bring_up::release_brake(bus, arm)?;
///         return Err(slips);
///     }
///     Ok(is_off)
/// }
/// ```
///
/// This checks the shaft after the brake has had the time to lock. If the shaft slips, a motor that ran something or
/// drew a current is told to hold it again, as by [`release_brake`], which may leave a stop in force. **A stop that is
/// in force when this is called refuses that, and the load falls: lift it before.** Some brakes slip only when the
/// motor is off: [check again](check_brake) then.
///
/// A motor that turns is refused while it runs something and can be stopped. If it runs nothing, or reports an error,
/// its brake is told to lock, to catch what falls. A motor that gives no answers is told nothing, as nothing is known of
/// it: ask it for [`LockBrake`](crate::command::LockBrake) to have it told all the same.
///
/// # Errors
/// [`BringUpError::Turns`], [`BringUpError::BrakeNotLocked`], [`BringUpError::BrakeSlips`], [`BringUpError::Call`].
pub fn lock_brake<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
) -> Result<(), BringUpError<R::Error>> {
    block_on(task::lock_brake(&mut Polled(runner), motor))
}

/// Checks whether the shaft of a motor that is off stands, after its brake was told to [lock](lock_brake). Watches it
/// for 200 ms, in which a load turns a shaft that nothing holds. What falls is not held again.
///
/// # Errors
/// [`BringUpError::BrakeSlips`], [`BringUpError::Call`].
pub fn check_brake<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
) -> Result<(), BringUpError<R::Error>> {
    block_on(task::check_brake(&mut Polled(runner), motor))
}

/// Sets after how long without a command a motor stops on its own (0xB3); 0 switches that off. It is kept in ROM. A
/// motor that turns is refused (2.31.1).
///
/// From then on the motor must be spoken to without longer pauses, even while a stop holds it.
///
/// - Any command to the motor counts. So the motor does not stop if the control loop hangs while another thread goes on
///   reading its temperature.
/// - Motors of another bus hear nothing while a function here waits: protect none before all buses are found and
///   checked, or give each bus a thread or a task.
/// - After a longer pause the motor may answer and not obey until it is spoken to steadily again (2.31.1). Its brake
///   has locked by then, and torque and motion commands do not open it: [release](release_brake) it again.
/// - Let it be 300 ms or more where a stop holds loads. Then a motor that has let go is told again to hold, if it
///   answers again; see [`StopKind::Hold`].
/// - A load falls until the brake holds: [lock](lock_brake) it before you fall silent on purpose.
/// - The functions here that wait speak to each motor every 20 ms, or as often as the bus carries: on RS485 to one
///   other motor at a time, and behind an adapter that delivers in bursts once in two bursts. A motor that is silent is
///   asked every 100 ms. Leave the protection time for that: 100 ms is enough for eight motors without such an adapter.
///   A shorter time may end what another motor holds, which they do not report, or a [move](move_to). A control loop
///   needs [more](crate::io::Watch).
/// - On RS485 each question to another motor waits for a time-out of a motor that does not confirm its stop, and all
///   wait for 100 ms if [`is_shared`] or [`change_id`] has no answer.
///
/// # Errors
/// - [`BringUpError::Turns`], and [`BringUpError::Call`] if the motor was not told the time;
/// - [`BringUpError::MayBeProtected`] if it was, and has not answered. As it writes to ROM, the command is sent only
///   once: call this again.
pub fn protect<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
    timeout: Milliseconds,
) -> Result<Protection, BringUpError<R::Error>> {
    block_on(task::protect(&mut Polled(runner), motor, timeout))
}

/// Restarts a drive (0x76) and waits until it answers under the id `then`, which may be a new one.
///
/// - The motor is [switched off](self#functions-that-switch-a-motor-off) first. One that turns while it runs something
///   is refused. One whose load falls and that cannot hold it, or that held nothing before, is restarted all the same.
/// - The brake of a motor that answers nothing is told to lock, too, since the motor may still hear.
/// - A drive that goes on running has not heard the restart, and is told again. Its run time (0xB1) shows that, or that
///   it answers under its old id.
/// - Whole turns are lost unless multi-turn saving ([function 4](crate::command::FunctionControl::SaveMultiTurn)) is
///   on, and the motor may be moved at once afterwards: read its angle first.
///
/// # Errors
/// - [`BringUpError::Turns`], [`BringUpError::BrakeSlips`];
/// - [`BringUpError::NotThere`] if it does not answer within 5 s;
/// - [`BringUpError::NotRestarted`] if it goes on running;
/// - [`BringUpError::Call`].
pub fn restart<R: Runner<N>, const N: usize>(
    runner: &mut R,
    motor: MotorId,
    then: MotorId,
) -> Result<(), BringUpError<R::Error>> {
    block_on(task::restart(&mut Polled(runner), motor, then))
}

/// Moves a motor to an angle, or by one, and watches it until it stands there; then it holds its position. The motor
/// must be ready to move: its brake open, no error.
///
/// `on_look` gets every look at the motor, some fifty a second, and may give the move up. Nobody watches the motor
/// while `on_look` runs. During the whole move errors that other motors report are ignored: if others hold loads, move
/// with set-points, or run the bus in a thread of its own.
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
/// [`NotArrived`], after a stop, which stays in force until [`lift_stop_of`](crate::master::Master::lift_stop_of):
///
/// - the motor has stalled ([a gripper may](WhenStalled::Press)), is driven away or has let go;
/// - its time is up;
/// - it reports an error, has restarted or does not answer;
/// - `on_look` gave the move up;
/// - the move is one that is not sent ([`MoveFailure::NoTorque`], [`MoveFailure::OutOfRange`]).
///
/// A panic of `on_look` stops the motor, too.
pub fn move_to<R: Runner<N>, C: MoveCommand, const N: usize>(
    runner: &mut R,
    motor: MotorId,
    command: C,
    limits: &MoveLimits,
    on_look: impl FnMut(&MoveProgress) -> ControlFlow<()>,
) -> Result<MoveProgress, NotArrived<R::Error>> {
    // After a panic no future is left to send the stop that `task::move_to` has put, so this sends it. A motor that
    // that stop switches off stays off.
    let moving = OnDrop::new(runner, |runner: &mut &mut R| {
        let _is_stopped = runner.stop(motor, StopKind::Hold);
    });
    let result = block_on(task::move_to(&mut Polled(moving.it), motor, command, limits, on_look));
    moving.end();
    result
}
