//! Behaviour of real drives that differs from the manual, with each option on and off, and what no drive may ever do.
//! The heartbeat after a lost master is in `fleet`.

use myactuator_protocol_core::command::*;
use myactuator_protocol_core::drive::{
    Drive, Event, IdealPlant, IgnoreReason, NotRunReason, Parameters, Quirks, RamMemory,
};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::*;
use myactuator_protocol_core::{AnyCommand, Channel, MotorId, Opcode, Target};
use myactuator_tests::bench::*;
use myactuator_tests::dice::any_data;
use myactuator_tests::values::*;
use proptest::prelude::*;

fn with(quirks: Quirks) -> Bench {
    Bench::new(Parameters { has_brake: true, quirks, ..Parameters::default() })
}

/// After 0x76 the drive does not answer for about 1.1 s.
#[test]
fn slow_boot() {
    let mut bench = with(Quirks { slow_boot: true, ..Quirks::default() });
    bench.run(millis(1_200));
    bench.restart();
    bench.run(millis(1_090));
    assert_eq!(bench.send(ReadStatus2), None);
    let ignored = bench
        .events
        .iter()
        .any(|event| matches!(event, Event::Ignored { reason: IgnoreReason::Starting, .. }));
    assert!(ignored);
    bench.run(millis(5));
    assert!(bench.send(ReadStatus2).is_some());
    let run_time = bench.ask(ReadRunTime).run_time.raw();
    assert!((1_105..=1_120).contains(&run_time), "since the restart: {run_time}");
}

/// The brake opens 50 to 150 ms after 0x77. The drive answers at once and does not wait for the brake.
#[test]
fn slow_brake() {
    let mut opened = Vec::new();
    for seed in 0..20 {
        let quirks = Quirks { slow_brake: true, ..Quirks::default() };
        let parameters = Parameters { has_brake: true, quirks, seed, ..Parameters::default() };
        let mut bench = Bench::new(parameters);
        bench.write(ReleaseBrake);
        bench.ask(push(1.0));
        assert!(bench.state().output_on);
        let mut waited = 10; // for two replies
        while bench.angle() == 0.0 {
            bench.run(millis(1));
            waited += 1;
        }
        opened.push(waited);
    }
    assert!(opened.iter().all(|millis| (50..=155).contains(millis)), "{opened:?}");
    assert!(opened.iter().max().unwrap() - opened.iter().min().unwrap() > 50, "{opened:?}");
}

/// The brake locks 50 to 150 ms after 0x78. Until then the output stays on, unless 0x80 switches it off.
#[test]
fn a_slow_brake_locks_late() {
    let quirks = Quirks { slow_brake: true, ..Quirks::default() };
    let at_work = |seed| {
        let parameters = Parameters { has_brake: true, quirks, seed, ..Parameters::default() };
        let mut bench = Bench::new(parameters);
        bench.write(ReleaseBrake);
        bench.go(push(1.0), millis(200));
        assert!(bench.state().output_on);
        bench
    };
    let mut locked = Vec::new();
    for seed in 0..20 {
        let mut bench = at_work(seed);
        bench.write(LockBrake);
        let mut waited = 5; // for its reply
        while bench.state().output_on {
            bench.run(millis(1));
            waited += 1;
        }
        locked.push(waited);
        let angle = bench.angle();
        bench.run(millis(100));
        assert_eq!(bench.angle(), angle, "it holds");
    }
    assert!(locked.iter().all(|millis| (50..=151).contains(millis)), "{locked:?}");
    assert!(locked.iter().max().unwrap() - locked.iter().min().unwrap() > 50, "{locked:?}");

    let mut bench = at_work(0);
    bench.write(LockBrake);
    bench.write(Shutdown);
    assert!(!bench.state().output_on);
    let angle = bench.angle();
    bench.run(millis(30));
    assert_ne!(bench.angle(), angle, "nothing holds it yet");

    // An output that was off stays off.
    let mut bench = Bench::new(Parameters { has_brake: true, quirks, ..Parameters::default() });
    bench.write(ReleaseBrake);
    bench.run(millis(200));
    bench.write(LockBrake);
    assert!(!bench.state().output_on);
}

