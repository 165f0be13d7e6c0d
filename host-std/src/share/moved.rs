//! Which motors may be moving.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::master::MotorSet;

/// Motors that were told to move since they were last stopped.
#[derive(Debug, Default)]
pub(super) struct Moved {
    all: MotorSet,
    /// Since a stop was last called for: its confirmation says nothing of these.
    since_stop: MotorSet,
}

impl Moved {
    pub(super) const fn all(&self) -> MotorSet {
        self.all
    }

    pub(super) fn is_moved(&mut self, motor: MotorId) {
        self.all.insert(motor);
        self.since_stop.insert(motor);
    }

    pub(super) fn is_to_stop(&mut self, motors: MotorSet) {
        self.since_stop = self.since_stop.without(motors);
    }

    pub(super) fn is_stopped(&mut self, motor: MotorId) {
        if !self.since_stop.contains(motor) {
            self.all.remove(motor);
        }
    }
}
