//! Shafts that are asked again and again whether they stand, and those that are not.

use std::cell::Cell;

use myactuator_host_std::sim::{DriveHandle, Fleet};
use myactuator_mcu_example::{Report, Setup, StateName, Trouble};
use myactuator_protocol_core::Data;
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{BrakeCommand, ErrorFlags};
use myactuator_tests::fleet::state;
use myactuator_tests::on_both_buses;
use myactuator_tests::values::{id, millis};

use super::brakes::{before_shutdown, fallen_deg, is_off, lets_go, loaded, slips, stays_held};
use super::gone::run_altered;
use super::shutdown::{break_off, shut_down};
use super::{Firmware, Moved, Panel, angle_deg, unplug};

on_both_buses! {
    a_brake_that_an_earlier_firmware_has_locked_is_watched
    a_brake_is_watched_although_its_answer_was_lost
    a_watched_motor_that_does_not_say_whether_it_stands_is_reported_once
    a_watched_motor_with_an_error_is_reported_whatever_the_cycle
    a_motor_that_is_held_again_and_restarts_is_held_again
    after_a_shutdown_in_which_one_turned_the_others_are_watched
    a_slip_while_another_motor_lets_go_is_seen_at_once
    a_slip_while_motors_are_looked_for_is_seen
    a_press_after_a_slip_that_ended_a_start_starts_nothing
    a_slip_while_another_motor_writes_slowly_is_seen
    a_slip_while_brakes_open_one_after_the_other_is_seen
    a_slip_while_others_do_not_confirm_their_stop_is_seen
    a_slip_of_a_motor_that_confirmed_late_is_seen_during_the_next_start
    a_slip_in_the_moment_of_a_press_is_seen
    a_slip_of_a_motor_that_is_back_soon_is_seen_during_the_next_start
    a_brake_that_an_error_has_locked_is_watched
    a_press_after_a_shaft_has_turned_starts_nothing
    a_load_that_sinks_until_its_brake_has_locked_is_no_slip
    a_load_that_sinks_before_it_ran_is_no_slip
    a_load_that_sinks_after_a_start_that_was_broken_off_is_no_slip
    a_shaft_that_is_turned_by_hand_after_a_shutdown_stays_free
    a_shaft_that_is_turned_by_hand_after_a_start_was_broken_off_stays_free
    a_shaft_that_is_turned_by_hand_before_a_shutdown_is_over_stays_free
}

fn is_open(drive: &DriveHandle) -> bool {
    state(drive).brake == BrakeCommand::RELEASE
}

/// The board restarted during a shutdown.
fn a_brake_that_an_earlier_firmware_has_locked_is_watched<B: Moved>() {
    for after_ms in [25, 150, 300] {
        let bus = loaded::<B>(8, true);
        let (mut firmware, before_deg) = before_shutdown(&bus);
        shut_down(&mut firmware);
        firmware.run_for(millis(after_ms));
        drop(firmware);
        let mut firmware = Firmware::start(&bus, Panel::default());
        firmware.run_for(millis(1_500));
        slips(&bus.drives[1]);
        firmware.run_for(millis(1_000));
        let (told, fallen) = (firmware.troubles(), fallen_deg(&bus, &before_deg));
        assert_eq!(told, [Trouble::Turns { motor: id(2) }], "{after_ms} ms: {fallen:?}");
        assert!(!is_off(&bus.drives[1]));
        // It is asked every 90 ms, and told to hold within 100 ms: 28 degrees without friction.
        assert!(fallen.iter().all(|&fallen| fallen < 28.0), "{after_ms} ms: {fallen:?}");
        stays_held(&mut firmware, &bus);
    }
}

