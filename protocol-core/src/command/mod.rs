//! What the data field of every frame means: one file a chapter of the manual, and in it, side by
//! side, each request, its reply and their tests.
//!
//! Every type encodes *and* decodes: a master uses one half, a drive the other, a monitor both.
//! [`Command`] ties a request to its reply; [`AnyCommand`] and [`AnyReply`] hold any of them, for
//! those who meet frames that they did not ask for.
//!
//! | chapter | requests |
//! |---|---|
//! | [`pid`] | [`ReadPid`], [`WritePidRam`], [`WritePidRom`] |
//! | [`acceleration`] | [`ReadAcceleration`], [`WriteAcceleration`] |
//! | [`encoder`] | [`ReadMultiTurnEncoder`], [`ReadMultiTurnEncoderRaw`], [`ReadMultiTurnEncoderOffset`], [`SetEncoderZero`], [`SetCurrentPositionZero`], [`ReadSingleTurnEncoder`] |
//! | [`angle`] | [`ReadMultiTurnAngle`], [`ReadSingleTurnAngle`] |
//! | [`status`] | [`ReadStatus1`], [`ReadStatus2`], [`ReadStatus3`] |
//! | [`control`] | [`Shutdown`], [`Stop`], [`Torque`], [`Speed`], [`AbsolutePosition`], [`SingleTurnPosition`], [`IncrementalPosition`], [`ForcePosition`] |
//! | [`motion`] | [`RawMotion`], from a [`MotionSetPoint`] by [`MotionRanges`] |
//! | [`system`] | [`ReadRunningMode`], [`Reset`], [`ReadRunTime`], [`ReadVersionDate`], [`ReadModel`] |
//! | [`brake`] | [`ReleaseBrake`], [`LockBrake`] |
//! | [`communication`] | [`CommunicationLossProtection`], [`SetBaudRate`], [`ActiveReply`] |
//! | [`function`] | [`FunctionControl`] |
//! | [`bus_id`] | [`BusId`] |

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
pub mod function;
pub mod motion;
pub mod pid;
pub mod status;
pub mod system;

pub use acceleration::*;
pub use angle::*;
pub use any::{AnyCommand, AnyReply, channel_of, check_on_rs485};
pub use brake::*;
pub use bus_id::*;
pub use communication::*;
pub use control::*;
pub use encoder::*;
pub use function::*;
pub use motion::*;
pub use pid::*;
pub use status::*;
pub use system::*;

use crate::error::DecodeError;
use crate::field::Data;
use crate::opcode::Opcode;

/// A request: what a master sends, tied to what the drive answers.
///
/// ```
/// use myactuator_protocol_core::command::{Command, ReadPid, PidIndex};
///
/// let request = ReadPid { index: PidIndex::CurrentKp };
/// assert_eq!(request.encode(), [0x30, 0x01, 0, 0, 0, 0, 0, 0]);
///
/// // The manual's answer (2.1.5): the current loop's KP is 1.0.
/// let reply = ReadPid::decode_reply(&[0x30, 0x01, 0, 0, 0, 0, 0x80, 0x3F])?;
/// assert_eq!(reply.value.value(), 1.0);
/// # Ok::<(), myactuator_protocol_core::DecodeError>(())
/// ```
pub trait Command: Sized {
    /// Its row in the table.
    const OPCODE: Opcode;
    /// What a drive answers.
    type Reply: Reply;

    /// The data field.
    fn encode(&self) -> Data;

    /// The request from a data field.
    ///
    /// # Errors
    /// [`DecodeError`] if the command byte is another's or a field holds what is not allowed.
    fn decode(data: &Data) -> Result<Self, DecodeError>;

    /// The answer from a data field.
    ///
    /// # Errors
    /// As [`decode`](Self::decode).
    #[inline]
    fn decode_reply(data: &Data) -> Result<Self::Reply, DecodeError> {
        expect_opcode(data, Self::OPCODE)?;
        Self::Reply::from_data(data)
    }
}

/// An answer. Several commands share some of them ([`Feedback`] above all), so that the command byte
/// is given from outside.
pub trait Reply: Sized {
    /// The data field of this answer to a command of kind `to`.
    fn to_data(&self, to: Opcode) -> Data;

    /// The answer from a data field, whatever its command byte.
    ///
    /// # Errors
    /// [`DecodeError`] if a field holds what is not allowed.
    fn from_data(data: &Data) -> Result<Self, DecodeError>;
}

/// The reply type of commands that have none, or none with a meaning (0x76, 0xB4, 0xB6). It has no
/// values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum NoReply {}

#[cfg(feature = "defmt")]
impl defmt::Format for NoReply {
    fn format(&self, _: defmt::Formatter<'_>) {
        match *self {}
    }
}

impl Reply for NoReply {
    fn to_data(&self, _: Opcode) -> Data {
        match *self {}
    }

    fn from_data(data: &Data) -> Result<Self, DecodeError> {
        match Opcode::from_byte(data[0]) {
            Some(opcode) => Err(DecodeError::NoReply(opcode)),
            None => Err(DecodeError::UnknownOpcode(data[0])),
        }
    }
}

#[inline(always)]
fn expect_opcode(data: &Data, expected: Opcode) -> Result<(), DecodeError> {
    match expected.byte() {
        Some(byte) if data[0] != byte => Err(DecodeError::WrongOpcode { expected, found: data[0] }),
        _ => Ok(()),
    }
}

/// A command that replaces the one before it: where to be, how fast to turn, how hard to push. It
/// may be sent over and over, and an old one must never follow a new one.
///
/// [`IncrementalPosition`] is none: each sending moves the motor on.
pub trait SetPoint: Command {}

impl SetPoint for Torque {}
impl SetPoint for Speed {}
impl SetPoint for AbsolutePosition {}
impl SetPoint for SingleTurnPosition {}
impl SetPoint for ForcePosition {}
impl SetPoint for RawMotion {}
