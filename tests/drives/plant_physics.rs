//! The simulated motor compared with mechanics and circuits worked out by hand.
//!
//! Every expected value is a closed form in the parameters of the test. None is taken from a run.

use myactuator_host_std::sim::plant::{
    BrakeResistor, CurrentScale, EndStop, Load, MotorParameters, SimulatedMotor, Supply,
};
use myactuator_protocol_core::drive::{Actuation, Measurement, Plant};
use myactuator_protocol_core::time::Duration;

pub(super) const MS: Duration = Duration::from_millis(1);
pub(super) const OFF: Actuation =
    Actuation { current_a: 0.0, output_on: false, brake_released: true };
const BRAKED: Actuation = Actuation { brake_released: false, ..OFF };

pub(super) fn amps(current_a: f32) -> Actuation {
    Actuation { current_a, output_on: true, brake_released: true }
}

/// A motor of round figures: 0.1 kg·m² at the output, 2 N·m/A, no losses except in copper.
pub(super) fn ideal() -> MotorParameters {
    let mut p = MotorParameters::named("RMD-X8-PRO").unwrap();
    p.gear.ratio = 10.0;
    p.gear.efficiency = 1.0;
    p.gear.output_inertia_kg_m2 = 0.06;
    p.motor.rotor_inertia_kg_m2 = 4e-4; // 0.04 kg·m² at the output
    p.motor.torque_constant_nm_per_a = 2.0;
    p.motor.phase_resistance_ohm = 0.5;
    p.motor.resistance_coefficient_per_k = 0.0;
    p.motor.current_scale = CurrentScale::Amplitude;
    p.friction.static_nm = 0.0;
    p.friction.coulomb_nm = 0.0;
    p.friction.viscous_nm_s_per_rad = 0.0;
    p.inverter.mos_resistance_ohm = 0.0;
    p.inverter.modulation_limit = 0.5;
    p.inverter.idle_power_w = 0.0;
    p
}
pub(super) const INERTIA: f64 = 0.1;

pub(super) fn motor(parameters: MotorParameters) -> SimulatedMotor {
    SimulatedMotor::new(parameters).unwrap()
}

pub(super) fn loaded(parameters: MotorParameters, load: Load) -> SimulatedMotor {
    let mut m = motor(parameters);
    m.set_load(load).unwrap();
    m
}

/// A motor with a load so heavy that no torque moves it.
pub(super) fn held(parameters: MotorParameters) -> SimulatedMotor {
    loaded(parameters, Load { inertia_kg_m2: 1e6, ..Load::NONE })
}

pub(super) fn with_friction(static_nm: f64, coulomb_nm: f64, viscous: f64) -> MotorParameters {
    let mut p = ideal();
    p.friction.static_nm = static_nm;
    p.friction.coulomb_nm = coulomb_nm;
    p.friction.viscous_nm_s_per_rad = viscous;
    p
}

pub(super) fn speed(motor: &SimulatedMotor) -> f64 {
    motor.output_speed_dps().to_radians()
}

pub(super) fn angle(motor: &SimulatedMotor) -> f64 {
    motor.output_angle_deg().to_radians()
}

#[track_caller]
pub(super) fn close(found: f64, expected: f64, share: f64) {
    let error = (found - expected).abs();
    assert!(error <= share * expected.abs(), "{found} is not {expected} within {share}");
}

// Mechanics

/// ω = τ t / J: 4 N·m for 0.2 s on 0.1 kg·m² are 8 rad/s, and the angle is half of that times t. Without torque the
/// momentum stays.
#[test]
fn momentum_is_torque_times_time_without_friction() {
    let mut m = motor(ideal());
    m.advance(&amps(2.0), MS.times(200));
    close(speed(&m), 8.0, 1e-9);
    close(angle(&m), 0.8, 1e-3);
    let (before_dps, before_deg) = (m.output_speed_dps(), m.output_angle_deg());
    m.advance(&OFF, Duration::from_secs(10));
    close(m.output_speed_dps(), before_dps, 1e-12);
    close(m.output_angle_deg(), before_deg + 10.0 * before_dps, 1e-9);
    // The opposite torque for the same time takes it all away.
    m.advance(&amps(-2.0), MS.times(200));
    assert!(speed(&m).abs() < 1e-9);
}

