//! Motors that were told to hold, and may have [let go](crate::master::motor::steady) since.

use crate::id::MotorId;
use crate::kind::Kind;
use crate::master::motor::Motor;
use crate::master::request::Purpose;
use crate::master::{Master, MotorSet, StopKind};

impl<const N: usize> Master<N> {
    /// Tells those of these motors to hold again that have confirmed it and may have let go since. Whether they confirm it
    /// again is reported as of any stop. Without a stop in force, only those that are [left to
    /// hold](Motor::is_left_to_hold) and of which nobody wants anything.
    pub(crate) fn hold_again(&mut self, motors: MotorSet) {
        if self.is_end_of_all_waiting() {
            return;
        }
        let is_it = |&it: &MotorId| {
            let says_so = self.lost_master.contains(it);
            let is_stopped = self.is_stopped(it);
            let is_wanted = self.broadcast.waiting().is_some_and(Kind::may_move);
            let is_loose = |motor: &Motor| {
                motor.may_have_let_go(says_so) && motor.may_be_held_again(is_stopped) && !is_wanted
            };
            motors.contains(it) && self.motor(it).is_some_and(is_loose)
        };
        let loose: MotorSet = self.motors().iter().filter(is_it).collect();
        for motor in loose.iter() {
            self.let_line_answer();
            self.put_stop(motor, StopKind::Hold, Purpose::Stop);
        }
    }
}
