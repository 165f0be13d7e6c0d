//! No energy is made and none is lost: a minute of hard motion of every model, kept book of from what anyone
//! can see of a motor, with the formulas of a textbook.

use std::f64::consts::TAU;

use myactuator_host_std::sim::plant::{
    Arm, EndStop, Load, MODELS, MotorParameters, STEP, SimulatedMotor, Spring, Supply,
};
use myactuator_protocol_core::drive::{Measurement, Plant};
use myactuator_protocol_core::time::Duration;

use super::plant_physics::{OFF, amps, angle, speed};

const STEP_S: f64 = STEP.as_micros() as f64 * 1e-6;
const GRAVITY_M_S2: f64 = 9.80665;

/// Where the energy went since the start, J. What is stored counts from the start, too.
#[derive(Debug, Default)]
struct Ledger {
    /// Given by the source.
    source: f64,
    // Taken for good.
    cable: f64,
    winding: f64,
    output_stage: f64,
    electronics: f64,
    gear: f64,
    friction: f64,
    damper: f64,
    stops: f64,
    // Stored.
    capacitor: f64,
    moving: f64,
    lifted: f64,
    spring: f64,
    pressed: f64,
}

impl Ledger {
    fn taken(&self) -> [f64; 8] {
        let Self {
            cable, winding, output_stage, electronics, gear, friction, damper, stops, ..
        } = *self;
        [cable, winding, output_stage, electronics, gear, friction, damper, stops]
    }

    fn stored(&self) -> f64 {
        self.capacitor + self.moving + self.lifted + self.spring + self.pressed
    }

    /// A step that began at `before` with `speed_before`, and how the motor is after it.
    fn book(
        &mut self,
        motor: &SimulatedMotor,
        supply: &Supply,
        before: &Measurement,
        speed_before: f64,
        now: &Measurement,
    ) {
        let MotorParameters { motor: winding, friction, gear, inverter, .. } = motor.parameters();
        let load = motor.load();
        let mean_speed = (speed_before + speed(motor)) / 2.0;
        let way = (mean_speed * STEP_S).abs();

        let [volts_before, volts] = [before, now].map(|m| f64::from(m.supply_voltage_v));
        let source_a = f64::from(now.supply_current_a)
            + supply.capacitance_f * (volts - volts_before) / STEP_S;
        self.source += supply.voltage_v * source_a * STEP_S;
        self.cable += supply.resistance_ohm * source_a * source_a * STEP_S;
        self.capacitor +=
            supply.capacitance_f * (volts * volts - volts_before * volts_before) / 2.0;

        // Currents are rms: 3 R i². Copper at the temperature that it had.
        let current_a = f64::from(now.current_a);
        let warmer_k = f64::from(before.motor_temperature_c) - 25.0;
        let ohm =
            winding.phase_resistance_ohm * (1.0 + winding.resistance_coefficient_per_k * warmer_k);
        self.winding += 3.0 * ohm * current_a * current_a * STEP_S;
        self.output_stage += 3.0 * inverter.mos_resistance_ohm * current_a * current_a * STEP_S;
        self.electronics += inverter.idle_power_w * STEP_S;

        let air_gap_nm = winding.torque_constant_nm_per_a / gear.efficiency * current_a.abs();
        self.gear += (1.0 - gear.efficiency) * air_gap_nm * way;
        let dry_nm = if speed_before == 0.0 { friction.static_nm } else { friction.coulomb_nm };
        self.friction += (dry_nm + friction.viscous_nm_s_per_rad * mean_speed.abs()) * way;
        self.damper += load.damping_nm_s_per_rad * mean_speed.abs() * way;

        let pressed = |angle_rad: f64| (angle_rad.abs() - END_DEG.to_radians()).max(0.0);
        let stop = load.upper_stop.unwrap();
        let given_back = stop.restitution * stop.restitution;
        let halfway = angle(motor) - speed(motor) * STEP_S / 2.0;
        // It pushes out with the share that it gives back of what it pushes in: half of the difference is against
        // any movement, like friction, and the mean is a spring.
        let stop_nm = stop.stiffness_nm_per_rad * pressed(halfway);
        self.stops += stop_nm * (1.0 - given_back) / 2.0 * way;
        self.pressed = stop.stiffness_nm_per_rad * (1.0 + given_back) / 2.0
            * pressed(angle(motor)).powi(2)
            / 2.0;

        self.moving = motor.inertia_kg_m2() * speed(motor).powi(2) / 2.0;
        let arm = load.arm.unwrap();
        self.lifted = arm.mass_kg * GRAVITY_M_S2 * arm.length_m * (1.0 - angle(motor).cos());
        self.spring = load.spring.unwrap().stiffness_nm_per_rad * angle(motor).powi(2) / 2.0;
    }
}

