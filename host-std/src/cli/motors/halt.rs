//! `myactuator stop` and `myactuator shutdown`: they must work without thinking.
//!
//! They ask the user nothing and do not scan first. The command goes to every id; on RS485 it goes to all at once, and
//! then to each motor that answers. Motors that confirm are reported. The exit status is 0 if all of this is so, else
//! 1:
//!
//! - The motor has confirmed; if all are meant, at least one has.
//! - The bus has carried the command to all that were meant.
//! - None of them goes on moving.
//! - None that was to hold still is known to hold nothing, or may hold nothing.

use myactuator_protocol_core::command::{ReadStatus1, ReadStatus2};
use myactuator_protocol_core::io::{CallError, Runner};
use myactuator_protocol_core::master::{Bus, MotorSet, StopKind};
use myactuator_protocol_core::{MotorId, Target};

use super::moving::{LONGEST_OUTAGE, LONGEST_WAIT, OFF, named};
use super::session::{Motors, Session, say};
use super::together::Together;
use crate::cli::{Outcome, Unfinished};

/// How often the stop to all is sent on a line: as often as a single motor is sent a stop that it does not confirm.
const STOPS_OF_LINE: usize = 15;
/// How often ids that do not answer are asked on a line.
const ROUNDS: usize = 3;

pub(super) fn stop(arguments: &Motors) -> Outcome {
    let mut session = Session::open_to_stop(&arguments.on)?;
    let motors = halt(&mut session, arguments.id, StopKind::Hold)?;
    let stopped = session.stopped(motors);
    let others = of_others(&session, arguments.id, motors);
    match stopped {
        Ok(told) => say(&format!("{told}{others}")),
        Err(Unfinished::Failed(told)) => Err(Unfinished::Failed(format!("{told}{others}"))),
        Err(other) => Err(other),
    }
}

pub(super) fn shut_down(arguments: &Motors) -> Outcome {
    let mut session = Session::open_to_stop(&arguments.on)?;
    let motors = halt(&mut session, arguments.id, StopKind::Off)?;
    session.are_left_alone(motors)?;
    let are = match motors.len() {
        1 => OFF,
        _ => "are off (0x80): their shafts are free unless brakes hold them",
    };
    say(&format!("{} {are}{}", named(motors), of_others(&session, arguments.id, motors)))
}

/// What a stop of all cannot know: a motor that never confirms looks like an id without a motor.
fn of_others(session: &Session, meant: Target, confirmed: MotorSet) -> String {
    if meant != Target::All || confirmed == MotorSet::ALL {
        return String::new();
    }
    let garbled = session.garbled();
    format!("; no other id has confirmed{garbled}: a motor that is not named here may go on")
}

/// Stops these motors. Returns those that have confirmed.
pub(super) fn halt(session: &mut Session, meant: Target, kind: StopKind) -> Outcome<MotorSet> {
    if let Target::Motor(motor) = meant {
        session.confirm_stop(kind, motor.into())?;
        session.stop_what_moves(kind, motor.into())?;
        return Ok(motor.into());
    }
    let stopped = stop_every_id(session, kind)?;
    // The others are not waited for any more.
    forget(session, MotorSet::ALL.without(stopped));
    session.stop_what_moves(kind, stopped)?;
    Ok(stopped)
}

