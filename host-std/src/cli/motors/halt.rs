//! `myactuator stop` and `myactuator shutdown`: what must work without thinking.
//!
//! Nothing is asked, and nobody is looked for first: the command itself goes to every id, on RS485 to all at
//! once before that, and those that confirm are reported. Exit status: 0 if the motor, or any motor if all are
//! meant, has confirmed, the bus has carried the command to all that were meant, none of them moves on, and none that
//! was to hold still is known, or may be feared, to hold nothing, else 1.

use myactuator_protocol_core::Target;
use myactuator_protocol_core::command::{Command, Shutdown, Stop};
use myactuator_protocol_core::io::{CallError, Runner};
use myactuator_protocol_core::master::{Failure, MotorSet, StopKind};

use super::moving::{LONGEST_OUTAGE, LONGEST_WAIT, named};
use super::session::{Motors, Session, say};
use super::together::Together;
use crate::cli::{Outcome, Unfinished};

/// How often ids are tried that do not confirm.
const ROUNDS: usize = 3;

pub(super) fn stop(arguments: &Motors) -> Outcome {
    let mut session = Session::open_to_stop(&arguments.on)?;
    let motors = halt(&mut session, arguments.id, StopKind::Hold)?;
    say(&session.stopped(motors)?)
}

pub(super) fn shut_down(arguments: &Motors) -> Outcome {
    let mut session = Session::open_to_stop(&arguments.on)?;
    let motors = halt(&mut session, arguments.id, StopKind::Off)?;
    let are = match motors.len() {
        1 => "is off (0x80): its shaft is free unless a brake holds it",
        _ => "are off (0x80): their shafts are free unless brakes hold them",
    };
    say(&format!("{} {are}", named(motors)))
}

/// Gives the motors that have confirmed.
fn halt(session: &mut Session, meant: Target, kind: StopKind) -> Outcome<MotorSet> {
    let stopped = match (meant, kind) {
        (Target::Motor(motor), _) => {
            session.stop(kind, motor.into())?;
            return Ok(motor.into());
        }
        (Target::All, StopKind::Hold) => stop_every_id(session, kind, Stop)?,
        (Target::All, StopKind::Off) => stop_every_id(session, kind, Shutdown)?,
    };
    // Nobody waits for the others any more.
    for motor in MotorSet::ALL.without(stopped).iter() {
        session.master.master().forget(motor);
    }
    session.see_stopped(kind, stopped)?;
    Ok(stopped)
}

/// Sends the command of this stop to every id, first once to each and then again to those that were silent. A bus
/// that carries nothing is waited for: no round counts in which it did not carry all.
fn stop_every_id<C: Command + Copy>(
    session: &mut Session,
    kind: StopKind,
    command: C,
) -> Outcome<MotorSet> {
    if kind == StopKind::Off {
        session.master.off = MotorSet::ALL;
    }
    // On RS485 one to all goes first: nobody waits behind those that are silent. There is a place for
    // all.
    let _ = session.master.master().stop_all(kind, MotorSet::EMPTY);
    let mut confirmed = MotorSet::EMPTY;
    let mut rounds = 0;
    let mut down_since = None;
    let begun = session.master.now();
    let outage = loop {
        let start = session.master.now();
        let Round { answered, outage } = once(session, MotorSet::ALL.without(confirmed), command);
        confirmed = confirmed.with(answered);
        let now = session.master.now();
        if outage.is_none() {
            (rounds, down_since) = (rounds + 1, None);
            // A line that fails tells it by nothing but silence.
            let may_be_down = confirmed.is_empty() && now - begun <= LONGEST_OUTAGE;
            if rounds >= ROUNDS && (!may_be_down || session.is_not_to_wait()) {
                break outage;
            }
        } else if now - *down_since.get_or_insert(start) > LONGEST_OUTAGE {
            break outage;
        } else {
            session.master.idle(now + LONGEST_WAIT);
        }
    };
    let why = match &outage {
        None if !confirmed.is_empty() => return Ok(confirmed),
        None => String::new(),
        Some(why) => format!("{why}; "),
    };
    let echo = session.echo_told_of();
    Err(Unfinished::Failed(if confirmed.is_empty() {
        format!(
            "{why}no confirmation of the stop from any motor{}: if one is on {}, cut its power; then check the \
             wiring and the bit rate ('scan --all-rates' tries the others){echo}",
            session.garbled(),
            session.address
        )
    } else {
        format!(
            "{why}confirmation of the stop from {} only: cut the power of the others on {}",
            named(confirmed),
            session.address
        )
    }))
}

