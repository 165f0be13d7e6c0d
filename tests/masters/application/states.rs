//! The button and troubles in every active state.

use std::mem;

use myactuator_host_std::sim::Fleet;
use myactuator_mcu_example::{App, Moment, Report, RestartCause, StateName, Trouble, cycle};
use myactuator_protocol_core::command::ErrorFlags;
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::master::{Event, Master};
use myactuator_protocol_core::time::Instant;
use myactuator_tests::on_both_buses;
use myactuator_tests::values::{id, millis};

use super::{Firmware, Moved, Panel, unplug};

on_both_buses! {
    a_press_in_any_state_stops_and_starts_nothing
    a_bus_error_in_any_state_stops
    a_press_right_after_a_stop_by_something_else_starts_nothing
    a_press_right_after_a_stop_by_the_button_starts
    a_press_right_after_a_start_starts_nothing
    a_motor_that_lost_its_master_while_getting_ready_is_not_moved
    a_motor_that_restarted_before_it_was_looked_for_runs
    no_brake_opens_while_a_motor_has_an_error
    replies_that_are_lost_are_counted
    what_the_driver_reports_reaches_the_application
}

const UNDER_WAY: [StateName; 4] =
    [StateName::Finding, StateName::Preparing, StateName::Running, StateName::ShuttingDown];

/// Brings the firmware to the moment when it has just entered this state, with the button up.
fn in_state<B: Moved>(firmware: &mut Firmware<'_, B>, state: StateName) {
    firmware.run_for(millis(1_500));
    firmware.panel.is_button_down = true;
    firmware.run_for(millis(50));
    if state != StateName::ShuttingDown {
        firmware.panel.is_button_down = false;
    }
    firmware.run_until(Report::State(state), millis(3_000));
    firmware.panel.is_button_down = false;
}

fn a_press_in_any_state_stops_and_starts_nothing<B: Moved>() {
    // During a shutdown the button is still held.
    for state in UNDER_WAY.into_iter().filter(|&state| state != StateName::ShuttingDown) {
        let bus = B::drives(&Fleet::new(4).brakes(true)).unwrap();
        let mut firmware = Firmware::start(&bus, Panel::default());
        in_state(&mut firmware, state);
        firmware.panel.is_button_down = true;
        firmware.run_for(millis(2));
        let told = &firmware.panel.reports;
        assert_eq!(firmware.troubles(), [Trouble::Button], "{state:?}: {told:?}");
        firmware.panel.is_button_down = false;
        firmware.stays_stopped();
        assert_eq!(firmware.troubles(), [Trouble::Button], "{state:?}");
    }
}

fn a_bus_error_in_any_state_stops<B: Moved>() {
    for state in UNDER_WAY {
        let bus = B::drives(&Fleet::new(4).brakes(true)).unwrap();
        let mut firmware = Firmware::start(&bus, Panel::default());
        in_state(&mut firmware, state);
        let Firmware { runner, app, panel, .. } = &mut firmware;
        let now = runner.now();
        app.handle_bus_error(&mut Moment { now, master: runner.master(), board: panel });
        assert_eq!(firmware.troubles(), [Trouble::BusDown], "{state:?}");
        firmware.stays_stopped();
    }
}

fn a_motor_that_lost_its_master_while_getting_ready_is_not_moved<B: Moved>() {
    let bus = B::drives(&Fleet::new(2).brakes(true)).unwrap();
    let mut firmware = Firmware::start(&bus, Panel::default());
    in_state(&mut firmware, StateName::Preparing);
    let Firmware { runner, app, panel, .. } = &mut firmware;
    let (now, motor) = (runner.now(), id(2));
    let at = &mut Moment { now, master: runner.master(), board: panel };
    app.handle_event(&Event::LostMaster { motor }, at);
    assert_eq!(firmware.troubles(), [Trouble::LostMaster { motor }]);
    firmware.stays_stopped();
}

/// The press was meant to stop motors that have just been stopped.
fn a_press_right_after_a_stop_by_something_else_starts_nothing<B: Moved>() {
    for state in [StateName::Finding, StateName::Preparing, StateName::Running] {
        let bus = B::drives(&Fleet::new(2)).unwrap();
        let mut firmware = Firmware::start(&bus, Panel::default());
        in_state(&mut firmware, state);
        let now = firmware.runner.now();
        let at = &mut Moment { now, master: firmware.runner.master(), board: &mut firmware.panel };
        firmware.app.handle_bus_error(at);
        firmware.run_for(millis(300));
        firmware.press(millis(100));
        firmware.stays_stopped();
        assert_eq!(firmware.troubles(), [Trouble::BusDown]);
        firmware.press(millis(50));
        firmware.run_until(Report::State(StateName::Running), millis(3_000));
    }
}