/// Stops every id. On CAN each id is sent its own stop, all at the same time. On RS485 the wait for ids without a motor
/// would keep the line busy: so the stop to all goes first, and then each motor that answers is sent its own.
fn stop_every_id(session: &mut Session, kind: StopKind) -> Outcome<MotorSet> {
    if kind == StopKind::Off {
        session.master.off = MotorSet::ALL;
    }
    // The result of an earlier stop says nothing about this one.
    (session.master.confirmed, session.master.silent) = (MotorSet::EMPTY, MotorSet::EMPTY);
    let on_line = matches!(session.master.master().config().bus, Bus::Rs485 { .. });
    let mut outage = None;
    let mut meant = MotorSet::ALL;
    if on_line {
        session.tell_all(|session| stop_line(session, kind));
        (meant, outage) = find_on_line(session);
    }
    if outage.is_none() {
        // A stop to all goes before it.
        outage = session.tell_all(|session| stop_each(session, kind, meant));
    }
    let confirmed = session.master.confirmed;
    // On CAN every id is meant: an id that was heard is a motor, and a silent one looks like none.
    let master = session.master.master();
    let is_there = |motor: &MotorId| on_line || master.health(*motor).last_seen.is_some();
    let silent: MotorSet = meant.without(confirmed).iter().filter(is_there).collect();
    if silent.is_empty() && outage.is_none() && !confirmed.is_empty() {
        return Ok(confirmed);
    }
    let others = match outage {
        None if !silent.is_empty() => named(silent),
        _ => "the others".to_owned(),
    };
    let why = outage.map(|why| format!("{why}; ")).unwrap_or_default();
    let (echo, other_rates) = (session.echo_told_of(), session.other_rates());
    let address = &session.address;
    Err(Unfinished::Failed(if confirmed.is_empty() {
        format!(
            "{why}no confirmation of the stop from any motor{}: if one is on {address}, cut its power; then check the \
             wiring and the bit rate ({other_rates}){echo}",
            session.garbled(),
        )
    } else {
        format!(
            "{why}the stop is confirmed by {} only: cut the power of {others} on {address}",
            named(confirmed),
        )
    }))
}

fn forget(session: &mut Session, motors: MotorSet) {
    for motor in motors.iter() {
        session.master.master().forget(motor);
    }
}

/// Sends the stop to all on a line. No motor confirms it, and it takes hardly any time: it is repeated, so that some
/// frames may be lost.
fn stop_line(session: &mut Session, kind: StopKind) {
    for _ in 0..STOPS_OF_LINE {
        // Without the lift it would be sent only once. Where motors are known, as to `send`, it goes only every 100 ms,
        // beside the stop of each. There is a place for all.
        session.master.master().lift_stop();
        let _ = session.master.master().stop_all(kind, MotorSet::EMPTY);
        while session.master.master().is_stop_to_all_waiting() {
            let has_failed = session.master.poll().is_err();
            let soon = session.master.now() + LONGEST_WAIT;
            session.master.idle(soon);
            if has_failed {
                // It may have been sent all the same. The next one is tried in any case.
                break;
            }
        }
    }
    // All motors answer the last one at once.
    let settled = session.master.now() + session.master.master().config().reply_timeout;
    let _ = session.master.run_until(settled, |_| {});
}

/// Returns the motors that answer on a line, and why it carries nothing, if so. Asks all motors repeatedly, so that a
/// short communication-loss protection does not let a load go.
fn find_on_line(session: &mut Session) -> (MotorSet, Option<String>) {
    let begun = session.master.awake();
    let mut found = MotorSet::EMPTY;
    let mut rounds = 0;
    loop {
        let patience = session.master.master().patience(1);
        // This is the first read: it also finds out whether the adapter echoes.
        let Together { outcomes, failure } =
            session.ask_each(MotorSet::ALL, ReadStatus1, Some(patience));
        let answered = outcomes.into_iter().filter(|(_, outcome)| outcome.is_ok());
        found = found.with(answered.map(|(motor, _)| motor).collect());
        rounds += 1;
        // A line that fails is only silent.
        let is_over = session.master.awake() - begun > LONGEST_OUTAGE || session.is_not_to_wait();
        if rounds >= ROUNDS && (!found.is_empty() || is_over) {
            forget(session, MotorSet::ALL.without(found));
            let outage = failure.filter(|_| found.is_empty());
            return (found, outage.map(|error| error.to_string()));
        }
    }
}