/// What came of sending a command once to many.
struct Round {
    answered: MotorSet,
    /// Why the bus has not carried it to all, if it has not.
    outage: Option<String>,
}

/// Sends a command once to each of these ids.
fn once<C: Command + Copy>(session: &mut Session, motors: MotorSet, command: C) -> Round {
    let patience = session.master.master().patience(1);
    let Together { outcomes, failure } = session.ask_each(motors, command, Some(patience));
    let was_down = outcomes
        .iter()
        .any(|(_, outcome)| matches!(outcome, Err(CallError::Failed(Failure::BusDown))));
    let answered = outcomes.into_iter().filter(|(_, outcome)| outcome.is_ok());
    let why =
        || failure.map_or_else(|| "the bus carries nothing".to_owned(), |error| error.to_string());
    Round { answered: answered.map(|(motor, _)| motor).collect(), outage: was_down.then(why) }
}

#[cfg(test)]
mod tests {
    use myactuator_host_std::open::AnyMaster;
    use myactuator_host_std::sim::Fleet;
    use myactuator_host_std::sim::bus::rs485::TransceiverConfig;
    use myactuator_host_std::sim::bus::trace::{Event, Log};
    use myactuator_protocol_core::command::Speed;
    use myactuator_protocol_core::io::SerialMaster;
    use myactuator_protocol_core::master::Config;
    use myactuator_protocol_core::time::Duration;
    use myactuator_protocol_core::units::{MaxTorque, SpeedTarget};
    use myactuator_protocol_core::{Channel, MotorId, Packet};

    use super::super::simulated::{OtherMaster, Sends, to_first, typed};
    use super::*;