/// Even if the drive restarts meanwhile: the brake does not open once more.
#[test]
fn a_slow_brake_locks_once_at_a_restart() {
    let quirks = Quirks { slow_brake: true, ..Quirks::default() };
    for seed in 0..20 {
        let boot_time = millis(20);
        let parameters =
            Parameters { has_brake: true, quirks, seed, boot_time, ..Parameters::default() };
        let mut bench = Bench::new(parameters);
        bench.run(millis(50));
        bench.write(ReleaseBrake);
        bench.go(push(1.0), millis(200));
        assert_eq!(bench.send(Reset), None);
        let mut angles = vec![bench.angle()];
        for _ in 0..200 {
            bench.run(millis(1));
            angles.push(bench.angle());
        }
        let turned: Vec<bool> = angles.windows(2).map(|pair| pair[0] != pair[1]).collect();
        let locked = turned.iter().position(|turned| !turned).unwrap();
        assert!((44..=150).contains(&locked), "{locked}");
        assert!(turned[locked..].iter().all(|turned| !turned), "{seed}");
    }
}

/// Function 5 changes the id, but is not answered.
#[test]
fn silent_id_change() {
    let mut bench = with(Quirks { silent_id_change: true, ..Quirks::default() });
    let id = MotorId::new(7).unwrap();
    assert_eq!(bench.send(FunctionControl::SetCanId(id)), None);
    bench.restart();
    assert_eq!(bench.drive.id(), id);
}

/// The turns are lost, although function 4 is on.
#[test]
fn turns_lost() {
    for (turns_lost, angle) in [(true, 30.0), (false, 390.0)] {
        let mut bench = with(Quirks { turns_lost, ..Quirks::default() });
        bench.write(FunctionControl::SaveMultiTurn(Switch::On));
        bench.restart();
        bench.turn_to(390.0);
        bench.restart();
        assert_eq!(bench.reported_angle(), angle);
    }
}

/// Writes to ROM are answered, but take effect only while the motor is shut down.
#[test]
fn rom_needs_shutdown() {
    let mut bench = with(Quirks { rom_needs_shutdown: true, ..Quirks::default() });
    let write = WritePidRom { index: PidIndex::SPEED_KI, value: Gain::new(0.25).unwrap() };
    let held = bench.ask(ReadPid { index: write.index }).value;
    bench.ask(turn(10.0));
    bench.write(write);
    bench.write(FunctionControl::MaxPositiveAngle(100));
    assert_eq!(bench.not_run(), Some(NotRunReason::NotShutDown));
    assert_eq!(bench.ask(ReadPid { index: write.index }).value, held);
    assert_eq!(bench.drive.settings().max_positive_angle, None);
    bench.write(Shutdown);
    bench.write(write);
    assert_eq!(bench.ask(ReadPid { index: write.index }).value, write.value);
}

/// 0x79 to one motor's identifier, or an unknown command byte: the last reply comes once more.
#[test]
fn repeats_last_reply() {
    let to_one = Channel::Command(ID.into());
    for (repeats_last_reply, times) in [(true, 1), (false, 0)] {
        for unknown in [[0x79, 0, 1, 0, 0, 0, 0, 0], [0xC0, 0, 0, 0, 0, 0, 0, 0]] {
            let mut bench = with(Quirks { repeats_last_reply, ..Quirks::default() });
            assert_eq!(bench.exchange(to_one, unknown), [], "there is none yet");
            bench.ask(ReadModel);
            let (_, last) = *bench.sent.last().unwrap();
            for _ in 0..2 {
                assert_eq!(bench.exchange(to_one, unknown), vec![last; times]);
            }
            bench.restart();
            assert_eq!(bench.exchange(to_one, unknown), []);
        }
    }
}

