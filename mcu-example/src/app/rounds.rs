//! Goes round the motors: of each its errors, its run time and its angle, one question at a time.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::master::{Event, Master, MotorSet, TicketId};
use myactuator_protocol_core::time::{Duration, Instant};

use super::Setup;
use super::script::{Answer, Question};

/// How often a question is asked.
const INTERVAL: Duration = Duration::from_millis(10);
const QUESTIONS: [Question; 3] = [Question::Errors, Question::RunTime, Question::Angle];

/// Whose turn it is.
#[derive(Debug)]
pub(super) struct Rounds {
    /// Counts the questions: one to each motor, then the next one to each, so that none waits for long
    /// until it hears something.
    turn: usize,
    asked: Option<(TicketId, Question)>,
    next: Instant,
}

impl Rounds {
    pub(super) const fn new(now: Instant) -> Self {
        Self { turn: 0, asked: None, next: now }
    }

    /// Asks one of these motors the next question if it is time and nobody is being asked.
    pub(super) fn ask<const N: usize>(
        &mut self,
        motors: MotorSet,
        setup: &Setup,
        master: &mut Master<N>,
        now: Instant,
    ) {
        if self.asked.is_some() || now < self.next || motors.is_empty() {
            return;
        }
        self.turn = (self.turn + 1) % (motors.len() * QUESTIONS.len());
        let Some(motor) = motors.iter().nth(self.turn % motors.len()) else { return };
        let question = QUESTIONS[self.turn / motors.len()];
        // A motor that is busy is asked in its next turn.
        if let Ok(ticket) = question.ask(motor, setup, master) {
            self.asked = Some((ticket, question));
        }
        self.next = now + INTERVAL;
    }

    /// The answer, if the event brings it.
    pub(super) fn take(&mut self, event: &Event) -> Option<(MotorId, Answer)> {
        let (ticket, question) = self.asked?;
        let answer = question.answer(ticket, event)?;
        self.asked = None;
        Some((ticket.motor(), answer))
    }
}
