//! What motors answer.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::master::Event;

use super::motor::Motor;
use super::script::Answer;
use super::state::State;
use super::{App, Moment};
use crate::board::Board;
use crate::report::{Report, Trouble};

impl<const N: usize> App<N> {
    /// Takes the outcome of a request of the rounds or of the script.
    // Rare beside feedback: its registers are not to be saved for each.
    #[inline(never)]
    pub(super) fn handle_answer(&mut self, event: &Event, at: &mut Moment<'_, N, impl Board>) {
        self.locks.note(event);
        let answer = self.rounds.take(event).or_else(|| {
            let answer = self.state.script()?.take(event);
            if let (State::Looking { .. }, Some((motor, Answer::None))) = (&self.state, answer) {
                self.missed_look(motor, at);
            }
            answer
        });
        let Some((motor, answer)) = answer else { return };
        if let Some(trouble) = self.note(motor, answer, at) {
            self.trouble(trouble, at);
        }
    }

    /// Takes note of an answer, and returns what is wrong with it.
    fn note(
        &mut self,
        motor: MotorId,
        answer: Answer,
        at: &mut Moment<'_, N, impl Board>,
    ) -> Option<Trouble> {
        match answer {
            Answer::None if !self.expected.contains(motor) => {
                // No motor has this id.
                at.master.forget(motor);
                None
            }
            Answer::None => Some(self.silent(motor, at)),
            Answer::Done => None,
            Answer::Back { was_gone } => {
                self.hold_again(motor, was_gone, at.now);
                was_gone.then_some(Trouble::Restarted { motor })
            }
            Answer::Version(version_date) => {
                self.expected.insert(motor);
                let is_known = self.setup.accepts(version_date);
                match self.motors.push(Motor::new(motor, version_date)) {
                    _ if !is_known => Some(Trouble::OtherFirmware { motor, version_date }),
                    Err(_) => Some(Trouble::Refused { motor }),
                    Ok(()) => None,
                }
            }
            Answer::Model(model) => {
                let version_date = self.motor(motor)?.version_date;
                at.board.log(&Report::Found { motor, model, version_date });
                None
            }
            Answer::Errors(flags) => Some(Trouble::Errors { motor, flags }),
            Answer::Turns if matches!(self.state, State::Stopped { .. }) => {
                // What makes one brake slip may make others slip.
                self.unseen = self.unseen.with(self.watched());
                None
            }
            Answer::Turns => Some(Trouble::Turns { motor }),
            Answer::Angle(angle) => {
                self.motor(motor)?.angle = angle;
                None
            }
            Answer::Home(angle) => {
                let setup = self.setup;
                if !self.motor(motor)?.can_begin_at(angle, &setup) {
                    return Some(Trouble::OutOfRange { motor });
                }
                at.board.log(&Report::Ready { motor, angle });
                None
            }
        }
    }
}
