//! Brakes that open and lock: a shaft is always held by its motor or by its brake.

use myactuator_host_std::sim::bus::trace;
use myactuator_host_std::sim::plant::{Arm, Load};
use myactuator_host_std::sim::{BusFleet, DriveHandle, Fleet};
use myactuator_mcu_example::{Moment, Report, StateName, Trouble};
use myactuator_protocol_core::command::{AnyReply, BrakeCommand, ErrorFlags, Status1};
use myactuator_protocol_core::drive::Quirks;
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::master::{Event, MotorSet};
use myactuator_protocol_core::units::{Temperature, Voltage};
use myactuator_protocol_core::wire::rs485::Receiver;
use myactuator_tests::fleet::state;
use myactuator_tests::on_both_buses;
use myactuator_tests::values::{id, millis};

use super::shutdown::break_off;
use super::{Firmware, Moved, Panel, angle_deg, unplug};

on_both_buses! {
    after_a_shutdown_no_brake_opens_before_its_motor_holds
    after_a_motor_restarted_its_brake_does_not_open_before_it_holds
    no_load_falls_where_an_error_comes_while_brakes_open
    no_brake_is_opened_if_its_motor_has_an_error
    an_error_is_reported_and_locks_the_brake_also_while_all_are_stopped
    no_load_falls_in_a_shutdown
    a_motor_that_misses_the_command_to_lock_its_brake_goes_on_holding
    what_would_fall_in_a_shutdown_is_held_again
    no_brake_of_a_motor_with_an_error_opens_in_a_shutdown
    no_load_falls_where_getting_ready_is_broken_off
    a_motor_that_lets_go_while_all_are_stopped_is_made_to_hold_again
    a_brake_that_slips_behind_a_motor_that_let_go_is_not_left_to_hold
    a_press_right_after_a_motor_is_told_to_hold_again_starts_nothing
}

/// Longer than two commands to a motor take, and shorter than any brake takes to open (50 ms and more).
const MOMENT_MS: u32 = 10;

/// Presses the button and checks every moment until the motors run. A shaft with an open brake and no output falls.
fn is_always_held<B: Moved>(firmware: &mut Firmware<'_, B>, bus: &BusFleet<B>) {
    firmware.press(millis(50));
    firmware.forget();
    let running = Report::State(StateName::Running);
    let end = firmware.runner.now() + millis(3_000);
    let mut unheld_ms = vec![0; bus.drives.len()];
    while !firmware.panel.reports.contains(&running) {
        assert!(firmware.runner.now() < end, "{:?}", firmware.panel.reports);
        firmware.run_for(millis(1));
        for (drive, unheld_ms) in bus.drives.iter().zip(&mut unheld_ms) {
            let state = state(drive);
            let is_held = state.output_on || state.brake == BrakeCommand::LOCK;
            *unheld_ms = if is_held { 0 } else { *unheld_ms + 1 };
            assert!(*unheld_ms < MOMENT_MS, "nothing holds the shaft: {state:?}");
        }
    }
}

fn after_a_shutdown_no_brake_opens_before_its_motor_holds<B: Moved>() {
    let bus = B::drives(&Fleet::new(4).brakes(true)).unwrap();
    let mut firmware = Firmware::running(&bus);
    firmware.press(millis(50));
    firmware.run_for(millis(1_000));
    firmware.press(millis(1_100));
    firmware.run_for(millis(1_000));
    assert!(bus.drives.iter().all(|drive| !state(drive).output_on));
    is_always_held(&mut firmware, &bus);
}

fn after_a_motor_restarted_its_brake_does_not_open_before_it_holds<B: Moved>() {
    let bus = B::drives(&Fleet::new(2).brakes(true)).unwrap();
    let mut firmware = Firmware::start(&bus, Panel::default());
    firmware.run_for(millis(1_500));
    let now = firmware.runner.now();
    bus.drives[1].with(|drive| {
        drive.power_off(now);
        drive.power_on(now);
    });
    // Sooner a press starts nothing.
    firmware.run_for(millis(1_200));
    is_always_held(&mut firmware, &bus);
}

/// Motors with a heavy arm that is stretched out. If they have brakes, these are slow.
pub(super) fn loaded<B: Moved>(motors: u8, brakes: bool) -> BusFleet<B> {
    let quirks = Quirks { slow_brake: true, ..Quirks::default() };
    let arm = Arm { mass_kg: 2.0, length_m: 0.4, down_deg: -90.0 };
    let load = Load { arm: Some(arm), ..Load::NONE };
    B::drives(&Fleet::new(motors).brakes(brakes).quirks(quirks).load(load)).unwrap()
}

