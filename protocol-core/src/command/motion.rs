//! Motion (MIT) mode: position, speed, both gains and torque in one frame (manual 5). CAN only.
//!
//! On the bus every value is a step on a linear scale. The scale depends on the drive's firmware, and a wrong one
//! multiplies the torque. So the scale is a value, [`MotionRanges`](super::MotionRanges): it turns a
//! [`MotionSetPoint`](super::MotionSetPoint) into a [`RawMotion`], and a [`RawMotionFeedback`] into a
//! [`MotionFeedback`](super::MotionFeedback).
//!
//! ```
//! use myactuator_protocol_core::command::{MotionRanges, MotionSetPoint};
//!
//! let hold = MotionSetPoint { position_rad: 10.0, velocity_rad_s: 0.0, kp: 10.0, kd: 1.0, torque_nm: 10.0 };
//! let raw = MotionRanges::V4_3.quantise(&hold)?;
//! assert_eq!(raw.position, 58982); // the manual's numbers (5.4)
//! assert_eq!((raw.kp.get(), raw.kd.get(), raw.torque.get()), (82, 819, 2901));
//! # Ok::<(), myactuator_protocol_core::command::MotionOutOfRange>(())
//! ```

use core::fmt;

use crate::command::{Field, Fields, When};
use crate::data::Data;
use crate::error::DecodeError;
use crate::id::MotorId;
use crate::opcode::Opcode;
use crate::packet::{Channel, Packet};
use crate::quantity::{Given, MotionScale, OutOfRange, Place, Quantity};

/// A step on a scale of 4096, 0 to 4095.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(try_from = "u16", into = "u16"))]
pub struct U12(u16);

impl U12 {
    /// Name and allowed range.
    pub const QUANTITY: Quantity = Quantity::whole("12-bit step", 0, 4095);
    /// The last step, 4095.
    pub const MAX: Self = Self(0xFFF);

    /// A step.
    ///
    /// # Errors
    /// [`OutOfRange`] above 4095.
    #[inline]
    pub const fn new(step: u16) -> Result<Self, OutOfRange> {
        if step <= 0xFFF {
            Ok(Self(step))
        } else {
            Err(OutOfRange { quantity: &Self::QUANTITY, given: Given::steps(step as u32, 1) })
        }
    }

    /// The step that the low twelve bits make.
    #[inline(always)]
    pub(super) const fn low_bits(step: i32) -> Self {
        Self(step as u16 & 0xFFF)
    }

    /// The step, 0 to 4095.
    #[inline]
    pub const fn get(self) -> u16 {
        self.0
    }

    /// Two steps from three bytes, big-endian.
    #[inline(always)]
    const fn pair(high: u8, middle: u8, low: u8) -> (Self, Self) {
        let first = (high as u16) << 4 | (middle as u16) >> 4;
        let second = (middle as u16 & 0x0F) << 8 | low as u16;
        (Self(first), Self(second))
    }
}

impl TryFrom<u16> for U12 {
    type Error = OutOfRange;
    fn try_from(step: u16) -> Result<Self, OutOfRange> {
        Self::new(step)
    }
}

impl From<U12> for u16 {
    fn from(step: U12) -> u16 {
        step.0
    }
}

/// A motion mode command as it is on the bus: steps without a scale (5.2), at CAN identifier
/// 0x400 + id, big-endian.
///
/// The drive sets its current to (`kp` · (position − its position) + `kd` · (velocity − its
/// velocity) + torque) divided by the motor's torque constant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RawMotion {
    /// Wanted position.
    pub position: u16,
    /// Wanted velocity.
    pub velocity: U12,
    /// Gain on the position error.
    pub kp: U12,
    /// Gain on the velocity error.
    pub kd: U12,
    /// Torque added to both.
    pub torque: U12,
}

impl RawMotion {
    /// The data field.
    #[inline]
    pub const fn encode(&self) -> Data {
        let velocity_kp = self.velocity.0 << 4 | self.kp.0 >> 8 & 0x0F;
        let kp_kd = self.kp.0 << 8 | self.kd.0 >> 4 & 0xFF;
        let kd_torque = self.kd.0 << 12 | self.torque.0;
        let high = (self.position as u32) << 16 | velocity_kp as u32;
        let low = (kp_kd as u32) << 16 | kd_torque as u32;
        let ([a, b, c, d], [e, f, g, h]) = (high.to_be_bytes(), low.to_be_bytes());
        [a, b, c, d, e, f, g, h]
    }

