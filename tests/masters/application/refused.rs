//! Requests that the master refuses.

use myactuator_host_std::sim::Fleet;
use myactuator_host_std::sim::bus::can::CanBus;
use myactuator_host_std::sim::bus::rs485::Rs485Line;
use myactuator_mcu_example::{Report, Setup, StateName, Trouble};
use myactuator_protocol_core::MotorId;
use myactuator_tests::on_both_buses;
use myactuator_tests::values::{id, millis};
use myactuator_tests::wire::Wire;

use super::{Firmware, Moved, Panel};

on_both_buses! {
    more_motors_than_there_are_places_for_do_not_run
}

fn more_motors_than_there_are_places_for_do_not_run<B: Moved>() {
    let bus = B::drives(&Fleet::new(9)).unwrap();
    let setup = Setup { search: MotorId::all().take(9).collect(), ..B::setup() };
    let mut firmware = Firmware::start_with(&bus, Panel::default(), setup);
    firmware.run_for(millis(2_000));
    firmware.press(millis(50));
    firmware.run_until(Report::Trouble(Trouble::Refused { motor: id(9) }), millis(1_000));
    firmware.stays_stopped();
}

#[test]
fn motion_mode_is_refused_on_rs485() {
    let bus = Rs485Line::drives(&Fleet::new(1)).unwrap();
    let mut firmware = Firmware::start_with(&bus, Panel::default(), CanBus::setup());
    firmware.run_for(millis(1_500));
    firmware.press(millis(50));
    firmware.run_until(Report::State(StateName::Running), millis(3_000));
    firmware.run_until(Report::Trouble(Trouble::Refused { motor: id(1) }), millis(5));
    firmware.stays_stopped();
}
