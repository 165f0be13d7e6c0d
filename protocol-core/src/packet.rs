//! The kinds of traffic on a bus, and a data field on one of them.
//!
//! Both wires map their addresses to a [`Channel`] and back. Everything above them uses channels, and no identifiers or
//! address bytes.

use core::fmt;

use crate::data::Data;
use crate::id::{MotorId, Target};

/// Sender and receiver of a frame, and which of the protocol's three forms it has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Channel {
    /// A command to one motor or to [all](Target::All) (manual 2, 3, 6).
    Command(Target),
    /// A motor's reply.
    Reply(MotorId),
    /// Bus id setting and its reply (manual 4, 7). It names no motor; all connected motors listen.
    BusId,
    /// A motion (MIT) mode command to one motor, CAN only (manual 5).
    Motion(MotorId),
    /// A motor's reply to a motion mode command, CAN only (manual 5).
    MotionReply(MotorId),
}

impl fmt::Display for Channel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Command(target) => write!(f, "command to {target}"),
            Self::Reply(motor) => write!(f, "reply of motor {motor}"),
            Self::BusId => f.write_str("bus id"),
            Self::Motion(motor) => write!(f, "motion command to motor {motor}"),
            Self::MotionReply(motor) => write!(f, "motion reply of motor {motor}"),
        }
    }
}

/// A frame without its framing: a data field and its channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Packet {
    /// Sender, receiver and form.
    pub channel: Channel,
    /// The eight data bytes.
    pub data: Data,
}

impl Packet {
    /// Whether it is a packet of motion mode, whose data has no command byte.
    #[inline]
    pub(crate) const fn is_motion(&self) -> bool {
        matches!(self.channel, Channel::Motion(_) | Channel::MotionReply(_))
    }
}