/// ω = τ t / J for 0.2 s:
///
/// - The rotor counts with the square of the gear ratio, the load as it is.
/// - With an efficiency of 0.8 the air gap's 5 N·m are 4 N·m at the output, which accelerate.
/// - A load's torque acts like a weight on a drum.
#[test]
fn load_and_gear_take_their_share() {
    let mut lossy = ideal();
    lossy.gear.efficiency = 0.8;
    let heavy = Load { inertia_kg_m2: 0.3, ..Load::NONE };
    let weight = Load { torque_nm: -3.0, ..Load::NONE };
    for (parameters, load, torque_nm, inertia) in [
        (ideal(), heavy, 4.0, 0.4),
        (lossy, Load::NONE, 4.0, INERTIA),
        (ideal(), weight, 4.0 - 3.0, INERTIA),
    ] {
        let mut m = loaded(parameters, load);
        close(m.inertia_kg_m2(), inertia, 1e-12);
        m.advance(&amps(2.0), MS.times(200));
        close(speed(&m), torque_nm * 0.2 / inertia, 1e-9);
    }
}

/// ω(t) = τ/b (1 - e^(-b t/J)).
#[test]
fn constant_torque_against_viscous_friction() {
    let (torque, viscous) = (1.0, 0.5);
    let mut m = motor(with_friction(0.0, 0.0, viscous));
    m.set_external_torque_nm(torque).unwrap();
    for ms in 1..=1000 {
        m.advance(&OFF, MS);
        let t = f64::from(ms) * 1e-3;
        let expected = torque / viscous * (1.0 - (-viscous * t / INERTIA).exp());
        close(speed(&m), expected, 1e-9);
    }
    // θ(t) = τ/b (t - J/b (1 - e^(-b t/J)))
    let expected = 2.0 * (1.0 - 0.2 * (1.0 - (-5.0_f64).exp()));
    close(angle(&m), expected, 1e-5);
}

/// Coulomb friction alone: a shaft with ω stops after J ω / τ and stays there.
#[test]
fn coulomb_friction_stops_the_shaft_after_a_finite_time() {
    let mut m = motor(with_friction(0.5, 0.5, 0.0));
    m.set_output_speed_dps(5_f64.to_degrees()).unwrap();
    // 0.1 * 5 / 0.5 = 1 s; angle ω²J/(2τ) = 2.5 rad
    m.advance(&OFF, MS.times(999));
    assert!(speed(&m) > 0.0);
    m.advance(&OFF, MS.times(2));
    assert_eq!(speed(&m), 0.0);
    close(angle(&m), 2.5, 1e-4);
    let at_rest = m.output_angle_deg();
    m.advance(&OFF, Duration::from_secs(60));
    assert_eq!(m.output_angle_deg(), at_rest);
}

/// Below static friction nothing creeps or chatters, even if the torque changes sign every step. Above it only Coulomb
/// friction acts on the moving shaft.
#[test]
fn static_friction_holds_up_to_its_limit() {
    let mut m = motor(with_friction(1.0, 0.6, 0.0));
    for torque in [0.999, -0.999] {
        m.set_external_torque_nm(torque).unwrap();
        m.advance(&OFF, Duration::from_secs(30));
        assert_eq!((m.output_angle_deg(), m.output_speed_dps()), (0.0, 0.0));
    }
    for step in 0..10_000 {
        m.set_external_torque_nm(if step % 2 == 0 { 0.9 } else { -0.9 }).unwrap();
        let measured = m.advance(&OFF, Duration::from_micros(100));
        assert_eq!((measured.speed_dps, measured.encoder_pulses), (0.0, 0));
    }
    m.set_external_torque_nm(1.001).unwrap();
    m.advance(&OFF, MS.times(500));
    // One step with 1.001 - 1.0 N·m, then 1.001 - 0.6 N·m: 0.401 * 0.5 / 0.1
    close(speed(&m), 2.005, 1e-3);
}

