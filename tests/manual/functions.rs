//! 2.35: the functions of 0x20.

use myactuator_protocol_core::command::*;
use myactuator_protocol_core::drive::{FaultLimits, Parameters};
use myactuator_protocol_core::{Channel, Target};
use myactuator_tests::bench::*;
use myactuator_tests::values::*;

use super::commands::{TURN, ends_at, force_to, on_by, within_a_turn};

/// 2.35.4, function 1: clears the turns, makes the position the zero and saves it. It acts after a restart.
#[test]
fn function_1_clears_the_turns_after_a_restart() {
    let mut bench = Bench::default();
    bench.write(FunctionControl::SaveMultiTurn(Switch::On));
    bench.restart();
    bench.turn_to(3.0 * 360.0 + 30.0);
    bench.write(FunctionControl::ClearMultiTurn);
    assert_eq!(bench.reported_angle(), 1_110.0);
    bench.restart();
    assert_eq!(bench.reported_angle(), 0.0);
    assert_eq!(bench.ask(ReadMultiTurnEncoderRaw).raw.raw(), TURN / 12);
    bench.turn_to(5.0 * 360.0 + 30.0);
    bench.power_cycle();
    assert_eq!(bench.reported_angle(), 720.0);
}

/// 2.35.4, function 2: 0x280 reaches a drive only while its id filter is off. The setting is kept after power-off.
#[test]
fn function_2_filters_commands_to_all() {
    let mut bench = Bench::default();
    let all = Channel::Command(Target::All);
    assert_eq!(bench.exchange(all, ReadStatus2.encode()).len(), 1);
    bench.write(FunctionControl::CanIdFilter(Switch::On));
    assert_eq!(bench.exchange(all, ReadStatus2.encode()), []);
    bench.power_cycle();
    assert_eq!(bench.exchange(all, ReadStatus2.encode()), []);
    assert_eq!(bench.exchange(Channel::BusId, BusId::Read.encode()).len(), 1);
    bench.write(FunctionControl::CanIdFilter(Switch::Off));
    assert_eq!(bench.exchange(all, ReadStatus2.encode()).len(), 1);
    // RS485's address 0xCD is no identifier to filter by.
    let mut bench = Bench::on_rs485();
    bench.write(FunctionControl::CanIdFilter(Switch::On));
    assert_eq!(bench.exchange(all, ReadStatus2.encode()).len(), 1);
}

/// 2.35.4, function 4: on, the turns are saved at power-off; off, they are lost. It acts after a restart.
#[test]
fn function_4_saves_the_turns() {
    for (on, restarted, kept) in
        [(Switch::On, true, 1_110.0), (Switch::Off, true, 30.0), (Switch::On, false, 30.0)]
    {
        let mut bench = Bench::default();
        bench.write(FunctionControl::SaveMultiTurn(on));
        if restarted {
            bench.restart();
        }
        bench.turn_to(1_110.0);
        bench.power_cycle();
        assert_eq!(bench.reported_angle(), kept);
        bench.restart();
        assert_eq!(bench.reported_angle(), kept);
    }
}

/// 2.35.4, function 5: a new id acts after a restart and is kept.
#[test]
fn function_5_changes_the_id_after_a_restart() {
    let mut bench = Bench::default();
    bench.write(FunctionControl::SetCanId(id(9)));
    assert_eq!(bench.drive.id(), ID);
    assert!(bench.send(ReadStatus2).is_some());
    bench.restart();
    assert_eq!(bench.send(ReadStatus2), None);
    let command = Channel::Command(Target::Motor(id(9)));
    assert_eq!(bench.exchange(command, ReadStatus2.encode())[0].channel, Channel::Reply(id(9)));
    bench.power_cycle();
    assert_eq!(bench.exchange(command, ReadStatus2.encode())[0].channel, Channel::Reply(id(9)));
}

