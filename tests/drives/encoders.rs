//! What encoders read of a shaft.

use myactuator_host_std::sim::Fleet;
use myactuator_host_std::sim::plant::{MotorParameters, STEP, SimulatedMotor};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::ReadMultiTurnEncoderRaw;
use myactuator_protocol_core::drive::Plant;
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::time::Duration;

use super::plant_physics::{MS, OFF, ideal, motor};

fn noisy(noise_pulses: f64) -> MotorParameters {
    let mut p = ideal();
    p.encoder.noise_pulses = noise_pulses;
    p
}

fn seeded(seed: u64) -> SimulatedMotor {
    let mut m = motor(noisy(3.0));
    m.set_noise_seed(seed);
    m
}

fn pulses(m: &mut SimulatedMotor, span: Duration) -> i64 {
    m.advance(&OFF, span).encoder_pulses
}

/// 3 pulses rms, about a mean half a pulse below the true position, because whole pulses are rounded down. The rounding
/// makes the rms √(9 + 1/12). One sigma over 20,000 steps is 0.02 for the mean and 0.015 for the rms. No reading is
/// beyond 2√3 · 3.
#[test]
fn noise_is_as_large_as_the_file_says() {
    let mut m = seeded(1);
    let seen: Vec<f64> = (0..20_000).map(|_| pulses(&mut m, STEP) as f64 + 0.5).collect();
    let mean = seen.iter().sum::<f64>() / 20_000.0;
    let rms = (seen.iter().map(|it| it * it).sum::<f64>() / 20_000.0).sqrt();
    assert!(mean.abs() < 0.08, "{mean}");
    assert!((rms - 3.0139).abs() < 0.06, "{rms}");
    assert!(seen.iter().all(|it| it.abs() < 10.4 + 1.0));
    // The noise of neighbouring steps does not correlate.
    let product = seen.windows(2).map(|it| it[0] * it[1]).sum::<f64>() / 20_000.0;
    assert!(product.abs() < 9.0 * 0.03, "{product}");
}

/// Reading more often returns the same values, and so does the same seed.
#[test]
fn looking_changes_nothing() {
    let (mut seldom, mut often, mut other) = (seeded(7), seeded(7), seeded(8));
    let mut differ = false;
    for _ in 0..100 {
        for _ in 0..9 {
            often.advance(&OFF, STEP);
            often.advance(&OFF, Duration::ZERO);
        }
        let looks = [STEP, Duration::ZERO, Duration::ZERO].map(|span| pulses(&mut often, span));
        let seen = pulses(&mut seldom, MS);
        assert_eq!(looks, [seen; 3]);
        differ |= pulses(&mut other, MS) != seen;
    }
    assert!(differ);
}

/// Each motor of a fleet has noise of its own, which is the same in each run.
#[test]
fn a_fleets_seed_is_its_noise() {
    let reported = |seed| {
        let mut model = MotorParameters::named("RMD-X8-P20-120").unwrap();
        model.encoder.noise_pulses = 50.0;
        let fleet = Fleet::new(2).model(model).seed(seed).on_can(1_000_000).unwrap();
        let mut master = fleet.master::<2>();
        [1, 2].map(|id| master.ask(MotorId::new(id).unwrap(), ReadMultiTurnEncoderRaw).unwrap())
    };
    assert_eq!(reported(1), reported(1));
    assert_ne!(reported(1), reported(2));
    assert_ne!(reported(1)[0], reported(1)[1]);
}
