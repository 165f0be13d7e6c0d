//! Reads a frame as a command, as a reply, or as the likelier of the two.

use embedded_can::Frame as _;
use myactuator_protocol_core::command::{AnyCommand, AnyReply, Field, MotionRanges};
use myactuator_protocol_core::opcode::LOST_MASTER_BYTE;
use myactuator_protocol_core::wire::can::{self, Received, SimpleFrame};
use myactuator_protocol_core::wire::rs485::Frame;
use myactuator_protocol_core::{
    Channel, Data, DecodeError, Firmware, Kind, Opcode, Packet, Target,
};

use super::explanation::{Decoded, Explanation, FrameDirection, LOST_MASTER, Reading};
use crate::{BusKind, text};

/// What is known of the motors whose frames are explained.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Explainer {
    /// Which revision of the protocol they speak.
    pub firmware: Firmware,
    /// The scales of their motion mode; without them its values are steps.
    pub ranges: Option<MotionRanges>,
    /// The direction of frames whose bytes do not show it.
    pub direction: FrameDirection,
}

impl Explainer {
    /// For motors of this firmware, with its own scales where it has them.
    pub const fn new(firmware: Firmware) -> Self {
        Self { firmware, ranges: firmware.motion_ranges(), direction: FrameDirection::Either }
    }

    /// Explains a CAN frame. All identifiers except 0x300 show the direction.
    pub fn can_frame(&self, frame: &SimpleFrame) -> Explanation {
        let raw = text::can::frame(frame);
        let none = |sentence| Explanation::no_frame(BusKind::Can, raw.clone(), sentence);
        match can::decode(frame) {
            Received::Packet(packet) => self.by_channel(raw, BusKind::Can, packet),
            Received::WrongLength { channel, length, first } => {
                let lost_master = if first == Some(LOST_MASTER_BYTE) { LOST_MASTER } else { "" };
                let bytes = if length == 1 { "byte" } else { "bytes" };
                let (id, direction) = addressed(channel);
                Explanation {
                    id: Some(id),
                    direction: Some(direction),
                    ..none(format!(
                        "every frame of the protocol has 8 data bytes, but this has {length} {bytes}{lost_master}"
                    ))
                }
            }
            Received::Foreign(identifier) => {
                none(format!("identifier 0x{identifier:03X} is none of the protocol's"))
            }
            Received::Extended(identifier) => none(format!(
                "extended identifier 0x{identifier:08X}: the protocol uses standard identifiers only"
            )),
            Received::Remote => {
                let channel = match frame.id() {
                    embedded_can::Id::Standard(id) => can::channel_at(id.as_raw()),
                    embedded_can::Id::Extended(_) => None,
                };
                Explanation {
                    id: channel.map(|channel| addressed(channel).0),
                    ..none("a remote frame, which the protocol does not use".to_owned())
                }
            }
        }
    }

    /// Explains an RS485 frame. On RS485 a command and its reply look the same, so its bytes may not show which it is.
    /// A frame to all motors is a command, since no drive answers to all, except for the bus id.
    pub fn rs485_frame(&self, frame: &Frame) -> Explanation {
        let raw = text::rs485::bytes(&frame.encode());
        let command = frame.as_command();
        let (direction, reply) = match frame.as_reply() {
            Some(reply) => (self.direction, reply),
            None => (FrameDirection::Command, command),
        };
        self.explain(raw, BusKind::Rs485, direction, &command, &reply)
    }

    /// Explains a packet as its frame on this bus; `None` if that has no frame for it.
    pub fn packet(&self, bus: BusKind, packet: &Packet) -> Option<Explanation> {
        Some(self.by_channel(text::packet(bus, packet)?, bus, *packet))
    }

    fn by_channel(&self, raw: String, bus: BusKind, packet: Packet) -> Explanation {
        let direction = match addressed(packet.channel) {
            (_, FrameDirection::Either) => self.direction,
            (_, known) => known,
        };
        self.explain(raw, bus, direction, &packet, &packet)
    }