/// The brake has locked, and the motor does not report what its brake does either.
fn a_brake_is_watched_although_its_answer_was_lost<B: Moved>() {
    let bus = loaded::<B>(3, true);
    let (mut firmware, before_deg) = before_shutdown(&bus);
    let altered = |mut data: Data| {
        if data[0] == 0x9A {
            data[3] = 1;
        }
        (data[0] != 0x78).then_some(data)
    };
    shut_down(&mut firmware);
    run_altered(&mut firmware, 1_500, altered);
    assert_eq!(firmware.troubles(), [Trouble::Silent { motor: id(3) }]);
    firmware.forget();
    slips(&bus.drives[2]);
    run_altered(&mut firmware, 1_000, altered);
    assert_eq!(firmware.troubles(), [Trouble::Turns { motor: id(3) }]);
    assert!(!is_off(&bus.drives[2]));
    assert!(fallen_deg(&bus, &before_deg)[2] < 15.0, "{:?}", fallen_deg(&bus, &before_deg));
    stays_held(&mut firmware, &bus);
}

/// It has let go, and answers everything else since. What its brake does nobody knows.
fn a_watched_motor_that_does_not_say_whether_it_stands_is_reported_once<B: Moved>() {
    let bus = loaded::<B>(3, true);
    let (mut firmware, _) = before_shutdown(&bus);
    lets_go(&mut firmware, &bus.drives[2], true, 0);
    run_altered(&mut firmware, 3_000, |data| (data[0] != 0x9C).then_some(data));
    assert_eq!(firmware.troubles(), [Trouble::Silent { motor: id(3) }]);
    firmware.forget();
    firmware.run_for(millis(1_000));
    run_altered(&mut firmware, 1_000, |data| (data[0] != 0x9C).then_some(data));
    assert_eq!(firmware.troubles(), [Trouble::Silent { motor: id(3) }], "it had answered since");
}

/// Asked whether its shaft stands, it may be busy whenever it is its turn to be asked for its errors. The last one is
/// watched, or all are.
fn a_watched_motor_with_an_error_is_reported_whatever_the_cycle<B: Moved>() {
    let is_reported = |cycle_ms, motors: u8, is_one| {
        let bus = B::drives(&Fleet::new(motors).brakes(true)).unwrap();
        let search = MotorId::all().take(motors.into()).collect();
        let setup = Setup { search, cycle: millis(cycle_ms), ..B::setup() };
        let mut firmware = Firmware::start_with(&bus, Panel::default(), setup);
        firmware.run_for(millis(200));
        let last = bus.drives.last().unwrap();
        if is_one {
            firmware.run_for(millis(1_000));
            firmware.press(millis(50));
            firmware.run_until(Report::State(StateName::Running), millis(3_000));
            firmware.press(millis(50));
            lets_go(&mut firmware, last, true, 0);
            firmware.run_for(millis(1_500));
        }
        last.with(|drive| drive.raise_fault(ErrorFlags::STALL));
        firmware.run_for(millis(1_000));
        let error = Trouble::Errors { motor: last.motor(), flags: ErrorFlags::STALL };
        firmware.troubles().contains(&error)
    };
    for cycle_ms in [1, 4, 10, 20] {
        for (motors, is_one) in [(1, false), (2, false), (2, true), (3, true), (8, true)] {
            let case = format!("{cycle_ms} ms, {motors} motors, one watched: {is_one}");
            assert!(is_reported(cycle_ms, motors, is_one), "{case}");
        }
    }
}

/// Its brake slipped in a shutdown, so its motor holds it. Once that restarts, only the same brake does.
fn a_motor_that_is_held_again_and_restarts_is_held_again<B: Moved>() {
    for is_restart in [false, true] {
        let bus = loaded::<B>(3, true);
        let (mut firmware, _) = before_shutdown(&bus);
        slips(&bus.drives[1]);
        shut_down(&mut firmware);
        firmware.run_for(millis(1_000));
        assert_eq!(firmware.troubles(), [Trouble::Turns { motor: id(2) }]);
        bus.drives[1].with(|drive| drive.plant_mut().force_brake(None));
        lets_go(&mut firmware, &bus.drives[1], is_restart, 600);
        firmware.run_for(millis(1_000));
        firmware.forget();
        let before_deg: Vec<_> = bus.drives.iter().map(angle_deg).collect();
        slips(&bus.drives[1]);
        firmware.run_for(millis(1_000));
        let fallen = fallen_deg(&bus, &before_deg);
        assert_eq!(firmware.troubles(), [Trouble::Turns { motor: id(2) }], "{fallen:?}");
        assert!(!is_off(&bus.drives[1]));
        // All three are watched.
        assert!(fallen.iter().all(|&fallen| fallen < 23.0), "{fallen:?}");
        stays_held(&mut firmware, &bus);
    }
}

