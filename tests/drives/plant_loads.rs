//! Loads on the simulated shaft, compared with mechanics worked out by hand, as in `plant_physics`.

use std::f64::consts::{FRAC_PI_2, TAU};

use myactuator_host_std::sim::plant::{Arm, EndStop, Load, STEP, SimulatedMotor, Spring};
use myactuator_protocol_core::drive::Plant;
use myactuator_protocol_core::time::Duration;
use myactuator_tests::values::GRAVITY_M_S2;

use super::energy::STEP_S;
use super::plant_physics::{
    INERTIA, MS, OFF, amps, angle, close, ideal, loaded, speed, with_friction,
};

fn sprung(stiffness_nm_per_rad: f64) -> Load {
    Load { spring: Some(Spring { rest_deg: 0.0, stiffness_nm_per_rad }), ..Load::NONE }
}

fn ended(at_deg: f64, stiffness_nm_per_rad: f64, restitution: f64) -> Load {
    let stop = EndStop { at_deg, stiffness_nm_per_rad, restitution };
    Load { upper_stop: Some(stop), ..Load::NONE }
}

/// 2 kg at 0.4 m that hang at 30°: 7.85 N·m when level, 0.32 kg·m².
const ARM: Arm = Arm { mass_kg: 2.0, length_m: 0.4, down_deg: 30.0 };
const HANGING: Load = Load { arm: Some(ARM), ..Load::NONE };
const WEIGHT_NM: f64 = 2.0 * GRAVITY_M_S2 * 0.4;
const HANGING_KG_M2: f64 = INERTIA + 2.0 * 0.4 * 0.4;

/// The mean time between upward passages of an angle, s, and the number of periods in that mean.
fn period_s(m: &mut SimulatedMotor, about_rad: f64, span: Duration) -> (f64, u32) {
    let (mut first, mut last, mut periods) = (None, 0.0, 0);
    for step in 1..=span.as_micros() / STEP.as_micros() {
        let before = angle(m) - about_rad;
        m.advance(&OFF, STEP);
        let now = angle(m) - about_rad;
        if before < 0.0 && now >= 0.0 {
            // Interpolated between two steps.
            last = (step as f64 - now / (now - before)) * STEP_S;
            periods += u32::from(first.is_some());
            first = first.or(Some(last));
        }
    }
    ((last - first.unwrap()) / f64::from(periods), periods)
}

// Springs

/// f = 1/2π √(k/J) for a spring that acts both ways: 40 N·m/rad and 0.1 kg·m² give 20 rad/s.
#[test]
fn a_spring_oscillates_at_its_frequency_and_keeps_its_energy() {
    let mut m = loaded(ideal(), sprung(40.0));
    m.set_output_angle_deg(30.0).unwrap();
    let start = angle(&m);
    let energy = 0.5 * 40.0 * start * start;
    for _ in 0..300 {
        m.advance(&OFF, MS.times(97));
        let total = 0.5 * INERTIA * speed(&m).powi(2) + 0.5 * 40.0 * angle(&m).powi(2);
        close(total, energy, 1e-5);
    }
    let (found_s, periods) = period_s(&mut m, 0.0, Duration::from_secs(20));
    assert!(periods > 60, "{periods}");
    close(found_s, TAU / 20.0, 1e-6);
}

/// The spring pulls to its rest angle. The friction of the shaft decides where it ends: within τ/k of that.
#[test]
fn a_spring_pulls_to_its_angle() {
    let spring = Spring { rest_deg: -400.0, stiffness_nm_per_rad: 20.0 };
    let mut m = loaded(with_friction(0.1, 0.1, 1.0), Load { spring: Some(spring), ..Load::NONE });
    m.advance(&OFF, Duration::from_secs(10));
    assert_eq!(speed(&m), 0.0);
    assert!((angle(&m) + 400_f64.to_radians()).abs() <= 0.1 / 20.0, "{}", m.output_angle_deg());
}

