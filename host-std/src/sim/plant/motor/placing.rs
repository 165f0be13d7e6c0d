//! The shaft is placed from outside: by hand, as an earlier run has left it, or by mechanics that lead it.

use serde::{Deserialize, Serialize};

use super::SimulatedMotor;
use crate::sim::plant::figure::{ImpossibleFigure, check};
use crate::sim::plant::led::{Led, ShaftTorque};
use crate::sim::plant::load::{ANGLE_DEG, Coming, Load};
use crate::sim::plant::shaft::Shaft;

/// The places of both sides of the gear, degrees of the output shaft, turns included.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(in crate::sim) struct ShaftPlace {
    pub(in crate::sim) output_deg: f64,
    /// The motor's side, which may be anywhere in the play.
    pub(in crate::sim) motor_side_deg: f64,
}

impl SimulatedMotor {
    /// Whether a shaft with this load may be at this angle, degrees. A led shaft may be anywhere: nothing else moves
    /// it.
    pub(super) fn check_reach(&self, load: &Load, angle_deg: f64) -> Result<(), ImpossibleFigure> {
        if self.led.is_some() {
            return Ok(());
        }
        let rating = &self.parameters.rating;
        let comes = Coming {
            inertia_kg_m2: self.parameters.inertia_kg_m2() + load.total_inertia_kg_m2(),
            speed_rad_s: (rating.no_load_speed_rpm * 6.0).to_radians(),
            torque_nm: rating.peak_torque_nm + self.external_torque_nm.abs(),
        };
        let reach_deg = load.reach_deg(angle_deg.to_radians(), comes);
        check("angle of the shaft between its end stops", "deg", reach_deg, angle_deg).map(|_| ())
    }

    /// Puts the shaft at an angle, degrees, at rest, with the gear's teeth in the middle of their play. A shaft that is
    /// [led](Self::lead) stays there only until it is led elsewhere.
    ///
    /// # Errors
    /// [`ImpossibleFigure`] beyond ±10⁹ degrees, or farther beyond an [end stop](crate::sim::plant::EndStop) than the
    /// motor could press it in.
    pub fn set_output_angle_deg(&mut self, angle_deg: f64) -> Result<(), ImpossibleFigure> {
        let angle_rad =
            check("output angle", "deg", -ANGLE_DEG..=ANGLE_DEG, angle_deg)?.to_radians();
        self.check_reach(&self.load, angle_deg)?;
        self.shaft = Shaft::at(angle_rad, 0.0, self.coefficients.play.is_some());
        Ok(())
    }

    /// Puts both sides of the gear at the places that [`place`](Self::place) has returned, at rest.
    ///
    /// # Errors
    /// As [`set_output_angle_deg`](Self::set_output_angle_deg).
    pub(in crate::sim) fn put_back(&mut self, place: ShaftPlace) -> Result<(), ImpossibleFigure> {
        self.set_output_angle_deg(place.output_deg)?;
        let (output_rad, motor_rad) =
            (place.output_deg.to_radians(), place.motor_side_deg.to_radians());
        self.shaft = Shaft::at_rest(output_rad, motor_rad, self.coefficients.play.as_ref());
        Ok(())
    }

    /// The places of both sides of the gear.
    pub(in crate::sim) fn place(&self) -> ShaftPlace {
        ShaftPlace {
            output_deg: self.output_angle_deg(),
            motor_side_deg: self.motor_side_angle_deg(),
        }
    }

    /// Gives the shaft a speed, degrees per second.
    ///
    /// # Errors
    /// [`ImpossibleFigure`] beyond ±10⁶ degrees per second.
    pub fn set_output_speed_dps(&mut self, speed_dps: f64) -> Result<(), ImpossibleFigure> {
        let speed_dps = check("output speed", "deg/s", -1e6..=1e6, speed_dps)?;
        self.shaft.set_speed(speed_dps.to_radians());
        Ok(())
    }

    /// Leads the shaft: puts it at an angle, degrees, with a speed, degrees per second, which it keeps until it is led
    /// again. The load and the motor's own inertia no longer affect it; the caller has to account for that inertia
    /// ([`inertia_kg_m2`](crate::sim::plant::MotorParameters::inertia_kg_m2)). The gear of a led shaft has no play.
    ///
    /// # Errors
    /// [`ImpossibleFigure`] beyond ±10⁹ degrees or ±10⁶ degrees per second; the shaft goes on as before.
    pub fn lead(&mut self, angle_deg: f64, speed_dps: f64) -> Result<(), ImpossibleFigure> {
        let speed_dps = check("output speed", "deg/s", -1e6..=1e6, speed_dps)?;
        let angle_deg = check("output angle", "deg", -ANGLE_DEG..=ANGLE_DEG, angle_deg)?;
        self.shaft = Shaft::at(angle_deg.to_radians(), speed_dps.to_radians(), false);
        self.led = Some(Led::default());
        Ok(())
    }

    /// Whether something else [leads](Self::lead) the shaft.
    pub const fn is_led(&self) -> bool {
        self.led.is_some()
    }

    /// The mean of what has acted on the shaft since it was last [led](Self::lead); nothing for a shaft that is not
    /// led.
    pub fn acting(&self) -> ShaftTorque {
        self.led.map(Led::mean).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::plant::{EndStop, MotorParameters};

    /// Refuses a stop that the shaft could not have passed, or a shaft beyond such a stop. A stop on which the motor
    /// leans is allowed.
    #[test]
    fn a_shaft_is_not_put_far_beyond_a_stop() {
        let stop = |at_deg| EndStop { at_deg, stiffness_nm_per_rad: 2_000.0, restitution: 0.3 };
        let ended = Load { upper_stop: Some(stop(140.0)), ..Load::NONE };
        let mut motor =
            SimulatedMotor::new(MotorParameters::named("RMD-X6-P20-60").unwrap()).unwrap();
        motor.set_output_angle_deg(150.0).unwrap();
        let error = motor.set_load(ended).unwrap_err().to_string();
        assert!(error.starts_with("angle of the shaft between its end stops must be "), "{error}");
        assert!(error.ends_with(" deg, but 150 deg was given"), "{error}");
        assert_eq!(motor.load, Load::NONE);
        motor.set_output_angle_deg(139.0).unwrap();
        motor.set_load(Load { lower_stop: Some(stop(-5.0)), ..ended }).unwrap();
        assert!(motor.set_output_angle_deg(150.0).is_err());
        assert!(motor.set_output_angle_deg(-20.0).is_err());
        assert_eq!(motor.output_angle_deg(), 139.0);
        // 60 N·m lean 1.72° into it.
        motor.set_output_angle_deg(141.7).unwrap();
        motor.set_load(*motor.load()).unwrap();
        // 10° take 349 N·m, which a hand has.
        assert!(motor.set_output_angle_deg(150.0).is_err());
        motor.set_external_torque_nm(300.0).unwrap();
        motor.set_output_angle_deg(150.0).unwrap();
        motor.set_external_torque_nm(-300.0).unwrap();
        motor.set_output_angle_deg(150.0).unwrap();
        motor.set_external_torque_nm(0.0).unwrap();
        // A stop that yields at once is no stop.
        let soft = EndStop { stiffness_nm_per_rad: 0.0, ..stop(140.0) };
        motor.set_load(Load { upper_stop: Some(soft), ..Load::NONE }).unwrap();
        motor.set_output_angle_deg(1e6).unwrap();
    }
}
