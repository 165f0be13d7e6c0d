//! What every loop offers, whatever its bus.

use core::fmt;

use crate::command::{Command, SetPoint};
use crate::error::RequestError;
use crate::id::MotorId;
use crate::master::{Event, Failure, Master, MotorSet, Patience, StopKind, Ticket};
use crate::time::{Duration, Instant};

/// Why a call has no answer.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub enum CallError<E> {
    /// The bus driver reports an error.
    #[error("the bus reports an error: {0:?}")]
    Bus(E),
    /// The command could not be sent as asked.
    #[error(transparent)]
    Request(#[from] RequestError),
    /// It was sent, and has no answer.
    #[error("{0}")]
    Failed(Failure),
}

/// How long a stop of all motors is tried at the most.
pub const LONGEST_STOP: Duration = Duration::from_secs(1);

/// How long [`Runner::ask`] sleeps at most between two looks at the bus.
pub(super) const LONGEST_IDLE: Duration = Duration::from_millis(10);

/// A bus that takes nothing for so long counts as down.
pub(super) const STUCK_AFTER: Duration = Duration::from_millis(20);

/// A loop that runs a [`Master`] on a bus.
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

    /// Sends a command to one motor and waits for its answer, or until it was sent if it has none. While an
    /// earlier request to the motor is under way it waits for the end of that. `on_event` gets everything
    /// else that happens meanwhile.
    ///
    /// # Errors
    /// [`CallError`]. After one of the bus the request may still be under way: the next one waits for it.
    fn ask_with<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
        patience: Option<Patience>,
        mut on_event: impl FnMut(Event),
    ) -> Result<C::Reply, CallError<Self::Error>> {
        let mut asking = Asking::new(motor, command, patience);
        loop {
            asking.put(self.master())?;
            match self.poll().map_err(CallError::Bus)? {
                Some(event) => match asking.outcome(&event) {
                    Some(outcome) => return outcome.map_err(CallError::Failed),
                    None => on_event(event),
                },
                None => self.idle(self.now() + LONGEST_IDLE),
            }
        }
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
        self.ask_with(motor, command, None, |_| {})
    }

    /// Puts a set-point in a motor's stream; see [`Master::set_point`].
    ///
    /// # Errors
    /// As there.
    fn set_point<C: SetPoint>(&mut self, motor: MotorId, command: C) -> Result<(), RequestError> {
        let now = self.now();
        self.master().set_point(motor, command, now)
    }

    /// Stops all motors and waits until each has confirmed, or not; see [`Master::stop_all`]. Gives
    /// those that have not: **cut their power**. An error of the bus does not end it; it goes on for up
    /// to [`LONGEST_STOP`], in the hope that the bus comes back.
    fn stop_all(&mut self, kind: StopKind, also: MotorSet) -> MotorSet {
        let now = self.now();
        let mut stop = StopWatch::begin(self.master(), kind, also, now);
        while !stop.is_over(self.now()) {
            match self.poll() {
                Ok(Some(event)) => stop.note(&event),
                Ok(None) | Err(_) => self.idle(self.now() + LONGEST_IDLE),
            }
        }
        stop.unconfirmed()
    }
}

/// A question that is put as soon as the motor is free for it.
#[derive(Debug)]
pub(super) struct Asking<C> {
    motor: MotorId,
    patience: Option<Patience>,
    state: AskingState<C>,
}

#[derive(Debug)]
enum AskingState<C> {
    ToBePut(C),
    Put(Ticket<C>),
}

impl<C: Command> Asking<C> {
    pub(super) const fn new(motor: MotorId, command: C, patience: Option<Patience>) -> Self {
        Self { motor, patience, state: AskingState::ToBePut(command) }
    }

    /// Puts it, unless it was put or the motor is busy.
    pub(super) fn put<const N: usize>(
        &mut self,
        master: &mut Master<N>,
    ) -> Result<(), RequestError> {
        let AskingState::ToBePut(command) = &self.state else { return Ok(()) };
        match master.put_request(self.motor, command, self.patience) {
            Ok(ticket) => self.state = AskingState::Put(ticket),
            Err(RequestError::Busy) => {}
            Err(error) => return Err(error),
        }
        Ok(())
    }

    pub(super) fn outcome(&self, event: &Event) -> Option<Result<C::Reply, Failure>> {
        match &self.state {
            AskingState::ToBePut(_) => None,
            AskingState::Put(ticket) => ticket.outcome(event),
        }
    }
}

/// Who of the motors that are being stopped has not confirmed it yet.
#[derive(Debug)]
pub(super) struct StopWatch {
    running: MotorSet,
    unconfirmed: MotorSet,
    end: Instant,
}

impl StopWatch {
    pub(super) fn begin<const N: usize>(
        master: &mut Master<N>,
        kind: StopKind,
        also: MotorSet,
        now: Instant,
    ) -> Self {
        // Those that the master has no place for are not stopped, which their absence below tells.
        let _ = master.stop_all(kind, also);
        let running = master.motors();
        Self { running, unconfirmed: also.without(running), end: now + LONGEST_STOP }
    }

    pub(super) fn note(&mut self, event: &Event) {
        match *event {
            Event::StopConfirmed { motor } => self.running.remove(motor),
            Event::StopUnconfirmed { motor } => {
                self.running.remove(motor);
                self.unconfirmed.insert(motor);
            }
            _ => {}
        }
    }

    pub(super) fn is_over(&self, now: Instant) -> bool {
        self.running.is_empty() || now >= self.end
    }

    pub(super) const fn end(&self) -> Instant {
        self.end
    }

    /// Those that have not confirmed.
    pub(super) fn unconfirmed(self) -> MotorSet {
        self.running.iter().chain(self.unconfirmed.iter()).collect()
    }
}
