//! Motors that stop when they hear nothing for a while go on holding their loads while a function works with another.

use core::ops::ControlFlow;

use myactuator_host_std::sim::bus::can::CanBus;
use myactuator_host_std::sim::plant::Load;
use myactuator_host_std::sim::{BusFleet, Fleet};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{AbsolutePosition, Stop};
use myactuator_protocol_core::drive::{Event, Quirks};
use myactuator_protocol_core::io::bring_up::{self, BringUpError, Protection};
use myactuator_protocol_core::io::{CallError, Runner};
use myactuator_protocol_core::master::MotorSet;
use myactuator_protocol_core::units::{Angle, MaxSpeed, Milliseconds};
use myactuator_tests::fleet::{happened, master, state};
use myactuator_tests::on_both_buses;
use myactuator_tests::values::{id, millis};
use myactuator_tests::wire::Wire;

on_both_buses! {
    motors_are_released_and_locked_in_turn
    one_is_restarted
    one_gets_a_zero
    one_gets_another_id
    one_is_moved
    all_ids_are_looked_for
    one_that_is_not_there_is_waited_for
    two_with_one_id_are_told_apart
    two_of_them_are_dead
}

/// A restart takes ten times as long, and twice as long without an answer.
const LIMIT: Milliseconds = Milliseconds::from_raw(100);
/// Of these one is worked with.
const MOTORS: u8 = 6;

fn others() -> impl Iterator<Item = MotorId> {
    (2..=MOTORS).map(id)
}

/// Motors with slow brakes and loads that pull at them. All but the first are held.
fn held<W: Wire>() -> (BusFleet<W>, W::Runner<8>) {
    let quirks = Quirks { slow_brake: true, ..Quirks::default() };
    let load = Load { torque_nm: 5.0, ..Load::NONE };
    let bus = W::drives(&Fleet::new(MOTORS).brakes(true).quirks(quirks).load(load)).unwrap();
    let mut runner = master(&bus);
    for motor in others().chain([id(1)]) {
        assert_eq!(bring_up::protect(&mut runner, motor, LIMIT), Ok(Protection::Confirmed));
    }
    for motor in others() {
        assert_eq!(bring_up::release_brake(&mut runner, motor), Ok(()));
    }
    (bus, runner)
}

#[track_caller]
fn check_others_hold<W: Wire>(bus: &BusFleet<W>) {
    for drive in &bus.drives[1..] {
        assert!(!happened(drive).contains(&Event::ProtectionTripped), "{}", drive.motor());
        assert!(state(drive).output_on, "{}", drive.motor());
    }
}

fn motors_are_released_and_locked_in_turn<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    check_others_hold(&bus);
    assert_eq!(bring_up::release_brake(&mut runner, id(1)), Ok(()));
    check_others_hold(&bus);
    assert_eq!(bring_up::lock_brake(&mut runner, id(1)), Ok(()));
    check_others_hold(&bus);
}

fn one_is_restarted<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    assert_eq!(bring_up::restart(&mut runner, id(1), id(1)), Ok(()));
    check_others_hold(&bus);
}

fn one_gets_a_zero<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    bring_up::zero_here(&mut runner, id(1)).unwrap();
    check_others_hold(&bus);
}

fn one_gets_another_id<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    assert_eq!(bring_up::change_id(&mut runner, id(1), id(9)), Ok(()));
    check_others_hold(&bus);
}

fn one_is_moved<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    assert_eq!(bring_up::release_brake(&mut runner, id(1)), Ok(()));
    let to = AbsolutePosition {
        max_speed: MaxSpeed::from_dps(90.0).unwrap(),
        angle: Angle::from_degrees(30.0).unwrap(),
    };
    let go_on = |_: &_| ControlFlow::Continue(());
    bring_up::move_to(&mut runner, id(1), to, &Default::default(), go_on).unwrap();
    check_others_hold(&bus);
}

fn all_ids_are_looked_for<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    let expected = others().chain([id(1)]).collect();
    assert_eq!(bring_up::scan(&mut runner, MotorSet::ALL, |_, _| {}), Ok(expected));
    check_others_hold(&bus);
    // None is left with a question under way.
    for motor in others() {
        let _ticket = runner.master().request(motor, Stop).unwrap();
    }
}

fn one_that_is_not_there_is_waited_for<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    let waited = bring_up::wait_until_there(&mut runner, id(20), millis(500));
    assert_eq!(waited, Err(BringUpError::NotThere(id(20))));
    check_others_hold(&bus);
    for motor in others() {
        let _ticket = runner.master().request(motor, Stop).unwrap();
    }
}

fn two_with_one_id_are_told_apart<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    assert_eq!(bring_up::is_shared(&mut runner, id(1)), Ok::<_, CallError<_>>(false));
    check_others_hold(&bus);
}

/// One of them since a moment ago.
fn two_of_them_are_dead<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    bus.world.cut(bus.drives[4].station());
    bring_up::wait_until_there(&mut runner, id(20), millis(200)).unwrap_err();
    bus.world.cut(bus.drives[5].station());
    assert_eq!(bring_up::restart(&mut runner, id(1), id(1)), Ok(()));
    for drive in &bus.drives[1..4] {
        assert!(!happened(drive).contains(&Event::ProtectionTripped), "{}", drive.motor());
    }
}

/// A USB adapter hands over what it hears every 16 ms.
#[test]
fn all_of_a_can_bus_hold_behind_an_adapter_that_delivers_in_bursts() {
    let quirks = Quirks { slow_brake: true, ..Quirks::default() };
    let fleet = Fleet::new(MOTORS).brakes(true).quirks(quirks);
    let bus = fleet.on_can(1_000_000).unwrap();
    let (mut runner, station) = CanBus::runner::<8>(&bus.world, CanBus::CONFIG);
    bus.world.hand_over_every(station, millis(16));
    for motor in (1..=MOTORS).map(id) {
        assert_eq!(bring_up::protect(&mut runner, motor, LIMIT), Ok(Protection::Confirmed));
    }
    for motor in others() {
        assert_eq!(bring_up::release_brake(&mut runner, motor), Ok(()));
    }
    bus.drives.iter().for_each(|drive| drop(happened(drive)));
    assert_eq!(bring_up::restart(&mut runner, id(1), id(1)), Ok(()));
    check_others_hold(&bus);
}