// Arms

/// T = 2π √(J / m g l) for a small swing about the angle where it hangs. For 0.2°, 1 + φ²/16 is 1 within 10⁻⁶.
#[test]
fn an_arm_is_a_pendulum() {
    let mut m = loaded(ideal(), HANGING);
    m.set_output_angle_deg(30.2).unwrap();
    close(m.inertia_kg_m2(), HANGING_KG_M2, 1e-12);
    let (found_s, periods) = period_s(&mut m, 30_f64.to_radians(), Duration::from_secs(60));
    assert!(periods > 30, "{periods}");
    close(found_s, TAU * (HANGING_KG_M2 / WEIGHT_NM).sqrt(), 2e-6);
    // At a right angle its whole weight pulls.
    m.set_output_angle_deg(120.0).unwrap();
    m.advance(&OFF, STEP);
    close(speed(&m), -WEIGHT_NM / HANGING_KG_M2 * STEP_S, 1e-6);
}

/// ½Jω² - m g l cos φ stays constant for a minute, in a wide swing and in one that goes over the top.
#[test]
fn an_arm_keeps_its_energy() {
    for (start_deg, start_dps) in [(30.0 + 150.0, 0.0), (30.0, 700.0)] {
        let mut m = loaded(ideal(), HANGING);
        m.set_output_angle_deg(start_deg).unwrap();
        m.set_output_speed_dps(start_dps).unwrap();
        // From where it hangs.
        let energy = |m: &SimulatedMotor| {
            let lifted = 1.0 - (angle(m) - 30_f64.to_radians()).cos();
            0.5 * HANGING_KG_M2 * speed(m).powi(2) + WEIGHT_NM * lifted
        };
        let at_first = energy(&m);
        for _ in 0..60_000 {
            m.advance(&OFF, MS);
            close(energy(&m), at_first, 1e-6);
        }
    }
}

// Dampers

/// ω = ω₀ e^(-b t/J) and φ = ω₀ J/b (1 - e^(-b t/J)). The load's damper and the motor's friction add up.
#[test]
fn a_damper_takes_the_speed_exponentially() {
    let load = Load { damping_nm_s_per_rad: 0.3, inertia_kg_m2: 0.1, ..Load::NONE };
    let mut m = loaded(with_friction(0.0, 0.0, 0.2), load);
    m.set_output_speed_dps(10_f64.to_degrees()).unwrap();
    for ms in 1..=2_000 {
        m.advance(&OFF, MS);
        let left = (-0.5 / 0.2 * f64::from(ms) * 1e-3).exp();
        close(speed(&m), 10.0 * left, 1e-9);
        close(angle(&m), 10.0 * 0.2 / 0.5 * (1.0 - left), 2e-4);
    }
}

/// A damper is stable even if it is far too strong for an explicit step (b h/J up to 10⁶). A torque makes it creep with
/// τ/b. A spring pulls it back, in the end with e^(-k t/b).
#[test]
fn a_damper_of_any_strength_is_stable() {
    for damping in [1e2, 1e4, 1e6] {
        let damped = |load| Load { damping_nm_s_per_rad: damping, ..load };
        let mut m = loaded(ideal(), damped(Load::NONE));
        m.set_output_speed_dps(1_000.0).unwrap();
        m.set_external_torque_nm(5.0).unwrap();
        m.advance(&OFF, MS.times(100));
        close(speed(&m), 5.0 / damping, 1e-6);

        // The stiffest spring that the step allows: critically damped by 2 √(k J), 400 N·m·s/rad.
        let stiffness = 4e6 * INERTIA;
        let mut m = loaded(ideal(), damped(sprung(stiffness)));
        m.set_output_angle_deg(1.0).unwrap();
        let mut before = 1.0;
        for _ in 0..1_000 {
            m.advance(&OFF, STEP);
            let now = m.output_angle_deg();
            assert!(
                now.abs() <= 1.0 && (damping < 400.0 || (0.0..=before).contains(&now)),
                "{now}"
            );
            before = now;
        }
        if damping == 1e6 {
            close(m.output_angle_deg(), (-stiffness / damping * 0.1_f64).exp(), 1e-4);
        }
    }
}

