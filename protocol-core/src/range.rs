//! What values a quantity may take, and the error for one that it may not.

use core::fmt;

/// Name, unit and allowed range of a quantity, in that unit.
///
/// Every type of [`units`](crate::units) publishes its own as `QUANTITY`, so that tools can tell a
/// person what is allowed without a second table.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Quantity {
    /// What it is, for people: `"torque current"`.
    pub name: &'static str,
    /// Its unit, for people: `"A"`; empty for a bare number.
    pub unit: &'static str,
    /// The smallest allowed value, in `unit`.
    pub min: f64,
    /// The largest allowed value, in `unit`.
    pub max: f64,
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
#[derive(Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct OutOfRange {
    /// What is allowed.
    pub quantity: &'static Quantity,
    /// What was given.
    pub given: Given,
}

/// A value as it was given. It is turned into its quantity's unit only when somebody looks: firmware
/// that refuses a value and does not print it needs no arithmetic with `f64`.
#[derive(Clone, Copy)]
pub struct Given(Kind);

#[derive(Clone, Copy)]
enum Kind {
    Steps {
        raw: u32,
        per_unit: u16,
    },
    Single(f32),
    /// The bits of an `f64` in two halves, for an `f64` would make every error eight bytes larger.
    Double {
        high: u32,
        low: u32,
    },
}

impl Given {
    /// An integer on the wire, of which `per_unit` make one unit.
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
        self.value() == other.value()
    }
}

impl fmt::Display for Given {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.value().fmt(f)
    }
}

impl fmt::Debug for Given {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.value().fmt(f)
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for Given {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "{=f64}", self.value());
    }
}

#[cfg(feature = "serde")]
impl serde::Serialize for Given {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_f64(self.value())
    }
}

impl fmt::Display for OutOfRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Quantity { name, unit, min, max } = self.quantity;
        let space = if unit.is_empty() { "" } else { " " };
        write!(
            f,
            "{name} must be {min} to {max}{space}{unit}, but {}{space}{unit} was given",
            self.given
        )
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
    extern crate std;
    use crate::units::{Angle, Gain, SingleTurnTarget};
    use std::string::ToString;

    #[test]
    fn tells_what_was_given_exactly_however_it_was_given() {
        let error = SingleTurnTarget::try_from_raw(36_001).unwrap_err();
        assert_eq!(error.given.value(), 360.01);
        assert_eq!(
            error.to_string(),
            "single-turn angle must be 0 to 360 deg, but 360.01 deg was given"
        );
        let error = SingleTurnTarget::from_degrees(-0.5).unwrap_err();
        assert_eq!(error.given.value(), -0.5);
        // More digits than an f32 holds.
        let error = Angle::from_degrees_f64(123_456_789.25).unwrap_err();
        assert_eq!(error.given.value(), 123_456_789.25);
        assert!(Gain::new(f32::NAN).unwrap_err().given.value().is_nan());
    }
}
