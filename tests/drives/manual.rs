//! What the manual says that a drive does, sentence by sentence, on an ideal motor.
//!
//! The documentation of each test gives the sentence's section and its meaning. Motor: 0.02 kg·m²,
//! 2 N·m/A, friction 0.05 N·m·s; rated current 6 A, stall current 12 A; 16384 pulses, gear 6.

use myactuator_protocol_core::command::*;
use myactuator_protocol_core::drive::{
    Bus, Drive, Event, FaultLimits, IdealPlant, IgnoreReason, Measurement, Memory, NotRunReason,
    Parameters, Settings,
};
use myactuator_protocol_core::opcode::{ReplyRule, Usage};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::*;
use myactuator_protocol_core::wire::rs485;
use myactuator_protocol_core::{AnyCommand, AnyReply, Channel, Kind, Opcode, Packet, Target};
use myactuator_tests::bench::*;
use myactuator_tests::values::*;
use myactuator_tests::vectors::one_of_each;

const TURN: i32 = 98_304;

fn plan(bench: &mut Bench, index: AccelerationIndex, dps2: u32) {
    let acceleration = Acceleration::try_from_raw(dps2).unwrap();
    bench.write(WriteAcceleration { index, acceleration });
}

/// 0xA8 by this angle, at 500 dps at the most.
fn on_by(angle_deg: f32) -> IncrementalPosition {
    IncrementalPosition { max_speed: up_to(500), angle: degrees(angle_deg) }
}

/// 0xA9 to this angle, at 500 dps at the most.
fn force_to(angle_deg: f32, torque_percent: u8) -> ForcePosition {
    let (max_torque, max_speed) = (percent(torque_percent), up_to(500));
    ForcePosition { max_torque, max_speed, angle: degrees(angle_deg) }
}

/// 0xA6 to this angle within a turn, at 500 dps at the most.
fn within_a_turn(direction: Direction, angle_deg: f32) -> SingleTurnPosition {
    let angle = SingleTurnTarget::from_degrees(angle_deg).unwrap();
    SingleTurnPosition { direction, max_speed: up_to(500), angle }
}

/// Carries the command out for 1.5 s, after which the shaft is at this angle.
#[track_caller]
fn ends_at<C: Command + Into<AnyCommand>>(bench: &mut Bench, command: C, angle_deg: f64) {
    bench.go(command, millis(1_500));
    assert!((bench.angle() - angle_deg).abs() < 0.02, "{}, not {angle_deg}", bench.angle());
}

/// The largest of what `figure` reads off the drive each millisecond of this span.
fn most(bench: &mut Bench, span: Duration, figure: fn(&Measurement) -> f32) -> f32 {
    let mut largest = 0.0_f32;
    bench.watch(span, |state| largest = largest.max(figure(&state.measurement)));
    largest
}

/// 2 to 7: each kind is answered as its row in the table says.
#[test]
fn every_kind_is_answered_by_its_rule() {
    for command in one_of_each() {
        let opcode = command.opcode().unwrap();
        let reply = Bench::default().send(command);
        let is_same = reply == Some(command.encode());
        let is_answer = reply.is_some_and(|reply| {
            Kind::Known(opcode).answers(&command.encode(), &reply)
                && AnyReply::decode_as(opcode, &reply).is_ok()
        });
        let is_right = match opcode.reply_rule() {
            ReplyRule::Same | ReplyRule::Acknowledge => is_same,
            ReplyRule::Values => is_answer,
            ReplyRule::Silent => reply.is_none(),
            ReplyRule::Garbled => !is_same,
            other => panic!("{opcode}: {other:?}"),
        };
        assert!(is_right, "{opcode}: {reply:02X?}");
    }
}

/// 1.1.2, 4.4, 5.3: replies come at 0x240 + ID, those to 0x300 at 0x300, those to 0x400 + ID at
/// 0x500 + ID.
#[test]
fn replies_come_on_their_channels() {
    let mut bench = Bench::default();
    let mut channel = |channel, data| bench.exchange(channel, data)[0].channel;
    let command = Channel::Command(ID.into());
    assert_eq!(channel(command, ReadStatus2.encode()), Channel::Reply(ID));
    assert_eq!(channel(Channel::Command(Target::All), ReadStatus2.encode()), Channel::Reply(ID));
    assert_eq!(channel(Channel::BusId, BusId::Read.encode()), Channel::BusId);
    assert_eq!(channel(Channel::Motion(ID), [0x80; 8]), Channel::MotionReply(ID));
}