    /// Explains a packet as a command, as a reply, or as the likelier of the two.
    fn explain(
        &self,
        raw: String,
        bus: BusKind,
        direction: FrameDirection,
        command: &Packet,
        reply: &Packet,
    ) -> Explanation {
        let Packet { channel, data } = *command;
        let opcode = match channel {
            Channel::Motion(_) | Channel::MotionReply(_) => Some(Opcode::Motion),
            _ => Opcode::of_firmware(self.firmware, data[0]),
        };
        let (direction, decoded) = match direction {
            FrameDirection::Command => (direction, self.command(bus, command)),
            FrameDirection::Reply => (direction, self.reply(bus, reply)),
            FrameDirection::Either => {
                likelier(opcode, self.command(bus, command), self.reply(bus, reply))
            }
        };
        let outcome = match (decoded, opcode) {
            (Err(error), _) => Err(sentence(&error)),
            (Ok(_), Some(opcode))
                if bus == BusKind::Rs485 && Kind::from(opcode).check_on_rs485().is_err() =>
            {
                Err(format!("{opcode} exists on CAN only"))
            }
            (Ok(decoded), _) => Ok(decoded),
        };
        Explanation {
            stamp: text::can::Stamp::default(),
            raw,
            bus,
            id: Some(addressed(channel).0),
            direction: Some(direction),
            opcode,
            byte: opcode.map_or(Some(data[0]), Opcode::byte),
            outcome,
        }
    }

    fn command(&self, bus: BusKind, packet: &Packet) -> Result<Decoded, DecodeError> {
        let command = AnyCommand::decode(packet, self.firmware)?;
        let fields = command.opcode().map_or(&[][..], Opcode::command_fields);
        Ok(self.decoded(bus, packet, fields, command.encode()))
    }

    fn reply(&self, bus: BusKind, packet: &Packet) -> Result<Decoded, DecodeError> {
        let reply = AnyReply::decode(packet, self.firmware)?;
        let fields = reply.opcode().map_or(&[][..], Opcode::reply_fields);
        Ok(self.decoded(bus, packet, fields, reply.encode()))
    }

    /// A packet that has these fields and is encoded as `again`.
    fn decoded(
        &self,
        bus: BusKind,
        packet: &Packet,
        fields: &'static [Field],
        again: Data,
    ) -> Decoded {
        let reading = Reading { fields, data: packet.data, ranges: self.ranges };
        // A packet that came from this bus always has a text.
        let canonical = text::packet(bus, &Packet { data: again, ..*packet }).unwrap_or_default();
        Decoded { reading, if_reply: None, canonical }
    }
}

fn addressed(channel: Channel) -> (Target, FrameDirection) {
    match channel {
        Channel::Command(target) => (target, FrameDirection::Command),
        Channel::Motion(id) => (id.into(), FrameDirection::Command),
        Channel::Reply(id) | Channel::MotionReply(id) => (id.into(), FrameDirection::Reply),
        Channel::BusId => (Target::All, FrameDirection::Either),
    }
}

/// Takes the likelier reading. One that sets bytes without a meaning is unlikely. If both are equally likely, the
/// direction stays open.
fn likelier(
    opcode: Option<Opcode>,
    command: Result<Decoded, DecodeError>,
    reply: Result<Decoded, DecodeError>,
) -> (FrameDirection, Result<Decoded, DecodeError>) {
    use FrameDirection as D;
    let is_exact = |decoded: &Decoded| opcode.is_none_or(|opcode| decoded.reading.is_exact(opcode));
    match (command, reply) {
        (Ok(command), Ok(reply)) if is_exact(&reply) => {
            if !is_exact(&command) {
                return (D::Reply, Ok(reply));
            }
            let differs = reply.reading.values() != command.reading.values();
            let if_reply = differs.then_some(reply.reading);
            (D::Either, Ok(Decoded { if_reply, ..command }))
        }
        (Ok(command), _) => (D::Command, Ok(command)),
        (Err(_), Ok(reply)) => (D::Reply, Ok(reply)),
        (Err(error), Err(_)) => (D::Either, Err(error)),
    }
}

