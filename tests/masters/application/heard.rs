//! Which motors must be heard, and what is told of them.

use myactuator_host_std::sim::Fleet;
use myactuator_mcu_example::{Report, Trouble};
use myactuator_tests::on_both_buses;
use myactuator_tests::values::{id, millis};

use super::{Firmware, Moved, unplug};

on_both_buses! {
    the_only_motor_is_named_when_it_is_silent
}

fn the_only_motor_is_named_when_it_is_silent<B: Moved>() {
    let bus = B::drives(&Fleet::new(1)).unwrap();
    let mut firmware = Firmware::running(&bus);
    firmware.run_for(millis(300));
    unplug(&bus, &bus.drives[0]);
    firmware.run_until(Report::Trouble(Trouble::Silent { motor: id(1) }), millis(200));
}