/// 1.1.2: a command at another's identifier, and another's reply, change nothing.
#[test]
fn what_is_for_others_is_not_heard() {
    let mut bench = Bench::default();
    for channel in [
        Channel::Command(Target::Motor(id(2))),
        Channel::Motion(id(2)),
        Channel::Reply(ID),
        Channel::MotionReply(ID),
    ] {
        assert_eq!(bench.exchange(channel, [0xA2, 0, 0, 0, 0x10, 0x27, 0, 0]), []);
    }
    assert!(!bench.state().output_on);
    assert_eq!(bench.events, [Event::Started]);
}

/// 2.1 to 2.3: a gain written reads back; RAM loses it by a reset and with the power, ROM keeps it.
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

/// 2.2: the gains are those of the loops: without the speed loop's, the motor does not run.
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

/// 2.2: and so are the current loop's: they set how fast the current follows.
#[test]
fn current_gains_act_on_the_current() {
    let mut bench = Bench::default();
    bench.write(WritePidRam { index: PidIndex::CURRENT_KP, value: gain(0.0) });
    bench.write(WritePidRam { index: PidIndex::CURRENT_KI, value: gain(10.0) });
    bench.drive.plant_mut().friction_nm_s = 1e9;
    bench.go(push(2.0), millis(95));
    // 2 A less e^-1.
    assert!((bench.current() - 1.264).abs() < 0.02, "{}", bench.current());
    bench.run(millis(900));
    assert!((bench.current() - 2.0).abs() < 0.01, "{}", bench.current());
}

/// 2.2.5: a current KP of 1.5, and any other, changes how fast a current comes and not how much.
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

/// 2.5.1: the range is 100 to 60000; what is outside is not taken.
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

/// 2.6.3: the position is the raw position less the zero offset; 2.7.1: the raw one is without it; 2.9.1:
/// a new zero is valid only after a restart.
#[test]
fn position_is_raw_less_offset_after_a_restart() {
    let mut bench = Bench::default();
    bench.write(SetEncoderZero { offset: EncoderPulses::from_raw(TURN / 4) });
    assert_eq!(bench.told_angle(), 0.0);
    bench.restart();
    assert_eq!(bench.told_angle(), -90.0);
    bench.turn_to(180.0);
    assert_eq!(bench.ask(ReadMultiTurnEncoderRaw).raw.raw(), TURN / 2);
    assert_eq!(bench.ask(ReadMultiTurnEncoderOffset).offset.raw(), TURN / 4);
    assert_eq!(bench.ask(ReadMultiTurnEncoder).position.raw(), TURN / 4);
}

/// 2.10: 0x64 makes the current position the zero, tells it, and it is valid after 0x76.
#[test]
fn the_current_position_becomes_the_zero_after_a_reset() {
    let mut bench = Bench::default();
    bench.turn_to(90.0);
    assert_eq!(bench.ask(SetCurrentPositionZero).offset.raw(), TURN / 4);
    assert_eq!(bench.told_angle(), 90.0);
    bench.restart();
    assert_eq!(bench.told_angle(), 0.0);
    bench.power_cycle();
    assert_eq!(bench.told_angle(), 0.0);
    // A second time, with a zero that is none of the encoder's.
    bench.turn_to(135.0);
    assert_eq!(bench.ask(SetCurrentPositionZero).offset.raw(), TURN * 3 / 8);
    bench.restart();
    assert_eq!(bench.told_angle(), 0.0);
}

/// 2.11.3: single-turn encoder position, raw position and offset.
#[test]
fn the_single_turn_encoder_tells_all_three() {
    let mut bench = Bench::default();
    bench.write(SetEncoderZero { offset: EncoderPulses::from_raw(9_355) });
    bench.restart();
    bench.turn_to(f64::from(16_384 + 11_454) * 360.0 / f64::from(TURN));
    let reading = bench.ask(ReadSingleTurnEncoder);
    let told = [reading.position, reading.raw, reading.offset].map(SingleTurnPulses::raw);
    assert_eq!(told, [2_099, 11_454, 9_355]); // the manual's example, 2.11.4
}

/// 2.12.3: the angle counts turns, in 0.01 degrees; 2.13.3: within a turn it grows clockwise and begins
/// anew; 2.15.3: feedback tells it in degrees up to ±32767.
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
        let told = bench.ask(ReadSingleTurnAngle).angle.raw();
        assert!(told.abs_diff(within_a_turn) <= 1, "{angle}: {told}");
        assert_eq!(bench.feedback().angle.raw(), coarse);
    }
}

