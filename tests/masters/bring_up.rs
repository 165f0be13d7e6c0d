//! First contact and safe ways of working, with complete simulated drives, on both buses.

use std::fmt::Debug;

use myactuator_host_std::sim::bus::can::CanBus;
use myactuator_host_std::sim::bus::faults::{Babble, Direction, FaultPlan};
use myactuator_host_std::sim::bus::rs485::TransceiverConfig;
use myactuator_host_std::sim::bus::trace;
use myactuator_host_std::sim::plant::{Arm, Load};
use myactuator_host_std::sim::{BusFleet, Fleet, LineFleet, MotorSetup};
use myactuator_protocol_core::command::{
    ActiveReply, BrakeCommand, ErrorFlags, FunctionControl, MotionLimits, MotionRanges,
    ReadMultiTurnAngle, ReadMultiTurnEncoderOffset, ReadRunTime, ReadStatus1, ReleaseBrake,
    ReportedCommand, Reset, Stop, Switch,
};
use myactuator_protocol_core::drive::{self, Quirks};
use myactuator_protocol_core::io::bring_up::{self, BringUpError, Protection};
use myactuator_protocol_core::io::{CallError, Runner, SerialMaster};
use myactuator_protocol_core::master::{Config, Event, Failure, MotorSet, StopKind};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::{Milliseconds, ReportInterval};
use myactuator_protocol_core::wire::rs485::Receiver;
use myactuator_protocol_core::{Firmware, Opcode, RequestError};
use myactuator_tests::fleet::{master, state, turn_to};
use myactuator_tests::listen::listen;
use myactuator_tests::on_both_buses;
use myactuator_tests::tapped::Tapped;
use myactuator_tests::values::{id, millis, push, turn};
use myactuator_tests::wire::Wire;

on_both_buses! {
    scan_finds_the_motors_and_frees_the_places_of_other_ids
    motor_with_a_request_in_flight_is_not_found_before_it_answers
    identify_reads_model_status_and_run_time
    identify_of_a_v4_4_motor_returns_no_model
    a_motor_is_waited_for_after_its_power_was_cycled
    a_restarting_motor_is_waited_for_though_another_question_waits_for_it
    a_zero_is_kept_over_a_power_cycle
    a_zero_is_kept_by_a_drive_that_writes_slowly
    one_of_several_gets_another_id_by_function_5
    an_id_is_not_changed_if_it_is_taken_or_not_acknowledged
    an_id_is_not_written_to_motors_that_are_not_understood
    an_id_that_motors_share_is_not_given_to_another
    refused_write_to_a_stopped_motor_leaves_it_holding
    a_motor_that_turns_gets_neither_a_zero_nor_another_id
    a_stopped_motor_is_waited_for_until_it_stands
    a_load_that_swings_does_not_stand_where_it_turns_back
    an_id_that_two_motors_have_is_not_changed
    motor_that_answers_late_is_not_taken_for_two
    motor_that_reports_its_errors_is_not_taken_for_two
    two_motors_of_one_id_that_report_errors_are_recognised
    only_motor_keeps_its_new_id_over_a_power_cycle
    brake_is_open_when_its_release_returns
    brake_opens_under_a_short_protection
    a_brake_opens_though_its_drive_had_lost_its_master
    motor_that_has_restarted_does_not_move_on_when_its_brake_is_released
    brake_of_a_motor_with_an_error_is_not_opened
    load_does_not_sink_while_its_brake_opens_and_locks
    a_load_that_is_too_heavy_for_the_motor_is_caught_by_the_brake
    motor_holds_its_load_again_when_its_brake_slips
    motor_holds_its_load_again_though_the_bus_is_out_when_its_brake_slips
    a_slipping_brake_that_may_not_be_opened_is_reported
    a_brake_that_slips_only_when_the_motor_is_off_is_reported
    lock_brake_catches_a_falling_load
    brake_holds_the_load_while_its_motor_is_switched_off
    no_brake_is_locked_on_a_turning_shaft_and_a_missing_brake_is_reported
    protected_motor_stops_when_it_hears_no_commands
    a_motor_that_turns_is_given_no_protection
    a_drive_that_has_lost_an_earlier_master_is_protected
    restart_that_the_drive_missed_is_sent_again
    a_new_id_is_taken_though_the_restart_was_lost_once
    a_zero_is_kept_though_the_restart_was_lost_once
    a_motor_that_falls_silent_after_a_write_may_have_kept_it
    the_restart_of_a_drive_that_answers_as_its_new_id_is_sent_again
}

fn ids(numbers: impl IntoIterator<Item = u8>) -> MotorSet {
    numbers.into_iter().map(id).collect()
}

fn read_angle<R: Runner<8, Error: Debug>>(runner: &mut R) -> f32 {
    runner.ask(id(1), ReadMultiTurnAngle).expect("it is there").angle.degrees()
}

fn scan_finds_the_motors_and_frees_the_places_of_other_ids<W: Wire>() {
    let bus = W::drives(&Fleet::new(5)).unwrap();
    let runner = &mut master(&bus);
    let mut returned = Vec::new();
    let found = bring_up::scan(runner, MotorSet::ALL, |motor, there| returned.push((motor, there)));
    assert_eq!(found, Ok(ids(1..=5)));
    returned.sort_unstable();
    let expected: Vec<_> = (1..=32).map(|number| (id(number), number <= 5)).collect();
    assert_eq!(returned, expected, "each is reported once");
    // They keep their places, so that a stop of all reaches them. The places of ids without a motor are free again.
    assert_eq!(runner.master().motors(), ids(1..=5));
    assert_eq!(bring_up::scan(runner, ids([2, 9]), |_, _| {}), Ok(ids([2])));
    assert_eq!(runner.master().motors(), ids(1..=5));
}

fn motor_with_a_request_in_flight_is_not_found_before_it_answers<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let runner = &mut master(&bus);
    // Requests to both are in flight already. Only motor 1 is there to answer.
    for motor in [id(1), id(9)] {
        let _ticket = runner.master().request(motor, ReadStatus1).expect("it is free");
    }
    assert_eq!(bring_up::scan(runner, ids([1, 9]), |_, _| {}), Ok(ids([1])));
}

