//! The loops on buses of memory and time that moves only while somebody waits.

mod blocking;
mod calls;
mod concurrent;
mod echoes;
mod failing;
mod floods;
mod guard;
mod half_duplex;
mod halted;
mod held_up;
mod left_halfway;
mod loads;
mod moves;
mod patience;
mod watch;
mod world;

use crate::MotorId;
use crate::command::{IncrementalPosition, Torque};
use crate::units::{Angle, Current, MaxSpeed};

fn id(id: u8) -> MotorId {
    MotorId::new(id).unwrap()
}

fn torque() -> Torque {
    Torque { current: Current::from_raw(-100) }
}

/// A command that must never be sent twice.
fn step() -> IncrementalPosition {
    IncrementalPosition { max_speed: MaxSpeed::from_raw(100), angle: Angle::from_raw(9_000) }
}
