//! First contact and safe ways of working against whole simulated drives, on both buses.

use myactuator_host_std::bus::StationId;
use myactuator_host_std::sim::{DriveHandle, Fleet};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{
    BrakeCommand, ErrorFlags, ReadMultiTurnAngle, ReadMultiTurnEncoderOffset, ReadStatus1, Speed,
    Torque,
};
use myactuator_protocol_core::drive::Quirks;
use myactuator_protocol_core::io::bring_up::{self, BringUpError, Protection};
use myactuator_protocol_core::io::{CallError, Runner};
use myactuator_protocol_core::master::{Failure, MotorSet};
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::{Current, MaxTorque, Milliseconds, SpeedTarget};

/// What happens to the supply of a drive's station.
type PowerCycle<'a> = &'a dyn Fn(StationId);

fn id(number: u8) -> MotorId {
    MotorId::new(number).expect("1 to 32")
}

fn ids(numbers: impl IntoIterator<Item = u8>) -> MotorSet {
    numbers.into_iter().map(id).collect()
}

/// Runs a check on both buses with the same drives.
macro_rules! on_both {
    ($fleet:expr, $check:ident) => {{
        let fleet: Fleet = $fleet;
        let can = fleet.on_can(1_000_000).expect("the model is sound");
        $check(&mut can.master::<8>(), &can.drives, &|station| can.world.reset(station));
        let line = fleet.on_rs485(1_000_000).expect("the model is sound");
        $check(&mut line.master::<8>(), &line.drives, &|station| line.world.reset(station));
    }};
}

fn wait<R: Runner<8, Error: PartialEq>>(runner: &mut R, span: Duration) {
    let end = runner.now() + span;
    while runner.now() < end {
        if runner.poll().expect("the bus works").is_none() {
            runner.idle(end);
        }
    }
}

fn turn_to(drive: &DriveHandle, degrees: f64) {
    drive.with(|drive| drive.plant_mut().set_output_angle_deg(degrees).expect("a finite angle"));
}

fn scan_finds<R: Runner<8, Error: PartialEq>>(
    runner: &mut R,
    _: &[DriveHandle],
    _: PowerCycle<'_>,
) {
    let mut told = Vec::new();
    let found = bring_up::scan(runner, MotorSet::ALL, |motor, there| told.push((motor, there)));
    assert_eq!(found, Ok(ids(1..=5)));
    told.sort_unstable();
    let expected: Vec<_> = (1..=32).map(|number| (id(number), number <= 5)).collect();
    assert_eq!(told, expected, "each is told of once");
    // The places that it needed are free again.
    assert_eq!(runner.master().motors(), MotorSet::EMPTY);
    assert_eq!(bring_up::scan(runner, ids([2, 9]), |_, _| {}), Ok(ids([2])));
}

#[test]
fn a_scan_tells_who_is_there() {
    on_both!(Fleet::new(5), scan_finds);
}

fn scan_waits_for_what_is_under_way<R: Runner<8, Error: PartialEq>>(
    runner: &mut R,
    _: &[DriveHandle],
    _: PowerCycle<'_>,
) {
    // Both are being asked already; only motor 1 is there to answer.
    let now = runner.now();
    for motor in [id(1), id(9)] {
        let _ticket = runner.master().request(motor, ReadStatus1, now).expect("it is free");
    }
    assert_eq!(bring_up::scan(runner, ids([1, 9]), |_, _| {}), Ok(ids([1])));
}

#[test]
fn a_motor_that_is_being_asked_is_not_there_before_it_answers() {
    on_both!(Fleet::new(1), scan_waits_for_what_is_under_way);
}

fn identifies<R: Runner<8, Error: PartialEq>>(
    runner: &mut R,
    _: &[DriveHandle],
    _: PowerCycle<'_>,
) {
    wait(runner, Duration::from_millis(300));
    let identity = bring_up::identify(runner, id(2)).expect("it is there");
    assert_eq!(identity.model.to_string(), "X8-PRO");
    assert_eq!(identity.status.errors, ErrorFlags::empty());
    assert!((290..=400).contains(&identity.run_time.raw()), "{}", identity.run_time);
    let nobody = bring_up::identify(runner, id(7)).expect_err("nobody is there");
    assert_eq!(nobody, CallError::Failed(Failure::NoReply));
}