/// Stops each of these motors, with the retries of the library. Retries on a bus that carries nothing. Returns why the
/// bus has not carried the stop to all, if it has not.
fn stop_each(session: &mut Session, kind: StopKind, motors: MotorSet) -> Option<String> {
    // There is a place for all.
    let _ = session.master.master().stop_all(kind, motors);
    let mut waits = motors;
    // When a stop was last confirmed or given up.
    let mut last_end = session.master.awake();
    while !waits.is_empty() {
        // So that a short communication-loss protection does not let a load go meanwhile.
        session.ask_each(session.master.confirmed, ReadStatus2, None);
        let soon = session.master.now() + LONGEST_WAIT;
        let outcome = session.master.run_until(soon, |_| {});
        session.master.idle(soon);
        let left = motors.without(session.master.confirmed).without(session.master.silent);
        let now = session.master.awake();
        if left != waits {
            (waits, last_end) = (left, now);
        } else if now - last_end > LONGEST_OUTAGE {
            return Some(match outcome {
                Err(CallError::Bus(error)) => error.to_string(),
                _ => "the bus carries nothing".to_owned(),
            });
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use myactuator_host_std::BusKind;
    use myactuator_host_std::open::{AnyMaster, BusAddress};
    use myactuator_host_std::sim::bus::rs485::TransceiverConfig;
    use myactuator_host_std::sim::bus::trace::{Event, Log};
    use myactuator_host_std::sim::{DriveHandle, Fleet, MotorSetup};
    use myactuator_protocol_core::command::{
        ActiveReply, ReportedCommand, Shutdown, Speed, Stop, Switch,
    };
    use myactuator_protocol_core::drive::Quirks;
    use myactuator_protocol_core::io::{CanMaster, SerialMaster, bring_up};
    use myactuator_protocol_core::master::Config;
    use myactuator_protocol_core::time::{Duration, Instant};
    use myactuator_protocol_core::units::{MaxTorque, Milliseconds, ReportInterval, SpeedTarget};
    use myactuator_protocol_core::{Channel, Opcode, Packet};

    use super::super::session::ToStop;
    use super::super::simulated::{OtherMaster, Sends, to_first, typed};
    use super::*;

    #[test]
    fn stop_whose_bus_cannot_be_opened_reports_that_no_motor_was_stopped() {
        for message in [stop, shut_down].map(|halt| halt(&typed("--bus rs485:/dev/nowhere@115200")))
        {
            let Err(Unfinished::Failed(message)) = message else { panic!("{message:?}") };
            assert!(message.starts_with("there is no serial port \"/dev/nowhere\""), "{message}");
            assert!(
                message
                    .ends_with("; no motor was told to stop: if one must stop now, cut its power")
            );
        }
    }

    /// A session on three drives of a line, by an adapter that is said not to echo. Also what passes on it.
    fn on_a_line(echo: bool) -> (Session, Log<Vec<u8>>) {
        let world = Fleet::new(3).on_rs485(115_200).unwrap().world;
        let port = world.port_with(TransceiverConfig { echo, ..TransceiverConfig::default() });
        let master = SerialMaster::new(port, world.clock(), Config::rs485(115_200, false));
        let log = world.log();
        (Session::by(AnyMaster::SimulatedRs485(master)), log)
    }

    #[test]
    fn stop_of_all_on_rs485_is_sent_to_all_before_any_motor_is_awaited() {
        let (mut session, log) = on_a_line(false);
        assert_eq!(stop_every_id(&mut session, StopKind::Hold).unwrap().len(), 3);
        let first = log.take().into_iter().find_map(|record| match record.event {
            Event::Carried { frame, .. } => Some(frame),
            _ => None,
        });
        assert_eq!(first.unwrap()[..4], [0x3E, 0xCD, 0x08, 0x81]);
    }

    /// Motor 1 sends reports on its own, and answers nothing while it does.
    #[test]
    fn stop_of_all_names_a_motor_that_is_heard_but_does_not_confirm() {
        let quirks = Quirks { silent_while_reporting: true, ..Quirks::default() };
        let fleet = Fleet::new(2).quirks(quirks).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        let command = ReportedCommand::of(Opcode::ReadStatus2).unwrap();
        let interval = ReportInterval::from_raw(1);
        session.ask(MotorId::MIN, ActiveReply { command, enable: Switch::On, interval }).unwrap();
        let outcome = stop_every_id(&mut session, StopKind::Hold);
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        assert!(message.contains("by motor 2 only: cut the power of motor 1 on"), "{message}");
    }

    #[test]
    fn stop_that_no_motor_confirms_asks_to_cut_the_power() {
        // The motors have power, and hear nothing of this.
        let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
        fleet.drives.iter().for_each(|drive| fleet.world.cut(drive.station()));
        let outcome = stop_every_id(&mut Session::on(&fleet), StopKind::Hold);
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        assert!(message.contains("cut its power"), "{message}");
    }

    #[test]
    fn stop_of_all_waits_a_second_for_a_bus_that_is_down() {
        // One takes nothing; the other goes bus-off again and again.
        for (faults, recovers) in [("cut", "mend+300ms"), ("corrupt=1", "corrupt=0+300ms")] {
            let faults = [faults, recovers].map(|fault| fault.parse().unwrap());
            let fleet = Fleet::new(4).faults(faults).on_can(1_000_000).unwrap();
            let stopped = stop_every_id(&mut Session::on(&fleet), StopKind::Hold);
            assert_eq!(stopped.map(MotorSet::len), Ok(4), "{recovers}");
        }
    }

    #[test]
    fn confirmations_of_an_earlier_stop_do_not_count_for_a_later_one() {
        let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        let stations = [0, 1].map(|at| fleet.drives[at].station());
        fleet.world.cut(stations[0]);
        let confirmed = stop_every_id(&mut session, StopKind::Hold);
        assert_eq!(confirmed, Ok(MotorId::new(2).unwrap().into()), "nobody has heard the other");
        for (cut, answers) in [(1, 0), (0, 1)] {
            fleet.world.cut(stations[cut]);
            fleet.world.mend(stations[answers]);
            let outcome = stop_every_id(&mut session, StopKind::Hold);
            let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
            let only = format!("by motor {} only: cut the power of motor {}", answers + 1, cut + 1);
            assert!(message.contains(&only), "{message}");
        }
    }

    #[test]
    fn stop_on_a_bus_that_stays_down_asks_to_cut_the_power_after_a_second() {
        for fault in ["cut", "corrupt=1"] {
            let fleet = Fleet::new(2).faults([fault.parse().unwrap()]).on_can(1_000_000).unwrap();
            let mut session = Session::on(&fleet);
            let outcome = stop_every_id(&mut session, StopKind::Hold);
            let Err(Unfinished::Failed(message)) = outcome else { panic!("{fault}: {outcome:?}") };
            assert!(message.contains("cut its power"), "{fault}: {message}");
            let tried = session.master.now().as_micros();
            assert!((1_000_000..1_100_000).contains(&tried), "{fault}: {tried} us");
        }
    }

    #[test]
    fn motors_that_missed_a_stop_on_a_failing_bus_are_reported() {
        // The first has confirmed by then.
        let faults = ["cut+6ms"].map(|fault| fault.parse().unwrap());
        let fleet = Fleet::new(32).faults(faults).on_can(1_000_000).unwrap();
        let outcome = stop_every_id(&mut Session::on(&fleet), StopKind::Off);
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        let some = "the bus carries nothing; the stop is confirmed by motors 1 ";
        assert!(message.starts_with(some), "{message}");
        assert!(message.ends_with(" only: cut the power of the others on sim:1"), "{message}");
    }

    #[test]
    fn a_stop_of_all_takes_as_long_as_the_help_says() {
        let seconds = |mut session: Session| {
            let _ = halt(&mut session, Target::All, StopKind::Hold);
            (session.master.now().as_micros() as f64 / 1e6).round()
        };
        let fleet = Fleet::new(3).on_can(1_000_000).unwrap();
        let address: BusAddress = "can0".parse().unwrap();
        let (port, clock) = (fleet.world.port(), fleet.world.clock());
        let master = CanMaster::new(port, clock, address.config());
        let of_can = seconds(Session::by(AnyMaster::SimulatedCan(master)));
        let of_line = [3, 0].map(|there| {
            let fleet = Fleet::new(3).on_rs485(115_200).unwrap();
            fleet.drives.iter().skip(there).for_each(|drive| fleet.world.cut(drive.station()));
            let address: BusAddress = "rs485:/dev/ttyUSB0@115200".parse().unwrap();
            let (port, clock) = (fleet.world.port(), fleet.world.clock());
            let master = SerialMaster::new(port, clock, address.config());
            seconds(Session::by(AnyMaster::SimulatedRs485(master)))
        });
        assert_eq!((of_can, of_line), (1.0, [2.0, 4.0]));
    }

    /// What something else sends to the first of two motors.
    const TURN: Speed =
        Speed { max_torque: MaxTorque::NO_LIMIT, speed: SpeedTarget::from_raw(9_000) };

    /// A motor does not count as stopped while something else sends this at this interval.
    fn is_not_left_alone(packet: Packet, every_ms: u64, kind: StopKind) {
        for meant in [Target::Motor(MotorId::MIN), Target::All] {
            let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
            OtherMaster::attach(&fleet, packet, Sends::Every(Duration::from_millis(every_ms)));
            let mut session = Session::on(&fleet);
            let motors = halt(&mut session, meant, kind).unwrap();
            let outcome = match kind {
                StopKind::Hold => session.stopped(motors).map(|_| ()),
                StopKind::Off => session.are_left_alone(motors),
            };
            let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
            let why = "has confirmed the stop, but something else on this bus goes on commanding ";
            let why_of_all = why.replace("has", "have");
            assert!(message.contains(why) || message.contains(&why_of_all), "{message}");
        }
    }

    #[test]
    fn motor_that_another_master_keeps_moving_is_not_reported_stopped() {
        // Only its channel shows that it is motion mode.
        let motion =
            Packet { channel: Channel::Motion(MotorId::MIN), data: [0x80, 0, 0x80, 0, 0, 0, 0, 0] };
        for packet in [to_first(TURN.encode()), motion] {
            for kind in [StopKind::Hold, StopKind::Off] {
                is_not_left_alone(packet, 10, kind);
            }
        }
    }

    #[test]
    fn another_master_that_commands_seldom_is_heard_after_a_stop() {
        for every_ms in [60, 100, 200] {
            is_not_left_alone(to_first(TURN.encode()), every_ms, StopKind::Hold);
        }
    }

    #[test]
    fn motor_that_another_master_switches_on_again_is_not_reported_off() {
        is_not_left_alone(to_first(Stop.encode()), 10, StopKind::Off);
    }

    #[test]
    fn motor_that_another_master_switches_off_is_not_reported_holding() {
        for meant in [Target::Motor(MotorId::MIN), Target::All] {
            let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
            let soon = Sends::Once(Duration::from_millis(100));
            OtherMaster::attach(&fleet, to_first(Shutdown.encode()), soon);
            let mut session = Session::on(&fleet);
            let motors = halt(&mut session, meant, StopKind::Hold).unwrap();
            let message = session.stopped(motors).unwrap();
            let off = "motor 1 is off (0x80): its shaft is free unless a brake holds it";
            assert!(message.ends_with(off), "{message}");
        }
    }

    /// What is reported about two stopped motors while something else turns the second, which is waited for, and sends
    /// these packets to the first, each so many milliseconds after the start. Returns the report about the first, and
    /// whether its output is on then.
    fn report_of_first(packets: &[(Packet, u64)]) -> (String, bool) {
        let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
        for (packet, after_ms) in packets {
            OtherMaster::attach(&fleet, *packet, Sends::Once(Duration::from_millis(*after_ms)));
        }
        let mut session = Session::on(&fleet);
        let motors = halt(&mut session, Target::All, StopKind::Hold).unwrap();
        fleet.drives[1].with(|drive| drive.plant_mut().lead(0.0, 200.0)).unwrap();
        let Err(Unfinished::Failed(message)) = session.stopped(motors) else { panic!("one turns") };
        assert!(
            message.contains("motor 2 has confirmed the stop (0x81), but turns at"),
            "{message}"
        );
        let of_first = message.split("; ").find(|message| message.starts_with("motor 1 "));
        let is_on = fleet.drives[0].with(|drive| drive.state().output_on);
        (of_first.expect("something").to_owned(), is_on)
    }

    #[test]
    fn changes_to_one_motor_while_another_is_awaited_are_reported() {
        let [off, on] = [to_first(Shutdown.encode()), to_first(Stop.encode())];
        let is_off = "motor 1 is off (0x80): its shaft is free unless a brake holds it".to_owned();
        assert_eq!(report_of_first(&[(off, 100)]), (is_off.clone(), false));
        assert_eq!(report_of_first(&[(off, 1_000)]), (is_off, false));
        let on_again = "motor 1 was switched off and on again by something else on this bus: its state is not known";
        assert_eq!(report_of_first(&[(off, 100), (on, 1_000)]), (on_again.to_owned(), true));
    }

    #[test]
    fn motor_stays_stopped_though_another_master_yields_one_command_late() {
        for meant in [Target::Motor(MotorId::MIN), Target::All] {
            let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
            OtherMaster::attach(&fleet, to_first(TURN.encode()), Sends::UntilStopped);
            fleet.world.run_for(Duration::from_millis(500));
            assert!(Session::on(&fleet).standing(MotorId::MIN).is_err());
            let mut session = Session::on(&fleet);
            let _stopped = halt(&mut session, meant, StopKind::Hold).unwrap();
            fleet.world.run_for(Duration::from_millis(500));
            session.standing(MotorId::MIN).unwrap();
        }
    }

    /// Stops six motors that turn at 100 dps, on a bus that loses frames from then on. Returns the outcome, and the
    /// motors that still turn.
    fn stopped_with_loss(bus: BusKind, seed: u64, kind: StopKind) -> (Outcome<MotorSet>, MotorSet) {
        let faults = ["lose=0.3+100ms".parse().unwrap()];
        let fleet = Fleet::new(6).seed(seed).faults(faults);
        match bus {
            BusKind::Can => {
                let fleet = fleet.on_can(1_000_000).unwrap();
                stopped_on(&fleet.drives, || AnyMaster::SimulatedCan(fleet.master()), kind)
            }
            BusKind::Rs485 => {
                let fleet = fleet.on_rs485(115_200).unwrap();
                stopped_on(&fleet.drives, || AnyMaster::SimulatedRs485(fleet.master()), kind)
            }
        }
    }

    /// The same on this bus, where another program has turned them.
    fn stopped_on(
        drives: &[DriveHandle],
        program: impl Fn() -> AnyMaster<{ MotorId::COUNT }>,
        kind: StopKind,
    ) -> (Outcome<MotorSet>, MotorSet) {
        let motors: MotorSet = MotorId::all().take(drives.len()).collect();
        let mut other = Session::by(program());
        assert!(
            other.ask_each(motors, TURN, None).outcomes.iter().all(|(_, outcome)| outcome.is_ok())
        );
        other.wait_until(Instant::ZERO + Duration::from_millis(200)).unwrap();
        drop(other);
        let mut session = Session::by(program());
        let turns = |motor: &MotorId| {
            drives[motor.index()].with(|drive| drive.plant().output_speed_dps().abs() > 2.0)
        };
        assert!(motors.iter().all(|motor| turns(&motor)));
        let stopped = halt(&mut session, Target::All, kind);
        let later = session.master.now() + Duration::from_secs(3);
        session.wait_until(later).unwrap();
        (stopped, motors.iter().filter(turns).collect())
    }

    /// The stop once tried each id three times, and passed over motors that had confirmed none of them.
    #[test]
    fn stop_of_all_leaves_no_motor_turning_where_frames_are_lost() {
        for bus in [BusKind::Can, BusKind::Rs485] {
            for kind in [StopKind::Hold, StopKind::Off] {
                for seed in 0..25 {
                    let (message, turning) = stopped_with_loss(bus, seed, kind);
                    assert_eq!(turning, MotorSet::EMPTY, "{bus:?} {kind:?} {seed}: {message:?}");
                }
            }
        }
    }

    #[test]
    fn protection_does_not_expire_while_stop_of_all_awaits_silent_ids() {
        let lets_go = |mut session: Session, drive: &DriveHandle, millis| {
            let silence = Milliseconds::from_raw(millis);
            bring_up::protect(&mut session.master, MotorId::MIN, silence).unwrap();
            for _ in 0..3 {
                session.ask(MotorId::MIN, ReadStatus2).unwrap();
            }
            let _stopped = stop_every_id(&mut session, StopKind::Hold).unwrap();
            !drive.with(|drive| drive.state().output_on)
        };
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        assert!(!lets_go(Session::on(&fleet), &fleet.drives[0], 60));
        let fleet = Fleet::new(1).on_rs485(115_200).unwrap();
        let session = Session::by(AnyMaster::SimulatedRs485(fleet.master()));
        assert!(!lets_go(session, &fleet.drives[0], 400));
    }

    #[test]
    fn stop_waits_for_an_rs485_line_that_is_cut_for_700_ms() {
        for meant in [Target::Motor(MotorId::MIN), Target::All] {
            for kind in [StopKind::Hold, StopKind::Off] {
                let faults = ["cut", "mend+700ms"].map(|fault| fault.parse().unwrap());
                let fleet = Fleet::new(2).faults(faults).on_rs485(2_500_000).unwrap();
                let mut session = Session::by(AnyMaster::SimulatedRs485(fleet.master()));
                assert!(halt(&mut session, meant, kind).is_ok(), "{meant:?} {kind:?}");
            }
        }
    }

    #[test]
    fn stop_on_rs485_of_motors_that_their_brakes_hold_reports_no_invalid_bytes() {
        let fleet = Fleet::new(3).brakes(true).on_rs485(115_200).unwrap();
        let mut session = Session::by(AnyMaster::SimulatedRs485(fleet.master()));
        let stopped = halt(&mut session, Target::All, StopKind::Hold).unwrap();
        session.stopped(stopped).unwrap();
        let message = of_others(&session, Target::All, stopped);
        assert!(!message.contains("bytes arrive"), "{message}");
    }

    #[test]
    fn stop_accepts_the_consent_that_it_does_not_need() {
        assert_eq!(
            typed::<ToStop>("--yes --id 3").motors.id,
            Target::Motor(MotorId::new(3).unwrap())
        );
    }

    #[test]
    fn stop_on_rs485_reports_invalid_bytes_where_two_motors_have_one_id() {
        let motor = MotorId::MIN;
        let fleet = Fleet::new(2).all_with_id(motor).on_rs485(115_200).unwrap();
        let mut session = Session::by(AnyMaster::SimulatedRs485(fleet.master()));
        let stopped = stop_every_id(&mut session, StopKind::Hold).map(|_| ());
        let found = session.meant(Target::All).map(|_| ());
        for message in [stopped, found] {
            let Err(Unfinished::Failed(message)) = message else { panic!("{message:?}") };
            assert!(
                message.contains("bytes arrive that are no valid frame (two motors"),
                "{message}"
            );
        }
        // With a third motor on the line they are reported beside it.
        let third = MotorId::new(2).unwrap();
        for (ids, is_told) in [(&[motor, motor, third][..], true), (&[motor, third], false)] {
            let fleet = Fleet::of(ids.iter().map(|&id| MotorSetup::new(id)));
            let fleet = fleet.on_rs485(115_200).unwrap();
            let mut session = Session::by(AnyMaster::SimulatedRs485(fleet.master()));
            let stopped = stop_every_id(&mut session, StopKind::Hold).unwrap();
            assert!(stopped.contains(third));
            let message = of_others(&session, Target::All, stopped);
            assert_eq!(message.contains("two motors with one id?"), is_told, "{message}");
        }
        let fleet = Fleet::new(1).on_rs485(115_200).unwrap();
        fleet.world.cut(fleet.drives[0].station());
        let mut session = Session::by(AnyMaster::SimulatedRs485(fleet.master()));
        let Err(Unfinished::Failed(message)) = session.meant(Target::All) else { panic!() };
        assert!(!message.contains("bytes arrive"), "{message}");
    }

    #[test]
    fn unconfirmed_stop_names_a_configured_echo_that_does_not_come() {
        for meant in [Target::Motor(MotorId::MIN), Target::All] {
            let fleet = Fleet::new(1).on_rs485(115_200).unwrap();
            let (port, clock) = (fleet.world.port(), fleet.world.clock());
            let master = SerialMaster::new(port, clock, Config::rs485(115_200, true));
            let mut session = Session::by(AnyMaster::SimulatedRs485(master));
            session.address = "rs485:/dev/ttyUSB0@115200,echo".parse().unwrap();
            let Err(Unfinished::Failed(message)) = halt(&mut session, meant, StopKind::Hold) else {
                panic!("its answer is the same bytes as the echo");
            };
            assert!(message.contains("leave out ',echo'"), "{message}");
        }
    }

    #[test]
    fn echo_not_configured_confirms_no_stop_of_an_absent_motor() {
        let (mut session, _) = on_a_line(true);
        assert_eq!(stop_every_id(&mut session, StopKind::Hold).unwrap().len(), 3);
        let (mut session, _) = on_a_line(true);
        assert_eq!(stop_every_id(&mut session, StopKind::Off).unwrap().len(), 3);
    }
}
