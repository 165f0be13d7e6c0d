//! Motion (MIT) mode: position, speed, both gains and torque in one frame (manual 5). CAN only.
//!
//! On the bus every value is a step on a linear scale. Which scale, depends on the drive's firmware,
//! and a wrong one multiplies the torque; so the scale is a value, [`MotionRanges`], that turns a
//! [`MotionSetPoint`] into a [`RawMotion`] and a [`RawMotionFeedback`] into a [`MotionFeedback`].
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

use crate::command::layout::Fields;
use crate::command::{Command, Reply};
use crate::error::DecodeError;
use crate::field::Data;
use crate::id::MotorId;
use crate::opcode::Opcode;
use crate::range::{Given, OutOfRange, Quantity};

/// A step on a scale of 4096, 0 to 4095.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(try_from = "u16", into = "u16"))]
pub struct U12(u16);

impl U12 {
    /// Name and allowed range.
    pub const QUANTITY: Quantity =
        Quantity { name: "12-bit step", unit: "", min: 0.0, max: 4095.0 };
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

    /// The step, 0 to 4095.
    #[inline]
    pub const fn get(self) -> u16 {
        self.0
    }

    /// High byte 4..11, and low nibble 0..3 in the upper half of a byte.
    #[inline(always)]
    const fn high_8_low_4(self) -> (u8, u8) {
        ((self.0 >> 4) as u8, (self.0 << 4) as u8)
    }

    /// High nibble 8..11 in the lower half of a byte, and low byte 0..7.
    #[inline(always)]
    const fn high_4_low_8(self) -> (u8, u8) {
        ((self.0 >> 8) as u8, self.0 as u8)
    }

    #[inline(always)]
    const fn from_high_8_low_4(high: u8, low: u8) -> Self {
        Self((high as u16) << 4 | (low as u16) >> 4)
    }

    #[inline(always)]
    const fn from_high_4_low_8(high: u8, low: u8) -> Self {
        Self((high as u16 & 0x0F) << 8 | low as u16)
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

    /// The command from a data field: every one means something.
    #[inline]
    pub const fn from_data(data: &Data) -> Self {
        Self {
            position: u16::from_be_bytes([data[0], data[1]]),
            velocity: U12::from_high_8_low_4(data[2], data[3]),
            kp: U12::from_high_4_low_8(data[3], data[4]),
            kd: U12::from_high_8_low_4(data[5], data[6]),
            torque: U12::from_high_4_low_8(data[6], data[7]),
        }
    }
}

impl Command for RawMotion {
    const OPCODE: Opcode = Opcode::Motion;
    type Reply = RawMotionFeedback;

    #[inline]
    fn encode(&self) -> Data {
        Self::encode(self)
    }

    #[inline]
    fn decode(data: &Data) -> Result<Self, DecodeError> {
        Ok(Self::from_data(data))
    }
}

impl Fields for RawMotion {
    #[inline]
    fn put(&self, data: &mut Data) {
        *data = self.encode();
    }

    #[inline]
    fn read(data: &Data) -> Result<Self, DecodeError> {
        Ok(Self::from_data(data))
    }
}

/// A drive's answer to a motion mode command as it is on the bus (5.3), at CAN identifier
/// 0x500 + id, big-endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RawMotionFeedback {
    /// Who answers.
    pub id: MotorId,
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
        let [p_high, p_low] = self.position.to_be_bytes();
        let (v_high, v_low) = self.velocity.high_8_low_4();
        let (t_high, t_low) = self.torque.high_4_low_8();
        [self.id.get(), p_high, p_low, v_high, v_low | t_high, t_low, 0, 0]
    }
}

impl Reply for RawMotionFeedback {
    #[inline]
    fn to_data(&self, _: Opcode) -> Data {
        Self::encode(self)
    }