/// A drive with an error obeys 0x77 but does not hold its shaft.
fn no_load_falls_where_an_error_comes_while_brakes_open<B: Moved>() {
    let falls = |motors: u8, after_ms: u64| {
        let bus = loaded::<B>(motors, true);
        let mut firmware = Firmware::start(&bus, Panel::default());
        firmware.run_until_preparing();
        firmware.run_for(millis(after_ms));
        let last = &bus.drives[usize::from(motors) - 1];
        last.with(|drive| drive.raise_fault(ErrorFlags::STALL));
        let before_deg = angle_deg(last);
        let mut released_ms = 0;
        for _ in 0..300 {
            firmware.run_for(millis(1));
            released_ms += u32::from(state(last).brake == BrakeCommand::RELEASE);
        }
        let trouble = Trouble::Errors { motor: id(motors), flags: ErrorFlags::STALL };
        assert_eq!(firmware.troubles(), [trouble], "after {after_ms} ms");
        // Or the load would fall, with the fastest brake.
        released_ms >= 50 || (angle_deg(last) - before_deg).abs() > 3.0
    };
    // Errors before any brake has opened. Later a load falls until the brake has locked again, whatever locks it.
    for (motors, until) in [(1, 50), (8, 110)] {
        let fallen: Vec<u64> = (0..until).filter(|&ms| falls(motors, ms)).collect();
        assert!(fallen.is_empty(), "{motors} motors, error after {fallen:?} ms");
    }
}

/// The error comes after the firmware has read the motor's errors.
fn no_brake_is_opened_if_its_motor_has_an_error<B: Moved>() {
    let bus = loaded::<B>(4, true);
    let mut firmware = Firmware::start(&bus, Panel::default());
    firmware.run_until_preparing();
    bus.drives[3].with(|drive| drive.raise_fault(ErrorFlags::STALL));
    stays_locked(&mut firmware, &bus.drives[3]);
}

fn stays_locked<B: Moved>(firmware: &mut Firmware<'_, B>, drive: &DriveHandle) {
    for _ in 0..1_000 {
        firmware.run_for(millis(1));
        assert_eq!(state(drive).brake, BrakeCommand::LOCK);
    }
}

fn an_error_is_reported_and_locks_the_brake_also_while_all_are_stopped<B: Moved>() {
    let bus = loaded::<B>(2, true);
    let mut firmware = Firmware::running(&bus);
    firmware.press(millis(50));
    firmware.run_for(millis(500));
    let failed = Status1 {
        temperature: Temperature::from_raw(40),
        mosfet_temperature: Temperature::from_raw(40),
        brake: BrakeCommand::RELEASE,
        voltage: Voltage::from_raw(480),
        errors: ErrorFlags::STALL,
    };
    let Firmware { runner, app, panel, .. } = &mut firmware;
    let at = &mut Moment { now: runner.now(), master: runner.master(), board: panel };
    let report = Event::Report { motor: id(2), reply: AnyReply::ReadStatus1(failed) };
    app.handle_event(&report, at);
    firmware.run_for(millis(100));
    let brakes = bus.drives.iter().map(|drive| state(drive).brake);
    assert_eq!(brakes.collect::<Vec<_>>(), [BrakeCommand::RELEASE, BrakeCommand::LOCK]);
    let trouble = |motor| Trouble::Errors { motor: id(motor), flags: ErrorFlags::STALL };
    assert_eq!(firmware.troubles(), [Trouble::Button, trouble(2)]);
    // Motors without error reports are asked. Each error is reported once, until the button is pressed.
    bus.drives[0].with(|drive| drive.raise_fault(ErrorFlags::STALL));
    firmware.run_for(millis(1_500));
    assert_eq!(firmware.troubles(), [Trouble::Button, trouble(2), trouble(1)]);
    firmware.press(millis(50));
    firmware.run_for(millis(500));
    assert_eq!(firmware.troubles(), [Trouble::Button, trouble(2), trouble(1), trouble(1)]);
}

/// A firmware whose motors have run and hold, ready for a shutdown, and the angles of the shafts.
pub(super) fn before_shutdown<B: Moved>(bus: &BusFleet<B>) -> (Firmware<'_, B>, Vec<f64>) {
    let mut firmware = Firmware::running(bus);
    firmware.run_for(millis(500));
    firmware.press(millis(50));
    firmware.run_for(millis(1_500));
    firmware.forget();
    (firmware, bus.drives.iter().map(angle_deg).collect())
}

/// Its brake holds nothing from now on, whatever it is told.
pub(super) fn slips(drive: &DriveHandle) {
    drive.with(|drive| drive.plant_mut().force_brake(Some(true)));
}

pub(super) fn is_off(drive: &DriveHandle) -> bool {
    !state(drive).output_on
}

/// How far each shaft has fallen.
pub(super) fn fallen_deg<B: Moved>(bus: &BusFleet<B>, before_deg: &[f64]) -> Vec<f64> {
    bus.drives.iter().zip(before_deg).map(|(drive, before)| before - angle_deg(drive)).collect()
}

