//! Asks motors the same questions again and again, one at a time.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::master::{Event, Failure, Master, MotorSet, TicketId};
use myactuator_protocol_core::time::{Duration, Instant};

use super::Setup;
use super::script::{Answer, Question};

/// How often a question is asked.
const INTERVAL: Duration = Duration::from_millis(10);

/// Whose turn it is, and which question's.
#[derive(Debug)]
pub(super) struct Rounds {
    questions: &'static [Question],
    /// Counts the questions. Each motor gets one question before any gets the next, so that none hears nothing for
    /// long.
    turn: usize,
    asked: Option<(TicketId, Question)>,
    next: Instant,
}

impl Rounds {
    pub(super) const fn new(questions: &'static [Question], now: Instant) -> Self {
        Self { questions, turn: 0, asked: None, next: now }
    }

    /// Whether it is time for the next question, and none is in flight.
    pub(super) fn is_due(&self, now: Instant) -> bool {
        self.asked.is_none() && now >= self.next
    }

    /// Whether it has waited for longer than these.
    pub(super) fn is_before(&self, other: &Self) -> bool {
        self.next < other.next
    }

    /// The motor whose answer is waited for.
    pub(super) fn asked(&self) -> Option<MotorId> {
        self.asked.map(|(ticket, _)| ticket.motor())
    }

    /// Asks one of these motors the next question. One that other rounds are asking keeps its turn: both may come to it
    /// in the same cycle again and again.
    pub(super) fn ask<const N: usize>(
        &mut self,
        motors: MotorSet,
        asked_by_others: Option<MotorId>,
        setup: &Setup,
        master: &mut Master<N>,
        now: Instant,
    ) {
        if motors.is_empty() {
            return;
        }
        let turn = (self.turn + 1) % (motors.len() * self.questions.len());
        let Some(motor) = motors.iter().nth(turn % motors.len()) else { return };
        if asked_by_others == Some(motor) {
            return;
        }
        self.turn = turn;
        let question = self.questions[turn / motors.len()];
        // A motor that is busy is asked in its next turn.
        if let Ok(ticket) = question.ask(motor, setup, master) {
            self.asked = Some((ticket, question));
            // A cycle that begins a little early for the next question does not put off those after it.
            self.next = (self.next + INTERVAL).max(now);
        }
    }

    /// Returns the answer if the event brings it.
    pub(super) fn take(&mut self, event: &Event) -> Option<(MotorId, Answer)> {
        let (ticket, question) = self.asked?;
        let answer = question.answer(ticket, event)?;
        self.asked = None;
        match event {
            // A stop has dropped the question.
            Event::Failed { failure: Failure::Stopped, .. } => None,
            _ => Some((ticket.motor(), answer)),
        }
    }
}