    #[inline]
    fn from_data(data: &Data) -> Result<Self, DecodeError> {
        Ok(Self {
            id: MotorId::new(data[0])?,
            position: u16::from_be_bytes([data[1], data[2]]),
            velocity: U12::from_high_8_low_4(data[3], data[4]),
            torque: U12::from_high_4_low_8(data[4], data[5]),
        })
    }
}

impl Fields for RawMotionFeedback {
    #[inline]
    fn put(&self, data: &mut Data) {
        *data = self.encode();
    }

    #[inline]
    fn read(data: &Data) -> Result<Self, DecodeError> {
        Self::from_data(data)
    }
}

/// A motion mode set-point in SI units.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MotionSetPoint {
    /// Wanted position of the output shaft, rad.
    pub position_rad: f32,
    /// Wanted velocity of the output shaft, rad/s.
    pub velocity_rad_s: f32,
    /// Gain on the position error, N·m/rad.
    pub kp: f32,
    /// Gain on the velocity error, N·m·s/rad.
    pub kd: f32,
    /// Torque added to both, N·m.
    pub torque_nm: f32,
}

/// What a drive measured in motion mode, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MotionFeedback {
    /// Who answers.
    pub id: MotorId,
    /// Position of the output shaft, rad.
    pub position_rad: f32,
    /// Velocity of the output shaft, rad/s.
    pub velocity_rad_s: f32,
    /// Torque, N·m.
    pub torque_nm: f32,
}

/// A motion mode value that the ranges do not allow, or that is not a number.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct MotionOutOfRange {
    /// Which value, for people: `"torque"`.
    pub name: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// The smallest allowed.
    pub min: f32,
    /// The largest allowed.
    pub max: f32,
    /// What was given.
    pub given: f32,
}

impl fmt::Display for MotionOutOfRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, unit, min, max, given } = self;
        write!(f, "{name} must be {min} to {max} {unit}, but {given} {unit} was given")
    }
}

impl core::error::Error for MotionOutOfRange {}

/// The scales of motion mode: where the first and last step of each value lie (5.1).
///
/// They differ between firmware versions, and sending steps of one scale to a drive of another
/// multiplies its torque. Use [`V4_3`](Self::V4_3) for drives of this protocol version only.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(try_from = "MotionLimits", into = "MotionLimits"))]
pub struct MotionRanges(MotionLimits);

/// The largest value of each scale; position, velocity and torque reach as far to the negative side.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MotionLimits {
    /// Position, rad.
    pub position_rad: f32,
    /// Velocity, rad/s.
    pub velocity_rad_s: f32,
    /// Gain on the position error.
    pub kp: f32,
    /// Gain on the velocity error.
    pub kd: f32,
    /// Torque, N·m.
    pub torque_nm: f32,
}

/// The step of `value` on a scale of `last + 1` steps from `-max` to `max`; any step for a value that
/// is not on the scale. The middle of the scale lies between two steps and goes to the upper one, as
/// all halves do. The manual's own example (10 rad) is such a half, and multiplying by
/// a rounded constant still finds it on the scales of V4.3, as the tests show.
#[inline(always)]
fn symmetric_step(value: f32, max: f32, last: f32) -> i32 {
    let steps_per_unit = last / (max + max); // a constant where the scale is
    (value * steps_per_unit + (last + 1.0) / 2.0) as i32
}

/// The same on a scale of 4096 steps from 0 to `max`.
#[inline(always)]
fn gain_step(value: f32, max: f32) -> i32 {
    // A half less than a step of f32: the sum of what is just below a half and one half itself would
    // be rounded up to the next whole number.
    const BELOW_HALF: f32 = 0.5 - f32::EPSILON / 4.0;
    (value * (LAST_12 / max) + BELOW_HALF) as i32
}

/// Whether a step lies so far from both ends of its scale that its value is certainly on it.
#[inline(always)]
const fn is_inner(step: i32, last: f32) -> bool {
    // Up to 255/256 of the scale: a number that fits into a compare instruction.
    let most = last as u32 & !(last as u32 >> 8);
    (step as u32).wrapping_sub(1) <= most
}