/// Below its limit the brake holds without giving way. Above it the brake slips.
#[test]
fn the_brake_holds_and_slips_at_its_limit() {
    let mut p = ideal();
    p.brake.holding_torque_nm = 5.0;
    let mut m = motor(p);
    m.set_external_torque_nm(4.99).unwrap();
    m.advance(&BRAKED, Duration::from_secs(10));
    assert_eq!(m.output_angle_deg(), 0.0);
    m.set_external_torque_nm(6.0).unwrap();
    m.advance(&BRAKED, MS.times(100));
    close(speed(&m), (6.0 - 5.0) * 0.1 / INERTIA, 1e-9);
    // It stops a turning shaft: 1 rad/s against 5 N·m takes 20 ms.
    m.set_external_torque_nm(0.0).unwrap();
    m.advance(&BRAKED, MS.times(19));
    assert!(speed(&m) > 0.0);
    m.advance(&BRAKED, MS.times(2));
    assert_eq!(speed(&m), 0.0);
    // The motor cannot turn it either.
    m.advance(&Actuation { brake_released: false, ..amps(2.4) }, MS.times(100));
    assert_eq!(speed(&m), 0.0);
}

// Electrics

/// A phase has at most half of 48 V. Its back-EMF has the amplitude 2/3 Kt ω (three half waves of power make Kt i ω).
/// So the motor ends at ω = 24 V / (2/3 * 2 N·m/A) = 18 rad/s, whatever current is commanded. On the voltage limit the
/// current is (V - EMF) / R, and the speed rises exponentially with the time constant J R / (2/3 Kt²) = 0.1 * 0.5 /
/// (8/3) = 18.75 ms.
#[test]
fn back_emf_limits_the_no_load_speed() {
    for asked in [1.0, 50.0, 1000.0] {
        let mut m = motor(ideal());
        m.force_supply_voltage_v(Some(48.0)).unwrap();
        let start = m.advance(&amps(asked), Duration::from_micros(100));
        close(f64::from(start.current_a), f64::from(asked).min(24.0 / 0.5), 1e-6);
        if asked > 48.0 {
            m.advance(&amps(asked), Duration::from_micros(18_650));
            close(speed(&m), 18.0 * (1.0 - (-1.0_f64).exp()), 0.005);
        }
        m.advance(&amps(asked), Duration::from_secs(10));
        close(speed(&m), 18.0, 1e-6);
        m.advance(&amps(-asked), Duration::from_secs(20));
        close(speed(&m), -18.0, 1e-6);
    }
}

/// A stalled motor takes 3/2 R i² from the supply, plus the electronics' own power. An ampere (rms) is √2 A at the
/// peak, which doubles the loss. Copper at 125 °C has 1 + 0.00393 * 100 times its resistance at 25 °C.
#[test]
fn a_stalled_motor_draws_copper_loss() {
    let mut lossy = ideal();
    lossy.inverter.idle_power_w = 6.0;
    lossy.inverter.mos_resistance_ohm = 0.1;
    let mut rms = ideal();
    rms.motor.current_scale = CurrentScale::Rms;
    let mut hot = ideal();
    hot.motor.resistance_coefficient_per_k = 0.00393;
    for (parameters, celsius, watts, amplitude_a) in [
        (lossy, 25.0, 1.5 * 0.6 * 16.0 + 6.0, 4.0),
        (rms, 25.0, 3.0 * 0.5 * 16.0, 4.0 * 2_f64.sqrt()),
        (hot, 125.0, 1.5 * 0.5 * 1.393 * 16.0, 4.0),
    ] {
        let mut m = held(parameters);
        m.force_supply_voltage_v(Some(48.0)).unwrap();
        m.force_motor_temperature_c(Some(celsius)).unwrap();
        let measured = m.advance(&amps(4.0), MS.times(10));
        close(f64::from(measured.supply_current_a), watts / 48.0, 1e-6);
        close(amplitude(&measured), amplitude_a, 1e-6);
    }
}

/// Amplitude of three sine currents 120° apart: √(2/3 Σ i²).
fn amplitude(measured: &Measurement) -> f64 {
    let squares: f64 = measured.phase_currents_a.iter().map(|&i| f64::from(i).powi(2)).sum();
    (squares * 2.0 / 3.0).sqrt()
}

