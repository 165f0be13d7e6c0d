//! The motor as a [`Plant`].

mod placing;

use std::f64::consts::TAU;

use myactuator_protocol_core::drive::{Actuation, Measurement, Plant};
use myactuator_protocol_core::time::Duration;

use super::coefficients::Coefficients;
use super::encoder::Noise;
use super::figure::{ImpossibleFigure, check};
use super::led::Led;
use super::shaft::{Acting, Shaft};
use super::supply::{CommonPoint, Link, check_voltage};
use super::thermal::ThermalNode;
use super::{Load, MotorParameters, ParameterError, Supply};

pub(in crate::sim) use placing::ShaftPlace;

/// The step of the simulation. Time that is left over is carried to the next call.
pub const STEP: Duration = Duration::from_micros(100);

pub(super) const STEP_S: f64 = STEP.as_micros() as f64 * 1e-6;
const HALF_STEP_S: f64 = STEP_S / 2.0;

/// Temperature at which the phase resistance is given, °C; also the air's, until set.
const REFERENCE_C: f64 = 25.0;

/// Below this voltage at its input a drive's electronics draw nothing, V. Estimated for logic of 3.3 V behind a
/// regulator; no document has it.
pub(in crate::sim) const BROWN_OUT_V: f64 = 4.0;

const HALF_SQRT_3: f64 = 0.866_025_403_784_438_6;

/// Amplitude of a phase's back-EMF at which the diodes begin to conduct, as a share of the supply's voltage: 1/√3,
/// since between two phases there is √3 times as much.
const DIODES_SHARE: f64 = 0.577_350_269_189_625_8;

/// Limits of a [calm](SimulatedMotor::is_calm) motor: what it draws, and its back-EMF as a share of that at which the
/// diodes begin to conduct.
const CALM_A: f64 = 1.0;
const CALM_SHARE: f64 = 0.5;

fn check_temperature(celsius: f64) -> Result<f64, ImpossibleFigure> {
    check("temperature", "°C", -273.15..=10_000.0, celsius)
}

/// A motor with gearbox, load, brake, encoder and supply, in software.
///
/// One step of [`STEP`] is a leapfrog: half a step of movement, the torques there, the new speed,
/// the other half of the movement. It is symplectic and of second order, so a spring neither gains
/// nor loses energy over time. Viscous friction and the load's damper are solved exactly within the
/// step, however strong. Coulomb and static friction, the loss of the gear, the brake and the loss of an end stop
/// take speed away up to their limit and never reverse it: a shaft at rest stays
/// exactly at rest until the other torques exceed the limit.
///
/// The current follows the command at once, as far as the supply's voltage less the back-EMF
/// allows. Inductance is left out, since at most speeds there is enough voltage for a current loop to
/// set the current within a step or two. With the output off the motor turns freely until the back-EMF
/// between two phases is above the supply's voltage. Then the diodes of the output stage feed the supply
/// and brake the shaft. The diodes' own voltage drop is left out.
///
/// Everything that a test may do to a motor is a `set_*` or `force_*` here.
#[derive(Clone, Debug)]
pub struct SimulatedMotor {
    parameters: MotorParameters,
    coefficients: Coefficients,
    load: Load,

    shaft: Shaft,
    current_a: f64,
    supply_current_a: f64,
    link: Link,
    winding: ThermalNode,
    /// Between winding and air, if it has figures of its own.
    housing: Option<ThermalNode>,
    mos: ThermalNode,
    ambient_c: f64,
    carried_us: u64,
    noise: Noise,

    external_torque_nm: f64,
    /// What acted on the shaft since it was led last, while it is led.
    led: Option<Led>,
    /// Whether the brake is open, whatever the drive wants.
    forced_brake: Option<bool>,
    /// What the encoder shows since it failed: pulses, and speed in degrees per second.
    frozen: Option<(i64, f32)>,
}

