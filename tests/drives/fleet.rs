//! Whole drives on whole buses, as their master sees them, on CAN and RS485, under the virtual clock: a lost master,
//! memory in files, reports and physical errors. `manual` and `quirks` test a drive without a bus.

use std::fmt::Debug;

use myactuator_host_std::sim::bus::rs485::Rs485Line;
use myactuator_host_std::sim::plant::SimulatedMotor;
use myactuator_host_std::sim::{BusFleet, Fleet, FleetError};
use myactuator_protocol_core::command::{
    AnyReply, BrakeCommand, CommunicationLossProtection, ErrorFlags, FunctionControl, PidIndex,
    ReadMultiTurnAngle, ReadMultiTurnEncoder, ReadPid, ReadStatus1, Reset, Switch, WritePidRam,
    WritePidRom,
};
use myactuator_protocol_core::drive::{Event as Happened, Indicator, NotRunReason, Quirks, State};
use myactuator_protocol_core::io::{CallError, Runner, bring_up};
use myactuator_protocol_core::master::{Config, Event, Failure, MotorSet};
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::Milliseconds;
use myactuator_protocol_core::{MotorId, Opcode};
use myactuator_tests::fleet::{happened, master, state, turn_to};
use myactuator_tests::listen::listen;
use myactuator_tests::on_both_buses;
use myactuator_tests::values::{gain, id, millis, push, turn};
use myactuator_tests::wire::Wire;

const MOTOR: MotorId = MotorId::MIN;

on_both_buses! {
    after_a_lost_master_the_first_command_does_nothing
    memory_in_files_outlives_the_fleet
    errors_are_reported_while_they_last
    physical_errors_of_level_two_recover
    physical_errors_of_level_one_need_a_restart
}

fn quirky<W: Wire>(quirks: Quirks) -> BusFleet<W> {
    W::drives(&Fleet::new(1).quirks(quirks)).unwrap()
}

fn read_speed_kp<R: Runner<8, Error: Debug>>(master: &mut R) -> f32 {
    master.ask(MOTOR, ReadPid { index: PidIndex::SPEED_KP }).unwrap().value.value()
}

fn read_errors<R: Runner<8, Error: Debug>>(master: &mut R) -> ErrorFlags {
    master.ask(MOTOR, ReadStatus1).unwrap().errors
}

#[test]
fn equal_drives_have_different_seeds() {
    let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
    let [one, other] = [0, 1].map(|place| fleet.drives[place].with(|it| it.parameters().seed));
    assert_ne!(one, other);
}

// ---- a lost master ----

/// "A drive that lost its master sends frames with 0xF1 and no data, once a second; the first command
/// after that is echoed and ignored, the second works if it comes in time".
fn after_a_lost_master_the_first_command_does_nothing<W: Wire>() {
    let bus: BusFleet<W> = quirky(Quirks { lost_master_heartbeat: true, ..Quirks::default() });
    let (mut master, drive) = (master(&bus), &bus.drives[0]);
    turn_to(drive, 30.0);
    let timeout = Milliseconds::from_raw(100);
    master.ask(MOTOR, CommunicationLossProtection { timeout }).unwrap();

    // The first after 0.1 s, then one a second.
    let heard = listen(&mut master, millis(10_150));
    assert_eq!(heard, [Event::LostMaster { motor: MOTOR }; 11]);

    // The master repeats a harmless command on its own. The caller does not notice.
    happened(drive);
    let angle_deg = master.ask(MOTOR, ReadMultiTurnAngle).unwrap().angle.degrees();
    assert!((angle_deg - 30.0).abs() < 0.1, "{angle_deg}");
    let not_run = |opcode| Happened::NotRun { opcode, reason: NotRunReason::CommunicationLost };
    assert_eq!(
        happened(drive),
        [not_run(Opcode::ReadMultiTurnAngle), Happened::ProtectionRecovered]
    );

    // A command that moves the motor is left to the caller to repeat, before the next 0xF1.
    for _ in 0..2 {
        listen(&mut master, millis(1_150));
        happened(drive);
        assert_eq!(
            master.ask(MOTOR, push(2.0)),
            Err(CallError::Failed { motor: MOTOR, failure: Failure::NotExecuted })
        );
        assert_eq!(happened(drive), [not_run(Opcode::Torque)]);
        assert!(!state(drive).output_on);
    }
    master.ask(MOTOR, push(2.0)).unwrap();
    assert!(state(drive).output_on);

    // In a stream the next set-point takes effect.
    listen(&mut master, millis(300));
    assert!(!state(drive).output_on);
    let mut streamed = Vec::new();
    for _ in 0..2 {
        master.set_point(MOTOR, turn(90.0)).unwrap();
        streamed.extend(listen(&mut master, millis(20)));
    }
    assert!(
        matches!(
            streamed[..],
            [Event::SetPointUnanswered { motor: MOTOR }, Event::Feedback { motor: MOTOR, .. }]
        ),
        "{streamed:?}"
    );
    assert!(state(drive).output_on);
}

