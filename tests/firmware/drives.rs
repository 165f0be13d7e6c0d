//! Faults of one drive.

use std::thread;
use std::time::Duration;

use myactuator_protocol_core::command::{ErrorFlags, VersionDate};

use myactuator_tests::emulator::firmware::Firmware;
use myactuator_tests::emulator::truth::Sample;

use super::running::{
    Program, QUERY_PERIOD, RECOVERY, TIMEOUT, WATCH, moving, start_moving, stopped, tests_on,
    wait_for_trouble,
};

tests_on! {
    two programs:
    one_faulty_drive_stops_all
}

/// The firmware gives a silent motor up after 100 ms, and then stops all.
const SILENCE_STOPS: Duration = Duration::from_millis(250);
/// A drive that restarts may answer again before it counts as silent. Then it is found by its run time.
const RESTART_STOPS: Duration = QUERY_PERIOD.saturating_add(Duration::from_millis(250));
/// A motor that receives nothing stops on its own after 500 ms, which the application has set.
const PROTECTION_STOPS: Duration = Duration::from_millis(700);
const ERROR_STOPS: Duration = QUERY_PERIOD.saturating_add(Duration::from_millis(180));

/// One fault after another; after each the motors move again.
fn one_faulty_drive_stops_all(program: Program) {
    let mut firmware = moving(program);
    one_unplugged_drive_stops_all(&mut firmware);
    one_restarting_drive_stops_all(&mut firmware);
    one_drive_with_an_error_stops_all_until_it_is_cleared(&mut firmware);
    drop(firmware);
    one_drive_with_another_firmware_keeps_all_from_moving(program);
}

fn one_unplugged_drive_stops_all(firmware: &mut Firmware) {
    let unplugged = firmware.drives().now();
    let motor_3 = firmware.drive(3).clone();
    firmware.drives().cut(std::slice::from_ref(&motor_3));
    wait_for_trouble(firmware, "Silent { motor: motor 3 }");
    firmware.wait_for("Stopped { unconfirmed: [3] }", TIMEOUT);
    firmware.wait_for("State(Stopped)", TIMEOUT);
    thread::sleep(PROTECTION_STOPS);
    if Sample::at(&motor_3).is_output_on {
        firmware.fail("motor 3 keeps its output on without a master");
    }
    firmware.drives().mend(std::slice::from_ref(&motor_3));
    firmware.check_stays_stopped(RECOVERY + WATCH);
    let mut moved_for = firmware.truth.moved_for(unplugged);
    let unplugged_for = moved_for.remove(2);
    let silence_stops = firmware.with_stalls(SILENCE_STOPS);
    if unplugged_for > firmware.with_stalls(PROTECTION_STOPS)
        || moved_for.iter().any(|&moved_for| moved_for > silence_stops)
    {
        firmware.fail(&format!(
            "expected motor 3 to stop within {PROTECTION_STOPS:?} and the others within \
             {SILENCE_STOPS:?}; motor 3 moved for {unplugged_for:?}, the others for {moved_for:?}"
        ));
    }
    start_moving(firmware);
}

fn one_restarting_drive_stops_all(firmware: &mut Firmware) {
    let restarted = firmware.drives().now();
    firmware.drives().restart(firmware.drive(2));
    let trouble = wait_for_trouble(firmware, "");
    // The firmware may find it silent before it queries its run time.
    let is_known = trouble.text.contains("Restarted") || trouble.text.contains("Silent");
    if !is_known || trouble.number("motor") != Some(2.0) {
        firmware.fail(&format!("expected motor 2 restarted or silent, found \"{trouble}\""));
    }
    firmware.wait_for("State(Stopped)", TIMEOUT);
    firmware.check_stays_stopped(RECOVERY + WATCH);
    firmware.check_still(restarted, RESTART_STOPS);
    start_moving(firmware);
}

fn one_drive_with_an_error_stops_all_until_it_is_cleared(firmware: &mut Firmware) {
    let raised = firmware.drives().now();
    let flags = ErrorFlags::MOTOR_OVER_TEMPERATURE;
    firmware.drive(4).with(|drive| drive.raise_fault(flags));
    wait_for_trouble(firmware, "Errors { motor: motor 4,");
    firmware.wait_for("State(Stopped)", TIMEOUT);
    firmware.check_stays_stopped(WATCH);
    firmware.check_still(raised, ERROR_STOPS);

    // The motors are stopped already, and a press starts nothing meanwhile.
    firmware.press();
    firmware.wait_for("Trouble(Errors { motor: motor 4,", TIMEOUT);
    firmware.check_stays_stopped(WATCH);
    firmware.check_still(raised, ERROR_STOPS);

    // From then on it is told to hold again, as after a silence.
    firmware.drive(4).with(|drive| drive.clear_fault(flags));
    firmware.check_stays_stopped(RECOVERY + WATCH);
    start_moving(firmware);
}

fn one_drive_with_another_firmware_keeps_all_from_moving(program: Program) {
    let mut firmware = stopped(program);
    let replaced = firmware.drives().now();
    let other = VersionDate::from_raw(20_231_201);
    if let Err(error) = firmware.drives().replace(firmware.drive(2), other) {
        firmware.fail(&error.to_string());
    }
    firmware.press();
    let mut trouble = wait_for_trouble(&mut firmware, "");
    // Its run time may be queried before its version is: then it is a drive that has restarted.
    if trouble.text.contains("Restarted { motor: motor 2 }") {
        firmware.wait_for("State(Stopped)", TIMEOUT);
        firmware.check_stays_stopped(RECOVERY + WATCH);
        firmware.press();
        trouble = wait_for_trouble(&mut firmware, "");
    }
    if !trouble.text.contains("OtherFirmware { motor: motor 2,")
        || !trouble.text.contains("20231201")
    {
        firmware.fail(&format!("expected motor 2 of version 20231201, found \"{trouble}\""));
    }
    firmware.wait_for("State(Stopped)", TIMEOUT);
    firmware.check_stays_stopped(WATCH);
    firmware.check_still(replaced, Duration::ZERO);
}