/// 2.35.4, functions 6 and 7: position commands end at the limits, at once and after power-off.
#[test]
fn functions_6_and_7_limit_positions() {
    let mut bench = Bench::default();
    bench.write(FunctionControl::MaxPositiveAngle(9_000));
    bench.write(FunctionControl::MaxNegativeAngle(-4_500));
    for by_power in [false, true] {
        if by_power {
            bench.power_cycle();
        }
        for (target, end) in [(360.0, 90.0), (-360.0, -45.0), (10.0, 10.0)] {
            ends_at(&mut bench, go_to(target, 500), end);
        }
        ends_at(&mut bench, on_by(500.0), 90.0);
        ends_at(&mut bench, force_to(-500.0, 100), -45.0);
        ends_at(&mut bench, within_a_turn(Direction::CLOCKWISE, 180.0), 90.0);
        ends_at(&mut bench, within_a_turn(Direction::COUNTER_CLOCKWISE, 180.0), -45.0);
        bench.write(Stop);
    }
}

/// 2.35.4, functions 6 and 7: "at once" applies to a moving motor, too. A new limit ends its motion there. A motor that
/// is already beyond the limit is not brought back, because setting a limit is no command to move.
#[test]
fn a_limit_ends_the_motion_under_way() {
    for sign in [1, -1] {
        let (way, limit) = (sign as f32, sign as f64);
        let set = |angle: i32| match sign {
            1 => FunctionControl::MaxPositiveAngle(angle),
            _ => FunctionControl::MaxNegativeAngle(-angle),
        };
        let mut bench = Bench::default();
        bench.go(go_to(360.0 * way, 100), millis(200));
        bench.write(set(9_000));
        bench.run(millis(2_000));
        assert!((bench.angle() - 90.0 * limit).abs() < 0.02, "{}", bench.angle());
        bench.write(set(4_500));
        bench.run(millis(1_000));
        assert!((bench.angle() - 90.0 * limit).abs() < 0.02, "{}", bench.angle());
        ends_at(&mut bench, go_to(360.0 * way, 500), 45.0 * limit);
    }
}

/// 2.35.4, function 3: the drive sends 0x9A every 100 ms while there is an error, and none after it.
#[test]
fn function_3_reports_an_error_every_100_ms() {
    let mut bench = Bench::default();
    bench.write(FunctionControl::ErrorReporting(Switch::On));
    bench.sent.clear();
    let since = bench.now;
    bench.raise(ErrorFlags::OVER_VOLTAGE);
    bench.run(millis(350));
    let reports: Vec<_> =
        bench.sent.iter().map(|(at, packet)| (*at - since, packet.data[0])).collect();
    assert_eq!(reports, [0, 100, 200, 300].map(|after_ms| (millis(after_ms), 0x9A)));
    bench.drive.clear_fault(ErrorFlags::OVER_VOLTAGE);
    bench.sent.clear();
    bench.run(millis(350));
    assert!(bench.sent.is_empty(), "{:?}", bench.sent);
}

/// 2.35.4, function 3: the drive measures once a millisecond. A fault is an error after its confirm time and is
/// reported then: the drive asks to be called at that time.
#[test]
fn an_error_that_is_measured_is_reported_at_once() {
    for confirm_ms in [3, 8, 13] {
        let limits = FaultLimits { confirm_time: millis(confirm_ms), ..FaultLimits::default() };
        let mut bench = Bench::new(Parameters { limits, ..Parameters::default() });
        bench.write(FunctionControl::ErrorReporting(Switch::On));
        bench.sent.clear();
        bench.drive.plant_mut().sensors.supply_voltage_v = 100.0;
        let since = bench.now;
        bench.run(millis(50));
        let (at, packet) = bench.sent[0];
        assert_eq!(packet.data[0], 0x9A);
        let after = at - since;
        let expected = millis(confirm_ms)..=millis(confirm_ms + 1);
        assert!(expected.contains(&after), "{confirm_ms} ms: {after}");
    }
}
