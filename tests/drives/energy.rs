//! Energy is conserved: a minute of hard motion of every model, with accounts kept from outside, from the values that a
//! motor shows and the formulas of a textbook.

use std::f64::consts::TAU;

use myactuator_host_std::sim::plant::{
    Arm, EndStop, Load, MODELS, MotorParameters, STEP, SimulatedMotor, Spring, Supply,
};
use myactuator_protocol_core::drive::{Measurement, Plant};
use myactuator_protocol_core::time::Duration;
use myactuator_tests::values::GRAVITY_M_S2;

use super::plant_physics::{OFF, amps, angle, speed};

pub(super) const STEP_S: f64 = STEP.as_micros() as f64 * 1e-6;

/// Both sides of the gear's play, as seen from outside.
#[derive(Clone, Copy)]
struct Sides {
    angle: f64,
    motor_speed: f64,
    load_speed: f64,
    ahead: f64,
    half_play: f64,
    motor_inertia: f64,
    load_inertia: f64,
}

impl Sides {
    fn of(motor: &SimulatedMotor) -> Self {
        let parameters = motor.parameters();
        let output = parameters.gear.output_inertia_kg_m2;
        Self {
            angle: angle(motor),
            motor_speed: motor.motor_side_speed_dps().to_radians(),
            load_speed: speed(motor),
            ahead: motor.motor_side_angle_deg().to_radians() - angle(motor),
            half_play: (parameters.gear.backlash_arcmin / 60.0).to_radians() / 2.0,
            motor_inertia: parameters.inertia_kg_m2() - output,
            load_inertia: output + motor.load().total_inertia_kg_m2(),
        }
    }

    fn touch(&self) -> bool {
        self.motor_speed == self.load_speed && self.ahead.abs() > self.half_play - 1e-9
    }

    /// The energy lost when the sides become one, and their common speed.
    fn meet(&self) -> (f64, f64) {
        let Self { motor_inertia, load_inertia, motor_speed, load_speed, .. } = *self;
        let sum = motor_inertia + load_inertia;
        let differ = motor_speed - load_speed;
        let lost = motor_inertia * load_inertia / sum * differ * differ / 2.0;
        (lost, (motor_inertia * motor_speed + load_inertia * load_speed) / sum)
    }

    /// The sides half a step later, at these speeds until they meet, and the energy lost when they meet.
    fn half_a_step_later(mut self) -> (Self, f64) {
        let span = STEP_S / 2.0;
        let closing = self.motor_speed - self.load_speed;
        let ahead = self.ahead + closing * span;
        if ahead.abs() <= self.half_play + 1e-12 {
            self.ahead = ahead;
            self.angle += self.load_speed * span;
            return (self, 0.0);
        }
        let side = self.half_play.copysign(ahead);
        let until = (side - self.ahead) / closing;
        let (lost, both) = self.meet();
        self.angle += self.load_speed * until + both * (span - until);
        (self.motor_speed, self.load_speed, self.ahead) = (both, both, side);
        (self, lost)
    }
}

/// Where the energy went since the start, J. Stored energy counts from the start, too.
#[derive(Debug, Default)]
struct Ledger {
    /// From the source.
    source: f64,
    // Lost.
    cable: f64,
    winding: f64,
    output_stage: f64,
    electronics: f64,
    gear: f64,
    friction: f64,
    damper: f64,
    stops: f64,
    teeth: f64,
    // Stored.
    capacitor: f64,
    moving: f64,
    lifted: f64,
    spring: f64,
    pressed: f64,
}

impl Ledger {
    fn taken(&self) -> [f64; 9] {
        let Self {
            cable,
            winding,
            output_stage,
            electronics,
            gear,
            friction,
            damper,
            stops,
            teeth,
            ..
        } = *self;
        [cable, winding, output_stage, electronics, gear, friction, damper, stops, teeth]
    }

    fn stored(&self) -> f64 {
        self.capacitor + self.moving + self.lifted + self.spring + self.pressed
    }