/// At every angle the phases sum to 0 and have the amplitude of the torque current. Over one electrical turn each goes
/// once through its whole range.
#[test]
fn phase_currents_are_three_sines_that_sum_to_zero() {
    let p = ideal();
    let electrical_turn_deg = 360.0 / (p.gear.ratio * f64::from(p.motor.pole_pairs));
    let mut m = held(p);
    let (mut highest, mut lowest) = ([f32::MIN; 3], [f32::MAX; 3]);
    for step in 0..360 {
        m.set_output_angle_deg(electrical_turn_deg * f64::from(step) / 360.0).unwrap();
        let measured = m.advance(&amps(3.0), Duration::from_micros(100));
        let phases = measured.phase_currents_a;
        assert!(phases.iter().sum::<f32>().abs() < 1e-5, "{phases:?}");
        close(amplitude(&measured), 3.0, 1e-5);
        for (phase, &current) in phases.iter().enumerate() {
            highest[phase] = highest[phase].max(current);
            lowest[phase] = lowest[phase].min(current);
        }
    }
    for phase in 0..3 {
        close(f64::from(highest[phase]), 3.0, 1e-3);
        close(f64::from(lowest[phase]), -3.0, 1e-3);
    }
    // All current is in the quadrature axis, so phase A is 0 at electrical angle 0 and at its negative peak a quarter
    // of an electrical turn later.
    m.set_output_angle_deg(0.0).unwrap();
    let phases = m.advance(&amps(3.0), Duration::from_micros(100)).phase_currents_a;
    assert!(phases[0].abs() < 1e-3, "{phases:?}");
    m.set_output_angle_deg(electrical_turn_deg / 4.0).unwrap();
    let phases = m.advance(&amps(3.0), Duration::from_micros(100)).phase_currents_a;
    close(f64::from(phases[0]), -3.0, 1e-4);
}

/// Constant power P through resistance R: V = (V0 + √(V0² - 4 R P)) / 2. A turning motor that brakes with little
/// current pushes Kt i ω less copper loss into the supply. The supply's voltage rises by the same law, with the
/// feedback resistance.
#[test]
fn the_supply_sags_under_load_and_rises_with_feedback() {
    let weak = Supply { resistance_ohm: 1.0, ..Supply::battery(48.0) };
    let bench = Supply { feedback_resistance_ohm: 20.0, ..Supply::battery(48.0) };
    for (supply, current, rad_per_s, resistance, power) in [
        (weak, 16.0, 0.0, 1.0, 1.5 * 0.5 * 16.0 * 16.0),
        (bench, -2.0, 10.0, 20.0, 1.5 * 0.5 * 4.0 - 2.0 * 2.0 * 10.0),
    ] {
        let mut m = held(ideal());
        m.set_supply(supply).unwrap();
        m.set_output_speed_dps(f64::to_degrees(rad_per_s)).unwrap();
        let measured = m.advance(&amps(current), MS.times(500));
        let volts = (48.0 + (48.0_f64 * 48.0 - 4.0 * resistance * power).sqrt()) / 2.0;
        assert!(if power > 0.0 { volts < 45.0 } else { volts > 60.0 });
        close(f64::from(measured.supply_voltage_v), volts, 1e-5);
        close(f64::from(measured.supply_current_a), power / volts, 1e-5);
    }
}

/// With the output off the diodes conduct once the back-EMF between two phases, √3 * 4/3 ω, exceeds 48 V, at 20.8
/// rad/s. At 30 rad/s a phase has 40 V, of which the supply takes 48/√3 V. The rest drives a current through 0.5 Ω,
/// which brakes with 2 N·m/A. The power that copper does not lose goes into the supply.
#[test]
fn a_motor_that_is_turned_fast_feeds_back_through_its_diodes() {
    for (rad_per_s, current_a) in [(20.0, 0.0), (30.0, -(40.0 - 48.0 / 3_f64.sqrt()) / 0.5)] {
        for direction in [1.0, -1.0] {
            let mut m = held(ideal());
            m.force_supply_voltage_v(Some(48.0)).unwrap();
            m.set_output_speed_dps(f64::to_degrees(direction * rad_per_s)).unwrap();
            let before = speed(&m);
            let measured = m.advance(&OFF, MS.times(10));
            let expected_a = direction * current_a;
            assert!((f64::from(measured.current_a) - expected_a).abs() < 1e-4, "{measured:?}");
            let torque_nm = (speed(&m) - before) * m.inertia_kg_m2() / 0.01;
            assert!((torque_nm - 2.0 * expected_a).abs() < 1e-3, "{torque_nm}");
            let input_w = 1.5 * 0.5 * current_a * current_a + 2.0 * current_a * rad_per_s;
            let input_a = f64::from(measured.supply_current_a);
            assert!((input_a - input_w / 48.0).abs() < 1e-4, "{input_a}");
        }
    }
}

