//! 2.17 to 2.25 and 5: commands that move the motor, and those that end its motion.

use myactuator_protocol_core::command::*;
use myactuator_protocol_core::drive::NotRunReason;
use myactuator_protocol_core::{AnyCommand, Channel};
use myactuator_tests::bench::*;
use myactuator_tests::values::*;

use super::commands::{ends_at, force_to, most, on_by, plan, within_a_turn};

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
    bench.ask(RawMotion::decode(&[0xFF; 8]));
    assert_eq!(bench.not_run(), Some(NotRunReason::BrakeLocked), "motion mode is torque, too");
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

/// 2.20.2, remark 2, 2.4.4: the speed planning accelerations limit how fast the speed changes. Remark 3: with 0 only
/// the current limits it.
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

/// 2.4.4: the deceleration is "in the same direction", the acceleration "includes both directions". So a reversal is
/// one acceleration from end to end.
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
    // 0 has no direction: the way to it is a deceleration.
    bench.go(turn(0.0), millis(195));
    assert!((bench.speed() + 60.0).abs() < 8.0, "{}", bench.speed());
}

/// 2.20.1: maxTorque is a percentage of the rated current. If it is 0, or above the stall current, only the stall
/// current limits.
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
        // Even without a shutdown in between, a new command is a new motion.
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

/// 2.4.4: the deceleration has a value of its own. If that is 0, the acceleration serves for both.
#[test]
fn zero_deceleration_takes_the_value_of_the_acceleration() {
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
fn single_turn_position_turns_in_the_given_direction() {
    for (direction, way, end) in
        [(Direction::CLOCKWISE, 1.0, 270.0), (Direction::COUNTER_CLOCKWISE, -1.0, -90.0)]
    {
        let mut bench = Bench::default();
        let go = within_a_turn(direction, 270.0);
        // The same command again is a command to stay, also for a shaft that has overshot by less than half a degree.
        for overshoot in [0.0, 0.0, 0.4, -0.4] {
            bench.turn_to(bench.angle() + overshoot * way);
            ends_at(&mut bench, go, end);
        }
        bench.turn_to(end + 0.6 * way);
        ends_at(&mut bench, go, end + 360.0 * way);
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

/// 2.24.1: 0xA9 goes to a position with its torque limited to a percentage of the rated current. Above the stall
/// current it is not limited.
#[test]
fn a_force_position_limits_its_torque() {
    for (limit, largest) in [(0, 0.0), (10, 0.6), (60, 3.6), (255, 12.0)] {
        let mut bench = Bench::default();
        bench.drive.plant_mut().load_nm = -30.0; // more than any limit lifts
        bench.ask(force_to(360.0, limit));
        let seen = most(&mut bench, millis(300), |measured| measured.current_a);
        assert!((seen - largest).abs() < 0.01, "{limit} %: {seen} A");
    }
    ends_at(&mut Bench::default(), force_to(360.0, 60), 360.0);
}

/// 2.25.3 names three modes, each a loop. 2.17.1: 0x80 "clears the running state". No loop runs after it, before the
/// first command, or after an error.
#[test]
fn running_mode_is_0_while_no_loop_runs() {
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

/// 2.22.1, 2.23.1, 2.24.1: maxSpeed, in dps, is the highest speed of these three as well.
#[test]
fn no_position_command_exceeds_its_speed() {
    let to = within_a_turn(Direction::CLOCKWISE, 90.0);
    let commands: [AnyCommand; 3] = [
        SingleTurnPosition { max_speed: up_to(100), ..to }.into(),
        IncrementalPosition { max_speed: up_to(100), ..on_by(90.0) }.into(),
        ForcePosition { max_speed: up_to(100), ..force_to(90.0, 100) }.into(),
    ];
    for command in commands {
        let mut bench = Bench::default();
        bench.send(command);
        let fastest = most(&mut bench, millis(1_500), |measured| measured.speed_dps);
        assert!((99.0..103.0).contains(&fastest), "{command}: {fastest}");
        assert!((bench.angle() - 90.0).abs() < 0.02, "{command}: {}", bench.angle());
    }
}

/// 2.23.1: "the current position is the starting point", also for a moving motor.
#[test]
fn an_incremental_position_counts_from_where_the_shaft_is() {
    let mut bench = Bench::default();
    bench.go(go_to(360.0, 100), millis(1_000));
    let here = bench.angle();
    assert!((50.0..110.0).contains(&here), "{here}");
    ends_at(&mut bench, on_by(90.0), here + 90.0);
}

/// 2.21.1, 2.24.1: the direction follows from target and position with 0xA9, too.
#[test]
fn a_force_position_is_gone_to_from_either_side() {
    let mut bench = Bench::default();
    for target in [360.0, -360.0, 0.0] {
        bench.go(force_to(target, 100), millis(2_500));
        assert!((bench.angle() - f64::from(target)).abs() < 0.02, "{target}: {}", bench.angle());
    }
}