/// Function 5 is answered under the new id. So are all commands to the old id until 0x76.
#[test]
fn answers_as_new_id() {
    let to_old = Channel::Command(ID.into());
    let new = MotorId::new(7).unwrap();
    let to_new = Channel::Command(new.into());
    let renamed = Channel::Reply(new);
    for (answers_as_new_id, before) in [(true, renamed), (false, Channel::Reply(ID))] {
        let mut bench = with(Quirks { answers_as_new_id, ..Quirks::default() });
        let mut from = |channel, data| {
            let replies = bench.exchange(channel, data);
            replies.iter().map(|packet| packet.channel).collect::<Vec<_>>()
        };
        assert_eq!(from(to_old, ReadModel.encode()), [Channel::Reply(ID)]);
        assert_eq!(from(to_old, FunctionControl::SetCanId(new).encode()), [before]);
        assert_eq!(from(to_old, ReadModel.encode()), [before]);
        assert_eq!(from(to_new, ReadModel.encode()), []);
        assert_eq!(from(to_old, Reset.encode()), []);
        assert_eq!(from(to_new, ReadModel.encode()), [renamed]);
        assert_eq!(from(to_old, ReadModel.encode()), []);
    }
}

/// 0x9A reports "released" only while the drive obeys a command that moves or holds the motor.
#[test]
fn brake_told_by_motion() {
    let (lock, release) = (BrakeCommand::LOCK, BrakeCommand::RELEASE);
    for (brake_told_by_motion, idle) in [(true, lock), (false, release)] {
        let mut bench = with(Quirks { brake_told_by_motion, ..Quirks::default() });
        let reported = |bench: &mut Bench| bench.ask(ReadStatus1).brake;
        assert_eq!(reported(&mut bench), lock);
        bench.write(ReleaseBrake);
        assert_eq!((reported(&mut bench), bench.state().brake), (idle, release));
        bench.ask(turn(10.0));
        assert_eq!(reported(&mut bench), release);
        bench.write(Shutdown);
        assert_eq!((reported(&mut bench), bench.state().brake), (idle, release));
    }
}

/// While 0x92 is reported the drive obeys commands but answers none.
#[test]
fn silent_while_reporting() {
    let report = |enable| ActiveReply {
        command: ReportedCommand::of(Opcode::ReadMultiTurnAngle).unwrap(),
        enable,
        interval: ReportInterval::from_raw(100),
    };
    for silent_while_reporting in [true, false] {
        let mut bench = with(Quirks { silent_while_reporting, ..Quirks::default() });
        assert_eq!(bench.send(report(Switch::On)), None);
        assert_eq!(bench.send(ReadMultiTurnAngle), None);
        assert_eq!(bench.send(ReadStatus2).is_none(), silent_while_reporting);
        assert_eq!(bench.send(turn(10.0)).is_none(), silent_while_reporting);
        assert!(bench.state().output_on);
        bench.sent.clear();
        bench.run(millis(1_000));
        assert_eq!(bench.sent.len(), 1, "the report");
        assert_eq!(bench.send(report(Switch::Off)), None);
        bench.feedback();
    }
}

/// The reply to a command that changes the ROM comes late, and so do the replies after it. All others come in time.
#[test]
fn slow_rom() {
    let gain = |value| (PidIndex::SPEED_KI, Gain::new(value).unwrap());
    for (slow_rom, took) in [(true, 15_800), (false, 800)] {
        let mut bench = with(Quirks { slow_rom, ..Quirks::default() });
        let mut ask = |command: AnyCommand| {
            bench.sent.clear();
            let asked = bench.now;
            for data in [command.encode(), ReadModel.encode()] {
                bench.put(Channel::Command(ID.into()), data);
            }
            bench.run(millis(30));
            let took = bench.sent.iter().map(|&(at, _)| (at - asked).as_micros());
            took.collect::<Vec<_>>()
        };
        let (index, value) = gain(0.25);
        assert_eq!(ask(WritePidRam { index, value }.into()), [800, 800]);
        assert_eq!(ask(WritePidRom { index, value }.into()), [took, took]);
        assert_eq!(ask(WritePidRom { index, value }.into()), [800, 800], "it holds that already");
        let id = MotorId::new(7).unwrap();
        assert_eq!(ask(FunctionControl::SetCanId(id).into()), [took, took]);
        assert_eq!(ask(SetCurrentPositionZero.into()), [800, 800], "it is zero already");
    }
}

