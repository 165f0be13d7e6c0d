//! 2.6 to 2.16, 2.29, 2.30, 2.33: a reading returns what is measured.

use myactuator_protocol_core::command::*;
use myactuator_protocol_core::drive::{
    Actuation, Drive, Measurement, Parameters, Plant, RamMemory,
};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::*;
use myactuator_tests::bench::*;
use myactuator_tests::values::*;
use myactuator_tests::vectors::one_of_each;

use super::commands::{TURN, within_a_turn};

/// 2.11.3: single-turn encoder position, raw position and offset.
#[test]
fn single_turn_encoder_reads_position_raw_position_and_offset() {
    let mut bench = Bench::default();
    bench.write(SetEncoderZero { offset: EncoderPulses::from_raw(9_355) });
    bench.restart();
    bench.turn_to(f64::from(16_384 + 11_454) * 360.0 / f64::from(TURN));
    let reading = bench.ask(ReadSingleTurnEncoder);
    let reported = [reading.position, reading.raw, reading.offset].map(SingleTurnPulses::raw);
    assert_eq!(reported, [2_099, 11_454, 9_355]); // the manual's example, 2.11.4
}

/// 2.12.3: the angle counts turns, in 0.01 degrees. 2.13.3: within a turn it grows clockwise and begins anew. 2.15.3:
/// feedback has it in degrees, up to ±32767.
#[test]
fn the_angle_counts_turns_and_feedback_saturates() {
    let mut bench = Bench::default();
    for (angle, fine, within_a_turn, coarse) in [
        (0.0, 0, 0, 0),
        (100.0, 10_000, 10_000, 100),
        (360.0, 36_000, 0, 360),
        (400.0, 40_000, 4_000, 400),
        (-90.0, -9_000, 27_000, -90),
        (-725.5, -72_550, 35_450, -726),
        (40_000.0, 4_000_000, 4_000, 32_767),
        (-40_000.0, -4_000_000, 32_000, -32_767),
    ] {
        bench.turn_to(angle);
        assert_eq!(bench.ask(ReadMultiTurnAngle).angle.raw(), fine);
        let pulses = (angle * f64::from(TURN) / 360.0).round() as i32;
        assert_eq!(bench.ask(ReadMultiTurnEncoder).position.raw(), pulses);
        let reported = bench.ask(ReadSingleTurnAngle).angle.raw();
        assert!(reported.abs_diff(within_a_turn) <= 1, "{angle}: {reported}");
        assert_eq!(bench.feedback().angle.raw(), coarse);
    }
}

/// 2.14.3, 2.16.3: temperatures, brake command, voltage, errors and phase currents are what is measured.
#[test]
fn status_reports_the_measured_values() {
    let mut bench = Bench::with_brake();
    let sensors = &mut bench.drive.plant_mut().sensors;
    sensors.motor_temperature_c = 50.0;
    sensors.mos_temperature_c = 61.0;
    sensors.supply_voltage_v = 48.5;
    bench.write(ReleaseBrake);
    bench.raise(ErrorFlags::ENCODER_CALIBRATION);
    let status = bench.ask(ReadStatus1);
    assert_eq!((status.temperature.raw(), status.mosfet_temperature.raw()), (50, 61));
    assert_eq!((status.voltage.raw(), status.errors), (485, ErrorFlags::ENCODER_CALIBRATION));
    bench.drive.clear_fault(ErrorFlags::all());
    bench.write(ReleaseBrake);
    bench.go(push(2.0), millis(20));
    let status = bench.ask(ReadStatus3);
    let phases =
        [status.phase_a_current, status.phase_b_current, status.phase_c_current].map(Current::raw);
    assert_eq!(phases, [200, -100, -100]);
    assert_eq!(bench.ask(ReadStatus1).brake, BrakeCommand::RELEASE);
    bench.write(LockBrake);
    assert_eq!(bench.ask(ReadStatus1).brake, BrakeCommand::LOCK);
}

