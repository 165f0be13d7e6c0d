//! Each model of the library compared with its data sheet, in runs of the physics.
//!
//! The figures are typed from the sheets once more here, so that a slip in a model's file shows. For the sheets and
//! what they leave out see `host-std/models/README.md`.

use myactuator_host_std::sim::Fleet;
use myactuator_host_std::sim::plant::{MODELS, MotorParameters, SimulatedMotor};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::ReadMultiTurnAngle;
use myactuator_protocol_core::drive::{Actuation, Plant};
use myactuator_protocol_core::io::Runner;

use myactuator_protocol_core::time::Duration;

use super::plant_physics::{MS, OFF, amps, close, held, motor, speed};

/// What a sheet promises of a motor at its nominal voltage.
struct Sheet {
    name: &'static str,
    volts: f64,
    /// Revolutions a minute, A at the input.
    no_load: (f64, NoLoad),
    /// N·m, revolutions a minute, A of torque current, output by input power.
    rated: (f64, f64, f64, f64),
    /// N·m, A of torque current.
    peak: (f64, f64),
    /// Torque on the shaft up to which it stays, N·m.
    back_drive_nm: Option<f64>,
}

enum NoLoad {
    /// Input current, A.
    Input(f64),
    /// Input current, A. It would lose more power than is lost at the rated point, so no motor can have both.
    Contradicted(f64),
    NotGiven,
}
use NoLoad::{Contradicted, Input, NotGiven};

#[rustfmt::skip]
const SHEETS: [Sheet; 12] = [
    Sheet { name: "RMD-X2-P28-7", volts: 24.0, no_load: (178.0, Contradicted(1.0)), rated: (2.5, 142.0, 3.0, 0.63), peak: (7.0, 8.1), back_drive_nm: Some(0.4) },
    Sheet { name: "RMD-X4-P12.5-10", volts: 24.0, no_load: (317.0, Contradicted(1.0)), rated: (4.0, 238.0, 7.8, 0.695), peak: (10.0, 19.5), back_drive_nm: None },
    Sheet { name: "RMD-X4-P36-36", volts: 24.0, no_load: (111.0, Input(0.9)), rated: (10.5, 83.0, 6.1, 0.631), peak: (34.0, 21.5), back_drive_nm: Some(1.14) },
    Sheet { name: "RMD-X6-P8-8", volts: 48.0, no_load: (387.0, Contradicted(1.1)), rated: (4.5, 310.0, 3.6, 0.78), peak: (8.0, 7.2), back_drive_nm: None },
    Sheet { name: "RMD-X8-PRO", volts: 48.0, no_load: (160.0, NotGiven), rated: (13.0, 122.0, 5.0, 0.77), peak: (25.0, 9.6), back_drive_nm: Some(0.61) },
    Sheet { name: "RMD-X6-P20-60", volts: 48.0, no_load: (176.0, Input(0.9)), rated: (20.0, 153.0, 9.5, 0.727), peak: (60.0, 29.1), back_drive_nm: Some(1.6) },
    Sheet { name: "RMD-X10-P7-40", volts: 48.0, no_load: (186.4, Input(0.515)), rated: (15.0, 165.0, 6.5, 0.82), peak: (40.0, 15.0), back_drive_nm: Some(0.62) },
    Sheet { name: "RMD-X10-P35-100", volts: 48.0, no_load: (53.6, Input(0.433)), rated: (50.0, 50.0, 6.7, 0.82), peak: (100.0, 13.5), back_drive_nm: Some(2.88) },
    Sheet { name: "RMD-X8-P20-120", volts: 48.0, no_load: (158.0, Input(1.6)), rated: (43.0, 127.0, 17.6, 0.79), peak: (120.0, 43.8), back_drive_nm: Some(1.5) },
    Sheet { name: "RMD-X8-P33-150", volts: 48.0, no_load: (90.0, Input(1.5)), rated: (66.0, 75.0, 15.0, 0.77), peak: (150.0, 34.0), back_drive_nm: None },
    Sheet { name: "RMD-X12-P20-320", volts: 48.0, no_load: (125.0, Input(2.7)), rated: (85.0, 100.0, 30.0, 0.75), peak: (320.0, 100.0), back_drive_nm: Some(3.8) },
    Sheet { name: "RMD-X15-P20-450", volts: 72.0, no_load: (108.0, Input(3.5)), rated: (145.0, 98.0, 25.0, 0.824), peak: (450.0, 69.2), back_drive_nm: Some(4.0) },
];

impl Sheet {
    /// Without play in the gear: the figures are of a motor that moves its load.
    fn parameters(&self) -> MotorParameters {
        let mut parameters = MotorParameters::named(self.name).unwrap();
        parameters.gear.backlash_arcmin = 0.0;
        parameters
    }

    /// At the nominal voltage, whatever is drawn.
    fn supplied(&self, mut motor: SimulatedMotor) -> SimulatedMotor {
        motor.force_supply_voltage_v(Some(self.volts)).unwrap();
        motor
    }
}

#[test]
fn each_model_has_its_sheet() {
    assert_eq!(MODELS.map(|model| model.name), SHEETS.map(|sheet| sheet.name));
}

