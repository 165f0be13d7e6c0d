//! Cogging, compared with the pendulum that it turns the rotor into.

use myactuator_host_std::sim::plant::{MotorParameters, SimulatedMotor};
use myactuator_protocol_core::drive::Plant;
use myactuator_protocol_core::time::Duration;

use super::plant_physics::{OFF, amps, close, ideal, motor, speed, with_friction};

/// 0.5 N·m, 12 times in a turn of the motor shaft, with a ratio of 10: every 3 degrees of the output.
fn coggy(mut p: MotorParameters) -> MotorParameters {
    p.motor.cogging_nm = 0.5;
    p.motor.cogging_periods = 12;
    p
}

/// Near a rest position cogging is a spring of 0.5 N·m * 120 = 60 N·m/rad. With 0.1 kg·m² that is 24.495 rad/s, half a
/// period in 128.26 ms. (0.05 degrees are 6 degrees of its period, which make that 0.07 % longer.)
#[test]
fn rotor_swings_about_its_cogging_rest_position() {
    let mut m = motor(coggy(ideal()));
    m.set_output_angle_deg(6.05).unwrap();
    m.advance(&OFF, Duration::from_micros(128_300));
    close(m.output_angle_deg(), 5.95, 1e-5);
    assert!(speed(&m).abs() < 1e-4, "{}", speed(&m));
}

/// Against 0.25 N·m, half of the amplitude, the rotor settles where the sine is a half: at 30 of 360 degrees, 0.25 of
/// 3. A torque below the amplitude never turns it into the next period, a larger one does.
#[test]
fn a_motor_at_rest_holds_up_to_the_cogging_torque() {
    let mut m = motor(coggy(with_friction(0.0, 0.0, 2.0)));
    m.advance(&amps(0.125), Duration::from_secs(2));
    close(m.output_angle_deg(), 0.25, 1e-3);
    let ends = |current_a| {
        let mut m: SimulatedMotor = motor(coggy(with_friction(0.0, 0.0, 10.0)));
        m.advance(&amps(current_a), Duration::from_secs(20));
        m.output_angle_deg()
    };
    assert!(ends(0.24) < 0.75 && ends(0.26) > 3.0);
}

/// Cogging takes no energy: a rotor that turns through it has its speed again after each period.
#[test]
fn cogging_gives_back_what_it_takes() {
    let mut m = motor(coggy(ideal()));
    m.set_output_speed_dps(60.0).unwrap();
    m.advance(&OFF, Duration::from_secs(60));
    // 60 deg/s are 0.0548 J. Between a tooth's top and its foot 2 * 0.5 / 120 = 0.0083 J come and go.
    let turned = m.output_angle_deg().to_radians() * 120.0;
    let has_j = 0.05 * speed(&m).powi(2) + 0.5 / 120.0 * (1.0 - turned.cos());
    close(has_j, 0.05 * 60_f64.to_radians().powi(2), 1e-3);
}

#[test]
fn cogging_faster_than_the_step_is_refused() {
    let mut p = coggy(ideal());
    p.motor.cogging_nm = 10_000.0;
    let error = SimulatedMotor::new(p).unwrap_err().to_string();
    assert!(error.contains("cogging torque"), "{error}");
}
