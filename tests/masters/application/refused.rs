//! Requests that the master refuses.

use myactuator_host_std::sim::Fleet;
use myactuator_host_std::sim::bus::can::CanBus;
use myactuator_host_std::sim::bus::rs485::Rs485Line;
use myactuator_mcu_example::{Moment, Report, Setup, StateName, Trouble};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::master::StopKind;
use myactuator_tests::on_both_buses;
use myactuator_tests::values::{id, millis};
use myactuator_tests::wire::Wire;

use super::{Firmware, Moved, Panel};

on_both_buses! {
    more_motors_than_there_are_places_for_do_not_run
    a_set_point_that_is_refused_names_the_reason
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

/// The master knows of a restart, and has not reported it yet. Or something else has stopped the motor.
fn a_set_point_that_is_refused_names_the_reason<B: Moved>() {
    let motor = id(2);
    for is_restart in [true, false] {
        let bus = B::drives(&Fleet::new(2)).unwrap();
        let mut firmware = Firmware::running(&bus);
        let Firmware { runner, app, panel, .. } = &mut firmware;
        let (now, master) = (app.next_cycle(), runner.master());
        let trouble = if is_restart {
            master.note_restart(motor);
            Trouble::Restarted { motor }
        } else {
            master.stop(motor, StopKind::Hold).unwrap();
            Trouble::Refused { motor }
        };
        app.begin_cycle(&mut Moment { now, master, board: panel });
        assert_eq!(firmware.troubles(), [trouble]);
        firmware.stays_stopped();
    }
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
