//! Motors that let go, or do not answer everything, while all are stopped.

use myactuator_host_std::sim::Fleet;
use myactuator_mcu_example::{Report, StateName, Trouble, cycle};
use myactuator_protocol_core::Data;
use myactuator_protocol_core::command::ErrorFlags;
use myactuator_protocol_core::io::{CanMaster, Runner};
use myactuator_protocol_core::master::{Config, Event, Failure, MotorSet};
use myactuator_tests::fleet::lost_their_master;
use myactuator_tests::on_both_buses;
use myactuator_tests::tapped::Tapped;
use myactuator_tests::values::{id, millis};

use super::brakes::{before_shutdown, fallen_deg, is_off, lets_go, loaded, slips, stays_held};
use super::shutdown::{break_off, shut_down};
use super::{Firmware, Moved, Panel, angle_deg, told_by};

on_both_buses! {
    a_motor_that_never_says_whether_its_shaft_stands_leaves_the_button_alive
    a_motor_that_never_answers_one_question_leaves_the_button_alive
    a_motor_that_turns_and_cannot_be_told_to_hold_leaves_the_button_alive
    a_motor_that_missed_both_checks_is_watched
    a_motor_that_turns_with_an_error_is_told_to_hold_once
    a_press_while_a_motor_lets_go_starts_nothing
    brakes_that_slip_at_the_same_time_are_all_seen
    a_brake_that_was_told_to_lock_is_watched_whatever_it_says
    a_motor_that_lets_go_again_and_again_leaves_the_button_alive
    a_press_after_a_second_motor_has_let_go_starts_nothing
    a_motor_whose_error_is_over_is_told_to_hold_again
    a_press_in_the_same_moment_leaves_a_motor_holding
    a_motor_that_has_let_go_is_not_asked_whether_its_shaft_stands
}

/// Runs with a motor 3 that answers otherwise.
pub(super) fn run_altered<B: Moved>(
    firmware: &mut Firmware<'_, B>,
    ms: u64,
    altered: impl Fn(Data) -> Option<Data>,
) {
    let alter = |event| match event {
        Event::Reply { ticket, kind, data } if ticket.motor() == id(3) => match altered(data) {
            Some(data) => Event::Reply { ticket, kind, data },
            None => Event::Failed { ticket, failure: Failure::NoReply },
        },
        event => event,
    };
    let Firmware { runner, app, panel, .. } = firmware;
    let end = runner.now() + millis(ms);
    while runner.now() < end {
        cycle(app, &mut Tapped(runner, |event: Option<Event>| event.map(alter)), panel);
    }
}

/// Runs with a motor 3 that answers whatever it is asked, except for this. Returns what has been reported so far.
fn run_mute<B: Moved>(
    firmware: &mut Firmware<'_, B>,
    mute: u8,
    is_button_down: bool,
    ms: u64,
) -> Vec<Report> {
    firmware.panel.is_button_down = is_button_down;
    run_altered(firmware, ms, |data| (data[0] != mute).then_some(data));
    firmware.panel.reports.clone()
}

fn count(told: &[Report], wanted: Report) -> usize {
    told.iter().filter(|&&report| report == wanted).count()
}

fn a_motor_that_never_says_whether_its_shaft_stands_leaves_the_button_alive<B: Moved>() {
    let bus = loaded::<B>(3, true);
    let (mut firmware, _) = before_shutdown(&bus);
    // In each shutdown.
    for _ in 0..2 {
        firmware.forget();
        shut_down(&mut firmware);
        firmware.run_for(millis(25));
        break_off(&mut firmware);
        let told = run_mute(&mut firmware, 0x9C, false, 1_500);
        let stopped = Report::Stopped { unconfirmed: MotorSet::EMPTY };
        assert!(told.ends_with(&[stopped, Report::State(StateName::Stopped)]), "{told:?}");
        let silent = Report::Trouble(Trouble::Silent { motor: id(3) });
        assert_eq!(count(&told, Report::State(StateName::Looking)), 2, "{told:?}");
        assert_eq!(count(&told, silent), 1, "{told:?}");
        assert_eq!(run_mute(&mut firmware, 0x9C, false, 3_000), told);
    }
    run_mute(&mut firmware, 0x9C, true, 50);
    let told = run_mute(&mut firmware, 0x9C, false, 2_000);
    assert!(told.contains(&Report::State(StateName::Running)), "{told:?}");
}

