//! What motors answer.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::master::Event;

use super::belief::Seen;
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
        self.locks.note(event, at.now);
        match self.watch.take(event) {
            Some((_, Answer::Turns)) => self.slips(at),
            Some((motor, answer)) => self.take_check(motor, answer, at),
            None => {}
        }
        let (motor, answer) = if let Some((motor, answer)) = self.rounds.take(event) {
            self.take_turn(motor, answer, at);
            (motor, answer)
        } else if let Some((motor, answer)) = self.state.script().and_then(|it| it.take(event)) {
            if let State::Looking { .. } = self.state {
                self.take_check(motor, answer, at);
            }
            (motor, answer)
        } else {
            return;
        };
        if let Some(trouble) = self.note(motor, answer, at) {
            self.trouble(trouble, at);
        }
    }

    /// What an answer in the rounds, or none, shows of a motor.
    fn take_turn(&mut self, motor: MotorId, answer: Answer, at: &mut Moment<'_, N, impl Board>) {
        match answer {
            Answer::None => self.see(motor, Seen::Missed, at.now),
            // It holds nothing.
            Answer::Errors(_) => {}
            answer => {
                let seen = if answer == Answer::Sound { Seen::Sound } else { Seen::Answered };
                let [before, after] = self.beliefs.see(motor, seen);
                if after.obeys() && !before.obeys() {
                    self.hold_again(motor, before, at);
                }
            }
        }
    }

    /// What an answer, or none, shows of a motor whose shaft is checked or watched, or which is told to hold it.
    fn take_check(&mut self, motor: MotorId, answer: Answer, at: &mut Moment<'_, N, impl Board>) {
        match answer {
            Answer::None => {
                let [before, after] = self.beliefs.see(motor, Seen::MissedCheck);
                if !after.is_unchecked() && !before.is_watched_in_vain() {
                    at.board.log(&Report::Trouble(Trouble::Silent { motor }));
                }
            }
            Answer::Done => _ = self.beliefs.see(motor, Seen::Stands),
            _ => {}
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
            Answer::Done | Answer::Sound => None,
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
