//! What holds a shaft whose brake opens.

use myactuator_host_std::sim::{BusFleet, Fleet};
use myactuator_mcu_example::{Report, StateName};
use myactuator_protocol_core::command::BrakeCommand;
use myactuator_protocol_core::io::Runner;
use myactuator_tests::fleet::state;
use myactuator_tests::on_both_buses;
use myactuator_tests::values::millis;

use super::{Firmware, Moved, Panel};

on_both_buses! {
    after_a_shutdown_no_brake_opens_before_its_motor_holds
    after_a_motor_restarted_its_brake_does_not_open_before_it_holds
}

/// Longer than two commands to a motor take, shorter than any brake takes to open: 50 ms and more.
const MOMENT_MS: u32 = 10;

/// Presses the button, and looks at every moment until the motors run: a shaft with an open brake and no
/// output falls.
fn is_always_held<B: Moved>(firmware: &mut Firmware<'_, B>, bus: &BusFleet<B>) {
    firmware.press(millis(50));
    firmware.forget();
    let running = Report::State(StateName::Running);
    let end = firmware.runner.now() + millis(3_000);
    let mut unheld_ms = vec![0; bus.drives.len()];
    while !firmware.panel.reports.contains(&running) {
        assert!(firmware.runner.now() < end, "{:?}", firmware.panel.reports);
        firmware.run_for(millis(1));
        for (drive, unheld_ms) in bus.drives.iter().zip(&mut unheld_ms) {
            let state = state(drive);
            let is_held = state.output_on || state.brake == BrakeCommand::LOCK;
            *unheld_ms = if is_held { 0 } else { *unheld_ms + 1 };
            assert!(*unheld_ms < MOMENT_MS, "nobody holds: {state:?}");
        }
    }
}

fn after_a_shutdown_no_brake_opens_before_its_motor_holds<B: Moved>() {
    let bus = B::drives(&Fleet::new(4).brakes(true)).unwrap();
    let mut firmware = Firmware::running(&bus);
    firmware.press(millis(50));
    firmware.run_for(millis(1_000));
    firmware.press(millis(1_100));
    firmware.run_for(millis(1_000));
    assert!(bus.drives.iter().all(|drive| !state(drive).output_on));
    is_always_held(&mut firmware, &bus);
}

fn after_a_motor_restarted_its_brake_does_not_open_before_it_holds<B: Moved>() {
    let bus = B::drives(&Fleet::new(2).brakes(true)).unwrap();
    let mut firmware = Firmware::start(&bus, Panel::default());
    firmware.run_for(millis(1_500));
    let now = firmware.runner.now();
    bus.drives[1].with(|drive| {
        drive.power_off(now);
        drive.power_on(now);
    });
    firmware.run_for(millis(1_000));
    is_always_held(&mut firmware, &bus);
}