impl SimulatedMotor {
    /// A motor at rest at 0°, without load, in air of 25 °C, on a [battery](Supply::battery) of its
    /// nominal voltage.
    ///
    /// # Errors
    /// [`ParameterError`] for impossible parameters.
    pub fn new(parameters: MotorParameters) -> Result<Self, ParameterError> {
        parameters.check()?;
        let coefficients = Coefficients::new(&parameters, &Load::NONE)?;
        let thermal = &parameters.thermal;
        let has_housing = thermal.housing_capacity_j_per_k > 0.0;
        let node =
            |capacity, resistance| ThermalNode::new(REFERENCE_C, capacity, resistance, STEP_S);
        Ok(Self {
            coefficients,
            load: Load::NONE,
            shaft: Shaft::at(0.0, 0.0, coefficients.play.is_some()),
            current_a: 0.0,
            supply_current_a: 0.0,
            link: Link::new(Supply::battery(parameters.rating.voltage_v), STEP_S),
            winding: node(
                thermal.winding_capacity_j_per_k,
                thermal.winding_resistance_k_per_w
                    - if has_housing { thermal.housing_resistance_k_per_w } else { 0.0 },
            ),
            housing: has_housing.then(|| {
                node(thermal.housing_capacity_j_per_k, thermal.housing_resistance_k_per_w)
            }),
            mos: node(thermal.mos_capacity_j_per_k, thermal.mos_resistance_k_per_w),
            ambient_c: REFERENCE_C,
            carried_us: 0,
            noise: Noise::new(0),
            external_torque_nm: 0.0,
            led: None,
            forced_brake: None,
            frozen: None,
            parameters,
        })
    }

    /// The figures of the motor.
    pub const fn parameters(&self) -> &MotorParameters {
        &self.parameters
    }

    /// Angle of the output shaft, degrees, turns included.
    pub fn output_angle_deg(&self) -> f64 {
        self.shaft.angle_rad.to_degrees()
    }

    /// True speed of the output shaft, degrees per second, whatever the encoder says.
    pub fn output_speed_dps(&self) -> f64 {
        self.shaft.speed_rad_s.to_degrees()
    }

    /// Angle of the motor's side of the gear, in degrees of the output shaft: up to half of the gear's backlash
    /// ahead of or behind [the output shaft](Self::output_angle_deg).
    pub fn motor_side_angle_deg(&self) -> f64 {
        self.shaft.motor_angle_rad().to_degrees()
    }

    /// Speed of the motor's side of the gear, in degrees of the output shaft per second.
    pub fn motor_side_speed_dps(&self) -> f64 {
        self.shaft.motor_speed_rad_s().to_degrees()
    }

    /// Inertia at the output shaft, load included, kg·m².
    pub fn inertia_kg_m2(&self) -> f64 {
        self.parameters.inertia_kg_m2() + self.load.total_inertia_kg_m2()
    }

    /// The load that is fixed to the shaft.
    pub const fn load(&self) -> &Load {
        &self.load
    }

    /// Fixes a load to the shaft, or [`Load::NONE`]; the speed stays.
    ///
    /// # Errors
    /// [`ParameterError`] for a load that is impossible or too stiff to simulate, or if the shaft is farther beyond one
    /// of its [end stops](super::EndStop) than the motor could press it in. Then the previous load stays.
    pub fn set_load(&mut self, load: Load) -> Result<(), ParameterError> {
        load.check()?;
        let coefficients = Coefficients::new(&self.parameters, &load)?;
        self.check_reach(&load, self.output_angle_deg())?;
        self.coefficients = coefficients;
        self.load = load;
        Ok(())
    }

    /// The supply of the motor.
    pub const fn supply(&self) -> &Supply {
        &self.link.supply
    }

    /// Connects another supply. The capacitor at the drive's input keeps its voltage at first, and follows. If the
    /// motor [shares](crate::sim::Fleet::supply) a supply, this is its cable to that: only the resistance, which is the
    /// same in both directions, and the capacitor change.
    ///
    /// # Errors
    /// [`ImpossibleFigure`] for an impossible figure.
    pub fn set_supply(&mut self, supply: Supply) -> Result<(), ImpossibleFigure> {
        supply.check()?;
        self.link.replace_supply(supply, STEP_S);
        Ok(())
    }

    /// From now on its source is a common point, behind a cable with its supply's resistance in both directions.
    pub(in crate::sim) fn join(&mut self, point: &CommonPoint) {
        self.link.join(point.voltage_v(), STEP_S);
    }

    /// What it has drawn from the common point since the last call, C.
    pub(in crate::sim) fn take_charge_c(&mut self) -> f64 {
        self.link.take_charge_c()
    }

    /// Sets the voltage of the common point.
    pub(in crate::sim) fn follow(&mut self, point: &CommonPoint) {
        self.link.follow(point.voltage_v());
    }

