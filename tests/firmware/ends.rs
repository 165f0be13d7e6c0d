//! The button, and firmware that breaks.

use std::thread;
use std::time::Duration;

use myactuator_protocol_core::command::Stop;
use myactuator_protocol_core::time::Instant;
use myactuator_protocol_core::{Channel, MotorId, Target};
use myactuator_tests::emulator::board::Board;
use myactuator_tests::emulator::firmware::Firmware;
use myactuator_tests::emulator::panel::Breakage;

use super::running::{
    DRIVES, Program, TIMEOUT, WATCH, millis, moving, start_moving, tests_on, wait_for_trouble,
};

tests_on! {
    every program:
    every_failure_stops_all_and_reports_its_cause
}

/// The application polls the button every 20 ms. A stop reaches all motors a few milliseconds later.
const BUTTON_STOPS: Duration = Duration::from_millis(100);
/// Firmware that panics or faults sends its last stops at once. On RS485 it leaves each of eight motors 5 ms to answer.
const LAST_STOPS: Duration = Duration::from_millis(150);
/// The watchdog fires after 200 ms, and then the firmware sends its last stops.
const WATCHDOG_STOPS: Duration = Duration::from_millis(350);
/// Without a watchdog, motors stop on their own 500 ms after the last command, which the application has set.
const PROTECTION_STOPS: Duration = Duration::from_millis(700);

/// One failure after another, and no two in a row with the same cause: a restart consumes the note of its cause, so
/// each failure has to leave its own.
fn every_failure_stops_all_and_reports_its_cause(program: Program) {
    let mut firmware = moving(program);
    breaks(&mut firmware, Breakage::Fault, "Fault", LAST_STOPS);
    breaks(&mut firmware, Breakage::Panic, "Panic", LAST_STOPS);
    breaks(&mut firmware, Breakage::Overflow, "Fault", LAST_STOPS);
    match program.0 {
        Board::Mps2An386 => breaks(&mut firmware, Breakage::Hang, "Watchdog", WATCHDOG_STOPS),
        // QEMU's machine has no watchdog.
        Board::NetduinoPlus2 => breaks(&mut firmware, Breakage::Panic, "Panic", LAST_STOPS),
    }
    breaks(&mut firmware, Breakage::Unexpected, "Fault", LAST_STOPS);
    holding_the_button_stops_and_starts_nothing(&mut firmware);
    if program.0 == Board::NetduinoPlus2 {
        drives_stop_on_their_own_when_firmware_without_a_watchdog_hangs(&mut firmware);
    }
}

fn holding_the_button_stops_and_starts_nothing(firmware: &mut Firmware) {
    let held = firmware.drives().now();
    firmware.hold();
    wait_for_trouble(firmware, "Button");
    firmware.wait_for("Stopped { unconfirmed: [] }", TIMEOUT);
    firmware.wait_for("State(Stopped)", TIMEOUT);
    firmware.check_stays_stopped(WATCH);
    firmware.check_still(held, BUTTON_STOPS);
    start_moving(firmware);
}

/// Breaks the firmware. It sends a stop to all motors, and they stand still, within the time. After the restart the
/// firmware reports the cause, and nothing moves until the button is pressed.
fn breaks(firmware: &mut Firmware, how: Breakage, cause: &str, within: Duration) {
    let broken = firmware.break_it(how);
    if how == Breakage::Panic {
        let panic = firmware.wait_for("panicked at", TIMEOUT);
        assert!(
            panic.text.ends_with("the panel asked for it"),
            "expected the panel's panic, found \"{panic}\""
        );
    }
    firmware.wait_for(&format!("Started {{ cause: {cause} }}"), TIMEOUT);
    check_stops(firmware, broken, within);
    firmware.wait_for("State(Stopped)", TIMEOUT);
    firmware.check_stays_stopped(WATCH);
    firmware.check_still(broken, within);
    start_moving(firmware);
}

/// Fails unless a stop to all and one to each motor were on the bus within the time.
fn check_stops(firmware: &Firmware, since: Instant, within: Duration) {
    let each = MotorId::all().take(DRIVES.into()).map(Target::Motor);
    for target in each.chain([Target::All]) {
        let heard = firmware.drives().heard_since(since);
        let stop = heard.iter().find(|heard| {
            heard.packet.channel == Channel::Command(target) && heard.packet.data == Stop.encode()
        });
        match stop {
            Some(stop) if Duration::from(stop.at - since) <= within => {}
            Some(stop) => firmware.fail(&format!(
                "expected a stop to {target:?} within {within:?} after {since:?}, found one at {:?}",
                stop.at
            )),
            None => firmware.fail(&format!("expected a stop to {target:?}, found none")),
        }
    }
}

fn drives_stop_on_their_own_when_firmware_without_a_watchdog_hangs(firmware: &mut Firmware) {
    let broken = firmware.break_it(Breakage::Hang);
    thread::sleep(PROTECTION_STOPS + millis(300));
    firmware.check_still(broken, PROTECTION_STOPS);
    for sample in firmware.samples() {
        assert!(!sample.is_output_on, "{sample:?}");
    }
}
