//! The last frames of a firmware that cannot go on.

use myactuator_protocol_core::command::Stop;
use myactuator_protocol_core::master::MotorSet;
use myactuator_protocol_core::{Channel, Packet, Target};

/// The stops that a firmware sends when it panics or faults: first one to all motors, then one to each of `motors`. On
/// CAN the first reaches only motors whose id filter is off.
///
/// Needs no heap, interrupts or locks. The caller:
///
/// - sends them by polling the controller's registers;
/// - gives up on a bus that takes nothing;
/// - where answers and commands share a line, leaves each motor time to answer;
/// - then resets.
pub fn last_words(motors: MotorSet) -> impl Iterator<Item = Packet> {
    let each = motors.iter().map(Target::Motor);
    core::iter::once(Target::All)
        .chain(each)
        .map(|target| Packet { channel: Channel::Command(target), data: Stop.encode() })
}

#[cfg(test)]
mod tests {
    use myactuator_protocol_core::MotorId;

    use super::*;

    /// The emulator does not show this: after its restart the firmware stops each motor anyway.
    #[test]
    fn all_at_once_and_then_each_is_stopped() {
        let mut words = last_words(MotorId::all().take(3).collect());
        assert_eq!(words.next().map(|packet| packet.channel), Some(Channel::Command(Target::All)));
        let stopped = |packet: Packet| (packet.data == Stop.encode()).then_some(packet.channel);
        assert!(
            words.map(stopped).eq(MotorId::all()
                .take(3)
                .map(|motor| Some(Channel::Command(Target::Motor(motor)))))
        );
    }
}