// ---- to all ----

/// The drives that a master hears, of this many, if it asks all of them at once at this bit rate.
fn answers_to_all(count: u8, bit_rate: u32, broadcast_slots: bool) -> MotorSet {
    let quirks = Quirks { broadcast_slots, ..Quirks::default() };
    let bus = Fleet::new(count).quirks(quirks).on_rs485(bit_rate).unwrap();
    // At 115200 the last of eight replies comes after some 12 ms.
    let config = Config { reply_timeout: millis(20), ..Config::rs485(bit_rate, false) };
    let (mut master, _) = Rs485Line::runner::<8>(&bus.world, config);
    let all = MotorId::all().take(count.into()).collect();
    master.master().broadcast(ReadMultiTurnEncoder, all).unwrap();
    let answers = listen(&mut master, millis(30)).into_iter().filter_map(|event| match event {
        Event::BroadcastReply { motor, .. } => Some(motor),
        _ => None,
    });
    answers.collect()
}

/// 6.2 shows the replies of four motors to 0xCD 0x60.
#[test]
fn answers_to_all_come_whole_if_drives_wait_for_their_turn() {
    for bit_rate in [115_200, 1_000_000] {
        for count in [4, 8] {
            let all = MotorId::all().take(count.into()).collect();
            assert_eq!(answers_to_all(count, bit_rate, true), all, "{bit_rate}");
            assert_ne!(answers_to_all(count, bit_rate, false), all, "{bit_rate}");
        }
    }
}

// ---- memory ----

/// 2.2.1 and 2.3.1: what is written to RAM is lost with the supply, what is written to ROM is not.
fn memory_in_files_outlives_the_fleet<W: Wire>() {
    let folder = tempfile::tempdir().unwrap();
    let fleet = Fleet::new(2).memory_folder(folder.path());
    let (first, second) = (0.25, 0.5);
    let at_factory = {
        let bus = W::drives(&fleet).unwrap();
        let mut master = master(&bus);
        let at_factory = read_speed_kp(&mut master);
        let index = PidIndex::SPEED_KP;
        master.ask(MOTOR, WritePidRom { index, value: gain(first) }).unwrap();
        master.ask(MOTOR, WritePidRam { index, value: gain(second) }).unwrap();
        assert_eq!(read_speed_kp(&mut master), second);
        at_factory
    };
    let bus = W::drives(&fleet).unwrap();
    let mut master = master(&bus);
    assert_eq!(read_speed_kp(&mut master), first);
    // Each drive has a memory of its own.
    let other = master.ask(id(2), ReadPid { index: PidIndex::SPEED_KP }).unwrap();
    assert_eq!(other.value.value(), at_factory);

    // A damaged memory is reported. Its contents are not guessed.
    for file in std::fs::read_dir(folder.path()).unwrap() {
        std::fs::write(file.unwrap().path(), "nonsense").unwrap();
    }
    assert!(matches!(W::drives(&fleet), Err(FleetError::Memory(_))));
}

// ---- reports ----

/// Function 3 (2.35.4): "0x9A by itself every 100 ms while an error lasts".
fn errors_are_reported_while_they_last<W: Wire>() {
    let bus: BusFleet<W> = quirky(Quirks::default());
    let (mut master, drive) = (master(&bus), &bus.drives[0]);
    let switch = |on| FunctionControl::ErrorReporting(Switch::from_bool(on));

    // While reporting is off, the drive is silent.
    drive.with(|drive| drive.raise_fault(ErrorFlags::OVER_VOLTAGE));
    assert_eq!(listen(&mut master, millis(500)), []);

    // The first report comes at once, before the reply to this command.
    let mut heard = Vec::new();
    master.ask_with(MOTOR, switch(true), None, |event| heard.push(event)).unwrap();
    heard.extend(listen(&mut master, millis(950)));
    assert_eq!(heard.len(), 10, "{heard:?}");
    for event in heard {
        match event {
            Event::Report { motor: MOTOR, reply: AnyReply::ReadStatus1(status) } => {
                assert_eq!(status.errors, ErrorFlags::OVER_VOLTAGE);
            }
            other => panic!("{other:?}"),
        }
    }
    drive.with(|drive| drive.clear_fault(ErrorFlags::OVER_VOLTAGE));
    assert_eq!(listen(&mut master, millis(500)), []);
    drive.with(|drive| drive.raise_fault(ErrorFlags::UNDER_VOLTAGE));
    assert!(!listen(&mut master, millis(50)).is_empty());
    master.ask(MOTOR, switch(false)).unwrap();
    assert_eq!(listen(&mut master, millis(500)), []);
}