/// It answers all others, so it has not let go. A press says what is wrong.
fn a_motor_that_never_answers_one_question_leaves_the_button_alive<B: Moved>() {
    for mute in [0x9A, 0xB1, 0x92] {
        let bus = loaded::<B>(3, true);
        let (mut firmware, _) = before_shutdown(&bus);
        run_mute(&mut firmware, mute, false, 2_000);
        run_mute(&mut firmware, mute, true, 50);
        let told = run_mute(&mut firmware, mute, false, 2_500);
        let silent = Report::Trouble(Trouble::Silent { motor: id(3) });
        assert!(told.contains(&silent), "{mute:#x}: {told:?}");
        run_mute(&mut firmware, mute, true, 1_100);
        let told = run_mute(&mut firmware, mute, false, 500);
        assert!(told.contains(&Report::State(StateName::ShuttingDown)), "{mute:#x}: {told:?}");
    }
}

/// Its brake slips, and the command to open it, or the one to hold, is never answered. A stop holds nothing then.
fn a_motor_that_turns_and_cannot_be_told_to_hold_leaves_the_button_alive<B: Moved>() {
    for mute in [0x77, 0x81] {
        let bus = loaded::<B>(3, true);
        let (mut firmware, _) = before_shutdown(&bus);
        slips(&bus.drives[2]);
        shut_down(&mut firmware);
        firmware.run_for(millis(25));
        break_off(&mut firmware);
        let told = run_mute(&mut firmware, mute, false, 3_000);
        let [silent, turns] = [Trouble::Silent { motor: id(3) }, Trouble::Turns { motor: id(3) }];
        assert_eq!(count(&told, Report::Trouble(turns)), 2, "{mute:#x}: {told:?}");
        assert_eq!(count(&told, Report::Trouble(silent)), 1, "{mute:#x}: {told:?}");
        assert!(told.ends_with(&[Report::State(StateName::Stopped)]), "{mute:#x}: {told:?}");
    }
}

/// Its answers were only lost. Its brake has locked, and slips later.
fn a_motor_that_missed_both_checks_is_watched<B: Moved>() {
    let bus = loaded::<B>(3, true);
    let (mut firmware, before_deg) = before_shutdown(&bus);
    shut_down(&mut firmware);
    firmware.run_for(millis(25));
    break_off(&mut firmware);
    run_mute(&mut firmware, 0x9C, false, 1_500);
    firmware.forget();
    slips(&bus.drives[2]);
    firmware.run_for(millis(1_000));
    assert_eq!(firmware.troubles(), [Trouble::Turns { motor: id(3) }]);
    assert!(!is_off(&bus.drives[2]));
    // As behind any brake that slips behind a motor that is watched.
    assert!(fallen_deg(&bus, &before_deg)[2] < 36.0);
    stays_held(&mut firmware, &bus);
}

/// It cannot hold, and its brake slips. While it is told to hold, the button does nothing.
fn a_motor_that_turns_with_an_error_is_told_to_hold_once<B: Moved>() {
    let bus = loaded::<B>(3, true);
    let (mut firmware, _) = before_shutdown(&bus);
    lets_go(&mut firmware, &bus.drives[1], true, 0);
    firmware.run_for(millis(1_000));
    bus.drives[1].with(|drive| {
        drive.raise_fault(ErrorFlags::STALL);
        drive.plant_mut().force_brake(Some(true));
    });
    firmware.run_for(millis(2_000));
    let told = &firmware.panel.reports;
    assert_eq!(count(told, Report::Trouble(Trouble::Turns { motor: id(2) })), 1, "{told:?}");
    assert_eq!(count(told, Report::State(StateName::Looking)), 1, "{told:?}");
}

/// A person who sees it fall presses to stop it, whatever the firmware knows by then.
fn a_press_while_a_motor_lets_go_starts_nothing<B: Moved>() {
    for (is_restart, gone_ms) in [(true, 0), (true, 100), (true, 600), (false, 600)] {
        for pressed_ms in [0, 30, 60, 90, 120] {
            let bus = loaded::<B>(8, false);
            let (mut firmware, _) = before_shutdown(&bus);
            lets_go(&mut firmware, &bus.drives[7], is_restart, gone_ms);
            firmware.run_for(millis(pressed_ms));
            firmware.press(millis(50));
            firmware.run_for(millis(1_500));
            let told = &firmware.panel.reports;
            let is_started = told.contains(&Report::State(StateName::Preparing));
            assert!(!is_started, "{is_restart} {gone_ms} {pressed_ms} ms: {told:?}");
            firmware.press(millis(50));
            firmware.run_until(Report::State(StateName::Running), millis(3_000));
        }
    }
}