// End stops

/// A stop throws back with its share of the speed and is pressed in by ω √(J/k). This holds for every speed, every
/// stiffness that the step allows (up to 4·10⁵ N·m/rad here), and every part of a step at which it is touched. The
/// share is met within 0.005 and the depth within 1 %. Below a restitution of 1 no speed is gained.
#[test]
fn a_stop_throws_back_with_its_share_of_the_speed() {
    for restitution in [0.0, 0.1, 0.5, 0.9, 0.995, 1.0] {
        for stiffness in [1e3, 1e5, 4e5] {
            let slowness_s = (INERTIA / stiffness).sqrt();
            for start_dps in [3.0, 71.0, 180.0, 913.0] {
                for part in 0..20 {
                    let mut m = loaded(ideal(), ended(45.0, stiffness, restitution));
                    m.set_output_angle_deg(45.0 - f64::from(part) / 20.0 * start_dps * STEP_S)
                        .unwrap();
                    m.set_output_speed_dps(start_dps).unwrap();
                    let mut deepest: f64 = 0.0;
                    // In, and out restitution times as fast. Then two steps more.
                    let contact_s =
                        FRAC_PI_2 * slowness_s * (1.0 + 1.0 / f64::max(restitution, 0.1));
                    for _ in 0..(contact_s / STEP_S) as u32 + 3 {
                        m.advance(&OFF, STEP);
                        deepest = deepest.max(m.output_angle_deg() - 45.0);
                    }
                    let thrown = -m.output_speed_dps() / start_dps;
                    let case = (restitution, stiffness, start_dps, part);
                    assert!((thrown - restitution).abs() < 0.005, "{case:?}: {thrown}");
                    assert!(thrown < 1.0 || restitution == 1.0, "{case:?}: {thrown}");
                    close(deepest, start_dps * slowness_s, 0.01);
                }
            }
        }
    }
}

/// A one-sided stop of restitution 1 is a spring: the contact lasts half a period, π √(J/k).
#[test]
fn a_stop_throws_back() {
    let mut m = loaded(ideal(), ended(45.0, 1000.0, 1.0));
    m.set_output_speed_dps(180.0).unwrap();
    let mut deepest: f64 = 0.0;
    let mut touching = 0;
    for _ in 0..5000 {
        m.advance(&OFF, STEP);
        deepest = deepest.max(m.output_angle_deg() - 45.0);
        touching += u32::from(m.output_angle_deg() > 45.0);
    }
    close(m.output_speed_dps(), -180.0, 1e-3);
    // ½Jω² = ½kx²: x = ω √(J/k) = 180° * 0.01 = 1.8°
    close(deepest, 1.8, 1e-3);
    close(f64::from(touching) * 1e-4, TAU / 2.0 * 0.01, 0.01);
}