#[test]
fn a_motor_tells_what_it_is() {
    on_both!(Fleet::new(2), identifies);
}

fn waits<R: Runner<8, Error: PartialEq>>(
    runner: &mut R,
    drives: &[DriveHandle],
    power_cycle: PowerCycle<'_>,
) {
    power_cycle(drives[0].station());
    let begun = runner.now();
    let half = Duration::from_millis(500);
    let early = bring_up::wait_until_there(runner, id(1), half);
    assert_eq!(early, Err(BringUpError::NotThere(id(1))));
    assert!(runner.now() - begun < half + Duration::from_millis(100));
    bring_up::wait_until_there(runner, id(1), Duration::from_secs(3)).expect("it starts");
    let took = runner.now() - begun;
    assert!(took >= Quirks::SLOW_BOOT, "{took}");
    assert!(took < Quirks::SLOW_BOOT + Duration::from_millis(150), "{took}");
    assert!(runner.ask(id(1), ReadStatus1).is_ok());
}

#[test]
fn a_motor_is_waited_for_after_its_power_was_cycled() {
    let slow = Quirks { slow_boot: true, ..Quirks::default() };
    on_both!(Fleet::new(1).quirks(slow), waits);
}

fn zeroes<R: Runner<8, Error: PartialEq>>(
    runner: &mut R,
    drives: &[DriveHandle],
    power_cycle: PowerCycle<'_>,
) {
    turn_to(&drives[0], 90.0);
    wait(runner, Duration::from_millis(20));
    let before = runner.ask(id(1), ReadMultiTurnAngle).expect("it is there").angle.degrees();
    assert!((before - 90.0).abs() < 0.1, "{before}");
    let offset = bring_up::zero_here(runner, id(1)).expect("it keeps its zero");
    assert_ne!(offset.raw(), 0);
    power_cycle(drives[0].station());
    bring_up::wait_until_there(runner, id(1), Duration::from_secs(3)).expect("it starts");
    let kept = runner.ask(id(1), ReadMultiTurnEncoderOffset).expect("it is there").offset;
    assert_eq!(kept, offset);
    let after = runner.ask(id(1), ReadMultiTurnAngle).expect("it is there").angle.degrees();
    assert!(after.abs() < 0.1, "{after}");
    // The zero is a place and not wherever the shaft is.
    turn_to(&drives[0], 120.0);
    wait(runner, Duration::from_millis(20));
    let turned = runner.ask(id(1), ReadMultiTurnAngle).expect("it is there").angle.degrees();
    assert!((turned - 30.0).abs() < 0.1, "{turned}");
}

#[test]
fn a_zero_is_kept_over_a_power_cycle() {
    on_both!(Fleet::new(1), zeroes);
}

fn refuses<R: Runner<8, Error: PartialEq>>(
    runner: &mut R,
    drives: &[DriveHandle],
    _: PowerCycle<'_>,
) {
    let two = bring_up::change_id(runner, id(1), id(9));
    assert_eq!(two, Err(BringUpError::NotAlone(ids([1, 2]))));
    let taken = bring_up::change_id(runner, id(1), id(2));
    assert_eq!(taken, Err(BringUpError::IdTaken(id(2))));
    let stranger = bring_up::change_id(runner, id(5), id(6));
    assert_eq!(stranger, Err(BringUpError::NotAlone(ids([1, 2]))));
    for (drive, number) in drives.iter().zip(1..) {
        let ids = drive.with(|drive| (drive.id(), drive.stored_settings().id));
        assert_eq!(ids, (id(number), id(number)), "nothing was changed");
    }
}

#[test]
fn an_id_is_not_changed_while_two_motors_listen_or_it_is_taken() {
    on_both!(Fleet::new(2), refuses);
}