/// 2.14.3, 2.16.3: temperatures, brake command, voltage, errors and phase currents are what is measured.
#[test]
fn status_tells_what_is_measured() {
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

/// 2.17.1: switches the output off and leaves every closed loop.
#[test]
fn shutdown_leaves_the_motor_free() {
    let mut bench = Bench::default();
    bench.go(turn(100.0), millis(200));
    bench.write(Shutdown);
    assert_eq!(bench.ask(ReadRunningMode).mode, Mode::from_raw(0));
    assert_eq!((bench.state().output_on, bench.current()), (false, 0.0));
    bench.drive.plant_mut().load_nm = 1.0;
    let before = bench.angle();
    bench.run(millis(500));
    assert!(bench.angle() > before + 90.0);
}

/// 2.18.1: stops the motor and holds it, so that an outside force does not move it.
#[test]
fn stop_holds_against_a_force() {
    let mut bench = Bench::default();
    bench.go(turn(300.0), millis(300));
    bench.write(Stop);
    bench.run(millis(1_000));
    let held = bench.angle();
    assert!(bench.speed().abs() < 0.1, "{}", bench.speed());
    bench.drive.plant_mut().load_nm = 10.0;
    bench.run(millis(1_000));
    assert!((bench.angle() - held).abs() < 0.2, "{} from {held}", bench.angle());
    assert!((bench.current() + 5.0).abs() < 0.05); // 10 N·m / 2 N·m/A
    bench.write(Stop);
    bench.run(millis(200));
    assert!((bench.angle() - held).abs() < 0.2);
}

/// 2.19.1: 0xA1 controls the torque current.
#[test]
fn torque_sets_the_current() {
    let mut bench = Bench::default();
    bench.ask(push(-1.0));
    assert_eq!(bench.ask(ReadRunningMode).mode, Mode::CURRENT);
    bench.run(millis(50));
    assert_eq!(bench.feedback().current.raw(), -100);
    assert!(bench.speed() < 0.0);
    // 2.20.2, remark 1: nothing exceeds the stall current.
    bench.ask(push(300.0));
    bench.watch(millis(20), |state| assert!(state.measurement.current_a <= 12.0));
}

/// 2.19.1: a motor with a brake does not take 0xA1 until 0x77 has opened it.
#[test]
fn torque_needs_the_brake_released_first() {
    let mut bench = Bench::with_brake();
    bench.ask(push(1.0));
    assert_eq!(bench.not_run(), Some(NotRunReason::BrakeLocked));
    bench.run(millis(100));
    assert_eq!((bench.current(), bench.angle()), (0.0, 0.0));
    bench.write(ReleaseBrake);
    bench.run(millis(100));
    assert_eq!(bench.current(), 0.0, "the old command must not come alive");
    bench.go(push(1.0), millis(100));
    assert!(bench.angle() > 1.0);
}

/// 2.20.1: 0xA2 controls the speed of the output shaft, in 0.01 dps, either way.
#[test]
fn speed_is_reached_either_way() {
    let mut bench = Bench::default();
    for target in [100.0, -100.0, 0.5] {
        bench.ask(turn(target));
        assert_eq!(bench.ask(ReadRunningMode).mode, Mode::SPEED);
        bench.run(millis(1_000));
        assert!((bench.speed() - target).abs() < 0.01, "{target}: {}", bench.speed());
    }
}

/// 2.20.2, remark 2, 2.4.4: the speed planning accelerations limit how fast the speed changes; 3: with 0
/// only the current does.
#[test]
fn speed_follows_its_ramps() {
    let mut bench = Bench::default();
    plan(&mut bench, AccelerationIndex::SPEED_ACCELERATION, 1_000);
    plan(&mut bench, AccelerationIndex::SPEED_DECELERATION, 500);
    bench.go(turn(200.0), millis(95));
    assert!((bench.speed() - 95.0).abs() < 10.0, "{}", bench.speed());
    bench.run(millis(400));
    bench.go(turn(100.0), millis(95));
    assert!((bench.speed() - 150.0).abs() < 5.0, "{}", bench.speed());
    bench.run(millis(300));
    plan(&mut bench, AccelerationIndex::SPEED_ACCELERATION, 0);
    bench.ask(turn(1_000.0));
    // 24 N·m / 0.02 kg·m² give 900 dps in 13 ms.
    bench.run(millis(45));
    assert!((bench.speed() - 1_000.0).abs() < 60.0, "{}", bench.speed());
}

/// 2.4.4: the deceleration is "in the same direction", the acceleration "includes both directions": a
/// reversal is one acceleration from end to end.
#[test]
fn a_reversal_is_an_acceleration() {
    let mut bench = Bench::default();
    plan(&mut bench, AccelerationIndex::SPEED_ACCELERATION, 1_000);
    plan(&mut bench, AccelerationIndex::SPEED_DECELERATION, 200);
    bench.go(turn(100.0), millis(500));
    bench.go(turn(-100.0), millis(95));
    assert!(bench.speed().abs() < 10.0, "{}", bench.speed());
    bench.run(millis(95));
    assert!((bench.speed() + 95.0).abs() < 8.0, "{}", bench.speed());
    // 0 has no direction: a way to it is a deceleration.
    bench.go(turn(0.0), millis(195));
    assert!((bench.speed() + 60.0).abs() < 8.0, "{}", bench.speed());
}

/// 2.20.1: maxTorque is a percentage of the rated current; 0, or above the stall current, is no limit
/// but the stall current.
#[test]
fn speed_mode_limits_its_torque() {
    for (limit, largest) in [(50, 3.0), (100, 6.0), (0, 12.0), (255, 12.0)] {
        let mut bench = Bench::default();
        plan(&mut bench, AccelerationIndex::SPEED_ACCELERATION, 0);
        let run = Speed { max_torque: percent(limit), speed: dps(1_500.0) };
        bench.put(Channel::Command(ID.into()), run.encode());
        let seen = most(&mut bench, millis(100), |measured| measured.current_a);
        assert!((seen - largest).abs() < 0.01, "{limit} %: {seen} A");
    }
}

/// 2.21.1: a planned motion accelerates as set even after the shaft was held back.
#[test]
fn a_shaft_that_was_held_back_does_not_jump() {
    for shut_down in [true, false] {
        let mut bench = Bench::default();
        plan(&mut bench, AccelerationIndex::POSITION_ACCELERATION, 1_000);
        let go = go_to(180.0, 500);
        bench.drive.plant_mut().friction_nm_s = 1e9;
        bench.go(go, millis(600));
        bench.drive.plant_mut().friction_nm_s = 0.05;
        // Without a shutdown between, a new command is a new motion all the same.
        if shut_down {
            bench.write(Shutdown);
        }
        bench.go(go, millis(95));
        assert!((bench.speed() - 100.0).abs() < 15.0, "{}", bench.speed());
    }
}

/// 2.21.1: with a position acceleration the drive plans the motion: accelerations and maxSpeed hold.
#[test]
fn an_absolute_position_is_planned() {
    let mut bench = Bench::default();
    plan(&mut bench, AccelerationIndex::POSITION_ACCELERATION, 2_000);
    plan(&mut bench, AccelerationIndex::POSITION_DECELERATION, 1_000);
    bench.ask(go_to(360.0, 500));
    assert_eq!(bench.ask(ReadRunningMode).mode, Mode::POSITION);
    let (mut fastest, mut farthest, mut speeds) = (0.0_f32, 0.0_f64, Vec::new());
    bench.watch(millis(1_600), |state| {
        fastest = fastest.max(state.measurement.speed_dps);
        farthest = farthest.max(state.angle_deg);
        speeds.push(state.measurement.speed_dps);
    });
    // 250 ms up, 500 ms down, and 172.5 degrees at 500 dps between: 1095 ms.
    assert!((bench.angle() - 360.0).abs() < 0.02, "{}", bench.angle());
    assert!((490.0..510.0).contains(&fastest), "{fastest}");
    assert!(farthest < 360.5, "{farthest}");
    assert!((speeds[115] - 250.0).abs() < 20.0, "{}", speeds[115]); // 125 ms after the command
    assert!((speeds[835] - 250.0).abs() < 20.0, "{}", speeds[835]); // 250 ms before the end
}

/// 2.4.4: the deceleration is its own; where it is 0, the acceleration serves for both.
#[test]
fn a_deceleration_of_zero_is_the_accelerations() {
    for (deceleration, speed_near_the_end) in [(0, 200.0), (500, 141.0)] {
        let mut bench = Bench::default();
        plan(&mut bench, AccelerationIndex::POSITION_ACCELERATION, 1_000);
        plan(&mut bench, AccelerationIndex::POSITION_DECELERATION, deceleration);
        bench.ask(go_to(360.0, 400));
        while bench.angle() < 340.0 {
            bench.run(millis(1));
        }
        // v² = 2·d·s, 20 degrees before the end.
        assert!((bench.speed() - speed_near_the_end).abs() < 8.0, "{}", bench.speed());
    }
}

/// 2.21.1: the direction follows from target and position; the angle is from the zero.
#[test]
fn an_absolute_position_is_gone_to_from_anywhere() {
    let mut bench = Bench::default();
    for target in [360.0, -360.0, -359.5, 0.0] {
        bench.go(go_to(target, 0), millis(2_000));
        assert!((bench.angle() - f64::from(target)).abs() < 0.02, "{target}: {}", bench.angle());
    }
}

/// 2.21.1: with acceleration 0 the loop tracks the target directly, no faster than maxSpeed.
#[test]
fn acceleration_zero_tracks_directly() {
    for (max_speed, at_most) in [(200, 215.0), (0, 2_400.0)] {
        let mut bench = Bench::default();
        plan(&mut bench, AccelerationIndex::POSITION_ACCELERATION, 0);
        bench.ask(go_to(90.0, max_speed));
        let fastest = most(&mut bench, millis(1_500), |measured| measured.speed_dps);
        assert!(fastest < at_most, "{fastest}");
        assert!(fastest > at_most * 0.4, "{fastest}");
        assert!((bench.angle() - 90.0).abs() < 0.05, "{}", bench.angle());
    }
}

/// 2.22.1: 0xA6 turns clockwise (0) or counter-clockwise (1) to an angle within a turn.
#[test]
fn a_single_turn_position_turns_as_told() {
    for (direction, end) in [(Direction::CLOCKWISE, 270.0), (Direction::COUNTER_CLOCKWISE, -90.0)] {
        let mut bench = Bench::default();
        // The same command again is a command to stay.
        for _ in 0..2 {
            ends_at(&mut bench, within_a_turn(direction, 270.0), end);
        }
    }
}

/// 2.22.4: 360 degrees are 0 degrees.
#[test]
fn single_turn_360_degrees_are_0() {
    let mut bench = Bench::default();
    bench.turn_to(90.0);
    let reply = bench.ask(within_a_turn(Direction::COUNTER_CLOCKWISE, 360.0));
    assert_eq!(reply.encoder.raw(), 24_576 % 16_384);
    bench.run(millis(1_000));
    assert!(bench.angle().abs() < 0.02, "{}", bench.angle());
}

/// 2.22.1: 0xA6 is for single-turn mode, which a drive is in while function 4 is off.
#[test]
fn a_single_turn_position_needs_single_turn_mode() {
    let mut bench = Bench::default();
    bench.write(FunctionControl::SaveMultiTurn(Switch::On));
    bench.restart();
    bench.ask(within_a_turn(Direction::CLOCKWISE, 90.0));
    assert_eq!(bench.not_run(), Some(NotRunReason::NotSingleTurn));
    bench.run(millis(500));
    assert_eq!(bench.angle(), 0.0);
}

/// 2.23.1: 0xA8 moves on from the current position; the sign is the direction.
#[test]
fn an_incremental_position_adds_up() {
    let mut bench = Bench::default();
    for (by, end) in [(90.0, 90.0), (90.0, 180.0), (-270.0, -90.0)] {
        bench.go(on_by(by), millis(1_500));
        assert!((bench.angle() - end).abs() < 0.05, "{end}: {}", bench.angle());
    }
}

/// 2.24.1: 0xA9 goes to a position with its torque limited to a percentage of the rated current; above
/// the stall current it is not limited.
#[test]
fn a_force_position_limits_its_torque() {
    for (limit, largest) in [(10, 0.6), (60, 3.6), (255, 12.0)] {
        let mut bench = Bench::default();
        bench.drive.plant_mut().load_nm = -30.0; // more than any limit lifts
        bench.ask(force_to(360.0, limit));
        let seen = most(&mut bench, millis(300), |measured| measured.current_a);
        assert!((seen - largest).abs() < 0.01, "{limit} %: {seen} A");
    }
    ends_at(&mut Bench::default(), force_to(360.0, 60), 360.0);
}

/// 2.26: 0x76 restarts the program: no reply, no mode, run time from 0; and what nothing says is saved ends:
/// active replies and error reporting.
#[test]
fn a_reset_starts_anew() {
    let mut bench = Bench::default();
    bench.run(millis(10_000));
    bench.ask(push(0.1));
    bench.write(FunctionControl::ErrorReporting(Switch::On));
    bench.send(report(Opcode::ReadStatus2, Switch::On, 1));
    bench.restart();
    assert!(!bench.state().output_on);
    assert_eq!(bench.ask(ReadRunTime).run_time.raw(), 5);
    assert!(bench.events.contains(&Event::Reset));
    bench.sent.clear();
    bench.raise(ErrorFlags::OVER_VOLTAGE);
    bench.run(millis(300));
    assert!(bench.sent.is_empty(), "{:?}", bench.sent);
    assert!(bench.send(ReadStatus2).is_some());
}

/// 2.35.4, function 3: what is measured, once a millisecond, is an error after its confirm time and reported then:
/// the drive asks to be called for it.
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

/// 2.27, 2.28: 0x77 lets the shaft go, 0x78 locks it, and without power it is locked.
#[test]
fn the_brake_holds_and_lets_go() {
    let mut bench = Bench::with_brake();
    bench.drive.plant_mut().load_nm = 1.0;
    bench.run(millis(100));
    assert_eq!(bench.angle(), 0.0);
    bench.write(ReleaseBrake);
    bench.run(millis(100));
    assert!(bench.angle() > 1.0);
    bench.write(LockBrake);
    let held = bench.angle();
    bench.run(millis(100));
    assert_eq!(bench.angle(), held);
    bench.write(ReleaseBrake);
    bench.drive.power_off(bench.now);
    let held = bench.drive.plant().angle_rad;
    bench.run(millis(100));
    assert_eq!(bench.drive.plant().angle_rad, held);
}

/// 2.28.1: with the brake locked the motor cannot run on.
#[test]
fn locking_the_brake_ends_the_run() {
    let mut bench = Bench::with_brake();
    bench.go(turn(100.0), millis(200));
    assert!(bench.speed() > 90.0);
    bench.write(LockBrake);
    assert!(!bench.state().output_on);
    bench.write(Stop); // holds already, and must not open it
    assert_eq!(bench.not_run(), None, "which is no refusal");
    assert_eq!(bench.ask(ReadStatus1).brake, BrakeCommand::LOCK);
}

/// 2.29.3: run time in ms since the start. 2.30, 2.33: version date and model are those of the drive.
#[test]
fn system_reads_tell_what_the_drive_is() {
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

fn protected() -> Bench {
    let mut bench = Bench::with_brake();
    let timeout = Milliseconds::from_raw(100);
    bench.write(CommunicationLossProtection { timeout });
    bench.ask(turn(100.0));
    bench
}

/// 2.31.1: beyond the set time without a command the output is cut and the brake locked.
#[test]
fn communication_loss_cuts_and_locks() {
    let mut bench = protected();
    for _ in 0..20 {
        bench.run(millis(90));
        bench.feedback(); // a read keeps it running
    }
    assert!(bench.speed() > 99.0);
    bench.run(millis(94));
    assert!(bench.state().output_on);
    bench.run(millis(3));
    let state = bench.state();
    assert!(!state.output_on && state.communication_lost);
    assert_eq!((state.brake, state.measurement.speed_dps), (BrakeCommand::LOCK, 0.0));
    assert_eq!(bench.events.last(), Some(&Event::ProtectionTripped));
}

/// 2.31.1: to run again, steady communication must be established first.
#[test]
fn the_motor_runs_again_only_once_communication_is_steady() {
    let mut bench = protected();
    bench.run(millis(200));
    let go = turn(100.0);
    bench.ask(go);
    bench.write(ReleaseBrake);
    assert_eq!(bench.ask(ReadStatus1).brake, BrakeCommand::LOCK, "third command, but a read");
    assert!(bench.events.contains(&Event::ProtectionRecovered));
    assert!(!bench.state().output_on, "old commands must not come alive");
    bench.run(millis(200));
    for _ in 0..5 {
        bench.run(millis(150)); // too far apart to be steady
        bench.ask(go);
        assert_eq!(bench.not_run(), Some(NotRunReason::CommunicationLost));
    }
    bench.ask(go);
    assert_eq!(bench.not_run(), Some(NotRunReason::CommunicationLost));
    bench.ask(go); // the third in a row
    assert_eq!(bench.not_run(), None);
    assert!(bench.state().output_on);
}

/// 2.31.1, 2.31.4: 0 switches the protection off, and the motor goes on with its command. It is kept.
#[test]
fn without_protection_the_motor_goes_on() {
    let mut bench = protected();
    bench.power_cycle();
    assert_eq!(bench.drive.settings().protection_timeout.raw(), 100);
    bench.write(CommunicationLossProtection { timeout: Milliseconds::from_raw(0) });
    bench.go(turn(100.0), millis(10_000));
    assert!(bench.speed() > 99.0);
}

/// 2.32: the rate is kept in ROM and acts when the drive is powered on again; a code that is not valid on the
/// bus changes nothing.
#[test]
fn the_bit_rate_is_kept_and_acts_after_the_next_start() {
    let mut bench = Bench::default();
    let slow = BaudCode::CAN_500K_RS485_115200;
    let reply = bench.send(SetBaudRate { baud_rate: slow }).unwrap();
    assert_eq!(reply[0], 0xB4);
    assert_eq!(bench.drive.bit_rate(), Some(1_000_000));
    assert!(!bench.events.contains(&Event::BitRateChanged(slow)));
    bench.power_cycle();
    assert_eq!(bench.drive.baud_rate(), slow);
    assert_eq!(bench.drive.bit_rate(), Some(500_000));
    assert!(bench.events.contains(&Event::BitRateChanged(slow)));
    assert_eq!(bench.send(SetBaudRate { baud_rate: BaudCode::RS485_1M }), None);
    bench.power_cycle();
    assert_eq!(bench.drive.baud_rate(), slow);
    let mut bench = Bench::on_rs485();
    bench.send(SetBaudRate { baud_rate: BaudCode::RS485_1M });
    assert_eq!(bench.drive.bit_rate(), Some(500_000));
    bench.restart();
    assert_eq!(bench.drive.bit_rate(), Some(1_000_000));
}

fn report(opcode: Opcode, enable: Switch, interval: u16) -> ActiveReply {
    let command = ReportedCommand::of(opcode).unwrap();
    ActiveReply { command, enable, interval: ReportInterval::from_raw(interval) }
}

/// 2.34.1: listed commands are sent by themselves at the interval, in turn; polls of them are not
/// answered; switched off it ends.
#[test]
fn active_replies_take_turns() {
    let mut bench = Bench::default();
    bench.send(report(Opcode::ReadMultiTurnEncoder, Switch::On, 2));
    bench.send(report(Opcode::ReadStatus2, Switch::On, 2));
    bench.sent.clear();
    bench.run(millis(100));
    let bytes: Vec<u8> = bench.sent.iter().map(|(_, packet)| packet.data[0]).collect();
    assert_eq!(bytes, [0x60, 0x9C, 0x60, 0x9C, 0x60]);
    for pair in bench.sent.windows(2) {
        assert_eq!(pair[1].0 - pair[0].0, millis(20));
    }
    assert!(bench.sent.iter().all(|(_, packet)| packet.channel == Channel::Reply(ID)));
    assert_eq!(bench.send(ReadStatus2), None);
    assert!(bench.send(ReadMultiTurnAngle).is_some(), "others are answered");
    bench.send(report(Opcode::ReadMultiTurnEncoder, Switch::Off, 0));
    bench.send(report(Opcode::ReadStatus2, Switch::Off, 0));
    bench.sent.clear();
    bench.run(millis(100));
    assert!(bench.sent.is_empty());
    assert!(bench.send(ReadStatus2).is_some());
}

/// 2.34.1: CAN only; RS485 does not have it. 5: nor motion mode.
#[test]
fn active_reply_and_motion_are_not_on_rs485() {
    let mut bench = Bench::on_rs485();
    bench.send(report(Opcode::ReadStatus2, Switch::On, 1));
    bench.send(RawMotion::decode(&[0x80; 8]));
    bench.run(millis(100));
    assert!(bench.sent.is_empty());
    let can_only = |opcode| move |event: &Event| matches!(event, Event::Ignored { reason: IgnoreReason::CanOnly(o), .. } if *o == opcode);
    assert!(bench.events.iter().any(can_only(Opcode::ActiveReply)));
    assert!(bench.events.iter().any(can_only(Opcode::Motion)));
}

/// 2.35.4, function 1: clears the turns, makes the position the zero and saves it; after a restart.
#[test]
fn function_1_clears_the_turns_after_a_restart() {
    let mut bench = Bench::default();
    bench.write(FunctionControl::SaveMultiTurn(Switch::On));
    bench.restart();
    bench.turn_to(3.0 * 360.0 + 30.0);
    bench.write(FunctionControl::ClearMultiTurn);
    assert_eq!(bench.told_angle(), 1_110.0);
    bench.restart();
    assert_eq!(bench.told_angle(), 0.0);
    assert_eq!(bench.ask(ReadMultiTurnEncoderRaw).raw.raw(), TURN / 12);
    bench.turn_to(5.0 * 360.0 + 30.0);
    bench.power_cycle();
    assert_eq!(bench.told_angle(), 720.0);
}

/// 2.35.4, function 2: 0x280 reaches a drive only while its id filter is off; kept after power-off.
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

/// 2.35.4, function 4: on, the turns are saved at power-off; off, they are lost. After a restart.
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
        assert_eq!(bench.told_angle(), kept);
        bench.restart();
        assert_eq!(bench.told_angle(), kept);
    }
}

