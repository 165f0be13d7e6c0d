//! What a figure of the physics may be.

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
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "{} must be {} to {}{space}{}, but {given}{space}{} was given",
    figure.name, figure.min, figure.max, figure.unit, figure.unit,
    space = if figure.unit.is_empty() { "" } else { " " }
)]
pub struct ImpossibleFigure {
    /// What is allowed.
    pub figure: &'static Figure,
    /// What was given, in the figure's unit.
    pub given: f64,
}
