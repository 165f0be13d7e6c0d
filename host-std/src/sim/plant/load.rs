//! The load of the output shaft.

use std::ops::RangeInclusive;

use super::figure::{ImpossibleFigure, check};
use serde::{Deserialize, Serialize};

/// Acceleration of a body that falls, m/s².
const GRAVITY_M_S2: f64 = 9.806_65;

/// The largest angle that can be distinguished from its neighbours, degrees.
pub(super) const ANGLE_DEG: f64 = 1e9;

/// What is fixed to the output shaft. All parts are optional, and add up.
///
/// Angles are those of the output shaft, turns included. A load is checked when it is fixed to a motor, by
/// [`SimulatedMotor::set_load`](super::SimulatedMotor::set_load) at any time or by
/// [`Fleet::load`](crate::sim::Fleet::load) from the start.
///
/// ```
/// use myactuator_host_std::sim::plant::{Arm, EndStop, Load, MotorParameters, SimulatedMotor, Spring};
///
/// // A forearm of 0.8 kg with its centre of mass 0.25 m from the joint, which hangs at 0° and ends at ±120°.
/// let end = |at_deg| EndStop { at_deg, stiffness_nm_per_rad: 2_000.0, restitution: 0.3 };
/// let forearm = Load {
///     inertia_kg_m2: 0.01,
///     arm: Some(Arm { mass_kg: 0.8, length_m: 0.25, down_deg: 0.0 }),
///     damping_nm_s_per_rad: 0.05,
///     lower_stop: Some(end(-120.0)),
///     upper_stop: Some(end(120.0)),
///     ..Load::NONE
/// };
/// // Stretched out, 0.8 kg * 9.81 m/s² * 0.25 m pull it down.
/// assert!((forearm.torque_at(90_f64.to_radians(), 0.0) + 1.961).abs() < 0.001);
/// let mut motor = SimulatedMotor::new(MotorParameters::named("RMD-X8-PRO")?)?;
/// motor.set_load(forearm)?;
///
/// // A balancer that pulls to the upright, while the motor runs.
/// let spring = Spring { rest_deg: 180.0, stiffness_nm_per_rad: 1.0 };
/// motor.set_load(Load { spring: Some(spring), ..forearm })?;
/// # Ok::<(), myactuator_host_std::sim::plant::ParameterError>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Load {
    /// Torque of the load on the shaft, the same at every angle and speed, N·m, up to ±10⁶: a weight on a
    /// drum, a hand that pushes.
    pub torque_nm: f64,
    /// Inertia, kg·m², 0 to 10⁶. That of the [`arm`](Self::arm)'s mass at its length is added.
    pub inertia_kg_m2: f64,
    /// A weight on a lever.
    pub arm: Option<Arm>,
    /// A spring that pulls to an angle from both sides.
    pub spring: Option<Spring>,
    /// Torque against the movement per speed, N·m·s/rad, 0 to 10⁶.
    pub damping_nm_s_per_rad: f64,
    /// The end stop at the largest angle.
    pub upper_stop: Option<EndStop>,
    /// The end stop at the smallest angle; not above the upper one.
    pub lower_stop: Option<EndStop>,
}

/// A weight on a lever. Its torque is m g l times the sine of the angle to where it hangs straight down.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Arm {
    /// Mass, kg, 0 to 10⁴.
    pub mass_kg: f64,
    /// Distance from the shaft to the centre of mass, m, 0 to 100.
    pub length_m: f64,
    /// Angle at which it hangs straight down, degrees, up to ±10⁹.
    pub down_deg: f64,
}

/// A spring that pulls to an angle from both sides, without losses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spring {
    /// Angle at which it is relaxed, degrees, up to ±10⁹.
    pub rest_deg: f64,
    /// Stiffness, N·m/rad, 0 to 10⁹; the step sets a limit of its own, see
    /// [`TooStiff`](super::ParameterError::TooStiff).
    pub stiffness_nm_per_rad: f64,
}

