//! One drive is not as it should be.

use std::thread;
use std::time::Duration;

use myactuator_protocol_core::command::{ErrorFlags, VersionDate};

use myactuator_tests::emulator::firmware::Firmware;
use myactuator_tests::emulator::truth::Look;

use super::running::{BACK, PATIENCE, Program, WATCHED, go, moving, on, stopped, stops_for};

on! {
    two programs:
    one_that_is_amiss_stops_all
}

/// A motor that is silent is given up after 100 ms; then all are stopped.
const SILENCE_STOPS: Duration = Duration::from_millis(250);
/// A motor that hears nothing stops by itself after 500 ms, which the application has told it.
const PROTECTION_STOPS: Duration = Duration::from_millis(700);
/// The application looks at each motor's errors every 120 ms.
const ERROR_STOPS: Duration = Duration::from_millis(300);

/// One thing behind the other: behind each they move again.
fn one_that_is_amiss_stops_all(program: Program) {
    let mut firmware = moving(program);
    one_that_is_unplugged_stops_all(&mut firmware);
    one_that_restarts_stops_all(&mut firmware);
    one_with_an_error_stops_all_until_that_is_gone(&mut firmware);
    drop(firmware);
    one_with_another_firmware_keeps_all_from_moving(program);
}

fn one_that_is_unplugged_stops_all(firmware: &mut Firmware) {
    let unplugged = firmware.drives().now();
    let motor_3 = firmware.drive(3).clone();
    firmware.drives().cut(std::slice::from_ref(&motor_3));
    stops_for(firmware, "Silent { motor: motor 3 }");
    firmware.wait_for("Stopped { unconfirmed: [3] }", PATIENCE);
    firmware.wait_for("State(Stopped)", PATIENCE);
    thread::sleep(PROTECTION_STOPS);
    assert!(!Look::at(&motor_3).is_output_on, "it goes on without a master");
    firmware.drives().mend(std::slice::from_ref(&motor_3));
    firmware.check_stays_stopped(BACK + WATCHED);
    let mut moved_for = firmware.truth.moved_for(unplugged);
    let alone = moved_for.remove(2);
    let silence_stops = firmware.with_stalls(SILENCE_STOPS);
    if alone > firmware.with_stalls(PROTECTION_STOPS)
        || moved_for.iter().any(|&moved_for| moved_for > silence_stops)
    {
        firmware.fail(&format!("the unplugged one moved for {alone:?}, the others {moved_for:?}"));
    }
    go(firmware);
}

fn one_that_restarts_stops_all(firmware: &mut Firmware) {
    let restarted = firmware.drives().now();
    firmware.drives().restart(firmware.drive(2));
    let told = stops_for(firmware, "");
    // It may be missed before it is asked how long it has run.
    let is_known = told.text.contains("Restarted") || told.text.contains("Silent");
    assert!(is_known && told.number("motor") == Some(2.0), "{told}");
    firmware.wait_for("State(Stopped)", PATIENCE);
    firmware.check_stays_stopped(BACK + WATCHED);
    firmware.check_still(restarted, SILENCE_STOPS);
    go(firmware);
}

fn one_with_an_error_stops_all_until_that_is_gone(firmware: &mut Firmware) {
    let struck = firmware.drives().now();
    let flags = ErrorFlags::MOTOR_OVER_TEMPERATURE;
    firmware.drive(4).with(|drive| drive.raise_fault(flags));
    stops_for(firmware, "Errors { motor: motor 4,");
    firmware.wait_for("State(Stopped)", PATIENCE);
    firmware.check_stays_stopped(WATCHED);
    firmware.check_still(struck, ERROR_STOPS);

    firmware.press();
    stops_for(firmware, "Errors { motor: motor 4,");
    firmware.wait_for("State(Stopped)", PATIENCE);
    firmware.check_stays_stopped(WATCHED);
    firmware.check_still(struck, ERROR_STOPS);

    firmware.drive(4).with(|drive| drive.clear_fault(flags));
    go(firmware);
}

fn one_with_another_firmware_keeps_all_from_moving(program: Program) {
    let mut firmware = stopped(program);
    let replaced = firmware.drives().now();
    let other = VersionDate::from_raw(20_231_201);
    if let Err(error) = firmware.drives().replace(firmware.drive(2), other) {
        firmware.fail(&error.to_string());
    }
    firmware.press();
    let told = stops_for(&mut firmware, "OtherFirmware { motor: motor 2,");
    assert!(told.text.contains("20231201"), "{told}");
    firmware.wait_for("State(Stopped)", PATIENCE);
    firmware.check_stays_stopped(WATCHED);
    firmware.check_still(replaced, Duration::ZERO);
}
