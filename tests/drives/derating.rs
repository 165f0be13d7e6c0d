//! A drive that is hot.

use myactuator_host_std::sim::Fleet;
use myactuator_host_std::sim::plant::{DeratingParameters, Load, MotorParameters};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::drive::{Event, Limit};
use myactuator_protocol_core::io::Runner;
use myactuator_tests::fleet::{happened, state};
use myactuator_tests::values::{go_to, millis};

/// An X8-120, whose stall current is 43.8 A, pushes a load that hardly moves. The drive reduces this current to nothing
/// between 80 and 120 °C of the motor and between 70 and 100 °C of the output stage.
#[test]
fn a_hot_motor_gets_less_current_and_the_limit_is_reported() {
    let mut model = MotorParameters::named("RMD-X8-P20-120").unwrap();
    model.derating = Some(DeratingParameters {
        motor_from_c: 80.0,
        motor_to_c: 120.0,
        mos_from_c: 70.0,
        mos_to_c: 100.0,
    });
    let load = Load { inertia_kg_m2: 1e4, ..Load::NONE };
    let fleet = Fleet::new(1).model(model).load(load).on_can(1_000_000).unwrap();
    let drive = &fleet.drives[0];
    let gives = |motor_c: f64, mos_c: f64| {
        drive.with(|drive| {
            drive.plant_mut().force_motor_temperature_c(Some(motor_c)).unwrap();
            drive.plant_mut().force_mos_temperature_c(Some(mos_c)).unwrap();
        });
        fleet.world.run_for(millis(100));
        let limit = |event| if let Event::Limited(limit) = event { Some(limit) } else { None };
        let reported: Vec<Limit> = happened(drive).into_iter().filter_map(limit).collect();
        (state(drive).measurement.current_a, reported)
    };
    fleet.master::<1>().ask(MotorId::MIN, go_to(9_000.0, 900)).unwrap();
    assert_eq!(gives(25.0, 25.0), (43.8, vec![Limit::StallCurrent]));
    // 30 of 40 degrees are left. Below 90 °C of the motor and 85 °C of the output stage there is no error.
    assert_eq!(gives(90.0, 25.0), (0.75 * 43.8, vec![Limit::Temperature]));
    // 20 of 30 degrees are left.
    let (current_a, reported) = gives(90.0, 80.0);
    assert!((current_a - 43.8 * 2.0 / 3.0).abs() < 1e-4, "{current_a}");
    assert_eq!(reported, []);
    assert_eq!(gives(25.0, 25.0), (43.8, vec![Limit::StallCurrent]));
}