#[test]
fn scan_of_a_dead_can_bus_fails_and_can_be_repeated() {
    let bus = Fleet::new(1).on_can(1_000_000).unwrap();
    bus.world.cut(bus.drives[0].station());
    let runner = &mut bus.master::<8>();
    let mut there = MotorSet::EMPTY;
    let hear = |motor, is_there| {
        if is_there {
            there.insert(motor);
        }
    };
    let found = bring_up::scan(runner, MotorSet::ALL, hear);
    assert!(matches!(found, Err(CallError::Failed { failure: Failure::BusDown, .. })), "{found:?}");
    assert_eq!(there, MotorSet::EMPTY);
    // The scan can be repeated.
    assert_eq!(runner.master().motors(), MotorSet::EMPTY);
    bus.world.mend(bus.drives[0].station());
    listen(runner, millis(50));
    assert_eq!(bring_up::scan(runner, MotorSet::ALL, |_, _| {}), Ok(ids([1])));
}

fn identify_reads_model_status_and_run_time<W: Wire>() {
    let bus = W::drives(&Fleet::new(2)).unwrap();
    let runner = &mut master(&bus);
    listen(runner, millis(300));
    let identity = bring_up::identify(runner, id(2)).expect("it is there");
    assert_eq!(identity.model.map(|model| model.to_string()).as_deref(), Some("X6-60"));
    assert_eq!(identity.status.errors, ErrorFlags::empty());
    assert!((290..=400).contains(&identity.run_time.raw()), "{}", identity.run_time);
    let nobody = bring_up::identify(runner, id(7)).expect_err("nobody is there");
    assert_eq!(nobody, CallError::Failed { motor: id(7), failure: Failure::NoReply });
}

fn identify_of_a_v4_4_motor_returns_no_model<W: Wire>() {
    let limits = MotionLimits { torque_nm: 60.0, ..MotionRanges::V4_3.limits() };
    let ranges = MotionRanges::new(limits).unwrap();
    let fleet = Fleet::new(1).firmware(Firmware::V4_4).motion_ranges(ranges);
    let bus = W::drives(&fleet).unwrap();
    let identity = bring_up::identify(&mut master(&bus), id(1)).expect("it is there");
    assert_eq!(identity.model, None);
    assert_eq!(identity.status.errors, ErrorFlags::empty());
}

fn a_motor_is_waited_for_after_its_power_was_cycled<W: Wire>() {
    let slow = Quirks { slow_boot: true, ..Quirks::default() };
    let bus = W::drives(&Fleet::new(1).quirks(slow)).unwrap();
    let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
    bus.world.reset(drive.station());
    let begun = runner.now();
    let half = millis(500);
    let early = bring_up::wait_until_there(runner, id(1), half);
    assert_eq!(early, Err(BringUpError::NotThere(id(1))));
    assert!(runner.now() - begun < half + millis(100));
    bring_up::wait_until_there(runner, id(1), Duration::from_secs(3)).expect("it starts");
    let took = runner.now() - begun;
    assert!(took >= Quirks::SLOW_BOOT, "{took}");
    assert!(took < Quirks::SLOW_BOOT + millis(150), "{took}");
    assert!(runner.ask(id(1), ReadStatus1).is_ok());
}

/// Another thread has asked it something, which is sent only when it has had the time to restart.
fn a_restarting_motor_is_waited_for_though_another_question_waits_for_it<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let config = Config { restart_time: millis(3_000), ..W::CONFIG };
    let (mut runner, _) = W::runner::<8>(&bus.world, config);
    runner.ask(id(1), Reset).expect("it is sent");
    let _ = runner.master().request(id(1), ReadRunTime).expect("it has a place");
    let there = bring_up::wait_until_there(&mut runner, id(1), Duration::from_secs(5));
    assert_eq!(there, Ok(()));
}

fn a_zero_is_kept_over_a_power_cycle<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
    turn_to(drive, 90.0);
    listen(runner, millis(20));
    let before = read_angle(runner);
    assert!((before - 90.0).abs() < 0.1, "{before}");
    let offset = bring_up::zero_here(runner, id(1)).expect("it keeps its zero");
    assert_ne!(offset.raw(), 0);
    bus.world.reset(drive.station());
    bring_up::wait_until_there(runner, id(1), Duration::from_secs(3)).expect("it starts");
    let kept = runner.ask(id(1), ReadMultiTurnEncoderOffset).expect("it is there").offset;
    assert_eq!(kept, offset);
    let after = read_angle(runner);
    assert!(after.abs() < 0.1, "{after}");
    // The zero stays where it is when the shaft turns.
    turn_to(drive, 120.0);
    listen(runner, millis(20));
    let turned = read_angle(runner);
    assert!((turned - 30.0).abs() < 0.1, "{turned}");
}

fn a_zero_is_kept_by_a_drive_that_writes_slowly<W: Wire>() {
    let slow = Quirks { slow_rom: true, ..Quirks::default() };
    let bus = W::drives(&Fleet::new(1).quirks(slow)).unwrap();
    let mut runner = master(&bus);
    turn_to(&bus.drives[0], 90.0);
    listen(&mut runner, millis(20));
    let begun = runner.now();
    bring_up::zero_here(&mut runner, id(1)).expect("it keeps its zero");
    assert!(runner.now() - begun >= Quirks::SLOW_ROM);
    assert!(read_angle(&mut runner).abs() < 0.1);
    let limit = Milliseconds::from_raw(500);
    assert_eq!(bring_up::protect(&mut runner, id(1), limit), Ok(Protection::Confirmed));
}

fn one_of_several_gets_another_id_by_function_5<W: Wire>() {
    let bus = W::drives(&Fleet::new(3)).unwrap();
    let runner = &mut master(&bus);
    assert_eq!(bring_up::change_id(runner, id(2), id(9)), Ok(()));
    assert_eq!(bring_up::scan(runner, MotorSet::ALL, |_, _| {}), Ok(ids([1, 3, 9])));
}