/// An arm that falls on a stop only loses energy, and presses it in by no more than its energy allows. It comes to rest
/// for ever where the stop holds its weight: between τ/k and τ/(e² k). That takes the time of all its jumps, each the
/// share e of the one before: 2ω/α (1 + e + e² + ...).
#[test]
fn arm_that_falls_on_an_end_stop_comes_to_rest() {
    for (restitution, stiffness) in [(0.0, 2e4), (0.3, 2e4), (0.3, 1e6), (0.7, 1e5), (0.9, 1e5)] {
        let arm = Arm { down_deg: 90.0, ..ARM };
        let mut m = loaded(ideal(), Load { arm: Some(arm), ..ended(0.0, stiffness, restitution) });
        m.set_output_angle_deg(-20.0).unwrap();
        let energy = |m: &SimulatedMotor| {
            0.5 * HANGING_KG_M2 * speed(m).powi(2) - WEIGHT_NM * angle(m).sin()
        };
        let fallen = WEIGHT_NM * 20_f64.to_radians().sin();
        let weakest_nm = WEIGHT_NM * 20_f64.to_radians().cos();
        // ½kx² = fallen + τ x
        let deepest = WEIGHT_NM / stiffness
            + ((WEIGHT_NM / stiffness).powi(2) + 2.0 * fallen / stiffness).sqrt();
        let lands_rad_s = (2.0 * fallen / HANGING_KG_M2).sqrt();
        let fall_s = lands_rad_s * HANGING_KG_M2 / weakest_nm;
        let jumps_s = 2.0 * fall_s * restitution / (1.0 - restitution);
        // The contacts take their time too.
        let rest_s = 1.1 * (fall_s + jumps_s) + 0.1;

        let mut least = energy(&m);
        let mut contacts = 0;
        for _ in 0..(rest_s / STEP_S) as u32 {
            let before = angle(&m);
            m.advance(&OFF, STEP);
            assert!(angle(&m) < 1.005 * deepest, "{restitution}, {stiffness}: {}", angle(&m));
            if angle(&m) <= 0.0 {
                assert!(energy(&m) <= least + 1e-6 * fallen, "{restitution}, {stiffness}");
                least = least.min(energy(&m));
            }
            contacts += u32::from(before <= 0.0 && angle(&m) > 0.0);
        }
        let at_rest = m.output_angle_deg();
        assert_eq!(speed(&m), 0.0, "{restitution}, {stiffness}: after {contacts} contacts");
        let (pressed_nm, given_back) = (stiffness * angle(&m), restitution * restitution);
        assert!((given_back * pressed_nm..=pressed_nm).contains(&WEIGHT_NM), "{pressed_nm}");
        m.advance(&OFF, Duration::from_secs(10));
        assert_eq!((m.output_angle_deg(), speed(&m)), (at_rest, 0.0));
    }
}

/// A damped motor that leans on a stop with a constant torque ends where k x = τ, or deeper by what the stop does not
/// give back: e² k x ≤ τ. Switched off, it is thrown out.
#[test]
fn a_motor_leaning_on_a_stop_comes_to_rest() {
    for restitution in [1.0, 0.5] {
        let mut m = loaded(with_friction(0.0, 0.0, 2.0), ended(10.0, 200.0, restitution));
        m.advance(&amps(2.0), Duration::from_secs(5));
        assert!(speed(&m).abs() < 1e-9, "{}", speed(&m));
        let pressed_nm = 200.0 * (angle(&m) - 10_f64.to_radians());
        assert!(pressed_nm > 4.0 * (1.0 - 1e-6), "{pressed_nm}");
        assert!(restitution * restitution * pressed_nm < 4.0 * (1.0 + 1e-6), "{pressed_nm}");
        m.advance(&OFF, Duration::from_secs(5));
        assert!(m.output_angle_deg() <= 10.0);
    }
}

/// A fast shaft ends between the two stops and stands still.
#[test]
fn two_stops_keep_the_shaft_between_them() {
    let stop = |at_deg| EndStop { at_deg, stiffness_nm_per_rad: 5e4, restitution: 0.6 };
    let load = Load { lower_stop: Some(stop(-5.0)), upper_stop: Some(stop(5.0)), ..Load::NONE };
    let mut m = loaded(with_friction(0.01, 0.01, 0.0), load);
    m.set_output_speed_dps(-2_000.0).unwrap();
    // ω √(J/k) = 2000° * 1.41 ms
    for _ in 0..60_000 {
        m.advance(&OFF, STEP);
        assert!(m.output_angle_deg().abs() < 5.0 + 2.9, "{}", m.output_angle_deg());
    }
    assert_eq!(speed(&m), 0.0);
}
