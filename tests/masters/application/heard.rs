//! Which motors must be heard, which must hear enough, and what is told of the others.

use myactuator_host_std::sim::{BusFleet, DriveHandle, Fleet};
use myactuator_mcu_example::{Report, Setup, StateName, Trouble};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::drive::Event;
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::master::MotorSet;
use myactuator_protocol_core::time::Duration;
use myactuator_tests::fleet::{happened, state};
use myactuator_tests::on_both_buses;
use myactuator_tests::values::{id, millis};

use super::{Firmware, Moved, Panel, unplug};

on_both_buses! {
    the_only_motor_is_named_when_it_is_silent
    motors_hear_enough_while_others_write_slowly
    motors_hear_enough_while_others_are_looked_for
}

fn the_only_motor_is_named_when_it_is_silent<B: Moved>() {
    let bus = B::drives(&Fleet::new(1)).unwrap();
    let mut firmware = Firmware::running(&bus);
    firmware.run_for(millis(300));
    unplug(&bus, &bus.drives[0]);
    firmware.run_until(Report::Trouble(Trouble::Silent { motor: id(1) }), millis(200));
}

fn lost_their_master<B: Moved>(bus: &BusFleet<B>) -> Vec<MotorId> {
    let lost = |drive: &&DriveHandle| happened(drive).contains(&Event::ProtectionTripped);
    bus.drives.iter().filter(lost).map(DriveHandle::motor).collect()
}

/// Each motor takes its protection only at the third asking, 100 ms after the first.
fn motors_hear_enough_while_others_write_slowly<B: Moved>() {
    let bus = B::drives(&Fleet::new(8)).unwrap();
    let mut firmware = Firmware::start(&bus, Panel::default());
    firmware.run_for(millis(1_500));
    firmware.press(millis(50));
    firmware.run_until(Report::State(StateName::Preparing), millis(1_000));
    let began = firmware.runner.now();
    for drive in &bus.drives {
        let is_protected = || drive.with(|drive| drive.settings().protection_timeout.raw() == 500);
        assert!(!is_protected());
        unplug(&bus, drive);
        firmware.run_for(millis(80));
        bus.world.mend(drive.station());
        while !is_protected() {
            assert_eq!(firmware.troubles(), []);
            firmware.run_for(Duration::from_micros(100));
        }
    }
    let taken = firmware.runner.now() - began;
    assert!(taken > millis(700), "{taken}");
    firmware.run_until(Report::State(StateName::Running), millis(1_000));
    assert_eq!(lost_their_master(&bus), []);
    firmware.run_for(millis(500));
    assert!(bus.drives.iter().all(|drive| state(drive).output_on));
    assert_eq!(lost_their_master(&bus), []);
}

/// The motors hold, protected as they ran, and a firmware that has restarted looks for 32.
fn motors_hear_enough_while_others_are_looked_for<B: Moved>() {
    let bus = B::drives(&Fleet::new(2)).unwrap();
    drop(Firmware::running(&bus));
    let setup = Setup { search: MotorSet::ALL, ..B::setup() };
    let mut firmware = Firmware::start_with(&bus, Panel::default(), setup);
    firmware.run_for(millis(3_000));
    assert_eq!(lost_their_master(&bus), []);
    firmware.press(millis(50));
    firmware.run_until(Report::State(StateName::Running), millis(6_000));
    assert_eq!(lost_their_master(&bus), []);
}