fn an_id_is_not_changed_if_it_is_taken_or_not_acknowledged<W: Wire>() {
    let silent = Quirks { silent_id_change: true, ..Quirks::default() };
    let bus = W::drives(&Fleet::new(2).quirks(silent)).unwrap();
    let runner = &mut master(&bus);
    let taken = bring_up::change_id(runner, id(1), id(2));
    assert_eq!(taken, Err(BringUpError::IdTaken(id(2))));
    let stranger = bring_up::change_id(runner, id(5), id(6));
    assert_eq!(stranger, Err(BringUpError::NotThere(id(5))));
    assert_eq!(bring_up::change_id(runner, id(1), id(1)), Ok(()), "it has it already");
    for (drive, number) in bus.drives.iter().zip(1..) {
        let ids = drive.with(|drive| (drive.id(), drive.stored_settings().id));
        assert_eq!(ids, (id(number), id(number)), "nothing was changed");
    }
    // 0x79 would not help: all drives would obey it.
    let not_taken = bring_up::change_id(runner, id(1), id(9));
    let expected = BringUpError::IdNotTaken { from: id(1), to: id(9), is_alone: false };
    assert_eq!(not_taken, Err(expected));
    assert_eq!(bus.drives[1].with(|drive| drive.stored_settings().id), id(2));
}

/// Two more motors, as they come from the factory. On a line nobody understands them.
fn an_id_is_not_written_to_motors_that_are_not_understood<W: Wire>() {
    let silent = Quirks { silent_id_change: true, ..Quirks::default() };
    let fleet = Fleet::of([1, 1, 3].map(|number| MotorSetup::new(id(number)))).quirks(silent);
    // At the same time.
    let bus = W::drives(&fleet.response(millis(1), millis(1))).unwrap();
    let not_taken = bring_up::change_id(&mut master(&bus), id(3), id(9));
    let expected = BringUpError::IdNotTaken { from: id(3), to: id(9), is_alone: false };
    assert_eq!(not_taken, Err(expected));
    let stored = [0, 1].map(|place| bus.drives[place].with(|drive| drive.stored_settings().id));
    assert_eq!(stored, [id(1); 2]);
}

fn an_id_that_motors_share_is_not_given_to_another<W: Wire>() {
    let fleet = Fleet::of([1, 1, 3].map(|number| MotorSetup::new(id(number))));
    // Two of them answer at the same time, one after the other, or in between.
    for latest in [1, 2, 4] {
        let bus = W::drives(&fleet.clone().response(millis(1), millis(latest))).unwrap();
        let refused = bring_up::change_id(&mut master(&bus), id(3), id(1));
        let expected = [BringUpError::IdShared(id(1)), BringUpError::IdTaken(id(1))];
        assert!(refused.is_err_and(|error| expected.contains(&error)), "{latest}");
        assert_eq!(bus.drives[2].with(|drive| drive.stored_settings().id), id(3), "{latest}");
    }
}

/// Two are on the line already, and hardly ever understood. If the third was given their id nevertheless, it is said.
#[test]
fn motor_that_joins_others_of_one_id_on_a_bad_line_is_reported() {
    for fault in ["lose=0.02", "lose=0.05", "corrupt=0.05"] {
        let mut joined = 0;
        for seed in 0..40 {
            let fleet = Fleet::of([1, 1, 3].map(|number| MotorSetup::new(id(number))));
            let fleet = fleet.seed(seed).faults([fault.parse().unwrap()]);
            let bus = fleet.on_rs485(115_200).unwrap();
            let changed = bring_up::change_id(&mut bus.master::<8>(), id(3), id(1));
            assert!(changed.is_err(), "{fault}, seed {seed}");
            joined += u32::from(bus.drives[2].with(|drive| drive.id()) == id(1));
        }
        assert!(joined < 4, "{fault}: {joined} of 40");
    }
}

/// Noise with each frame is no sign of motors that answer at the same time.
#[test]
fn a_noisy_line_has_no_shared_ids() {
    for number in [1, 5] {
        let bus = Fleet::new(1).on_rs485(115_200).unwrap();
        let noisy = TransceiverConfig { switch_noise: 1.0, ..TransceiverConfig::default() };
        let (port, config) = (bus.world.port_with(noisy), Config::rs485(115_200, false));
        let runner = &mut SerialMaster::<_, _, 8>::new(port, bus.world.clock(), config);
        let changed = bring_up::change_id(runner, id(number), id(9));
        let expected = if number == 1 { Ok(()) } else { Err(BringUpError::NotThere(id(number))) };
        assert_eq!(changed, expected);
        assert!(runner.garbled() > 10);
    }
}

/// A byte of noise comes from time to time, whoever is asked.
fn noisy(fleet: &Fleet, interval_ms: u64, seed: u64) -> LineFleet {
    let bus = fleet.clone().seed(seed).on_rs485(115_200).unwrap();
    let interval = Duration::from_micros(1_000 * interval_ms + 31 * seed);
    let noise = Babble { interval, frame: Some(vec![0x5A]) };
    bus.world.babble(bus.world.port().station(), Some(noise));
    bus.world.run_for(Duration::from_micros(1_137 * seed));
    bus
}

#[test]
fn noise_that_comes_by_time_is_no_shared_id() {
    for interval_ms in [5, 10, 20, 50, 100] {
        for seed in 0..20 {
            let bus = noisy(&Fleet::new(1), interval_ms, seed);
            let changed = bring_up::change_id(&mut bus.master::<8>(), id(5), id(9));
            let expected = [BringUpError::NotThere(id(5)), BringUpError::Noise(id(5))];
            let case = format!("{interval_ms} ms, {seed}: {changed:?}");
            assert!(changed.is_err_and(|error| expected.contains(&error)), "{case}");
        }
    }
}

/// Two are on the line already, and are not understood: they answer at the same time.
#[test]
fn noise_that_comes_by_time_hides_no_shared_id() {
    let fleet = Fleet::of([1, 1, 3].map(|number| MotorSetup::new(id(number))));
    let fleet = fleet.response(millis(1), millis(1));
    for interval_ms in [2, 6, 20, 80, 300, 600] {
        for seed in 0..40 {
            let bus = noisy(&fleet, interval_ms, seed);
            let changed = bring_up::change_id(&mut bus.master::<8>(), id(3), id(1));
            let stored = bus.drives[2].with(|drive| drive.stored_settings().id);
            assert_eq!(stored, id(3), "{interval_ms} ms, {seed}: {changed:?}");
        }
    }
}

