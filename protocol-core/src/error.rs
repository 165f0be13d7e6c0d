//! What can be wrong with received bytes, and with a request.

use crate::opcode::Opcode;
use crate::packet::Channel;
use crate::quantity::OutOfRange;

/// Why a data field cannot be decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub enum DecodeError {
    /// The command byte is not in the table.
    #[error("command byte 0x{0:02X} is in no table of commands")]
    UnknownOpcode(u8),
    /// The command byte is not that of the requested kind.
    #[error("expected {expected}, found command byte 0x{found:02X}")]
    WrongOpcode {
        /// The kind that was to be decoded.
        expected: Opcode,
        /// The command byte found.
        found: u8,
    },
    /// The kind does not occur on that channel.
    #[error("{opcode} does not travel as {channel}")]
    WrongChannel {
        /// The kind that the data field names.
        opcode: Opcode,
        /// The channel it came on.
        channel: Channel,
    },
    /// The channel carries no commands.
    #[error("expected a command, found a {0}")]
    NotACommand(Channel),
    /// The channel carries no replies.
    #[error("expected a reply, found a {0}")]
    NotAReply(Channel),
    /// The kind has no reply, so this cannot be one (0x76, 0xB4, 0xB6).
    #[error("{0} has no reply with a meaning")]
    NoReply(Opcode),
    /// A field holds a value that is not allowed there.
    #[error("{0}")]
    OutOfRange(#[from] OutOfRange),
    /// A reply to a read of the bus id holds neither an id nor a reply identifier (4.3, 7.3).
    #[error("expected an id 1 to 32 or a reply identifier 0x241 to 0x260, found 0x{0:03X}")]
    NotABusId(u16),
}

/// Why a command cannot be sent as asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub enum RequestError {
    /// The command has no form for all motors (motion mode).
    #[error("{0} goes to one motor only: name its id")]
    OneMotorOnly(Opcode),
    /// The command goes to all connected motors and names none (bus id setting).
    #[error("{0} reaches every motor that is connected and names none: send it to all")]
    AllMotorsOnly(Opcode),
    /// The command exists on CAN only.
    #[error("{0} exists on CAN only")]
    CanOnly(Opcode),
    /// A request to that motor, its stop, or a broadcast is still in flight: wait for its outcome. A stop stays in
    /// flight for as long as the bus takes nothing.
    #[error(
        "an earlier request, or a stop that the bus does not take, is under way: wait for its outcome"
    )]
    Busy,
    /// The motor reports this reply on its own (0xB6) and does not answer a request for it.
    #[error(
        "{0} is reported by the motor itself, which then does not answer it: end the report (0xB6) first"
    )]
    Reported(Opcode),
    /// The motor follows a stream of set-points of this kind, and their feedback looks like a reply to this. Put it in
    /// the stream, or wait for the late window after the last set-point.
    #[error("the motor follows a stream of {0}: put this in the stream too")]
    Streamed(Opcode),
    /// The command does not replace the one before it, so it cannot be streamed.
    #[error("{0} acts with each sending, so it is no set-point: request it")]
    NotASetPoint(Opcode),
    /// The master has no place for another motor.
    #[error(
        "this master has places for {capacity} motors, and all are taken: make it larger (its N), or forget ids without a motor"
    )]
    TooManyMotors {
        /// How many places it has.
        capacity: usize,
    },
    /// The motor has restarted or [may have](crate::master::Event::Restarted), so its turns may be lost. If it has not,
    /// it may still be turning: stop it, read its angle, and then [resume](crate::master::Master::resume).
    #[error(
        "the motor may have restarted (it was silent for a second, for example): stop it, see where it is, then \
         lift the stop and resume"
    )]
    Restarted,
    /// The motor was stopped, and the command [is refused](crate::Kind::is_refused_while_stopped) until the stop is
    /// lifted. A way of working on a bus that several callers share, such as the opening of a brake, is refused also if
    /// another caller has stopped the motor since it began, with no stop in force.
    #[error("the motors were stopped: lift the stop first, if one is in force")]
    Stopped,
}
