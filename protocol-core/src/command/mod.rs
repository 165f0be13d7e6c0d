//! What the data field of every frame means. Each chapter of the manual has a file, which has each command, its reply
//! and their tests side by side.
//!
//! Every type encodes *and* decodes: a master uses one half, a drive the other, a monitor both.
//! [`Command`] ties a command to its reply. [`AnyCommand`] and [`AnyReply`] hold any of them, for programs that receive
//! frames that they did not ask for.
//!
//! # Commands
//! A [`ReplyRule`](crate::opcode::ReplyRule) says what a drive answers, and when. Identifiers, buses and firmware are
//! in the table of [`Opcode`].
//!
//! | command | byte | manual | answered | what it does |
//! |---|---|---|---|---|
#![doc = crate::opcode::opcode_table!(command_rows)]
//! | [`RawCommand`] | any | | as its caller says | Whatever this library does not know; [`RawReply`] is its reply. |
//!
//! # Chapters
//! | chapter | what its commands speak of, beside the quantities of [`units`](crate::units) |
//! |---|---|
//! | [`pid`] | [`PidIndex`] |
//! | [`acceleration`] | [`AccelerationIndex`] |
//! | [`encoder`], [`angle`] | |
//! | [`status`] | [`Feedback`], which most control commands return; [`BrakeCommand`], [`ErrorFlags`], [`ErrorLevel`] |
//! | [`control`] | [`Direction`] |
//! | [`system`] | [`Mode`], [`VersionDate`], [`ModelName`] |
//! | [`brake`] | |
//! | [`communication`] | [`BaudCode`], [`ReportedCommand`], [`Switch`] |
//! | [`function`] | [`FunctionIndex`], [`OtherFunction`] |
//! | [`bus_id`] | [`Access`] |
//! | [`motion`], [`motion_ranges`] | [`MotionSetPoint`] and [`MotionFeedback`] in SI units; [`MotionRanges`], which makes them [`RawMotion`] and [`RawMotionFeedback`] |

#[macro_use]
mod layout;

pub mod acceleration;
pub mod angle;
mod any;
pub mod brake;
pub mod bus_id;
pub mod communication;
pub mod control;
pub mod encoder;
mod field;
pub mod function;
pub mod motion;
pub mod motion_ranges;
pub mod pid;
pub(crate) mod print;
mod raw;
pub mod status;
pub mod system;

pub use acceleration::*;
pub use angle::*;
pub use any::{AnyCommand, AnyReply};
pub use brake::*;
pub use bus_id::*;
pub use communication::*;
pub use control::*;
pub use encoder::*;
pub use field::{Field, Key, When};
pub use function::*;
pub use layout::Fields;
pub use motion::*;
pub use motion_ranges::*;
pub use pid::*;
pub use print::{PacketText, Phrase};
pub use raw::{RawCommand, RawReply};
pub use status::*;
pub use system::*;

use crate::data::Data;
use crate::error::DecodeError;
use crate::kind::Kind;
use crate::opcode::{Opcode, command_rows};

/// A command: what a master sends, tied to what the drive answers.
///
/// ```
/// use myactuator_protocol_core::command::{Command, ReadPid, PidIndex};
///
/// let read = ReadPid { index: PidIndex::CURRENT_KP };
/// assert_eq!(read.encode(), [0x30, 0x01, 0, 0, 0, 0, 0, 0]);
///
/// // The manual's answer (2.1.5): the current loop's KP is 1.0.
/// let reply = ReadPid::decode_reply(&[0x30, 0x01, 0, 0, 0, 0, 0x80, 0x3F])?;
/// assert_eq!(reply.value.value(), 1.0);
/// # Ok::<(), myactuator_protocol_core::DecodeError>(())
/// ```
pub trait Command: Sized {
    /// What a drive answers.
    type Reply: Reply;

    /// What a master has to know of it: its row in the table. If the bytes name another row, that one counts.
    fn kind(&self) -> Kind;

    /// The data field.
    fn encode(&self) -> Data;

    /// The answer from a data field.
    ///
    /// # Errors
    /// [`DecodeError`] if the command byte is another's or a field holds what is not allowed.
    fn decode_reply(data: &Data) -> Result<Self::Reply, DecodeError>;
}

/// An answer. Several commands share one ([`Feedback`] above all), so the command byte comes from outside.
pub trait Reply: Fields {
    /// The data field of this answer to a command of kind `to`.
    fn encode(&self, to: Opcode) -> Data {
        let mut data = with_opcode(to);
        self.put(&mut data);
        data
    }

    /// The answer from a data field, whatever its command byte.
    ///
    /// # Errors
    /// [`DecodeError`] if a field holds what is not allowed.
    fn decode(data: &Data) -> Result<Self, DecodeError> {
        Self::read(data)
    }
}

/// The outcome of commands that have no reply, or none with a meaning (0x76, 0xB4, 0xB6): they are over when they were
/// sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct NoReply;

#[cfg(feature = "defmt")]
impl defmt::Format for NoReply {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "NoReply");
    }
}

impl Reply for NoReply {}

impl Fields for NoReply {
    const FIELDS: &'static [Field] = &[];

    fn put(&self, _: &mut Data) {}

    fn read(_: &Data) -> Result<Self, DecodeError> {
        Ok(Self)
    }
}

/// Whether this command is over only when its reply has come. Function 5 (0x20) is over when it was sent: drives were
/// seen to obey it without the acknowledgement that 2.35.3 promises. An acknowledgement that does come is a stray.
pub fn awaits_reply(kind: Kind, command: &Data) -> bool {
    let sets_id = kind == Kind::Known(Opcode::FunctionControl)
        && command[1] == FunctionIndex::SET_CAN_ID.raw();
    kind.has_reply() && !sets_id
}

/// A data field that holds nothing but its command byte.
#[inline(always)]
pub(crate) const fn with_opcode(opcode: Opcode) -> Data {
    let byte = match opcode.byte() {
        Some(byte) => byte,
        None => 0,
    };
    [byte, 0, 0, 0, 0, 0, 0, 0]
}

#[inline(always)]
fn expect_opcode(data: &Data, expected: Opcode) -> Result<(), DecodeError> {
    match expected.byte() {
        Some(byte) if data[0] != byte => Err(DecodeError::WrongOpcode { expected, found: data[0] }),
        _ => Ok(()),
    }
}

/// A command that replaces the one before it: where to be, how fast to turn, how hard to push. It may be sent over and
/// over, but an old one must never follow a new one. These are the kinds of
/// [`Usage::SetPoint`](crate::opcode::Usage::SetPoint) in the table.
///
/// [`IncrementalPosition`] is not one: each sending moves the motor on.
pub trait SetPoint: Command {}