#[inline(always)]
fn value(step: u16, min: f32, max: f32, last: f32) -> f32 {
    min + step as f32 * (max - min) / last
}

const LAST_16: f32 = 65_535.0;
const LAST_12: f32 = 4_095.0;

impl MotionRanges {
    /// The ranges of protocol V4.3: ±12.5 rad, ±45 rad/s, kp 0 to 500, kd 0 to 5, ±24 N·m.
    pub const V4_3: Self = Self(MotionLimits {
        position_rad: 12.5,
        velocity_rad_s: 45.0,
        kp: 500.0,
        kd: 5.0,
        torque_nm: 24.0,
    });

    /// Ranges of other firmware.
    ///
    /// # Errors
    /// [`MotionOutOfRange`] unless every limit is positive and at most 1e6.
    pub fn new(limits: MotionLimits) -> Result<Self, MotionOutOfRange> {
        let checks = [
            (limits.position_rad, "position range", "rad"),
            (limits.velocity_rad_s, "velocity range", "rad/s"),
            (limits.kp, "kp range", "N·m/rad"),
            (limits.kd, "kd range", "N·m·s/rad"),
            (limits.torque_nm, "torque range", "N·m"),
        ];
        for (given, name, unit) in checks {
            if !(f32::MIN_POSITIVE..=1e6).contains(&given) {
                return Err(MotionOutOfRange {
                    name,
                    unit,
                    min: f32::MIN_POSITIVE,
                    max: 1e6,
                    given,
                });
            }
        }
        Ok(Self(limits))
    }

    /// The largest value of each scale.
    pub const fn limits(&self) -> MotionLimits {
        self.0
    }

    /// The set-point on these scales, each value at its nearest step.
    ///
    /// No step of the symmetric scales is exactly zero: 0 becomes half a step above it.
    ///
    /// # Errors
    /// [`MotionOutOfRange`] for a value beyond its scale, an infinity or NaN.
    #[inline]
    pub fn quantise(&self, set_point: &MotionSetPoint) -> Result<RawMotion, MotionOutOfRange> {
        let [position, velocity, kp, kd, torque] = self.steps(set_point);
        // Comparing steps takes half the instructions of comparing floats, and leaves only the ends
        // of the scales in doubt.
        let certain = is_inner(position, LAST_16)
            & is_inner(velocity, LAST_12)
            & is_inner(kp, LAST_12)
            & is_inner(kd, LAST_12)
            & is_inner(torque, LAST_12);
        if !certain {
            return self.quantise_near_ends(set_point);
        }
        Ok(RawMotion {
            position: position as u16,
            velocity: U12(velocity as u16),
            kp: U12(kp as u16),
            kd: U12(kd as u16),
            torque: U12(torque as u16),
        })
    }

    /// Position, velocity, kp, kd and torque as steps, whether or not they are on their scales.
    #[inline(always)]
    fn steps(&self, set_point: &MotionSetPoint) -> [i32; 5] {
        let max = &self.0;
        [
            symmetric_step(set_point.position_rad, max.position_rad, LAST_16),
            symmetric_step(set_point.velocity_rad_s, max.velocity_rad_s, LAST_12),
            gain_step(set_point.kp, max.kp),
            gain_step(set_point.kd, max.kd),
            symmetric_step(set_point.torque_nm, max.torque_nm, LAST_12),
        ]
    }

