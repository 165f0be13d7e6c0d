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
    /// What was given, in the quantity's unit.
    pub given: f64,
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
