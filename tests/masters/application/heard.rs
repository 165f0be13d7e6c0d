//! Which motors must be heard, which must hear enough commands, and what is reported of the others.

use myactuator_host_std::sim::Fleet;
use myactuator_mcu_example::{Movement, Report, Setup, StateName, Trouble, cycle};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{BrakeCommand, ErrorFlags};
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::master::{Config, Event, MotorSet};
use myactuator_protocol_core::time::Duration;
use myactuator_tests::fleet::{lost_their_master, state};
use myactuator_tests::on_both_buses;
use myactuator_tests::tapped::Tapped;
use myactuator_tests::values::{id, millis};

use super::{Firmware, Moved, Panel, told_by, unplug};

on_both_buses! {
    the_only_motor_is_named_when_it_is_silent
    motors_hear_enough_while_others_write_slowly
    motors_hear_enough_while_others_are_looked_for
    a_motor_that_ran_and_is_missing_keeps_the_others_from_starting
    a_motor_that_was_heard_once_must_be_found
    a_required_motor_must_be_found_wherever_is_searched
    ids_without_an_answer_are_reported_separately
    a_shutdown_after_a_search_that_failed_is_one_of_all
    an_error_is_noticed_at_once_where_motors_report_it
    motors_hear_enough_beside_stops_to_nobody
    a_stopped_motor_is_asked_every_10_ms_whatever_the_cycle
    a_motor_that_stops_late_is_kept_holding
    a_motor_that_was_found_once_must_be_found_again
    a_motor_that_confirmed_no_stop_must_be_found_again
    two_motors_that_are_silent_are_a_dead_bus
    a_bus_that_waits_long_for_a_silent_motor_is_not_down
}

fn the_only_motor_is_named_when_it_is_silent<B: Moved>() {
    let bus = B::drives(&Fleet::new(1)).unwrap();
    let mut firmware = Firmware::running(&bus);
    firmware.run_for(millis(300));
    unplug(&bus, &bus.drives[0]);
    firmware.run_until(Report::Trouble(Trouble::Silent { motor: id(1) }), millis(200));
}