    /// As [`quantise`](Self::quantise), for a set-point of which a value is at an end of its scale or
    /// beyond. It does everything anew, so that the other one keeps nothing for it.
    #[inline(never)]
    fn quantise_near_ends(
        &self,
        set_point: &MotionSetPoint,
    ) -> Result<RawMotion, MotionOutOfRange> {
        // From which multiple of its end each scale starts.
        const SCALES: [(&str, &str, f32); 5] = [
            ("position", "rad", -1.0),
            ("velocity", "rad/s", -1.0),
            ("kp", "N·m/rad", 0.0),
            ("kd", "N·m·s/rad", 0.0),
            ("torque", "N·m", -1.0),
        ];
        let MotionLimits { position_rad, velocity_rad_s, kp, kd, torque_nm } = self.0;
        let ends = [position_rad, velocity_rad_s, kp, kd, torque_nm];
        let MotionSetPoint { position_rad, velocity_rad_s, kp, kd, torque_nm } = *set_point;
        let values = [position_rad, velocity_rad_s, kp, kd, torque_nm];
        for ((&(name, unit, start), max), given) in SCALES.iter().zip(ends).zip(values) {
            let min = start * max;
            // Not a number is not within anything.
            if !(min..=max).contains(&given) {
                return Err(MotionOutOfRange { name, unit, min, max, given });
            }
        }
        let [position, velocity, kp, kd, torque] = self.steps(set_point);
        let step_12 = |step: i32| U12(step as u16 & 0xFFF);
        Ok(RawMotion {
            position: position as u16,
            velocity: step_12(velocity),
            kp: step_12(kp),
            kd: step_12(kd),
            torque: step_12(torque),
        })
    }

    /// As [`quantise`](Self::quantise), with each value beyond its scale at the scale's end.
    ///
    /// # Errors
    /// [`MotionOutOfRange`] for NaN only.
    pub fn saturating_quantise(
        &self,
        set_point: &MotionSetPoint,
    ) -> Result<RawMotion, MotionOutOfRange> {
        let max = &self.0;
        self.quantise(&MotionSetPoint {
            position_rad: set_point.position_rad.clamp(-max.position_rad, max.position_rad),
            velocity_rad_s: set_point.velocity_rad_s.clamp(-max.velocity_rad_s, max.velocity_rad_s),
            kp: set_point.kp.clamp(0.0, max.kp),
            kd: set_point.kd.clamp(0.0, max.kd),
            torque_nm: set_point.torque_nm.clamp(-max.torque_nm, max.torque_nm),
        })
    }

    /// The set-point that these steps mean on these scales.
    #[inline]
    pub fn set_point(&self, raw: &RawMotion) -> MotionSetPoint {
        let max = &self.0;
        MotionSetPoint {
            position_rad: value(raw.position, -max.position_rad, max.position_rad, LAST_16),
            velocity_rad_s: value(raw.velocity.0, -max.velocity_rad_s, max.velocity_rad_s, LAST_12),
            kp: value(raw.kp.0, 0.0, max.kp, LAST_12),
            kd: value(raw.kd.0, 0.0, max.kd, LAST_12),
            torque_nm: value(raw.torque.0, -max.torque_nm, max.torque_nm, LAST_12),
        }
    }

    /// The measurement that these steps mean on these scales.
    #[inline]
    pub fn feedback(&self, raw: &RawMotionFeedback) -> MotionFeedback {
        let max = &self.0;
        MotionFeedback {
            id: raw.id,
            position_rad: value(raw.position, -max.position_rad, max.position_rad, LAST_16),
            velocity_rad_s: value(raw.velocity.0, -max.velocity_rad_s, max.velocity_rad_s, LAST_12),
            torque_nm: value(raw.torque.0, -max.torque_nm, max.torque_nm, LAST_12),
        }
    }

    /// A measurement on these scales, as a drive sends it: beyond a scale, the scale's end.
    ///
    /// # Errors
    /// [`MotionOutOfRange`] for NaN only.
    pub fn quantise_feedback(
        &self,
        feedback: &MotionFeedback,
    ) -> Result<RawMotionFeedback, MotionOutOfRange> {
        let raw = self.saturating_quantise(&MotionSetPoint {
            position_rad: feedback.position_rad,
            velocity_rad_s: feedback.velocity_rad_s,
            torque_nm: feedback.torque_nm,
            ..MotionSetPoint::default()
        })?;
        Ok(RawMotionFeedback {
            id: feedback.id,
            position: raw.position,
            velocity: raw.velocity,
            torque: raw.torque,
        })
    }
}