fn changes<R: Runner<8, Error: PartialEq>>(
    runner: &mut R,
    drives: &[DriveHandle],
    power_cycle: PowerCycle<'_>,
) {
    bring_up::wait_until_there(runner, id(1), Duration::from_secs(3)).expect("it starts");
    let empty = bring_up::change_id(runner, id(3), id(4));
    assert_eq!(empty, Err(BringUpError::NotAlone(ids([1]))), "the only one there is another");
    bring_up::change_id(runner, id(1), id(9)).expect("it is alone");
    assert_eq!(bring_up::scan(runner, MotorSet::ALL, |_, _| {}), Ok(ids([9])));
    power_cycle(drives[0].station());
    bring_up::wait_until_there(runner, id(9), Duration::from_secs(3)).expect("it kept its id");
}

#[test]
fn the_only_motor_gets_its_new_id_for_good() {
    on_both!(Fleet::new(1), changes);
    let slow = Quirks { slow_boot: true, silent_id_change: true, ..Quirks::default() };
    on_both!(Fleet::new(1).quirks(slow), changes);
}

fn opens<R: Runner<8, Error: PartialEq>>(
    runner: &mut R,
    drives: &[DriveHandle],
    _: PowerCycle<'_>,
) {
    let push = Torque { current: Current::from_amperes(2.0).expect("in range") };
    let moved = |drives: &[DriveHandle]| drives[0].with(|drive| drive.state().angle_deg.abs());
    let begun = runner.now();
    bring_up::release_brake(runner, id(1)).expect("it has a brake");
    let took = runner.now() - begun;
    assert!(took >= Quirks::SLOW_BRAKE_MAX, "it is waited for: {took}");
    assert_eq!(drives[0].with(|drive| drive.state().brake), BrakeCommand::Release);
    // Torque moves the shaft from the first moment.
    assert!(moved(drives) < 0.01);
    runner.ask(id(1), push).expect("it is there");
    wait(runner, Duration::from_millis(50));
    assert!(moved(drives) > 0.01, "{}", moved(drives));
}

#[test]
fn a_brake_is_open_before_torque_comes() {
    let slow = Quirks { slow_brake: true, ..Quirks::default() };
    on_both!(Fleet::new(1).brakes(true).quirks(slow), opens);
}

fn stays_locked<R: Runner<8, Error: PartialEq>>(
    runner: &mut R,
    drives: &[DriveHandle],
    _: PowerCycle<'_>,
) {
    // A drive that has lost its master answers 0x77 and does nothing.
    let limit = Milliseconds::from_raw(100);
    assert_eq!(bring_up::protect(runner, id(1), limit), Ok(Protection::Confirmed));
    wait(runner, Duration::from_millis(300));
    assert!(drives[0].with(|drive| drive.state().communication_lost));
    let refused = bring_up::release_brake(runner, id(1));
    assert_eq!(refused, Err(BringUpError::BrakeNotReleased(BrakeCommand::Lock)));
}

#[test]
fn a_brake_that_does_not_open_is_told() {
    on_both!(Fleet::new(1).brakes(true), stays_locked);
}

fn protects<R: Runner<8, Error: PartialEq>>(
    runner: &mut R,
    drives: &[DriveHandle],
    _: PowerCycle<'_>,
) {
    let limit = Milliseconds::from_raw(200);
    assert_eq!(bring_up::protect(runner, id(1), limit), Ok(Protection::Confirmed));
    let speed = SpeedTarget::from_dps(50.0).expect("in range");
    let turn = Speed { max_torque: MaxTorque::from_raw(0), speed };
    let output_on = |drives: &[DriveHandle]| drives[0].with(|drive| drive.state().output_on);
    for _ in 0..20 {
        runner.ask(id(1), turn).expect("it is there");
        wait(runner, Duration::from_millis(50));
        assert!(output_on(drives), "commands come in time");
    }
    // What no command can read back: it stops when nobody speaks.
    wait(runner, Duration::from_millis(180));
    assert!(!output_on(drives));
    assert!(drives[0].with(|drive| drive.state().communication_lost));
    // Switched off, it does not.
    assert_eq!(
        bring_up::protect(runner, id(1), Milliseconds::from_raw(0)),
        Ok(Protection::Confirmed)
    );
    runner.ask(id(1), turn).expect("it is there");
    wait(runner, Duration::from_millis(1_000));
    assert!(output_on(drives));
}

#[test]
fn a_protected_motor_stops_when_nobody_speaks() {
    on_both!(Fleet::new(1), protects);
}
