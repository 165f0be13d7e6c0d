//! What every loop offers, on any bus.

use core::fmt;

use embassy_futures::block_on;

use crate::command::{Command, SetPoint};
use crate::id::MotorId;
use crate::io::asking::CallError;
use crate::io::async_runner::AsyncRunner;
use crate::io::polled::Polled;
use crate::master::{Event, Master, MotorSet, Patience, StopKind};
use crate::time::{Duration, Instant};

/// How long a stop is tried if no motor answers, measured by [`Elapsed`](crate::io::Elapsed): a program that was
/// suspended meanwhile goes on with the stop. On a slow RS485 line it is [longer](longest_stop).
pub const LONGEST_STOP: Duration = Duration::from_secs(1);

/// How long a stop is tried for these motors, which have not confirmed it yet: [`LONGEST_STOP`], or on RS485, where
/// motors take turns, twice a stop's time-out for each, if that is longer. If one of them was heard within the last
/// quarter of a second, or on RS485 any motor within that time, it is three times as long.
///
/// The time-out is [`Config::reply_timeout`](crate::master::Config::reply_timeout), or 50 ms if that is shorter. So 32
/// motors at 115200 bit/s have a second or three, and at 9600 bit/s some two seconds or six.
pub fn longest_stop<const N: usize>(
    master: &Master<N>,
    motors: MotorSet,
    now: Instant,
) -> Duration {
    let (mut longest, mut who, mut within) = (LONGEST_STOP, motors, Duration::from_millis(250));
    if master.config().is_rs485() {
        // On a line dead motors may have many turns in a row, or those that have confirmed.
        who = master.motors();
        longest = longest.max(master.stop_timeout().times(2 * who.len() as u32));
        within = longest;
    }
    let mut seen = who.iter().filter_map(|motor| master.health(motor).last_seen);
    let is_any_heard = seen.any(|at| now - at < within);
    if is_any_heard { longest.times(3) } else { longest }
}

/// How long a question waits for its turn at most. An earlier request ends sooner, except a stop that waits for a bus
/// that is down.
pub const LONGEST_TURN: Duration = Duration::from_secs(2);

/// How long a loop sleeps at most between two looks at the bus.
pub(super) const LONGEST_IDLE: Duration = Duration::from_millis(10);

/// A loop that runs a [`Master`] on a bus.
///
/// While a call waits, here or in [`bring_up`](crate::io::bring_up), it ignores all other events, even that another
/// motor reports an error or has restarted. [`ask_with`](Self::ask_with) and [`run_until`](Self::run_until) hand such
/// events on.
pub trait Runner<const N: usize> {
    /// What the bus driver reports when it fails.
    type Error: fmt::Debug;

    /// The master that this loop runs.
    fn master(&mut self) -> &mut Master<N>;

    /// The time now.
    fn now(&self) -> Instant;

    /// Runs one round and returns an event if there is one. Never waits.
    ///
    /// A round receives first. If that yields no event, the round lets the master see the time and sends what the bus
    /// takes. So call this until it returns `None`: a round that receives an event sends nothing.
    ///
    /// # Errors
    /// What the bus driver reports; see [there](crate::io#what-a-driver-reports). The master stays sound: call again.
    fn poll(&mut self) -> Result<Option<Event>, Self::Error>;

    /// Lets the clock idle until `until`, the master's next deadline or a frame, whichever comes first, as well as the
    /// clock can.
    fn idle(&mut self, until: Instant);

    /// Runs the bus until the time `until`, and passes each event to `on_event`.
    ///
    /// If `until` is past, this still receives all that has come (with up to 64 looks at a bus that always has
    /// something), and then sends what can be sent. So a control loop that is late stops neither receiving nor sending.
    ///
    /// # Errors
    /// [`CallError::Bus`].
    fn run_until(
        &mut self,
        until: Instant,
        on_event: impl FnMut(Event),
    ) -> Result<(), CallError<Self::Error>> {
        block_on(Polled(self).run_until(until, on_event))
    }

