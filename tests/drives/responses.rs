//! Step and frequency responses of the motor and of the drive's loops, compared with the closed forms of the linear
//! system: no friction, no limit reached.

use std::f64::consts::TAU;

use myactuator_host_std::sim::plant::{Load, MotorParameters, STEP, Spring};
use myactuator_protocol_core::command::{
    AccelerationIndex, MotionRanges, MotionSetPoint, WriteAcceleration,
};
use myactuator_protocol_core::drive::Plant;
use myactuator_protocol_core::units::Acceleration;
use myactuator_tests::values::{go_to, turn};

use super::loops::{Alone, plan_all};
use super::plant_physics::{INERTIA, amps, angle, ideal, loaded};

const STEP_S: f64 = STEP.as_micros() as f64 * 1e-6;

/// Gain and phase lead (degrees) of an output to an input of sin(2π n / period) in step n: the mean over `periods`
/// periods, after `waited` periods in which the transient of the start dies away.
fn response(
    period: u32,
    waited: u32,
    periods: u32,
    mut out_of: impl FnMut(f64) -> f64,
) -> (f64, f64) {
    let (mut in_phase, mut ahead) = (0.0, 0.0);
    for step in 0..period * (waited + periods) {
        let turns = f64::from(step % period) / f64::from(period);
        let output = out_of((turns * TAU).sin());
        if step >= period * waited {
            // The output is read when the step is over.
            let (sin, cos) = (turns * TAU + TAU / f64::from(period)).sin_cos();
            in_phase += output * sin;
            ahead += output * cos;
        }
    }
    let steps = f64::from(period * periods) / 2.0;
    (in_phase.hypot(ahead) / steps, ahead.atan2(in_phase).to_degrees())
}

/// A complex number's amount and angle, degrees.
fn polar((re, im): (f64, f64)) -> (f64, f64) {
    (re.hypot(im), im.atan2(re).to_degrees())
}

fn quotient((a, b): (f64, f64), (c, d): (f64, f64)) -> (f64, f64) {
    let amount = c * c + d * d;
    ((a * c + b * d) / amount, (b * c - a * d) / amount)
}

#[track_caller]
fn same(found: (f64, f64), expected: (f64, f64), share: f64, degrees: f64, case: &str) {
    let off = (found.0 / expected.0 - 1.0, found.1 - expected.1);
    let is_same = off.0.abs() < share && off.1.abs() < degrees;
    assert!(is_same, "{case}: {found:?}, expected {expected:?}");
}

/// θ/τ = 1 / (k - J ω² + j c ω), with 2 N·m/A: below, at and above the resonance at 20 rad/s, where it is 1/cω.
#[test]
fn a_sprung_and_damped_shaft_answers_a_torque() {
    let (k, c) = (40.0, 0.8);
    for period in [12_566, 6_283, 3_142, 1_571] {
        let rad_s = TAU / (f64::from(period) * STEP_S);
        let spring = Some(Spring { rest_deg: 0.0, stiffness_nm_per_rad: k });
        let mut m = loaded(ideal(), Load { spring, damping_nm_s_per_rad: c, ..Load::NONE });
        let found = response(period, 25_000 / period + 1, 2, |sin| {
            m.advance(&amps(sin as f32), STEP);
            angle(&m) / 2.0
        });
        let expected = polar(quotient((1.0, 0.0), (k - INERTIA * rad_s * rad_s, c * rad_s)));
        same(found, expected, 0.001, 0.15, &format!("{rad_s:.1} rad/s"));
    }
}

/// 0.1 kg·m², 2 N·m/A and no losses, as the drive knows them, and an output that reaches no limit. The factory's rule
/// then makes the speed loop 1000 rad/s without load.
fn linear() -> MotorParameters {
    let mut p = ideal();
    p.rating.torque_constant_nm_per_a = 2.0;
    p.rating.peak_current_a = 100.0;
    p.motor.phase_resistance_ohm = 0.01;
    p
}

/// The factory's loops with ten times the inertia, in 1/s: the bandwidth of the speed loop, its integral gain over its
/// proportional gain, and the gain of the position loop.
const GROWTH: f64 = 10.0;
const B: f64 = 1000.0 / GROWTH;
const I: f64 = 5.0;
const P: f64 = 25.0;

fn ten_times_heavier() -> Alone {
    Alone::new(&linear(), (GROWTH - 1.0) * INERTIA)
}

/// A continuous loop plus the delay of sampling every 0.1 ms: half a step of hold.
fn sampled((gain, lead_deg): (f64, f64), rad_s: f64) -> (f64, f64) {
    (gain, lead_deg - (rad_s * STEP_S / 2.0).to_degrees())
}

