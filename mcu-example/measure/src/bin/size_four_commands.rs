//! What four commands and their replies over CAN take of the flash.
#![no_std]
#![no_main]

#[path = "../size/mod.rs"]
mod size;

use core::hint::black_box;

use cortex_m_rt::entry;
use myactuator_protocol_core::{
    Channel, Command, MotorId, Packet,
    command::{AbsolutePosition, ReadStatus1, ReleaseBrake, Stop},
    units::{Angle, MaxSpeed},
    wire::can::{self, Received, SimpleFrame},
};

/// Sends a command, and reads a reply if there is one. The compiler is not to know the bus.
fn exchange<C: Command>(motor: MotorId, command: C) -> Option<C::Reply> {
    let packet = Packet { channel: Channel::Command(motor.into()), data: command.encode() };
    let frame: SimpleFrame = can::encode(&packet)?;
    match can::decode(&black_box(frame)) {
        Received::Packet(reply) if reply.channel == Channel::Reply(motor) => {
            C::decode_reply(&reply.data).ok()
        }
        _ => None,
    }
}

#[entry]
fn main() -> ! {
    let motor = black_box(MotorId::MIN);
    let max_speed = MaxSpeed::from_raw(black_box(500));
    let angle = Angle::from_degrees(black_box(90.0)).unwrap_or_default();
    black_box(exchange(motor, ReleaseBrake));
    black_box(exchange(motor, AbsolutePosition { max_speed, angle }));
    black_box(exchange(motor, ReadStatus1));
    black_box(exchange(motor, Stop));
    size::finish(true)
}
