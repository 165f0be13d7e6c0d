//! A motor that has restarted gets no moves before the caller knows.

use crate::id::MotorId;
use crate::kind::Kind;
use crate::master::Master;
use crate::master::motor::LastSent;

impl<const N: usize> Master<N> {
    /// The caller has found out that a motor has restarted, for example by its angle, and the master has not. This has
    /// the effect of [`Event::Restarted`](crate::master::Event::Restarted), which is also reported. A motor without a
    /// place gets one. If none is left, no request or set-point for it is accepted anyway.
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

    /// The caller knows where a motor is that [has restarted](crate::master::Event::Restarted): set-points and moves
    /// for it are accepted again. However long it is silent from then on, one move is sent to it before it is heard.
    pub fn resume(&mut self, motor: MotorId) {
        self.change(motor, |motor, _| {
            motor.has_restarted = false;
            motor.last_sent.insert(LastSent::IS_RESUMED);
        });
    }

    pub(super) fn has_any_restarted(&self) -> bool {
        self.at(self.places.taken).any(|(_, motor)| motor.has_restarted)
    }

    /// Drops a broadcast that would move a motor that has restarted.
    pub(super) fn cancel_move_after_restart(&mut self) {
        if self.broadcast.waiting().is_some_and(Kind::moves) && self.has_any_restarted() {
            self.broadcast.cancel();
        }
    }
}