/// A stop that yields like a spring, and returns only a part of the energy.
///
/// On the way in it pushes with its stiffness, on the way out with restitution² times as much. So the loss is
/// the same at every speed, like that of rubber, and the shaft bounces back with the share
/// `restitution` of its speed (within 0.005, at the largest stiffness). At rest the stop pushes with any torque between
/// these two, so a load that leans on it stands still.
///
/// A stop may be fixed where the shaft leans on it, and the shaft may be put there, but no farther in than the motor
/// could press it. A shaft farther beyond would be flung out, so that is refused.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EndStop {
    /// Angle where the shaft touches it, degrees, up to ±10⁹.
    pub at_deg: f64,
    /// Stiffness, N·m/rad, 0 to 10⁹; the step sets a limit of its own, see
    /// [`TooStiff`](super::ParameterError::TooStiff).
    pub stiffness_nm_per_rad: f64,
    /// Speed after the contact divided by the speed before it: from 0, which takes all of it, to 1, a spring without
    /// losses.
    pub restitution: f64,
}

impl Load {
    /// A bare shaft.
    pub const NONE: Self = Self {
        torque_nm: 0.0,
        inertia_kg_m2: 0.0,
        arm: None,
        spring: None,
        damping_nm_s_per_rad: 0.0,
        upper_stop: None,
        lower_stop: None,
    };

    /// Its whole inertia, the arm's included, kg·m².
    pub fn total_inertia_kg_m2(&self) -> f64 {
        self.inertia_kg_m2 + self.arm.map_or(0.0, |arm| arm.mass_kg * arm.length_m * arm.length_m)
    }

    /// Torque of the load on a shaft at `angle_rad` that turns with `speed_rad_s`, N·m. At rest a stop pushes
    /// with any torque within limits; this returns the middle of them.
    pub fn torque_at(&self, angle_rad: f64, speed_rad_s: f64) -> f64 {
        let Reaction { torque_nm, taken_nm } = self.reaction_at(angle_rad);
        let direction = if speed_rad_s == 0.0 { 0.0 } else { speed_rad_s.signum() };
        torque_nm - taken_nm * direction - self.damping_nm_s_per_rad * speed_rad_s
    }

    /// What it does at this angle at any speed, without the damper.
    pub(super) fn reaction_at(&self, angle_rad: f64) -> Reaction {
        let mut torque_nm = self.torque_nm;
        if let Some(arm) = self.arm {
            torque_nm -= arm.weight_nm() * libm::sin(angle_rad - arm.down_deg.to_radians());
        }
        if let Some(spring) = self.spring {
            torque_nm -= spring.stiffness_nm_per_rad * (angle_rad - spring.rest_deg.to_radians());
        }
        let Some((stop, pressed_rad)) = self.touched_at(angle_rad) else {
            return Reaction { torque_nm, taken_nm: 0.0 };
        };
        // The difference between in and out acts against the movement, as dry friction does. So it is lost with any
        // step, and ends in exact rest.
        let stop_nm = stop.stiffness_nm_per_rad * pressed_rad;
        let given_back = stop.restitution * stop.restitution;
        Reaction {
            torque_nm: torque_nm - stop_nm * (1.0 + given_back) / 2.0,
            taken_nm: stop_nm.abs() * (1.0 - given_back) / 2.0,
        }
    }

    /// The stop that is touched, and how far it is pressed in, upwards or (negative) downwards.
    fn touched_at(&self, angle_rad: f64) -> Option<(EndStop, f64)> {
        let pressed_rad = |stop: EndStop| angle_rad - stop.at_deg.to_radians();
        let upper = self.upper_stop.map(|stop| (stop, pressed_rad(stop)));
        let lower = self.lower_stop.map(|stop| (stop, pressed_rad(stop)));
        upper.filter(|(_, rad)| *rad > 0.0).or(lower.filter(|(_, rad)| *rad < 0.0))
    }

