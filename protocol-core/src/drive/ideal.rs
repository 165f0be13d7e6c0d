//! The simplest plant: a body that turns, without gear play, heat or limits.

use super::plant::{Actuation, Measurement, Plant};
use crate::time::Duration;

/// A turning body: J dω/dt = KT · i − b · ω + load. It is for trying a drive and for tests; modelling a real motor is
/// the simulation's task.
///
/// It stays at 25 °C and 48 V. With the output off it turns freely; a locked brake stops it at once.
#[derive(Clone, Debug, PartialEq)]
pub struct IdealPlant {
    /// Inertia at the output shaft, kg·m².
    pub inertia_kg_m2: f64,
    /// Torque for a current of 1 A at the output shaft, N·m/A.
    pub torque_constant_nm_per_a: f64,
    /// Friction for a speed of 1 rad/s, N·m·s.
    pub friction_nm_s: f64,
    /// Torque from outside, N·m, positive for positive turning.
    pub load_nm: f64,
    /// Encoder pulses in a turn of the output shaft.
    pub pulses_per_turn: f64,
    /// Angle of the output shaft from the encoder's zero, rad.
    pub angle_rad: f64,
    /// Speed of the output shaft, rad/s.
    pub speed_rad_s: f64,
    /// What sensors beside the encoder measure. The angle, speed and currents in it are overwritten.
    pub sensors: Measurement,
}

impl Default for IdealPlant {
    /// Suits the default [`Parameters`](super::Parameters).
    fn default() -> Self {
        Self {
            inertia_kg_m2: 0.02,
            torque_constant_nm_per_a: 2.0,
            friction_nm_s: 0.05,
            load_nm: 0.0,
            pulses_per_turn: 98_304.0,
            angle_rad: 0.0,
            speed_rad_s: 0.0,
            sensors: Measurement {
                motor_temperature_c: 25.0,
                mos_temperature_c: 25.0,
                supply_voltage_v: 48.0,
                encoder_ok: true,
                ..Measurement::default()
            },
        }
    }
}

impl IdealPlant {
    /// Angle of the output shaft from the encoder's zero, degrees.
    pub fn angle_deg(&self) -> f64 {
        self.angle_rad.to_degrees()
    }

    /// Turns the shaft to an angle by hand, degrees from the encoder's zero.
    pub fn set_angle_deg(&mut self, angle_deg: f64) {
        self.angle_rad = angle_deg.to_radians();
    }
}

impl Plant for IdealPlant {
    fn advance(&mut self, actuation: &Actuation, span: Duration) -> Measurement {
        let seconds = span.as_micros() as f64 / 1e6;
        let current_a = if actuation.output_on { actuation.current_a } else { 0.0 };
        let before = self.speed_rad_s;
        if actuation.brake_released {
            // Friction implicitly, so that no step is too long for it.
            let drive_nm = self.torque_constant_nm_per_a * f64::from(current_a) + self.load_nm;
            self.speed_rad_s = (before + drive_nm / self.inertia_kg_m2 * seconds)
                / (1.0 + self.friction_nm_s / self.inertia_kg_m2 * seconds);
            self.angle_rad += (before + self.speed_rad_s) / 2.0 * seconds;
        } else {
            self.speed_rad_s = 0.0;
        }
        let pulses = self.angle_rad / core::f64::consts::TAU * self.pulses_per_turn;
        Measurement {
            encoder_pulses: crate::round::round_f64(pulses) as i64,
            speed_dps: self.speed_rad_s.to_degrees() as f32,
            current_a,
            phase_currents_a: [current_a, -current_a / 2.0, -current_a / 2.0],
            ..self.sensors
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn off_it_turns_freely_and_a_locked_brake_stops_it() {
        let mut plant =
            IdealPlant { speed_rad_s: 1.0, friction_nm_s: 0.0, ..IdealPlant::default() };
        let off = Actuation { current_a: 9.0, output_on: false, brake_released: true };
        let measured = plant.advance(&off, Duration::from_millis(1));
        assert_eq!((plant.speed_rad_s, measured.current_a), (1.0, 0.0));
        plant.advance(&Actuation::default(), Duration::from_millis(1));
        assert_eq!(plant.speed_rad_s, 0.0);
    }
}
