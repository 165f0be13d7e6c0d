//! What a call that waits for an answer goes through.

use crate::command::{Command, SetPoint};
use crate::error::RequestError;
use crate::id::MotorId;
use crate::io::runner::LONGEST_TURN;
use crate::master::{Event, Failure, Master, Patience, Ticket};
use crate::time::Instant;

/// Why a call has no answer.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub enum CallError<E> {
    /// The bus driver reports an error.
    #[error("the bus reports an error: {0:?}")]
    Bus(E),
    /// The command could not be sent as asked.
    #[error("motor {motor}: {refusal}")]
    Refused {
        /// Whom it was for.
        motor: MotorId,
        /// Why it could not be sent.
        refusal: RequestError,
    },
    /// It was sent, and has no answer.
    #[error("motor {motor}: {failure}")]
    Failed {
        /// Who was asked.
        motor: MotorId,
        /// Why there is no answer.
        failure: Failure,
    },
}

impl<E> CallError<E> {
    /// Makes of what the [`Master`] refuses the error of a call: `.map_err(CallError::refused(motor))`.
    pub fn refused(motor: MotorId) -> impl Fn(RequestError) -> Self {
        move |refusal| Self::Refused { motor, refusal }
    }
}

/// A question that is put as soon as the motor is free for it.
#[derive(Debug)]
pub(super) struct Asking<C> {
    motor: MotorId,
    command: C,
    patience: Option<Patience>,
    /// Until when it waits for its turn.
    latest_turn: Instant,
    /// Once it was put.
    ticket: Option<Ticket<C>>,
}

impl<C: Command> Asking<C> {
    pub(super) fn new(
        motor: MotorId,
        command: C,
        patience: Option<Patience>,
        now: Instant,
    ) -> Self {
        Self { motor, command, patience, latest_turn: now + LONGEST_TURN, ticket: None }
    }

    /// Puts it, unless it was put or the motor is busy, for a while.
    pub(super) fn put<const N: usize, E>(
        &mut self,
        master: &mut Master<N>,
        now: Instant,
    ) -> Result<(), CallError<E>> {
        if self.ticket.is_none() {
            match master.put_request(self.motor, &self.command, self.patience) {
                Ok(ticket) => self.ticket = Some(ticket),
                Err(RequestError::Busy) if now < self.latest_turn => {}
                Err(refusal) => return Err(CallError::Refused { motor: self.motor, refusal }),
            }
        }
        Ok(())
    }

    /// Nobody waits for its answer any more.
    pub(super) fn withdraw<const N: usize>(&self, master: &mut Master<N>) {
        if let Some(ticket) = self.ticket {
            master.withdraw(ticket.id());
        }
    }

    /// Until when it waits for its turn, if it does.
    pub(super) fn latest_turn(&self) -> Option<Instant> {
        self.ticket.is_none().then_some(self.latest_turn)
    }

    pub(super) fn outcome<E>(&self, event: &Event) -> Option<Outcome<C, E>> {
        let failed = |failure| CallError::Failed { motor: self.motor, failure };
        Some(self.ticket?.outcome(event)?.map_err(failed))
    }
}

/// Several questions at the same time.
pub(super) struct Askings<C: Command, E, const M: usize>([Asked<C, E>; M]);

/// One of them, and what came of it so far.
type Asked<C, E> = (Asking<C>, Option<Outcome<C, E>>);
type Outcome<C, E> = Result<<C as Command>::Reply, CallError<E>>;

impl<C: Command, E, const M: usize> Askings<C, E, M> {
    pub(super) fn new(questions: [(MotorId, C); M], now: Instant) -> Self {
        Self(questions.map(|(motor, command)| (Asking::new(motor, command, None, now), None)))
    }

    /// Puts those that can be put. Gives whether any of them is still open.
    pub(super) fn put<const N: usize>(&mut self, master: &mut Master<N>, now: Instant) -> bool {
        for (asking, outcome) in self.open() {
            *outcome = asking.put(master, now).err().map(Err);
        }
        self.open().next().is_some()
    }

    /// Nobody waits for their answers any more.
    pub(super) fn withdraw<const N: usize>(&self, master: &mut Master<N>) {
        self.0.iter().for_each(|(asking, _)| asking.withdraw(master));
    }

    /// Until when the first of them waits for its turn, if any does.
    pub(super) fn latest_turn(&mut self) -> Option<Instant> {
        self.open().filter_map(|(asking, _)| asking.latest_turn()).min()
    }

    pub(super) fn note(&mut self, event: &Event) {
        for (asking, outcome) in self.open() {
            *outcome = asking.outcome(event);
        }
    }

    /// The bus has failed, which one of them is reported. The others may have been sent, and go on.
    pub(super) fn bus_has_failed(&mut self, error: E) {
        if let Some((_, outcome)) = self.open().next() {
            *outcome = Some(Err(CallError::Bus(error)));
        }
    }

    /// What came of each, once none is open.
    pub(super) fn outcomes(&mut self) -> [Outcome<C, E>; M] {
        self.0.each_mut().map(|(asking, outcome)| {
            let bus_is_down = CallError::Failed { motor: asking.motor, failure: Failure::BusDown };
            outcome.take().unwrap_or(Err(bus_is_down))
        })
    }

    fn open(&mut self) -> impl Iterator<Item = &mut Asked<C, E>> {
        self.0.iter_mut().filter(|(_, outcome)| outcome.is_none())
    }
}

/// What an event says of a motor's newest set-point; nothing while it is under way.
pub(super) fn outcome_of_set_point<C: SetPoint, const N: usize>(
    master: &Master<N>,
    motor: MotorId,
    event: &Event,
) -> Option<Result<C::Reply, Failure>> {
    match event {
        // The motor was stopped or the bus is down, or it grew too old. An earlier one may be in flight yet.
        _ if master.is_newest_set_point_dropped(motor) => Some(Err(Failure::Dropped)),
        // What is told of a set-point now was that of an earlier one.
        _ if master.has_set_point_under_way(motor) => None,
        Event::SetPointUnanswered { motor: from } if *from == motor => Some(Err(Failure::NoReply)),
        // Of another kind is the late feedback of an earlier set-point.
        Event::Feedback { motor: from, reply } if *from == motor => {
            C::decode_reply(&reply.encode()).ok().map(Ok)
        }
        _ => None,
    }
}