    /// The allowed angles of a shaft that is to be at `angle_rad`, degrees: no deeper in a stop than a shaft gets that
    /// comes with this speed and inertia, pushed by this torque and by the rest of the load. Rounded outwards to 0.01°.
    pub(super) fn reach_deg(&self, angle_rad: f64, comes: Coming) -> RangeInclusive<f64> {
        let free = Self { upper_stop: None, lower_stop: None, ..*self };
        let torque_nm = comes.torque_nm + free.reaction_at(angle_rad).torque_nm.abs();
        let energy_j = 0.5 * comes.inertia_kg_m2 * comes.speed_rad_s * comes.speed_rad_s;
        let deepest_deg = |stop: EndStop| {
            // ½kx² = τx + E
            let stiffness = stop.stiffness_nm_per_rad;
            let root = (torque_nm * torque_nm + 2.0 * stiffness * energy_j).sqrt();
            ((torque_nm + root) / stiffness).to_degrees()
        };
        let ends = [
            self.lower_stop.map_or(-ANGLE_DEG, |stop| stop.at_deg - deepest_deg(stop)),
            self.upper_stop.map_or(ANGLE_DEG, |stop| stop.at_deg + deepest_deg(stop)),
        ];
        (ends[0].max(-ANGLE_DEG) * 100.0).floor() / 100.0
            ..=(ends[1].min(ANGLE_DEG) * 100.0).ceil() / 100.0
    }

    /// The stiffest part, and the largest stiffness of all parts together, N·m/rad.
    pub(super) fn stiffness(&self) -> (&'static str, f64) {
        let stop = |stop: Option<EndStop>| stop.map_or(0.0, |stop| stop.stiffness_nm_per_rad);
        let parts = [
            ("arm", self.arm.map_or(0.0, Arm::weight_nm)),
            ("spring", self.spring.map_or(0.0, |spring| spring.stiffness_nm_per_rad)),
            ("end stop", stop(self.upper_stop).max(stop(self.lower_stop))),
        ];
        let [arm, spring, end] = parts;
        let stiffest = if arm.1 > spring.1 { arm } else { spring };
        let stiffest = if stiffest.1 > end.1 { stiffest } else { end };
        (stiffest.0, parts.iter().map(|(_, stiffness)| stiffness).sum())
    }

    pub(super) fn check(&self) -> Result<(), ImpossibleFigure> {
        let angle = |name, given| check(name, "deg", -ANGLE_DEG..=ANGLE_DEG, given);
        let stiffness = |name, given| check(name, "N·m/rad", 0.0..=1e9, given);
        check("load torque", "N·m", -1e6..=1e6, self.torque_nm)?;
        check("load inertia", "kg·m²", 0.0..=1e6, self.inertia_kg_m2)?;
        check("load damping", "N·m·s/rad", 0.0..=1e6, self.damping_nm_s_per_rad)?;
        if let Some(arm) = self.arm {
            check("arm mass", "kg", 0.0..=1e4, arm.mass_kg)?;
            check("arm length", "m", 0.0..=100.0, arm.length_m)?;
            angle("angle at which the arm hangs down", arm.down_deg)?;
        }
        if let Some(spring) = self.spring {
            angle("angle of the relaxed spring", spring.rest_deg)?;
            stiffness("spring stiffness", spring.stiffness_nm_per_rad)?;
        }
        for stop in [self.upper_stop, self.lower_stop].into_iter().flatten() {
            angle("stop angle", stop.at_deg)?;
            stiffness("stop stiffness", stop.stiffness_nm_per_rad)?;
            check("stop restitution", "", 0.0..=1.0, stop.restitution)?;
        }
        if let (Some(lower), Some(upper)) = (self.lower_stop, self.upper_stop) {
            check("angle of the lower stop", "deg", -ANGLE_DEG..=upper.at_deg, lower.at_deg)?;
        }
        Ok(())
    }
}

impl Arm {
    /// Torque of the weight when it is stretched out level, N·m; as a spring about where it hangs, N·m/rad.
    fn weight_nm(self) -> f64 {
        self.mass_kg * GRAVITY_M_S2 * self.length_m
    }
}

/// The most with which a shaft hits a stop.
#[derive(Clone, Copy, Debug)]
pub(super) struct Coming {
    pub(super) inertia_kg_m2: f64,
    pub(super) speed_rad_s: f64,
    /// Of motor and hand, N·m.
    pub(super) torque_nm: f64,
}

