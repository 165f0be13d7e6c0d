//! Quantities: the integer on the wire, and what it means in the unit of the manual.
//!
//! Each quantity has a type of its own, so that a speed limit cannot be passed as an angle, and one place for its
//! scale. `raw` is the integer on the wire. The conversions from floats round to the nearest step and refuse what does
//! not fit; `saturating_*` takes the nearest allowed amount instead. Both refuse NaN: for a position there is no
//! harmless number to put in its place. If 0 has a meaning of its own ("no limit"), it has a name, and no amount
//! becomes it.
//!
//! ```
//! use myactuator_protocol_core::units::{Angle, Current, MaxSpeed};
//!
//! assert_eq!(Current::from_amperes(-1.0)?.raw(), -100);
//! assert_eq!(Angle::from_raw(36_000).degrees(), 360.0);
//! assert_eq!(Current::saturating_from_amperes(1e9)?, Current::MAX);
//! assert!(Current::from_amperes(f32::NAN).is_err());
//! assert!(MaxSpeed::from_dps(0.4).is_err()); // not 0, which may set no limit
//! assert_eq!(format!("{:.1}", Angle::from_radians(1.0)?), "57.3 deg");
//! # Ok::<(), myactuator_protocol_core::OutOfRange>(())
//! ```

use core::fmt;

use crate::data::{self, Data};
use crate::quantity::{Form, Given, OutOfRange, Quantity, Steps, Unit};
use crate::round::{round_f32, round_f64};
use crate::time::Duration;

#[macro_use]
mod define;
pub(crate) mod decimal;

quantity! {
    /// Motor or MOSFET temperature, 1 °C a step (2.14.3).
    Temperature(i8 put_i8 get_i8) "temperature" DegreeCelsius, step 1/1
    ; floats from_celsius saturating_from_celsius celsius
}

quantity! {
    /// Torque current or phase current, 0.01 A a step (2.15.3, 2.16.3, 2.19.1). Torque is current
    /// times the motor's torque constant, which the protocol does not give.
    Current(i16 put_i16 get_i16) "torque current" Ampere, step 1/100
    ; floats from_amperes saturating_from_amperes amperes
    ; signed arithmetic
}

quantity! {
    /// Measured speed of the output shaft as feedback reports it, 1 degree per second a step (2.15.3).
    CoarseSpeed(i16 put_i16 get_i16) "speed" DegreePerSecond, step 1/1
    ; floats from_dps saturating_from_dps dps
    ; radians from_radians_per_second radians_per_second by from_dps dps
    ; signed arithmetic
}

quantity! {
    /// Commanded speed of the output shaft, 0.01 degrees per second a step (2.20.1).
    ///
    /// `f32` holds every step up to 167,772 dps; beyond that use the `f64` conversions.
    SpeedTarget(i32 put_i32 get_i32) "speed" DegreePerSecond, step 1/100
    ; floats from_dps saturating_from_dps dps
    ; doubles from_dps_f64 saturating_from_dps_f64 dps_f64
    ; radians from_radians_per_second radians_per_second by from_dps dps
    ; signed arithmetic
}

quantity! {
    /// The fastest that a position command may turn the output shaft, 1 degree per second a step
    /// (2.21.1).
    ///
    /// The smallest is 1 dps, and no amount becomes [`NO_LIMIT`](Self::NO_LIMIT).
    MaxSpeed(u16 put_u16 get_u16) "maximum speed" DegreePerSecond, step 1/1, zero "no limit in direct tracking"
    ; floats from_dps saturating_from_dps dps
    ; radians from_radians_per_second radians_per_second by from_dps dps
}

quantity! {
    /// The largest torque that a command may use, 1 % of the rated current a step (2.20.1, 2.24.1).
    ///
    /// A value above the stall current sets no limit. The smallest is 1 %, and no amount becomes
    /// [`NO_LIMIT`](Self::NO_LIMIT).
    MaxTorque(u8 put_u8 get_u8) "maximum torque" PercentOfRatedCurrent, step 1/1, zero "no limit in a speed command"
    ; floats from_percent saturating_from_percent percent
}

impl MaxSpeed {
    /// No limit in direct tracking, where the position loop's output alone decides (2.21.1). With planning, and in
    /// 0xA6, 0xA8 and 0xA9, the manual does not say what this does.
    pub const NO_LIMIT: Self = Self(0);
}

impl MaxTorque {
    /// No limit in a speed command but the stall current (2.20.1). With a force-limited position (0xA9) the manual does
    /// not say what this does.
    pub const NO_LIMIT: Self = Self(0);
}