/// What motor 2 says is disturbed for half a second, while it is looked for.
#[test]
fn motor_that_was_not_understood_at_first_is_there() {
    let change_id = |from, to| {
        let bus = Fleet::new(2).on_rs485(115_200).unwrap();
        let disturb = |plan| {
            bus.world.set_node_faults(bus.drives[1].station(), Direction::ToPorts, plan);
        };
        disturb(Some(FaultPlan { corrupt: 1.0, ..FaultPlan::NONE }));
        let until_then = |event| {
            if bus.world.now() > Instant::from_millis(500) {
                disturb(None);
            }
            event
        };
        bring_up::change_id(&mut Tapped(&mut bus.master::<8>(), until_then), id(from), id(to))
    };
    assert_eq!(change_id(1, 2), Err(BringUpError::IdTaken(id(2))));
    assert_eq!(change_id(2, 9), Ok(()));
}

fn refused_write_to_a_stopped_motor_leaves_it_holding<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
    runner.ask(id(1), turn(50.0)).expect("it is there");
    assert_eq!(runner.stop_all(StopKind::Hold, MotorSet::EMPTY), MotorSet::EMPTY);
    let stopped = || Err(CallError::refused(id(1))(RequestError::Stopped).into());
    assert_eq!(bring_up::zero_here(runner, id(1)).map(|_| ()), stopped());
    assert!(state(drive).output_on, "a load would fall");
    assert_eq!(bring_up::change_id(runner, id(1), id(9)), stopped());
    assert!(state(drive).output_on, "a load would fall");
    // A call that changes nothing is not refused while a stop is in force.
    assert_eq!(bring_up::change_id(runner, id(1), id(1)), Ok(()));
    runner.master().lift_stop();
    assert!(bring_up::zero_here(runner, id(1)).is_ok());
}

fn a_motor_that_turns_gets_neither_a_zero_nor_another_id<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
    runner.ask(id(1), turn(100.0)).expect("it is there");
    listen(runner, millis(500));
    let settings = || drive.with(|drive| *drive.stored_settings());
    let before = settings();
    let zero = bring_up::zero_here(runner, id(1)).map(|_| ());
    let changed = bring_up::change_id(runner, id(1), id(9));
    for refused in [zero, changed] {
        let returned = refused.expect_err("it turns");
        let BringUpError::Turns { motor, speed } = returned else { panic!("{returned}") };
        assert!(motor == id(1) && (speed.dps() - 100.0).abs() < 5.0, "{returned}");
        assert_eq!(
            returned.to_string(),
            format!("motor 1 turns at {speed}: stop it first, and wait until it stands")
        );
        assert!(state(drive).output_on, "its shaft would run on");
    }
    assert_eq!(settings(), before, "nothing was written");
    // A call that changes nothing works although the motor turns.
    assert_eq!(bring_up::change_id(runner, id(1), id(1)), Ok(()));
    assert!(runner.stop(id(1), StopKind::Hold));
    listen(runner, millis(500));
    runner.master().lift_stop_of(id(1));
    assert_eq!(bring_up::change_id(runner, id(1), id(9)), Ok(()));
}

fn a_stopped_motor_is_waited_for_until_it_stands<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
    runner.ask(id(1), turn(100.0)).expect("it is there");
    listen(runner, millis(500));
    let begun = runner.now();
    let returned =
        bring_up::wait_until_stands(runner, id(1), millis(200)).expect_err("it turns on");
    assert!(matches!(returned, BringUpError::Turns { .. }), "{returned}");
    let took = runner.now() - begun;
    assert!(took >= millis(200) && took < millis(250), "{took}");

    let speed = || drive.with(|drive| drive.plant().output_speed_dps().abs());
    assert!(runner.stop(id(1), StopKind::Hold));
    assert!(speed() > 50.0, "confirmed, and at {} dps", speed());
    assert_eq!(bring_up::wait_until_stands(runner, id(1), millis(1_000)), Ok(()));
    assert!(speed() < 3.0, "{}", speed());
}

/// A held load that swings by a degree or so, and a weight that comes up and falls back. The latter stands for 100 ms
/// only where it then swings at no more than 13 degrees/s: ±2 degrees/s around its turn are 40 degrees/s², which is
/// reached 4 degrees beside its lowest point.
fn a_load_that_swings_does_not_stand_where_it_turns_back<W: Wire>() {
    let heavy = Load { inertia_kg_m2: 10.0, ..Load::NONE };
    let weight =
        Load { arm: Some(Arm { mass_kg: 3.0, length_m: 1.0, down_deg: 0.0 }), ..Load::NONE };
    for (load, kind, most) in [(weight, StopKind::Off, 13.0), (heavy, StopKind::Hold, 4.0)] {
        let bus = W::drives(&Fleet::new(1).load(load)).unwrap();
        let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
        runner.ask(id(1), turn(90.0)).expect("it is there");
        listen(runner, millis(1_500));
        assert!(runner.stop(id(1), kind));
        assert_eq!(bring_up::wait_until_stands(runner, id(1), millis(60_000)), Ok(()));
        for _ in 0..100 {
            listen(runner, millis(10));
            let speed = drive.with(|drive| drive.plant().output_speed_dps());
            assert!(speed.abs() < most, "{kind:?}: {speed}");
        }
    }
}

fn an_id_that_two_motors_have_is_not_changed<W: Wire>() {
    // Like drives from the factory.
    let bus = W::drives(&Fleet::new(2).all_with_id(id(1))).unwrap();
    let runner = &mut master(&bus);
    let found = bring_up::scan(runner, MotorSet::ALL, |_, _| {}).expect("a bus");
    assert!([MotorSet::EMPTY, ids([1])].contains(&found), "{found:?}");
    assert_eq!(bring_up::is_shared(runner, id(1)), Ok(true));
    let refused = bring_up::change_id(runner, id(1), id(9));
    assert_eq!(refused, Err(BringUpError::IdShared(id(1))));
    for drive in &bus.drives {
        assert_eq!(drive.with(|drive| drive.stored_settings().id), id(1), "nothing was changed");
    }
}