/// Each motor accepts its protection only at the third attempt, 100 ms after the first.
fn motors_hear_enough_while_others_write_slowly<B: Moved>() {
    let bus = B::drives(&Fleet::new(8)).unwrap();
    // An angle of 0 is read once more after a pause, as its answer equals the read.
    for drive in &bus.drives {
        drive.with(|drive| drive.plant_mut().set_output_angle_deg(10.0).unwrap());
    }
    let mut firmware = Firmware::start(&bus, Panel::default());
    firmware.run_until_preparing();
    let began = firmware.runner.now();
    for drive in &bus.drives {
        let is_protected = || drive.with(|drive| drive.settings().protection_timeout.raw() == 500);
        assert!(!is_protected());
        // Not during another exchange, which would fail before the third attempt.
        while B::NAME == "CAN" && firmware.runner.master().is_anything_in_flight() {
            firmware.run_for(Duration::from_micros(100));
        }
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
    assert_eq!(lost_their_master(&bus.drives), []);
    firmware.run_for(millis(500));
    assert!(bus.drives.iter().all(|drive| state(drive).output_on));
    assert_eq!(lost_their_master(&bus.drives), []);
}

/// The motors hold with their protection on, while a restarted firmware searches for 32 motors.
fn motors_hear_enough_while_others_are_looked_for<B: Moved>() {
    let bus = B::drives(&Fleet::new(2)).unwrap();
    drop(Firmware::running(&bus));
    let setup = Setup { search: MotorSet::ALL, ..B::setup() };
    let mut firmware = Firmware::start_with(&bus, Panel::default(), setup);
    firmware.run_for(millis(3_000));
    assert_eq!(lost_their_master(&bus.drives), []);
    firmware.press(millis(50));
    firmware.run_until(Report::State(StateName::Running), millis(6_000));
    assert_eq!(lost_their_master(&bus.drives), []);
}

/// A question that is due just after a cycle began waits for the next one, and does not put off those after it.
fn a_stopped_motor_is_asked_every_10_ms_whatever_the_cycle<B: Moved>() {
    for cycle_ms in [1, 4, 9] {
        let bus = B::drives(&Fleet::new(1)).unwrap();
        let search = id(1).into();
        let setup = Setup { search, cycle: millis(cycle_ms), ..B::setup() };
        let mut firmware = Firmware::start_with(&bus, Panel::default(), setup);
        firmware.run_for(millis(100));
        let before = firmware.runner.master().health(id(1)).answered;
        firmware.run_for(millis(1_000));
        let answered = firmware.runner.master().health(id(1)).answered - before;
        assert!((98..=102).contains(&answered), "a cycle of {cycle_ms} ms: {answered}");
    }
}

fn a_motor_that_ran_and_is_missing_keeps_the_others_from_starting<B: Moved>() {
    let bus = B::drives(&Fleet::new(3)).unwrap();
    let mut firmware = Firmware::running(&bus);
    firmware.press(millis(50));
    firmware.run_for(millis(1_000));
    unplug(&bus, &bus.drives[2]);
    firmware.forget();
    firmware.press(millis(50));
    firmware.run_until(Report::Trouble(Trouble::Silent { motor: id(3) }), millis(500));
    assert!(!firmware.panel.reports.contains(&Report::State(StateName::Preparing)));
    firmware.run_until(Report::Stopped { unconfirmed: id(3).into() }, millis(1_100));
    firmware.stays_stopped();
    bus.world.mend(bus.drives[2].station());
    // It is told to hold again. Sooner a press starts nothing.
    firmware.run_for(millis(1_200));
    firmware.press(millis(50));
    firmware.run_until(Report::State(StateName::Running), millis(3_000));
}

/// The motor has confirmed the stop at the start, so it is there although no search has found it yet.
fn a_motor_that_was_heard_once_must_be_found<B: Moved>() {
    let bus = B::drives(&Fleet::new(3)).unwrap();
    let mut firmware = Firmware::start(&bus, Panel::default());
    firmware.run_for(millis(1_500));
    unplug(&bus, &bus.drives[0]);
    firmware.press(millis(50));
    firmware.run_until(Report::Trouble(Trouble::Silent { motor: id(1) }), millis(500));
    assert!(!firmware.panel.reports.contains(&Report::State(StateName::Preparing)));
    firmware.stays_stopped();
}

fn a_required_motor_must_be_found_wherever_is_searched<B: Moved>() {
    for required in [2, 9] {
        let bus = B::drives(&Fleet::new(1)).unwrap();
        let setup = Setup { required: id(required).into(), ..B::setup() };
        let mut firmware = Firmware::start_with(&bus, Panel::default(), setup);
        firmware.run_until(Report::Stopped { unconfirmed: id(required).into() }, millis(1_500));
        firmware.run_for(millis(1_000));
        firmware.press(millis(50));
        let silent = Trouble::Silent { motor: id(required) };
        firmware.run_until(Report::Trouble(silent), millis(1_500));
        firmware.stays_stopped();
    }
}

/// The firmware goes on stopping these ids. A motor that confirms a stop is expected from then on.
fn ids_without_an_answer_are_reported_separately<B: Moved>() {
    let bus = B::drives(&Fleet::new(2)).unwrap();
    unplug(&bus, &bus.drives[1]);
    let mut firmware = Firmware::start(&bus, Panel::default());
    firmware.run_for(millis(1_500));
    let told = |motors: &[u8]| motors.iter().map(|&motor| id(motor)).collect::<MotorSet>();
    let stopped = Report::Stopped { unconfirmed: MotorSet::EMPTY };
    assert_eq!(
        firmware.panel.reports[2..4],
        [Report::Unheard { motors: told(&[2, 3, 4, 5, 6, 7, 8]) }, stopped]
    );
    bus.world.mend(bus.drives[1].station());
    // Every half a second one of the seven gets a stop.
    firmware.run_for(millis(4_000));
    unplug(&bus, &bus.drives[1]);
    firmware.forget();
    firmware.press(millis(50));
    firmware.run_until(Report::Stopped { unconfirmed: told(&[2]) }, millis(1_500));
    let is_unheard =
        |report: &Report| matches!(report, Report::Unheard { motors } if motors.contains(id(2)));
    assert!(!firmware.panel.reports.iter().any(is_unheard));
}

fn a_shutdown_after_a_search_that_failed_is_one_of_all<B: Moved>() {
    let bus = B::drives(&Fleet::new(3).brakes(true)).unwrap();
    let mut firmware = Firmware::running(&bus);
    firmware.press(millis(50));
    firmware.run_for(millis(1_000));
    firmware.press(millis(50));
    firmware.run_until(Report::State(StateName::Finding), millis(100));
    bus.drives[1].with(|drive| drive.raise_fault(ErrorFlags::STALL));
    firmware.run_until(Report::State(StateName::Stopped), millis(1_000));
    // Even within a second after a stop by something else.
    firmware.press(millis(1_100));
    firmware.run_for(millis(300));
    for drive in &bus.drives {
        let state = state(drive);
        assert!(!state.output_on && state.brake == BrakeCommand::LOCK, "{state:?}");
    }
}

/// On CAN motors report their errors on their own. On RS485 the firmware has to ask for them.
fn an_error_is_noticed_at_once_where_motors_report_it<B: Moved>() {
    let is_can = matches!(B::setup().movement, Movement::Motion { .. });
    let taken = (0..8).map(|index| {
        let bus = B::drives(&Fleet::new(8)).unwrap();
        let mut firmware = Firmware::running(&bus);
        firmware.run_for(millis(300));
        let flags = ErrorFlags::MOTOR_OVER_TEMPERATURE;
        let raised = firmware.runner.now();
        bus.drives[index].with(|drive| drive.raise_fault(flags));
        let motor = bus.drives[index].motor();
        firmware.run_until(Report::Trouble(Trouble::Errors { motor, flags }), millis(300));
        firmware.runner.now() - raised
    });
    let slowest = taken.max().unwrap();
    assert_eq!(B::setup().error_reports, is_can);
    assert_eq!(slowest < millis(5), is_can, "{slowest}");
}

/// Seven ids have no motor. On RS485 the stops to them would leave room for nothing else.
fn motors_hear_enough_beside_stops_to_nobody<B: Moved>() {
    let bus = B::drives(&Fleet::new(1)).unwrap();
    drop(Firmware::running(&bus));
    let mut firmware = Firmware::start(&bus, Panel::default());
    for tenth in 0..50 {
        firmware.run_for(millis(100));
        assert_eq!(lost_their_master(&bus.drives), [], "after {tenth} tenths of a second");
    }
}

fn a_motor_that_stops_late_is_kept_holding<B: Moved>() {
    let bus = B::drives(&Fleet::new(2)).unwrap();
    let mut firmware = Firmware::running(&bus);
    unplug(&bus, &bus.drives[1]);
    firmware.run_until(Report::Stopped { unconfirmed: id(2).into() }, millis(1_500));
    bus.world.mend(bus.drives[1].station());
    firmware.run_for(millis(1_000));
    lost_their_master(&bus.drives);
    let asked = firmware.runner.master().health(id(2)).answered;
    firmware.run_for(millis(3_000));
    assert_eq!(lost_their_master(&bus.drives), []);
    let asked = firmware.runner.master().health(id(2)).answered - asked;
    assert!(asked > 100, "it is stopped again and again, and asked nothing: {asked}");
    assert!(bus.drives.iter().all(|drive| !state(drive).communication_lost));
}

/// The motor was plugged in after the last stop, so only the search has heard it.
fn a_motor_that_was_found_once_must_be_found_again<B: Moved>() {
    let bus = B::drives(&Fleet::new(2)).unwrap();
    unplug(&bus, &bus.drives[1]);
    let setup = Setup { search: MotorId::all().take(2).collect(), ..B::setup() };
    let mut firmware = Firmware::start_with(&bus, Panel::default(), setup);
    // Until no repeated stop is in flight.
    firmware.run_for(millis(1_700));
    firmware.press(millis(50));
    firmware.run_until(Report::State(StateName::Finding), millis(100));
    bus.world.mend(bus.drives[1].station());
    firmware.run_until(Report::State(StateName::Running), millis(3_000));
    unplug(&bus, &bus.drives[1]);
    firmware.run_until(Report::Stopped { unconfirmed: id(2).into() }, millis(1_000));
    // An earlier press starts nothing.
    firmware.run_for(millis(1_000));
    firmware.press(millis(50));
    firmware.run_until(Report::Trouble(Trouble::Silent { motor: id(2) }), millis(1_000));
    assert_eq!(told_by(&firmware, |report| *report == Report::State(StateName::Preparing)), 1);
}

/// Only the search has heard it.
fn a_motor_that_confirmed_no_stop_must_be_found_again<B: Moved>() {
    let bus = B::drives(&Fleet::new(2)).unwrap();
    let setup = Setup { search: MotorId::all().take(2).collect(), ..B::setup() };
    let mut firmware = Firmware::start_with(&bus, Panel::default(), setup);
    let unless_confirmed = |event: Option<Event>| {
        event.filter(|event| *event != Event::StopConfirmed { motor: id(2) })
    };
    let run_for = |firmware: &mut Firmware<'_, B>, ms| {
        let Firmware { runner, app, panel, .. } = firmware;
        let end = runner.now() + millis(ms);
        while runner.now() < end {
            cycle(app, &mut Tapped(runner, unless_confirmed), panel);
        }
    };
    let press = |firmware: &mut Firmware<'_, B>| {
        firmware.forget();
        firmware.panel.is_button_down = true;
        run_for(firmware, 50);
        firmware.panel.is_button_down = false;
        run_for(firmware, 1_500);
    };
    run_for(&mut firmware, 1_500);
    press(&mut firmware);
    assert!(firmware.panel.reports.contains(&Report::State(StateName::Running)));
    unplug(&bus, &bus.drives[1]);
    // Sooner a press starts nothing.
    run_for(&mut firmware, 2_000);
    press(&mut firmware);
    assert_eq!(firmware.troubles(), [Trouble::Silent { motor: id(2) }]);
    assert!(!firmware.panel.reports.contains(&Report::State(StateName::Preparing)));
}

fn two_motors_that_are_silent_are_a_dead_bus<B: Moved>() {
    let bus = B::drives(&Fleet::new(2)).unwrap();
    let mut firmware = Firmware::running(&bus);
    firmware.run_for(millis(300));
    bus.drives.iter().for_each(|drive| unplug(&bus, drive));
    firmware.run_until(Report::Trouble(Trouble::BusDown), millis(200));
}

/// While the line waits for the missing motor, the others are not asked.
fn a_bus_that_waits_long_for_a_silent_motor_is_not_down<B: Moved>() {
    let patience = millis(25);
    let patient = Config {
        reply_timeout: patience,
        longest_response: patience,
        late_window: millis(50),
        ..B::CONFIG
    };
    for phase in 0..12 {
        let slow = Fleet::new(4).response(millis(2), millis(4));
        let bus = B::drives(&slow).unwrap();
        let mut firmware = Firmware::running_on(&bus, B::runner(&bus.world, patient).0);
        firmware.run_for(millis(300 + 3 * phase));
        unplug(&bus, &bus.drives[2]);
        firmware.run_until(Report::Trouble(Trouble::Silent { motor: id(3) }), millis(200));
    }
}