quantity! {
    /// Multi-turn angle of the output shaft, 0.01 degrees a step (2.12.3, 2.21.1).
    ///
    /// `f32` holds every step up to 167,772 degrees (466 turns); beyond that use the `f64`
    /// conversions.
    Angle(i32 put_i32 get_i32) "angle" Degree, step 1/100
    ; floats from_degrees saturating_from_degrees degrees
    ; doubles from_degrees_f64 saturating_from_degrees_f64 degrees_f64
    ; radians from_radians radians by from_degrees degrees
    ; signed arithmetic
}

quantity! {
    /// Multi-turn angle of the output shaft as feedback reports it, 1 degree a step (2.15.3).
    CoarseAngle(i16 put_i16 get_i16) "angle" Degree, step 1/1
    ; floats from_degrees saturating_from_degrees degrees
    ; radians from_radians radians by from_degrees degrees
    ; signed arithmetic
}

quantity! {
    /// Measured angle within one turn, 0.01 degrees a step: 0 to 359.99 degrees by 2.13.3. Any value that a drive
    /// reports is kept: a whole turn reported as 360 degrees is no reason to lose a reading.
    ReportedSingleTurnAngle(u16 put_u16 get_u16) "single-turn angle" Degree, step 1/100
    ; floats from_degrees saturating_from_degrees degrees
    ; radians from_radians radians by from_degrees degrees
}

quantity! {
    /// Commanded angle within one turn, 0.01 degrees a step, 0 to 360 degrees.
    ///
    /// The manual gives the range as 0 to 359.99 and then sends 360 in both of its examples, saying
    /// that it is the same place as 0 (2.22.4); so 360 is allowed here.
    SingleTurnTarget(u16 put_u16 get_u16) "single-turn angle" Degree, step 1/100, in 0..=36_000
    ; floats from_degrees saturating_from_degrees degrees
    ; radians from_radians radians by from_degrees degrees
}

quantity! {
    /// Multi-turn encoder position in pulses (2.6 to 2.10). Pulses in a turn of the output shaft are
    /// the encoder's pulses in a turn times the gear ratio.
    EncoderPulses(i32 put_i32 get_i32) "encoder position" Pulse, step 1/1
    ; signed arithmetic
}

quantity! {
    /// Encoder position within one turn, in pulses (2.11.3).
    SingleTurnPulses(u16 put_u16 get_u16) "single-turn encoder position" Pulse, step 1/1
}

quantity! {
    /// Supply voltage, 0.1 V a step (2.14.3).
    Voltage(u16 put_u16 get_u16) "voltage" Volt, step 1/10
    ; floats from_volts saturating_from_volts volts
}

quantity! {
    /// Planned acceleration or deceleration of the output shaft, 1 dps/s a step, 100 to 60000 (2.5.1),
    /// or [`NONE`](Self::NONE), which no amount becomes.
    Acceleration(u32 put_u32 get_u32) "acceleration" DegreePerSecondSquared, step 1/1, zero "no planning", in 100..=60_000
    ; floats from_dps2 saturating_from_dps2 dps2
}

impl Acceleration {
    /// No planning, 0: position commands track their target directly (2.21.1), speed commands
    /// accelerate as hard as the current allows (2.20.2).
    ///
    /// 2.5.1 does not list 0 as a value to write; 2.20.2 and 2.21.1 describe what it does.
    pub const NONE: Self = Self(0);
}

quantity! {
    /// Acceleration as a drive reports it, 1 dps/s a step: whatever it holds, in range or not (2.4.3).
    ReportedAcceleration(u32 put_u32 get_u32) "acceleration" DegreePerSecondSquared, step 1/1
    ; floats from_dps2 saturating_from_dps2 dps2
}

quantity! {
    /// A span of time, 1 ms a step (2.29.3, 2.31.2).
    Milliseconds(u32 put_u32 get_u32) "time" Millisecond, step 1/1, zero "off as a protection time"
}

impl From<Milliseconds> for Duration {
    fn from(span: Milliseconds) -> Self {
        Self::from_millis(span.raw().into())
    }
}

/// To the nearest millisecond, but never to 0, which would switch a protection off.
impl TryFrom<Duration> for Milliseconds {
    type Error = OutOfRange;
    fn try_from(span: Duration) -> Result<Self, OutOfRange> {
        let nearest = span.as_micros().saturating_add(500) / 1_000;
        match u32::try_from(nearest) {
            Ok(raw) if raw > 0 || span == Duration::ZERO => Ok(Self(raw)),
            _ => {
                let given = Given::f64(span.as_micros() as f64 / 1e3);
                Err(OutOfRange { quantity: &Self::QUANTITY, given })
            }
        }
    }
}

quantity! {
    /// How often a drive reports unasked, 10 ms a step (2.34.2).
    ReportInterval(u16 put_u16 get_u16) "report interval" Millisecond, step 10/1
    ; floats from_millis saturating_from_millis millis
}

/// A gain of a control loop: any finite number (2.1.1 sets no range).
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(try_from = "f32", into = "f32"))]
pub struct Gain(f32);

