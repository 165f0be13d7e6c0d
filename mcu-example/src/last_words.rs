//! What a firmware that cannot go on still has to say.

use myactuator_protocol_core::command::Stop;
use myactuator_protocol_core::master::MotorSet;
use myactuator_protocol_core::{Channel, Packet, Target};

/// The stops that a panicking or faulting firmware sends: one to all motors at once, then one to each
/// of `motors`, for on CAN the first reaches only those whose id filter is off.
///
/// Needs no heap, no interrupt and no lock. The caller sends them by looking at the controller's
/// registers, gives up on a bus that takes nothing, leaves each motor time to answer where answers and
/// commands share a line, and then resets.
pub fn last_words(motors: MotorSet) -> impl Iterator<Item = Packet> {
    let each = motors.iter().map(Target::Motor);
    core::iter::once(Target::All)
        .chain(each)
        .map(|target| Packet { channel: Channel::Command(target), data: Stop.encode() })
}
