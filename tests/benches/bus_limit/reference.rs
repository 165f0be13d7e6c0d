//! A master without rules, to find out what can be reached at all.

use std::collections::VecDeque;

use embedded_can::nb::Can;
use myactuator_protocol_core::io::Clock;
use myactuator_protocol_core::time::Instant;
use myactuator_protocol_core::wire::can;
use myactuator_protocol_core::{Channel, MotorId, Packet, Target};

/// The motor that a command is for, or a reply is from.
pub(crate) fn motor_of(frame: &impl embedded_can::Frame) -> Option<MotorId> {
    let can::Received::Packet(Packet { channel, .. }) = can::decode(frame) else { return None };
    match channel {
        Channel::Command(Target::Motor(motor)) | Channel::Motion(motor) => Some(motor),
        Channel::Reply(motor) | Channel::MotionReply(motor) => Some(motor),
        Channel::Command(Target::All) | Channel::BusId => None,
    }
}

/// Sends each motor of `ready`, and then each motor that has answered, its next command as soon as the controller has
/// room for it. Commands go in the order of the answers, regardless of pending replies. Returns the number of answers
/// from `start` until `end`.
pub(crate) fn answers<C: Can>(
    can: &mut C,
    clock: &impl Clock,
    mut ready: VecDeque<MotorId>,
    command: impl Fn(MotorId) -> Packet,
    start: Instant,
    end: Instant,
) -> u32 {
    let mut count = 0;
    while clock.now() < end {
        while let Some(motor) = can.receive().ok().as_ref().and_then(motor_of) {
            count += u32::from(clock.now() >= start);
            ready.push_back(motor);
        }
        while let Some(&motor) = ready.front() {
            let frame = can::encode(&command(motor)).expect("eight bytes fit");
            let Ok(pushed_out) = can.transmit(&frame) else { break };
            ready.pop_front();
            if let Some(motor) = pushed_out.as_ref().and_then(motor_of) {
                ready.push_front(motor);
            }
        }
        clock.idle(end);
    }
    count
}