/// What a load does at an angle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reaction {
    /// Torque on the shaft, N·m.
    pub(super) torque_nm: f64,
    /// Torque against any movement, N·m, like dry friction.
    pub(super) taken_nm: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    const ARM: Arm = Arm { mass_kg: 2.0, length_m: 0.5, down_deg: -90.0 };
    const STOP: EndStop = EndStop { at_deg: 30.0, stiffness_nm_per_rad: 100.0, restitution: 0.5 };

    #[test]
    fn impossible_loads_are_refused() {
        let spring = Spring { rest_deg: 0.0, stiffness_nm_per_rad: 1.0 };
        let arm = |arm| Load { arm: Some(arm), ..Load::NONE };
        let sprung = |spring| Load { spring: Some(spring), ..Load::NONE };
        let ended = |stop| Load { lower_stop: Some(stop), ..Load::NONE };
        for (load, name) in [
            (Load { inertia_kg_m2: -0.1, ..Load::NONE }, "load inertia"),
            (Load { torque_nm: f64::NAN, ..Load::NONE }, "load torque"),
            (Load { damping_nm_s_per_rad: -1.0, ..Load::NONE }, "load damping"),
            (arm(Arm { mass_kg: -1.0, ..ARM }), "arm mass"),
            (arm(Arm { length_m: f64::INFINITY, ..ARM }), "arm length"),
            (arm(Arm { down_deg: f64::NAN, ..ARM }), "angle at which the arm hangs down"),
            (sprung(Spring { rest_deg: f64::NAN, ..spring }), "angle of the relaxed spring"),
            (sprung(Spring { stiffness_nm_per_rad: -1.0, ..spring }), "spring stiffness"),
            (ended(EndStop { at_deg: 2e9, ..STOP }), "stop angle"),
            (ended(EndStop { stiffness_nm_per_rad: -1.0, ..STOP }), "stop stiffness"),
            (ended(EndStop { restitution: 1.01, ..STOP }), "stop restitution"),
            (ended(EndStop { restitution: f64::NAN, ..STOP }), "stop restitution"),
            (
                Load { upper_stop: Some(EndStop { at_deg: 29.0, ..STOP }), ..ended(STOP) },
                "angle of the lower stop",
            ),
        ] {
            assert_eq!(load.check().unwrap_err().name, name, "{load:?}");
        }
        assert_eq!(Load { upper_stop: Some(STOP), arm: Some(ARM), ..ended(STOP) }.check(), Ok(()));
    }

    #[test]
    fn parts_add_up() {
        let load = Load {
            torque_nm: 3.0,
            inertia_kg_m2: 0.25,
            arm: Some(ARM),
            spring: Some(Spring { rest_deg: 90.0, stiffness_nm_per_rad: 10.0 }),
            damping_nm_s_per_rad: 0.5,
            upper_stop: Some(STOP),
            lower_stop: None,
        };
        assert_eq!(load.total_inertia_kg_m2(), 0.25 + 2.0 * 0.25);
        let free = |degrees: f64| {
            3.0 - 2.0 * 9.80665 * 0.5 * (degrees + 90.0).to_radians().sin()
                - 10.0 * (degrees - 90.0).to_radians()
        };
        for (degrees, speed, expected) in [
            (20.0, 2.0, free(20.0) - 1.0),
            (20.0, 0.0, free(20.0)),
            // 1 rad in: 100 N·m inwards, a quarter of that outwards.
            (30.0 + 1_f64.to_degrees(), 2.0, free(30.0 + 1_f64.to_degrees()) - 1.0 - 100.0),
            (30.0 + 1_f64.to_degrees(), -2.0, free(30.0 + 1_f64.to_degrees()) + 1.0 - 25.0),
        ] {
            let found = load.torque_at(degrees.to_radians(), speed);
            assert!((found - expected).abs() < 1e-9, "{found} at {degrees}, not {expected}");
        }
        let mirrored = Load { lower_stop: Some(STOP), ..Load::NONE };
        assert!((mirrored.torque_at(STOP.at_deg.to_radians() - 1.0, -1.0) - 100.0).abs() < 1e-9);
        assert!((mirrored.torque_at(STOP.at_deg.to_radians() - 1.0, 1.0) - 25.0).abs() < 1e-9);
    }

    #[test]
    fn a_load_reads_back_as_it_is_written() {
        let load = Load { arm: Some(ARM), upper_stop: Some(STOP), ..Load::NONE };
        let text = toml::to_string(&load).unwrap();
        assert_eq!(toml::from_str(&text), Ok(load));
        assert!(toml::from_str::<Load>("[arm]\nmass_kg = 1\nlength_m = 1").is_err());
        assert!(toml::from_str::<Load>("weight = 1").is_err());
    }
}
