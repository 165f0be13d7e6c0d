//! 2.26 to 2.34: restart, brake, protection, bit rate, active replies.

use myactuator_protocol_core::command::*;
use myactuator_protocol_core::drive::{Event, NotRunReason};
use myactuator_protocol_core::opcode::{ReplyRule, Usage};
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::*;
use myactuator_protocol_core::{AnyCommand, Channel, Opcode, Target};
use myactuator_tests::bench::*;
use myactuator_tests::values::*;
use myactuator_tests::vectors::one_of_each;

use super::commands::{force_to, on_by, report, within_a_turn};

/// 2.26: 0x76 restarts the program: no reply, no mode, run time from 0. Active replies and error reporting end, because
/// nothing says that they are saved.
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

/// 2.27, 2.28: 0x77 lets the shaft go, 0x78 locks it, and without power it is locked.
#[test]
fn brake_releases_locks_and_is_locked_without_power() {
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

fn protected() -> Bench {
    protect(Bench::with_brake())
}

/// Turns the motor and cuts its output after a silence of 100 ms.
fn protect(mut bench: Bench) -> Bench {
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

/// 2.31.1: to run again, steady communication must be established first. That holds for each command that moves the
/// motor, for 0x81 and for 0x77. All others work.
#[test]
fn after_a_loss_no_kind_of_command_moves_the_motor_at_once() {
    for command in one_of_each() {
        let opcode = command.opcode().unwrap();
        // Without a brake, for a locked one alone forbids 0xA1, 0x81 and motion mode.
        let mut bench = protect(Bench::default());
        bench.run(millis(200));
        let reply = bench.send(command);
        assert_eq!(reply.is_some(), !matches!(opcode.reply_rule(), ReplyRule::Silent), "{opcode}");
        assert!(!bench.state().output_on, "{opcode}");
        let waits = matches!(opcode.usage(), Usage::SetPoint | Usage::Move)
            || [Opcode::Stop, Opcode::ReleaseBrake].contains(&opcode);
        assert_eq!(bench.not_run(), waits.then_some(NotRunReason::CommunicationLost), "{opcode}");
    }
}

/// 2.31.1: the output is cut if the silence "exceeds" the set time. 2.31.4: communication is restored if its intervals
/// are "within" that time. So an interval of exactly the set time is neither a loss nor unsteady.
#[test]
fn an_interval_of_exactly_the_set_time_is_in_time() {
    let mut bench = protected();
    let go = |bench: &mut Bench| bench.put(Channel::Command(ID.into()), turn(100.0).encode());
    go(&mut bench);
    bench.run(millis(100));
    assert!(bench.state().output_on);
    bench.run(Duration::from_micros(100)); // a step of the loops
    assert!(bench.state().communication_lost && !bench.state().output_on);
    for runs in [false, false, true] {
        go(&mut bench);
        assert_eq!(bench.state().output_on, runs);
        bench.run(millis(100));
    }
    assert!(bench.state().output_on);
}

/// 2.31.1: 0 switches the protection off, so that nothing is lost any more. It does not start the motor.
#[test]
fn switching_the_protection_off_ends_a_loss() {
    let mut bench = protected();
    bench.run(millis(200));
    assert!(bench.state().communication_lost);
    bench.write(CommunicationLossProtection { timeout: Milliseconds::from_raw(0) });
    assert_eq!(bench.events.last(), Some(&Event::ProtectionRecovered));
    assert!(!bench.state().communication_lost && !bench.state().output_on);
    bench.ask(turn(100.0));
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

/// 2.32: the rate is kept in ROM and acts when the drive starts again. A code that is not valid on the bus changes
/// nothing.
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

/// 2.34.1: the drive reports the listed commands in turn, one per interval. It does not answer polls of them, not even
/// those to all. Switched off, they end.
#[test]
fn active_replies_take_turns() {
    let mut bench = Bench::default();
    bench.send(report(Opcode::ReadMultiTurnEncoder, Switch::On, 9)); // the last one holds for both
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
    bench.run(millis(6)); // past the next report
    let all = Channel::Command(Target::All);
    assert_eq!(bench.exchange(all, ReadStatus2.encode()), []);
    assert_eq!(bench.exchange(all, ReadMultiTurnAngle.encode()).len(), 1);
    bench.send(report(Opcode::ReadMultiTurnEncoder, Switch::Off, 0));
    bench.send(report(Opcode::ReadStatus2, Switch::Off, 0));
    bench.sent.clear();
    bench.run(millis(100));
    assert!(bench.sent.is_empty());
    assert!(bench.send(ReadStatus2).is_some());
}

/// 2.19.1 asks for 0x77 before torque only. Speed and position commands open the brake on their own, and 0x80 locks it
/// again. If 0x77 has opened the brake, 0x80 leaves it open.
#[test]
fn shutdown_locks_the_brake_unless_0x77_opened_it() {
    let commands: [AnyCommand; 5] = [
        turn(90.0).into(),
        go_to(90.0, 500).into(),
        within_a_turn(Direction::CLOCKWISE, 90.0).into(),
        on_by(90.0).into(),
        force_to(90.0, 100).into(),
    ];
    for command in commands {
        for by_0x77 in [false, true] {
            let mut bench = Bench::with_brake();
            if by_0x77 {
                bench.write(ReleaseBrake);
            }
            bench.send(command);
            bench.run(millis(200));
            assert!(bench.angle() > 5.0, "{command}: {}", bench.angle());
            bench.write(Shutdown);
            let expected = if by_0x77 { BrakeCommand::RELEASE } else { BrakeCommand::LOCK };
            assert_eq!(bench.ask(ReadStatus1).brake, expected, "{command}");
        }
    }
}

/// 2.14.3, 2.27.3, 2.28.3: a motor without a brake answers 0x77 and 0x78, keeps turning, and reports "released".
#[test]
fn a_motor_without_a_brake_is_released() {
    let mut bench = Bench::default();
    assert_eq!(bench.ask(ReadStatus1).brake, BrakeCommand::RELEASE);
    bench.go(turn(90.0), millis(500));
    bench.write(LockBrake);
    bench.write(ReleaseBrake);
    assert_eq!(bench.ask(ReadStatus1).brake, BrakeCommand::RELEASE);
    assert!(bench.state().output_on && bench.speed() > 80.0, "{}", bench.speed());
}