fn motor_that_answers_late_is_not_taken_for_two<W: Wire>() {
    // Later than the master's time-out. Both attempts are answered after it.
    let late = millis(30);
    let bus = W::drives(&Fleet::new(1).response(late, late)).unwrap();
    assert_eq!(bring_up::is_shared(&mut master(&bus), id(1)), Ok(false));
}

/// This many motors with id 1 that stall and report that every 100 ms.
fn stalled<W: Wire>(motors: u8) -> BusFleet<W> {
    let bus = W::drives(&Fleet::new(motors).all_with_id(id(1))).unwrap();
    let runner = &mut master(&bus);
    // On a line the answers of two motors are not understood.
    let _ = runner.ask(id(1), FunctionControl::ErrorReporting(Switch::On));
    for drive in &bus.drives {
        drive.with(|drive| drive.raise_fault(ErrorFlags::STALL));
    }
    let mut reports = 0;
    let heard = |event| {
        if let Event::Report { .. } = event {
            reports += 1;
        }
    };
    let end = runner.now() + millis(250);
    runner.run_until(end, heard).unwrap();
    assert!(motors > 1 || reports > 1, "{reports}");
    bus
}

fn motor_that_reports_its_errors_is_not_taken_for_two<W: Wire>() {
    let bus = stalled::<W>(1);
    // Whenever it is asked.
    for _ in 0..10 {
        let runner = &mut master(&bus);
        assert_eq!(bring_up::is_shared(runner, id(1)), Ok(false));
        listen(runner, millis(17));
    }
}

/// Each report of the motor looks like a second answer, until this master ends the reports.
#[test]
fn motor_that_reports_to_another_master_looks_like_two() {
    let bus = Fleet::new(1).on_can(1_000_000).unwrap();
    let report = |enable, runner: &mut <CanBus as Wire>::Runner<8>| {
        let command = ReportedCommand::of(Opcode::ReadStatus2).unwrap();
        let interval = ReportInterval::from_raw(1);
        runner.ask(id(1), ActiveReply { command, enable, interval }).unwrap();
    };
    let (other, runner) = (&mut master(&bus), &mut master(&bus));
    report(Switch::On, other);
    assert_eq!(bring_up::is_shared(runner, id(1)), Ok(true));
    report(Switch::Off, runner);
    assert_eq!(bring_up::is_shared(runner, id(1)), Ok(false));
    // A master does not ask a motor for what the motor reports on its command.
    report(Switch::On, runner);
    let reported = RequestError::Reported(Opcode::ReadStatus2);
    assert_eq!(bring_up::is_shared(runner, id(1)), Err(CallError::refused(id(1))(reported)));
}

fn two_motors_of_one_id_that_report_errors_are_recognised<W: Wire>() {
    let bus = stalled::<W>(2);
    for _ in 0..10 {
        let runner = &mut master(&bus);
        assert_eq!(bring_up::is_shared(runner, id(1)), Ok(true));
        listen(runner, millis(17));
    }
}

fn only_motor_keeps_its_new_id_over_a_power_cycle<W: Wire>() {
    let slow = Quirks { slow_boot: true, silent_id_change: true, ..Quirks::default() };
    for quirks in [Quirks::default(), slow] {
        let bus = W::drives(&Fleet::new(1).quirks(quirks)).unwrap();
        let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
        bring_up::wait_until_there(runner, id(1), Duration::from_secs(3)).expect("it starts");
        let empty = bring_up::change_id(runner, id(3), id(4));
        assert_eq!(empty, Err(BringUpError::NotThere(id(3))), "the only one there is another");
        bring_up::change_id(runner, id(1), id(9)).expect("it is alone");
        assert_eq!(bring_up::scan(runner, MotorSet::ALL, |_, _| {}), Ok(ids([9])));
        bus.world.reset(drive.station());
        let there = bring_up::wait_until_there(runner, id(9), Duration::from_secs(3));
        there.expect("it kept its id");
    }
}

fn brake_is_open_when_its_release_returns<W: Wire>() {
    let slow = Quirks { slow_brake: true, ..Quirks::default() };
    let bus = W::drives(&Fleet::new(1).brakes(true).quirks(slow)).unwrap();
    let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
    let moved = || state(drive).angle_deg.abs();
    let begun = runner.now();
    bring_up::release_brake(runner, id(1)).expect("it has a brake");
    let took = runner.now() - begun;
    assert!(took >= Quirks::SLOW_BRAKE_MAX, "it is waited for: {took}");
    assert_eq!(state(drive).brake, BrakeCommand::RELEASE);
    // Torque moves the shaft at once. Until then it was held.
    assert!(moved() < 0.01);
    assert!(state(drive).output_on);
    runner.ask(id(1), push(2.0)).expect("it is there");
    listen(runner, millis(50));
    assert!(moved() > 0.01, "{}", moved());
}

/// 2.31.1: not while it starts or moves.
fn a_motor_that_turns_is_given_no_protection<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
    runner.ask(id(1), turn(90.0)).expect("it is there");
    listen(runner, millis(200));
    let refused = bring_up::protect(runner, id(1), Milliseconds::from_raw(500));
    assert!(matches!(refused, Err(BringUpError::Turns { .. })), "{refused:?}");
    assert_eq!(drive.with(|drive| drive.stored_settings().protection_timeout.raw()), 0);
}

/// It ignores the first command of the next master, and sends it back.
fn a_drive_that_has_lost_an_earlier_master_is_protected<W: Wire>() {
    let quirks = Quirks { lost_master_heartbeat: true, ..Quirks::default() };
    let bus = W::drives(&Fleet::new(1).quirks(quirks)).unwrap();
    let drive = &bus.drives[0];
    let (short, long) = (Milliseconds::from_raw(100), Milliseconds::from_raw(500));
    assert_eq!(bring_up::protect(&mut master(&bus), id(1), short), Ok(Protection::Confirmed));
    // Shortly after its last message of that.
    bus.world.run_for(millis(1_150));
    assert!(state(drive).communication_lost);
    assert_eq!(bring_up::protect(&mut master(&bus), id(1), long), Ok(Protection::Confirmed));
    assert_eq!(drive.with(|drive| drive.stored_settings().protection_timeout), long);
}