/// Asserts that from now on no shaft turns and nothing more is reported.
#[track_caller]
pub(super) fn stays_held<B: Moved>(firmware: &mut Firmware<'_, B>, bus: &BusFleet<B>) {
    let held_deg: Vec<_> = bus.drives.iter().map(angle_deg).collect();
    firmware.stays_stopped();
    has_none_fallen(bus, &held_deg, 0.5);
}

#[track_caller]
pub(super) fn has_none_fallen<B: Moved>(bus: &BusFleet<B>, before_deg: &[f64], most_deg: f64) {
    let fallen = fallen_deg(bus, before_deg);
    assert!(fallen.iter().all(|fallen| fallen.abs() < most_deg), "fallen by {fallen:?} degrees");
}

fn no_load_falls_in_a_shutdown<B: Moved>() {
    let bus = loaded::<B>(4, true);
    let (mut firmware, before_deg) = before_shutdown(&bus);
    firmware.press(millis(1_100));
    firmware.run_for(millis(1_000));
    assert!(bus.drives.iter().all(is_off));
    assert_eq!(firmware.troubles(), []);
    has_none_fallen(&bus, &before_deg, 0.5);
}

/// The motor is back before the outputs would be switched off.
fn a_motor_that_misses_the_command_to_lock_its_brake_goes_on_holding<B: Moved>() {
    let bus = loaded::<B>(2, true);
    let (mut firmware, before_deg) = before_shutdown(&bus);
    firmware.panel.is_button_down = true;
    firmware.run_until(Report::State(StateName::ShuttingDown), millis(1_100));
    firmware.panel.is_button_down = false;
    unplug(&bus, &bus.drives[1]);
    firmware.run_until(Report::Trouble(Trouble::Silent { motor: id(2) }), millis(150));
    bus.world.mend(bus.drives[1].station());
    firmware.run_for(millis(1_000));
    assert!(!is_off(&bus.drives[1]));
    has_none_fallen(&bus, &before_deg, 0.5);
}

/// Two brakes of three slip, or no motor has one.
fn what_would_fall_in_a_shutdown_is_held_again<B: Moved>() {
    // A shaft with a brake is checked only after the brake has had time to lock. A motor without a brake is switched
    // off first.
    for (brakes, falling, most_deg, off) in [(true, 1..3, 25.0, 1), (false, 0..3, 8.0, 3)] {
        let bus = loaded::<B>(3, brakes);
        let (mut firmware, before_deg) = before_shutdown(&bus);
        let log = bus.world.log();
        for drive in &bus.drives[falling.clone()] {
            slips(drive);
        }
        firmware.press(millis(1_100));
        firmware.run_for(millis(1_000));
        let told = falling.clone().map(|index| Trouble::Turns { motor: bus.drives[index].motor() });
        assert_eq!(firmware.troubles(), told.collect::<Vec<_>>(), "brakes: {brakes}");
        let end =
            [Report::Stopped { unconfirmed: MotorSet::EMPTY }, Report::State(StateName::Stopped)];
        assert!(firmware.panel.reports.ends_with(&end), "{:?}", firmware.panel.reports);
        assert!(bus.drives[falling].iter().all(|drive| !is_off(drive)));
        has_none_fallen(&bus, &before_deg, most_deg);
        let is_told_off = |record: &trace::Record<B::Frame>| match &record.event {
            trace::Event::Carried { frame, .. } => {
                B::packet(&mut Receiver::new(), frame, true).is_some_and(|it| it.data[0] == 0x80)
            }
            _ => false,
        };
        // Commands and their answers. No turning motor with a brake is switched off.
        assert_eq!(log.take().iter().filter(|record| is_told_off(record)).count(), 2 * off);
        stays_held(&mut firmware, &bus);
    }
}

/// The motor would not hold its shaft with an open brake, so the brake stays locked even if it slips.
fn no_brake_of_a_motor_with_an_error_opens_in_a_shutdown<B: Moved>() {
    let bus = loaded::<B>(2, true);
    let (mut firmware, before_deg) = before_shutdown(&bus);
    for drive in &bus.drives {
        slips(drive);
    }
    firmware.panel.is_button_down = true;
    firmware.run_until(Report::State(StateName::ShuttingDown), millis(1_100));
    firmware.panel.is_button_down = false;
    bus.drives[0].with(|drive| drive.raise_fault(ErrorFlags::STALL));
    stays_locked(&mut firmware, &bus.drives[0]);
    let told = firmware.troubles();
    assert!(told.contains(&Trouble::Turns { motor: id(1) }), "{told:?}");
    // The other motor is held again.
    assert!(!is_off(&bus.drives[1]));
    assert!(fallen_deg(&bus, &before_deg)[1].abs() < 25.0);
}