    /// Books a step that began at `before` with these sides. `motor` and `now` are after it.
    fn book(
        &mut self,
        motor: &SimulatedMotor,
        supply: &Supply,
        before: &Measurement,
        sides: Sides,
        now: &Measurement,
    ) {
        let MotorParameters { motor: winding, friction, gear, inverter, .. } = motor.parameters();
        let load = motor.load();
        let arm = load.arm.unwrap();
        let weight_nm = arm.mass_kg * GRAVITY_M_S2 * arm.length_m;
        let spring_nm_per_rad = load.spring.unwrap().stiffness_nm_per_rad;
        let pressed = |angle_rad: f64| (angle_rad.abs() - END_DEG.to_radians()).max(0.0);
        let stop = load.upper_stop.unwrap();
        let given_back = stop.restitution * stop.restitution;

        // Half a step of movement, the torques there, the other half of the movement.
        let (halfway, lost) = sides.half_a_step_later();
        self.teeth += lost;
        let stop_nm = stop.stiffness_nm_per_rad * pressed(halfway.angle);
        let mut pushed = Sides::of(motor);
        if pushed.touch() && !halfway.touch() {
            // They have met since. Before that its own torques accelerated the load, and the motor had the rest.
            let (_, both) = pushed.meet();
            let stops_share =
                if halfway.angle * halfway.load_speed > 0.0 { 1.0 } else { given_back };
            let torque_nm = -weight_nm * halfway.angle.sin()
                - spring_nm_per_rad * halfway.angle
                - stop_nm * stops_share * halfway.angle.signum()
                - load.damping_nm_s_per_rad * halfway.load_speed;
            pushed.load_speed = halfway.load_speed + torque_nm * STEP_S / pushed.load_inertia;
            pushed.motor_speed =
                both + (both - pushed.load_speed) * pushed.load_inertia / pushed.motor_inertia;
            self.teeth += pushed.meet().0;
        }
        let mean_speed = (halfway.motor_speed + pushed.motor_speed) / 2.0;
        let way = (mean_speed * STEP_S).abs();
        let load_speed = (halfway.load_speed + pushed.load_speed) / 2.0;
        let load_way = (load_speed * STEP_S).abs();

        let [volts_before, volts] = [before, now].map(|m| f64::from(m.supply_voltage_v));
        let source_a = f64::from(now.supply_current_a)
            + supply.capacitance_f * (volts - volts_before) / STEP_S;
        self.source += supply.voltage_v * source_a * STEP_S;
        self.cable += supply.resistance_ohm * source_a * source_a * STEP_S;
        self.capacitor +=
            supply.capacitance_f * (volts * volts - volts_before * volts_before) / 2.0;

        // Currents are rms: 3 R i². Copper has the temperature of before.
        let current_a = f64::from(now.current_a);
        let warmer_k = f64::from(before.motor_temperature_c) - 25.0;
        let ohm =
            winding.phase_resistance_ohm * (1.0 + winding.resistance_coefficient_per_k * warmer_k);
        self.winding += 3.0 * ohm * current_a * current_a * STEP_S;
        self.output_stage += 3.0 * inverter.mos_resistance_ohm * current_a * current_a * STEP_S;
        self.electronics += inverter.idle_power_w * STEP_S;

        let air_gap_nm = winding.torque_constant_nm_per_a / gear.efficiency * current_a.abs();
        self.gear += (1.0 - gear.efficiency) * air_gap_nm * way;
        let dry_nm =
            if halfway.motor_speed == 0.0 { friction.static_nm } else { friction.coulomb_nm };
        self.friction += (dry_nm + friction.viscous_nm_s_per_rad * mean_speed.abs()) * way;
        self.damper += load.damping_nm_s_per_rad * load_speed.abs() * load_way;

        // On the way out a stop pushes with the share that it gives back. The mean of both pushes is a spring. Half of
        // their difference acts against any movement, like friction.
        self.stops += stop_nm * (1.0 - given_back) / 2.0 * load_way;
        self.pressed = stop.stiffness_nm_per_rad * (1.0 + given_back) / 2.0
            * pressed(angle(motor)).powi(2)
            / 2.0;

        let Sides { motor_inertia, load_inertia, motor_speed, load_speed, .. } = Sides::of(motor);
        self.moving =
            motor_inertia * motor_speed.powi(2) / 2.0 + load_inertia * load_speed.powi(2) / 2.0;
        self.lifted = weight_nm * (1.0 - angle(motor).cos());
        self.spring = spring_nm_per_rad * angle(motor).powi(2) / 2.0;
    }
}

const END_DEG: f64 = 100.0;

/// A load with everything that a load can have: an arm that takes a fifth of the rated torque, a spring that takes as
/// much at the ends, a damper that takes a tenth at rated speed, and stops.
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

/// Every model runs a minute at 1.5 times its rated current, which reverses more and more often, with the output off in
/// between: into both stops, against the voltage limit, feeding back. The energy from the source equals the energy lost
/// and stored, to 0.01 %.
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
            let sides = Sides::of(&motor);
            let now = motor.advance(&command, STEP);
            ledger.book(&motor, &supply, &before, sides, &now);
            fed_back |= now.supply_current_a < -0.5;
            before = now;
        }

        let name = model.name;
        let taken = ledger.taken();
        let [gear, teeth, rest @ ..] = [4, 8, 0, 1, 2, 3, 5, 6, 7].map(|place: usize| taken[place]);
        let smallest = 2e-4 * ledger.source;
        let has_play = motor.parameters().gear.backlash_arcmin > 0.0;
        assert_eq!(teeth > smallest, has_play, "{name}: all take part: {ledger:?}");
        let lossless_gear = motor.parameters().gear.efficiency == 1.0;
        assert!(rest.iter().all(|part| *part > smallest), "{name}: all take part: {ledger:?}");
        assert!(gear > smallest || lossless_gear, "{name}: all take part: {ledger:?}");
        assert!(fed_back, "{name} feeds back");
        let error = (taken.iter().sum::<f64>() + ledger.stored()) / ledger.source - 1.0;
        assert!(error.abs() < 1e-4, "{name}: {error:+.6} of the energy: {ledger:?}");
    }
}
