//! Commands, replies and packets as text for people: a firmware's log, a terminal.

use core::fmt::{self, Display, Formatter};

use crate::command::{AnyCommand, AnyReply, Field, MotionRanges};
use crate::data::Data;
use crate::firmware::Firmware;
use crate::opcode::Opcode;
use crate::packet::{Channel, Packet};

/// The fields of a data field as text: `max speed 500 dps, angle 360 deg`.
#[derive(Clone, Copy, Debug)]
pub struct Phrase<'a> {
    /// Which fields. Those that this data field does not have are left out.
    pub fields: &'a [Field],
    /// The data field.
    pub data: &'a Data,
    /// The scales of motion mode. If they are not known, its values are printed as steps.
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
pub(crate) fn raw(f: &mut Formatter<'_>, data: &Data) -> fmt::Result {
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

/// A packet as text, as read by one firmware: see [`Packet::as_of`].
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

/// As all firmwares read it. Where they differ (0x94), only the bytes are printed: see [`as_of`](Packet::as_of).
impl Display for Packet {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let is_motion = matches!(self.channel, Channel::Motion(_) | Channel::MotionReply(_));
        let of =
            |&firmware: &Firmware| Some((firmware, Opcode::of_firmware(firmware, self.data[0])?));
        let mut known = Firmware::ALL.iter().filter_map(of);
        match known.next() {
            Some((firmware, opcode)) if !is_motion => {
                if known.all(|(_, other)| other == opcode) {
                    return self.as_of(firmware).fmt(f);
                }
                write!(f, "{}: ", self.channel)?;
                raw(f, &self.data)?;
                f.write_str(" (its layout differs between firmwares)")
            }
            _ => self.as_of(Firmware::V4_3).fmt(f),
        }
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
    use crate::wire::can;
    use std::string::ToString;
    use std::vec::Vec;

    /// A frame and the section it is from, if any, then its text.
    const CASES: &str = "
141#A400F401A08C0000 2.21.4
command to motor 1: absolute-position (0xA4): max speed 500 dps, angle 360 deg
241#9A320001E5010600
reply of motor 1: read-status1 (0x9A): temperature 50 °C, mosfet temperature 0 °C, brake release (1), voltage 48.5 V, errors: motor stalled, supply voltage too low (a restart is needed)
241#B20000002E893401 2.30.4
reply of motor 1: read-version-date (0xB2): version date 20220206 (2022-02-06)
141#B400000000000002
command to motor 1: set-baud-rate (0xB4): baud rate rs485-1m (2)
141#B660010100000000 2.34.4
command to motor 1: active-reply (0xB6): command read-multi-turn-encoder (96), enable on, interval 10 ms
141#A609010000000000
command to motor 1: single-turn-position (0xA6): direction unknown code 9, max speed 1 dps, angle 0 deg
141#2002000001000000
command to motor 1: function-control (0x20): index can-id-filter (2), value on
401#E66682E052333B55 5.4
motion command to motor 1: motion: position step 58982, velocity step 2094, kp step 82, kd step 819, torque step 2901
300#7900010000004202 4.4
bus id: bus-id (0x79): access read (1), motor id 2
141#8100000000000000
command to motor 1: stop (0x81)
241#F100000000000001
reply of motor 1: raw F1 00 00 00 00 00 00 01
280#4300000063000000
command to all motors: raw 43 00 00 00 63 00 00 00 (acceleration must be 100 to 60000 dps/s (0: no planning), but 99 dps/s was given)
";

    fn packet(frame: &str) -> Packet {
        let identifier = u16::from_str_radix(&frame[..3], 16).unwrap();
        let data = u64::from_str_radix(&frame[4..20], 16).unwrap().to_be_bytes();
        Packet { channel: can::channel_at(identifier).unwrap(), data }
    }

    #[test]
    fn packets_print_what_they_say() {
        let lines: Vec<_> = CASES.lines().skip(1).collect();
        assert_eq!(lines.len(), 2 * 12);
        for case in lines.chunks(2) {
            assert_eq!(packet(case[0]).to_string(), case[1]);
        }
        assert_eq!(
            packet("241#94000000D8DCFFFF").to_string(),
            "reply of motor 1: raw 94 00 00 00 D8 DC FF FF (its layout differs between firmwares)"
        );
        assert_eq!(
            packet("241#94000000D8DCFFFF").as_of(Firmware::V4_4).to_string(),
            "reply of motor 1: read-single-turn-angle-v4.4 (0x94): angle -90 deg"
        );
    }
}