    /// Whether it draws little, nearly independent of the supply's voltage: its back-EMF is far below what makes diodes
    /// conduct or a voltage too low.
    pub(in crate::sim) fn is_calm(&self) -> bool {
        let emf_v = self.coefficients.emf_v_s_per_rad * self.shaft.motor_speed_rad_s();
        self.supply_current_a.abs() < CALM_A
            && emf_v.abs() <= CALM_SHARE * DIODES_SHARE * self.link.voltage_v()
    }

    /// Turns the shaft by hand: puts a torque on it besides the load's, N·m, until another is set.
    ///
    /// # Errors
    /// [`ImpossibleFigure`] beyond ±10⁶ N·m.
    pub fn set_external_torque_nm(&mut self, torque_nm: f64) -> Result<(), ImpossibleFigure> {
        self.external_torque_nm = check("external torque", "N·m", -1e6..=1e6, torque_nm)?;
        Ok(())
    }

    /// The torque of [a hand](Self::set_external_torque_nm) on the shaft, N·m.
    pub const fn external_torque_nm(&self) -> f64 {
        self.external_torque_nm
    }

    /// Makes the brake stick, open (`true`) or closed (`false`), whatever the drive does; with `None` it works again.
    pub fn force_brake(&mut self, open: Option<bool>) {
        self.forced_brake = open;
    }

    /// How [the brake sticks](Self::force_brake); `None` if it works.
    pub const fn forced_brake(&self) -> Option<bool> {
        self.forced_brake
    }

    /// Sets the seed of the encoder's [noise](super::EncoderParameters::noise_pulses); 0 at first.
    pub const fn set_noise_seed(&mut self, seed: u64) {
        self.noise.reseed(seed);
    }

    /// Temperature of the housing, °C; `None` for a motor whose file has no figures for it.
    pub fn housing_temperature_c(&self) -> Option<f64> {
        self.housing.as_ref().map(ThermalNode::temperature_c)
    }

    /// Sets the temperature of the air, °C.
    ///
    /// # Errors
    /// [`ImpossibleFigure`] below absolute zero.
    pub fn set_ambient_c(&mut self, ambient_c: f64) -> Result<(), ImpossibleFigure> {
        self.ambient_c = check_temperature(ambient_c)?;
        Ok(())
    }

    /// Holds the voltage at the drive's input, V, whatever is drawn; `None` lets it go.
    ///
    /// # Errors
    /// [`ImpossibleFigure`] for a voltage that no supply has.
    pub fn force_supply_voltage_v(
        &mut self,
        voltage_v: Option<f64>,
    ) -> Result<(), ImpossibleFigure> {
        self.link.held_v = voltage_v.map(check_voltage).transpose()?;
        Ok(())
    }

    /// Holds the temperature of the winding, °C; `None` lets it go on from there.
    ///
    /// # Errors
    /// [`ImpossibleFigure`] below absolute zero.
    pub fn force_motor_temperature_c(
        &mut self,
        held_c: Option<f64>,
    ) -> Result<(), ImpossibleFigure> {
        self.winding.hold_c(held_c.map(check_temperature).transpose()?);
        Ok(())
    }

    /// Holds the temperature of the output stage, °C; `None` lets it go on from there.
    ///
    /// # Errors
    /// [`ImpossibleFigure`] below absolute zero.
    pub fn force_mos_temperature_c(&mut self, held_c: Option<f64>) -> Result<(), ImpossibleFigure> {
        self.mos.hold_c(held_c.map(check_temperature).transpose()?);
        Ok(())
    }

    /// Breaks or mends the encoder. A broken encoder shows the pulses and the speed of the moment when it broke,
    /// and says that they are not valid. A mended one shows the true angle, since it is absolute.
    pub fn set_encoder_fault(&mut self, broken: bool) {
        self.frozen = broken.then(|| self.frozen.unwrap_or(self.seen_by_encoder()));
    }

    fn seen_by_encoder(&self) -> (i64, f32) {
        let mut pulses = self.shaft.motor_angle_rad() * self.coefficients.pulses_per_rad;
        let noise_pulses = self.parameters.encoder.noise_pulses;
        if noise_pulses > 0.0 {
            pulses += noise_pulses * self.noise.now();
        }
        (pulses.floor() as i64, self.motor_side_speed_dps() as f32)
    }

