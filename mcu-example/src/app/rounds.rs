//! Asks the motors for their errors, run times and angles, one question at a time.

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
    /// Counts the questions. Each motor gets one question before any gets the next, so that none hears nothing for
    /// long.
    turn: usize,
    asked: Option<(TicketId, Question)>,
    next: Instant,
    /// Motors that may have let go, and have not answered since.
    doubted: MotorSet,
    /// Motors that may have let go, and have answered once since.
    answered: MotorSet,
    /// Motors that [have let go](Self::has_let_go), and are not back. The other doubted ones did not answer one
    /// question, and may answer all others.
    gone: MotorSet,
}

impl Rounds {
    pub(super) const fn new(now: Instant) -> Self {
        let (doubted, answered, gone) = (MotorSet::EMPTY, MotorSet::EMPTY, MotorSet::EMPTY);
        Self { turn: 0, asked: None, next: now, doubted, answered, gone }
    }

    /// This motor has let go, or nothing shows that it has not.
    pub(super) fn has_let_go(&mut self, motor: MotorId) {
        self.gone.insert(motor);
        self.doubt(motor.into());
    }

    /// The motors that have let go, and are not back.
    pub(super) const fn gone(&self) -> MotorSet {
        self.gone
    }

    /// These motors may have let go. One that has lost its master obeys the third command. So a motor [is
    /// back](Answer::Back) once it has answered two.
    pub(super) const fn doubt(&mut self, motors: MotorSet) {
        self.doubted = self.doubted.with(motors);
        self.answered = self.answered.without(motors);
    }

    /// Whether it is time for the next question, and none is in flight.
    pub(super) fn is_due(&self, now: Instant) -> bool {
        self.asked.is_none() && now >= self.next
    }

    /// Asks one of these motors the next question. Those that are watched are asked whether their shafts stand, instead
    /// of where they are.
    pub(super) fn ask<const N: usize>(
        &mut self,
        motors: MotorSet,
        watched: MotorSet,
        setup: &Setup,
        master: &mut Master<N>,
        now: Instant,
    ) {
        if motors.is_empty() {
            return;
        }
        self.turn = (self.turn + 1) % (motors.len() * QUESTIONS.len());
        let Some(motor) = motors.iter().nth(self.turn % motors.len()) else { return };
        let question = match QUESTIONS[self.turn / motors.len()] {
            Question::Angle if watched.contains(motor) => Question::Stands,
            question => question,
        };
        // A motor that is busy is asked in its next turn.
        if let Ok(ticket) = question.ask(motor, setup, master) {
            self.asked = Some((ticket, question));
        }
        self.next = now + INTERVAL;
    }

    /// Returns the answer if the event brings it.
    pub(super) fn take(&mut self, event: &Event) -> Option<(MotorId, Answer)> {
        let (ticket, question) = self.asked?;
        let answer = question.answer(ticket, event)?;
        self.asked = None;
        let motor = ticket.motor();
        match answer {
            // A stop has dropped the question.
            Answer::None if matches!(event, Event::Failed { failure: Failure::Stopped, .. }) => {}
            // It has answered nothing since the last one that it did not answer.
            Answer::None if self.doubted.contains(motor) => self.has_let_go(motor),
            Answer::None => self.doubt(motor.into()),
            Answer::Errors(_) => {}
            _ if self.doubted.contains(motor) => {
                self.doubted.remove(motor);
                self.answered.insert(motor);
            }
            _ if self.answered.contains(motor) => {
                self.answered.remove(motor);
                let was_gone = self.gone.contains(motor);
                self.gone.remove(motor);
                return Some((motor, Answer::Back { was_gone }));
            }
            _ => {}
        }
        Some((motor, answer))
    }
}
