//! Quantities: the integer on the wire, and what it means in the unit of the manual.
//!
//! One type a quantity, so that a speed limit cannot be passed as an angle, and one place for each
//! scale. `raw` is the integer on the wire. The conversions from floats round to the nearest step
//! and refuse what does not fit; `saturating_*` takes the nearest allowed value instead. Both
//! refuse NaN: for a position there is no harmless number to put in its place.
//!
//! ```
//! use myactuator_protocol_core::units::{Angle, Current};
//!
//! assert_eq!(Current::from_amperes(-1.0)?.raw(), -100);
//! assert_eq!(Angle::from_raw(36_000).degrees(), 360.0);
//! assert_eq!(Current::saturating_from_amperes(1e9)?.raw(), i16::MAX);
//! assert!(Current::from_amperes(f32::NAN).is_err());
//! # Ok::<(), myactuator_protocol_core::OutOfRange>(())
//! ```

use core::fmt;

use crate::field::{self, Data};
use crate::range::{Given, OutOfRange, Quantity};

macro_rules! define_round {
    ($name:ident $float:ident $int:ident, whole_from $limit:literal) => {
        /// The nearest whole number, halves away from zero (`core` has no `round` yet).
        #[inline]
        pub(crate) const fn $name(x: $float) -> $float {
            if !(x > -$limit && x < $limit) {
                return x; // already whole, or not a number
            }
            let whole = x as $int as $float;
            let rest = x - whole;
            if rest >= 0.5 {
                whole + 1.0
            } else if rest <= -0.5 {
                whole - 1.0
            } else {
                whole
            }
        }
    };
}
define_round!(round_f32 f32 i32, whole_from 8_388_608.0);
define_round!(round_f64 f64 i64, whole_from 4_503_599_627_370_496.0);