/// The response delay is drawn from its range, by the seed.
#[test]
fn response_delays_are_drawn_by_the_seed() {
    let delays = |seed| {
        let parameters = Parameters {
            seed,
            response_delay_min: Duration::from_micros(700),
            response_delay_max: Duration::from_micros(900),
            ..Parameters::default()
        };
        let mut bench = Bench::new(parameters);
        (0..50)
            .map(|_| {
                let asked = bench.now;
                bench.feedback();
                (bench.sent.pop().unwrap().0 - asked).as_micros()
            })
            .collect::<Vec<_>>()
    };
    let drawn = delays(1);
    assert!(drawn.iter().all(|delay| (700..=900).contains(delay)), "{drawn:?}");
    assert!(drawn.iter().max().unwrap() - drawn.iter().min().unwrap() > 100, "{drawn:?}");
    assert_eq!(drawn, delays(1));
    assert_ne!(drawn, delays(2));
}

/// Replies leave in the order of their commands, even if a later one was ready sooner.
#[test]
fn replies_keep_their_order() {
    let mut bench = Bench::new(Parameters {
        response_delay_min: Duration::from_micros(100),
        response_delay_max: millis(5),
        ..Parameters::default()
    });
    for _ in 0..20 {
        bench.sent.clear();
        for data in [ReadStatus1.encode(), ReadStatus2.encode(), ReadStatus3.encode()] {
            bench.put(Channel::Command(ID.into()), data);
        }
        bench.run(millis(10));
        let bytes: Vec<u8> = bench.sent.iter().map(|(_, packet)| packet.data[0]).collect();
        assert_eq!(bytes, [0x9A, 0x9C, 0x9D]);
    }
}

/// A caller that lets hours pass gets bounded work per call. The drive's clock catches up and never goes back.
#[test]
fn a_late_caller_gets_bounded_work() {
    let plant = IdealPlant::default();
    let memory = RamMemory::default();
    let mut drive = Drive::new(Parameters::default(), plant, memory, Instant::ZERO).unwrap();
    let hour = Instant::from_millis(3_600_000);
    drive.advance(hour);
    assert_eq!(drive.clock(), Instant::from_millis(1_000));
    while drive.clock() < Instant::from_millis(20_000) {
        drive.advance(hour);
    }
    drive.advance(Instant::ZERO); // backwards: nothing
    assert_eq!(drive.clock(), Instant::from_millis(20_000));
}

fn any_channel() -> impl Strategy<Value = Channel> {
    let id = (1_u8..=3).prop_map(|id| MotorId::new(id).unwrap());
    prop_oneof![
        8 => Just(Channel::Command(Target::Motor(ID))),
        1 => id.clone().prop_map(|id| Channel::Command(Target::Motor(id))),
        2 => Just(Channel::Command(Target::All)),
        1 => Just(Channel::BusId),
        2 => Just(Channel::Motion(ID)),
        1 => id.prop_map(Channel::Reply),
    ]
}

proptest! {
    /// Whatever comes over the bus, the drive does not panic or exceed its stall current, and its measurements stay
    /// finite.
    #[test]
    fn nothing_on_the_bus_hurts_it(
        packets in prop::collection::vec((any_channel(), any_data(), 0_u64..30), 1..80),
        brake in any::<bool>(),
    ) {
        let mut bench = Bench::new(Parameters { has_brake: brake, ..Parameters::default() });
        for (channel, data, wait) in packets {
            bench.put(channel, data);
            bench.run(millis(wait));
            prop_assert!(bench.current().abs() <= 12.0);
            prop_assert!(bench.angle().is_finite() && bench.speed().is_finite());
        }
    }
}