fn brake_opens_under_a_short_protection<W: Wire>() {
    let bus = W::drives(&Fleet::new(1).brakes(true)).unwrap();
    let runner = &mut master(&bus);
    let limit = Milliseconds::from_raw(100);
    assert_eq!(bring_up::protect(runner, id(1), limit), Ok(Protection::Confirmed));
    assert_eq!(bring_up::release_brake(runner, id(1)), Ok(()));
    assert_eq!(state(&bus.drives[0]).brake, BrakeCommand::RELEASE);
}

/// The situation of a restarted program: the protection is still on, and the motor has heard nothing for a while.
fn a_brake_opens_though_its_drive_had_lost_its_master<W: Wire>() {
    let bus = W::drives(&Fleet::new(1).brakes(true)).unwrap();
    let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
    let limit = Milliseconds::from_raw(100);
    assert_eq!(bring_up::protect(runner, id(1), limit), Ok(Protection::Confirmed));
    listen(runner, millis(300));
    assert!(state(drive).communication_lost);
    assert_eq!(bring_up::release_brake(runner, id(1)), Ok(()));
    assert_eq!(state(drive).brake, BrakeCommand::RELEASE);
}

/// A locked brake may be all that has been seen of the restart. The turns are lost.
fn motor_that_has_restarted_does_not_move_on_when_its_brake_is_released<W: Wire>() {
    let bus = W::drives(&Fleet::new(1).brakes(true)).unwrap();
    let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
    bring_up::release_brake(runner, id(1)).expect("it has a brake");
    listen(runner, millis(100));
    bus.world.reset(drive.station());
    let status = runner.ask(id(1), ReadStatus1).expect("it is back at once");
    assert_eq!(status.brake, BrakeCommand::LOCK);
    assert!(!runner.master().has_restarted(id(1)));
    assert_eq!(bring_up::release_brake(runner, id(1)), Ok(()));
    assert!(runner.master().has_restarted(id(1)));
}

fn brake_of_a_motor_with_an_error_is_not_opened<W: Wire>() {
    let bus = W::drives(&Fleet::new(1).brakes(true)).unwrap();
    let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
    drive.with(|drive| drive.raise_fault(ErrorFlags::STALL));
    let (motor, errors) = (id(1), ErrorFlags::STALL);
    let refused = bring_up::release_brake(runner, motor);
    assert_eq!(refused, Err(BringUpError::Fault { motor, errors }));
    assert!(refused.unwrap_err().to_string().contains("motor 1 reports an error (motor stalled)"));
    assert_eq!(state(drive).brake, BrakeCommand::LOCK);
}

/// The motor holds the load, and then the brake does.
fn load_does_not_sink_while_its_brake_opens_and_locks<W: Wire>() {
    let bus = lifting::<W>();
    let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
    let begun_deg = state(drive).angle_deg;
    let has_moved = || (state(drive).angle_deg - begun_deg).abs() > 1.0;
    assert_eq!(bring_up::release_brake(runner, id(1)), Ok(()));
    assert!(!has_moved() && state(drive).output_on);
    assert_eq!(bring_up::lock_brake(runner, id(1)), Ok(()));
    assert!(runner.stop(id(1), StopKind::Off));
    listen(runner, millis(500));
    assert!(!has_moved() && !state(drive).output_on);
}

/// A motor with a slow brake and a load that pulls at it.
fn lifting<W: Wire>() -> BusFleet<W> {
    W::drives(&lifting_fleet(1)).unwrap()
}

fn lifting_fleet(motors: u8) -> Fleet {
    let quirks = Quirks { slow_brake: true, ..Quirks::default() };
    let load = Load { torque_nm: 5.0, ..Load::NONE };
    Fleet::new(motors).brakes(true).quirks(quirks).load(load)
}

/// The motor draws all the current that it may, and its load pulls it away all the same.
fn a_load_that_is_too_heavy_for_the_motor_is_caught_by_the_brake<W: Wire>() {
    let load = Load { torque_nm: 60.0, ..Load::NONE };
    let bus = W::drives(&Fleet::new(1).brakes(true).load(load)).unwrap();
    let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
    let returned = bring_up::release_brake(runner, id(1));
    assert!(matches!(returned, Err(BringUpError::NotHeld { .. })), "{returned:?}");
    listen(runner, bring_up::BRAKE_MOVES);
    let caught_deg = state(drive).angle_deg;
    listen(runner, millis(500));
    assert!((state(drive).angle_deg - caught_deg).abs() < 0.1, "{returned:?}");
}

fn motor_holds_its_load_again_when_its_brake_slips<W: Wire>() {
    let bus = lifting::<W>();
    let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
    assert_eq!(bring_up::release_brake(runner, id(1)), Ok(()));
    drive.with(|drive| drive.plant_mut().force_brake(Some(true)));
    let settings = || drive.with(|drive| *drive.stored_settings());
    let before = settings();
    for way in [
        |runner: &mut W::Runner<8>| bring_up::lock_brake(runner, id(1)),
        |runner: &mut W::Runner<8>| bring_up::zero_here(runner, id(1)).map(drop),
        |runner: &mut W::Runner<8>| bring_up::change_id(runner, id(1), id(9)),
        |runner: &mut W::Runner<8>| bring_up::restart(runner, id(1), id(1)),
    ] {
        let returned = way(runner);
        assert!(
            matches!(returned, Err(BringUpError::BrakeSlips { holds: Some(true), .. })),
            "{returned:?}"
        );
        let held_deg = state(drive).angle_deg;
        listen(runner, millis(500));
        assert!((state(drive).angle_deg - held_deg).abs() < 0.1 && state(drive).output_on);
    }
    assert_eq!(settings(), before, "nothing was written");
}