/// A bench supply takes back little (20 Ω). A brake resistor of 10 Ω goes on above 54 V and off below 52 V.
///
/// - 117 W of feedback are less than the resistor burns: the voltage swings between these, give or take a step.
/// - Of 900 W it burns as much as it can: V²/10 + (V - 48) V / 20 = 900, at 86 V instead of 160 V.
#[test]
fn a_brake_resistor_burns_what_is_fed_back() {
    let brake = BrakeResistor { on_above_v: 54.0, off_below_v: 52.0, resistance_ohm: 10.0 };
    let (feedback_resistance_ohm, brake_resistor) = (20.0, Some(brake));
    let supply = Supply { feedback_resistance_ohm, brake_resistor, ..Supply::battery(48.0) };
    for (current_a, rad_per_s) in [(-4.0, 16.125), (-20.0, 30.0)] {
        let fed_back_w = -(1.5 * 0.5 * current_a * current_a + 2.0 * current_a * rad_per_s);
        let mut m = held(ideal());
        m.set_supply(supply).unwrap();
        m.set_output_speed_dps(f64::to_degrees(rad_per_s)).unwrap();
        m.advance(&amps(current_a as f32), MS.times(500));
        let (mut least, mut most) = (f64::MAX, f64::MIN);
        for _ in 0..1_000 {
            let volts = m.advance(&amps(current_a as f32), Duration::from_micros(100));
            let volts = f64::from(volts.supply_voltage_v);
            (least, most) = (least.min(volts), most.max(volts));
        }
        if fed_back_w < 200.0 {
            close(fed_back_w, 117.0, 0.001);
            // A step changes the voltage by at most 0.1 ms times 3.3 A (left of 5.5 A), over 1 mF.
            assert!((51.6..52.0).contains(&least), "{least}");
            assert!((54.0..54.3).contains(&most), "{most}");
        } else {
            let (a, b) = (1.0 / 10.0 + 1.0 / 20.0, 48.0 / 20.0);
            let volts = (b + (b * b + 4.0 * a * fed_back_w).sqrt()) / (2.0 * a);
            close(fed_back_w, 900.0, 0.001);
            close(least, volts, 1e-4);
            close(most, volts, 1e-4);
        }
    }
    let below = BrakeResistor { off_below_v: 47.0, ..brake };
    let refused = Supply { brake_resistor: Some(below), ..supply };
    assert!(motor(ideal()).set_supply(refused).is_err());
    // Below the supply's own voltage it would be on for ever.
    let always = BrakeResistor { on_above_v: 45.0, off_below_v: 44.0, ..brake };
    let refused = Supply { brake_resistor: Some(always), ..supply };
    let message = motor(ideal()).set_supply(refused).unwrap_err().to_string();
    let expected =
        "voltage at which the brake resistor goes on must be 48 to 1000 V, but 45 V was given";
    assert_eq!(message, expected);
}

/// With a supply that is far too weak the voltage collapses. It never becomes negative, and all values stay finite.
#[test]
fn an_overloaded_supply_collapses_without_nonsense() {
    let mut m = motor(ideal());
    m.set_supply(Supply { resistance_ohm: 50.0, ..Supply::battery(48.0) }).unwrap();
    for _ in 0..5000 {
        let measured = m.advance(&amps(100.0), MS);
        assert!((0.0..=48.0).contains(&measured.supply_voltage_v), "{measured:?}");
        assert!(measured.current_a.is_finite() && measured.speed_dps.is_finite());
    }
}

// Energy