impl Gain {
    /// Name and allowed range.
    pub const QUANTITY: Quantity = Quantity { name: "gain", unit: Unit::None, form: Form::Float };
    pub(crate) const BYTES: u8 = 4;
    /// No gain.
    pub const ZERO: Self = Self(0.0);

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
        data::put_u32::<AT>(data, self.0.to_bits());
    }

    #[inline(always)]
    pub(crate) const fn read<const AT: usize>(data: &Data) -> Result<Self, OutOfRange> {
        Self::new(f32::from_bits(data::get_u32::<AT>(data)))
    }
}

// A gain is finite, so each equals itself.
impl Eq for Gain {}

impl core::hash::Hash for Gain {
    fn hash<H: core::hash::Hasher>(&self, state: &mut H) {
        // The sum turns -0.0, which equals 0.0, into the same bits.
        (self.0 + 0.0).to_bits().hash(state);
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
    use super::*;
    use std::string::ToString;

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
        assert!(Acceleration::from_dps2(99.0).is_err());
        assert!(Acceleration::from_dps2(60_001.0).is_err());
        assert!(Acceleration::from_dps2(0.0).is_err());
        assert!(Acceleration::from_dps2(0.4).is_err());
        assert_eq!(ReportInterval::from_millis(655_350.0).unwrap().raw(), u16::MAX);
        assert!(ReportInterval::from_millis(655_360.0).is_err());
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
            "acceleration must be 100 to 60000 dps/s (0: no planning), but 99 dps/s was given"
        );
    }

    #[test]
    fn no_amount_becomes_a_0_that_means_no_limit() {
        let error = MaxTorque::from_percent(0.0).unwrap_err().to_string();
        assert_eq!(
            error,
            "maximum torque must be 1 to 255 % of rated current (0: no limit in a speed command), but 0 % of rated \
             current was given: if that is meant, use its name"
        );
        for small in [0.0, -0.0, 0.4, 0.499_999_97, 1e-30, -0.1, -5.0, f32::NEG_INFINITY] {
            assert!(MaxSpeed::from_dps(small).is_err(), "{small}");
            assert!(MaxTorque::from_percent(small).is_err(), "{small}");
            assert_eq!(MaxSpeed::saturating_from_dps(small).unwrap().raw(), 1, "{small}");
            assert_eq!(MaxTorque::saturating_from_percent(small).unwrap().raw(), 1, "{small}");
            assert_eq!(Acceleration::saturating_from_dps2(small).unwrap().raw(), 100, "{small}");
        }
        assert_eq!(MaxSpeed::from_dps(0.5).unwrap().raw(), 1);
        assert_eq!(MaxSpeed::from_radians_per_second(0.02).unwrap().raw(), 1); // 1.15 dps
        assert!(MaxSpeed::from_radians_per_second(0.001).is_err());
        let span = Duration::from_micros;
        assert_eq!(Milliseconds::try_from(span(0)).unwrap().raw(), 0);
        assert!(Milliseconds::try_from(span(499)).is_err());
        assert_eq!(Milliseconds::try_from(span(1_499)).unwrap().raw(), 1);
        assert!(Milliseconds::try_from(span(u64::MAX)).is_err());
        assert_eq!(Duration::from(Milliseconds::from_raw(7)), span(7_000));
    }

    #[test]
    fn arithmetic_ends_at_the_ends() {
        let one = Angle::from_raw(1);
        assert_eq!(Angle::MAX + one, Angle::MAX);
        assert_eq!(Angle::MIN - one, Angle::MIN);
        assert_eq!(-Angle::MIN, Angle::MAX);
        assert_eq!(-one - one, Angle::from_raw(-2));
        assert_eq!(Angle::from_radians(core::f32::consts::PI).unwrap().raw(), 18_000);
        assert_eq!(Angle::from_raw(-9_000).radians(), -core::f32::consts::FRAC_PI_2);
    }

    #[test]
    fn debug_shows_units_too() {
        assert_eq!(std::format!("{:?}", Angle::from_raw(36_000)), "Angle(360 deg)");
    }

    #[cfg(feature = "serde")]
    #[test]
    fn people_read_units_and_compact_formats_keep_steps() {
        use serde::Deserialize;
        use serde::de::IntoDeserializer;
        use serde::de::value::{Error, F64Deserializer};
        let read = |amount: f64| {
            let from: F64Deserializer<Error> = amount.into_deserializer();
            MaxSpeed::deserialize(from)
        };
        assert_eq!(read(500.0), Ok(MaxSpeed::from_raw(500)));
        assert_eq!(read(0.0), Ok(MaxSpeed::NO_LIMIT));
        assert!(read(0.4).is_err() && read(f64::NAN).is_err());
    }
}
