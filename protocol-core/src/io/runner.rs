//! What every loop offers, whatever its bus.

use core::fmt;

use embassy_futures::block_on;

use crate::command::{Command, SetPoint};
use crate::id::MotorId;
use crate::io::asking::CallError;
use crate::io::async_runner::AsyncRunner;
use crate::io::polled::Polled;
use crate::master::{Event, Master, MotorSet, Patience, StopKind};
use crate::time::{Duration, Instant};

/// How long a stop of all motors is tried at the most: so much of [`Elapsed`](crate::io::Elapsed), so that a program
/// that is suspended meanwhile goes on with it, and one whose driver keeps the loop each time it is used sends four or five
/// times.
pub const LONGEST_STOP: Duration = Duration::from_secs(1);

/// How long a question waits for its turn at the most: an earlier one ends sooner, but for a stop that waits for
/// a bus that is down.
pub const LONGEST_TURN: Duration = Duration::from_secs(2);

/// How long a loop sleeps at most between two looks at the bus.
pub(super) const LONGEST_IDLE: Duration = Duration::from_millis(10);

/// A loop that runs a [`Master`] on a bus.
///
/// While a call waits, here or in [`bring_up`](crate::io::bring_up), it passes over what happens otherwise: also that
/// another motor reports an error, or has restarted. What hands such events on is [`ask_with`](Self::ask_with) and
/// [`run_until`](Self::run_until).
pub trait Runner<const N: usize> {
    /// What the bus driver reports when it fails.
    type Error: fmt::Debug;

    /// The master that is run.
    fn master(&mut self) -> &mut Master<N>;

    /// The time now.
    fn now(&self) -> Instant;

    /// One round: receives; if nothing was received, lets the master see the time and sends what the
    /// bus takes. Gives one event if there is any. Call it until there is none, or nothing is sent.
    /// Never waits.
    ///
    /// # Errors
    /// What the bus driver reports. The master stays sound: call again.
    fn poll(&mut self) -> Result<Option<Event>, Self::Error>;

    /// Lets the clock idle until `until`, the master's next deadline or a frame, whichever comes
    /// first, as well as the clock can.
    fn idle(&mut self, until: Instant);

    /// Runs the bus until then. `on_event` gets what happens meanwhile. When `until` is past, all that has come is
    /// heard, with up to 64 looks at a bus that always has something, and then what can be sent is sent: a control
    /// loop that is late does not stop hearing, nor sending.
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

    /// Sends a command to one motor and waits for its answer, or until it was sent if it has none. While an
    /// earlier request to the motor is under way it waits for the end of that. `on_event` gets everything
    /// else that happens meanwhile.
    ///
    /// # Errors
    /// [`CallError`]. After one of the bus the request may still be under way: the next one waits for it. What
    /// gets no turn within 2 s, since a stop waits for a bus that is down, say, is
    /// [`Busy`](crate::error::RequestError::Busy).
    fn ask_with<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
        patience: Option<Patience>,
        on_event: impl FnMut(Event),
    ) -> Result<C::Reply, CallError<Self::Error>> {
        block_on(Polled(self).ask_with(motor, command, patience, on_event))
    }

    /// Sends a command to one motor and waits for its answer, or until it was sent if it has none. Other
    /// events are passed over.
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

    /// Asks several motors at the same time, so that it takes as long as the slowest, and gives an
    /// outcome each, in the order of the questions. Other events are passed over.
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
    /// Each error of the bus is the outcome of one question, which may be under way all the same; the others go
    /// on.
    fn ask_together<C: Command, const M: usize>(
        &mut self,
        questions: [(MotorId, C); M],
    ) -> [Result<C::Reply, CallError<Self::Error>>; M] {
        block_on(Polled(self).ask_together(questions))
    }

    /// Puts a set-point in a motor's stream; see [`Master::set_point`].
    ///
    /// # Errors
    /// [`CallError::Refused`], for what is refused there.
    fn set_point<C: SetPoint>(
        &mut self,
        motor: MotorId,
        command: C,
    ) -> Result<(), CallError<Self::Error>> {
        Polled(self).set_point(motor, command)
    }

    /// Puts a set-point in a motor's stream and waits for its feedback. Feedback says how the motor is, and
    /// may be the late one of an earlier set-point of the same kind. Other events are passed over.
    ///
    /// # Errors
    /// [`CallError`]: what [`Master::set_point`] refuses; no feedback in time; dropped before it was sent;
    /// an error of the bus, behind which it is not sent any more. A set-point is never sent again.
    fn set_point_and_wait<C: SetPoint>(
        &mut self,
        motor: MotorId,
        command: C,
    ) -> Result<C::Reply, CallError<Self::Error>> {
        block_on(Polled(self).set_point_and_wait(motor, command))
    }

    /// Stops one motor and waits until it has confirmed, or not: then **cut its power**. See
    /// [`Master::stop`]; until [`Master::lift_stop_of`] whatever may move it is refused. An error of the bus
    /// does not end it, as with [`stop_all`](Self::stop_all). One that a stop has switched off, and that was not lifted
    /// since, confirms [`StopKind::Hold`], too, and stays off.
    #[must_use = "a motor that has not confirmed the stop may still move: cut its power"]
    fn stop(&mut self, motor: MotorId, kind: StopKind) -> bool {
        block_on(Polled(self).stop(motor, kind))
    }

    /// Stops all motors [that have a place](Master::motors) and those of `also`, and waits until each has confirmed,
    /// or not; see [`Master::stop_all`]. Gives those of them that have not: **cut their power**. A motor that this
    /// master has never spoken to is not among them, so that there is none where it has spoken to nobody: name it. An
    /// error of the bus does not end it; it goes on for up to [`LONGEST_STOP`], in the hope that the bus comes back.
    ///
    /// On RS485 it goes behind the exchange under way, which it waits for no longer than 50 ms. A motor that a stop has
    /// switched off stays off until that is lifted, also where this is to hold it.
    ///
    /// Until [`Master::lift_stop`] whatever may move a motor is refused. Whose watchdog does not wait for so long calls
    /// [`Master::stop_all`] and goes on with its loop, to which events say who has confirmed, with a time limit of its own.
    #[must_use = "those that have not confirmed the stop may still move: cut their power"]
    fn stop_all(&mut self, kind: StopKind, also: MotorSet) -> MotorSet {
        block_on(Polled(self).stop_all(kind, also))
    }
}
