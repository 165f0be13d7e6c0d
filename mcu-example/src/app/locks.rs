//! The brakes of motors that have reported an error.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::master::{Event, Failure, Master, MotorSet, TicketId};

use super::Setup;
use super::script::Question;

/// Whose brakes are to lock.
#[derive(Debug)]
pub(super) struct Locks {
    wanted: MotorSet,
    /// The one that was told so and has not answered.
    told: Option<TicketId>,
}

impl Locks {
    pub(super) const fn new() -> Self {
        Self { wanted: MotorSet::EMPTY, told: None }
    }

    /// This motor's is to lock.
    pub(super) fn want(&mut self, motor: MotorId) {
        self.wanted.insert(motor);
    }

    /// Tells them so, one after the other. One that is being stopped gets it behind that.
    pub(super) fn ask<const N: usize>(&mut self, setup: &Setup, master: &mut Master<N>) {
        // To look through all ids would take some 200 instructions a cycle.
        if self.wanted.is_empty() || self.told.is_some() {
            return;
        }
        let ask = |motor| Question::LockBrake.ask(motor, setup, master).ok();
        self.told = self.wanted.iter().find_map(ask);
        if let Some(told) = self.told {
            self.wanted.remove(told.motor());
        }
    }

    /// Takes note of an outcome. Whoever was told nothing, as a stop took the place of that, is told behind the stop.
    pub(super) fn note(&mut self, event: &Event) {
        let Some(told) = self.told else { return };
        let failure = match event {
            Event::Reply { ticket, .. } if *ticket == told => None,
            Event::Failed { ticket, failure } if *ticket == told => Some(failure),
            _ => return,
        };
        self.told = None;
        if failure == Some(&Failure::Stopped) {
            self.wanted.insert(told.motor());
        }
    }
}

#[cfg(test)]
mod tests {
    use myactuator_protocol_core::command::{MotionRanges, ReadModel};
    use myactuator_protocol_core::master::{Config, StopKind};

    use super::*;
    use crate::Movement;

    #[test]
    fn what_came_of_another_question_is_not_what_came_of_the_lock() {
        let ranges = MotionRanges::V4_3;
        let setup = Setup::new(Movement::Motion { ranges, kp: 0.0, kd: 0.0 });
        let [mut earlier, mut master] = [(); 2].map(|()| Master::<2>::new(Config::can(1_000_000)));
        let motor = MotorId::MIN;
        assert!(earlier.request(motor, ReadModel).is_ok());
        // So that its next ticket is another.
        assert!(master.request(MotorId::all().last().expect("32"), ReadModel).is_ok());

        let mut locks = Locks::new();
        locks.want(motor);
        locks.ask(&setup, &mut master);
        let mut is_stopped = |master: &mut Master<2>| {
            master.stop_all(StopKind::Hold, MotorSet::EMPTY).expect("it has a place");
            while let Some(event) = master.poll_event() {
                locks.note(&event);
            }
            locks.wanted.contains(motor)
        };
        assert!(!is_stopped(&mut earlier));
        assert!(is_stopped(&mut master));
    }
}
