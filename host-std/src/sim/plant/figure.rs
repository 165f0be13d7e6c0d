//! What a figure of the physics may be.

use std::fmt;

/// Name, unit and allowed range of a figure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figure {
    /// What it is: `"supply voltage"`.
    pub name: &'static str,
    /// Its unit; empty for a bare number.
    pub unit: &'static str,
    /// The smallest allowed.
    pub min: f64,
    /// The largest allowed.
    pub max: f64,
}

impl Figure {
    pub(super) fn check(&'static self, given: f64) -> Result<f64, ImpossibleFigure> {
        if given >= self.min && given <= self.max {
            Ok(given)
        } else {
            Err(ImpossibleFigure { figure: self, given })
        }
    }
}

/// A figure that cannot be, or that is not a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImpossibleFigure {
    /// What is allowed.
    pub figure: &'static Figure,
    /// What was given, in the figure's unit.
    pub given: f64,
}

impl fmt::Display for ImpossibleFigure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Figure { name, unit, min, max } = self.figure;
        let (given, space) = (self.given, if unit.is_empty() { "" } else { " " });
        write!(f, "{name} must be {min} to {max}{space}{unit}, but {given}{space}{unit} was given")
    }
}

impl std::error::Error for ImpossibleFigure {}
