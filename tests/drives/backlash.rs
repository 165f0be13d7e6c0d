//! A gear with play, against two bodies worked out by hand.

use myactuator_host_std::sim::plant::{Load, MotorParameters, SimulatedMotor, Spring};
use myactuator_protocol_core::drive::{Actuation, Plant};
use myactuator_protocol_core::time::Duration;

use super::plant_physics::{MS, OFF, amps, close, ideal, motor, speed};

/// The ideal motor, 0.04 kg·m² on the motor's side and 0.06 on the load's, with one degree of play.
fn loose() -> MotorParameters {
    let mut p = ideal();
    p.gear.backlash_arcmin = 60.0;
    p
}

fn ahead_deg(m: &SimulatedMotor) -> f64 {
    m.motor_side_angle_deg() - m.output_angle_deg()
}

/// For the first half degree 4 N·m turn the motor's side alone, with α = 100 rad/s². That takes √(2 · 0.0087266 / 100)
/// = 13.211 ms and ends at 1.3211 rad/s. Then 0.04 of 0.1 kg·m² share this with the load: 0.52844 rad/s. Both go on
/// with 40 rad/s².
#[test]
fn the_motor_crosses_the_play_and_takes_the_load_along() {
    let mut m = motor(loose());
    let seen = m.advance(&amps(2.0), MS.times(13));
    assert_eq!(m.output_angle_deg(), 0.0);
    let alone_rad = 0.5 * 100.0 * 0.013 * 0.013_f64;
    close(m.motor_side_angle_deg(), alone_rad.to_degrees(), 1e-9);
    close(f64::from(seen.speed_dps), 1.3_f64.to_degrees(), 1e-6);
    // 18 bits and a ratio of 10.
    assert_eq!(seen.encoder_pulses, (alone_rad.to_degrees() / 360.0 * 2_621_440.0) as i64);

    m.advance(&amps(2.0), MS.times(7));
    close(speed(&m), 0.52844 + 40.0 * (0.020 - 0.013_211), 1e-3);
    close(ahead_deg(&m), 0.5, 1e-9);
    assert_eq!(m.motor_side_speed_dps(), m.output_speed_dps());
    close(
        m.output_angle_deg(),
        (0.52844 * 6.789e-3 + 20.0 * 6.789e-3_f64.powi(2)).to_degrees(),
        5e-3,
    );
}

/// If the motor brakes, the load goes on through the whole play at its own speed.
#[test]
fn a_load_runs_ahead_of_a_motor_that_brakes() {
    let mut m = motor(loose());
    m.advance(&amps(2.0), MS.times(100));
    let (speed_before, output_before) = (m.output_speed_dps(), m.output_angle_deg());
    // Backwards with 100 rad/s², the motor's side falls a degree behind after √(2 · 0.017453 / 100) = 18.68 ms.
    m.advance(&amps(-2.0), MS.times(18));
    close(m.output_speed_dps(), speed_before, 1e-9);
    close(m.output_angle_deg() - output_before, speed_before * 0.018, 1e-9);
    close(ahead_deg(&m), 0.5 - (50.0 * 0.018 * 0.018_f64).to_degrees(), 1e-6);
    m.advance(&amps(-2.0), MS);
    close(ahead_deg(&m), -0.5, 1e-9);
    // The sum of both momenta, less 4 N·m for 19 ms.
    close(speed(&m), speed_before.to_radians() - 4.0 * 0.019 / 0.1, 1e-9);
}

/// The brake holds the motor. A hand turns the output through the play and no further. It pushes so softly that the
/// 0.054 rad/s at which the teeth meet move the brake, of 25 N·m, by less than a thousandth of a degree.
#[test]
fn a_hand_feels_the_whole_play() {
    let mut m = motor(loose());
    let held = Actuation { brake_released: false, ..OFF };
    for (hand_nm, ends_deg) in [(0.01, 0.5), (-0.01, -0.5), (0.01, 0.5)] {
        m.set_external_torque_nm(hand_nm).unwrap();
        m.advance(&held, Duration::from_secs(1));
        close(m.output_angle_deg(), ends_deg, 1e-3);
        assert_eq!(m.motor_side_speed_dps(), 0.0);
    }
}

/// Within the play a spring swings the load alone, with √(k/J) of the load's own inertia.
#[test]
fn a_load_in_the_play_swings_alone() {
    let spring = Spring { rest_deg: 0.0, stiffness_nm_per_rad: 6.0 };
    let mut m = motor(loose());
    m.set_load(Load { spring: Some(spring), ..Load::NONE }).unwrap();
    m.force_brake(Some(false));
    // 10 rad/s: 2 deg/s are 0.2 degrees to either side, and a period is 2π/10 s.
    m.set_output_speed_dps(2.0).unwrap();
    m.advance(&OFF, Duration::from_micros(157_100));
    close(m.output_angle_deg(), 0.2, 1e-3);
    m.advance(&OFF, Duration::from_micros(314_200));
    close(m.output_angle_deg(), -0.2, 1e-3);
}

#[test]
fn a_gear_without_a_mass_after_its_play_is_refused() {
    let mut p = loose();
    p.gear.output_inertia_kg_m2 = 0.0;
    let error = SimulatedMotor::new(p).unwrap_err().to_string();
    assert!(error.contains("output inertia of a gear with backlash"), "{error}");
}

/// Loads, up to the stiffest that the step allows, are thrown to and fro in the play. Their energy does not grow.
#[test]
fn no_load_gains_energy_from_the_play() {
    for stiffness_nm_per_rad in [1e2, 1e4, 4e5] {
        let spring = Spring { rest_deg: 0.3, stiffness_nm_per_rad };
        let mut m = motor(loose());
        m.set_load(Load { spring: Some(spring), ..Load::NONE }).unwrap();
        m.set_output_speed_dps(500.0).unwrap();
        let most_j = 0.05 * 500_f64.to_radians().powi(2)
            + 0.5 * stiffness_nm_per_rad * 0.3_f64.to_radians().powi(2);
        for _ in 0..2_000 {
            m.advance(&OFF, MS);
            let moving_j = 0.5 * 0.06 * speed(&m).powi(2)
                + 0.5 * 0.04 * m.motor_side_speed_dps().to_radians().powi(2);
            let out_rad = (m.output_angle_deg() - 0.3).to_radians();
            let has_j = moving_j + 0.5 * stiffness_nm_per_rad * out_rad * out_rad;
            assert!(has_j < 1.05 * most_j, "{stiffness_nm_per_rad}: {has_j} of {most_j}");
        }
    }
}