/// At the rated speed the rated current is reached and balances the rated torque to 1 %. The input power matches the
/// rated efficiency to 2 %.
#[test]
fn the_rated_point_is_met() {
    for sheet in SHEETS {
        let (torque_nm, rpm, current_a, efficiency) = sheet.rated;
        let mut m = sheet.supplied(held(sheet.parameters()));
        m.set_output_speed_dps(rpm * 6.0).unwrap();
        m.set_external_torque_nm(-torque_nm).unwrap();
        let before = speed(&m);
        let measured = m.advance(&amps(current_a as f32), MS.times(10));
        close(f64::from(measured.current_a), current_a, 1e-6);
        let surplus_nm = (speed(&m) - before) * m.inertia_kg_m2() / 0.01;
        assert!(surplus_nm.abs() < 0.01 * torque_nm, "{}: {surplus_nm}", sheet.name);
        let power_w = sheet.volts * f64::from(measured.supply_current_a);
        close(torque_nm * before / power_w, efficiency, 0.02);
    }
}

/// Without load, and with as much current as it needs, a motor ends at the no-load speed, to 2 %, and draws the no-load
/// current, to 10 %.
#[test]
fn the_no_load_point_is_met() {
    for sheet in SHEETS {
        let (rpm, input) = &sheet.no_load;
        let mut m = sheet.supplied(motor(sheet.parameters()));
        let measured = m.advance(&amps(sheet.peak.1 as f32), Duration::from_secs(2));
        close(m.output_speed_dps() / 6.0, *rpm, 0.02);
        let input_a = f64::from(measured.supply_current_a);
        match *input {
            Input(sheets_a) => close(input_a, sheets_a, 0.1),
            Contradicted(sheets_a) => {
                assert!((0.4..0.85).contains(&(input_a / sheets_a)), "{}: {input_a}", sheet.name);
            }
            NotGiven => {}
        }
    }
}

/// A shaft that hardly turns is pushed with the peak torque at the peak current, to 20 %: the torque of the models is
/// proportional to the current, that of real motors is not.
#[test]
fn the_peak_torque_is_met() {
    for sheet in SHEETS {
        let (torque_nm, current_a) = sheet.peak;
        let mut m = sheet.supplied(held(sheet.parameters()));
        m.set_output_speed_dps(0.1).unwrap();
        let before = speed(&m);
        let measured = m.advance(&amps(current_a as f32), MS.times(10));
        close(f64::from(measured.current_a), current_a, 1e-6);
        close((speed(&m) - before) * m.inertia_kg_m2() / 0.01, torque_nm, 0.2);
    }
}

/// At the rated current, for long, the winding ends 60 K above air of 24 °C.
#[test]
fn the_rated_rise_is_met() {
    for sheet in SHEETS {
        let mut p = sheet.parameters();
        // Less heat capacity: the final temperature is the same, but comes sooner.
        p.thermal.winding_capacity_j_per_k = 1.0;
        p.thermal.mos_capacity_j_per_k = 1.0;
        let mut m = motor(p);
        m.set_ambient_c(24.0).unwrap();
        let locked = Actuation { brake_released: false, ..amps(sheet.rated.2 as f32) };
        let measured = m.advance(&locked, Duration::from_secs(50));
        close(f64::from(measured.motor_temperature_c), 84.0, 0.02);
        // The output stage can bear this permanently.
        assert!(measured.mos_temperature_c < 80.0, "{}: {measured:?}", sheet.name);
    }
}

/// A hand cannot turn the shaft below the back-drive torque.
#[test]
fn the_back_drive_torque_is_met() {
    for sheet in SHEETS {
        let Some(back_drive_nm) = sheet.back_drive_nm else { continue };
        let mut m = motor(sheet.parameters());
        m.set_external_torque_nm(back_drive_nm * 0.99).unwrap();
        m.advance(&OFF, Duration::from_secs(1));
        assert_eq!(m.output_angle_deg(), 0.0, "{}", sheet.name);
        m.set_external_torque_nm(back_drive_nm * 1.01).unwrap();
        m.advance(&OFF, Duration::from_secs(1));
        assert!(m.output_angle_deg() > 0.0, "{}", sheet.name);
    }
}

/// With an encoder on the output shaft a drive knows its position after a start. Without one it knows the position only
/// within a turn of the motor shaft. That is 40 degrees of an RMD-X8-PRO's output, so 30 degrees are -10.
#[test]
fn drive_with_one_encoder_knows_its_position_within_a_motor_turn() {
    for (name, expected_deg) in [("RMD-X6-P20-60", 30.0), ("RMD-X8-PRO", -10.0)] {
        let model = MotorParameters::named(name).unwrap();
        let fleet = Fleet::new(1).model(model).start_angle_deg(30.0).on_can(1_000_000).unwrap();
        let reported = fleet.master::<1>().ask(MotorId::MIN, ReadMultiTurnAngle).unwrap();
        assert!(
            (reported.angle.degrees() - expected_deg).abs() < 0.02,
            "{name}: {}",
            reported.angle
        );
    }
}
