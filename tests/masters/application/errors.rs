//! Motors with errors that come and go.

use myactuator_mcu_example::{Report, StateName, Trouble};
use myactuator_protocol_core::command::ErrorFlags;
use myactuator_tests::on_both_buses;
use myactuator_tests::values::millis;

use super::Moved;
use super::brakes::{before_shutdown, is_off, lets_go, loaded, slips, stays_held};

on_both_buses! {
    a_motor_that_turned_with_an_error_is_held_when_that_is_over
    a_press_after_a_motor_had_an_error_starts_nothing
}

const FLAGS: ErrorFlags = ErrorFlags::UNDER_VOLTAGE;

/// Its brake slips, and it could not be told to hold: behind a locked brake a stop has no effect. The error comes
/// before, or once it is held again, which locks its brake.
fn a_motor_that_turned_with_an_error_is_held_when_that_is_over<B: Moved>() {
    for is_held_before in [false, true] {
        let bus = loaded::<B>(3, true);
        let (mut firmware, _) = before_shutdown(&bus);
        let drive = &bus.drives[1];
        lets_go(&mut firmware, drive, true, 0);
        firmware.run_for(millis(1_000));
        slips(drive);
        if is_held_before {
            firmware.run_for(millis(1_000));
            assert!(!is_off(drive));
        }
        drive.with(|drive| drive.raise_fault(FLAGS));
        firmware.run_for(millis(300));
        let motor = drive.motor();
        let turns = Trouble::Turns { motor };
        assert!(firmware.troubles().contains(&turns), "{:?}", firmware.panel.reports);
        firmware.forget();
        drive.with(|drive| drive.clear_fault(FLAGS));
        firmware.run_for(millis(1_000));
        assert_eq!(firmware.troubles(), [turns], "held before: {is_held_before}");
        assert!(!is_off(drive), "held before: {is_held_before}");
        stays_held(&mut firmware, &bus);
    }
}

/// A load without a brake falls until the error is over. A person who sees that presses to stop it.
fn a_press_after_a_motor_had_an_error_starts_nothing<B: Moved>() {
    for (after_ms, pressed_ms) in [(0, 30), (0, 50), (20, 50), (300, 50), (900, 50), (300, 1_200)] {
        let bus = loaded::<B>(3, false);
        let (mut firmware, _) = before_shutdown(&bus);
        let last = &bus.drives[2];
        last.with(|drive| drive.raise_fault(FLAGS));
        firmware.run_for(millis(100));
        last.with(|drive| drive.clear_fault(FLAGS));
        firmware.run_for(millis(after_ms));
        firmware.press(millis(pressed_ms));
        firmware.stays_stopped();
        let told = &firmware.panel.reports;
        let is_acted_on = [StateName::Finding, StateName::ShuttingDown]
            .into_iter()
            .any(|state| told.contains(&Report::State(state)));
        assert!(!is_acted_on && !is_off(last), "{after_ms} {pressed_ms} ms: {told:?}");
        firmware.press(millis(50));
        firmware.run_until(Report::State(StateName::Running), millis(3_000));
    }
}
