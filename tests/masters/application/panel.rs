//! The button, the light, and the report of each second.

use myactuator_host_std::sim::Fleet;
use myactuator_mcu_example::{Report, StateName};
use myactuator_protocol_core::io::Runner;
use myactuator_tests::on_both_buses;
use myactuator_tests::values::millis;

use super::{Firmware, Moved, Panel, angle_deg};

on_both_buses! {
    a_spike_on_the_button_starts_nothing
    the_light_blinks_slowly_while_stopped_and_is_on_while_running
    the_reported_angles_are_those_of_the_shafts
}

fn a_spike_on_the_button_starts_nothing<B: Moved>() {
    let bus = B::drives(&Fleet::new(1)).unwrap();
    let mut firmware = Firmware::start(&bus, Panel::default());
    firmware.run_for(millis(1_500));
    firmware.press(millis(5));
    firmware.stays_stopped();
}

fn the_light_blinks_slowly_while_stopped_and_is_on_while_running<B: Moved>() {
    let bus = B::drives(&Fleet::new(1)).unwrap();
    let mut firmware = Firmware::start(&bus, Panel::default());
    let changes = |firmware: &mut Firmware<'_, B>| {
        let mut changes = 0;
        for _ in 0..2_000 {
            let before = firmware.panel.is_light_on;
            firmware.run_for(millis(1));
            changes += u32::from(firmware.panel.is_light_on != before);
        }
        changes
    };
    firmware.run_until(Report::State(StateName::Stopped), millis(1_500));
    assert_eq!(changes(&mut firmware), 4);
    firmware.press(millis(50));
    firmware.run_until(Report::State(StateName::Running), millis(3_000));
    firmware.run_for(millis(2));
    assert_eq!(changes(&mut firmware), 0);
    assert!(firmware.panel.is_light_on);
}

fn the_reported_angles_are_those_of_the_shafts<B: Moved>() {
    let bus = B::drives(&Fleet::new(3)).unwrap();
    let mut firmware = Firmware::running(&bus);
    firmware.forget();
    let until = firmware.runner.now() + millis(1_100);
    let told = |firmware: &Firmware<'_, B>| {
        let measured = |report: &Report| match *report {
            Report::Measured { angle, .. } => Some(angle.degrees()),
            _ => None,
        };
        firmware.panel.reports.iter().filter_map(measured).collect::<Vec<_>>()
    };
    while told(&firmware).is_empty() {
        assert!(firmware.runner.now() < until);
        firmware.run_for(millis(1));
    }
    let told = told(&firmware);
    assert_eq!(told.len(), 3);
    for (drive, told) in bus.drives.iter().zip(told) {
        let is = angle_deg(drive);
        assert!((is - f64::from(told)).abs() < 4.0 && is > 15.0, "{told} told, {is}");
    }
}