/// It hears nothing for so long that it cuts its output on its own, or it restarts.
pub(super) fn lets_go<B: Moved>(
    firmware: &mut Firmware<'_, B>,
    drive: &DriveHandle,
    is_restart: bool,
    gone_ms: u64,
) {
    let now = firmware.runner.now();
    if is_restart {
        drive.with(|drive| drive.power_off(now));
    } else {
        unplug(firmware.bus, drive);
    }
    firmware.run_for(millis(gone_ms));
    let now = firmware.runner.now();
    if is_restart {
        drive.with(|drive| drive.power_on(now));
    } else {
        firmware.bus.world.mend(drive.station());
    }
}

/// It has no brake.
fn a_motor_that_lets_go_while_all_are_stopped_is_made_to_hold_again<B: Moved>() {
    for is_restart in [false, true] {
        for gone_ms in [100, 550, 800, 3_000] {
            let bus = loaded::<B>(3, false);
            let (mut firmware, _) = before_shutdown(&bus);
            let drive = &bus.drives[1];
            lets_go(&mut firmware, drive, is_restart, gone_ms);
            firmware.run_for(millis(2_000));
            assert!(!is_off(drive), "restart: {is_restart}, gone for {gone_ms} ms");
            firmware.stays_stopped();
            assert_eq!(firmware.troubles(), []);
        }
    }
}

/// Its brake has locked, and a stop does nothing behind it. It slips at once or later.
fn a_brake_that_slips_behind_a_motor_that_let_go_is_not_left_to_hold<B: Moved>() {
    for is_restart in [false, true] {
        for slips_after_ms in [0, 70, 1_000, 10_000] {
            let bus = loaded::<B>(3, true);
            let (mut firmware, mut before_deg) = before_shutdown(&bus);
            let drive = &bus.drives[1];
            // A brake that works holds the load until it slips, once it has locked.
            lets_go(&mut firmware, drive, is_restart, 800);
            firmware.run_for(millis(slips_after_ms));
            assert_eq!(firmware.troubles(), []);
            if slips_after_ms >= 1_000 {
                before_deg[1] = angle_deg(drive);
            }
            slips(drive);
            firmware.run_for(millis(1_000));
            let (told, fallen) = (firmware.troubles(), fallen_deg(&bus, &before_deg));
            let case = format!("{is_restart} {slips_after_ms} ms: {fallen:?}, {told:?}");
            assert_eq!(told, [Trouble::Turns { motor: id(2) }], "{case}");
            assert!(!is_off(drive), "{case}");
            // It answers again, and is seen to turn, within two rounds of 90 ms: it falls by 31 degrees, and by 36
            // without friction in 225 ms. Once it is watched, it is asked every 12 ms, and told to hold within 100 ms:
            // 7 degrees. On RS485 an id without a motor may occupy the line for 80 ms: 23 degrees in 180 ms.
            let most_deg = match B::NAME {
                _ if slips_after_ms < 1_000 => 36.0,
                "CAN" => 8.0,
                _ => 23.0,
            };
            assert!(
                fallen[1] < most_deg && fallen[0].abs() < 0.5 && fallen[2].abs() < 0.5,
                "{case}"
            );
            stays_held(&mut firmware, &bus);
        }
    }
}

/// A person who saw it fall presses to stop it. With and without a brake, and however long.
fn a_press_right_after_a_motor_is_told_to_hold_again_starts_nothing<B: Moved>() {
    for (brakes, pressed_ms) in [(false, 50), (true, 50), (false, 1_200), (true, 1_200)] {
        let bus = loaded::<B>(3, brakes);
        let (mut firmware, _) = before_shutdown(&bus);
        lets_go(&mut firmware, &bus.drives[1], true, 0);
        firmware.run_for(millis(200));
        firmware.press(millis(pressed_ms));
        firmware.stays_stopped();
        assert_eq!(firmware.panel.reports, [], "brakes: {brakes}, {pressed_ms} ms");
        firmware.press(millis(50));
        firmware.run_until(Report::State(StateName::Running), millis(3_000));
    }
}

/// While brakes are told to open, while they open, and once they have.
fn no_load_falls_where_getting_ready_is_broken_off<B: Moved>() {
    for after_ms in (0..260).step_by(13) {
        for is_pressed in [false, true] {
            let bus = loaded::<B>(4, true);
            let mut firmware = Firmware::start(&bus, Panel::default());
            firmware.run_until_preparing();
            let before_deg: Vec<_> = bus.drives.iter().map(angle_deg).collect();
            firmware.run_for(millis(after_ms));
            match is_pressed {
                true => firmware.press(millis(30)),
                false => break_off(&mut firmware),
            }
            firmware.stays_stopped();
            has_none_fallen(&bus, &before_deg, 3.0);
        }
    }
}
