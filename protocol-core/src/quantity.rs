//! What a value is and which values are allowed: [`Quantity`], and the error for one that is not allowed.
//!
//! Every type of [`units`](crate::units), every code and every flag set publishes its own as `QUANTITY`, and a
//! [`Field`](crate::command::Field) refers to it. So code that prints, parses or tabulates a value needs no second
//! list.

use core::fmt;

use crate::data::Data;

/// A unit of measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Unit {
    /// A bare number.
    None,
    /// Torque or phase current.
    Ampere,
    /// Supply voltage.
    Volt,
    /// Temperature.
    DegreeCelsius,
    /// Angle of the output shaft.
    Degree,
    /// Speed of the output shaft.
    DegreePerSecond,
    /// Acceleration of the output shaft.
    DegreePerSecondSquared,
    /// Torque, as a part of the motor's rated current.
    PercentOfRatedCurrent,
    /// Encoder position.
    Pulse,
    /// Time.
    Millisecond,
    /// Angle in motion mode.
    Radian,
    /// Speed in motion mode.
    RadianPerSecond,
    /// Torque in motion mode.
    NewtonMetre,
    /// Gain on the position error in motion mode.
    NewtonMetrePerRadian,
    /// Gain on the velocity error in motion mode.
    NewtonMetreSecondPerRadian,
}

impl Unit {
    /// For people, after a number: `"dps/s"`; empty for a bare number.
    pub const fn symbol(self) -> &'static str {
        self.words().0
    }

    /// For programs, at the end of a key: `"dps2"` as in `acceleration_dps2`; empty if a key needs none.
    pub const fn key(self) -> &'static str {
        self.words().1
    }

    const fn words(self) -> (&'static str, &'static str) {
        match self {
            Self::None => ("", ""),
            Self::Ampere => ("A", "a"),
            Self::Volt => ("V", "v"),
            Self::DegreeCelsius => ("°C", "c"),
            Self::Degree => ("deg", "deg"),
            Self::DegreePerSecond => ("dps", "dps"),
            Self::DegreePerSecondSquared => ("dps/s", "dps2"),
            Self::PercentOfRatedCurrent => ("% of rated current", "pct"),
            Self::Pulse => ("pulses", "pulses"),
            Self::Millisecond => ("ms", "ms"),
            Self::Radian => ("rad", "rad"),
            Self::RadianPerSecond => ("rad/s", "rad_s"),
            Self::NewtonMetre => ("N·m", "nm"),
            Self::NewtonMetrePerRadian => ("N·m/rad", ""),
            Self::NewtonMetreSecondPerRadian => ("N·m·s/rad", ""),
        }
    }
}

/// Equal steps of a whole number: the unit is `numerator / denominator` times the number on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Steps {
    /// The smallest allowed number on the wire. If it is below 0, the number has a sign.
    pub min: i64,
    /// The largest allowed number on the wire.
    pub max: i64,
    /// What 0 means if it is not an amount like the others ("no limit"). Then it is allowed, whatever `min` is, and no
    /// other amount is ever rounded to it.
    pub zero: Option<&'static str>,
    /// The numerator of a step in the unit: 1 or 10.
    pub numerator: u8,
    /// The denominator of a step in the unit: 1, 10 or 100.
    pub denominator: u8,
}

impl Steps {
    /// How many steps make one unit.
    pub const fn per_unit(&self) -> f64 {
        self.denominator as f64 / self.numerator as f64
    }

    /// Whether a number of steps is allowed.
    #[inline]
    pub const fn allow(&self, raw: i64) -> bool {
        (self.min <= raw && raw <= self.max) || (raw == 0 && self.zero.is_some())
    }
}

/// A name of a number on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Name {
    /// The number; of a flag, its bit.
    pub raw: u16,
    /// For programs: `"current-kp"`.
    pub name: &'static str,
    /// For people, a phrase or a sentence.
    pub meaning: &'static str,
}