/// Whoever presses twice means to start.
fn a_press_right_after_a_stop_by_the_button_starts<B: Moved>() {
    let bus = B::drives(&Fleet::new(2)).unwrap();
    let mut firmware = Firmware::running(&bus);
    firmware.run_for(millis(300));
    firmware.press(millis(50));
    firmware.run_for(millis(200));
    firmware.press(millis(50));
    firmware.run_until(Report::State(StateName::Running), millis(3_000));
    assert_eq!(firmware.troubles(), [Trouble::Button]);
}

/// The motors may have been running until then. A brown-out looks like the first start.
fn a_press_right_after_a_start_starts_nothing<B: Moved>() {
    for cause in [RestartCause::Power, RestartCause::Watchdog] {
        let bus = B::drives(&Fleet::new(2)).unwrap();
        let mut firmware = Firmware::start(&bus, Panel::default());
        let now = firmware.runner.now();
        let at = &mut Moment { now, master: firmware.runner.master(), board: &mut firmware.panel };
        firmware.app = App::start(B::setup(), cause, at);
        firmware.run_for(millis(400));
        firmware.press(millis(50));
        firmware.stays_stopped();
        firmware.press(millis(50));
        firmware.run_until(Report::State(StateName::Running), millis(3_000));
    }
}

/// The motors' supply is switched off and on before the button is pressed for the first time.
fn a_motor_that_restarted_before_it_was_looked_for_runs<B: Moved>() {
    let bus = B::drives(&Fleet::new(2)).unwrap();
    let mut firmware = Firmware::start(&bus, Panel::default());
    firmware.run_for(millis(3_000));
    let now = firmware.runner.now();
    bus.drives[1].with(|drive| drive.power_off(now));
    firmware.run_for(millis(1_000));
    let now = firmware.runner.now();
    bus.drives[1].with(|drive| drive.power_on(now));
    firmware.run_for(millis(4_000));
    firmware.press(millis(50));
    firmware.run_until(Report::State(StateName::Running), millis(3_000));
    firmware.run_for(millis(500));
    assert_eq!(firmware.troubles(), []);
}

fn no_brake_opens_while_a_motor_has_an_error<B: Moved>() {
    let flags = ErrorFlags::MOTOR_OVER_TEMPERATURE;
    for motor in (1..=4).map(id) {
        let bus = B::drives(&Fleet::new(4).brakes(true)).unwrap();
        let mut firmware = Firmware::start(&bus, Panel::default());
        firmware.run_for(millis(1_500));
        bus.drives[usize::from(motor.get()) - 1].with(|drive| drive.raise_fault(flags));
        // It is reported while the motor is stopped, and again because it keeps the motors from starting.
        firmware.run_until(Report::Trouble(Trouble::Errors { motor, flags }), millis(1_000));
        firmware.run_for(millis(1_000));
        firmware.press(millis(50));
        firmware.run_for(millis(500));
        assert_eq!(firmware.troubles(), [Trouble::Errors { motor, flags }; 2]);
        let told = &firmware.panel.reports;
        assert!(!told.contains(&Report::State(StateName::Preparing)), "{told:?}");
    }
}

fn replies_that_are_lost_are_counted<B: Moved>() {
    let bus = B::drives(&Fleet::new(2)).unwrap();
    let mut firmware = Firmware::running(&bus);
    firmware.run_for(millis(300));
    unplug(&bus, &bus.drives[1]);
    firmware.run_for(millis(20));
    bus.world.mend(bus.drives[1].station());
    firmware.run_for(millis(1_100));
    assert_eq!(firmware.troubles(), []);
    let told = firmware.panel.reports.iter().rev().find_map(|report| match *report {
        Report::Second { lost, .. } => Some(lost),
        _ => None,
    });
    assert!(told.is_some_and(|lost| lost > 0), "{told:?}");
}

/// A bus whose driver reports an error once.
struct Broken<'a, R>(&'a mut R, bool);

impl<R: Runner<8>> Runner<8> for Broken<'_, R> {
    type Error = &'static str;

    fn master(&mut self) -> &mut Master<8> {
        self.0.master()
    }

    fn now(&self) -> Instant {
        self.0.now()
    }

    fn poll(&mut self) -> Result<Option<Event>, &'static str> {
        if mem::take(&mut self.1) {
            return Err("broken");
        }
        self.0.poll().map_err(|_| "really broken")
    }

    fn idle(&mut self, until: Instant) {
        self.0.idle(until);
    }
}

fn what_the_driver_reports_reaches_the_application<B: Moved>() {
    let bus = B::drives(&Fleet::new(2)).unwrap();
    let mut firmware = Firmware::running(&bus);
    let Firmware { runner, app, panel, .. } = &mut firmware;
    cycle(app, &mut Broken(runner, true), panel);
    assert_eq!(firmware.troubles(), [Trouble::BusDown]);
    firmware.stays_stopped();
}
