//! A winding in a housing, compared with two thermal nodes worked out by hand.

use myactuator_host_std::sim::plant::{MotorParameters, SimulatedMotor};
use myactuator_protocol_core::drive::Plant;
use myactuator_protocol_core::time::Duration;

use super::plant_physics::{amps, close, held, ideal, motor};

/// 20 J/K of winding with 1 K/W to a housing of 100 J/K, which has 2 K/W to the air.
fn housed() -> MotorParameters {
    let mut p = ideal();
    p.thermal.winding_capacity_j_per_k = 20.0;
    p.thermal.winding_resistance_k_per_w = 3.0;
    p.thermal.housing_capacity_j_per_k = 100.0;
    p.thermal.housing_resistance_k_per_w = 2.0;
    p
}

/// 4 A of amplitude through 0.5 Ω are 1.5 * 0.5 * 16 = 12 W. In the end the housing is 24 K above the air of 25 °C, and
/// the winding 36 K.
///
/// On the way, C T' = A T + P has the rates of x² + (1/20 + 1/100 + 1/200) x + 1/4000 = 0: 0.060895 and 0.004105 per
/// second. Both start at 0 K.
///
/// - The rise of the winding is 36 + a e^(-0.060895 t) + b e^(-0.004105 t), with a + b = -36 and a 0.060895 + b
///   0.004105 = -12 W / 20 J/K: a = -7.9629, b = -28.0371.
/// - The rise of the housing is that of the winding plus 20 s of its slope less 12 K: 24 + 1.7350 e^(..) - 25.7350
///   e^(..).
#[test]
fn winding_and_housing_warm_up_as_two_nodes_do() {
    let mut m = held(housed());
    for seconds in 1..=60 {
        let measured = m.advance(&amps(4.0), Duration::from_secs(1));
        let (fast, slow) =
            ((-0.060_895 * f64::from(seconds)).exp(), (-0.004_105 * f64::from(seconds)).exp());
        let winding_k = 36.0 - 7.9629 * fast - 28.0371 * slow;
        close(f64::from(measured.motor_temperature_c) - 25.0, winding_k, 2e-3);
        let housing_k = 24.0 + 1.7350 * fast - 25.7350 * slow;
        let found_k = m.housing_temperature_c().unwrap() - 25.0;
        assert!((found_k - housing_k).abs() < 0.01, "{found_k}, not {housing_k}");
    }
}

#[test]
fn the_housings_resistance_must_be_a_part_of_the_windings() {
    assert_eq!(motor(ideal()).housing_temperature_c(), None);
    for resistance_k_per_w in [0.0, 3.0] {
        let mut p = housed();
        p.thermal.housing_resistance_k_per_w = resistance_k_per_w;
        let error = SimulatedMotor::new(p).unwrap_err().to_string();
        assert!(error.contains("thermal.housing_resistance_k_per_w"), "{error}");
    }
}