/// 2.16.4: 0x9D returns the motor's 50 °C and phase currents of 30.1, -15.2 and -16 A in the bytes of the example.
#[test]
fn phase_currents_are_those_of_the_example() {
    struct Measured(Measurement);
    impl Plant for Measured {
        fn advance(&mut self, _: &Actuation, _: Duration) -> Measurement {
            self.0
        }
    }
    let measured = Measured(Measurement {
        phase_currents_a: [30.1, -15.2, -16.0],
        motor_temperature_c: 50.0,
        mos_temperature_c: 61.0,
        supply_voltage_v: 48.0,
        encoder_ok: true,
        ..Measurement::default()
    });
    let now = Instant::ZERO;
    let mut drive = Drive::new(Parameters::default(), measured, RamMemory::default(), now).unwrap();
    drive.handle_packet(&ReadStatus3.packet(ID), now);
    let reply = drive.poll_transmit(now + millis(5)).unwrap();
    assert_eq!(reply.data, [0x9D, 0x32, 0xC2, 0x0B, 0x10, 0xFA, 0xC0, 0xF9]);
}

/// 2.29.3: the run time is a u32. So after 2^32 ms, 49.7 days, it begins anew, which is no restart.
#[test]
fn run_time_begins_anew_after_49_7_days() {
    // A drive with slow loops, for a quick test.
    let control_period = Duration::from_secs(1_000);
    let mut bench = Bench::new(Parameters { control_period, ..Parameters::default() });
    bench.run(Duration::from_secs(4_294_000));
    let before = bench.ask(ReadRunTime);
    assert_eq!(before.run_time.raw(), 4_294_000_000);
    bench.run(Duration::from_secs(1_000));
    let after = bench.ask(ReadRunTime);
    assert_eq!(after.run_time.raw(), 32_704); // 4 295 000 000 - 4 294 967 296
    assert!(!after.shows_restart_since(before));
}

/// 2.29.3: run time in ms since the start. 2.30, 2.33: version date and model are those of the drive.
#[test]
fn run_time_version_date_and_model_are_those_of_the_drive() {
    let mut bench = Bench::new(Parameters {
        version_date: VersionDate::from_raw(20_220_206),
        ..Parameters::default()
    });
    bench.run(millis(1_234));
    assert_eq!(bench.ask(ReadRunTime).run_time.raw(), 1_234);
    assert_eq!(bench.ask(ReadVersionDate).version_date.raw(), 20_220_206);
    assert_eq!(bench.ask(ReadModel).model.as_str(), Some("X8S2V10"));
    bench.power_cycle();
    assert_eq!(bench.ask(ReadRunTime).run_time.raw(), 1);
}

/// 2.15.4, 2.19.4 to 2.24.4: 0x9C and every command that is answered with feedback return 50 °C, 1 A, 500 dps and 45
/// degrees, and the same backwards, in the bytes of the examples.
#[test]
fn feedback_is_that_of_the_examples() {
    let forwards = [50, 0x64, 0x00, 0xF4, 0x01, 0x2D, 0x00];
    let backwards = [50, 0x9C, 0xFF, 0x0C, 0xFE, 0xD3, 0xFF];
    for (sign, rest) in [(1.0, forwards), (-1.0, backwards)] {
        for command in one_of_each() {
            let byte = command.encode()[0];
            if ![0x9C, 0xA1, 0xA2, 0xA4, 0xA8, 0xA9].contains(&byte) {
                continue;
            }
            let mut bench = turning(sign as f32, 45.0 * sign);
            let [opcode, reported @ ..] = bench.send(command).unwrap();
            assert_eq!((opcode, reported), (byte, rest), "{byte:#X}");
        }
        // 2.22.4: 1000 pulses beyond the motor shaft's zero, instead of the angle.
        let mut bench = turning(sign as f32, 1_000.0 * 360.0 / f64::from(TURN));
        let to = within_a_turn(Direction::CLOCKWISE, 360.0);
        let reported = bench.send(to).unwrap();
        assert_eq!((reported[0], &reported[1..6]), (0xA6, &rest[..5]));
        assert_eq!(reported[6..], [0xE8, 0x03]);
    }
}

/// A motor of 50 °C that passes this angle with 500 dps and 1 A, forwards (1) or backwards (-1).
fn turning(sign: f32, angle_deg: f64) -> Bench {
    let mut bench = Bench::default();
    let motor = bench.drive.plant_mut();
    motor.sensors.motor_temperature_c = 50.0;
    // So heavy that no command changes its speed.
    motor.inertia_kg_m2 = 1e9;
    motor.friction_nm_s = 0.0;
    bench.ask(push(sign));
    let speed_dps = 500.0 * f64::from(sign);
    let motor = bench.drive.plant_mut();
    motor.speed_rad_s = speed_dps.to_radians();
    // A step of the loops is 0.1 ms, and the next one ends at this angle.
    motor.set_angle_deg(angle_deg - speed_dps * 1e-4);
    bench.run(Duration::from_micros(100));
    bench
}
