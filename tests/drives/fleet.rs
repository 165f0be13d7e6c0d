//! Whole drives on whole buses, as their master sees them: quirks, faults, memory, broadcasts and
//! reports, on CAN and RS485, under the virtual clock.

use std::fmt::Debug;

use myactuator_host_std::sim::plant::SimulatedMotor;
use myactuator_host_std::sim::{CanFleet, Fleet, FleetError};
use myactuator_protocol_core::command::{
    ActiveReply, AnyReply, BrakeCommand, CommunicationLossProtection, ErrorFlags, FunctionControl,
    PidIndex, ReadModel, ReadMultiTurnAngle, ReadPid, ReadRunningMode, ReadStatus1, ReadStatus2,
    ReleaseBrake, ReportedCommand, Reset, Shutdown, Stop, Switch, WritePidRam, WritePidRom,
};
use myactuator_protocol_core::drive::{Event as Happened, NotRunReason, Quirks};
use myactuator_protocol_core::error::RequestError;
use myactuator_protocol_core::io::{CallError, Runner, bring_up};
use myactuator_protocol_core::master::{Event, Failure, MotorSet};
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::{Milliseconds, ReportInterval};
use myactuator_protocol_core::{MotorId, Opcode};
use myactuator_tests::fleet::{Bus, Master, angle_deg, happened, speed_dps, state, turn_to};
use myactuator_tests::listen::{listen, listen_until};
use myactuator_tests::on_both_buses;
use myactuator_tests::values::{gain, go_to, id, millis, push, turn};

const MOTOR: MotorId = MotorId::MIN;

on_both_buses! {
    a_slow_boot_is_waited_out
    a_slow_brake_holds_the_shaft_for_a_while
    after_a_lost_master_the_first_command_does_nothing
    a_silent_id_change_acts_all_the_same
    rom_may_need_a_shutdown
    turns_may_be_lost
    memory_in_files_outlives_the_fleet
    errors_are_reported_while_they_last
    a_fault_stops_the_motor_and_every_control_command
    physical_errors_of_level_two_recover
    physical_errors_of_level_one_need_a_restart
}

fn quirky<B: Bus>(quirks: Quirks) -> B {
    B::with(&Fleet::new(1).quirks(quirks)).unwrap()
}

fn rom_speed_kp(value: f32) -> WritePidRom {
    WritePidRom { index: PidIndex::SPEED_KP, value: gain(value) }
}

fn is_unanswered<T, E>(result: &Result<T, CallError<E>>) -> bool {
    matches!(result, Err(CallError::Failed(Failure::NoReply)))
}

fn read_speed_kp<R: Runner<8, Error: Debug>>(master: &mut R) -> f32 {
    master.ask(MOTOR, ReadPid { index: PidIndex::SPEED_KP }).unwrap().value.value()
}

fn read_angle<R: Runner<8, Error: Debug>>(master: &mut R) -> f64 {
    master.ask(MOTOR, ReadMultiTurnAngle).unwrap().angle.degrees().into()
}

fn read_errors<R: Runner<8, Error: Debug>>(master: &mut R) -> ErrorFlags {
    master.ask(MOTOR, ReadStatus1).unwrap().errors
}

fn restart<R: Runner<8, Error: Debug>>(master: &mut R, then: MotorId) {
    master.call(MOTOR, Reset).unwrap();
    bring_up::wait_until_there(master, then, Duration::from_secs(5)).unwrap();
}

/// 0xB6 for 0x9C.
fn report_status2(enable: Switch, interval_ms: f32) -> ActiveReply {
    let interval = ReportInterval::from_millis(interval_ms).unwrap();
    ActiveReply { command: ReportedCommand::of(Opcode::ReadStatus2).unwrap(), enable, interval }
}

// ---- quirks ----

