//! The button, and a firmware that ends.

use std::thread;
use std::time::Duration;

use myactuator_protocol_core::command::Stop;
use myactuator_protocol_core::time::Instant;
use myactuator_protocol_core::{Channel, MotorId, Target};
use myactuator_tests::emulator::firmware::Firmware;
use myactuator_tests::emulator::panel::Breakage;

use super::running::{
    DRIVES, NETDUINO_RS485, PATIENCE, Program, WATCHED, go, millis, moving, on, stopped, stops_for,
};

on! {
    every program:
    a_button_that_is_held_stops_and_starts_nothing
    a_panic_stops_all_and_is_told
    a_fault_stops_all_and_is_told
    a_stack_that_overflows_stops_all_and_is_told
    an_exception_that_nobody_handles_stops_all_and_is_told
    each_end_tells_its_own_cause
}
on! {
    every watchdog:
    a_hang_ends_by_the_watchdog_which_is_told
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

fn a_button_that_is_held_stops_and_starts_nothing(program: Program) {
    let mut firmware = moving(program);
    let held = firmware.drives().now();
    firmware.hold();
    stops_for(&mut firmware, "Button");
    firmware.wait_for("Stopped { unconfirmed: [] }", PATIENCE);
    firmware.wait_for("State(Stopped)", PATIENCE);
    firmware.check_stays_stopped(WATCHED);
    firmware.check_still(held, BUTTON_STOPS);
    go(&mut firmware);
}

fn a_panic_stops_all_and_is_told(program: Program) {
    ends(program, Breakage::Panic, "Panic", LAST_WORDS_STOP);
}

fn a_fault_stops_all_and_is_told(program: Program) {
    ends(program, Breakage::Fault, "Fault", LAST_WORDS_STOP);
}

fn a_stack_that_overflows_stops_all_and_is_told(program: Program) {
    ends(program, Breakage::Overflow, "Fault", LAST_WORDS_STOP);
}

fn an_exception_that_nobody_handles_stops_all_and_is_told(program: Program) {
    ends(program, Breakage::Unexpected, "Fault", LAST_WORDS_STOP);
}

fn a_hang_ends_by_the_watchdog_which_is_told(program: Program) {
    ends(program, Breakage::Hang, "Watchdog", WATCHDOG_STOPS);
}

/// The note of one end is used up when the next one comes.
fn each_end_tells_its_own_cause(program: Program) {
    let mut firmware = stopped(program);
    for (how, cause) in [(Breakage::Panic, "Panic"), (Breakage::Fault, "Fault")] {
        firmware.break_it(how);
        firmware.wait_for(&format!("Started {{ cause: {cause} }}"), PATIENCE);
        firmware.wait_for("State(Stopped)", PATIENCE);
    }
}

/// All motors were told to stop, and stand still, within the time; after the restart the cause is told, and
/// nothing moves until the button.
fn ends(program: Program, how: Breakage, cause: &str, within: Duration) {
    let mut firmware = moving(program);
    let broken = firmware.break_it(how);
    if how == Breakage::Panic {
        let told = firmware.wait_for("panicked at", PATIENCE);
        assert!(told.text.ends_with("the panel asked for it"), "{told}");
    }
    firmware.wait_for(&format!("Started {{ cause: {cause} }}"), PATIENCE);
    check_stops(&firmware, broken, within);
    firmware.wait_for("State(Stopped)", PATIENCE);
    firmware.check_stays_stopped(WATCHED);
    firmware.check_still(broken, within);
    go(&mut firmware);
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

/// QEMU gives that machine no watchdog: the drives look after themselves.
#[test]
fn a_hang_without_a_watchdog_ends_by_the_drives_protection() {
    let mut firmware = moving(NETDUINO_RS485);
    let broken = firmware.break_it(Breakage::Hang);
    thread::sleep(PROTECTION_STOPS + millis(300));
    firmware.check_still(broken, PROTECTION_STOPS);
    for look in firmware.looks() {
        assert!(!look.is_output_on, "{look:?}");
    }
}
