//! One command and its reply by hand, on either bus: no master, no loop.
//!
//! `cargo run -p myactuator-protocol-core --example one_frame`

use std::error::Error;

use embedded_can::{Frame as _, StandardId};
use myactuator_protocol_core::command::{AbsolutePosition, Command};
use myactuator_protocol_core::units::{Angle, MaxSpeed};
use myactuator_protocol_core::wire::can::{self, Received, SimpleFrame};
use myactuator_protocol_core::wire::rs485::{self, Fed, Receiver};
use myactuator_protocol_core::{Channel, DecodeError, MotorId, Packet};

fn main() -> Result<(), Box<dyn Error>> {
    let motor = MotorId::new(1)?;
    // Ranges are checked when a value is made, so encoding cannot fail.
    let go = AbsolutePosition {
        max_speed: MaxSpeed::from_dps(500.0)?,
        angle: Angle::from_degrees(360.0)?,
    };
    let packet = go.packet(motor);
    println!("{packet}");

    // As a CAN frame. `can::encode` makes one of any HAL's frames instead.
    let frame = SimpleFrame::from_packet(&packet);
    println!("CAN:   {:03X} {:02X?}", can::identifier(packet.channel), frame.data());
    // As bytes on an RS485 line.
    let line = rs485::Frame::from_packet(&packet).ok_or("RS485 has no frame for this")?;
    println!("RS485: {:02X?}", line.encode());

    // What motor 1 replies in the manual's example (2.21.4), on CAN ...
    let id = StandardId::new(0x241).ok_or("no identifier")?;
    let received = SimpleFrame::new(id, &[0xA4, 0x32, 0x64, 0x00, 0xF4, 0x01, 0x2D, 0x00]);
    if let Received::Packet(reply) = can::decode(&received.ok_or("no frame")?) {
        show(motor, &reply)?;
    }
    // ... and on RS485, where bytes come one by one and some may be noise.
    let bytes =
        [0x00, 0x3E, 0x01, 0x08, 0xA4, 0x32, 0x64, 0x00, 0xF4, 0x01, 0x2D, 0x00, 0x95, 0xC5];
    let mut receiver = Receiver::new();
    for byte in bytes {
        let Fed::Frame(frame) = receiver.feed(byte) else { continue };
        if let Some(reply) = frame.as_reply() {
            show(motor, &reply)?;
        }
    }
    Ok(())
}

fn show(motor: MotorId, reply: &Packet) -> Result<(), DecodeError> {
    if reply.channel == Channel::Reply(motor) {
        // What comes back is known from the command that was sent.
        let feedback = AbsolutePosition::decode_reply(&reply.data)?;
        println!("{feedback}");
        println!("that is {} A at {} deg", feedback.current.amperes(), feedback.angle.degrees());
    }
    Ok(())
}