/// All hold again, and the brakes of the others have locked.
fn after_a_shutdown_in_which_one_turned_the_others_are_watched<B: Moved>() {
    let bus = loaded::<B>(3, true);
    let (mut firmware, _) = before_shutdown(&bus);
    slips(&bus.drives[1]);
    shut_down(&mut firmware);
    firmware.run_for(millis(2_000));
    assert_eq!(firmware.troubles(), [Trouble::Turns { motor: id(2) }]);
    firmware.forget();
    let before_deg: Vec<_> = bus.drives.iter().map(angle_deg).collect();
    slips(&bus.drives[0]);
    firmware.run_for(millis(1_000));
    let fallen = fallen_deg(&bus, &before_deg);
    assert_eq!(firmware.troubles(), [Trouble::Turns { motor: id(1) }], "{fallen:?}");
    assert!(!is_off(&bus.drives[0]));
    assert!(fallen.iter().all(|&fallen| fallen < 23.0), "{fallen:?}");
    stays_held(&mut firmware, &bus);
}

/// The brake of the other one has not locked yet. That is no reason to look away from this one.
fn a_slip_while_another_motor_lets_go_is_seen_at_once<B: Moved>() {
    for after_ms in [0, 60, 100, 140] {
        let bus = loaded::<B>(2, true);
        let (mut firmware, _) = before_shutdown(&bus);
        lets_go(&mut firmware, &bus.drives[0], true, 0);
        firmware.run_for(millis(2_000));
        let before_deg: Vec<_> = bus.drives.iter().map(angle_deg).collect();
        lets_go(&mut firmware, &bus.drives[1], true, 0);
        firmware.run_for(millis(after_ms));
        slips(&bus.drives[0]);
        firmware.run_for(millis(1_000));
        let fallen = fallen_deg(&bus, &before_deg);
        assert_eq!(firmware.troubles(), [Trouble::Turns { motor: id(1) }], "{after_ms} ms");
        assert!(!is_off(&bus.drives[0]));
        // As if nothing else happened: 7 degrees, or 23 where the line may be occupied for 80 ms.
        let most_deg = if B::NAME == "CAN" { 8.0 } else { 23.0 };
        assert!(fallen[0] < most_deg && fallen[1] < 16.0, "{after_ms} ms: {fallen:?}");
        stays_held(&mut firmware, &bus);
    }
}

/// On CAN an id without a motor keeps the others waiting for 90 ms.
fn a_slip_while_motors_are_looked_for_is_seen<B: Moved>() {
    for (ids, after_ms) in [(8, 0), (8, 60), (32, 0), (32, 400)] {
        let bus = loaded::<B>(3, true);
        let setup = Setup { search: MotorId::all().take(ids).collect(), ..B::setup() };
        let mut firmware = Firmware::start_with(&bus, Panel::default(), setup);
        firmware.run_for(millis(1_500));
        firmware.press(millis(50));
        firmware.run_until(Report::State(StateName::Finding), millis(100));
        firmware.run_for(millis(after_ms));
        let before_deg: Vec<_> = bus.drives.iter().map(angle_deg).collect();
        slips(&bus.drives[1]);
        firmware.run_for(millis(1_000));
        let (told, fallen) = (firmware.troubles(), fallen_deg(&bus, &before_deg));
        let case = format!("{ids} ids, {after_ms} ms: {fallen:?}, {:?}", firmware.panel.reports);
        assert_eq!(told, [Trouble::Turns { motor: id(2) }], "{case}");
        let most_deg = if B::NAME == "CAN" { 8.0 } else { 23.0 };
        assert!(!is_off(&bus.drives[1]) && fallen[1] < most_deg, "{case}");
        stays_held(&mut firmware, &bus);
    }
}

