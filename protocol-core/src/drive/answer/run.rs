//! The commands that move the motor (manual 2.18 to 2.24, 5), as [`decisions`](crate::drive::decisions)
//! says.

use crate::command::RawMotion;
use crate::command::{
    AbsolutePosition, Direction, ForcePosition, IncrementalPosition, SingleTurnPosition, Speed,
    Torque,
};
use crate::drive::control::SetPoint;
use crate::drive::{Drive, Memory, NotRunReason, Plant, brake};
use crate::opcode::Opcode;
use crate::units::{MaxSpeed, MaxTorque};

/// Closer than this to its target, degrees, a single-turn command goes the short way.
const SHORT_WAY_DEG: f64 = 0.5;

/// What a command does about a locked brake.
#[derive(Clone, Copy, PartialEq)]
enum LockedBrake {
    Opens,
    Forbids,
}

impl<P: Plant, M: Memory> Drive<P, M> {
    /// 0x81. A locked brake holds already.
    pub(super) fn run_stop(&mut self) {
        if !self.brake.holds() {
            self.run(Opcode::Stop, SetPoint::Stop, LockedBrake::Forbids);
        }
    }

    /// 0xA1.
    pub(super) fn run_torque(&mut self, torque: &Torque) {
        let set_point = SetPoint::Current { current_a: torque.current.amperes() };
        self.run(Opcode::Torque, set_point, LockedBrake::Forbids);
    }

    /// 0xA2.
    pub(super) fn run_speed(&mut self, speed: &Speed) {
        let limit_a = match speed.max_torque.raw() {
            0 => self.parameters.stall_current_a,
            _ => self.limit_a(speed.max_torque),
        };
        let set_point = SetPoint::Speed { speed_dps: speed.speed.dps(), limit_a };
        self.run(Opcode::Speed, set_point, LockedBrake::Opens);
    }

    /// 0xA4.
    pub(super) fn run_absolute(&mut self, to: &AbsolutePosition) {
        let limit_a = self.parameters.stall_current_a;
        let target = to.angle.degrees_f64();
        self.run_position(Opcode::AbsolutePosition, target, to.max_speed, limit_a);
    }

    /// 0xA6; whether its direction has a name.
    pub(super) fn run_single_turn(&mut self, to: &SingleTurnPosition) -> bool {
        let here = self.encoder.angle_deg();
        let clockwise = (f64::from(to.angle.raw()) / 100.0 - here).rem_euclid_deg();
        let near = clockwise.min(360.0 - clockwise) < SHORT_WAY_DEG;
        let way = match to.direction {
            Direction::CLOCKWISE | Direction::COUNTER_CLOCKWISE if near && clockwise < 180.0 => {
                clockwise
            }
            Direction::CLOCKWISE | Direction::COUNTER_CLOCKWISE if near => clockwise - 360.0,
            Direction::CLOCKWISE => clockwise,
            Direction::COUNTER_CLOCKWISE => clockwise - 360.0,
            _ => return false,
        };
        if self.active.save_multi_turn {
            self.not_run(Opcode::SingleTurnPosition, NotRunReason::NotSingleTurn);
        } else {
            let limit_a = self.parameters.stall_current_a;
            self.run_position(Opcode::SingleTurnPosition, here + way, to.max_speed, limit_a);
        }
        true
    }

    /// 0xA8.
    pub(super) fn run_incremental(&mut self, by: &IncrementalPosition) {
        let limit_a = self.parameters.stall_current_a;
        let target = self.encoder.angle_deg() + by.angle.degrees_f64();
        self.run_position(Opcode::IncrementalPosition, target, by.max_speed, limit_a);
    }

    /// 0xA9.
    pub(super) fn run_force(&mut self, to: &ForcePosition) {
        let limit_a = self.limit_a(to.max_torque);
        let target = to.angle.degrees_f64();
        self.run_position(Opcode::ForcePosition, target, to.max_speed, limit_a);
    }

    /// Motion mode.
    pub(super) fn run_motion(&mut self, motion: &RawMotion) {
        let set_point = SetPoint::Motion(self.parameters.motion_ranges.set_point(motion));
        self.run(Opcode::Motion, set_point, LockedBrake::Forbids);
    }

    /// A part of the rated current; above the stall current there is no limit but that.
    fn limit_a(&self, max_torque: MaxTorque) -> f32 {
        let limit_a = max_torque.percent() / 100.0 * self.parameters.rated_current_a;
        limit_a.min(self.parameters.stall_current_a)
    }

    fn run_position(&mut self, opcode: Opcode, target_deg: f64, max_speed: MaxSpeed, limit_a: f32) {
        let mut target_deg = target_deg;
        if let Some(max) = self.active.max_positive_angle {
            target_deg = target_deg.min(max.degrees_f64());
        }
        if let Some(min) = self.active.max_negative_angle {
            target_deg = target_deg.max(min.degrees_f64());
        }
        let max_speed_dps = max_speed.dps();
        let set_point = SetPoint::Position { target_deg, max_speed_dps, limit_a };
        self.run(opcode, set_point, LockedBrake::Opens);
    }

    /// Takes a set-point over, unless something forbids it.
    fn run(&mut self, opcode: Opcode, set_point: SetPoint, locked_brake: LockedBrake) {
        let errors = self.faults.all();
        let forbidden = if !errors.is_empty() {
            Some(NotRunReason::Fault(errors))
        } else if self.protection.is_tripped() {
            Some(NotRunReason::CommunicationLost)
        } else if self.brake.holds() && locked_brake == LockedBrake::Forbids {
            Some(NotRunReason::BrakeLocked)
        } else {
            None
        };
        if let Some(reason) = forbidden {
            return self.not_run(opcode, reason);
        }
        if locked_brake == LockedBrake::Opens && self.brake.holds() {
            let quirks = self.parameters.quirks;
            let at = brake::opening_time(self.clock, &quirks, &mut self.random);
            self.brake.release_for_motion(at);
        }
        let input = self.input();
        self.controller.set(set_point, &input);
    }
}

/// The remainder of an angle within 0 to less than 360 degrees.
trait WithinTurn {
    fn rem_euclid_deg(self) -> f64;
}

impl WithinTurn for f64 {
    fn rem_euclid_deg(self) -> f64 {
        let rest = self % 360.0;
        if rest < 0.0 { rest + 360.0 } else { rest }
    }
}
