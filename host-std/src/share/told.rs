//! Which motors hold still, and which may be moving.

use myactuator_protocol_core::master::{MotorSet, StopKind};
use myactuator_protocol_core::{Kind, MotorId};

/// What a motor was told last of its motion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Last {
    /// Nothing, or it has confirmed that it is off or that its brake locks.
    #[default]
    Nothing,
    ToMove,
    /// It has not confirmed this yet: it may go on moving.
    ToStop(StopKind),
    /// It has confirmed that it holds still.
    ToHold,
}

/// What each motor was told last of its motion.
#[derive(Debug, Default)]
pub(super) struct Told([Last; MotorId::COUNT]);

impl Told {
    pub(super) fn moves(&mut self, motor: MotorId) {
        self.0[motor.index()] = Last::ToMove;
    }

    pub(super) fn stops(&mut self, motors: MotorSet, kind: StopKind) {
        motors.iter().for_each(|motor| self.0[motor.index()] = Last::ToStop(kind));
    }

    /// Told by a command that ends motion. A locked brake holds without the motor.
    pub(super) fn ends_motion(&mut self, motor: MotorId, by: Kind) {
        self.stops(motor.into(), StopKind::by(by).unwrap_or(StopKind::Off));
    }

    /// It has confirmed what ends its motion. That says nothing of what it was told since.
    pub(super) fn confirmed(&mut self, motor: MotorId) {
        let last = &mut self.0[motor.index()];
        *last = match *last {
            Last::ToStop(StopKind::Hold) => Last::ToHold,
            Last::ToStop(StopKind::Off) => Last::Nothing,
            other => other,
        };
    }

    /// Those that hold still until they are told otherwise.
    pub(super) fn holding(&self) -> MotorSet {
        self.with(|last| last == Last::ToHold)
    }

    /// Those that may be moving.
    pub(super) fn may_move(&self) -> MotorSet {
        self.with(|last| matches!(last, Last::ToMove | Last::ToStop(_)))
    }

    fn with(&self, is_it: impl Fn(Last) -> bool) -> MotorSet {
        MotorId::all().filter(|motor| is_it(self.0[motor.index()])).collect()
    }
}
