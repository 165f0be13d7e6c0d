//! Field behaviour beside the manual, each option on and off (a lost master's heartbeat is in `fleet`),
//! and what no drive may ever do.

use myactuator_protocol_core::command::*;
use myactuator_protocol_core::drive::{
    Drive, Event, IdealPlant, IgnoreReason, NotRunReason, Parameters, Quirks, RamMemory,
};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::*;
use myactuator_protocol_core::{Channel, MotorId, Target};
use myactuator_tests::bench::*;
use myactuator_tests::dice::any_data;
use myactuator_tests::values::*;
use proptest::prelude::*;

fn with(quirks: Quirks) -> Bench {
    Bench::new(Parameters { has_brake: true, quirks, ..Parameters::default() })
}

/// After 0x76 the drive answers again after about 1.1 s.
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

/// The brake opens 50 to 150 ms after 0x77; the drive, which has answered at once, does not wait.
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

/// Function 5 changes the id, but is not answered.
#[test]
fn silent_id_change() {
    let mut bench = with(Quirks { silent_id_change: true, ..Quirks::default() });
    let id = MotorId::new(7).unwrap();
    assert_eq!(bench.send(FunctionControl::SetCanId(id)), None);
    bench.restart();
    assert_eq!(bench.drive.id(), id);
}

/// The turns are lost although function 4 is on.
#[test]
fn turns_lost() {
    for (turns_lost, angle) in [(true, 30.0), (false, 390.0)] {
        let mut bench = with(Quirks { turns_lost, ..Quirks::default() });
        bench.write(FunctionControl::SaveMultiTurn(Switch::On));
        bench.restart();
        bench.turn_to(390.0);
        bench.restart();
        assert_eq!(bench.told_angle(), angle);
    }
}

/// Writes to ROM are answered but take only while the motor is shut down.
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

/// The response delay is drawn from its range, by the seed, and replies keep their order.
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

/// A caller that lets hours pass gets bounded work a call, and a drive that ends up right.
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
    /// Whatever comes over the bus, the drive lives, puts out no more than its stall current, and what
    /// it measures stays a number.
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