/// One quantity: its type, its range and its place in a data field. `per_unit` is how many wire
/// steps make one unit; `floats` names the conversions from, saturating from and to that unit.
/// `in` restricts the raw values.
macro_rules! quantity {
    (
        $(#[$attr:meta])*
        $name:ident($raw:ident $put:ident $get:ident) $what:literal $unit:literal, per_unit $per_unit:literal
        $(, floats $from:ident $saturating:ident $to:ident)?
        $(, doubles $from64:ident $saturating64:ident $to64:ident)?
    ) => {
        quantity!(@common $(#[$attr])* [derive(Default)] [serde(transparent)]
            $name($raw $put) $what $unit, $per_unit, $raw::MIN, $raw::MAX);
        $(quantity!(@floats $name $raw f32 round_f32 $unit $from $saturating $to);)?
        $(quantity!(@floats $name $raw f64 round_f64 $unit $from64 $saturating64 $to64);)?

        impl $name {
            /// The quantity with this integer on the wire.
            #[inline]
            pub const fn from_raw(raw: $raw) -> Self {
                Self(raw)
            }

            #[inline(always)]
            pub(crate) const fn read<const AT: usize>(data: &Data) -> Result<Self, OutOfRange> {
                Ok(Self(field::$get::<AT>(data)))
            }
        }
    };
    (
        $(#[$attr:meta])*
        $name:ident($raw:ident $raw_name:literal $put:ident $get:ident in $min:literal..=$max:literal $(or $also:literal)?)
        $what:literal $unit:literal, per_unit $per_unit:literal,
        floats $from:ident $saturating:ident $to:ident
    ) => {
        quantity!(@common $(#[$attr])* [] [serde(try_from = $raw_name, into = $raw_name)]
            $name($raw $put) $what $unit, $per_unit, $min, $max);
        quantity!(@floats $name $raw f32 round_f32 $unit $from $saturating $to);

        impl $name {
            /// The quantity with this integer on the wire.
            ///
            /// # Errors
            /// [`OutOfRange`] for what [`QUANTITY`](Self::QUANTITY) does not allow.
            #[inline]
            pub const fn try_from_raw(raw: $raw) -> Result<Self, OutOfRange> {
                if (raw >= Self::MIN_RAW && raw <= Self::MAX_RAW) $(|| raw == $also)? {
                    Ok(Self(raw))
                } else {
                    let given = Given::steps(raw as u32, Self::PER_UNIT as u16);
                    Err(OutOfRange { quantity: &Self::QUANTITY, given })
                }
            }

            #[inline(always)]
            pub(crate) const fn read<const AT: usize>(data: &Data) -> Result<Self, OutOfRange> {
                Self::try_from_raw(field::$get::<AT>(data))
            }
        }

        impl TryFrom<$raw> for $name {
            type Error = OutOfRange;
            fn try_from(raw: $raw) -> Result<Self, OutOfRange> {
                Self::try_from_raw(raw)
            }
        }

        impl From<$name> for $raw {
            fn from(quantity: $name) -> $raw {
                quantity.0
            }
        }
    };
    (@common
        $(#[$attr:meta])* [$($derive:meta)?] [$serde:meta]
        $name:ident($raw:ident $put:ident) $what:literal $unit:literal, $per_unit:literal,
        $min:expr, $max:expr
    ) => {
        $(#[$attr])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        $(#[$derive])?
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), $serde)]
        pub struct $name($raw);

        impl $name {
            const MIN_RAW: $raw = $min;
            const MAX_RAW: $raw = $max;
            /// Wire steps in one unit.
            const PER_UNIT: f64 = $per_unit;
            /// Name, unit and allowed range.
            pub const QUANTITY: Quantity = Quantity {
                name: $what,
                unit: $unit,
                min: Self::MIN_RAW as f64 / Self::PER_UNIT,
                max: Self::MAX_RAW as f64 / Self::PER_UNIT,
            };

            /// The integer on the wire.
            #[inline]
            pub const fn raw(self) -> $raw {
                self.0
            }

            #[inline(always)]
            pub(crate) const fn put<const AT: usize>(self, data: &mut Data) {
                field::$put::<AT>(data, self.0);
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                let value = self.0 as f64 / Self::PER_UNIT;
                if $unit.is_empty() { write!(f, "{value}") } else { write!(f, "{value} {}", $unit) }
            }
        }
    };
    (@floats $name:ident $raw:ident $float:ident $round:ident $unit:literal
        $from:ident $saturating:ident $to:ident) => {
        impl $name {
            #[doc = concat!("From ", $unit, ", rounded to the nearest step.")]
            ///
            /// # Errors
            /// [`OutOfRange`] for NaN and for what [`QUANTITY`](Self::QUANTITY) does not allow.
            #[inline]
            pub const fn $from(value: $float) -> Result<Self, OutOfRange> {
                let steps = $round(value * Self::PER_UNIT as $float);
                if steps >= Self::MIN_RAW as $float && steps <= Self::MAX_RAW as $float {
                    Ok(Self(steps as $raw))
                } else {
                    Err(OutOfRange { quantity: &Self::QUANTITY, given: Given::$float(value) })
                }
            }

            #[doc = concat!("From ", $unit, ", the nearest allowed value.")]
            ///
            /// # Errors
            /// [`OutOfRange`] for NaN only.
            #[inline]
            pub const fn $saturating(value: $float) -> Result<Self, OutOfRange> {
                let steps = $round(value * Self::PER_UNIT as $float);
                if value.is_nan() {
                    Err(OutOfRange { quantity: &Self::QUANTITY, given: Given::$float(value) })
                } else if steps < Self::MIN_RAW as $float {
                    Ok(Self(Self::MIN_RAW))
                } else if steps > Self::MAX_RAW as $float {
                    Ok(Self(Self::MAX_RAW))
                } else {
                    Ok(Self(steps as $raw))
                }
            }

            #[doc = concat!("In ", $unit, ".")]
            #[inline]
            pub const fn $to(self) -> $float {
                self.0 as $float / Self::PER_UNIT as $float
            }
        }
    };
}

quantity! {
    /// Motor or MOSFET temperature, 1 °C a step (2.14.3).
    Temperature(i8 put_i8 get_i8) "temperature" "°C", per_unit 1.0,
    floats from_celsius saturating_from_celsius celsius
}

quantity! {
    /// Torque current or phase current, 0.01 A a step (2.15.3, 2.16.3, 2.19.1). Torque is current
    /// times the motor's torque constant, which the protocol does not tell.
    Current(i16 put_i16 get_i16) "torque current" "A", per_unit 100.0,
    floats from_amperes saturating_from_amperes amperes
}

quantity! {
    /// Measured speed of the output shaft, 1 degree per second a step (2.15.3).
    Speed(i16 put_i16 get_i16) "speed" "dps", per_unit 1.0,
    floats from_dps saturating_from_dps dps
}

quantity! {
    /// Commanded speed of the output shaft, 0.01 degrees per second a step (2.20.1).
    ///
    /// `f32` holds every step up to 167,772 dps; beyond that use the `f64` conversions.
    SpeedTarget(i32 put_i32 get_i32) "speed" "dps", per_unit 100.0,
    floats from_dps saturating_from_dps dps,
    doubles from_dps_f64 saturating_from_dps_f64 dps_f64
}

quantity! {
    /// The fastest that a position command may turn the output shaft, 1 degree per second a step
    /// (2.21.1). 0 sets no limit: with planning the drive's own, in direct tracking none but the
    /// position loop's output.
    MaxSpeed(u16 put_u16 get_u16) "maximum speed" "dps", per_unit 1.0,
    floats from_dps saturating_from_dps dps
}

quantity! {
    /// The largest torque that a command may use, 1 % of the rated current a step (2.20.1, 2.24.1).
    ///
    /// In a speed command 0 means no limit; in both, a value above the stall current means none.
    MaxTorque(u8 put_u8 get_u8) "maximum torque" "% of rated current", per_unit 1.0,
    floats from_percent saturating_from_percent percent
}

quantity! {
    /// Multi-turn angle of the output shaft, 0.01 degrees a step (2.12.3, 2.21.1).
    ///
    /// `f32` holds every step up to 167,772 degrees (466 turns); beyond that use the `f64`
    /// conversions.
    Angle(i32 put_i32 get_i32) "angle" "deg", per_unit 100.0,
    floats from_degrees saturating_from_degrees degrees,
    doubles from_degrees_f64 saturating_from_degrees_f64 degrees_f64
}

quantity! {
    /// Multi-turn angle of the output shaft as feedback reports it, 1 degree a step (2.15.3).
    CoarseAngle(i16 put_i16 get_i16) "angle" "deg", per_unit 1.0,
    floats from_degrees saturating_from_degrees degrees
}

quantity! {
    /// Measured angle within one turn, 0.01 degrees a step, 0 to 359.99 degrees (2.13.3).
    SingleTurnAngle(u16 "u16" put_u16 get_u16 in 0..=35_999) "single-turn angle" "deg", per_unit 100.0,
    floats from_degrees saturating_from_degrees degrees
}

quantity! {
    /// Commanded angle within one turn, 0.01 degrees a step, 0 to 360 degrees.
    ///
    /// The manual gives the range as 0 to 359.99 and then sends 360 in both of its examples, telling
    /// that it is the same place as 0 (2.22.4); so 360 is allowed here.
    SingleTurnTarget(u16 "u16" put_u16 get_u16 in 0..=36_000) "single-turn angle" "deg", per_unit 100.0,
    floats from_degrees saturating_from_degrees degrees
}

quantity! {
    /// Multi-turn encoder position in pulses (2.6 to 2.10). Pulses in a turn of the output shaft are
    /// the encoder's pulses in a turn times the gear ratio.
    EncoderPulses(i32 put_i32 get_i32) "encoder position" "pulses", per_unit 1.0
}

quantity! {
    /// Encoder position within one turn, in pulses (2.11.3).
    SingleTurnPulses(u16 put_u16 get_u16) "single-turn encoder position" "pulses", per_unit 1.0
}

quantity! {
    /// Supply voltage, 0.1 V a step (2.14.3).
    Voltage(u16 put_u16 get_u16) "voltage" "V", per_unit 10.0,
    floats from_volts saturating_from_volts volts
}

quantity! {
    /// Planned acceleration or deceleration of the output shaft, 1 dps/s a step, 100 to 60000 (2.5.1).
    ///
    /// On the wire [`NONE`](Self::NONE) is allowed too.
    Acceleration(u32 "u32" put_u32 get_u32 in 100..=60_000 or 0) "acceleration" "dps/s", per_unit 1.0,
    floats from_dps2 saturating_from_dps2 dps2
}

impl Acceleration {
    /// No planning: position commands track their target directly (2.21.1), speed commands
    /// accelerate as hard as the current allows (2.20.2).
    ///
    /// 2.5.1 does not list 0 as a value to write, though drives take it; so it has to be asked for
    /// by this name.
    pub const NONE: Self = Self(0);
}

quantity! {
    /// Acceleration as a drive reports it, 1 dps/s a step: whatever it holds, in range or not (2.4.3).
    ReportedAcceleration(u32 put_u32 get_u32) "acceleration" "dps/s", per_unit 1.0,
    floats from_dps2 saturating_from_dps2 dps2
}

quantity! {
    /// A span of time, 1 ms a step (2.29.3, 2.31.2).
    Milliseconds(u32 put_u32 get_u32) "time" "ms", per_unit 1.0
}

quantity! {
    /// How often a drive reports by itself, 10 ms a step (2.34.2).
    ReportInterval(u16 put_u16 get_u16) "report interval" "ms", per_unit 0.1,
    floats from_millis saturating_from_millis millis
}

/// A gain of a control loop: any finite number (2.1.1 sets no range).
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(try_from = "f32", into = "f32"))]
pub struct Gain(f32);

impl Gain {
    /// Name and allowed range.
    pub const QUANTITY: Quantity =
        Quantity { name: "gain", unit: "", min: f32::MIN as f64, max: f32::MAX as f64 };

    /// A gain from its value.
    ///
    /// # Errors
    /// [`OutOfRange`] for infinities and NaN.
    pub const fn new(value: f32) -> Result<Self, OutOfRange> {
        if value.is_finite() {
            Ok(Self(value))
        } else {
            Err(OutOfRange { quantity: &Self::QUANTITY, given: Given::f32(value) })
        }
    }

    /// The gain's value.
    pub const fn value(self) -> f32 {
        self.0
    }

    #[inline(always)]
    pub(crate) const fn put<const AT: usize>(self, data: &mut Data) {
        field::put_u32::<AT>(data, self.0.to_bits());
    }

    #[inline(always)]
    pub(crate) const fn read<const AT: usize>(data: &Data) -> Result<Self, OutOfRange> {
        Self::new(f32::from_bits(field::get_u32::<AT>(data)))
    }
}

impl TryFrom<f32> for Gain {
    type Error = OutOfRange;
    fn try_from(value: f32) -> Result<Self, OutOfRange> {
        Self::new(value)
    }
}

impl From<Gain> for f32 {
    fn from(gain: Gain) -> f32 {
        gain.0
    }
}

impl fmt::Display for Gain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::string::ToString;

    #[test]
    fn rounds_to_the_nearest_step_and_halves_away_from_zero() {
        assert_eq!(round_f32(0.499_999_97), 0.0);
        assert_eq!(round_f32(0.5), 1.0);
        assert_eq!(round_f32(-0.5), -1.0);
        assert_eq!(round_f32(-2.4), -2.0);
        assert_eq!(round_f32(8_388_609.0), 8_388_609.0);
        assert_eq!(round_f64(4_503_599_627_370_497.0), 4_503_599_627_370_497.0);
        assert!(round_f32(f32::NAN).is_nan());
    }

    #[test]
    fn ends_of_a_range_are_in_it_and_one_step_more_is_not() {
        assert_eq!(Current::from_amperes(327.67).unwrap().raw(), i16::MAX);
        assert_eq!(Current::from_amperes(-327.68).unwrap().raw(), i16::MIN);
        assert!(Current::from_amperes(327.68).is_err());
        assert!(Current::from_amperes(-327.69).is_err());
        assert_eq!(Angle::from_degrees_f64(21_474_836.47).unwrap().raw(), i32::MAX);
        assert!(Angle::from_degrees_f64(21_474_836.48).is_err());
        assert!(Temperature::from_celsius(128.0).is_err());
        assert!(MaxSpeed::from_dps(-1.0).is_err());
        assert!(MaxTorque::from_percent(256.0).is_err());
        assert_eq!(SingleTurnTarget::from_degrees(360.0).unwrap().raw(), 36_000);
        assert!(SingleTurnTarget::from_degrees(360.01).is_err());
        assert!(SingleTurnAngle::from_degrees(360.0).is_err());
        assert!(Acceleration::from_dps2(99.0).is_err());
        assert!(Acceleration::from_dps2(60_001.0).is_err());
        assert!(Acceleration::from_dps2(0.0).is_err());
        assert_eq!(ReportInterval::from_millis(655_350.0).unwrap().raw(), u16::MAX);
        assert!(ReportInterval::from_millis(655_360.0).is_err());
    }

    #[test]
    fn raw_values_are_checked_too() {
        assert_eq!(Acceleration::try_from_raw(0).unwrap(), Acceleration::NONE);
        assert!(Acceleration::try_from_raw(1).is_err());
        assert!(SingleTurnTarget::try_from_raw(36_001).is_err());
        assert!(SingleTurnAngle::try_from_raw(36_000).is_err());
    }

    #[test]
    fn saturating_takes_the_end_and_never_a_nan() {
        assert_eq!(SpeedTarget::saturating_from_dps(f32::INFINITY).unwrap().raw(), i32::MAX);
        assert_eq!(SpeedTarget::saturating_from_dps(f32::NEG_INFINITY).unwrap().raw(), i32::MIN);
        assert_eq!(Acceleration::saturating_from_dps2(1.0).unwrap().raw(), 100);
        assert!(Angle::saturating_from_degrees(f32::NAN).is_err());
        assert!(Angle::from_degrees(f32::NAN).is_err());
        assert!(Gain::new(f32::INFINITY).is_err());
    }

    #[test]
    fn prints_value_and_unit() {
        assert_eq!(Current::from_raw(-100).to_string(), "-1 A");
        assert_eq!(Voltage::from_raw(485).to_string(), "48.5 V");
        assert_eq!(ReportInterval::from_raw(1).to_string(), "10 ms");
        assert_eq!(
            Acceleration::from_dps2(99.0).unwrap_err().to_string(),
            "acceleration must be 100 to 60000 dps/s, but 99 dps/s was given"
        );
    }
}
