//! Motors that have restarted get no moves before the caller knows.

use crate::id::MotorId;
use crate::master::Master;
use crate::master::motor::LastSent;

impl<const N: usize> Master<N> {
    /// The caller has found out that a motor has restarted, by its angle for example, which the master has not: as
    /// [`Event::Restarted`](crate::master::Event::Restarted), which follows. A motor without a place gets one; without
    /// room for it nothing can move it.
    pub fn note_restart(&mut self, motor: MotorId) {
        let now = self.now;
        self.offer = None;
        let _ = self.place_for(motor);
        self.change(motor, |motor, config| motor.begin_anew(config, now));
        self.cancel_move_after_restart();
    }

    /// Whether a motor [has restarted](crate::master::Event::Restarted) and was not [resumed](Self::resume).
    pub fn has_restarted(&self, motor: MotorId) -> bool {
        self.motor(motor).is_some_and(|motor| motor.has_restarted)
    }

    /// Takes set-points and moves again for a motor that [has restarted](crate::master::Event::Restarted): the caller
    /// knows where it is. However long it is silent from then on, it is moved once before it is heard.
    pub fn resume(&mut self, motor: MotorId) {
        self.change(motor, |motor, _| {
            motor.has_restarted = false;
            motor.last_sent.insert(LastSent::IS_RESUMED);
        });
    }

    pub(super) fn has_any_restarted(&self) -> bool {
        self.at(self.places.taken).any(|(_, motor)| motor.has_restarted)
    }

    /// What would move a motor that has restarted does not go by itself.
    pub(super) fn cancel_move_after_restart(&mut self) {
        if self.broadcast.waits_to_move() && self.has_any_restarted() {
            self.broadcast.cancel();
        }
    }
}