// ---- faults ----

/// Makes a quantity bad, or good again.
type Force = fn(&mut SimulatedMotor, bool);

fn warm(too_warm: bool) -> Option<f64> {
    Some(if too_warm { 120.0 } else { 40.0 })
}

/// 8.1: level two, "the motor recovers to normal operation by itself once the conditions are met".
fn physical_errors_of_level_two_recover<W: Wire>() {
    // The bits of 2.14.3. The model runs from 24 to 55 V.
    let causes: [(u16, Force); 4] = [
        (0x0004, |motor, bad| motor.force_supply_voltage_v(bad.then_some(15.0)).unwrap()),
        (0x0008, |motor, bad| motor.force_supply_voltage_v(bad.then_some(60.0)).unwrap()),
        (0x1000, |motor, bad| motor.force_motor_temperature_c(warm(bad)).unwrap()),
        (0x0800, |motor, bad| motor.force_mos_temperature_c(warm(bad)).unwrap()),
    ];
    for (bit, force) in causes {
        let bus = W::drives(&Fleet::new(1).brakes(true)).unwrap();
        let (mut master, drive) = (master(&bus), &bus.drives[0]);
        master.ask(MOTOR, turn(90.0)).unwrap();
        listen(&mut master, millis(100));
        assert_eq!(read_errors(&mut master), ErrorFlags::empty());

        drive.with(|drive| force(drive.plant_mut(), true));
        listen(&mut master, millis(100));
        let status = master.ask(MOTOR, ReadStatus1).unwrap();
        assert_eq!(status.errors.bits(), bit, "{}", status.errors);
        match bit {
            0x0004 => assert_eq!(status.voltage.volts(), 15.0),
            0x0008 => assert_eq!(status.voltage.volts(), 60.0),
            0x1000 => assert_eq!(status.temperature.celsius(), 120.0),
            _ => assert_eq!(status.mosfet_temperature.celsius(), 120.0),
        }
        let State { output_on, brake, indicator, .. } = state(drive);
        let expected = (false, BrakeCommand::LOCK, Indicator::SlowBlink);
        assert_eq!((output_on, brake, indicator), expected, "{}", status.errors);
        happened(drive);
        master.ask(MOTOR, turn(90.0)).unwrap();
        let reason = NotRunReason::Fault(status.errors);
        assert_eq!(happened(drive), [Happened::NotRun { opcode: Opcode::Speed, reason }]);
        listen(&mut master, millis(1_000));
        assert!(!state(drive).output_on, "{}", status.errors);

        drive.with(|drive| force(drive.plant_mut(), false));
        listen(&mut master, millis(100));
        let now = read_errors(&mut master);
        assert_eq!(now, ErrorFlags::empty(), "after {}", status.errors);
        assert_eq!(state(drive).indicator, Indicator::On);
        // A motor that goes on on its own may hurt someone.
        listen(&mut master, millis(1_000));
        assert!(!state(drive).output_on && state(drive).measurement.speed_dps.abs() < 1.0);
        master.ask(MOTOR, turn(90.0)).unwrap();
        listen(&mut master, millis(200));
        assert!(state(drive).measurement.speed_dps > 80.0);
    }
}

/// 8.1: level one, "the motor cannot recover; check it and restart it". An encoder that was wrong once is not trusted
/// until a restart.
fn physical_errors_of_level_one_need_a_restart<W: Wire>() {
    let bus: BusFleet<W> = quirky(Quirks::default());
    let (mut master, drive) = (master(&bus), &bus.drives[0]);
    drive.with(|drive| drive.plant_mut().set_encoder_fault(true));
    listen(&mut master, millis(100));
    let broken = read_errors(&mut master);
    assert_eq!(broken, ErrorFlags::ENCODER_DATA);
    drive.with(|drive| drive.plant_mut().set_encoder_fault(false));
    listen(&mut master, millis(1_000));
    assert_eq!(read_errors(&mut master), broken);
    master.ask(MOTOR, Reset).unwrap();
    bring_up::wait_until_there(&mut master, MOTOR, Duration::from_secs(5)).unwrap();
    assert_eq!(read_errors(&mut master), ErrorFlags::empty());
}
