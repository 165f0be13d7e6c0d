//! What every async loop offers, whatever its bus.

use core::fmt;

use embassy_futures::yield_now;

use crate::command::{Command, SetPoint};
use crate::error::RequestError;
use crate::id::MotorId;
use crate::io::runner::{Asking, CallError, StopWatch};
use crate::master::{Event, Master, MotorSet, Patience, StopKind};
use crate::time::Instant;

/// An async loop that runs a [`Master`] on a bus: [`Runner`](crate::io::Runner) for tasks.
///
/// The bus moves only while one of these futures is awaited. Any of them may be dropped, by a
/// `select` or a time-out: no event is lost and no frame is sent twice. A request whose
/// [`ask`](Self::ask) is dropped stays under way, and the next one waits for its end.
#[allow(async_fn_in_trait, reason = "one task runs one bus, so nothing asks for Send")]
pub trait AsyncRunner<const N: usize> {
    /// What the bus driver reports when it fails.
    type Error: fmt::Debug;

    /// The master that is run.
    fn master(&mut self) -> &mut Master<N>;

    /// The time now.
    fn now(&self) -> Instant;

    /// Runs the bus until there is an event, or until then if there is none; with no end, until
    /// there is one. Whatever can be sent is sent, even when `until` is past.
    ///
    /// # Errors
    /// What the bus driver reports. The master stays sound: call again.
    async fn run(&mut self, until: Option<Instant>) -> Result<Option<Event>, Self::Error>;

    /// Runs the bus until there is an event.
    ///
    /// # Errors
    /// As [`run`](Self::run).
    async fn next_event(&mut self) -> Result<Event, Self::Error> {
        loop {
            if let Some(event) = self.run(None).await? {
                return Ok(event);
            }
        }
    }

    /// As [`Runner::ask_with`](crate::io::Runner::ask_with).
    ///
    /// # Errors
    /// As there.
    async fn ask_with<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
        patience: Option<Patience>,
        mut on_event: impl FnMut(Event),
    ) -> Result<C::Reply, CallError<Self::Error>> {
        let mut asking = Asking::new(motor, command, patience);
        loop {
            asking.put(self.master())?;
            let event = match self.next_event().await {
                Ok(event) => event,
                Err(error) => {
                    // A bus that fails again and again leaves the other tasks their turns.
                    yield_now().await;
                    return Err(CallError::Bus(error));
                }
            };
            match asking.outcome(&event) {
                Some(outcome) => return outcome.map_err(CallError::Failed),
                None => on_event(event),
            }
        }
    }

    /// As [`Runner::ask`](crate::io::Runner::ask).
    ///
    /// # Errors
    /// As there.
    async fn ask<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
    ) -> Result<C::Reply, CallError<Self::Error>> {
        self.ask_with(motor, command, None, |_| {}).await
    }

    /// Puts a set-point in a motor's stream; see [`Master::set_point`]. It leaves at the next
    /// [`run`](Self::run).
    ///
    /// # Errors
    /// As there.
    fn set_point<C: SetPoint>(&mut self, motor: MotorId, command: C) -> Result<(), RequestError> {
        let now = self.now();
        self.master().set_point(motor, command, now)
    }

    /// Stops all motors and waits until each has confirmed, or not; see
    /// [`Runner::stop_all`](crate::io::Runner::stop_all). Gives those that have not: **cut their
    /// power**.
    ///
    /// The stop is in force with the first poll of this future, and goes on with any other future of
    /// this loop if this one is dropped.
    async fn stop_all(&mut self, kind: StopKind, also: MotorSet) -> MotorSet {
        let now = self.now();
        let mut stop = StopWatch::begin(self.master(), kind, also, now);
        while !stop.is_over(self.now()) {
            match self.run(Some(stop.end())).await {
                Ok(Some(event)) => stop.note(&event),
                Ok(None) => {}
                // A bus that fails again and again leaves the other tasks their turns.
                Err(_) => yield_now().await,
            }
        }
        stop.unconfirmed()
    }
}

/// The earlier of two times of which either may be missing.
pub(super) fn earlier(a: Option<Instant>, b: Option<Instant>) -> Option<Instant> {
    [a, b].into_iter().flatten().min()
}