/// ω/ω* = B (s + I) / (s² + B s + B I).
#[test]
fn the_speed_loop_answers_as_its_gains_say() {
    for period in [20_000, 2_000, 628, 200] {
        let rad_s = TAU / (f64::from(period) * STEP_S);
        let mut alone = ten_times_heavier();
        plan_all(&mut alone, 60_000);
        let found = response(period, 30_000 / period + 1, 2, |sin| {
            alone.command(turn((20.0 * sin) as f32));
            alone.run(STEP);
            alone.speed_dps() / 20.0
        });
        let closed = quotient((B * I, B * rad_s), (B * I - rad_s * rad_s, B * rad_s));
        same(found, sampled(polar(closed), rad_s), 0.006, 0.3, &format!("{rad_s:.1} rad/s"));
    }
}

/// θ/θ* = B P (s + I) / (s³ + B s² + B (P + I) s + B P I), by direct tracking (2.21.1).
#[test]
fn the_position_loop_answers_as_its_gains_say() {
    for period in [20_000, 4_000, 2_000, 1_000] {
        let rad_s = TAU / (f64::from(period) * STEP_S);
        let mut alone = ten_times_heavier();
        let acceleration = Acceleration::NONE;
        alone.command(WriteAcceleration {
            index: AccelerationIndex::POSITION_ACCELERATION,
            acceleration,
        });
        let found = response(period, 30_000 / period + 1, 2, |sin| {
            alone.command(go_to((5.0 * sin) as f32, 0));
            alone.run(STEP);
            alone.angle_deg() / 5.0
        });
        let closed = quotient(
            (B * P * I, B * P * rad_s),
            (B * P * I - B * rad_s * rad_s, B * (P + I) * rad_s - rad_s.powi(3)),
        );
        same(found, sampled(polar(closed), rad_s), 0.006, 0.3, &format!("{rad_s:.1} rad/s"));
    }
}

/// The step response of the same speed loop: 1 + Σ (B p + B I) / (p (p - q)) e^pt over its poles p, q of s² + 100 s +
/// 500, which are -50 ± √2000.
#[test]
fn a_step_of_speed_is_followed_as_the_poles_say() {
    let mut alone = ten_times_heavier();
    plan_all(&mut alone, 60_000);
    let (p, q) = (-50.0 + 2_000_f64.sqrt(), -50.0 - 2_000_f64.sqrt());
    let part = |p: f64, q: f64, t: f64| (B * p + B * I) / (p * (p - q)) * (p * t).exp();
    alone.command(turn(20.0));
    for step in 1..=5_000 {
        alone.run(STEP);
        // The ramp of 60000 dps/s has its middle at a sixth of a millisecond.
        let t = (f64::from(step) * STEP_S - 20.0 / 60_000.0 / 2.0).max(0.0);
        let expected = 20.0 * (1.0 + part(p, q, t) + part(q, p, t));
        let found = alone.speed_dps();
        assert!((found - expected).abs() < 0.15, "{t} s: {found}, expected {expected}");
    }
}

/// 5.1: motion mode is a spring and a damper: 1 - e^(-ζ ω t) (cos ω' t + ζ ω / ω' sin ω' t), with ω² = kp/J,
/// ζ = kd / 2 J ω and ω'² = ω² (1 - ζ²).
#[test]
fn a_step_of_motion_mode_swings_as_its_gains_say() {
    let mut alone = ten_times_heavier();
    let wanted =
        MotionSetPoint { position_rad: 0.5, kp: 100.0, kd: 2.0, ..MotionSetPoint::default() };
    let motion = MotionRanges::V4_3.quantise(&wanted).unwrap();
    alone.command(motion);
    // In the steps of a frame the gains differ a little, and zeros are not quite 0: within half a step.
    let inertia = GROWTH * INERTIA;
    let natural = (100.0 / inertia).sqrt();
    let damping = 2.0 / (2.0 * inertia * natural);
    let swing = natural * (1.0 - damping * damping).sqrt();
    for step in 1..=10_000 {
        alone.run(STEP);
        let t = f64::from(step) * STEP_S;
        let decays = (-damping * natural * t).exp();
        let (sin, cos) = (swing * t).sin_cos();
        let expected = 0.5 * (1.0 - decays * (cos + damping * natural / swing * sin));
        let found = alone.angle_deg().to_radians();
        assert!((found - expected).abs() < 0.002, "{t} s: {found}, expected {expected}");
    }
}