    #[test]
    fn whoever_cannot_open_the_bus_is_told_that_nobody_was_stopped() {
        for told in [stop, shut_down].map(|halt| halt(&typed("--bus rs485:/dev/nowhere@115200"))) {
            let Err(Unfinished::Failed(told)) = told else { panic!("{told:?}") };
            assert!(told.starts_with("there is no serial port \"/dev/nowhere\""), "{told}");
            assert!(
                told.ends_with("; no motor was told to stop: if one must stop now, cut its power")
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
    fn on_a_line_all_hear_the_stop_before_anybody_is_waited_for() {
        let (mut session, log) = on_a_line(false);
        assert_eq!(stop_every_id(&mut session, StopKind::Hold, Stop).unwrap().len(), 3);
        let first = log.take().into_iter().find_map(|record| match record.event {
            Event::Carried { frame, .. } => Some(frame),
            _ => None,
        });
        assert_eq!(first.unwrap()[..4], [0x3E, 0xCD, 0x08, 0x81]);
    }

    #[test]
    fn if_nobody_confirms_the_power_is_to_be_cut() {
        // The motors have power, and hear nothing of this.
        let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
        fleet.drives.iter().for_each(|drive| fleet.world.cut(drive.station()));
        let outcome = stop_every_id(&mut Session::on(&fleet), StopKind::Hold, Stop);
        let Err(Unfinished::Failed(told)) = outcome else { panic!("{outcome:?}") };
        assert!(told.contains("cut its power"), "{told}");
    }

    #[test]
    fn a_bus_that_is_back_within_a_second_is_waited_for_and_all_are_stopped() {
        // One takes nothing, the other leaves the bus with errors again and again.
        for (faults, recovers) in [("cut", "mend+300ms"), ("corrupt=1", "corrupt=0+300ms")] {
            let faults = [faults, recovers].map(|fault| fault.parse().unwrap());
            let fleet = Fleet::new(4).faults(faults).on_can(1_000_000).unwrap();
            let stopped = stop_every_id(&mut Session::on(&fleet), StopKind::Hold, Stop);
            assert_eq!(stopped.map(MotorSet::len), Ok(4), "{recovers}");
        }
    }

    #[test]
    fn a_bus_that_stays_down_is_told_with_the_power_to_cut() {
        for fault in ["cut", "corrupt=1"] {
            let fleet = Fleet::new(2).faults([fault.parse().unwrap()]).on_can(1_000_000).unwrap();
            let mut session = Session::on(&fleet);
            let outcome = stop_every_id(&mut session, StopKind::Hold, Stop);
            let Err(Unfinished::Failed(told)) = outcome else { panic!("{fault}: {outcome:?}") };
            assert!(told.contains("cut its power"), "{fault}: {told}");
            let tried = session.master.now().as_micros();
            assert!((1_000_000..1_100_000).contains(&tried), "{fault}: {tried} us");
        }
    }

    #[test]
    fn whom_a_bus_that_went_down_has_not_told_is_not_passed_over() {
        // The first has confirmed by then.
        let faults = ["cut+6ms"].map(|fault| fault.parse().unwrap());
        let fleet = Fleet::new(32).faults(faults).on_can(1_000_000).unwrap();
        let outcome = stop_every_id(&mut Session::on(&fleet), StopKind::Off, Shutdown);
        let Err(Unfinished::Failed(told)) = outcome else { panic!("{outcome:?}") };
        let some = "the bus carries nothing; confirmation of the stop from motors 1 ";
        assert!(told.starts_with(some), "{told}");
        assert!(told.ends_with(" only: cut the power of the others on sim:1"), "{told}");
    }

    /// What the first of two motors is told from elsewhere.
    const TURN: Speed =
        Speed { max_torque: MaxTorque::from_raw(0), speed: SpeedTarget::from_raw(9_000) };

    /// That it is not said to be stopped while something else sends this every so often.
    fn is_not_left_alone(packet: Packet, every_ms: u64, kind: StopKind) {
        for meant in [Target::Motor(MotorId::MIN), Target::All] {
            let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
            OtherMaster::attach(&fleet, packet, Sends::Every(Duration::from_millis(every_ms)));
            let outcome = halt(&mut Session::on(&fleet), meant, kind);
            let Err(Unfinished::Failed(told)) = outcome else { panic!("{outcome:?}") };
            let why = "but something else on this bus goes on commanding motor 1: end that, or cut the power";
            assert!(told.ends_with(why), "{told}");
        }
    }

    #[test]
    fn a_motor_that_something_else_goes_on_moving_is_not_said_to_be_stopped() {
        // Its data say nothing of motion mode, its channel does.
        let motion =
            Packet { channel: Channel::Motion(MotorId::MIN), data: [0x80, 0, 0x80, 0, 0, 0, 0, 0] };
        for packet in [to_first(TURN.encode()), motion] {
            for kind in [StopKind::Hold, StopKind::Off] {
                is_not_left_alone(packet, 10, kind);
            }
        }
    }

    #[test]
    fn who_commands_a_motor_seldom_is_heard_all_the_same() {
        for every_ms in [60, 100, 200] {
            is_not_left_alone(to_first(TURN.encode()), every_ms, StopKind::Hold);
        }
    }

    #[test]
    fn a_motor_that_something_else_switches_on_again_is_not_said_to_be_off() {
        is_not_left_alone(to_first(Stop.encode()), 10, StopKind::Off);
    }

    #[test]
    fn a_motor_that_something_else_switches_off_after_the_stop_is_not_said_to_hold_still() {
        for meant in [Target::Motor(MotorId::MIN), Target::All] {
            let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
            let soon = Sends::Once(Duration::from_millis(100));
            OtherMaster::attach(&fleet, to_first(Shutdown.encode()), soon);
            let mut session = Session::on(&fleet);
            let motors = halt(&mut session, meant, StopKind::Hold).unwrap();
            let told = session.stopped(motors).unwrap();
            let off = "motor 1 is off (0x80): its shaft is free unless a brake holds it";
            assert!(told.ends_with(off), "{told}");
        }
    }

    /// What is told of two stopped motors: something else turns the second, which is waited for, and sends these to the
    /// first so many milliseconds after the start. And whether the first's output is on then.
    fn told_of_first(packets: &[(Packet, u64)]) -> (String, bool) {
        let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
        for (packet, after_ms) in packets {
            OtherMaster::attach(&fleet, *packet, Sends::Once(Duration::from_millis(*after_ms)));
        }
        let mut session = Session::on(&fleet);
        let motors = halt(&mut session, Target::All, StopKind::Hold).unwrap();
        fleet.drives[1].with(|drive| drive.plant_mut().lead(0.0, 200.0)).unwrap();
        let Err(Unfinished::Failed(told)) = session.stopped(motors) else { panic!("one turns") };
        assert!(told.contains("motor 2 has confirmed the stop (0x81), but turns at"), "{told}");
        let of_first = told.split("; ").find(|told| told.starts_with("motor 1 "));
        let is_on = fleet.drives[0].with(|drive| drive.state().output_on);
        (of_first.expect("something").to_owned(), is_on)
    }

    #[test]
    fn what_is_done_to_a_motor_while_another_is_waited_for_is_told() {
        let [off, on] = [to_first(Shutdown.encode()), to_first(Stop.encode())];
        let is_off = "motor 1 is off (0x80): its shaft is free unless a brake holds it".to_owned();
        assert_eq!(told_of_first(&[(off, 100)]), (is_off.clone(), false));
        assert_eq!(told_of_first(&[(off, 1_000)]), (is_off, false));
        let on_again = "motor 1 was switched off and on again by something else on this bus: how it stands is not known";
        assert_eq!(told_of_first(&[(off, 100), (on, 1_000)]), (on_again.to_owned(), true));
    }

    #[test]
    fn whoever_gives_way_to_a_stop_may_send_once_more() {
        for meant in [Target::Motor(MotorId::MIN), Target::All] {
            let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
            OtherMaster::attach(&fleet, to_first(TURN.encode()), Sends::UntilStopped);
            fleet.world.run_for(Duration::from_millis(500));
            assert!(Session::on(&fleet).standing(MotorId::MIN).is_err());
            let mut session = Session::on(&fleet);
            halt(&mut session, meant, StopKind::Hold).unwrap();
            fleet.world.run_for(Duration::from_millis(500));
            session.standing(MotorId::MIN).unwrap();
        }
    }

    #[test]
    fn a_line_that_fails_for_a_moment_is_waited_for() {
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
    fn of_two_motors_with_one_id_on_a_line_it_is_told_that_something_comes() {
        let motor = MotorId::MIN;
        let fleet = Fleet::new(2).all_with_id(motor).on_rs485(115_200).unwrap();
        let mut session = Session::by(AnyMaster::SimulatedRs485(fleet.master()));
        let stopped = stop_every_id(&mut session, StopKind::Hold, Stop).map(|_| ());
        let found = session.meant(Target::All).map(|_| ());
        for told in [stopped, found] {
            let Err(Unfinished::Failed(told)) = told else { panic!("{told:?}") };
            assert!(told.contains("bytes come that are no frame (do two motors"), "{told}");
        }
        let fleet = Fleet::new(1).on_rs485(115_200).unwrap();
        fleet.world.cut(fleet.drives[0].station());
        let mut session = Session::by(AnyMaster::SimulatedRs485(fleet.master()));
        let Err(Unfinished::Failed(told)) = session.meant(Target::All) else { panic!() };
        assert!(!told.contains("bytes come"), "{told}");
    }

    #[test]
    fn an_echo_that_was_told_of_and_does_not_come_is_named_where_no_stop_is_confirmed() {
        for meant in [Target::Motor(MotorId::MIN), Target::All] {
            let fleet = Fleet::new(1).on_rs485(115_200).unwrap();
            let (port, clock) = (fleet.world.port(), fleet.world.clock());
            let master = SerialMaster::new(port, clock, Config::rs485(115_200, true));
            let mut session = Session::by(AnyMaster::SimulatedRs485(master));
            let Err(Unfinished::Failed(told)) = halt(&mut session, meant, StopKind::Hold) else {
                panic!("its answer is the same bytes as the echo");
            };
            assert!(told.contains("leave ',echo' away"), "{told}");
        }
    }

    #[test]
    fn an_echo_that_nobody_told_of_is_no_confirmation_of_a_motor_that_is_not_there() {
        let (mut session, _) = on_a_line(true);
        assert_eq!(stop_every_id(&mut session, StopKind::Hold, Stop).unwrap().len(), 3);
        let (mut session, _) = on_a_line(true);
        assert_eq!(stop_every_id(&mut session, StopKind::Off, Shutdown).unwrap().len(), 3);
    }
}