    /// The command from a data field. Every data field means something.
    #[inline]
    pub const fn decode(data: &Data) -> Self {
        let [a, b, c, d, e, f, g, h] = *data;
        let (velocity, kp) = U12::pair(c, d, e);
        let (kd, torque) = U12::pair(f, g, h);
        Self { position: u16::from_be_bytes([a, b]), velocity, kp, kd, torque }
    }

    /// Its row in the table.
    pub const OPCODE: Opcode = Opcode::Motion;

    /// The command to one motor: at compile time too, and without [`AnyCommand`](crate::AnyCommand).
    #[inline]
    pub const fn packet(&self, motor: MotorId) -> Packet {
        Packet { channel: Channel::Motion(motor), data: self.encode() }
    }
}

reply_to!(RawMotion -> RawMotionFeedback);

impl Fields for RawMotion {
    const FIELDS: &'static [Field] = &[
        scaled("position", "Wanted position of the output shaft.", MotionScale::Position, 0, 16),
        scaled("velocity", "Wanted velocity of the output shaft.", MotionScale::Velocity, 16, 12),
        scaled("kp", "Gain on the position error.", MotionScale::Kp, 28, 12),
        scaled("kd", "Gain on the velocity error.", MotionScale::Kd, 40, 12),
        scaled("torque", "Torque added to both.", MotionScale::Torque, 52, 12),
    ];

    #[inline]
    fn put(&self, data: &mut Data) {
        *data = self.encode();
    }

    #[inline]
    fn read(data: &Data) -> Result<Self, DecodeError> {
        Ok(Self::decode(data))
    }
}

impl fmt::Display for RawMotion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        crate::command::print::named(f, Self::OPCODE, Self::FIELDS, &self.encode())
    }
}

const fn scaled(
    name: &'static str,
    meaning: &'static str,
    scale: MotionScale,
    first: u8,
    count: u8,
) -> Field {
    let place = Place::Bits { first, count };
    Field { name, meaning, quantity: scale.quantity(), place, when: When::Always }
}

/// A drive's answer to a motion mode command as it is on the bus (5.3), at CAN identifier
/// 0x500 + id, big-endian.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RawMotionFeedback {
    /// The id by which the drive calls itself: 0 to 32 by 5.4, but any value may come. Only the identifier says who
    /// answers. If this byte names another motor, the [master](crate::master) believes no feedback before the motor has
    /// answered three commands without a pause of more than 150 ms: the drive may have sent a command back.
    pub id_byte: u8,
    /// Measured position.
    pub position: u16,
    /// Measured velocity.
    pub velocity: U12,
    /// Measured torque.
    pub torque: U12,
}

impl RawMotionFeedback {
    /// The data field.
    #[inline]
    pub const fn encode(&self) -> Data {
        let [b, c] = self.position.to_be_bytes();
        let both = (self.velocity.0 as u32) << 12 | self.torque.0 as u32;
        let [_, d, e, f] = both.to_be_bytes();
        [self.id_byte, b, c, d, e, f, 0, 0]
    }

    /// The answer from a data field. Every data field means something.
    #[inline]
    pub const fn decode(data: &Data) -> Self {
        let [id_byte, b, c, d, e, f, ..] = *data;
        let (velocity, torque) = U12::pair(d, e, f);
        Self { id_byte, position: u16::from_be_bytes([b, c]), velocity, torque }
    }
}

reply_type!(RawMotionFeedback);

impl Fields for RawMotionFeedback {
    const FIELDS: &'static [Field] = &{
        const ID: Quantity = Quantity::whole("id byte", 0, 255);
        [
            Field::bytes("id_byte", "What the drive says its id is.", &ID, 0, 1),
            scaled(
                "position",
                "Measured position of the output shaft.",
                MotionScale::Position,
                8,
                16,
            ),
            scaled(
                "velocity",
                "Measured velocity of the output shaft.",
                MotionScale::Velocity,
                24,
                12,
            ),
            scaled("torque", "Measured torque.", MotionScale::Torque, 36, 12),
        ]
    };

    #[inline]
    fn put(&self, data: &mut Data) {
        *data = self.encode();
    }

    #[inline]
    fn read(data: &Data) -> Result<Self, DecodeError> {
        Ok(Self::decode(data))
    }
}

impl fmt::Display for RawMotionFeedback {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        crate::command::Phrase { fields: Self::FIELDS, data: &self.encode(), ranges: None }.fmt(f)
    }
}
