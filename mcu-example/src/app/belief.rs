//! What is believed of each motor, and why: whether it obeys, and what holds its shaft.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::master::MotorSet;

/// What is seen of a motor.
#[derive(Clone, Copy, Debug)]
pub(super) enum Seen {
    /// It restarted or lost its master.
    LetGo,
    /// It reports an error: it holds nothing, and its brake is told to lock.
    Failed,
    /// It reports no error.
    Sound,
    /// It did not answer a question of the rounds, or did not confirm a stop in time.
    Missed,
    /// It answered a question of the rounds.
    Answered,
    /// It holds, and its brake is open.
    Ready,
    /// Its brake is told to lock in a shutdown.
    ShutDown,
    /// That shutdown was broken off, or another brake that is watched slips.
    MayTurn,
    /// Its shaft was checked or watched and stands, or it cannot be asked.
    Stands,
    /// Its shaft turns.
    Turns,
    /// It did not answer while its shaft was checked or watched, or while it was told to hold.
    MissedCheck,
}

/// Whether a motor obeys. One that has lost its master obeys the third command, so it does after two answers.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Contact {
    Obeys,
    /// It missed one question, and has answered so many since: it may have let go, or never answer that one.
    Doubted(u8),
    /// It holds nothing, and has answered so many questions since.
    LetGo(u8),
    /// It has an error, and holds nothing.
    Failed,
}

/// What holds a shaft while the motors are stopped. Behind a locked brake a motor holds nothing, whatever it confirms.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Shaft {
    /// Its motor.
    Held,
    /// Its brake, if that is locked. Then the motor is asked again and again whether the shaft stands, and may have
    /// missed the last question.
    Watched { missed: bool },
    /// Unknown: it is checked once its motor has confirmed a stop. Twice if the motor missed that once: it may never
    /// answer this, and while shafts are checked, the button does nothing.
    Unchecked { missed: bool },
    /// It turned, and the motor is told to hold it. Once: it may not be able to.
    Turned { missed: bool },
}

/// What is believed of a motor.
#[derive(Clone, Copy, Debug)]
pub(super) struct Belief {
    contact: Contact,
    shaft: Shaft,
}

impl Belief {
    const fn after(self, seen: Seen) -> Self {
        use Contact::{Doubted, Failed, LetGo, Obeys};
        use Shaft::{Held, Turned, Unchecked, Watched};
        let contact = match (self.contact, seen) {
            (_, Seen::LetGo) | (Doubted(0) | LetGo(_) | Failed, Seen::Missed) => LetGo(0),
            (_, Seen::Missed) => Doubted(0),
            (Obeys | Doubted(_), Seen::Failed) | (Failed, Seen::Answered) => Failed,
            (Doubted(0), Seen::Answered | Seen::Sound) => Doubted(1),
            (LetGo(0), Seen::Answered | Seen::Sound) => LetGo(1),
            (_, Seen::Answered | Seen::Sound) => Obeys,
            (same, _) => same,
        };
        let shaft = match (self.shaft, seen) {
            (_, Seen::Ready) => Held,
            (_, Seen::ShutDown) => Watched { missed: false },
            // Its brake may have locked.
            (Held | Turned { .. }, Seen::LetGo | Seen::Missed) | (Held, Seen::Failed) => {
                Watched { missed: false }
            }
            // It could not be told to hold it before.
            (Turned { .. }, _) if !matches!(self.contact, Obeys) && matches!(contact, Obeys) => {
                Watched { missed: false }
            }
            (_, Seen::MayTurn) => Unchecked { missed: false },
            (Unchecked { .. } | Watched { .. }, Seen::Stands) => Watched { missed: false },
            (Unchecked { missed }, Seen::Turns) => Turned { missed },
            (_, Seen::Turns) => Turned { missed: false },
            (Unchecked { missed: false } | Turned { missed: false }, Seen::MissedCheck) => {
                Unchecked { missed: true }
            }
            (Unchecked { missed: true } | Watched { .. }, Seen::MissedCheck) => {
                Watched { missed: true }
            }
            (same, _) => same,
        };
        Self { contact, shaft }
    }

    pub(super) fn obeys(&self) -> bool {
        self.contact == Contact::Obeys
    }

    pub(super) fn has_failed(&self) -> bool {
        self.contact == Contact::Failed
    }

    pub(super) fn has_let_go(&self) -> bool {
        matches!(self.contact, Contact::LetGo(_))
    }

    pub(super) fn is_watched(&self) -> bool {
        matches!(self.shaft, Shaft::Watched { .. })
    }

    /// It is watched, and does not say whether its shaft stands.
    pub(super) fn is_watched_in_vain(&self) -> bool {
        self.shaft == Shaft::Watched { missed: true }
    }

    pub(super) fn is_unchecked(&self) -> bool {
        matches!(self.shaft, Shaft::Unchecked { .. })
    }
}

/// What is believed of all motors.
#[derive(Debug)]
pub(super) struct Beliefs([Belief; MotorId::COUNT]);

impl Beliefs {
    /// An earlier run of the firmware may have locked brakes.
    pub(super) const fn new() -> Self {
        Self(
            [Belief { contact: Contact::Obeys, shaft: Shaft::Watched { missed: false } };
                MotorId::COUNT],
        )
    }

    /// Takes note of what is seen of a motor. Returns what was believed before, and what is now.
    pub(super) fn see(&mut self, motor: MotorId, seen: Seen) -> [Belief; 2] {
        let belief = &mut self.0[motor.index()];
        let before = *belief;
        *belief = before.after(seen);
        [before, *belief]
    }

    pub(super) fn see_all(&mut self, motors: MotorSet, seen: Seen) {
        motors.iter().for_each(|motor| _ = self.see(motor, seen));
    }

    /// The motors of which this is believed.
    pub(super) fn those(&self, is: fn(&Belief) -> bool) -> MotorSet {
        MotorId::all().filter(|motor| is(&self.0[motor.index()])).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_motor_that_missed_a_question_and_reports_an_error_has_failed() {
        let mut beliefs = Beliefs::new();
        beliefs.see(MotorId::MIN, Seen::Missed);
        let [before, after] = beliefs.see(MotorId::MIN, Seen::Failed);
        assert!(!before.has_failed() && after.has_failed());
    }

    #[test]
    fn a_motor_with_an_error_that_misses_a_question_has_let_go() {
        let mut beliefs = Beliefs::new();
        beliefs.see(MotorId::MIN, Seen::Failed);
        let [_, after] = beliefs.see(MotorId::MIN, Seen::Missed);
        assert!(after.has_let_go());
    }

    #[test]
    fn a_motor_that_turned_before_it_obeyed_is_watched_once_it_does() {
        let mut beliefs = Beliefs::new();
        for seen in [Seen::LetGo, Seen::MayTurn, Seen::Turns, Seen::Failed, Seen::Sound] {
            beliefs.see(MotorId::MIN, seen);
        }
        let [_, after] = beliefs.see(MotorId::MIN, Seen::Answered);
        assert!(after.obeys() && after.is_watched());
    }
}
