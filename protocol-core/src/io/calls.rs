//! What a way of working with one motor needs.

use core::fmt;

use crate::command::Command;
use crate::error::RequestError;
use crate::id::MotorId;
use crate::io::asking::CallError;
use crate::io::async_runner::AsyncRunner;
use crate::io::keep_alive::KeptAlive;
use crate::io::presence::{answers, forget_silent_ones};
use crate::master::{MotorSet, StopKind};
use crate::time::{Duration, Instant};

/// How often a motor that is waited for is spoken to: its communication-loss protection may be short.
pub(super) const SPOKEN_TO_EVERY: Duration = Duration::from_millis(10);

/// A bus as needed by the ways of working with one motor: [`move_to`](crate::io::async_bring_up::move_to),
/// [`restart`](crate::io::async_bring_up::restart), [`protect`](crate::io::async_bring_up::protect) and those with a
/// brake. Every [`AsyncRunner`] is one. A handle to a loop that another thread runs may be one, too; `N` then has no
/// meaning.
#[allow(async_fn_in_trait, reason = "one task goes one way, so nothing asks for Send")]
pub trait Calls<const N: usize> {
    /// What the bus driver reports when it fails.
    type Error: fmt::Debug;

    /// The time now.
    fn now(&mut self) -> Instant;

    /// Waits until the time `until`, whatever happens meanwhile.
    ///
    /// # Errors
    /// [`CallError::Bus`].
    async fn wait_until(&mut self, until: Instant) -> Result<(), CallError<Self::Error>>;

    /// Sends a command to one motor and waits for its answer. If none comes, sends it again, up to `attempts` times in
    /// all; with `None`, as often as is usual for this command.
    ///
    /// # Errors
    /// [`CallError`].
    async fn ask_often<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
        attempts: Option<u8>,
    ) -> Result<C::Reply, CallError<Self::Error>>;

    /// As [`ask_often`](Self::ask_often), with the usual number of attempts.
    async fn ask<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
    ) -> Result<C::Reply, CallError<Self::Error>> {
        self.ask_often(motor, command, None).await
    }

    /// Stops a motor, waits until it has confirmed that or has failed to, and returns whether it has; see
    /// [`Master::stop`](crate::master::Master::stop).
    #[must_use = "a motor that has not confirmed the stop may still move: cut its power"]
    async fn stop(&mut self, motor: MotorId, kind: StopKind) -> bool;

    /// Stops a motor without waiting.
    fn begin_stop(&mut self, motor: MotorId, kind: StopKind);

    /// Checks that a move of this motor would not be refused now.
    ///
    /// # Errors
    /// [`RequestError::Stopped`] if it was stopped, [`RequestError::Restarted`] if it has restarted.
    fn may_move(&mut self, motor: MotorId) -> Result<(), RequestError>;

    /// Takes note that a motor has restarted; see [`Master::note_restart`](crate::master::Master::note_restart).
    fn note_restart(&mut self, motor: MotorId);

    /// Accepts moves again for a motor whose restart was intended; see
    /// [`Master::resume`](crate::master::Master::resume). Does nothing if others may move the motor, too: they count
    /// from where it was, and have to know first.
    fn resume(&mut self, motor: MotorId);

    /// Whether anything answers under this id. If nothing does, a loop gives the id no place that it did not have
    /// before.
    ///
    /// # Errors
    /// [`CallError`]; but no answer is `false`, not an error.
    async fn is_there(&mut self, motor: MotorId) -> Result<bool, CallError<Self::Error>>
    where
        Self: Sized,
    {
        answers(self, motor).await
    }
}

impl<R: AsyncRunner<N>, const N: usize> Calls<N> for R {
    type Error = R::Error;

    fn now(&mut self) -> Instant {
        AsyncRunner::now(self)
    }

    async fn wait_until(&mut self, until: Instant) -> Result<(), CallError<R::Error>> {
        let all = KeptAlive::new(self, MotorSet::ALL);
        all.during(async |bus| bus.run_until(until, |_| {}).await).await
    }

    async fn ask_often<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
        attempts: Option<u8>,
    ) -> Result<C::Reply, CallError<R::Error>> {
        let patience = attempts.map(|attempts| self.master().patience(attempts));
        let all = KeptAlive::new(self, MotorSet::ALL);
        all.during(async |bus| bus.ask_with(motor, command, patience, |_| {}).await).await
    }

    async fn stop(&mut self, motor: MotorId, kind: StopKind) -> bool {
        AsyncRunner::stop(self, motor, kind).await
    }

    fn begin_stop(&mut self, motor: MotorId, kind: StopKind) {
        // A motor that was spoken to has a place.
        let _ = self.master().stop(motor, kind);
    }

    fn may_move(&mut self, motor: MotorId) -> Result<(), RequestError> {
        match self.master() {
            master if master.is_stopped(motor) => Err(RequestError::Stopped),
            master if master.has_restarted(motor) => Err(RequestError::Restarted),
            _ => Ok(()),
        }
    }

    fn note_restart(&mut self, motor: MotorId) {
        self.master().note_restart(motor);
    }

    fn resume(&mut self, motor: MotorId) {
        self.master().resume(motor);
    }

    async fn is_there(&mut self, motor: MotorId) -> Result<bool, CallError<R::Error>> {
        let is_known = self.master().motors().contains(motor);
        let is_there = answers(self, motor).await;
        if !is_known && !matches!(is_there, Ok(true)) {
            // Otherwise every stop of all would wait for an id without a motor.
            let all = KeptAlive::new(self, MotorSet::ALL);
            all.during(async |bus| forget_silent_ones(bus, motor.into()).await).await;
        }
        is_there
    }
}
