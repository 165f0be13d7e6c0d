//! An adverse adapter between the firmware and the bus. The firmware is not configured for it. The adapter passes on
//! received bytes in bursts. On RS485 it echoes what it sends; on CAN it sends by priority.

use std::thread;

use myactuator_tests::emulator::drives::Adapter;

use super::running::{
    Program, RECOVERY, TIMEOUT, WATCH, millis, start_moving, stopped_with, tests_on,
    wait_for_trouble,
};

tests_on! {
    every program:
    a_stop_that_no_drive_received_is_not_confirmed
}

fn a_stop_that_no_drive_received_is_not_confirmed(program: Program) {
    let mut firmware = stopped_with(program, Adapter::Adverse);
    firmware.check_stays_stopped(WATCH);
    start_moving(&mut firmware);
    firmware.skip();
    let second = firmware.wait_for_second();
    if second.lost as usize > firmware.excused() {
        firmware.fail(&format!("{second:?}: expected no lost reply on an undisturbed bus"));
    }

    let cut = firmware.drives().now();
    firmware.drives().cut(firmware.drives().handles());
    wait_for_trouble(&mut firmware, "");
    firmware.wait_for("Stopped { unconfirmed: [1 2 3 4] }", TIMEOUT);
    thread::sleep(millis(500));
    firmware.drives().mend(firmware.drives().handles());
    firmware.check_stays_stopped(RECOVERY + WATCH);
    // By the drives' communication protection, which the application has set.
    firmware.check_still(cut, millis(700));
    start_moving(&mut firmware);
}