/// One of the values of motion mode, whose scales depend on the drive's firmware.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MotionScale {
    /// Position, rad.
    Position,
    /// Velocity, rad/s.
    Velocity,
    /// Gain on the position error, N·m/rad.
    Kp,
    /// Gain on the velocity error, N·m·s/rad.
    Kd,
    /// Torque, N·m.
    Torque,
}

impl MotionScale {
    /// All five, in the order of a command's bytes.
    pub const ALL: [Self; 5] = [Self::Position, Self::Velocity, Self::Kp, Self::Kd, Self::Torque];

    /// Its quantity.
    pub const fn quantity(self) -> &'static Quantity {
        const fn named(name: &'static str, unit: Unit, scale: MotionScale) -> Quantity {
            Quantity { name, unit, form: Form::Motion(scale) }
        }
        const QUANTITIES: &[Quantity; 5] = &[
            named("position", Unit::Radian, MotionScale::Position),
            named("velocity", Unit::RadianPerSecond, MotionScale::Velocity),
            named("kp", Unit::NewtonMetrePerRadian, MotionScale::Kp),
            named("kd", Unit::NewtonMetreSecondPerRadian, MotionScale::Kd),
            named("torque", Unit::NewtonMetre, MotionScale::Torque),
        ];
        &QUANTITIES[self as usize]
    }
}

/// How a value is encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Form {
    /// Equal steps of a whole number.
    Steps(Steps),
    /// A finite `f32`.
    Float,
    /// A code: a number with a name. Numbers without a name are kept.
    Code(&'static [Name]),
    /// 0 for off, 1 for on.
    Switch,
    /// A flag for each of these bits. Other bits are kept.
    Flags(&'static [Name]),
    /// A date as a decimal number, YYYYMMDD, possibly followed by a two-digit build number.
    Date,
    /// ASCII characters, padded with zeros.
    Text,
    /// A motor id, as its reply identifier or as a bare number in one of two bytes (4.3, 7.3).
    ReplyIdentifier,
    /// A step between the ends of a scale of motion mode.
    Motion(MotionScale),
}

/// What a value is: its name, its unit, and its form with its range.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Quantity {
    /// What it is, for people: `"torque current"`.
    pub name: &'static str,
    /// Its unit.
    pub unit: Unit,
    /// How it is encoded, and which values are allowed.
    pub form: Form,
}

impl Quantity {
    /// A whole number from `min` to `max`.
    pub const fn whole(name: &'static str, min: i64, max: i64) -> Self {
        let steps = Steps { min, max, zero: None, numerator: 1, denominator: 1 };
        Self { name, unit: Unit::None, form: Form::Steps(steps) }
    }

    /// The amount of this many steps, in the unit. (For other forms: the number itself.)
    pub const fn amount(&self, raw: i64) -> f64 {
        match self.form {
            Form::Steps(steps) => raw as f64 * steps.numerator as f64 / steps.denominator as f64,
            Form::Float => f32::from_bits(raw as u32) as f64,
            _ => raw as f64,
        }
    }

    /// Whether this number on the wire is allowed.
    pub const fn allows(&self, raw: i64) -> bool {
        match self.form {
            Form::Steps(steps) => steps.allow(raw),
            Form::Float => {
                0 <= raw && raw <= u32::MAX as i64 && f32::from_bits(raw as u32).is_finite()
            }
            Form::Switch => raw == 0 || raw == 1,
            Form::ReplyIdentifier => 1 <= raw && raw <= 32,
            _ => true,
        }
    }