/// Why a frame says nothing, for people.
fn sentence(error: &DecodeError) -> String {
    match error {
        DecodeError::WrongChannel { opcode: Opcode::BusId, .. } => {
            format!("{} travels at CAN identifier 0x300 or RS485 address 0xCD only", Opcode::BusId)
        }
        DecodeError::WrongChannel { opcode, channel: Channel::BusId } => {
            format!("CAN identifier 0x300 carries {} only, found {opcode}", Opcode::BusId)
        }
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use myactuator_protocol_core::MotorId;

    fn on_can(line: &str) -> Explanation {
        Explainer::new(Firmware::V4_3).can_frame(&text::can::parse_line(line).unwrap())
    }

    fn on_rs485(data: [u8; 8], direction: FrameDirection) -> Explanation {
        let address = Target::Motor(MotorId::new(1).unwrap());
        Explainer { direction, ..Explainer::new(Firmware::V4_3) }
            .rs485_frame(&Frame { address, data })
    }

    fn direction(explanation: &Explanation) -> &'static str {
        explanation.direction.unwrap().name()
    }

    #[test]
    fn direction_of_rs485_bytes_is_inferred_where_possible() {
        // A NULL byte of the command is set: only the reply holds that (2.21.4).
        let reply = on_rs485([0xA4, 0x32, 0x64, 0, 0xF4, 1, 0x2D, 0], FrameDirection::Either);
        assert_eq!(direction(&reply), "reply");
        assert_eq!(reply.outcome.unwrap().reading.values()["angle_deg"], 45.0);
        // Reset has no reply.
        assert_eq!(
            direction(&on_rs485([0x76, 0, 0, 0, 0, 0, 0, 0], FrameDirection::Either)),
            "command"
        );
        // An echo is the same both ways.
        let echo = on_rs485([0x80, 0, 0, 0, 0, 0, 0, 0], FrameDirection::Either);
        assert_eq!(direction(&echo), "either");
        assert_eq!(echo.outcome.unwrap().if_reply, None);
        // A read, or a reply of all zeros.
        let read = on_rs485([0x92, 0, 0, 0, 0, 0, 0, 0], FrameDirection::Either);
        assert_eq!(direction(&read), "either");
        let decoded = read.outcome.unwrap();
        assert!(decoded.reading.is_empty());
        assert_eq!(decoded.if_reply.unwrap().values()["angle_deg"], 0.0);
    }

    #[test]
    fn the_sender_settles_it() {
        let zeros = [0x92, 0, 0, 0, 0, 0, 0, 0];
        let command = on_rs485(zeros, FrameDirection::Command);
        assert_eq!(direction(&command), "command");
        assert_eq!(command.outcome.unwrap().if_reply, None);
        let reply = on_rs485(zeros, FrameDirection::Reply);
        assert_eq!(direction(&reply), "reply");
        assert_eq!(reply.outcome.unwrap().reading.values()["angle_deg"], 0.0);
        // No drive answers to all.
        let all = Frame { address: Target::All, data: zeros };
        assert_eq!(direction(&Explainer::new(Firmware::V4_3).rs485_frame(&all)), "command");
    }

    #[test]
    fn with_no_exact_reading_the_command_is_taken() {
        // 0x80 has no fields, yet a byte is set.
        let odd = on_rs485([0x80, 1, 0, 0, 0, 0, 0, 0], FrameDirection::Either);
        assert_eq!(direction(&odd), "command");
        assert!(odd.outcome.unwrap().canonical.starts_with("3E 01 08 80 00"));
    }

    #[test]
    fn frames_outside_the_protocol_are_reported_with_what_is_known() {
        let cases = [
            (
                "141#F1",
                "every frame of the protocol has 8 data bytes, but this has 1 byte; drives were seen to send it once a second after they lost their master",
            ),
            ("7DF#0000000000000000", "identifier 0x7DF is none of the protocol's"),
            (
                "00000141#00",
                "extended identifier 0x00000141: the protocol uses standard identifiers only",
            ),
            ("141#R", "a remote frame, which the protocol does not use"),
            (
                "141#7900000000000002",
                "bus-id (0x79) travels at CAN identifier 0x300 or RS485 address 0xCD only",
            ),
            (
                "300#8000000000000000",
                "CAN identifier 0x300 carries bus-id (0x79) only, found shutdown (0x80)",
            ),
            ("241#7600000000000000", "reset (0x76) has no reply with a meaning"),
            (
                "141#4300000063000000",
                "acceleration must be 100 to 60000 dps/s (0: no planning), but 99 dps/s was given",
            ),
        ];
        for (line, sentence) in cases {
            assert_eq!(on_can(line).outcome, Err(sentence.to_owned()), "{line}");
        }
        let short = on_can("241#F1");
        assert_eq!(short.id, Some(Target::Motor(MotorId::new(1).unwrap())));
        assert_eq!(direction(&short), "reply");
        assert_eq!(on_can("7DF#0000000000000000").id, None);
        assert_eq!(on_can("141#4300000063000000").opcode, Some(Opcode::WriteAcceleration));
        assert_eq!(
            on_rs485([0xB6, 0x60, 1, 1, 0, 0, 0, 0], FrameDirection::Either).outcome,
            Err("active-reply (0xB6) exists on CAN only".to_owned())
        );
    }
}