    /// Currents of the phases A, B and C, A. All of the current makes torque (the flux current is
    /// 0). The sum of the three is 0.
    fn phase_currents_a(&self) -> [f64; 3] {
        let amplitude = self.current_a * self.coefficients.amplitude_per_a;
        let turns = self.shaft.motor_angle_rad() * self.coefficients.electrical_turns_per_rad;
        let (sin, cos) = libm::sincos((turns - turns.floor()) * TAU);
        let a = -amplitude * sin;
        // sin(angle - 120°) without a second sine.
        let b = amplitude * (0.5 * sin + HALF_SQRT_3 * cos);
        [a, b, -(a + b)]
    }

    fn step(&mut self, command_a: f64, actuation: &Actuation) {
        let Coefficients { air_gap_nm_per_a, amplitude_per_a, emf_v_s_per_rad, play, .. } =
            self.coefficients;
        self.noise.step();
        self.shaft.drift(play.as_ref(), HALF_STEP_S);
        let speed_before = self.shaft.motor_speed_rad_s();

        let motor = &self.parameters.motor;
        let warmer_k = self.winding.temperature_c() - REFERENCE_C;
        // The resistance stays positive in the cold.
        let warmth = (1.0 + motor.resistance_coefficient_per_k * warmer_k).max(0.1);
        let winding_ohm = motor.phase_resistance_ohm * warmth;
        let mos_ohm = self.parameters.inverter.mos_resistance_ohm;
        let emf_v = emf_v_s_per_rad * speed_before;
        let ohm = amplitude_per_a * (winding_ohm + mos_ohm);
        self.current_a = if actuation.output_on {
            let limit_v = self.parameters.inverter.modulation_limit * self.link.voltage_v();
            let wanted_v = command_a * ohm + emf_v;
            if wanted_v.abs() <= limit_v {
                command_a
            } else {
                (limit_v.copysign(wanted_v) - emf_v) / ohm
            }
        } else {
            let limit_v = DIODES_SHARE * self.link.voltage_v();
            if emf_v.abs() <= limit_v { 0.0 } else { (limit_v.copysign(emf_v) - emf_v) / ohm }
        };
        let motor_nm = air_gap_nm_per_a * self.current_a;

        let brake_released = self.forced_brake.unwrap_or(actuation.brake_released);
        self.push(motor_nm, brake_released);
        let mean_speed = 0.5 * (speed_before + self.shaft.motor_speed_rad_s());
        self.shaft.drift(play.as_ref(), HALF_STEP_S);

        let amplitude_a = amplitude_per_a * self.current_a;
        let squared = 1.5 * amplitude_a * amplitude_a;
        let (winding_w, mos_w) = (squared * winding_ohm, squared * mos_ohm);
        let mechanical_w = motor_nm * mean_speed;
        let is_fed = self.link.voltage_v() >= BROWN_OUT_V;
        let idle_w = if is_fed { self.parameters.inverter.idle_power_w } else { 0.0 };
        self.supply_current_a = self.link.step(winding_w + mos_w + mechanical_w + idle_w);

        match &mut self.housing {
            Some(housing) => {
                let housing_c = housing.temperature_c();
                let passed_w = self.winding.step(winding_w, housing_c);
                housing.step(passed_w, self.ambient_c);
            }
            None => {
                self.winding.step(winding_w, self.ambient_c);
            }
        }
        self.mos.step(mos_w, self.ambient_c);
    }

    /// The speeds after a step under `motor_nm` in the air gap.
    fn push(&mut self, motor_nm: f64, brake_released: bool) {
        let dry_nm = self.dry_friction_nm(motor_nm, brake_released);
        let motor_nm = motor_nm + self.cogging_nm();
        if let Some(led) = &mut self.led {
            let viscous_nm = self.parameters.friction.viscous_nm_s_per_rad * self.shaft.speed_rad_s;
            led.add(motor_nm + self.external_torque_nm - viscous_nm, dry_nm);
            return;
        }
        let Coefficients { whole, play, .. } = &self.coefficients;
        let reaction = self.load.reaction_at(self.shaft.angle_rad);
        let motor = Acting { torque_nm: motor_nm, dry_nm };
        let torque_nm = self.external_torque_nm + reaction.torque_nm;
        let load = Acting { torque_nm, dry_nm: reaction.taken_nm };
        self.shaft.push(whole, play.as_ref(), motor, load);
    }