/// "0x76: about 1.1 s until the drive answers again".
fn a_slow_boot_is_waited_out<B: Bus>() {
    let bus: B = quirky(Quirks { slow_boot: true, ..Quirks::default() });
    let mut hasty = bus.hasty_master();
    let boots_since = |hasty: &mut Master<B>| {
        let from = hasty.now();
        assert!(is_unanswered(&hasty.call(MOTOR, ReadStatus1)));
        bring_up::wait_until_there(hasty, MOTOR, Duration::from_secs(5)).unwrap();
        let took = hasty.now() - from;
        assert!((millis(1_090)..millis(1_200)).contains(&took), "{took}");
    };
    boots_since(&mut hasty); // from power-on
    hasty.call(MOTOR, Reset).unwrap();
    boots_since(&mut hasty);

    // A master that leaves the motor alone loses nothing.
    let mut master = bus.master();
    master.call(MOTOR, Reset).unwrap();
    master.ask(MOTOR, ReadStatus1).unwrap();
    assert_eq!(master.master().health(MOTOR).lost, 0);

    // Without the quirk it answers at once.
    let bus: B = quirky(Quirks::default());
    let mut hasty = bus.hasty_master();
    hasty.call(MOTOR, Reset).unwrap();
    listen(&mut hasty, millis(1));
    hasty.ask(MOTOR, ReadStatus1).unwrap();
    assert_eq!(hasty.master().health(MOTOR).lost, 0);
}

/// "0x77: 50 to 150 ms mechanical".
fn a_slow_brake_holds_the_shaft_for_a_while<B: Bus>() {
    // Where the shaft is 45 and 175 ms after the brake was told to open, under torque all along.
    let moved = |slow_brake, seed| {
        let quirks = Quirks { slow_brake, ..Quirks::default() };
        let bus = B::with(&Fleet::new(1).quirks(quirks).brakes(true).seed(seed)).unwrap();
        let (mut master, drive) = (bus.master(), &bus.drives()[0]);
        master.ask(MOTOR, ReleaseBrake).unwrap();
        let told = master.now();
        master.ask(MOTOR, push(3.0)).unwrap();
        // It says so at once: what it tells is the command, not the brake's state.
        assert_eq!(master.ask(MOTOR, ReadStatus1).unwrap().brake, BrakeCommand::RELEASE);
        [45, 175].map(|after| {
            listen_until(&mut master, told + millis(after));
            angle_deg(drive)
        })
    };
    for seed in 1..=5 {
        let [early, late] = moved(true, seed);
        assert!(early.abs() < 0.1, "seed {seed}: {early}");
        assert!(late > 0.1, "seed {seed}: {late}");
    }
    // 3 A are 8 N·m or so, on 0.03 kg·m²: some 250 rad/s².
    let [early, _] = moved(false, 1);
    assert!(early > 5.0, "{early}");

    // The library waits for it.
    let quirks = Quirks { slow_brake: true, ..Quirks::default() };
    let bus = B::with(&Fleet::new(1).quirks(quirks).brakes(true)).unwrap();
    let mut master = bus.master();
    bring_up::release_brake(&mut master, MOTOR).unwrap();
    master.ask(MOTOR, push(3.0)).unwrap();
    listen(&mut master, millis(30));
    assert!(angle_deg(&bus.drives()[0]) > 2.0);
}

