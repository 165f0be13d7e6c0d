//! The brakes of motors that have reported an error.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::master::{Event, Failure, Master, MotorSet};

use super::Setup;
use super::script::Question;

/// Whose brakes are to lock.
#[derive(Debug)]
pub(super) struct Locks {
    wanted: MotorSet,
    /// Those that were told so and have not answered.
    told: MotorSet,
}

impl Locks {
    pub(super) const fn new() -> Self {
        Self { wanted: MotorSet::EMPTY, told: MotorSet::EMPTY }
    }

    /// This motor's is to lock.
    pub(super) fn want(&mut self, motor: MotorId) {
        self.wanted.insert(motor);
    }

    /// Tells them so. One that is being stopped gets it behind that.
    pub(super) fn ask<const N: usize>(&mut self, setup: &Setup, master: &mut Master<N>) {
        // To look through all ids would take some 200 instructions a cycle.
        if self.wanted.is_empty() {
            return;
        }
        for motor in self.wanted.iter() {
            if Question::LockBrake.ask(motor, setup, master).is_ok() {
                self.wanted.remove(motor);
                self.told.insert(motor);
            }
        }
    }

    /// Takes note of an outcome. Whoever was told nothing, as a stop took the place of that, is told behind the stop.
    pub(super) fn note(&mut self, event: &Event) {
        if self.told.is_empty() {
            return;
        }
        let (Event::Reply { ticket, .. } | Event::Failed { ticket, .. }) = event else { return };
        let motor = ticket.motor();
        if self.told.contains(motor) {
            self.told.remove(motor);
            if matches!(event, Event::Failed { failure: Failure::Stopped, .. }) {
                self.wanted.insert(motor);
            }
        }
    }
}