/// A shaft turns at 5 dps, once, while motors are looked for or while brakes open. The start has ended, and whoever
/// presses then may have meant to end it.
fn a_press_after_a_slip_that_ended_a_start_starts_nothing<B: Moved>() {
    for is_opening in [false, true] {
        let bus = loaded::<B>(3, true);
        let setup = Setup { cycle: millis(10), ..B::setup() };
        let mut firmware = Firmware::start_with(&bus, Panel::default(), setup);
        firmware.run_for(millis(1_500));
        firmware.press(millis(50));
        firmware.run_until(Report::State(StateName::Finding), millis(100));
        while is_opening && !is_open(&bus.drives[0]) {
            firmware.run_for(millis(1));
        }
        let is_first = Cell::new(true);
        while is_first.get() {
            run_altered(&mut firmware, 10, |mut data| {
                if data[0] == 0x9C && is_first.replace(false) {
                    data[4] = 5;
                }
                Some(data)
            });
        }
        firmware.run_until(Report::State(StateName::Stopped), millis(1_000));
        assert_eq!(firmware.troubles(), [], "it has turned for a moment");
        firmware.forget();
        firmware.press(millis(50));
        firmware.stays_stopped();
        assert_eq!(firmware.panel.reports, [], "opening: {is_opening}");
    }
}

/// A motor accepts its protection only at the third attempt, 100 ms after the first. No brake was told to open yet.
fn a_slip_while_another_motor_writes_slowly_is_seen<B: Moved>() {
    let bus = loaded::<B>(2, true);
    let mut firmware = Firmware::start(&bus, Panel::default());
    firmware.run_until_preparing();
    unplug(&bus, &bus.drives[0]);
    let before_deg: Vec<_> = bus.drives.iter().map(angle_deg).collect();
    slips(&bus.drives[1]);
    firmware.run_for(millis(80));
    bus.world.mend(bus.drives[0].station());
    firmware.run_for(millis(1_000));
    let told = firmware.troubles();
    assert!(told.contains(&Trouble::Turns { motor: id(2) }), "{:?}", firmware.panel.reports);
    assert!(!is_off(&bus.drives[1]));
    let fallen = fallen_deg(&bus, &before_deg);
    // Also the check asks that motor first: 15 degrees without friction in 145 ms. On RS485 the whole line waits for
    // it, for 50 ms before and after: 36 degrees in 225 ms.
    let most_deg = if B::NAME == "CAN" { 15.0 } else { 36.0 };
    assert!(fallen[1] < most_deg, "{fallen:?}");
    stays_held(&mut firmware, &bus);
}

/// The brakes of the others are open already, and their motors hold.
fn a_slip_while_brakes_open_one_after_the_other_is_seen<B: Moved>() {
    let bus = loaded::<B>(8, true);
    let setup = Setup { cycle: millis(10), ..B::setup() };
    let mut firmware = Firmware::start_with(&bus, Panel::default(), setup);
    firmware.run_until_preparing();
    while !is_open(&bus.drives[0]) {
        firmware.run_for(millis(1));
    }
    let before_deg: Vec<_> = bus.drives.iter().map(angle_deg).collect();
    slips(&bus.drives[7]);
    firmware.run_for(millis(1_500));
    let (told, fallen) = (firmware.troubles(), fallen_deg(&bus, &before_deg));
    assert_eq!(told, [Trouble::Turns { motor: id(8) }], "{:?}", firmware.panel.reports);
    assert!(!firmware.panel.reports.contains(&Report::State(StateName::Running)));
    // Each command takes a cycle: up to 7 to the watched motors until this one is asked, 7 more until it is checked,
    // and a few to stop it and to hold it. 36 degrees in 225 ms.
    assert!(!is_off(&bus.drives[7]) && fallen[7] < 36.0, "{fallen:?}");
    stays_held(&mut firmware, &bus);
}