/// Whatever makes one brake slip may make others slip.
fn brakes_that_slip_at_the_same_time_are_all_seen<B: Moved>() {
    for slips_after_ms in [1_000, 1_080, 1_160] {
        let bus = loaded::<B>(8, true);
        let (mut firmware, _) = before_shutdown(&bus);
        let slipping = &bus.drives[1..4];
        slipping.iter().for_each(|drive| lets_go(&mut firmware, drive, true, 0));
        firmware.run_for(millis(slips_after_ms));
        let before_deg: Vec<_> = bus.drives.iter().map(angle_deg).collect();
        for drive in slipping {
            slips(drive);
        }
        firmware.run_for(millis(1_000));
        let fallen = fallen_deg(&bus, &before_deg);
        let case = format!("{slips_after_ms} ms: {fallen:?}");
        assert!(!slipping.iter().any(is_off), "{case}");
        assert_eq!(told_by(&firmware, |it| matches!(it, Report::Trouble(_))), 3, "{case}");
        let looking = Report::State(StateName::Looking);
        assert_eq!(count(&firmware.panel.reports, looking), 1, "{case}");
        // Each of the three is asked every 36 ms. After that all are checked, and told to hold within 12 more commands:
        // 15 degrees without friction in 145 ms.
        assert!(fallen.iter().all(|&fallen| fallen < 15.0), "{case}");
        stays_held(&mut firmware, &bus);
    }
}

/// Some firmware does not report what the brake does.
fn a_brake_that_was_told_to_lock_is_watched_whatever_it_says<B: Moved>() {
    let bus = loaded::<B>(3, true);
    let (mut firmware, before_deg) = before_shutdown(&bus);
    let says_released = |mut data: Data| {
        if data[0] == 0x9A {
            data[3] = 1;
        }
        Some(data)
    };
    shut_down(&mut firmware);
    run_altered(&mut firmware, 25, says_released);
    break_off(&mut firmware);
    run_altered(&mut firmware, 1_500, says_released);
    firmware.forget();
    slips(&bus.drives[2]);
    run_altered(&mut firmware, 1_000, says_released);
    assert_eq!(firmware.troubles(), [Trouble::Turns { motor: id(3) }]);
    assert!(!is_off(&bus.drives[2]));
    assert!(fallen_deg(&bus, &before_deg)[2] < 15.0, "{:?}", fallen_deg(&bus, &before_deg));
    stays_held(&mut firmware, &bus);
}

/// It restarts every 700 ms. A press says so, and a long one shuts down.
fn a_motor_that_lets_go_again_and_again_leaves_the_button_alive<B: Moved>() {
    for (pressed, state) in [(30..31, StateName::Finding), (30..43, StateName::ShuttingDown)] {
        let bus = loaded::<B>(3, true);
        let (mut firmware, _) = before_shutdown(&bus);
        for tenth in 0..50 {
            if tenth % 7 == 0 {
                lets_go(&mut firmware, &bus.drives[1], true, 0);
            }
            firmware.panel.is_button_down = pressed.contains(&tenth);
            firmware.run_for(millis(100));
        }
        let told = &firmware.panel.reports;
        assert!(told.contains(&Report::State(state)), "{pressed:?}: {told:?}");
    }
}

/// A person who sees the second one fall presses to stop it.
fn a_press_after_a_second_motor_has_let_go_starts_nothing<B: Moved>() {
    for (between_ms, pressed_ms) in [(1_500, 50), (2_500, 50), (1_500, 1_200)] {
        let bus = loaded::<B>(3, false);
        let (mut firmware, _) = before_shutdown(&bus);
        lets_go(&mut firmware, &bus.drives[0], true, 0);
        firmware.run_for(millis(between_ms));
        lets_go(&mut firmware, &bus.drives[1], true, 0);
        firmware.run_for(millis(300));
        assert!(!is_off(&bus.drives[1]));
        firmware.press(millis(pressed_ms));
        firmware.stays_stopped();
        assert_eq!(firmware.panel.reports, [], "{between_ms} {pressed_ms} ms");
    }
}