    /// The magnets cling to the iron's teeth; at 0° one rests on a tooth.
    fn cogging_nm(&self) -> f64 {
        let amplitude_nm = self.parameters.motor.cogging_nm;
        if amplitude_nm == 0.0 {
            return 0.0;
        }
        -amplitude_nm * libm::sin(self.shaft.motor_angle_rad() * self.coefficients.cogging_per_rad)
    }

    /// The most that friction, gear and brake take, at any speed.
    fn dry_friction_nm(&self, motor_nm: f64, brake_released: bool) -> f64 {
        let friction = &self.parameters.friction;
        let at_rest = self.shaft.motor_speed_rad_s() == 0.0;
        let dry_nm = if at_rest { friction.static_nm } else { friction.coulomb_nm };
        let brake_nm = if brake_released { 0.0 } else { self.parameters.brake.holding_torque_nm };
        dry_nm + brake_nm + self.coefficients.gear_loss * motor_nm.abs()
    }

    fn measure(&self) -> Measurement {
        let (encoder_pulses, speed_dps) = self.frozen.unwrap_or_else(|| self.seen_by_encoder());
        Measurement {
            encoder_pulses,
            speed_dps,
            current_a: self.current_a as f32,
            phase_currents_a: self.phase_currents_a().map(|current_a| current_a as f32),
            motor_temperature_c: self.winding.temperature_c() as f32,
            mos_temperature_c: self.mos.temperature_c() as f32,
            supply_voltage_v: self.link.voltage_v() as f32,
            supply_current_a: self.supply_current_a as f32,
            encoder_ok: self.frozen.is_none(),
        }
    }
}

