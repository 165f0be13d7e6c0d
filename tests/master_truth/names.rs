//! The names of frames. Each command carries a token, and so does its reply.

use myactuator_protocol_core::{Channel, Opcode, Packet};
use myactuator_tests::rig::{STREAM_MARK, token_of};

/// Tokens of requests. Smaller numbers are those of set-points.
pub(crate) const REQUESTS: u32 = 0x0100_0000;
/// Tokens of reports.
pub(crate) const REPORTS: u32 = 0x3D00_0000;
/// Tokens of another master.
pub(crate) const STRANGERS: u32 = 0x3E00_0000;
/// Marks the other master's set-points, because only half of their token comes back. In motion mode the mark is the
/// last byte of the torque.
pub(crate) const STRANGER_MARK: u8 = 9;

/// What distinguishes one command and its replies from all others of a motor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(crate) struct Name {
    /// The command byte, 0 for motion mode.
    pub(crate) byte: u8,
    pub(crate) token: u32,
}

/// What the master can distinguish: a command byte and an index.
pub(crate) type Question = (u8, u8);

impl Name {
    pub(crate) fn of(packet: &Packet) -> Self {
        let d = &packet.data;
        let (byte, token) = match (packet.channel, d[0]) {
            (Channel::Motion(_), _) if d[7] == STRANGER_MARK => {
                (0, STRANGERS | u32::from(u16::from_be_bytes([d[0], d[1]])))
            }
            (Channel::MotionReply(_), _) if d[5] == STRANGER_MARK => {
                (0, STRANGERS | u32::from(u16::from_be_bytes([d[1], d[2]])))
            }
            (Channel::Motion(_), _) => (0, u32::from(u16::from_be_bytes([d[0], d[1]]))),
            (Channel::MotionReply(_), _) => (0, u32::from(u16::from_be_bytes([d[1], d[2]]))),
            // The reply has its value where others have their token.
            (_, 0xB1) => (0xB1, REQUESTS | u32::from_le_bytes([d[1], d[2], d[3], 0])),
            (_, byte) if has_angle(byte) && d[1] == STRANGER_MARK => {
                (byte, STRANGERS | token_of(d) & 0xFFFF)
            }
            // The angle of their feedback is in the other half.
            (_, 0xA2) if d[1] != STREAM_MARK => (0xA2, REQUESTS | token_of(d) & 0xFFFF),
            (_, byte) if has_angle(byte) => (byte, token_of(d) & 0xFFFF),
            (_, byte) => (byte, token_of(d)),
        };
        Self { byte, token }
    }

    pub(crate) fn is_strangers(self) -> bool {
        self.token & 0xFF00_0000 == STRANGERS
    }

    /// Whether it is a set-point of a stream.
    pub(crate) fn is_set_point(self) -> bool {
        matches!(self.byte, 0 | 0xA2 | 0xA4) && self.token < REQUESTS
    }

    pub(crate) fn moves(self) -> bool {
        matches!(self.byte, 0 | 0xA2 | 0xA4 | 0xA8)
    }

    /// Whether it is a stop of the master itself.
    pub(crate) fn is_stop(self) -> bool {
        self.token == 0 && self.is_ending()
    }

    pub(crate) fn is_ending(self) -> bool {
        matches!(self.byte, 0x76 | 0x78 | 0x80 | 0x81)
    }
}

/// Whether the feedback to this command has an angle here.
pub(crate) fn has_angle(byte: u8) -> bool {
    matches!(byte, 0xA2 | 0xA4)
}

/// The question of a command or a reply.
pub(crate) fn question_of(packet: &Packet) -> Question {
    let name = Name::of(packet);
    let has_index = matches!(name.byte, 0x30 | 0x31 | 0x42);
    (name.byte, if has_index { packet.data[1] } else { 0 })
}

/// Whether a command is answered.
pub(crate) fn is_asking(packet: &Packet) -> bool {
    matches!(packet.channel, Channel::Motion(_))
        || Opcode::from_byte(packet.data[0]).is_none_or(Opcode::has_reply)
}

/// Whether a drive answers with values, and not with the command's own bytes.
pub(crate) fn has_values(byte: u8) -> bool {
    !matches!(byte, 0x31 | 0x77 | 0x78 | 0x80 | 0x81)
}
