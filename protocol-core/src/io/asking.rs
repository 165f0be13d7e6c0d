//! The course of a call that waits for an answer.

use crate::command::{Command, SetPoint};
use crate::error::RequestError;
use crate::id::MotorId;
use crate::io::runner::{LONGEST_IDLE, LONGEST_TURN};
use crate::master::{Event, Failure, Master, Patience, Ticket};
use crate::opcode::Repeat;
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
        /// The motor that it was for.
        motor: MotorId,
        /// Why it could not be sent.
        refusal: RequestError,
    },
    /// It has no answer. The failure says whether it may have been sent.
    #[error("motor {motor}: {failure}")]
    Failed {
        /// The motor that was asked.
        motor: MotorId,
        /// Why there is no answer.
        failure: Failure,
    },
}

impl<E> CallError<E> {
    /// Turns a refusal of the [`Master`] into the error of a call: `.map_err(CallError::refused(motor))`.
    pub fn refused(motor: MotorId) -> impl Fn(RequestError) -> Self {
        move |refusal| Self::Refused { motor, refusal }
    }
}

/// Several questions. Each is put as soon as its motor is free for it.
pub(super) struct Askings<C: Command, E, const M: usize> {
    all: [Asking<C, E>; M],
    patience: Option<Patience>,
    /// Until when they wait for their turns.
    latest_turn: Instant,
    /// What the bus has reported meanwhile.
    error: Option<E>,
}

struct Asking<C: Command, E> {
    motor: MotorId,
    command: C,
    /// `None` until the question is put.
    ticket: Option<Ticket<C>>,
    outcome: Option<Outcome<C, E>>,
}

type Outcome<C, E> = Result<<C as Command>::Reply, CallError<E>>;

impl<C: Command, E, const M: usize> Askings<C, E, M> {
    pub(super) fn new(
        questions: [(MotorId, C); M],
        patience: Option<Patience>,
        now: Instant,
    ) -> Self {
        let asking = |(motor, command)| Asking { motor, command, ticket: None, outcome: None };
        Self { all: questions.map(asking), patience, latest_turn: now + LONGEST_TURN, error: None }
    }

    /// Puts those that can be put; a motor may be busy for a while. Returns whether any of them is still open.
    pub(super) fn put<const N: usize>(&mut self, master: &mut Master<N>, now: Instant) -> bool {
        let (patience, may_wait) = (self.patience, now < self.latest_turn);
        for it in self.open().filter(|it| it.ticket.is_none()) {
            // Its turn may come too late: the loop may have been suspended.
            let put = match may_wait || it.command.kind().ends_motion() {
                true => master.put_request(it.motor, &it.command, patience),
                false => Err(RequestError::Busy),
            };
            match put {
                Ok(ticket) => it.ticket = Some(ticket),
                Err(RequestError::Busy) if may_wait => {}
                Err(refusal) => {
                    it.outcome = Some(Err(CallError::Refused { motor: it.motor, refusal }))
                }
            }
        }
        self.open().next().is_some()
    }

    /// Withdraws the questions: nobody waits for their answers any more.
    pub(super) fn withdraw<const N: usize>(&self, master: &mut Master<N>) {
        self.all.iter().filter_map(|it| it.ticket).for_each(|ticket| master.withdraw(ticket.id()));
    }

    /// When to look again whether it is the turn of one that waits, if any does: there is no event when a motor's stop
    /// that was sent once more has no answer.
    pub(super) fn next_turn(&mut self, now: Instant) -> Option<Instant> {
        let soon = self.latest_turn.min(now + LONGEST_IDLE);
        self.open().any(|it| it.ticket.is_none()).then_some(soon)
    }

    /// Returns whether the event is the outcome of one of them.
    pub(super) fn note(&mut self, event: &Event) -> bool {
        self.open().any(|it| {
            let failed = |failure| CallError::Failed { motor: it.motor, failure };
            it.outcome =
                it.ticket.and_then(|ticket| ticket.outcome(event)).map(|it| it.map_err(failed));
            it.outcome.is_some()
        })
    }

    /// The bus reports an error. What is under way may be answered all the same. What was not put yet is over, except
    /// what ends motion.
    pub(super) fn bus_has_failed(&mut self, error: E) {
        for it in self.open().filter(|it| it.ticket.is_none() && !it.command.kind().ends_motion()) {
            let failure = Failure::BusDown;
            it.outcome = Some(Err(CallError::Failed { motor: it.motor, failure }));
        }
        self.error.get_or_insert(error);
    }

    /// The outcome of each, once none is open. An error of the bus is the outcome of one that was dropped because of
    /// that, or that has no answer and does no harm if it is put again.
    pub(super) fn outcomes(&mut self) -> [Outcome<C, E>; M] {
        let error = &mut self.error;
        self.all.each_mut().map(|it| {
            let bus_is_down = CallError::Failed { motor: it.motor, failure: Failure::BusDown };
            let outcome = it.outcome.take().unwrap_or(Err(bus_is_down));
            let is_harmless = || it.command.kind().repeat() == Repeat::Harmless;
            let is_of_error = match outcome {
                Err(CallError::Failed { failure: Failure::BusDown, .. }) => true,
                Err(CallError::Failed { failure: Failure::NoReply, .. }) => is_harmless(),
                _ => false,
            };
            match error.take_if(|_| is_of_error) {
                Some(error) => Err(CallError::Bus(error)),
                None => outcome,
            }
        })
    }

    fn open(&mut self) -> impl Iterator<Item = &mut Asking<C, E>> {
        self.all.iter_mut().filter(|it| it.outcome.is_none())
    }
}

/// What an event says of a motor's newest set-point; `None` while that is under way.
pub(super) fn outcome_of_set_point<C: SetPoint, const N: usize>(
    master: &Master<N>,
    motor: MotorId,
    event: &Event,
) -> Option<Result<C::Reply, Failure>> {
    match event {
        // The motor was stopped, the bus is down, or the set-point grew too old. An earlier one may still be in flight.
        _ if master.is_newest_set_point_dropped(motor) => Some(Err(Failure::Dropped)),
        // What is reported now is the outcome of an earlier set-point.
        _ if master.has_set_point_under_way(motor) => None,
        Event::SetPointUnanswered { motor: from } if *from == motor => Some(Err(Failure::NoReply)),
        // Feedback of another kind is the late feedback of an earlier set-point.
        Event::Feedback { motor: from, reply } if *from == motor => {
            C::decode_reply(&reply.encode()).ok().map(Ok)
        }
        _ => None,
    }
}
