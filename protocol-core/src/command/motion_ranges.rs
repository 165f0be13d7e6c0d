//! The scales of motion (MIT) mode, and its values in SI units (manual 5.1).

use crate::command::motion::{RawMotion, RawMotionFeedback, U12};
use crate::firmware::Firmware;
use crate::id::MotorId;
use crate::quantity::MotionScale;

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
    /// Position of the output shaft, rad.
    pub position_rad: f32,
    /// Velocity of the output shaft, rad/s.
    pub velocity_rad_s: f32,
    /// Torque, N·m.
    pub torque_nm: f32,
}

/// A motion mode value that the ranges do not allow, or that is not a number.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{name} must be {min} to {max} {unit}, but {given} {unit} was given")]
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

/// The scales of motion mode: where the first and last step of each value lie (5.1).
///
/// They differ between firmware versions, and steps of one scale sent to a drive with another multiply its torque. Use
/// [`V4_3`](Self::V4_3) only for drives of this protocol version.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(try_from = "MotionLimits", into = "MotionLimits"))]
pub struct MotionRanges(MotionLimits);

/// The largest value of each scale; position, velocity and torque reach as far to the negative side.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct MotionLimits {
    /// Position, rad.
    pub position_rad: f32,
    /// Velocity, rad/s.
    pub velocity_rad_s: f32,
    /// Gain on the position error, N·m/rad.
    pub kp: f32,
    /// Gain on the velocity error, N·m·s/rad.
    pub kd: f32,
    /// Torque, N·m.
    pub torque_nm: f32,
}

/// The step of `value` on a scale of `last + 1` steps from `-max` to `max`; any step for a value that is not on the
/// scale. The middle of the scale lies between two steps and goes to the upper one, as all halves do. The manual's own
/// example (10 rad) is such a half. Multiplying by a rounded constant still finds it on the scales of V4.3, as the
/// tests show.
#[inline(always)]
const fn symmetric_step(value: f32, max: f32, last: f32) -> i32 {
    let steps_per_unit = last / (max + max); // a constant where the scale is
    (value * steps_per_unit + (last + 1.0) / 2.0) as i32
}

/// The same on a scale of 4096 steps from 0 to `max`.
#[inline(always)]
const fn gain_step(value: f32, max: f32) -> i32 {
    // A half less than a step of f32. With one half itself, the sum for a value just below a half would be rounded up
    // to the next whole number.
    const BELOW_HALF: f32 = 0.5 - f32::EPSILON / 4.0;
    (value * (LAST_12 / max) + BELOW_HALF) as i32
}

const fn refused(scale: usize, (min, max): (f32, f32), given: f32) -> MotionOutOfRange {
    let quantity = MotionScale::ALL[scale].quantity();
    MotionOutOfRange { name: quantity.name, unit: quantity.unit.symbol(), min, max, given }
}

#[inline(always)]
const fn raw([position, velocity, kp, kd, torque]: [i32; 5]) -> RawMotion {
    RawMotion {
        position: position as u16,
        velocity: U12::low_bits(velocity),
        kp: U12::low_bits(kp),
        kd: U12::low_bits(kd),
        torque: U12::low_bits(torque),
    }
}

/// Whether a step lies so far from both ends of its scale that its value is certainly on it.
#[inline(always)]
const fn is_inner(step: i32, last: f32) -> bool {
    // Up to 255/256 of the scale: a number that fits into a compare instruction.
    let most = last as u32 & !(last as u32 >> 8);
    (step as u32).wrapping_sub(1) <= most
}

const LAST_16: f32 = 65_535.0;
const LAST_12: f32 = 4_095.0;

