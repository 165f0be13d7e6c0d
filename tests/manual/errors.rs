//! 2.14.3 and 8: what errors change.

use myactuator_protocol_core::command::*;
use myactuator_protocol_core::drive::{Drive, IdealPlant, Indicator, Memory, Parameters, Settings};
use myactuator_protocol_core::opcode::{ReplyRule, Usage};
use myactuator_protocol_core::time::Instant;
use myactuator_protocol_core::{AnyCommand, Opcode};
use myactuator_tests::bench::*;
use myactuator_tests::values::*;
use myactuator_tests::vectors::one_of_each;

/// 2.14.3: several errors show at once.
#[test]
fn errors_add_up() {
    let mut bench = Bench::default();
    bench.raise(ErrorFlags::from_bits_retain(0x0016));
    assert_eq!(bench.ask(ReadStatus1).errors.bits(), 0x0016);
    bench.drive.clear_fault(ErrorFlags::all());
    assert_eq!(bench.ask(ReadStatus1).errors, ErrorFlags::STALL | ErrorFlags::OVER_CURRENT);
}

/// 2.19.1 and after: control commands run only without faults; everything else still works.
#[test]
fn a_faulted_drive_still_obeys_the_rest() {
    for command in one_of_each() {
        let opcode = command.opcode().unwrap();
        let mut bench = Bench::default();
        bench.raise(ErrorFlags::OVER_VOLTAGE);
        let reply = bench.send(command);
        assert_eq!(reply.is_some(), !matches!(opcode.reply_rule(), ReplyRule::Silent), "{opcode}");
        assert!(!bench.state().output_on, "{opcode}");
        let moves =
            matches!(opcode.usage(), Usage::SetPoint | Usage::Move) || opcode == Opcode::Stop;
        assert_eq!(bench.not_run().is_some(), moves, "{opcode}");
    }
}

/// 8.1: the light blinks fast with an error of level one, also if a measured one of level two came before or after it.
#[test]
fn the_light_shows_level_one_before_level_two() {
    for voltage_first in [false, true] {
        let mut bench = Bench::default();
        let set_voltage = |bench: &mut Bench, volts| {
            bench.drive.plant_mut().sensors.supply_voltage_v = volts;
            bench.run(millis(50));
        };
        if voltage_first {
            set_voltage(&mut bench, 100.0);
            assert_eq!(bench.state().indicator, Indicator::SlowBlink);
        }
        bench.raise(ErrorFlags::STALL);
        set_voltage(&mut bench, 100.0);
        assert_eq!(bench.state().errors, ErrorFlags::STALL | ErrorFlags::OVER_VOLTAGE);
        assert_eq!(bench.state().indicator, Indicator::FastBlink);
        set_voltage(&mut bench, 48.0);
        assert_eq!(bench.state().errors, ErrorFlags::STALL);
        assert_eq!(bench.state().indicator, Indicator::FastBlink);
        bench.restart();
        assert_eq!(bench.state().indicator, Indicator::On);
    }
}

/// 2.14.3: a failing memory raises "calibration parameters: write error". The command is not acknowledged.
#[test]
fn a_failing_memory_is_an_error_and_not_acknowledged() {
    struct Worn;
    impl Memory for Worn {
        type Error = ();
        fn load(&mut self) -> Result<Option<Settings>, ()> {
            Ok(None)
        }
        fn store(&mut self, _: &Settings) -> Result<(), ()> {
            Err(())
        }
    }
    let now = Instant::ZERO;
    let mut drive = Drive::new(Parameters::default(), IdealPlant::default(), Worn, now).unwrap();
    let write = WritePidRom { index: PidIndex::SPEED_KP, value: gain(9.0) };
    let packet = AnyCommand::from(write).packet(ID.into()).unwrap();
    drive.handle_packet(&packet, now);
    assert_eq!(drive.poll_transmit(now + millis(5)), None);
    assert_eq!(drive.state().errors, ErrorFlags::CALIBRATION_PARAMETERS);
    assert_ne!(drive.settings().gains.speed_kp, gain(9.0));
}