/// Electrical energy in = copper + friction + kinetic + spring + lifted weight, each calculated from measured values: a
/// start, a reversal, a stop in a spring.
#[test]
fn energy_balances() {
    let mut p = with_friction(0.3, 0.3, 0.2);
    p.inverter.idle_power_w = 3.0;
    p.inverter.mos_resistance_ohm = 0.05;
    let stop = EndStop { at_deg: 60.0, stiffness_nm_per_rad: 300.0, restitution: 1.0 };
    let (torque_nm, inertia_kg_m2) = (-1.0, 0.05);
    let mut m = loaded(p, Load { torque_nm, inertia_kg_m2, upper_stop: Some(stop), ..Load::NONE });

    let dt = 1e-4;
    let (mut electrical, mut copper, mut friction, mut idle) = (0.0, 0.0, 0.0, 0.0);
    let mut before = speed(&m);
    for step in 0..20_000 {
        let command = match step {
            0..6_000 => amps(3.0),
            6_000..9_000 => amps(-2.0),
            _ => amps(1.5),
        };
        let measured = m.advance(&command, Duration::from_micros(100));
        electrical +=
            f64::from(measured.supply_voltage_v) * f64::from(measured.supply_current_a) * dt;
        copper += 1.5 * 0.55 * f64::from(measured.current_a).powi(2) * dt;
        idle += 3.0 * dt;
        let mean = (before + speed(&m)) / 2.0;
        friction += (0.3 * mean.abs() + 0.2 * mean * mean) * dt;
        before = speed(&m);
    }
    let kinetic = 0.5 * (INERTIA + inertia_kg_m2) * speed(&m).powi(2);
    let pressed_rad = (angle(&m) - 60_f64.to_radians()).max(0.0);
    let spring = 0.5 * 300.0 * pressed_rad.powi(2);
    let lifted = -torque_nm * angle(&m);
    assert!(friction > 1.0 && copper > 1.0 && kinetic + spring > 0.1, "all parts take part");
    close(electrical, copper + idle + friction + kinetic + spring + lifted, 1e-5);
}

// Heat

/// T = Ta + P R (1 - e^(-t/RC)) for the winding and the output stage, heated by 3/2 R i² each.
#[test]
fn winding_and_output_stage_heat_exponentially_and_cool_again() {
    let mut p = ideal();
    p.inverter.mos_resistance_ohm = 0.1;
    p.thermal.winding_capacity_j_per_k = 20.0;
    p.thermal.winding_resistance_k_per_w = 1.5; // 30 s
    p.thermal.mos_capacity_j_per_k = 4.0;
    p.thermal.mos_resistance_k_per_w = 5.0; // 20 s
    let mut m = held(p);
    m.set_ambient_c(20.0).unwrap();
    // From 25 °C at the start towards 20 °C + rise. 4 A: 12 W in the winding, 2.4 W in the stage.
    let at = |rise: f64, start: f64, tau: f64, t: f64| {
        20.0 + rise + (start - 20.0 - rise) * (-t / tau).exp()
    };
    let hot = m.advance(&amps(4.0), Duration::from_secs(25));
    let (winding, mos) = (at(18.0, 25.0, 30.0, 25.0), at(12.0, 25.0, 20.0, 25.0));
    close(f64::from(hot.motor_temperature_c), winding, 1e-6);
    close(f64::from(hot.mos_temperature_c), mos, 1e-6);
    let cool = m.advance(&OFF, Duration::from_secs(40));
    close(f64::from(cool.motor_temperature_c), at(0.0, winding, 30.0, 40.0), 1e-6);
    close(f64::from(cool.mos_temperature_c), at(0.0, mos, 20.0, 40.0), 1e-6);
}

// Determinism

/// The same second in other portions gives the same bits, because remainders are carried over.
#[test]
fn any_split_of_the_time_gives_the_same_bits() {
    let run = |portion_us: u64| {
        let stop = EndStop { at_deg: 200.0, stiffness_nm_per_rad: 400.0, restitution: 1.0 };
        let load = Load { torque_nm: -1.0, upper_stop: Some(stop), ..Load::NONE };
        let mut m = loaded(MotorParameters::named("RMD-X6-P20-60").unwrap(), load);
        let mut left_us = 1_000_000;
        let mut last = Measurement::default();
        while left_us > 0 {
            let now = portion_us.min(left_us);
            last = m.advance(&amps(4.0), Duration::from_micros(now));
            left_us -= now;
        }
        // Numbers print with enough digits to be distinct.
        format!("{:?}", (last, m.output_angle_deg(), m.output_speed_dps()))
    };
    let whole = run(1_000_000);
    for portion_us in [1_000, 7_000, 7, 99, 101, 333_333] {
        assert_eq!(run(portion_us), whole, "portions of {portion_us} us");
    }
}