const fn last_step(scale: MotionScale) -> f32 {
    if matches!(scale, MotionScale::Position) { LAST_16 } else { LAST_12 }
}

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
    /// [`MotionOutOfRange`] unless every limit is 0.001 to 1e6.
    pub const fn new(limits: MotionLimits) -> Result<Self, MotionOutOfRange> {
        let checks = [
            (limits.position_rad, "position range", "rad"),
            (limits.velocity_rad_s, "velocity range", "rad/s"),
            (limits.kp, "kp range", "N·m/rad"),
            (limits.kd, "kd range", "N·m·s/rad"),
            (limits.torque_nm, "torque range", "N·m"),
        ];
        let mut row = 0;
        while row < checks.len() {
            let ((given, name, unit), min, max) = (checks[row], 1e-3, 1e6);
            if !(min <= given && given <= max) {
                return Err(MotionOutOfRange { name, unit, min, max, given });
            }
            row += 1;
        }
        Ok(Self(limits))
    }

    /// The ends of a scale.
    #[inline(always)]
    pub const fn ends(&self, scale: MotionScale) -> (f32, f32) {
        self.all_ends()[scale as usize]
    }

    #[inline(always)]
    const fn all_ends(&self) -> [(f32, f32); 5] {
        let MotionLimits { position_rad, velocity_rad_s, kp, kd, torque_nm } = self.0;
        [
            (-position_rad, position_rad),
            (-velocity_rad_s, velocity_rad_s),
            (0.0, kp),
            (0.0, kd),
            (-torque_nm, torque_nm),
        ]
    }

    /// The value of a step of a scale, for callers that want more digits than an `f32` has.
    pub const fn value(&self, scale: MotionScale, step: u16) -> f64 {
        let (min, max) = self.ends(scale);
        min as f64 + step as f64 * (max as f64 - min as f64) / last_step(scale) as f64
    }

    #[inline(always)]
    const fn value_f32(&self, scale: MotionScale, step: u16) -> f32 {
        let (min, max) = self.ends(scale);
        min + step as f32 * (max - min) / last_step(scale)
    }

    /// The step of a scale nearest to a value; halves go up.
    ///
    /// # Errors
    /// [`MotionOutOfRange`] for a value beyond the scale, an infinity or NaN.
    pub fn step(&self, scale: MotionScale, value: f64) -> Result<u16, MotionOutOfRange> {
        let (min, max) = self.ends(scale);
        let (low, high) = (f64::from(min), f64::from(max));
        if low <= value && value <= high {
            Ok(((value - low) / (high - low) * f64::from(last_step(scale)) + 0.5) as u16)
        } else {
            Err(refused(scale as usize, (min, max), value as f32))
        }
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
    pub const fn quantise(
        &self,
        set_point: &MotionSetPoint,
    ) -> Result<RawMotion, MotionOutOfRange> {
        let steps = self.steps(set_point);
        let [position, velocity, kp, kd, torque] = steps;
        // Comparing steps takes half the instructions of comparing floats, and leaves only the ends of the scales in
        // doubt.
        let certain = is_inner(position, LAST_16)
            & is_inner(velocity, LAST_12)
            & is_inner(kp, LAST_12)
            & is_inner(kd, LAST_12)
            & is_inner(torque, LAST_12);
        if certain { Ok(raw(steps)) } else { self.quantise_near_ends(set_point) }
    }

    /// Position, velocity, kp, kd and torque as steps, whether or not they are on their scales.
    #[inline(always)]
    const fn steps(&self, set_point: &MotionSetPoint) -> [i32; 5] {
        let max = &self.0;
        [
            symmetric_step(set_point.position_rad, max.position_rad, LAST_16),
            symmetric_step(set_point.velocity_rad_s, max.velocity_rad_s, LAST_12),
            gain_step(set_point.kp, max.kp),
            gain_step(set_point.kd, max.kd),
            symmetric_step(set_point.torque_nm, max.torque_nm, LAST_12),
        ]
    }

    /// As [`quantise`](Self::quantise), for a set-point with a value at an end of its scale or beyond. It does
    /// everything again, so that `quantise` itself keeps nothing for it.
    #[inline(never)]
    const fn quantise_near_ends(
        &self,
        set_point: &MotionSetPoint,
    ) -> Result<RawMotion, MotionOutOfRange> {
        let MotionSetPoint { position_rad, velocity_rad_s, kp, kd, torque_nm } = *set_point;
        let values = [position_rad, velocity_rad_s, kp, kd, torque_nm];
        let ends = self.all_ends();
        let mut row = 0;
        while row < values.len() {
            let (given, (min, max)) = (values[row], ends[row]);
            // Not a number is not within anything.
            if !(min <= given && given <= max) {
                return Err(refused(row, ends[row], given));
            }
            row += 1;
        }
        Ok(raw(self.steps(set_point)))
    }

    /// As [`quantise`](Self::quantise), with each value beyond its scale at the scale's end.
    ///
    /// # Errors
    /// [`MotionOutOfRange`] for NaN only.
    pub const fn saturating_quantise(
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
    pub const fn set_point(&self, raw: &RawMotion) -> MotionSetPoint {
        MotionSetPoint {
            position_rad: self.value_f32(MotionScale::Position, raw.position),
            velocity_rad_s: self.value_f32(MotionScale::Velocity, raw.velocity.get()),
            kp: self.value_f32(MotionScale::Kp, raw.kp.get()),
            kd: self.value_f32(MotionScale::Kd, raw.kd.get()),
            torque_nm: self.value_f32(MotionScale::Torque, raw.torque.get()),
        }
    }

    /// The measurement that these steps mean on these scales.
    #[inline]
    pub const fn feedback(&self, raw: &RawMotionFeedback) -> MotionFeedback {
        MotionFeedback {
            position_rad: self.value_f32(MotionScale::Position, raw.position),
            velocity_rad_s: self.value_f32(MotionScale::Velocity, raw.velocity.get()),
            torque_nm: self.value_f32(MotionScale::Torque, raw.torque.get()),
        }
    }

    /// A measurement of this motor on these scales, as a drive sends it: beyond a scale, the scale's end.
    ///
    /// # Errors
    /// [`MotionOutOfRange`] for NaN only.
    pub fn quantise_feedback(
        &self,
        motor: MotorId,
        feedback: &MotionFeedback,
    ) -> Result<RawMotionFeedback, MotionOutOfRange> {
        let raw = self.saturating_quantise(&MotionSetPoint {
            position_rad: feedback.position_rad,
            velocity_rad_s: feedback.velocity_rad_s,
            torque_nm: feedback.torque_nm,
            kp: 0.0,
            kd: 0.0,
        })?;
        Ok(RawMotionFeedback {
            id_byte: motor.get(),
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

impl Firmware {
    /// The scales of its motion mode, if they are the same for all its motors. Those of V4.4 depend on the motor's
    /// largest torque: if you know that, make them with [`MotionRanges::new`].
    pub const fn motion_ranges(self) -> Option<MotionRanges> {
        match self {
            Self::V4_3 => Some(MotionRanges::V4_3),
            Self::V4_4 => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn set_points_are_quantised_at_compile_time_too() {
        const HOLD: Result<RawMotion, MotionOutOfRange> =
            MotionRanges::V4_3.quantise(&MotionSetPoint {
                position_rad: 10.0,
                velocity_rad_s: 0.0,
                kp: 10.0,
                kd: 1.0,
                torque_nm: 10.0,
            });
        assert_eq!(HOLD.unwrap().position, 58_982); // 5.4
    }

    #[test]
    fn every_value_goes_to_its_nearest_step() {
        // 65535 steps in 25 rad, 4095 in 90 rad/s and in kp 500.
        for step in 0..=4095u16 {
            for part in [-0.4, 0.0, 0.4] {
                let place = f64::from(step) + part;
                if !(0.0..=4095.0).contains(&place) {
                    continue;
                }
                let set_point = MotionSetPoint {
                    position_rad: (place * 16.0 * 25.0 / 65_535.0 - 12.5) as f32,
                    velocity_rad_s: (place * 90.0 / 4_095.0 - 45.0) as f32,
                    kp: (place * 500.0 / 4_095.0) as f32,
                    kd: (place * 5.0 / 4_095.0) as f32,
                    torque_nm: (24.0 - place * 48.0 / 4_095.0) as f32,
                };
                let raw = MotionRanges::V4_3.quantise(&set_point).unwrap();
                let steps = [raw.velocity, raw.kp, raw.kd].map(U12::get);
                assert_eq!(steps, [step; 3], "{place}");
                assert_eq!(raw.torque.get(), 4_095 - step, "{place}");
                let sixteenth = f64::from(raw.position) - place * 16.0;
                assert!(sixteenth.abs() <= 0.51, "{place}: {}", raw.position);
            }
        }
    }
}
