//! What the output shaft carries.

use super::figure::{ImpossibleFigure, check};
use serde::{Deserialize, Serialize};

/// What is fixed to the output shaft: any of its parts may be there, all at once too.
///
/// ```
/// use myactuator_host_std::sim::plant::{Load, SpringStop};
///
/// let stop = SpringStop { at_deg: 90.0, stiffness_nm_per_rad: 500.0 };
/// let arm = Load { torque_nm: -2.0, inertia_kg_m2: 0.05, upper_stop: Some(stop), ..Load::NONE };
/// assert_eq!(arm.torque_at(0.0), -2.0);
/// // One degree into the spring: 500 N·m/rad * 1° = 8.73 N·m back.
/// assert!((arm.torque_at(91_f64.to_radians()) - (-2.0 - 8.727)).abs() < 0.001);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Load {
    /// Torque of the load on the shaft, the same at every angle and speed, N·m: a weight on a drum.
    pub torque_nm: f64,
    /// Inertia, kg·m².
    pub inertia_kg_m2: f64,
    /// A spring that pushes back from its angle upwards.
    pub upper_stop: Option<SpringStop>,
    /// A spring that pushes back from its angle downwards. At the same angle as the upper one it
    /// makes a spring that pulls to that angle from both sides.
    pub lower_stop: Option<SpringStop>,
}

/// A stop that gives way like a spring, without losses of its own.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpringStop {
    /// Angle of the output shaft where the shaft touches it, degrees.
    pub at_deg: f64,
    /// Stiffness, N·m/rad.
    pub stiffness_nm_per_rad: f64,
}

impl Load {
    /// A bare shaft.
    pub const NONE: Self =
        Self { torque_nm: 0.0, inertia_kg_m2: 0.0, upper_stop: None, lower_stop: None };

    /// Torque of the load on a shaft at `angle_rad`, N·m.
    pub fn torque_at(&self, angle_rad: f64) -> f64 {
        let mut torque_nm = self.torque_nm;
        if let Some(stop) = self.upper_stop {
            torque_nm -= stop.stiffness_nm_per_rad * (angle_rad - stop.at_rad()).max(0.0);
        }
        if let Some(stop) = self.lower_stop {
            torque_nm += stop.stiffness_nm_per_rad * (stop.at_rad() - angle_rad).max(0.0);
        }
        torque_nm
    }

    /// Stiffness of the stiffest stop, N·m/rad; 0 without one.
    pub(super) fn max_stiffness_nm_per_rad(&self) -> f64 {
        let stiffness = |stop: Option<SpringStop>| stop.map_or(0.0, |s| s.stiffness_nm_per_rad);
        stiffness(self.upper_stop).max(stiffness(self.lower_stop))
    }

    pub(super) fn check(&self) -> Result<(), ImpossibleFigure> {
        check("load torque", "N·m", -1e6..=1e6, self.torque_nm)?;
        check("load inertia", "kg·m²", 0.0..=1e6, self.inertia_kg_m2)?;
        for stop in [self.upper_stop, self.lower_stop].into_iter().flatten() {
            check("stop angle", "deg", -1e9..=1e9, stop.at_deg)?;
            check("stop stiffness", "N·m/rad", 0.0..=1e9, stop.stiffness_nm_per_rad)?;
        }
        Ok(())
    }
}

impl SpringStop {
    fn at_rad(self) -> f64 {
        self.at_deg.to_radians()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_loads_are_refused() {
        assert!(Load { inertia_kg_m2: -0.1, ..Load::NONE }.check().is_err());
        assert!(Load { torque_nm: f64::NAN, ..Load::NONE }.check().is_err());
        let stop = SpringStop { at_deg: 0.0, stiffness_nm_per_rad: -1.0 };
        assert!(Load { lower_stop: Some(stop), ..Load::NONE }.check().is_err());
    }
}
