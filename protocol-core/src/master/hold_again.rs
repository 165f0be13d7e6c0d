//! Motors that were told to hold, and may have [let go](crate::master::motor::steady) since.

use crate::id::MotorId;
use crate::master::request::Purpose;
use crate::master::{Master, MotorSet, StopKind};

impl<const N: usize> Master<N> {
    /// Tells those of these motors to hold again that have confirmed it and may have let go since. Whether they confirm it
    /// again is reported as of any stop. Without a stop in force, only those that are [left to
    /// hold](crate::master::motor::Motor::is_left_to_hold) and of which nobody wants anything.
    pub(crate) fn hold_again(&mut self, motors: MotorSet) {
        // All are about to be told something else.
        if self.broadcast.waiting().is_some_and(|kind| kind.ends_motion() || kind.may_move()) {
            return;
        }
        let is_loose = |&it: &MotorId| {
            let (says_so, is_stopped) = (self.lost_master.contains(it), self.is_stopped(it));
            self.motor(it).is_some_and(|motor| {
                motor.may_have_let_go(says_so) && motor.may_be_held_again(is_stopped)
            })
        };
        let loose: MotorSet = motors.iter().filter(is_loose).collect();
        for motor in loose.iter() {
            self.let_line_answer();
            self.put_stop(motor, StopKind::Hold, Purpose::Stop);
        }
    }
}
