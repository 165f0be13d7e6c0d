//! Commands and replies that this library does not know.

use core::fmt;

use crate::command::{Command, Field, Fields, print};
use crate::data::Data;
use crate::error::{DecodeError, RequestError};
use crate::id::Target;
use crate::kind::Kind;
use crate::opcode::{Opcode, ReplyRule};
use crate::packet::Packet;

/// A command of the caller's own: eight bytes, how a drive answers them, and whether they may move the
/// motor. For commands that this library does not know, or knows with another layout.
///
/// It is never resent automatically, and one that may move the motor is [refused while the motors are
/// stopped](Kind::is_refused_while_stopped). If the table has its command byte, what the table says of it holds. A
/// reply that begins with 0xF1 is taken for that of a [lost master](crate::opcode::LOST_MASTER_BYTE), so 0xF1 is never
/// answered.
///
/// ```
/// use myactuator_protocol_core::command::RawCommand;
/// use myactuator_protocol_core::opcode::{Opcode, ReplyRule};
/// use myactuator_protocol_core::{Command, Kind};
///
/// // Motor power, of firmware before V4.2.
/// let power = RawCommand::new([0x71, 0, 0, 0, 0, 0, 0, 0], ReplyRule::Values, false);
/// assert_eq!(power.kind().byte(), Some(0x71));
/// // A known byte is what the table says it is: this may move the motor.
/// let speed = RawCommand::new([0xA2, 0, 0, 0, 1, 0, 0, 0], ReplyRule::Values, false);
/// assert_eq!(speed.kind(), Kind::Known(Opcode::Speed));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RawCommand {
    data: Data,
    reply: ReplyRule,
    moves: bool,
}

impl RawCommand {
    /// The command with these eight bytes, the command byte first. `moves` says whether it may set the motor in motion
    /// or let its load fall; if in doubt, pass `true`.
    pub const fn new(data: Data, reply: ReplyRule, moves: bool) -> Self {
        Self { data, reply, moves }
    }

    /// A command that somebody else sent. Nothing is known of it, so it may move the motor.
    pub(crate) const fn heard(data: Data) -> Self {
        Self::new(data, ReplyRule::Values, true)
    }

    /// The data field.
    pub const fn encode(&self) -> Data {
        self.data
    }

    pub(super) const fn put(&self, data: &mut Data) {
        *data = self.data;
    }

    /// The command to one motor or to [all](Target::All), on CAN those with their id filter off.
    ///
    /// # Errors
    /// As [`Kind::channel_to`]: if the table has its command byte, the table says which motors it reaches.
    pub fn packet_to(&self, target: Target) -> Result<Packet, RequestError> {
        Ok(Packet { channel: self.kind().channel_to(target)?, data: self.data })
    }
}

impl Command for RawCommand {
    type Reply = RawReply;

    fn kind(&self) -> Kind {
        let byte = self.data[0];
        match Opcode::from_byte(byte) {
            Some(opcode) => Kind::Known(opcode),
            None => Kind::Raw { byte, reply: self.reply, moves: self.moves },
        }
    }

    fn encode(&self) -> Data {
        self.data
    }

    fn decode_reply(data: &Data) -> Result<RawReply, DecodeError> {
        Fields::read(data)
    }
}

/// The eight bytes of a reply whose meaning this library does not know.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(transparent))]
pub struct RawReply(pub Data);

reply_type!(RawReply);

impl Fields for RawReply {
    const FIELDS: &'static [Field] = &[];

    fn put(&self, data: &mut Data) {
        *data = self.0;
    }

    fn read(data: &Data) -> Result<Self, DecodeError> {
        Ok(Self(*data))
    }
}

impl fmt::Display for RawCommand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        print::raw(f, &self.data)
    }
}

impl fmt::Display for RawReply {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        print::raw(f, &self.0)
    }
}