    /// The step nearest to an amount in the unit. An amount that is not 0 never becomes a 0 that has a meaning of its
    /// own.
    ///
    /// # Errors
    /// [`OutOfRange`] for NaN and for what the quantity does not allow.
    pub fn nearest(&'static self, amount: f64) -> Result<i64, OutOfRange> {
        let wrong = OutOfRange { quantity: self, given: Given::f64(amount) };
        match self.form {
            Form::Steps(Steps { min, max, zero, numerator, denominator }) => {
                let steps =
                    crate::round::round_f64(amount * f64::from(denominator) / f64::from(numerator));
                if amount == 0.0 && zero.is_some() {
                    Ok(0)
                } else if steps >= min as f64 && steps <= max as f64 {
                    Ok(steps as i64)
                } else {
                    Err(wrong)
                }
            }
            Form::Float if (amount as f32).is_finite() => Ok(i64::from((amount as f32).to_bits())),
            Form::Float => Err(wrong),
            _ => {
                let raw = amount as i64;
                if raw as f64 == amount && self.allows(raw) { Ok(raw) } else { Err(wrong) }
            }
        }
    }

    /// The name of a number as a code; `None` if it has none.
    pub fn name_of(&self, raw: i64) -> Option<&'static str> {
        let Form::Code(names) = self.form else { return None };
        names.iter().find(|name| i64::from(name.raw) == raw).map(|name| name.name)
    }

    /// The number of the code with this name; `None` if there is none.
    pub fn code_of(&self, name: &str) -> Option<u16> {
        let Form::Code(names) = self.form else { return None };
        names.iter().find(|code| code.name == name).map(|code| code.raw)
    }
}

/// What is allowed, in words: `angle must be -10 to 10 deg`.
impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, unit, form } = self;
        let symbol = unit.symbol();
        let space = if symbol.is_empty() { "" } else { " " };
        match form {
            Form::Steps(Steps { min, max, zero, .. }) => {
                let (min, max) = (self.amount(*min), self.amount(*max));
                write!(f, "{name} must be {min} to {max}{space}{symbol}")?;
                match zero {
                    Some(meaning) => write!(f, " (0: {meaning})"),
                    None => Ok(()),
                }
            }
            Form::Float => write!(f, "{name} must be a finite number"),
            Form::Switch => write!(f, "{name} must be 0 (off) or 1 (on)"),
            Form::Code(names) => {
                write!(f, "{name} must be")?;
                for (place, name) in names.iter().enumerate() {
                    let between = if place == 0 { "" } else { "," };
                    write!(f, "{between} {} ({})", name.name, name.raw)?;
                }
                write!(f, " or another number up to 255")
            }
            Form::Flags(_) => write!(f, "{name} must be bits of a number"),
            Form::Date => write!(f, "{name} must be a date such as 20220206"),
            Form::Text => write!(f, "{name} must be up to 7 ASCII characters"),
            Form::ReplyIdentifier => write!(f, "{name} must be 1 to 32"),
            Form::Motion(_) => {
                write!(f, "{name} must be within the firmware's range{space}{symbol}")
            }
        }
    }
}

/// Where a value is in a data field.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Place {
    /// Whole bytes, low byte first.
    Bytes {
        /// The first of them.
        first: u8,
        /// How many.
        count: u8,
    },
    /// Bits in big-endian order (motion mode), counted from the highest of the first byte.
    Bits {
        /// The first and highest of them.
        first: u8,
        /// How many.
        count: u8,
    },
}

impl Place {
    /// How many bits it has, at most 64.
    pub const fn bits(self) -> u32 {
        let bits = match self {
            Self::Bytes { count, .. } => count as u32 * 8,
            Self::Bits { count, .. } => count as u32,
        };
        if bits > 64 { 64 } else { bits }
    }

    const fn low_bits(self) -> u64 {
        if self.bits() == 0 { 0 } else { u64::MAX >> (64 - self.bits()) }
    }

    /// How far the bits are shifted up from the lowest bit, in their byte order.
    const fn shift(self) -> u32 {
        match self {
            Self::Bytes { first, .. } => first as u32 * 8 % 64,
            Self::Bits { first, .. } => 64u32.saturating_sub(first as u32 + self.bits()) % 64,
        }
    }