    /// Sends a command to one motor and waits for its answer; if the command has none, until it was sent. If an earlier
    /// request to the motor is under way, this first waits for its end. `on_event` gets all other events.
    ///
    /// # Errors
    /// [`CallError`]. An error of the bus is returned if the command was dropped because of it. It is also returned if
    /// no answer comes, unless a second sending would act again: whether the first was sent has to be known then. A
    /// request that gets no turn within 2 s returns [`Busy`](crate::error::RequestError::Busy), for example because a
    /// stop waits for a bus that is down.
    fn ask_with<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
        patience: Option<Patience>,
        on_event: impl FnMut(Event),
    ) -> Result<C::Reply, CallError<Self::Error>> {
        block_on(Polled(self).ask_with(motor, command, patience, on_event))
    }

    /// As [`ask_with`](Self::ask_with), with the usual time-out and attempts. Other events are ignored.
    ///
    /// # Errors
    /// As [`ask_with`](Self::ask_with).
    fn ask<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
    ) -> Result<C::Reply, CallError<Self::Error>> {
        block_on(Polled(self).ask(motor, command))
    }

    /// Asks several motors at the same time, so that it takes only as long as the slowest. Returns the outcomes in the
    /// order of the questions. Other events are ignored.
    ///
    /// ```no_run
    /// # use myactuator_protocol_core::command::ReadMultiTurnAngle;
    /// # use myactuator_protocol_core::io::Runner;
    /// # use myactuator_protocol_core::MotorId;
    /// # fn angles<R: Runner<8>>(bus: &mut R, arm: [MotorId; 4]) -> Result<(), Box<dyn std::error::Error>>
    /// # where R::Error: 'static {
    /// let angles = bus.ask_together(arm.map(|motor| (motor, ReadMultiTurnAngle)));
    /// let [base, shoulder, elbow, wrist] = angles;
    /// # let _ = (base, shoulder, wrist);
    /// let degrees = elbow.map_err(|error| error.to_string())?.angle.degrees();
    /// # let _ = degrees; Ok(()) }
    /// ```
    ///
    /// An error of the bus is the outcome of one question, as of [`ask_with`](Self::ask_with).
    fn ask_together<C: Command, const M: usize>(
        &mut self,
        questions: [(MotorId, C); M],
    ) -> [Result<C::Reply, CallError<Self::Error>>; M] {
        block_on(Polled(self).ask_together(questions))
    }

    /// Puts a set-point in a motor's stream; see [`Master::set_point`].
    ///
    /// # Errors
    /// [`CallError::Refused`] for what [`Master::set_point`] refuses.
    fn set_point<C: SetPoint>(
        &mut self,
        motor: MotorId,
        command: C,
    ) -> Result<(), CallError<Self::Error>> {
        Polled(self).set_point(motor, command)
    }

    /// Puts a set-point in a motor's stream and waits for its feedback. Feedback says how the motor is; it may be the
    /// late feedback of an earlier set-point of the same kind. Other events are ignored.
    ///
    /// # Errors
    /// [`CallError`], if:
    ///
    /// - [`Master::set_point`] refuses the set-point;
    /// - no feedback comes in time;
    /// - the set-point is dropped before it was sent;
    /// - the bus reports an error. A set-point that still waits is then not sent any more.
    ///
    /// A set-point is never sent again.
    fn set_point_and_wait<C: SetPoint>(
        &mut self,
        motor: MotorId,
        command: C,
    ) -> Result<C::Reply, CallError<Self::Error>> {
        block_on(Polled(self).set_point_and_wait(motor, command))
    }

    /// Stops one motor, waits until it has confirmed or has failed to, and returns whether it has. If not, **cut its
    /// power**. See [`Master::stop`].
    ///
    /// - This may take [up to a second or three](longest_stop), on a slow line more, in which the others get no
    ///   set-points. In a control loop call [`Master::stop`], take the event, and leave the motor out of the stream and
    ///   the [`Watch`](crate::io::Watch).
    /// - Until [`Master::lift_stop_of`] whatever may move the motor is refused.
    /// - An error of the bus does not end the stop, as with [`stop_all`](Self::stop_all).
    /// - A motor that was switched off by a stop that is still in force stays off. It confirms [`StopKind::Hold`], too.
    #[must_use = "a motor that has not confirmed the stop may still move: cut its power"]
    fn stop(&mut self, motor: MotorId, kind: StopKind) -> bool {
        block_on(Polled(self).stop(motor, kind))
    }

    /// Stops all motors [that have a place](Master::motors) and those of `also`, and waits until each has confirmed or
    /// has failed to; see [`Master::stop_all`]. Returns those that have not confirmed: **cut their power**.
    ///
    /// - A motor that this master has never spoken to has no place, and is not among those returned: name it in `also`.
    ///   If the master has spoken to no motor and `also` is empty, so is the result.
    /// - An error of the bus does not end the stop. It is tried for [up to a second or three](longest_stop), on a
    ///   slow line for longer, in the hope that the bus comes back.
    /// - On RS485 it goes after the exchange under way, but waits for that no longer than 50 ms.
    /// - It takes some 15 reply time-outs if a motor does not confirm. Meanwhile the others are asked, so that their
    ///   communication-loss protection (0xB3) lets none go. On RS485 each of these turns comes after a time-out of the
    ///   motor that does not confirm: at 115200 bit/s 200 ms are enough for six motors that hold beside a few that
    ///   are dead, and not for many more.
    /// - A motor that a stop has switched off stays off until that stop is lifted, even if this one is to hold it.
    /// - Until [`Master::lift_stop`] whatever may move a motor is refused.
    ///
    /// If your watchdog does not wait that long, call [`Master::stop_all`] and go on with your loop. Events then report
    /// which motors have confirmed; while the bus takes nothing there is none, so set a time limit of your own.
    #[must_use = "those that have not confirmed the stop may still move: cut their power"]
    fn stop_all(&mut self, kind: StopKind, also: MotorSet) -> MotorSet {
        block_on(Polled(self).stop_all(kind, also))
    }
}
