//! Commands, replies and packets as text for people: a firmware's log, a terminal.

use core::fmt::{self, Display, Formatter};

use crate::command::{AnyCommand, AnyReply, Field, MotionRanges};
use crate::data::Data;
use crate::firmware::Firmware;
use crate::packet::{Channel, Packet};

/// The fields of a data field as text: `max speed 500 dps, angle 360 deg`.
#[derive(Clone, Copy, Debug)]
pub struct Phrase<'a> {
    /// Which fields; those that this data field does not have are passed over.
    pub fields: &'a [Field],
    /// The data field.
    pub data: &'a Data,
    /// The scales of motion mode. Where they are not known its values are printed as steps.
    pub ranges: Option<&'a MotionRanges>,
}

impl Display for Phrase<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let there = self.fields.iter().filter(|field| field.is_in(self.data));
        for (place, field) in there.enumerate() {
            if place > 0 {
                f.write_str(", ")?;
            }
            field.print(f, self.data, self.ranges)?;
        }
        Ok(())
    }
}

/// A name, and fields if there are any.
pub(super) fn named(
    f: &mut Formatter<'_>,
    name: impl Display,
    fields: &[Field],
    data: &Data,
) -> fmt::Result {
    name.fmt(f)?;
    if fields.iter().any(|field| field.is_in(data)) {
        write!(f, ": {}", Phrase { fields, data, ranges: None })?;
    }
    Ok(())
}

/// Bytes without a meaning.
pub(super) fn raw(f: &mut Formatter<'_>, data: &Data) -> fmt::Result {
    f.write_str("raw")?;
    data.iter().try_for_each(|byte| write!(f, " {byte:02X}"))
}

impl Display for AnyCommand {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self.opcode() {
            Some(opcode) => named(f, opcode, opcode.command_fields(), &self.encode()),
            None => raw(f, &self.encode()),
        }
    }
}

impl Display for AnyReply {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self.opcode() {
            Some(opcode) => named(f, opcode, opcode.reply_fields(), &self.encode()),
            None => raw(f, &self.encode()),
        }
    }
}

/// A packet as text, as a firmware means it: see [`Packet::as_of`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PacketText {
    packet: Packet,
    firmware: Firmware,
}

impl Packet {
    /// The packet as text, read as this firmware means it.
    ///
    /// ```
    /// use myactuator_protocol_core::command::Stop;
    /// use myactuator_protocol_core::{Firmware, MotorId};
    ///
    /// let stop = Stop.packet(MotorId::MIN);
    /// assert_eq!(stop.as_of(Firmware::V4_4).to_string(), "command to motor 1: stop (0x81)");
    /// ```
    pub const fn as_of(&self, firmware: Firmware) -> PacketText {
        PacketText { packet: *self, firmware }
    }
}

/// As firmware V4.3 means it.
impl Display for Packet {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        self.as_of(Firmware::V4_3).fmt(f)
    }
}

impl Display for PacketText {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let Self { packet, firmware } = self;
        write!(f, "{}: ", packet.channel)?;
        let is_reply = match packet.channel {
            Channel::Reply(_) | Channel::MotionReply(_) => true,
            Channel::Command(_) | Channel::Motion(_) => false,
            // Only a reply holds an id that was read.
            Channel::BusId => packet.data[2] == 1 && packet.data[6..] != [0, 0],
        };
        let printed = if is_reply {
            AnyReply::decode(packet, *firmware).map(|reply| reply.fmt(f))
        } else {
            AnyCommand::decode(packet, *firmware).map(|command| command.fmt(f))
        };
        printed.unwrap_or_else(|error| {
            raw(f, &packet.data)?;
            write!(f, " ({error})")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::id::MotorId;
    use std::string::ToString;

    const M1: MotorId = MotorId::MIN;

    #[test]
    fn packets_print_what_they_say() {
        let cases: [(Channel, Data, &str); 12] = [
            (
                Channel::Command(M1.into()),
                [0xA4, 0, 0xF4, 1, 0xA0, 0x8C, 0, 0], // 2.21.4
                "command to motor 1: absolute-position (0xA4): max speed 500 dps, angle 360 deg",
            ),
            (
                Channel::Reply(M1),
                [0x9A, 0x32, 0, 1, 0xE5, 1, 6, 0],
                "reply of motor 1: read-status1 (0x9A): temperature 50 °C, mosfet temperature 0 °C, brake release (1), voltage 48.5 V, errors: motor stalled, supply voltage too low (a restart is needed)",
            ),
            (
                Channel::Reply(M1),
                [0xB2, 0, 0, 0, 0x2E, 0x89, 0x34, 1], // 2.30.4
                "reply of motor 1: read-version-date (0xB2): version date 20220206 (2022-02-06)",
            ),
            (
                Channel::Command(M1.into()),
                [0xB4, 0, 0, 0, 0, 0, 0, 2],
                "command to motor 1: set-baud-rate (0xB4): baud rate rs485-1m (2)",
            ),
            (
                Channel::Command(M1.into()),
                [0xB6, 0x60, 1, 1, 0, 0, 0, 0], // 2.34.4
                "command to motor 1: active-reply (0xB6): command read-multi-turn-encoder (96), enable on, interval 10 ms",
            ),
            (
                Channel::Command(M1.into()),
                [0xA6, 9, 1, 0, 0, 0, 0, 0],
                "command to motor 1: single-turn-position (0xA6): direction unknown code 9, max speed 1 dps, angle 0 deg",
            ),
            (
                Channel::Command(M1.into()),
                [0x20, 2, 0, 0, 1, 0, 0, 0],
                "command to motor 1: function-control (0x20): index can-id-filter (2), value on",
            ),
            (
                Channel::Motion(M1),
                [0xE6, 0x66, 0x82, 0xE0, 0x52, 0x33, 0x3B, 0x55], // 5.4
                "motion command to motor 1: motion: position step 58982, velocity step 2094, kp step 82, kd step 819, torque step 2901",
            ),
            (
                Channel::BusId,
                [0x79, 0, 1, 0, 0, 0, 0x42, 2], // 4.4
                "bus id: bus-id (0x79): access read (1), motor id 2",
            ),
            (
                Channel::Command(M1.into()),
                [0x81, 0, 0, 0, 0, 0, 0, 0],
                "command to motor 1: stop (0x81)",
            ),
            (
                Channel::Reply(M1),
                [0xF1, 0, 0, 0, 0, 0, 0, 1],
                "reply of motor 1: raw F1 00 00 00 00 00 00 01",
            ),
            (
                Channel::Command(crate::Target::All),
                [0x43, 0, 0, 0, 99, 0, 0, 0],
                "command to all motors: raw 43 00 00 00 63 00 00 00 (acceleration must be 100 to 60000 dps/s (0: no planning), but 99 dps/s was given)",
            ),
        ];
        for (channel, data, text) in cases {
            assert_eq!(Packet { channel, data }.to_string(), text);
        }
        let angle =
            Packet { channel: Channel::Reply(M1), data: [0x94, 0, 0, 0, 0xD8, 0xDC, 0xFF, 0xFF] };
        assert_eq!(
            angle.as_of(Firmware::V4_4).to_string(),
            "reply of motor 1: read-single-turn-angle-v4.4 (0x94): angle -90 deg"
        );
    }
}
