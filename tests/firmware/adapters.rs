//! Between the firmware and the bus is an adapter that is not kind, of which the firmware was told nothing: what it
//! hears it hands over in bursts; on RS485 it hands back what it is given to send, and on CAN it sends by priority.

use std::thread;

use myactuator_tests::emulator::drives::Adapter;

use super::running::{BACK, PATIENCE, Program, WATCHED, go, millis, on, stopped_behind, stops_for};

on! {
    every program:
    a_stop_that_no_drive_heard_is_not_confirmed
}

fn a_stop_that_no_drive_heard_is_not_confirmed(program: Program) {
    let mut firmware = stopped_behind(program, Adapter::Unkind);
    firmware.check_stays_stopped(WATCHED);
    go(&mut firmware);
    firmware.skip();
    let second = firmware.wait_for_second();
    if second.lost as usize > firmware.excused() {
        firmware.fail(&format!("{second:?}: a reply was lost on a clean bus"));
    }

    let cut = firmware.drives().now();
    firmware.drives().cut(firmware.drives().handles());
    stops_for(&mut firmware, "");
    firmware.wait_for("Stopped { unconfirmed: [1 2 3 4] }", PATIENCE);
    thread::sleep(millis(500));
    firmware.drives().mend(firmware.drives().handles());
    firmware.check_stays_stopped(BACK + WATCHED);
    // By their own protection, which the application has told them.
    firmware.check_still(cut, millis(700));
    go(&mut firmware);
}