impl TryFrom<MotionLimits> for MotionRanges {
    type Error = MotionOutOfRange;
    fn try_from(limits: MotionLimits) -> Result<Self, MotionOutOfRange> {
        Self::new(limits)
    }
}

impl From<MotionRanges> for MotionLimits {
    fn from(ranges: MotionRanges) -> MotionLimits {
        ranges.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXAMPLE: Data = [0xE6, 0x66, 0x82, 0xE0, 0x52, 0x33, 0x3B, 0x55]; // 5.4

    #[test]
    fn unpacks_and_packs_the_manuals_command() {
        let raw = RawMotion::from_data(&EXAMPLE);
        assert_eq!(raw.position, 58982);
        let steps = [raw.velocity, raw.kp, raw.kd, raw.torque].map(U12::get);
        assert_eq!(steps, [2094, 82, 819, 2901]);
        assert_eq!(raw.encode(), EXAMPLE);
    }

    #[test]
    fn unpacks_and_packs_the_manuals_reply() {
        // 5.4 prints 0x65 for the third byte; its nibbles and its value say 0x66.
        let reply = [0x01, 0xE6, 0x66, 0x82, 0xEB, 0x55, 0, 0];
        let feedback = RawMotion::decode_reply(&reply).unwrap();
        assert_eq!(feedback.id.get(), 1);
        assert_eq!(
            (feedback.position, feedback.velocity.get(), feedback.torque.get()),
            (58982, 2094, 2901)
        );
        assert_eq!(feedback.encode(), reply);
        assert!(RawMotion::decode_reply(&[0; 8]).is_err());
    }

    #[test]
    fn a_scale_ends_where_it_ends() {
        let zero = MotionSetPoint::default();
        let quantise = |set_point| MotionRanges::V4_3.quantise(&set_point);
        // 13107 steps are 5 rad, from a middle between two steps.
        for (position_rad, step) in [(-10.0, 6_554), (-5.0, 19_661), (5.0, 45_875), (10.0, 58_982)]
        {
            assert_eq!(quantise(MotionSetPoint { position_rad, ..zero }).unwrap().position, step);
        }
        let raw = quantise(zero).unwrap(); // halves go up, and -0.0 is 0
        assert_eq!((raw.position, raw.velocity.get(), raw.kp.get()), (32_768, 2_048, 0));
        assert_eq!(quantise(MotionSetPoint { kd: -0.0, ..zero }), Ok(raw));
        let end = MotionSetPoint {
            position_rad: 12.5,
            velocity_rad_s: -45.0,
            kp: 500.0,
            kd: 5.0,
            torque_nm: -24.0,
        };
        let raw = quantise(end).unwrap();
        let steps = [raw.velocity, raw.kp, raw.kd, raw.torque].map(U12::get);
        assert_eq!((raw.position, steps), (65_535, [0, 4_095, 4_095, 0]));
        let beyond = [
            MotionSetPoint { position_rad: 12.5f32.next_up(), ..end },
            MotionSetPoint { velocity_rad_s: (-45.0f32).next_down(), ..end },
            MotionSetPoint { kp: 500.0f32.next_up(), ..end },
            MotionSetPoint { kd: 0.0f32.next_down(), ..end },
            MotionSetPoint { torque_nm: (-24.0f32).next_down(), ..end },
        ];
        let names = ["position", "velocity", "kp", "kd", "torque"];
        for (set_point, name) in beyond.into_iter().zip(names) {
            assert_eq!(quantise(set_point).unwrap_err().name, name);
        }
    }
}