/// At any time while the brake locks and the shaft is looked at. Where this motor is alone, nobody acknowledges a frame
/// then.
fn motor_holds_its_load_again_though_the_bus_is_out_when_its_brake_slips<W: Wire>() {
    let cuts = || core::iter::once(None).chain((1..400).step_by(20).map(Some));
    let mut locks_at_ms = 0;
    for (motors, cut) in [2, 1].into_iter().flat_map(|motors| cuts().map(move |cut| (motors, cut)))
    {
        let at = |ms| locks_at_ms + ms;
        let faults =
            cut.map(|ms| [format!("cut@1+{}ms", at(ms)), format!("mend@1+{}ms", at(ms + 150))]);
        let faults = faults.into_iter().flatten().map(|fault| fault.parse().unwrap());
        let bus = W::drives(&lifting_fleet(motors).faults(faults)).unwrap();
        let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
        assert_eq!(bring_up::release_brake(runner, id(1)), Ok(()));
        locks_at_ms = runner.now().as_micros() / 1_000;
        drive.with(|drive| drive.plant_mut().force_brake(Some(true)));
        let returned = bring_up::lock_brake(runner, id(1));
        assert!(returned.is_err(), "{cut:?}");
        let held_deg = state(drive).angle_deg;
        listen(runner, millis(500));
        // It would turn by hundreds.
        assert!((state(drive).angle_deg - held_deg).abs() < 1.0, "{cut:?}: {returned:?}");
    }
}

/// While a stop is in force, opening the brake again is refused.
fn a_slipping_brake_that_may_not_be_opened_is_reported<W: Wire>() {
    let bus = lifting::<W>();
    let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
    assert_eq!(bring_up::release_brake(runner, id(1)), Ok(()));
    drive.with(|drive| drive.plant_mut().force_brake(Some(true)));
    assert!(runner.stop(id(1), StopKind::Hold));
    let returned = bring_up::lock_brake(runner, id(1)).expect_err("its load falls");
    assert!(
        matches!(returned, BringUpError::BrakeSlips { holds: Some(false), .. }),
        "{returned:?}"
    );
    assert!(!returned.to_string().contains("holds"), "{returned}");
}

/// The brake stays locked.
fn a_brake_that_slips_only_when_the_motor_is_off_is_reported<W: Wire>() {
    for slips in [false, true] {
        let bus = lifting::<W>();
        let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
        assert_eq!(bring_up::release_brake(runner, id(1)), Ok(()));
        assert_eq!(bring_up::lock_brake(runner, id(1)), Ok(()));
        drive.with(|drive| drive.plant_mut().force_brake(slips.then_some(true)));
        assert!(runner.stop(id(1), StopKind::Off));
        let returned = bring_up::check_brake(runner, id(1));
        let is_told = matches!(returned, Err(BringUpError::BrakeSlips { holds: Some(false), .. }));
        assert!(if slips { is_told } else { returned.is_ok() }, "{returned:?}");
        assert!(!state(drive).output_on);
    }
}

fn lock_brake_catches_a_falling_load<W: Wire>() {
    for fails in [false, true] {
        let bus = lifting::<W>();
        let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
        if fails {
            drive.with(|drive| drive.raise_fault(ErrorFlags::STALL));
        }
        runner.ask(id(1), ReleaseBrake).expect("it is there");
        listen(runner, millis(400));
        assert!(state(drive).measurement.speed_dps.abs() > 10.0, "it falls");
        assert_eq!(bring_up::lock_brake(runner, id(1)), Ok(()), "{fails}");
        let held_deg = state(drive).angle_deg;
        listen(runner, millis(500));
        assert!((state(drive).angle_deg - held_deg).abs() < 0.1, "{fails}");
    }
}

fn brake_holds_the_load_while_its_motor_is_switched_off<W: Wire>() {
    let ways = [
        |runner: &mut W::Runner<8>| bring_up::zero_here(runner, id(1)).map(drop),
        |runner: &mut W::Runner<8>| bring_up::restart(runner, id(1), id(1)),
        |runner: &mut W::Runner<8>| bring_up::change_id(runner, id(1), id(9)),
    ];
    for (number, way) in ways.into_iter().enumerate() {
        let bus = lifting::<W>();
        let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
        assert_eq!(bring_up::release_brake(runner, id(1)), Ok(()));
        let held_deg = drive.with(|drive| drive.plant().output_angle_deg());
        way(runner).unwrap();
        let sunk_deg = drive.with(|drive| drive.plant().output_angle_deg()) - held_deg;
        assert!(sunk_deg.abs() < 1.0, "{number}: {sunk_deg}");
    }
}

fn no_brake_is_locked_on_a_turning_shaft_and_a_missing_brake_is_reported<W: Wire>() {
    for has_brake in [true, false] {
        let bus = W::drives(&Fleet::new(1).brakes(has_brake)).unwrap();
        let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
        runner.ask(id(1), turn(90.0)).expect("it is there");
        listen(runner, millis(500));
        let refused = bring_up::lock_brake(runner, id(1));
        assert!(refused.is_err(), "{refused:?}");
        assert_eq!(state(drive).brake, BrakeCommand::RELEASE);
        runner.ask(id(1), Stop).expect("it is there");
        listen(runner, millis(1_000));
        let (motor, says) = (id(1), BrakeCommand::RELEASE);
        let returned = Err(BringUpError::BrakeNotLocked { motor, says });
        assert_eq!(bring_up::lock_brake(runner, id(1)), if has_brake { Ok(()) } else { returned });
    }
}

fn protected_motor_stops_when_it_hears_no_commands<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let (runner, drive) = (&mut master(&bus), &bus.drives[0]);
    let limit = Milliseconds::from_raw(200);
    assert_eq!(bring_up::protect(runner, id(1), limit), Ok(Protection::Confirmed));
    for _ in 0..20 {
        runner.ask(id(1), turn(50.0)).expect("it is there");
        listen(runner, millis(50));
        assert!(state(drive).output_on, "commands come in time");
    }
    // No command reads the setting back. It shows when the motor hears nothing.
    listen(runner, millis(180));
    assert!(!state(drive).output_on);
    assert!(state(drive).communication_lost);
    // Without protection it goes on.
    let off = bring_up::protect(runner, id(1), Milliseconds::from_raw(0));
    assert_eq!(off, Ok(Protection::Confirmed));
    runner.ask(id(1), turn(50.0)).expect("it is there");
    listen(runner, millis(1_000));
    assert!(state(drive).output_on);
}

