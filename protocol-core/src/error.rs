//! What can be wrong with received bytes, and with a request.

use core::fmt;

use crate::opcode::Opcode;
use crate::packet::Channel;
use crate::quantity::OutOfRange;

/// Why a data field does not mean anything.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub enum DecodeError {
    /// The command byte is not in the table.
    UnknownOpcode(u8),
    /// The command byte is another than the asked-for kind's.
    WrongOpcode {
        /// The kind that was to be decoded.
        expected: Opcode,
        /// The command byte found.
        found: u8,
    },
    /// The kind does not travel on that channel.
    WrongChannel {
        /// The kind that the data field names.
        opcode: Opcode,
        /// The channel it came on.
        channel: Channel,
    },
    /// The channel carries no commands.
    NotACommand(Channel),
    /// The channel carries no replies.
    NotAReply(Channel),
    /// The kind has no reply, so this cannot be one (0x76, 0xB4, 0xB6).
    NoReply(Opcode),
    /// A field holds a value that is not allowed there.
    OutOfRange(OutOfRange),
    /// A reply to a read of the bus id holds neither an id nor a reply identifier (4.3, 7.3).
    NotABusId(u16),
}

impl From<OutOfRange> for DecodeError {
    fn from(error: OutOfRange) -> Self {
        Self::OutOfRange(error)
    }
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UnknownOpcode(byte) => {
                write!(f, "command byte 0x{byte:02X} is in no table of commands")
            }
            Self::WrongOpcode { expected, found } => {
                write!(f, "expected {expected}, found command byte 0x{found:02X}")
            }
            Self::WrongChannel { opcode, channel } => {
                write!(f, "{opcode} does not travel as {channel}")
            }
            Self::NotACommand(channel) => write!(f, "expected a command, found a {channel}"),
            Self::NotAReply(channel) => write!(f, "expected a reply, found a {channel}"),
            Self::NoReply(opcode) => write!(f, "{opcode} has no reply with a meaning"),
            Self::OutOfRange(error) => error.fmt(f),
            Self::NotABusId(found) => {
                write!(
                    f,
                    "expected an id 1 to 32 or a reply identifier 0x241 to 0x260, found 0x{found:03X}"
                )
            }
        }
    }
}

impl core::error::Error for DecodeError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::OutOfRange(error) => Some(error),
            _ => None,
        }
    }
}

/// Why a command cannot be sent as asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub enum RequestError {
    /// The command goes to one motor; there is no form of it for all (motion mode).
    OneMotorOnly(Opcode),
    /// The command goes to whatever is connected and names no motor (bus id setting).
    AllMotorsOnly(Opcode),
    /// The command exists on CAN only.
    CanOnly(Opcode),
    /// A request to that motor, or a broadcast, is still under way: wait for its outcome.
    Busy,
    /// The motor reports this reply by itself (0xB6) and does not answer when asked for it.
    Reported(Opcode),
    /// The motor follows a stream of set-points of this kind, whose feedback looks like a reply to
    /// this: put it in the stream, or wait for the late window after the last set-point.
    Streamed(Opcode),
    /// The master has no place left for one more motor.
    TooManyMotors {
        /// How many it is made for.
        capacity: usize,
    },
    /// The motors were stopped, and the command [may move](crate::Kind::may_move) one: it is refused
    /// until the stop is lifted.
    Stopped,
}

impl fmt::Display for RequestError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OneMotorOnly(opcode) => {
                write!(f, "{opcode} goes to one motor only: name its id")
            }
            Self::AllMotorsOnly(opcode) => {
                write!(
                    f,
                    "{opcode} reaches every motor that is connected and names none: send it to all"
                )
            }
            Self::CanOnly(opcode) => write!(f, "{opcode} exists on CAN only"),
            Self::Busy => f.write_str("an earlier request is under way: wait for its outcome"),
            Self::Reported(opcode) => {
                write!(f, "{opcode} is reported by the motor itself, which then does not answer it")
            }
            Self::Streamed(opcode) => {
                write!(f, "the motor follows a stream of {opcode}: put this in the stream too")
            }
            Self::TooManyMotors { capacity } => {
                write!(f, "this master is made for {capacity} motors: make it larger")
            }
            Self::Stopped => f.write_str("the motors were stopped: lift the stop first"),
        }
    }
}

impl core::error::Error for RequestError {}
