//! Between the firmware and the bus is an adapter that holds back what it receives, and on RS485 hands back
//! what it is given to send, of which the firmware was told nothing.

use std::thread;
use std::time::Duration;

use myactuator_tests::emulator::adapter::Adapter;
use myactuator_tests::emulator::board::Wire;

use super::running::{PATIENCE, Program, WATCHED, go, millis, on, stopped_behind, stops_for};

on! {
    every program:
    a_stop_that_no_drive_heard_is_not_confirmed
}

/// On RS485 each exchange waits for one: with longer bursts the set-points are so few that shafts go in steps.
const BURSTS: Duration = Duration::from_millis(2);

fn a_stop_that_no_drive_heard_is_not_confirmed(program: Program) {
    let echo = Wire::of_program(program.1) == Ok(Wire::Rs485);
    let mut firmware = stopped_behind(program, Some(Adapter { bursts: BURSTS, echo }));
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
    firmware.check_stays_stopped(WATCHED);
    // By their own protection, which the application has told them.
    firmware.check_still(cut, millis(700));
    go(&mut firmware);
}