/// 2.35.4, function 5: a new id acts after a restart.
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
        bench.write(Stop);
    }
}

/// 2.35.4, functions 6 and 7: "at once" is for a motor on its way, too. A limit ends its motion there; a
/// motor that is beyond already is not brought back, as setting a limit is no command to move.
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

/// 2.25.3 names three modes, each a loop; 2.17.1: 0x80 "clears the running state", so that no loop runs.
/// Nor does one before the first command, or after an error.
#[test]
fn in_no_mode_0x70_tells_0() {
    let none = Mode::from_raw(0);
    let mut bench = Bench::default();
    assert_eq!(bench.ask(ReadRunningMode).mode, none);
    bench.ask(turn(50.0));
    bench.raise(ErrorFlags::OVER_VOLTAGE);
    assert_eq!(bench.ask(ReadRunningMode).mode, none);
    bench.drive.clear_fault(ErrorFlags::OVER_VOLTAGE);
    for (end, mode) in [(AnyCommand::from(Shutdown), none), (Stop.into(), Mode::POSITION)] {
        bench.go(turn(50.0), millis(200));
        bench.send(end);
        bench.run(millis(200));
        assert_eq!(
            bench.ask(ReadRunningMode).mode,
            mode,
            "a motor that holds is in the position loop"
        );
    }
}