impl Plant for SimulatedMotor {
    /// Makes whole steps of [`STEP`]. The rest of `span` is carried to the next call, so that the same time in other
    /// portions gives the same bits. A command that is not a number is 0 A.
    fn advance(&mut self, actuation: &Actuation, span: Duration) -> Measurement {
        let command_a =
            if actuation.current_a.is_nan() { 0.0 } else { f64::from(actuation.current_a) };
        let due_us = self.carried_us.saturating_add(span.as_micros());
        self.carried_us = due_us % STEP.as_micros();
        for _ in 0..due_us / STEP.as_micros() {
            self.step(command_a, actuation);
        }
        self.measure()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{EndStop, Spring};
    use super::*;

    const FREE: Actuation = Actuation { current_a: 0.0, output_on: false, brake_released: true };

    fn x6() -> SimulatedMotor {
        SimulatedMotor::new(MotorParameters::named("RMD-X6-P20-60").unwrap()).unwrap()
    }

    #[test]
    fn encoder_counts_motor_turns() {
        let mut motor = x6();
        motor.set_output_angle_deg(3600.0).unwrap();
        // 10 turns * 19.612 * 2^17 = 25 705 840.64
        assert_eq!(motor.advance(&FREE, Duration::ZERO).encoder_pulses, 25_705_840);
        motor.set_output_angle_deg(-0.000_001).unwrap();
        assert_eq!(motor.advance(&FREE, Duration::ZERO).encoder_pulses, -1);
    }

    #[test]
    fn broken_encoder_freezes_and_reports_that() {
        let mut motor = x6();
        motor.set_output_speed_dps(360.0).unwrap();
        let before = motor.advance(&FREE, Duration::from_millis(1));
        motor.set_encoder_fault(true);
        motor.set_encoder_fault(true);
        let broken = motor.advance(&FREE, Duration::from_millis(5));
        assert_eq!(
            (broken.encoder_ok, broken.encoder_pulses, broken.speed_dps),
            (false, before.encoder_pulses, before.speed_dps)
        );
        motor.set_encoder_fault(false);
        let mended = motor.advance(&FREE, Duration::ZERO);
        assert!(mended.encoder_ok && mended.encoder_pulses > before.encoder_pulses);
    }

    #[test]
    fn forced_temperatures_hold_and_then_go_on() {
        let mut motor = x6();
        motor.force_motor_temperature_c(Some(120.0)).unwrap();
        motor.force_mos_temperature_c(Some(90.0)).unwrap();
        let held = motor.advance(&FREE, Duration::from_secs(1));
        assert_eq!((held.motor_temperature_c, held.mos_temperature_c), (120.0, 90.0));
        motor.force_motor_temperature_c(None).unwrap();
        let free = motor.advance(&FREE, Duration::from_secs(1));
        assert!(free.motor_temperature_c < 120.0 && free.motor_temperature_c > 100.0);
        assert_eq!(free.mos_temperature_c, 90.0);
    }

    #[test]
    fn a_brake_sticks_open_or_closed() {
        let mut motor = x6();
        let on = Actuation { current_a: 1.0, output_on: true, brake_released: true };
        let locked = Actuation { brake_released: false, ..on };
        let mut turns = |stuck, actuation| {
            motor.force_brake(stuck);
            motor.advance(actuation, Duration::from_millis(20)).speed_dps != 0.0
        };
        assert!(!turns(None, &locked));
        assert!(turns(Some(true), &locked));
        assert!(!turns(Some(false), &on));
        assert!(turns(None, &on));
    }

    #[test]
    fn forced_voltage_holds() {
        let mut motor = x6();
        motor.force_supply_voltage_v(Some(12.0)).unwrap();
        let on = Actuation { current_a: 5.0, output_on: true, brake_released: true };
        assert_eq!(motor.advance(&on, Duration::from_millis(50)).supply_voltage_v, 12.0);
        motor.set_supply(Supply::battery(48.0)).unwrap();
        assert_eq!(motor.advance(&on, Duration::from_millis(50)).supply_voltage_v, 12.0);
        motor.force_supply_voltage_v(None).unwrap();
        assert!(motor.advance(&on, Duration::from_millis(50)).supply_voltage_v > 40.0);
        assert!(motor.force_supply_voltage_v(Some(-1.0)).is_err());
    }

    #[test]
    fn nan_and_infinity_move_nothing() {
        let mut motor = x6();
        let nan = Actuation { current_a: f32::NAN, output_on: true, brake_released: true };
        let measured = motor.advance(&nan, Duration::from_millis(10));
        assert_eq!((measured.current_a, measured.speed_dps), (0.0, 0.0));
        assert!(motor.set_external_torque_nm(f64::NAN).is_err());
        assert!(motor.set_output_angle_deg(f64::INFINITY).is_err());
    }

    /// A load may still be changed at the depth that the motor reaches at full speed and torque.
    #[test]
    fn a_load_is_changed_while_a_stop_is_pressed_in() {
        let stop = EndStop { at_deg: 5.0, stiffness_nm_per_rad: 500.0, restitution: 0.9 };
        let load = Load { inertia_kg_m2: 0.05, upper_stop: Some(stop), ..Load::NONE };
        let mut motor = x6();
        motor.set_load(load).unwrap();
        let no_load_dps = motor.parameters.rating.no_load_speed_rpm * 6.0;
        motor.set_output_speed_dps(no_load_dps).unwrap();
        let current_a = motor.parameters.rating.peak_current_a as f32;
        let on = Actuation { current_a, output_on: true, brake_released: true };
        let mut deepest_deg: f64 = 0.0;
        for _ in 0..1_000 {
            motor.advance(&on, STEP);
            deepest_deg = deepest_deg.max(motor.output_angle_deg() - 5.0);
            motor.set_load(load).unwrap();
        }
        assert!(deepest_deg > 5.0, "{deepest_deg}");
    }

    #[test]
    fn a_load_too_stiff_for_the_step_is_refused() {
        let mut motor = x6();
        let stop = EndStop { at_deg: 0.0, stiffness_nm_per_rad: 1e7, restitution: 0.5 };
        let spring = Spring { rest_deg: 0.0, stiffness_nm_per_rad: 1e7 };
        let ended = Load { upper_stop: Some(stop), ..Load::NONE };
        let sprung = Load { spring: Some(spring), ..Load::NONE };
        for (load, part) in [(ended, "end stop"), (sprung, "spring")] {
            let error = motor.set_load(load).unwrap_err().to_string();
            assert!(error.contains(&format!("make its {part} softer")), "{error}");
            assert_eq!(motor.load, Load::NONE);
            // The other remedy that the error names.
            motor.set_load(Load { inertia_kg_m2: 2.5, ..load }).unwrap();
            motor.set_load(Load::NONE).unwrap();
        }
    }
}
