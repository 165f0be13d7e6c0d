//! What a watcher of a drive wants to know.

use crate::command::{BaudCode, ErrorFlags};
use crate::error::DecodeError;
use crate::opcode::Opcode;
use crate::packet::Packet;

/// Something that happened in a drive.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub enum Event {
    /// A packet had no effect and no answer, but for the last one once more by
    /// [a quirk](super::Quirks::repeats_last_reply).
    Ignored {
        /// The packet.
        packet: Packet,
        /// Why.
        reason: IgnoreReason,
    },
    /// A command was answered, but not carried out.
    NotRun {
        /// Its kind.
        opcode: Opcode,
        /// Why.
        reason: NotRunReason,
    },
    /// Errors that have just come.
    FaultRaised(ErrorFlags),
    /// Errors that have just gone.
    FaultCleared(ErrorFlags),
    /// No command came in time (0xB3): the output is cut and the brake locked.
    ProtectionTripped,
    /// Communication is steady again: the drive can run.
    ProtectionRecovered,
    /// The drive restarts (0x76).
    Reset,
    /// The drive has started, after power-on or a restart, and hears commands.
    Started,
    /// The supply is gone.
    PoweredOff,
    /// The drive speaks at another bit rate from now on (0xB4).
    BitRateChanged(BaudCode),
    /// The non-volatile memory could not be read or written. The error flag for lost parameters is
    /// raised with it, and the command that wanted to write is not answered.
    MemoryFailed,
}

/// Why a packet had no effect.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub enum IgnoreReason {
    /// It means nothing, or holds what is not allowed.
    Malformed(DecodeError),
    /// The drive's firmware does not know the command byte.
    UnknownCommand,
    /// The drive is starting and does not hear yet.
    Starting,
    /// The drive has no supply.
    PoweredOff,
    /// The command to all did not pass the id filter (function 2).
    IdFilter,
    /// The command exists on CAN only, and this drive is on RS485.
    CanOnly(Opcode),
    /// The command is known, but names an index or a code that the manual does not.
    UnknownCode(Opcode),
    /// On the channel of bus ids commands and replies look alike: this is another drive's reply.
    AnothersReply,
    /// The drive reports this by itself, and so does not answer when asked for it (2.34.1).
    ReportedActively(Opcode),
}

impl IgnoreReason {
    /// Whether this drive has no such command on the channel that it came on.
    pub(super) const fn is_of_unknown_command(&self) -> bool {
        matches!(
            self,
            Self::UnknownCommand
                | Self::CanOnly(_)
                | Self::Malformed(DecodeError::WrongChannel { .. })
        )
    }
}

impl From<DecodeError> for IgnoreReason {
    fn from(error: DecodeError) -> Self {
        Self::Malformed(error)
    }
}

/// Why a command was answered but not carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub enum NotRunReason {
    /// An error stands.
    Fault(ErrorFlags),
    /// Communication was lost and is not steady yet.
    CommunicationLost,
    /// The brake is locked, and this command does not open it (2.19.1).
    BrakeLocked,
    /// The drive counts turns (function 4), and the command needs single-turn mode (2.22.1).
    NotSingleTurn,
    /// The quirk [`rom_needs_shutdown`](super::Quirks::rom_needs_shutdown) holds.
    NotShutDown,
}