/// An under-voltage that lasts until it was read: it is every 90 ms. No brake holds the load meanwhile.
fn a_motor_whose_error_is_over_is_told_to_hold_again<B: Moved>() {
    for phase_ms in [0, 10, 20, 30, 40, 50, 60, 70, 80] {
        let bus = loaded::<B>(3, false);
        let (mut firmware, before_deg) = before_shutdown(&bus);
        firmware.run_for(millis(phase_ms));
        let (last, flags) = (&bus.drives[2], ErrorFlags::UNDER_VOLTAGE);
        last.with(|drive| drive.raise_fault(flags));
        firmware.run_for(millis(100));
        last.with(|drive| drive.clear_fault(flags));
        firmware.run_for(millis(1_000));
        let fallen = fallen_deg(&bus, &before_deg);
        let told = firmware.troubles();
        assert_eq!(told.first(), Some(&Trouble::Errors { motor: id(3), flags }), "{told:?}");
        // 28 degrees without friction in 200 ms.
        assert!(!is_off(last) && fallen[2] < 28.0, "{phase_ms} ms: {fallen:?}");
        stays_held(&mut firmware, &bus);
    }
}

/// The error is over. Before the motor is told to hold again, or just then, the button starts the motors.
fn a_press_in_the_same_moment_leaves_a_motor_holding<B: Moved>() {
    for phase_ms in 0..10 {
        let bus = loaded::<B>(1, false);
        let (mut firmware, before_deg) = before_shutdown(&bus);
        let (drive, flags) = (&bus.drives[0], ErrorFlags::UNDER_VOLTAGE);
        firmware.panel.is_button_down = true;
        firmware.run_for(millis(60));
        drive.with(|drive| drive.raise_fault(flags));
        firmware.run_for(millis(40));
        drive.with(|drive| drive.clear_fault(flags));
        firmware.run_for(millis(phase_ms));
        firmware.panel.is_button_down = false;
        firmware.run_for(millis(300));
        let fallen = fallen_deg(&bus, &before_deg);
        // As if there was no press. 9 degrees without friction in 110 ms.
        assert!(!is_off(drive) && fallen[0] < 9.0, "{phase_ms} ms: {fallen:?}");
    }
}

/// As many as the second number lose power while all hold. Each is asked three times before the next motor.
#[test]
fn motors_without_power_keep_others_from_hearing_only_with_the_time_outs_of_a_longer_bus() {
    let for_eight = |bit_rate| {
        let config = Config::can(bit_rate);
        Config { reply_timeout: millis(3) + config.frame_time.times(32), ..config }
    };
    let cases = [
        (1_000_000, 7, Config::can(1_000_000), false),
        (500_000, 5, Config::can(500_000), true),
        (500_000, 7, for_eight(500_000), false),
        (250_000, 7, for_eight(250_000), false),
    ];
    for (bit_rate, without_power, config, have_lost) in cases {
        let bus = Fleet::new(8).brakes(true).on_can(bit_rate).unwrap();
        let runner = CanMaster::new(bus.world.port(), bus.world.clock(), config);
        let mut firmware = Firmware::running_on(&bus, runner);
        firmware.press(millis(50));
        firmware.run_for(millis(1_500));
        let (others, cut) = bus.drives.split_at(8 - without_power);
        lost_their_master(others);
        let now = firmware.runner.now();
        cut.iter().for_each(|drive| drive.with(|drive| drive.power_off(now)));
        firmware.run_for(millis(3_000));
        let lost = lost_their_master(others);
        assert_eq!(!lost.is_empty(), have_lost, "{bit_rate} bit/s, {without_power}: {lost:?}");
    }
}

/// It holds nothing until it answers the rounds again. Whatever it says of its shaft meanwhile, a check would only keep
/// the button from working.
fn a_motor_that_has_let_go_is_not_asked_whether_its_shaft_stands<B: Moved>() {
    let bus = loaded::<B>(3, true);
    let mut firmware = Firmware::start(&bus, Panel::default());
    // Its brake is locked, and it has said so.
    firmware.run_for(millis(1_500));
    let rounds = [0x9A, 0xB1, 0x92];
    let mute = |data: Data| (!rounds.contains(&data[0])).then_some(data);
    run_altered(&mut firmware, 1_000, mute);
    firmware.forget();
    run_altered(&mut firmware, 1_000, |mut data| {
        if data[0] == 0x9C {
            // 5 dps.
            data[4] = 5;
        }
        mute(data)
    });
    assert_eq!(firmware.panel.reports, []);
}
