//! Goes round the motors: of each its errors, its run time and its angle, one question at a time.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::master::{Event, Failure, Master, MotorSet, TicketId};
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
    /// Those that may have let go, and have not answered since.
    doubted: MotorSet,
    /// Those of them that have answered once.
    answered: MotorSet,
}

impl Rounds {
    pub(super) const fn new(now: Instant) -> Self {
        let (doubted, answered) = (MotorSet::EMPTY, MotorSet::EMPTY);
        Self { turn: 0, asked: None, next: now, doubted, answered }
    }

    /// These may have let go. Who has lost its master obeys the third command: once they have answered two they
    /// [are back](Answer::Back).
    pub(super) const fn doubt(&mut self, motors: MotorSet) {
        self.doubted = self.doubted.with(motors);
        self.answered = self.answered.without(motors);
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
        let motor = ticket.motor();
        match answer {
            // A stop took its place.
            Answer::None if matches!(event, Event::Failed { failure: Failure::Stopped, .. }) => {}
            Answer::None => self.doubt(motor.into()),
            Answer::Errors(_) => {}
            _ if self.doubted.contains(motor) => {
                self.doubted.remove(motor);
                self.answered.insert(motor);
            }
            _ if self.answered.contains(motor) => {
                self.answered.remove(motor);
                return Some((motor, Answer::Back));
            }
            _ => {}
        }
        Some((motor, answer))
    }
}
