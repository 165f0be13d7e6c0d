//! The loops on buses of memory and time that moves only while somebody waits.

mod blocking;
mod concurrent;
mod half_duplex;
mod world;

use crate::MotorId;
use crate::command::IncrementalPosition;
use crate::units::{Angle, MaxSpeed};

fn id(id: u8) -> MotorId {
    MotorId::new(id).unwrap()
}

/// A command that must never be sent twice.
fn step() -> IncrementalPosition {
    IncrementalPosition { max_speed: MaxSpeed::from_raw(100), angle: Angle::from_raw(9_000) }
}
