//! The button, and a firmware that ends.

use std::thread;
use std::time::Duration;

use myactuator_protocol_core::command::Stop;
use myactuator_protocol_core::time::Instant;
use myactuator_protocol_core::{Channel, MotorId, Target};
use myactuator_tests::emulator::board::Board;
use myactuator_tests::emulator::firmware::Firmware;
use myactuator_tests::emulator::panel::Breakage;

use super::running::{DRIVES, PATIENCE, Program, WATCHED, go, millis, moving, on, stops_for};

on! {
    every program:
    every_end_stops_all_and_tells_its_own_cause
}

/// The application looks at the button every millisecond; a stop reaches all motors within some more.
const BUTTON_STOPS: Duration = Duration::from_millis(100);
/// A firmware that panics or faults says its last words at once: on a line each of eight motors is left 5 ms
/// to answer.
const LAST_WORDS_STOP: Duration = Duration::from_millis(150);
/// The watchdog bites after 200 ms, and then the last words are said.
const WATCHDOG_STOPS: Duration = Duration::from_millis(350);
/// Where there is no watchdog, motors stop by themselves 500 ms after the last command, which the
/// application has told them.
const PROTECTION_STOPS: Duration = Duration::from_millis(700);

/// One behind the other, no two of one cause in a row: the note of one is used up when the next one comes, which has to
/// make its own.
fn every_end_stops_all_and_tells_its_own_cause(program: Program) {
    let mut firmware = moving(program);
    ends(&mut firmware, Breakage::Fault, "Fault", LAST_WORDS_STOP);
    ends(&mut firmware, Breakage::Panic, "Panic", LAST_WORDS_STOP);
    ends(&mut firmware, Breakage::Overflow, "Fault", LAST_WORDS_STOP);
    match program.0 {
        Board::Mps2An386 => ends(&mut firmware, Breakage::Hang, "Watchdog", WATCHDOG_STOPS),
        // QEMU gives that machine no watchdog.
        Board::NetduinoPlus2 => ends(&mut firmware, Breakage::Panic, "Panic", LAST_WORDS_STOP),
    }
    ends(&mut firmware, Breakage::Unexpected, "Fault", LAST_WORDS_STOP);
    a_button_that_is_held_stops_and_starts_nothing(&mut firmware);
    if program.0 == Board::NetduinoPlus2 {
        a_hang_without_a_watchdog_ends_by_the_drives_protection(&mut firmware);
    }
}

fn a_button_that_is_held_stops_and_starts_nothing(firmware: &mut Firmware) {
    let held = firmware.drives().now();
    firmware.hold();
    stops_for(firmware, "Button");
    firmware.wait_for("Stopped { unconfirmed: [] }", PATIENCE);
    firmware.wait_for("State(Stopped)", PATIENCE);
    firmware.check_stays_stopped(WATCHED);
    firmware.check_still(held, BUTTON_STOPS);
    go(firmware);
}

/// All motors were told to stop, and stand still, within the time; after the restart the cause is told, and
/// nothing moves until the button.
fn ends(firmware: &mut Firmware, how: Breakage, cause: &str, within: Duration) {
    let broken = firmware.break_it(how);
    if how == Breakage::Panic {
        let told = firmware.wait_for("panicked at", PATIENCE);
        assert!(told.text.ends_with("the panel asked for it"), "{told}");
    }
    firmware.wait_for(&format!("Started {{ cause: {cause} }}"), PATIENCE);
    check_stops(firmware, broken, within);
    firmware.wait_for("State(Stopped)", PATIENCE);
    firmware.check_stays_stopped(WATCHED);
    firmware.check_still(broken, within);
    go(firmware);
}

/// A stop to all and one to each were on the bus by then.
fn check_stops(firmware: &Firmware, since: Instant, within: Duration) {
    let each = MotorId::all().take(DRIVES.into()).map(Target::Motor);
    for target in each.chain([Target::All]) {
        let heard = firmware.drives().heard_since(since);
        let stop = heard.iter().find(|heard| {
            heard.packet.channel == Channel::Command(target) && heard.packet.data == Stop.encode()
        });
        match stop {
            Some(stop) if Duration::from(stop.at - since) <= within => {}
            Some(stop) => firmware.fail(&format!("{target:?} was stopped at {:?}", stop.at)),
            None => firmware.fail(&format!("{target:?} was not stopped")),
        }
    }
}

/// The drives look after themselves.
fn a_hang_without_a_watchdog_ends_by_the_drives_protection(firmware: &mut Firmware) {
    let broken = firmware.break_it(Breakage::Hang);
    thread::sleep(PROTECTION_STOPS + millis(300));
    firmware.check_still(broken, PROTECTION_STOPS);
    for look in firmware.looks() {
        assert!(!look.is_output_on, "{look:?}");
    }
}