/// A start is broken off while motors are looked for. No motor has the other ids.
fn a_slip_while_others_do_not_confirm_their_stop_is_seen<B: Moved>() {
    for after_ms in [0, 100, 200] {
        let bus = loaded::<B>(2, true);
        let mut firmware = Firmware::start(&bus, Panel::default());
        firmware.run_for(millis(1_500));
        firmware.press(millis(50));
        firmware.run_until(Report::State(StateName::Finding), millis(100));
        break_off(&mut firmware);
        firmware.run_for(millis(after_ms));
        let before_deg: Vec<_> = bus.drives.iter().map(angle_deg).collect();
        slips(&bus.drives[1]);
        firmware.run_for(millis(1_000));
        let (told, fallen) = (firmware.troubles(), fallen_deg(&bus, &before_deg));
        let expected = [Trouble::BusDown, Trouble::Turns { motor: id(2) }];
        assert_eq!(told, expected, "{after_ms} ms: {fallen:?}");
        assert!(!is_off(&bus.drives[1]) && fallen[1] < 23.0, "{after_ms} ms: {fallen:?}");
        stays_held(&mut firmware, &bus);
    }
}

/// Its shaft could not be checked after the shutdown that was broken off.
fn a_slip_of_a_motor_that_confirmed_late_is_seen_during_the_next_start<B: Moved>() {
    for phase_ms in (0..400).step_by(40) {
        let bus = loaded::<B>(3, true);
        let (mut firmware, _) = before_shutdown(&bus);
        shut_down(&mut firmware);
        firmware.run_for(millis(25));
        unplug(&bus, &bus.drives[1]);
        break_off(&mut firmware);
        firmware.run_for(millis(2_000 + phase_ms));
        firmware.forget();
        firmware.press(millis(50));
        firmware.run_until(Report::State(StateName::Finding), millis(100));
        let before_deg: Vec<_> = bus.drives.iter().map(angle_deg).collect();
        slips(&bus.drives[1]);
        bus.world.mend(bus.drives[1].station());
        firmware.run_for(millis(1_000));
        let (told, fallen) = (firmware.troubles(), fallen_deg(&bus, &before_deg));
        assert!(told.contains(&Trouble::Turns { motor: id(2) }), "{phase_ms} ms: {told:?}");
        assert!(!is_off(&bus.drives[1]) && fallen[1] < 23.0, "{phase_ms} ms: {fallen:?}");
    }
}

/// It is seen in the cycle before the press counts, or about then.
fn a_slip_in_the_moment_of_a_press_is_seen<B: Moved>() {
    for phase_ms in 0..40 {
        let bus = loaded::<B>(2, true);
        let mut firmware = Firmware::start(&bus, Panel::default());
        firmware.run_for(millis(1_500 + phase_ms));
        let before_deg: Vec<_> = bus.drives.iter().map(angle_deg).collect();
        firmware.press(millis(50));
        slips(&bus.drives[1]);
        firmware.run_for(millis(1_500));
        let (told, fallen) = (firmware.troubles(), fallen_deg(&bus, &before_deg));
        assert_eq!(told, [Trouble::Turns { motor: id(2) }], "{phase_ms} ms: {fallen:?}");
        assert!(!is_off(&bus.drives[1]) && fallen[1] < 23.0, "{phase_ms} ms: {fallen:?}");
    }
}