/// "A drive that lost its master sends frames with 0xF1 and no data, once a second; the first command
/// after that is echoed and ignored, the second works if it comes in time".
fn after_a_lost_master_the_first_command_does_nothing<B: Bus>() {
    let bus: B = quirky(Quirks { lost_master_heartbeat: true, ..Quirks::default() });
    let (mut master, drive) = (bus.master(), &bus.drives()[0]);
    turn_to(drive, 30.0);
    let timeout = Milliseconds::from_raw(100);
    master.ask(MOTOR, CommunicationLossProtection { timeout }).unwrap();

    // The first after 0.1 s, then one a second.
    let told = listen(&mut master, millis(2_500));
    assert_eq!(told, [Event::LostMaster { motor: MOTOR }; 3]);

    // What does no harm is sent again by the master: the caller sees nothing of it.
    happened(drive);
    assert!((read_angle(&mut master) - 30.0).abs() < 0.1);
    let not_run = |opcode| Happened::NotRun { opcode, reason: NotRunReason::CommunicationLost };
    assert_eq!(
        happened(drive),
        [not_run(Opcode::ReadMultiTurnAngle), Happened::ProtectionRecovered]
    );

    // What moves the motor is the caller's to repeat.
    listen(&mut master, millis(300));
    happened(drive);
    assert_eq!(master.ask(MOTOR, push(2.0)), Err(CallError::Failed(Failure::NotExecuted)));
    assert_eq!(happened(drive), [not_run(Opcode::Torque)]);
    assert!(!state(drive).output_on);
    master.ask(MOTOR, push(2.0)).unwrap();
    assert!(state(drive).output_on);

    // In a stream the next set-point does.
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

/// "Setting the id with function 5 was seen to give no reply, and needs 0x76".
fn a_silent_id_change_acts_all_the_same<B: Bus>() {
    for silent_id_change in [false, true] {
        let bus: B = quirky(Quirks { silent_id_change, ..Quirks::default() });
        let mut master = bus.hasty_master();
        // The master does not wait for an echo that may not come.
        assert_eq!(master.call(MOTOR, FunctionControl::SetCanId(id(5))), Ok(None));
        // Function 5 takes effect after a restart (2.35.4).
        master.ask(MOTOR, ReadModel).unwrap();
        restart(&mut master, id(5));
        master.ask(id(5), ReadModel).unwrap();
        assert!(is_unanswered(&master.call(MOTOR, ReadModel)));
    }
}

/// "ROM writes (0x20, 0x32, 0xB4) may only take while the motor is shut down (0x80)".
fn rom_may_need_a_shutdown<B: Bus>() {
    for rom_needs_shutdown in [false, true] {
        let bus: B = quirky(Quirks { rom_needs_shutdown, ..Quirks::default() });
        let mut master = bus.hasty_master();
        let before = read_speed_kp(&mut master);
        let first = rom_speed_kp(before * 1.5);
        master.ask(MOTOR, turn(90.0)).unwrap();
        // It says yes in any case.
        assert_eq!(master.ask(MOTOR, first).unwrap(), first);
        let expected = if rom_needs_shutdown { before } else { first.value.value() };
        assert_eq!(read_speed_kp(&mut master), expected);

        master.ask(MOTOR, Shutdown).unwrap();
        let second = rom_speed_kp(before * 2.0);
        master.ask(MOTOR, second).unwrap();
        assert_eq!(read_speed_kp(&mut master), second.value.value());
        restart(&mut master, MOTOR);
        assert_eq!(read_speed_kp(&mut master), second.value.value());
    }
}

/// "After power-on or 0x76 the multi-turn angle comes back within ±180 degrees, unless multi-turn
/// saving (function 4) is on"; some drives lose the turns even then.
fn turns_may_be_lost<B: Bus>() {
    for (save, turns_lost, expected) in
        [(true, false, 750.0), (true, true, 30.0), (false, false, 30.0)]
    {
        let bus: B = quirky(Quirks { turns_lost, ..Quirks::default() });
        let mut master = bus.hasty_master();
        let save = Switch::from_bool(save);
        master.ask(MOTOR, FunctionControl::SaveMultiTurn(save)).unwrap();
        restart(&mut master, MOTOR);
        // Turned by hand, by two turns and 30 degrees.
        turn_to(&bus.drives()[0], 750.0);
        listen(&mut master, millis(20));
        let found = read_angle(&mut master);
        assert!((found - 750.0).abs() < 0.1, "{found}");
        restart(&mut master, MOTOR);
        let found = read_angle(&mut master);
        assert!((found - expected).abs() < 0.1, "{save:?}, {turns_lost}: {found}");
    }
}

/// "While active reply (0xB6) is on, a poll of that command gets no answer" (2.34.1 says the same).
#[test]
fn what_is_reported_actively_is_not_answered() {
    let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
    let (mut master, mut stranger) = (Bus::master(&fleet), Bus::master(&fleet));
    assert_eq!(master.call(MOTOR, report_status2(Switch::On, 20.0)).unwrap(), None);
    let told = listen(&mut master, millis(210));
    assert_eq!(told.len(), 10);
    let is_status2 = |event: &Event| {
        matches!(event, Event::Report { motor: MOTOR, reply: AnyReply::ReadStatus2(_) })
    };
    assert!(told.iter().all(is_status2), "{told:?}");

    // A master that has switched it on knows. Everything else is answered.
    let refused = RequestError::Reported(Opcode::ReadStatus2);
    assert_eq!(master.call(MOTOR, ReadStatus2), Err(CallError::Request(refused)));
    master.ask(MOTOR, ReadStatus1).unwrap();

    // One that does not know gets no answer (between two reports).
    master.call(MOTOR, report_status2(Switch::On, 1_000.0)).unwrap();
    listen(&mut stranger, millis(100));
    assert!(is_unanswered(&stranger.call(MOTOR, ReadStatus2)));

    master.call(MOTOR, report_status2(Switch::Off, 1_000.0)).unwrap();
    listen(&mut master, millis(100));
    master.ask(MOTOR, ReadStatus2).unwrap();
    assert_eq!(listen(&mut master, millis(2_000)), []);
    stranger.ask(MOTOR, ReadStatus2).unwrap();
}

/// 0xB6 is "for the CAN bus only" (2.34.1).
#[test]
fn there_are_no_active_replies_on_rs485() {
    let fleet = Fleet::new(1).on_rs485(1_000_000).unwrap();
    let refused = Bus::master(&fleet).call(MOTOR, report_status2(Switch::On, 20.0));
    let expected = RequestError::CanOnly(Opcode::ActiveReply);
    assert_eq!(refused, Err(CallError::Request(expected)));
}

// ---- memory ----

/// 2.2.1 and 2.3.1: what is written to RAM is lost with the supply, what is written to ROM is not.
fn memory_in_files_outlives_the_fleet<B: Bus>() {
    let folder = tempfile::tempdir().unwrap();
    let fleet = Fleet::new(2).memory_folder(folder.path());
    let (first, second) = (0.25, 0.5);
    let at_factory = {
        let bus = B::with(&fleet).unwrap();
        let mut master = bus.master();
        let at_factory = read_speed_kp(&mut master);
        master.ask(MOTOR, rom_speed_kp(first)).unwrap();
        let to_ram = WritePidRam { index: PidIndex::SPEED_KP, value: gain(second) };
        master.ask(MOTOR, to_ram).unwrap();
        assert_eq!(read_speed_kp(&mut master), second);
        at_factory
    };
    let bus = B::with(&fleet).unwrap();
    let mut master = bus.master();
    assert_eq!(read_speed_kp(&mut master), first);
    // Each drive has a memory of its own.
    let other = master.ask(id(2), ReadPid { index: PidIndex::SPEED_KP }).unwrap();
    assert_eq!(other.value.value(), at_factory);

    // A damaged memory is told, not guessed at.
    for file in std::fs::read_dir(folder.path()).unwrap() {
        std::fs::write(file.unwrap().path(), "nonsense").unwrap();
    }
    assert!(matches!(B::with(&fleet), Err(FleetError::Memory(_))));
}

// ---- broadcasts and reports ----

/// Function 2 (2.35.4): the filter must be off for the broadcast 0x280 to be received; kept over
/// power-off.
#[test]
fn a_broadcast_reaches_those_whose_id_filter_is_off() {
    let fleet = Fleet::new(3).on_can(1_000_000).unwrap();
    let mut master = fleet.hasty_master();
    let all: MotorSet = [1, 2, 3].map(id).into_iter().collect();
    let ask_all = |master: &mut Master<CanFleet>| {
        let now = master.now();
        master.master().broadcast(ReadStatus1, all, now).unwrap();
        let (mut answered, mut silent) = (MotorSet::EMPTY, None);
        for event in listen(master, millis(100)) {
            match event {
                Event::BroadcastReply { motor, reply: AnyReply::ReadStatus1(_) } => {
                    answered.insert(motor);
                }
                Event::BroadcastDone { silent: these } => silent = Some(these),
                other => panic!("{other:?}"),
            }
        }
        assert_eq!(silent, Some(all.without(answered)));
        answered
    };
    assert_eq!(ask_all(&mut master), all);
    master.ask(id(2), FunctionControl::CanIdFilter(Switch::On)).unwrap();
    assert_eq!(ask_all(&mut master), all.without(id(2).into()));
    master.call(id(2), Reset).unwrap();
    bring_up::wait_until_there(&mut master, id(2), Duration::from_secs(1)).unwrap();
    assert_eq!(ask_all(&mut master), all.without(id(2).into()));

    // Nor does it hear anything else that goes to all.
    for motor in all.iter() {
        master.ask(motor, turn(90.0)).unwrap();
    }
    let now = master.now();
    master.master().broadcast(Shutdown, all, now).unwrap();
    listen(&mut master, millis(50));
    let still_on: Vec<bool> = fleet.drives.iter().map(|drive| state(drive).output_on).collect();
    assert_eq!(still_on, [false, true, false]);

    master.ask(id(2), FunctionControl::CanIdFilter(Switch::Off)).unwrap();
    assert_eq!(ask_all(&mut master), all);
}

/// Function 3 (2.35.4): "0x9A by itself every 100 ms while an error lasts".
fn errors_are_reported_while_they_last<B: Bus>() {
    let bus: B = quirky(Quirks::default());
    let (mut master, drive) = (bus.master(), &bus.drives()[0]);
    let switch = |on| FunctionControl::ErrorReporting(Switch::from_bool(on));

    // Off, it says nothing.
    drive.with(|drive| drive.raise_fault(ErrorFlags::OVER_VOLTAGE));
    assert_eq!(listen(&mut master, millis(500)), []);

    // The first at once, before the reply to this.
    let mut told = Vec::new();
    master.call_with(MOTOR, switch(true), None, |event| told.push(event)).unwrap();
    told.extend(listen(&mut master, millis(950)));
    assert_eq!(told.len(), 10, "{told:?}");
    for event in told {
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

/// 2.19.1 and after: control commands run "while the motor has no fault".
fn a_fault_stops_the_motor_and_every_control_command<B: Bus>() {
    let bus = B::with(&Fleet::new(1).brakes(true)).unwrap();
    let (mut master, drive) = (bus.hasty_master(), &bus.drives()[0]);
    master.ask(MOTOR, turn(90.0)).unwrap();
    listen(&mut master, millis(200));
    assert!(speed_dps(drive) > 80.0);

    drive.with(|drive| drive.raise_fault(ErrorFlags::STALL));
    listen(&mut master, millis(100));
    let status = master.ask(MOTOR, ReadStatus1).unwrap();
    assert_eq!(status.errors.bits(), 0x0002); // 2.14.3
    assert_eq!(status.brake, BrakeCommand::LOCK);
    let stopped_at = angle_deg(drive);

    // All are answered, and nothing moves.
    happened(drive);
    master.ask(MOTOR, push(3.0)).unwrap();
    master.ask(MOTOR, turn(90.0)).unwrap();
    master.ask(MOTOR, go_to(720.0, 500)).unwrap();
    master.ask(MOTOR, ReleaseBrake).unwrap();
    master.ask(MOTOR, push(3.0)).unwrap();
    master.ask(MOTOR, Stop).unwrap();
    listen(&mut master, millis(300));
    let not_run =
        [Opcode::Torque, Opcode::Speed, Opcode::AbsolutePosition, Opcode::Torque, Opcode::Stop];
    let reason = NotRunReason::Fault(ErrorFlags::STALL);
    assert_eq!(happened(drive), not_run.map(|opcode| Happened::NotRun { opcode, reason }));
    assert!((angle_deg(drive) - stopped_at).abs() < 0.01);
    assert!(!state(drive).output_on);
    master.ask(MOTOR, ReadRunningMode).unwrap();

    // Level one does not go by itself, nor when its cause does (8.1).
    drive.with(|drive| drive.clear_fault(ErrorFlags::STALL));
    assert_eq!(read_errors(&mut master), ErrorFlags::STALL);
    restart(&mut master, MOTOR);
    assert_eq!(read_errors(&mut master), ErrorFlags::empty());
    master.ask(MOTOR, turn(90.0)).unwrap();
    listen(&mut master, millis(200));
    assert!(angle_deg(drive) > stopped_at + 5.0);
}

/// Makes a quantity what it must not be, or what it was.
type Force = fn(&mut SimulatedMotor, bool);

fn warm(too_warm: bool) -> Option<f64> {
    Some(if too_warm { 120.0 } else { 40.0 })
}

/// 8.1: level two, "the motor recovers to normal operation by itself once the conditions are met".
fn physical_errors_of_level_two_recover<B: Bus>() {
    // The bits of 2.14.3. The model runs from 24 to 55 V.
    let causes: [(u16, Force); 4] = [
        (0x0004, |motor, bad| motor.force_supply_voltage_v(bad.then_some(15.0)).unwrap()),
        (0x0008, |motor, bad| motor.force_supply_voltage_v(bad.then_some(60.0)).unwrap()),
        (0x1000, |motor, bad| motor.force_motor_temperature_c(warm(bad)).unwrap()),
        (0x0800, |motor, bad| motor.force_mos_temperature_c(warm(bad)).unwrap()),
    ];
    for (bit, force) in causes {
        let bus: B = quirky(Quirks::default());
        let (mut master, drive) = (bus.master(), &bus.drives()[0]);
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
        master.ask(MOTOR, turn(90.0)).unwrap();
        listen(&mut master, millis(1_000));
        assert!(!state(drive).output_on, "{}", status.errors);

        drive.with(|drive| force(drive.plant_mut(), false));
        listen(&mut master, millis(100));
        let now = read_errors(&mut master);
        assert_eq!(now, ErrorFlags::empty(), "after {}", status.errors);
        // A motor that goes on by itself may hurt someone.
        listen(&mut master, millis(1_000));
        assert!(speed_dps(drive).abs() < 1.0);
        master.ask(MOTOR, turn(90.0)).unwrap();
        listen(&mut master, millis(200));
        assert!(speed_dps(drive) > 80.0);
    }
}

/// 8.1: level one, "the motor cannot recover; check it and restart it". An encoder that was wrong once
/// is not trusted again.
fn physical_errors_of_level_one_need_a_restart<B: Bus>() {
    let bus: B = quirky(Quirks::default());
    let (mut master, drive) = (bus.hasty_master(), &bus.drives()[0]);
    drive.with(|drive| drive.plant_mut().set_encoder_fault(true));
    listen(&mut master, millis(100));
    let broken = read_errors(&mut master);
    assert_eq!(broken, ErrorFlags::ENCODER_DATA);
    drive.with(|drive| drive.plant_mut().set_encoder_fault(false));
    listen(&mut master, millis(1_000));
    assert_eq!(read_errors(&mut master), broken);
    restart(&mut master, MOTOR);
    assert_eq!(read_errors(&mut master), ErrorFlags::empty());
}
