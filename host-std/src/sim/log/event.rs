//! The events in a log of a drive.

use std::fmt;

use myactuator_protocol_core::drive;
use serde::Serialize;

use crate::sim::bus::trace::Fault;

/// Something that happened in a drive, or to it on its wire.
///
/// In JSON the events of the drive itself are as the drive has them, such as `"reset"`. Those of the wire are
/// `"cable-cut"`, `"cable-mended"`, `{"slowed": 2000}`, `{"babbles": true}`, `{"frame-to-drive": "lost"}` and
/// `{"frame-from-drive": "broken"}`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum LogEvent {
    /// Its cable was cut.
    CableCut,
    /// Its cable is whole again.
    CableMended,
    /// What it sends comes so much later from now on, µs; 0 for no longer.
    Slowed(u64),
    /// It begins to send random frames (`true`), or ends that.
    Babbles(bool),
    /// A fault by chance struck a frame on its way to the drive. On CAN the frame may be meant for another drive: all
    /// hear all.
    FrameToDrive(FrameFault),
    /// The same of a frame that the drive has sent, on its way to a program.
    FrameFromDrive(FrameFault),
    /// In the drive itself.
    #[serde(untagged)]
    Drive(drive::Event),
}

impl LogEvent {
    /// Whether it lasts until the opposite is reported.
    pub(super) const fn is_lasting(&self) -> bool {
        matches!(self, Self::CableCut | Self::CableMended | Self::Slowed(_) | Self::Babbles(_))
    }
}

/// What became of a frame that a fault has struck.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum FrameFault {
    /// It does not arrive.
    Lost,
    /// It arrives with a wrong bit.
    Corrupted,
    /// It arrives twice.
    Duplicated,
    /// It arrives late.
    Delayed,
    /// It arrives after the next one.
    Reordered,
    /// It went wrong on the wire: a bit was disturbed, or another station sent at the same time. On CAN it is repeated.
    Broken,
}

impl From<Fault> for FrameFault {
    fn from(fault: Fault) -> Self {
        match fault {
            Fault::Lost => Self::Lost,
            Fault::Corrupted => Self::Corrupted,
            Fault::Duplicated => Self::Duplicated,
            Fault::Delayed(_) => Self::Delayed,
            Fault::Reordered => Self::Reordered,
        }
    }
}

impl From<drive::Event> for LogEvent {
    fn from(event: drive::Event) -> Self {
        Self::Drive(event)
    }
}

/// What the drive did or what was done to it, without its name: "is off the bus: its cable is cut".
impl fmt::Display for LogEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::CableCut => f.write_str("is off the bus: its cable is cut"),
            Self::CableMended => f.write_str("has its cable back"),
            Self::Slowed(0) => f.write_str("is as fast as ever again"),
            Self::Slowed(by_us) => {
                write!(f, "is slow: what it sends comes {by_us} us later, by a fault")
            }
            Self::Babbles(true) => f.write_str("babbles: it sends frames by itself, by a fault"),
            Self::Babbles(false) => f.write_str("babbles no more"),
            Self::FrameToDrive(fault) => write!(f, "was to hear a frame that {fault}"),
            Self::FrameFromDrive(fault) => write!(f, "has sent a frame that {fault}"),
            Self::Drive(event) => event.fmt(f),
        }
    }
}

/// "is lost, by a fault".
impl fmt::Display for FrameFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Lost => "is lost, by a fault",
            Self::Corrupted => "arrives with a wrong bit, by a fault",
            Self::Duplicated => "arrives twice, by a fault",
            Self::Delayed => "arrives late, by a fault",
            Self::Reordered => "arrives after the one that follows it, by a fault",
            Self::Broken => "went wrong on the wire: disturbed, or sent while another was",
        })
    }
}
