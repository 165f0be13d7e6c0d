//! 2.1 to 2.10: gains, accelerations and the zero, and how long each is kept.

use myactuator_protocol_core::Channel;
use myactuator_protocol_core::command::*;
use myactuator_protocol_core::drive::{Event, IgnoreReason};
use myactuator_protocol_core::units::*;
use myactuator_tests::bench::*;
use myactuator_tests::values::*;

use super::commands::{TURN, most, plan};

/// 2.1 to 2.3: a written gain reads back. RAM loses it at a reset and at power-off, ROM keeps it.
#[test]
fn gains_are_kept_in_rom_only() {
    for &index in PidIndex::ALL {
        let (mut bench, value) = (Bench::default(), gain(1.5));
        let factory = bench.ask(ReadPid { index }).value;
        for restart in [Bench::restart, Bench::power_cycle] {
            bench.write(WritePidRam { index, value });
            assert_eq!(bench.ask(ReadPid { index }), PidGain { index, value });
            restart(&mut bench);
            assert_eq!(bench.ask(ReadPid { index }).value, factory);
        }
        bench.write(WritePidRom { index, value });
        assert_eq!(bench.ask(ReadPid { index }).value, value);
        bench.power_cycle();
        assert_eq!(bench.ask(ReadPid { index }).value, value);
    }
}

/// 2.2: the gains act on the loops: without those of the speed loop the motor does not run.
#[test]
fn gains_act_on_the_loops() {
    let mut bench = Bench::default();
    bench.write(WritePidRam { index: PidIndex::SPEED_KP, value: gain(0.0) });
    bench.write(WritePidRam { index: PidIndex::SPEED_KI, value: gain(0.0) });
    bench.go(turn(100.0), millis(500));
    assert_eq!(bench.speed(), 0.0);
    bench.restart();
    bench.go(turn(100.0), millis(500));
    assert!((bench.speed() - 100.0).abs() < 1.0, "{}", bench.speed());
}

/// 2.2: the gains of the current loop set how fast the current follows.
#[test]
fn current_gains_act_on_the_current() {
    let mut bench = Bench::default();
    bench.write(WritePidRam { index: PidIndex::CURRENT_KP, value: gain(0.0) });
    bench.write(WritePidRam { index: PidIndex::CURRENT_KI, value: gain(10.0) });
    bench.drive.plant_mut().friction_nm_s = 1e9;
    bench.go(push(2.0), millis(95));
    // 2 A · (1 - e^-1).
    assert!((bench.current() - 1.264).abs() < 0.02, "{}", bench.current());
    bench.run(millis(900));
    assert!((bench.current() - 2.0).abs() < 0.01, "{}", bench.current());
}

/// 2.2.5: a current KP of 1.5, like any other, changes how fast the current comes, not how much.
#[test]
fn current_gains_change_no_torque() {
    for kp in [0.0, 0.1, 1.0, 1.5, 100.0] {
        for ki in [0.0, 10.0, 100.0, 10_000.0] {
            if (kp, ki) == (0.0, 0.0) {
                continue;
            }
            let mut bench = Bench::default();
            bench.write(WritePidRam { index: PidIndex::CURRENT_KP, value: gain(kp) });
            bench.write(WritePidRam { index: PidIndex::CURRENT_KI, value: gain(ki) });
            bench.drive.plant_mut().friction_nm_s = 1e9;
            bench.ask(push(3.0));
            let seen = most(&mut bench, millis(1_000), |measured| measured.current_a);
            assert!(seen <= 3.0, "KP {kp}, KI {ki}: {seen} A");
            assert!((bench.current() - 3.0).abs() < 0.01, "KP {kp}, KI {ki}: {}", bench.current());
        }
    }
}

/// 2.4, 2.5: the four accelerations are written to RAM and ROM at once and kept after power-off.
#[test]
fn accelerations_are_kept() {
    let mut bench = Bench::default();
    let values = || AccelerationIndex::ALL.iter().copied().zip(1_000..);
    values().for_each(|(index, dps2)| plan(&mut bench, index, dps2));
    for cycle_power in [false, true] {
        if cycle_power {
            bench.power_cycle();
        }
        for (index, dps2) in values() {
            let reading = bench.ask(ReadAcceleration { index });
            assert_eq!((reading.index, reading.acceleration.raw()), (index, dps2));
        }
    }
}

/// 2.5.1: the range is 100 to 60000. A value outside is ignored.
#[test]
fn an_acceleration_out_of_range_is_ignored() {
    let mut bench = Bench::default();
    for raw in [1_u32, 99, 60_001, u32::MAX] {
        let [a, b, c, d] = raw.to_le_bytes();
        bench.exchange(Channel::Command(ID.into()), [0x43, 0, 0, 0, a, b, c, d]);
        assert!(matches!(
            bench.events.pop(),
            Some(Event::Ignored { reason: IgnoreReason::Malformed(_), .. })
        ));
    }
    assert!(bench.sent.is_empty());
    let index = AccelerationIndex::POSITION_ACCELERATION;
    assert_eq!(bench.ask(ReadAcceleration { index }).acceleration.raw(), 10_000);
}