    /// Reads these bits of a data field, as an unsigned number.
    pub const fn get(self, data: &Data) -> u64 {
        let all = match self {
            Self::Bytes { .. } => u64::from_le_bytes(*data),
            Self::Bits { .. } => u64::from_be_bytes(*data),
        };
        all >> self.shift() & self.low_bits()
    }

    /// Writes the low bits of a number to these bits.
    pub const fn put(self, data: &mut Data, bits: u64) {
        let mask = self.low_bits() << self.shift();
        let bits = bits << self.shift() & mask;
        *data = match self {
            Self::Bytes { .. } => (u64::from_le_bytes(*data) & !mask | bits).to_le_bytes(),
            Self::Bits { .. } => (u64::from_be_bytes(*data) & !mask | bits).to_be_bytes(),
        };
    }
}

/// A value that its quantity does not allow, or that is not a number.
///
/// ```
/// use myactuator_protocol_core::units::Current;
///
/// let error = Current::from_amperes(400.0).unwrap_err();
/// assert_eq!(
///     error.to_string(),
///     "torque current must be -327.68 to 327.67 A, but 400 A was given"
/// );
/// ```
#[derive(Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct OutOfRange {
    /// What is allowed.
    pub quantity: &'static Quantity,
    /// What was given.
    pub given: Given,
}

/// A value as it was given. It is converted to its quantity's unit only when it is read, so firmware that refuses a
/// value and does not print it needs no arithmetic with `f64`.
#[derive(Clone, Copy)]
pub struct Given(Kind);

#[derive(Clone, Copy)]
enum Kind {
    Steps {
        raw: u32,
        per_unit: u16,
    },
    Single(f32),
    /// The bits of an `f64` in two halves, since an `f64` would make every error eight bytes larger.
    Double {
        high: u32,
        low: u32,
    },
}

impl Given {
    /// An integer on the wire; `per_unit` of them make one unit.
    pub(crate) const fn steps(raw: u32, per_unit: u16) -> Self {
        Self(Kind::Steps { raw, per_unit })
    }

    pub(crate) const fn f32(value: f32) -> Self {
        Self(Kind::Single(value))
    }

    pub(crate) const fn f64(value: f64) -> Self {
        let bits = value.to_bits();
        Self(Kind::Double { high: (bits >> 32) as u32, low: bits as u32 })
    }

    /// The value in the quantity's unit.
    pub const fn value(self) -> f64 {
        match self.0 {
            Kind::Steps { raw, per_unit } => raw as f64 / per_unit as f64,
            Kind::Single(value) => value as f64,
            Kind::Double { high, low } => f64::from_bits((high as u64) << 32 | low as u64),
        }
    }
}

impl From<f64> for Given {
    fn from(value: f64) -> Self {
        Self::f64(value)
    }
}

impl PartialEq for Given {
    fn eq(&self, other: &Self) -> bool {
        self.value().total_cmp(&other.value()).is_eq()
    }
}

impl Eq for Given {}

impl fmt::Display for Given {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            // As it was given: the same number in f64 has digits that were not given.
            Kind::Single(value) => value.fmt(f),
            Kind::Steps { .. } | Kind::Double { .. } => self.value().fmt(f),
        }
    }
}

impl fmt::Debug for Given {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for Given {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "{=f64}", self.value());
    }
}

#[cfg(feature = "serde")]
impl serde::Serialize for OutOfRange {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        use serde::ser::SerializeStruct;
        let mut error = serializer.serialize_struct("OutOfRange", 2)?;
        error.serialize_field("quantity", self.quantity.name)?;
        error.serialize_field("given", &self.given.value())?;
        error.end()
    }
}

