//! The commands that move the motor (manual 2.18 to 2.24, 5), as [`decisions`](crate::drive::decisions)
//! says.

use crate::command::{Direction, SingleTurnPosition, Speed};
use crate::drive::control::SetPoint;
use crate::drive::{Drive, Event, Memory, NotRunReason, Plant};
use crate::opcode::Opcode;
use crate::units::{MaxSpeed, MaxTorque};

/// Closer than this to its target, degrees, a single-turn command goes the short way.
const SHORT_WAY_DEG: f64 = 0.5;

/// What a command does about a locked brake.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum LockedBrake {
    Opens,
    Forbids,
}

impl<P: Plant, M: Memory> Drive<P, M> {
    /// 0xA2.
    pub(super) fn run_speed(&mut self, speed: &Speed) {
        let limit_a = match speed.max_torque.raw() {
            0 => self.parameters.stall_current_a,
            _ => self.limit_a(speed.max_torque),
        };
        let set_point = SetPoint::Speed { speed_dps: speed.speed.dps(), limit_a };
        self.run(Opcode::Speed, set_point, LockedBrake::Opens);
    }

    /// 0xA6. Returns whether its direction has a name.
    pub(super) fn run_single_turn(&mut self, to: &SingleTurnPosition) -> bool {
        let here = self.encoder.angle_deg();
        if to.direction.name().is_none() {
            return false;
        }
        let clockwise = within_turn(f64::from(to.angle.raw()) / 100.0 - here);
        let is_near = clockwise.min(360.0 - clockwise) < SHORT_WAY_DEG;
        let goes_clockwise =
            if is_near { clockwise < 180.0 } else { to.direction == Direction::CLOCKWISE };
        let way = if goes_clockwise { clockwise } else { clockwise - 360.0 };
        if self.active.save_multi_turn {
            self.not_run(Opcode::SingleTurnPosition, NotRunReason::NotSingleTurn);
        } else {
            let limit_a = self.parameters.stall_current_a;
            self.run_position(Opcode::SingleTurnPosition, here + way, to.max_speed, limit_a);
        }
        true
    }

    /// A share of the rated current; above the stall current only that limits it.
    pub(super) fn limit_a(&self, max_torque: MaxTorque) -> f32 {
        let limit_a = max_torque.percent() / 100.0 * self.parameters.rated_current_a;
        limit_a.min(self.parameters.stall_current_a)
    }

    pub(super) fn run_position(
        &mut self,
        opcode: Opcode,
        target_deg: f64,
        max_speed: MaxSpeed,
        limit_a: f32,
    ) {
        let asked_deg = target_deg;
        let target_deg = self.active.position_limits().nearest(target_deg);
        let max_speed_dps = max_speed.dps();
        let set_point = SetPoint::Position { target_deg, max_speed_dps, limit_a };
        let runs = self.run(opcode, set_point, LockedBrake::Opens);
        if runs && target_deg != asked_deg {
            let limit_deg = target_deg;
            self.events.push(Event::TargetLimited { opcode, asked_deg, limit_deg });
        }
    }

    /// Takes a set-point, unless something forbids it. Returns whether it did.
    pub(super) fn run(
        &mut self,
        opcode: Opcode,
        set_point: SetPoint,
        locked_brake: LockedBrake,
    ) -> bool {
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
            self.not_run(opcode, reason);
            return false;
        }
        if locked_brake == LockedBrake::Opens && self.brake.holds() {
            let at = self.brake_moves_at(self.clock);
            self.brake.release_for_motion(at, self.clock);
        }
        let input = self.input();
        self.controller.set(set_point, &input);
        true
    }
}

/// The remainder of an angle within 0 to less than 360 degrees.
fn within_turn(angle_deg: f64) -> f64 {
    let rest = angle_deg % 360.0;
    if rest < 0.0 { rest + 360.0 } else { rest }
}