/// 2.6.3: the position is the raw position less the zero offset. 2.7.1: the raw position is without it. 2.9.1: a new
/// zero is valid only after a restart.
#[test]
fn position_is_raw_less_offset_after_a_restart() {
    let mut bench = Bench::default();
    bench.write(SetEncoderZero { offset: EncoderPulses::from_raw(TURN / 4) });
    assert_eq!(bench.reported_angle(), 0.0);
    assert_eq!(bench.ask(ReadMultiTurnEncoderOffset).offset.raw(), 0);
    bench.restart();
    assert_eq!(bench.reported_angle(), -90.0);
    bench.turn_to(180.0);
    assert_eq!(bench.ask(ReadMultiTurnEncoderRaw).raw.raw(), TURN / 2);
    assert_eq!(bench.ask(ReadMultiTurnEncoderOffset).offset.raw(), TURN / 4);
    assert_eq!(bench.ask(ReadMultiTurnEncoder).position.raw(), TURN / 4);
}

/// 2.10: 0x64 makes the current position the zero and returns it. It is valid after 0x76.
#[test]
fn the_current_position_becomes_the_zero_after_a_reset() {
    let mut bench = Bench::default();
    bench.turn_to(90.0);
    assert_eq!(bench.ask(SetCurrentPositionZero).offset.raw(), TURN / 4);
    assert_eq!(bench.reported_angle(), 90.0);
    bench.restart();
    assert_eq!(bench.reported_angle(), 0.0);
    bench.power_cycle();
    assert_eq!(bench.reported_angle(), 0.0);
    // A second time, when the zero is no longer the encoder's.
    bench.turn_to(135.0);
    assert_eq!(bench.ask(SetCurrentPositionZero).offset.raw(), TURN * 3 / 8);
    bench.restart();
    assert_eq!(bench.reported_angle(), 0.0);
}

/// 2.9.1: 0x63 writes the zero to ROM. 2.9.1, 2.10.1: targets count from the new zero.
#[test]
fn a_zero_is_kept_and_targets_count_from_it() {
    for by_0x64 in [false, true] {
        let mut bench = Bench::default();
        bench.turn_to(90.0);
        match by_0x64 {
            false => bench.write(SetEncoderZero { offset: EncoderPulses::from_raw(TURN / 4) }),
            true => drop(bench.ask(SetCurrentPositionZero)),
        }
        bench.power_cycle();
        assert_eq!(bench.ask(ReadMultiTurnEncoderOffset).offset.raw(), TURN / 4);
        assert_eq!(bench.reported_angle(), 0.0);
        bench.go(go_to(45.0, 500), millis(1_500));
        assert!((bench.reported_angle() - 45.0).abs() < 0.02, "{}", bench.reported_angle());
        let shaft = bench.drive.plant().angle_deg();
        assert!((shaft - 135.0).abs() < 0.02, "{shaft}");
    }
}

/// 2.2.1, 2.3.1, 2.5.1, 2.9.1, 2.10.1, 2.31.1, 2.35.1 advise against writing while the motor moves. They do not forbid
/// it, so it works.
#[test]
fn settings_written_while_the_motor_moves_are_kept() {
    let mut bench = Bench::default();
    bench.go(turn(90.0), millis(500));
    bench.write(WritePidRam { index: PidIndex::SPEED_KI, value: gain(0.5) });
    assert_eq!(bench.ask(ReadPid { index: PidIndex::SPEED_KI }).value, gain(0.5));
    let here = bench.ask(SetCurrentPositionZero).offset;
    assert_eq!(bench.drive.stored_settings().zero_offset, here);
    bench.write(WritePidRom { index: PidIndex::SPEED_KI, value: gain(0.25) });
    plan(&mut bench, AccelerationIndex::SPEED_DECELERATION, 4_321);
    bench.write(SetEncoderZero { offset: EncoderPulses::from_raw(77) });
    bench.write(FunctionControl::MaxPositiveAngle(123_456));
    bench.write(CommunicationLossProtection { timeout: Milliseconds::from_raw(60_000) });
    assert!(bench.speed() > 80.0, "{}", bench.speed());
    bench.power_cycle();
    let kept = bench.drive.settings();
    assert_eq!(kept.gains.speed_ki, gain(0.25));
    assert_eq!(kept.accelerations.speed_deceleration.raw(), 4_321);
    assert_eq!(kept.zero_offset.raw(), 77);
    assert_eq!(kept.max_positive_angle, Some(Angle::from_raw(123_456)));
    assert_eq!(kept.protection_timeout.raw(), 60_000);
}