/// It did not confirm the stop that broke a shutdown off, so its shaft was not checked.
fn a_slip_of_a_motor_that_is_back_soon_is_seen_during_the_next_start<B: Moved>() {
    for phase_ms in (0..60).step_by(5) {
        let bus = loaded::<B>(2, true);
        let (mut firmware, _) = before_shutdown(&bus);
        shut_down(&mut firmware);
        firmware.run_for(millis(25));
        unplug(&bus, &bus.drives[1]);
        firmware.press(millis(30));
        firmware.run_until(Report::Stopped { unconfirmed: id(2).into() }, millis(500));
        firmware.run_for(millis(phase_ms));
        firmware.forget();
        firmware.press(millis(30));
        firmware.run_until(Report::State(StateName::Finding), millis(100));
        let before_deg: Vec<_> = bus.drives.iter().map(angle_deg).collect();
        slips(&bus.drives[1]);
        bus.world.mend(bus.drives[1].station());
        firmware.run_for(millis(1_500));
        let (told, fallen) = (firmware.troubles(), fallen_deg(&bus, &before_deg));
        assert!(told.contains(&Trouble::Turns { motor: id(2) }), "{phase_ms} ms: {told:?}");
        assert!(!is_off(&bus.drives[1]) && fallen[1] < 23.0, "{phase_ms} ms: {fallen:?}");
    }
}

/// The error has gone.
fn a_brake_that_an_error_has_locked_is_watched<B: Moved>() {
    let bus = loaded::<B>(3, true);
    let (mut firmware, _) = before_shutdown(&bus);
    let (last, flags) = (&bus.drives[2], ErrorFlags::MOTOR_OVER_TEMPERATURE);
    last.with(|drive| drive.raise_fault(flags));
    firmware.run_for(millis(500));
    last.with(|drive| drive.clear_fault(flags));
    firmware.run_for(millis(1_500));
    let before_deg: Vec<_> = bus.drives.iter().map(angle_deg).collect();
    slips(last);
    firmware.run_for(millis(1_000));
    let (told, fallen) = (firmware.troubles(), fallen_deg(&bus, &before_deg));
    let motor = last.motor();
    assert_eq!(told, [Trouble::Errors { motor, flags }, Trouble::Turns { motor }], "{fallen:?}");
    assert!(!is_off(last) && fallen[2] < 23.0, "{fallen:?}");
    stays_held(&mut firmware, &bus);
}

/// However long it is, in a shutdown and where one was broken off.
fn a_press_after_a_shaft_has_turned_starts_nothing<B: Moved>() {
    for (is_broken_off, pressed_ms) in [(false, 50), (false, 1_200), (true, 50), (true, 1_200)] {
        let bus = loaded::<B>(3, true);
        let (mut firmware, _) = before_shutdown(&bus);
        slips(&bus.drives[1]);
        shut_down(&mut firmware);
        firmware.run_for(millis(25));
        if is_broken_off {
            firmware.press(millis(30));
        }
        firmware.run_until(Report::Trouble(Trouble::Turns { motor: id(2) }), millis(500));
        firmware.run_for(millis(900));
        firmware.forget();
        firmware.press(millis(pressed_ms));
        firmware.stays_stopped();
        assert_eq!(firmware.panel.reports, [], "{is_broken_off} {pressed_ms} ms");
    }
}

/// A motor that restarts lets go at once, and its brake is slow. The same after it has run again.
fn a_load_that_sinks_until_its_brake_has_locked_is_no_slip<B: Moved>() {
    for phase_ms in [0, 7, 14, 21] {
        let bus = loaded::<B>(1, true);
        let (mut firmware, _) = before_shutdown(&bus);
        firmware.run_for(millis(phase_ms));
        for _ in 0..2 {
            lets_go(&mut firmware, &bus.drives[0], true, 0);
            firmware.run_for(millis(1_500));
            assert_eq!(firmware.troubles(), [], "{phase_ms} ms");
            firmware.press(millis(50));
            firmware.run_until(Report::State(StateName::Running), millis(3_000));
            firmware.press(millis(50));
            firmware.run_for(millis(1_500));
            firmware.forget();
        }
    }
}

