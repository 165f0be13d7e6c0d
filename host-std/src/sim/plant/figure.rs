//! What a figure of the physics may be.

use std::ops::RangeInclusive;

/// The figure, if it is a number in this range.
pub(super) fn check(
    name: &'static str,
    unit: &'static str,
    allowed: RangeInclusive<f64>,
    given: f64,
) -> Result<f64, ImpossibleFigure> {
    if allowed.contains(&given) {
        return Ok(given);
    }
    let (min, max) = allowed.into_inner();
    Err(ImpossibleFigure { name, unit, min, max, given })
}

/// A figure that cannot be, or that is not a number.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "{name} must be {min} to {max}{space}{unit}, but {given}{space}{unit} was given",
    space = if unit.is_empty() { "" } else { " " }
)]
pub struct ImpossibleFigure {
    /// What it is: `"supply voltage"`.
    pub name: &'static str,
    /// Its unit; empty for a bare number.
    pub unit: &'static str,
    /// The smallest allowed.
    pub min: f64,
    /// The largest allowed.
    pub max: f64,
    /// What was given.
    pub given: f64,
}