/// 3.2, 6.2: all drives obey a command to all, and each replies under its own id.
#[test]
fn a_command_to_all_is_obeyed_and_answered_by_each() {
    for bus in [Bus::Can, Bus::Rs485] {
        for motor in (1..=4).map(id) {
            let mut bench = Bench::new(Parameters { id: motor, bus, ..Parameters::default() });
            let packets = bench.exchange(Channel::Command(Target::All), Shutdown.encode());
            let channel = Channel::Reply(motor);
            assert_eq!(packets, [Packet { channel, data: Shutdown.encode() }]);
        }
    }
}

/// 4.4, 7.4: 0x79 reads the id, on CAN as a reply identifier and on RS485 bare, and sets it.
#[test]
fn the_bus_id_is_read_and_set() {
    for (bus, told) in [(Bus::Can, [0x42, 0x02]), (Bus::Rs485, [0, 2])] {
        let mut bench = Bench::new(Parameters { bus, ..Parameters::default() });
        assert_eq!(bench.send(BusId::Write(id(2))), Some(BusId::Write(id(2)).encode()));
        bench.restart();
        let replies = bench.exchange(Channel::BusId, BusId::Read.encode());
        let data = [0x79, 0, 1, 0, 0, 0, told[0], told[1]];
        assert_eq!(replies, [Packet { channel: Channel::BusId, data }]);
        let line = rs485::Frame::from_packet(&replies[0]).unwrap();
        assert_eq!(line.address, Target::All);
    }
}