impl fmt::Display for OutOfRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let symbol = self.quantity.unit.symbol();
        let space = if symbol.is_empty() { "" } else { " " };
        write!(f, "{}, but {}{space}{symbol} was given", self.quantity, self.given)?;
        match self.quantity.form {
            Form::Steps(Steps { zero: Some(_), .. }) if self.given.value() == 0.0 => {
                f.write_str(": if that is meant, use its name")
            }
            _ => Ok(()),
        }
    }
}

impl fmt::Debug for OutOfRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "OutOfRange({self})")
    }
}

impl core::error::Error for OutOfRange {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::{Angle, Current, Gain, MaxSpeed, SingleTurnTarget};
    use std::string::ToString;

    #[test]
    fn range_error_shows_the_given_value_exactly() {
        let error = SingleTurnTarget::try_from_raw(36_001).unwrap_err();
        assert_eq!(error.given.value(), 360.01);
        assert_eq!(
            error.to_string(),
            "single-turn angle must be 0 to 360 deg, but 360.01 deg was given"
        );
        let error = SingleTurnTarget::from_degrees(-0.5).unwrap_err();
        assert_eq!(error.given.value(), -0.5);
        // Not 400.4 as the nearest f32, which is 400.3999938964844.
        let error = Current::from_amperes(400.4).unwrap_err();
        assert!(error.to_string().ends_with("but 400.4 A was given"), "{error}");
        // More digits than an f32 holds.
        let error = Angle::from_degrees_f64(123_456_789.25).unwrap_err();
        assert_eq!(error.given.value(), 123_456_789.25);
        assert!(Gain::new(f32::NAN).unwrap_err().given.value().is_nan());
    }

    #[test]
    fn a_zero_with_a_meaning_is_only_what_was_asked_for() {
        let speed = &MaxSpeed::QUANTITY;
        assert_eq!(speed.nearest(0.0), Ok(0));
        assert_eq!(speed.nearest(0.6), Ok(1));
        assert_eq!(
            speed.nearest(0.4).unwrap_err().to_string(),
            "maximum speed must be 1 to 65535 dps (0: no limit in direct tracking), but 0.4 dps was given"
        );
        assert_eq!(Angle::QUANTITY.nearest(0.004), Ok(0));
    }

    #[test]
    fn a_place_changes_its_own_bits_only() {
        for place in [
            Place::Bytes { first: 0, count: 1 },
            Place::Bytes { first: 6, count: 2 },
            Place::Bytes { first: 1, count: 7 },
            Place::Bits { first: 0, count: 16 },
            Place::Bits { first: 28, count: 12 },
            Place::Bits { first: 52, count: 12 },
        ] {
            let ones = u64::MAX >> (64 - place.bits());
            let mut data = [0; 8];
            place.put(&mut data, u64::MAX);
            assert_eq!(place.get(&data), ones);
            let set: u32 = data.iter().map(|byte| byte.count_ones()).sum();
            assert_eq!(set, place.bits(), "{place:?}");
            let mut data = [0xFF; 8];
            place.put(&mut data, 0);
            let set: u32 = data.iter().map(|byte| byte.count_ones()).sum();
            assert_eq!((place.get(&data), set), (0, 64 - place.bits()), "{place:?}");
        }
        // No made-up value panics.
        for (first, count) in [(0, 0), (0, 9), (60, 12), (255, 255), (64, 64), (7, 2)] {
            for place in [Place::Bytes { first, count }, Place::Bits { first, count }] {
                let mut data = [0xA5; 8];
                place.put(&mut data, u64::MAX);
                let _ = place.get(&data);
            }
        }
        // 5.2: kp fills the low nibble of the fourth byte and the fifth.
        let mut data = [0; 8];
        Place::Bits { first: 28, count: 12 }.put(&mut data, 0xABC);
        assert_eq!(data, [0, 0, 0, 0x0A, 0xBC, 0, 0, 0]);
        Place::Bytes { first: 6, count: 2 }.put(&mut data, 0x1234);
        assert_eq!(data, [0, 0, 0, 0x0A, 0xBC, 0, 0x34, 0x12]);
    }
}