/// Whether the bus has carried a command to restart.
fn is_reset<W: Wire>(record: &trace::Record<W::Frame>) -> bool {
    let trace::Event::Carried { frame, .. } = &record.event else { return false };
    W::packet(&mut Receiver::new(), frame, true).is_some_and(|packet| packet.data[0] == 0x76)
}

/// Runs `work` on motor 1 of two. The motor's wire is cut for 2 ms when the first 0x76 is sent. Returns the outcome and
/// how often motor 1 has restarted.
fn with_first_restart_lost<W: Wire, T>(work: impl FnMut(&mut W::Runner<8>) -> T) -> (T, u32) {
    with_first_restart_lost_by::<W, T>(Quirks::default(), 2_000, work)
}

fn with_first_restart_lost_by<W: Wire, T>(
    quirks: Quirks,
    cut_for_us: u64,
    mut work: impl FnMut(&mut W::Runner<8>) -> T,
) -> (T, u32) {
    let mut lost_at = None;
    loop {
        let faults = lost_at
            .into_iter()
            .flat_map(|us: u64| [format!("cut@1+{us}us"), format!("mend@1+{}us", us + cut_for_us)]);
        let fleet = Fleet::new(2).quirks(quirks).faults(faults.map(|fault| fault.parse().unwrap()));
        let bus = W::drives(&fleet).unwrap();
        turn_to(&bus.drives[0], 50.0);
        // Let it run for a while.
        bus.world.run_for(millis(5_000));
        myactuator_tests::fleet::happened(&bus.drives[0]);
        let log = bus.world.log();
        let result = work(&mut master(&bus));
        let first = log.take().into_iter().find(is_reset::<W>);
        if lost_at.is_some() {
            let restarts = myactuator_tests::fleet::happened(&bus.drives[0]).into_iter();
            let restarted = |it: &drive::Event| matches!(it, drive::Event::Started);
            return (result, restarts.filter(restarted).count() as u32);
        }
        lost_at = Some(first.expect("it was told to restart").at_ns / 1_000 - 60);
    }
}

/// The first 0x76 is lost, so the motor goes on and answers.
fn restart_that_the_drive_missed_is_sent_again<W: Wire>() {
    let restart = |runner: &mut W::Runner<8>| bring_up::restart(runner, id(1), id(1));
    // It is sent once more, which the drive hears.
    assert_eq!(with_first_restart_lost::<W, _>(restart), (Ok(()), 1));
}

fn a_new_id_is_taken_though_the_restart_was_lost_once<W: Wire>() {
    let change = |runner: &mut W::Runner<8>| bring_up::change_id(runner, id(1), id(5));
    let (returned, restarts) = with_first_restart_lost::<W, _>(change);
    assert!(returned.is_ok() && restarts == 1, "{returned:?} after {restarts} restarts");
}

fn a_zero_is_kept_though_the_restart_was_lost_once<W: Wire>() {
    let zero = |runner: &mut W::Runner<8>| bring_up::zero_here(runner, id(1));
    let (returned, restarts) = with_first_restart_lost::<W, _>(zero);
    assert!(returned.is_ok() && restarts == 1, "{returned:?} after {restarts} restarts");
}

/// Firmware 2025070202: until it restarts, a drive hears the old id and answers under the new one.
fn the_restart_of_a_drive_that_answers_as_its_new_id_is_sent_again<W: Wire>() {
    let quirks = Quirks { answers_as_new_id: true, slow_boot: true, ..Quirks::default() };
    let change = |runner: &mut W::Runner<8>| bring_up::change_id(runner, id(1), id(5));
    let (returned, restarts) = with_first_restart_lost_by::<W, _>(quirks, 2_000, change);
    assert_eq!((returned, restarts), (Ok(()), 1));
}

fn a_motor_that_falls_silent_after_a_write_may_have_kept_it<W: Wire>() {
    let change = |runner: &mut W::Runner<8>| bring_up::change_id(runner, id(1), id(5));
    let (changed, _) = with_first_restart_lost_by::<W, _>(Quirks::default(), 60_000_000, change);
    let zero = |runner: &mut W::Runner<8>| bring_up::zero_here(runner, id(1)).map(|_| ());
    let (zeroed, _) = with_first_restart_lost_by::<W, _>(Quirks::default(), 60_000_000, zero);
    for returned in [changed, zeroed] {
        let returned = returned.unwrap_err().to_string();
        assert!(
            returned.starts_with("motor 1 may have its new zero or id in its ROM"),
            "{returned}"
        );
        assert!(returned.contains("no reply"), "{returned}");
    }
}

/// Moves are refused because the motor's turns may be lost. A restart that was never heard does not change that.
#[test]
fn restart_that_was_never_heard_allows_no_moves() {
    let mut cuts: Vec<u64> = Vec::new();
    for _ in 0..4 {
        let faults = cuts
            .iter()
            .flat_map(|us| [format!("cut@1+{us}us"), format!("mend@1+{}us", us + 2_000)]);
        let faults = faults.map(|fault| fault.parse().unwrap());
        let bus = Fleet::new(2).faults(faults).on_can(1_000_000).unwrap();
        bus.world.run_for(millis(5_000));
        let runner = &mut bus.master::<8>();
        assert!(runner.ask(id(1), ReadStatus1).is_ok());
        runner.master().note_restart(id(1));
        let log = bus.world.log();
        let returned = bring_up::restart(runner, id(1), id(1));
        if returned == Err(BringUpError::NotRestarted(id(1))) {
            assert!(runner.master().has_restarted(id(1)));
            return;
        }
        let last = log.take().into_iter().rfind(is_reset::<CanBus>);
        cuts.push(last.unwrap().at_ns / 1_000 - 60);
    }
    panic!("it was heard");
}