/// 4.1: all that are connected take a new id; their replies, which look like commands, end there.
#[test]
fn several_drives_take_the_same_id_and_do_not_answer_each_other() {
    let mut motors = [1, 2].map(|n| Bench::new(Parameters { id: id(n), ..Parameters::default() }));
    for data in [BusId::Read.encode(), BusId::Write(id(5)).encode()] {
        let mut bus = vec![data];
        let mut packets = 0;
        while let Some(data) = bus.pop() {
            packets += 1;
            assert!(packets <= 3, "they answer each other");
            for bench in &mut motors {
                let replies = bench.exchange(Channel::BusId, data);
                bus.extend(replies.iter().map(|reply| reply.data));
            }
        }
        assert_eq!(packets, 3);
    }
    for bench in &motors {
        assert_eq!(bench.drive.stored_settings().id, id(5));
    }
}

/// 5.1: motion mode sets the current to (kp·Δp + kd·Δv + t_ff) / KT, and answers with what it measures.
#[test]
fn motion_mode_is_a_spring_a_damper_and_a_torque() {
    let mut bench = Bench::default();
    let ranges = MotionRanges::V4_3;
    let hold = MotionSetPoint { position_rad: 1.0, kp: 50.0, kd: 2.0, ..Default::default() };
    let raw = ranges.quantise(&hold).unwrap();
    let answer = bench.ask(raw);
    assert_eq!(answer.id_byte, ID.get());
    assert_eq!(bench.ask(ReadRunningMode).mode, Mode::CURRENT);
    bench.run(millis(2_000));
    // Half a step of velocity times kd is 0.02 N·m, and of torque 0.006 N·m: 0.6 mrad at kp 50.
    assert!((bench.angle().to_radians() - 1.0).abs() < 0.002, "{}", bench.angle());
    bench.drive.plant_mut().load_nm = 5.0;
    bench.run(millis(2_000));
    assert!((bench.angle().to_radians() - 1.1).abs() < 0.002, "a spring gives way");
    let feedback = ranges.feedback(&bench.ask(raw));
    assert!((feedback.position_rad - 1.1).abs() < 0.003);
    assert!((feedback.torque_nm + 5.0).abs() < 0.03, "{}", feedback.torque_nm);
    assert!(feedback.velocity_rad_s.abs() < 0.03);
}

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

/// 2.14.3: "calibration parameters: write error" is what a failing memory raises; the command is not
/// acknowledged.
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