const END_DEG: f64 = 100.0;

/// A load with all that a load can have, for a motor of this torque and speed: an arm that takes a fifth of the
/// rated torque, a spring that takes as much at the ends, a damper that takes a tenth at rated speed, and stops.
fn load_for(model: &MotorParameters) -> Load {
    let torque_nm = model.rating.torque_nm;
    let rated_rad_s = model.rating.speed_rpm * TAU / 60.0;
    let inertia_kg_m2 = model.inertia_kg_m2();
    let length_m = 0.2;
    let mass_kg = 0.2 * torque_nm / (GRAVITY_M_S2 * length_m);
    let stop =
        |at_deg| EndStop { at_deg, stiffness_nm_per_rad: 100.0 * torque_nm, restitution: 0.6 };
    Load {
        torque_nm: 0.0,
        inertia_kg_m2,
        arm: Some(Arm { mass_kg, length_m, down_deg: 0.0 }),
        spring: Some(Spring {
            rest_deg: 0.0,
            stiffness_nm_per_rad: 0.2 * torque_nm / END_DEG.to_radians(),
        }),
        damping_nm_s_per_rad: 0.1 * torque_nm / rated_rad_s,
        upper_stop: Some(stop(END_DEG)),
        lower_stop: Some(stop(-END_DEG)),
    }
}

/// A minute of every model at 1.5 times its rated current, which changes its direction more and more often,
/// with the output off in between: into both stops, against the voltage's limit, feeding back. What the source
/// gave is what was taken and is stored, to 0.01 %.
#[test]
fn energy_is_conserved_over_a_minute_of_hard_motion() {
    for model in MODELS {
        let parameters = MotorParameters::named(model.name).unwrap();
        let supply = Supply::battery(parameters.rating.voltage_v);
        let hard_a = 1.5 * parameters.rating.current_a as f32;
        let load = load_for(&parameters);
        let mut motor = SimulatedMotor::new(parameters).unwrap();
        motor.set_load(load).unwrap();

        let mut ledger = Ledger::default();
        let mut before = motor.advance(&OFF, Duration::ZERO);
        let mut fed_back = false;
        for step in 0..600_000_u32 {
            let seconds = f64::from(step) * STEP_S;
            // From a change every two seconds to one every 0.1 s, and every fifth time off.
            let swings = seconds / 2.0 + seconds * seconds * seconds * 1.3e-3;
            let command = match swings as u32 % 5 {
                4 => OFF,
                even if even % 2 == 0 => amps(hard_a),
                _ => amps(-hard_a),
            };
            let speed_before = speed(&motor);
            let now = motor.advance(&command, STEP);
            ledger.book(&motor, &supply, &before, speed_before, &now);
            fed_back |= now.supply_current_a < -0.5;
            before = now;
        }

        let name = model.name;
        let taken = ledger.taken();
        let [gear, rest @ ..] = [4, 0, 1, 2, 3, 5, 6, 7].map(|place: usize| taken[place]);
        let smallest = 2e-4 * ledger.source;
        let lossless_gear = motor.parameters().gear.efficiency == 1.0;
        assert!(rest.iter().all(|part| *part > smallest), "{name}: all take part: {ledger:?}");
        assert!(gear > smallest || lossless_gear, "{name}: all take part: {ledger:?}");
        assert!(fed_back, "{name} feeds back");
        let error = (taken.iter().sum::<f64>() + ledger.stored()) / ledger.source - 1.0;
        assert!(error.abs() < 1e-4, "{name}: {error:+.6} of the energy: {ledger:?}");
    }
}
