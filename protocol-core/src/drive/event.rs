//! What a watcher of a drive may want to know.

use crate::command::{BaudCode, ErrorFlags};
use crate::drive::QUEUE_LENGTH;
use crate::drive::queue::DropOldest;
use crate::error::DecodeError;
use crate::opcode::Opcode;
use crate::packet::Packet;
use crate::time::Instant;

/// Something that happened in a drive.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize), serde(rename_all = "kebab-case"))]
#[non_exhaustive]
pub enum Event {
    /// A packet had no effect and no answer. ([A quirk](super::Quirks::repeats_last_reply) sends the last answer once
    /// more.)
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
    /// The current has been limited for 10 ms, mostly by this limit, and the motor does less than it was told to.
    Limited(Limit),
    /// This limit no longer acts.
    Unlimited(Limit),
    /// A command asks for a position beyond a limit of the drive (functions 6 and 7). The drive goes as far as it may.
    TargetLimited {
        /// The command's kind.
        opcode: Opcode,
        /// Where it was to go, degrees.
        asked_deg: f64,
        /// Where it goes, degrees.
        limit_deg: f64,
    },
}

/// What keeps the current from being what the loops want.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize), serde(rename_all = "kebab-case"))]
#[non_exhaustive]
pub enum Limit {
    /// The torque limit of the command that runs (0xA2, 0xA9).
    CommandTorque,
    /// The drive's own limit, [`stall_current_a`](super::Parameters::stall_current_a).
    StallCurrent,
    /// The drive's own limit while it is hot, [`derating`](super::Parameters::derating).
    Temperature,
    /// At this speed the supply's voltage drives no more current through the motor.
    Voltage,
}

/// Why a packet had no effect.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize), serde(rename_all = "kebab-case"))]
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
    /// The drive reports this on its own, and so does not answer when asked for it (2.34.1).
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
#[cfg_attr(feature = "serde", derive(serde::Serialize), serde(rename_all = "kebab-case"))]
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

/// Events with their times, until they are polled.
#[derive(Clone, Debug)]
pub(super) struct Events {
    queue: DropOldest<(Instant, Event), QUEUE_LENGTH>,
    /// When the next ones happen.
    pub(super) now: Instant,
}

impl Events {
    pub(super) const fn new(now: Instant) -> Self {
        Self { queue: DropOldest::new(), now }
    }

    pub(super) fn push(&mut self, event: Event) {
        self.queue.push((self.now, event));
    }

    pub(super) fn pop(&mut self) -> Option<(Instant, Event)> {
        self.queue.pop()
    }

    pub(super) const fn dropped(&self) -> u32 {
        self.queue.dropped()
    }
}
