//! The first frames: one command to motor 1 and its reply, as CAN and RS485 carry them. They have
//! to be those that the manual prints (2.21.4, example 1).
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use cortex_m_semihosting::hprintln;
use embedded_can::{Frame, StandardId};
use measure::finish;
use myactuator_protocol_core::{
    Channel, Command, DecodeError, MotorId, Packet,
    command::AbsolutePosition,
    units::{Angle, MaxSpeed},
    wire::{
        can::{self, SimpleFrame},
        rs485::{self, Fed},
    },
};

#[entry]
fn main() -> ! {
    finish(run())
}

fn run() -> Result<(), DecodeError> {
    let motor = MotorId::new(1)?;
    let go = AbsolutePosition {
        max_speed: MaxSpeed::from_dps(500.0)?,
        angle: Angle::from_degrees(360.0)?,
    };
    let packet = Packet { channel: Channel::Command(motor.into()), data: go.encode() };

    // On a board this is the frame type of its CAN driver.
    let frame: SimpleFrame = can::encode(&packet).expect("eight bytes fit");
    hprintln!("CAN   sends {:#05X} {:02X?}", can::identifier(packet.channel), frame.data());
    assert_eq!(can::identifier(packet.channel), 0x141);
    assert_eq!(frame.data(), [0xA4, 0x00, 0xF4, 0x01, 0xA0, 0x8C, 0x00, 0x00]);

    let line = rs485::Frame::from_packet(&packet).expect("not motion mode").encode();
    hprintln!("RS485 sends {:02X?}", line);
    assert_eq!(line, [0x3E, 1, 8, 0xA4, 0x00, 0xF4, 0x01, 0xA0, 0x8C, 0x00, 0x00, 0x3B, 0xDD]);

    let id = StandardId::new(0x241).expect("eleven bits");
    let reply = [0xA4, 0x32, 0x64, 0x00, 0xF4, 0x01, 0x2D, 0x00];
    let frame = SimpleFrame::new(id, &reply).expect("eight bytes fit");
    let can::Received::Packet(from_can) = can::decode(&frame) else {
        panic!("{:?} is no reply", frame)
    };
    let feedback = AbsolutePosition::decode_reply(&from_can.data)?;
    hprintln!(
        "motor {} replies {}, {}, {}, {}",
        motor,
        feedback.temperature,
        feedback.current,
        feedback.speed,
        feedback.angle
    );
    assert_eq!(from_can.channel, Channel::Reply(motor));
    assert_eq!(feedback.temperature.celsius(), 50.0);
    assert_eq!(feedback.current.amperes(), 1.0);
    assert_eq!(feedback.speed.dps(), 500.0);
    assert_eq!(feedback.angle.degrees(), 45.0);

    let line = [0x3E, 1, 8, 0xA4, 0x32, 0x64, 0x00, 0xF4, 0x01, 0x2D, 0x00, 0x95, 0xC5];
    let mut receiver = rs485::Receiver::new();
    let [.., Fed::Frame(frame)] = line.map(|byte| receiver.feed(byte)) else {
        panic!("{:02X?} is no frame", line)
    };
    assert_eq!(frame.as_reply(), Some(from_can));
    Ok(())
}
