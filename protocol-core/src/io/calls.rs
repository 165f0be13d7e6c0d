//! What a way of working needs that goes on for longer, with one motor.

use core::fmt;

use crate::command::Command;
use crate::error::RequestError;
use crate::id::MotorId;
use crate::io::asking::CallError;
use crate::io::async_runner::AsyncRunner;
use crate::io::presence::answers;
use crate::master::StopKind;
use crate::time::Instant;

/// A bus as ways of working with one motor need it: [`move_to`](crate::io::async_bring_up::move_to),
/// [`restart`](crate::io::async_bring_up::restart), [`protect`](crate::io::async_bring_up::protect) and those with a
/// brake. Every [`AsyncRunner`] is one, and a handle to a loop that another thread runs may be: then `N` is of no
/// consequence.
#[allow(async_fn_in_trait, reason = "one task goes one way, so nothing asks for Send")]
pub trait Calls<const N: usize> {
    /// What the bus driver reports when it fails.
    type Error: fmt::Debug;

    /// The time now.
    fn now(&mut self) -> Instant;

    /// Waits until then, whatever happens meanwhile.
    ///
    /// # Errors
    /// [`CallError::Bus`].
    async fn wait_until(&mut self, until: Instant) -> Result<(), CallError<Self::Error>>;

    /// Sends a command to one motor and waits for its answer; if there is none, so often at the most, or as often as is
    /// usual for this command.
    ///
    /// # Errors
    /// [`CallError`].
    async fn ask_often<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
        attempts: Option<u8>,
    ) -> Result<C::Reply, CallError<Self::Error>>;

    /// As [`ask_often`](Self::ask_often), as often as is usual.
    async fn ask<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
    ) -> Result<C::Reply, CallError<Self::Error>> {
        self.ask_often(motor, command, None).await
    }

    /// Stops a motor, and waits until it has confirmed that, or not: see
    /// [`Master::stop`](crate::master::Master::stop).
    #[must_use = "a motor that has not confirmed the stop may still move: cut its power"]
    async fn stop(&mut self, motor: MotorId, kind: StopKind) -> bool;

    /// Stops a motor, and waits for nothing.
    fn begin_stop(&mut self, motor: MotorId, kind: StopKind);

    /// Whether a motor would be refused a move now: it was stopped, or has restarted.
    ///
    /// # Errors
    /// [`RequestError::Stopped`], [`RequestError::Restarted`].
    fn may_move(&mut self, motor: MotorId) -> Result<(), RequestError>;

    /// Takes note that a motor has restarted; see [`Master::note_restart`](crate::master::Master::note_restart).
    fn note_restart(&mut self, motor: MotorId);

    /// Takes moves again for a motor that has restarted as it was meant to; see
    /// [`Master::resume`](crate::master::Master::resume). Not where others may move the motor, too: they count from where
    /// it was, and have to know first.
    fn resume(&mut self, motor: MotorId);

    /// Whether anything answers under this id. A loop gives one that nobody answers at no place that it did not have.
    ///
    /// # Errors
    /// [`CallError`], but not that nobody answers.
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
        self.run_until(until, |_| {}).await
    }

    async fn ask_often<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
        attempts: Option<u8>,
    ) -> Result<C::Reply, CallError<R::Error>> {
        let patience = attempts.map(|attempts| self.master().patience(attempts));
        self.ask_with(motor, command, patience, |_| {}).await
    }

    async fn stop(&mut self, motor: MotorId, kind: StopKind) -> bool {
        AsyncRunner::stop(self, motor, kind).await
    }

    fn begin_stop(&mut self, motor: MotorId, kind: StopKind) {
        // Who was spoken to has a place.
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
        let is_there = answers(self, motor).await?;
        if !is_there && !is_known {
            // Else every stop of all would wait for an id at which there is nobody.
            self.master().forget(motor);
        }
        Ok(is_there)
    }
}