/// An earlier run of the firmware has opened the brakes. A motor restarts, or has an error and its brake is told to
/// lock.
fn a_load_that_sinks_before_it_ran_is_no_slip<B: Moved>() {
    for phase_ms in [0, 7, 14, 21, 28, 35] {
        for is_restart in [true, false] {
            let bus = loaded::<B>(2, true);
            drop(before_shutdown(&bus));
            let mut firmware = Firmware::start(&bus, Panel::default());
            firmware.run_for(millis(1_500 + phase_ms));
            let drive = &bus.drives[0];
            match is_restart {
                true => lets_go(&mut firmware, drive, true, 0),
                false => drive.with(|drive| drive.raise_fault(ErrorFlags::STALL)),
            }
            firmware.run_for(millis(1_500));
            let told = firmware.troubles();
            let is_slip = told.contains(&Trouble::Turns { motor: id(1) });
            assert!(!is_slip, "restart: {is_restart}, {phase_ms} ms: {told:?}");
        }
    }
}

/// The brakes have opened, and the motors never ran.
fn a_load_that_sinks_after_a_start_that_was_broken_off_is_no_slip<B: Moved>() {
    for phase_ms in [0, 7, 14, 21, 28, 35] {
        let bus = loaded::<B>(2, true);
        let mut firmware = Firmware::start(&bus, Panel::default());
        firmware.run_until_preparing();
        firmware.run_for(millis(150));
        break_off(&mut firmware);
        firmware.run_for(millis(1_500 + phase_ms));
        lets_go(&mut firmware, &bus.drives[0], true, 0);
        firmware.run_for(millis(1_500));
        assert_eq!(firmware.troubles(), [Trouble::BusDown], "{phase_ms} ms");
    }
}

/// A person who opens a brake by hand has shut down before. No motor switches itself on.
fn a_shaft_that_is_turned_by_hand_after_a_shutdown_stays_free<B: Moved>() {
    let bus = loaded::<B>(2, true);
    let (mut firmware, _) = before_shutdown(&bus);
    shut_down(&mut firmware);
    firmware.run_for(millis(1_000));
    slips(&bus.drives[1]);
    firmware.run_for(millis(1_000));
    assert_eq!(firmware.troubles(), []);
    assert!(bus.drives.iter().all(is_off));
}

/// After a shutdown, too. What was switched off is not switched on by a start that came to nothing.
fn a_shaft_that_is_turned_by_hand_after_a_start_was_broken_off_stays_free<B: Moved>() {
    let bus = loaded::<B>(2, true);
    let (mut firmware, _) = before_shutdown(&bus);
    shut_down(&mut firmware);
    firmware.run_for(millis(1_000));
    firmware.press(millis(50));
    firmware.run_until(Report::State(StateName::Finding), millis(100));
    firmware.press(millis(50));
    firmware.run_until(Report::State(StateName::Stopped), millis(1_500));
    firmware.run_for(millis(1_000));
    slips(&bus.drives[1]);
    firmware.run_for(millis(1_000));
    assert_eq!(firmware.troubles(), [Trouble::Button]);
    assert!(bus.drives.iter().all(is_off));
}

/// The other one does not confirm that it is switched off, which is waited for.
fn a_shaft_that_is_turned_by_hand_before_a_shutdown_is_over_stays_free<B: Moved>() {
    let bus = loaded::<B>(2, true);
    let (mut firmware, _) = before_shutdown(&bus);
    shut_down(&mut firmware);
    firmware.run_until(Report::State(StateName::Stopping), millis(1_000));
    unplug(&bus, &bus.drives[0]);
    slips(&bus.drives[1]);
    let unconfirmed = id(1).into();
    firmware.run_until(Report::Stopped { unconfirmed }, millis(1_000));
    firmware.run_for(millis(1_000));
    assert_eq!(firmware.troubles(), []);
    assert!(is_off(&bus.drives[1]));
}
