//! `myactuator id`: another id for a motor.

use myactuator_protocol_core::io::bring_up;
use myactuator_protocol_core::master::MotorSet;
use myactuator_protocol_core::{MotorId, Target};

use super::help::SIGNALS;
use super::on_bus::OnBus;
use super::session::{Consent, Session, say};
use crate::cli::{Outcome, Unfinished, arguments as parse};

/// Give a motor another id
///
/// If the motor has a brake that is open, it is locked (0x78). The motor is switched off (0x80), stores the id in its
/// ROM and restarts. The id is set by function 5 (0x20), which names the motor. If the motor does not acknowledge that
/// and is the only one on the bus, the id is set by 0x79, which all motors obey. Ctrl-C ends this program when the
/// change is finished.
///
/// Whole turns are lost with the restart unless multi-turn saving (function 4) is on. A motor that turns is refused:
/// stop it first. So are two motors with the same id: connect only one of them.
///
/// Exit status: 0 answers under the new id, 1 not, 2 wrong usage.
#[derive(Debug, clap::Args)]
#[command(after_help = SIGNALS)]
pub(in crate::cli) struct Arguments {
    #[command(flatten)]
    on: OnBus,
    /// The id that it has, 1 to 32; not needed if it is the only motor.
    #[arg(long, value_parser = parse::motor_id, allow_hyphen_values = true)]
    id: Option<MotorId>,
    /// The id that it gets, 1 to 32.
    #[arg(long, value_parser = parse::motor_id, allow_hyphen_values = true)]
    new_id: MotorId,
    #[command(flatten)]
    consent: Consent,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let mut session = Session::open_to_change(&arguments.on, arguments.consent)?;
    run_on(&mut session, arguments.id, arguments.new_id)
}

fn run_on(session: &mut Session, id: Option<MotorId>, to: MotorId) -> Outcome {
    let found = session.meant(Target::All)?;
    let from = which(found, id, &session.garbled())?;
    if from == to {
        return say(&format!("motor {from} has this id already"));
    }
    session.standing(from)?;
    session.confirm(from, &format!(
        "Motor {from} will be switched off, store id {to} in its ROM, and restart: hold the shaft if a load pulls at it. Its whole turns may be lost."
    ))?;
    change(session, from, to)?;
    say(&format!("motor {from} is motor {to} now"))
}

fn change(session: &mut Session, from: MotorId, to: MotorId) -> Outcome {
    session.is_finished_first()?;
    bring_up::change_id(&mut session.master, from, to)
        .map_err(|error| session.not_brought_up(error))
}

/// The motor that is meant. What is `garbled` may be others.
fn which(found: MotorSet, id: Option<MotorId>, garbled: &str) -> Outcome<MotorId> {
    let mut motors = found.iter();
    let only = motors.next().filter(|_| motors.next().is_none() && garbled.is_empty());
    match (id, only) {
        (Some(id), _) if found.contains(id) => Ok(id),
        (None, Some(only)) => Ok(only),
        (Some(id), Some(only)) => {
            Err(Unfinished::Failed(format!("the only motor has id {only}, not {id}")))
        }
        (Some(id), None) => {
            Err(Unfinished::Failed(format!("no motor has id {id} (there are: {found}){garbled}")))
        }
        (None, None) => Err(Unfinished::Failed(format!(
            "--id is missing: say which motor gets another id (there are: {found}){garbled}"
        ))),
    }
}

#[cfg(test)]
mod tests {
    use myactuator_host_std::open::AnyMaster;
    use myactuator_host_std::sim::{Fleet, MotorSetup};
    use myactuator_protocol_core::drive::Quirks;
    use myactuator_protocol_core::time::Duration;

    use super::super::{
        odd_drive,
        simulated::{sent, turning},
    };
    use super::*;

    fn id(id: u8) -> MotorId {
        MotorId::new(id).unwrap()
    }

    fn failed(outcome: Outcome) -> String {
        match outcome {
            Err(Unfinished::Failed(sentence)) => sentence,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn one_of_several_gets_another_id_by_function_5() {
        let fleet = Fleet::new(3).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        let message = failed(run_on(&mut session, None, id(7)));
        assert!(message.ends_with("(there are: 1 2 3)"), "{message}");
        let taken = failed(run_on(&mut session, Some(id(2)), id(3)));
        assert_eq!(taken, "a motor with id 3 is on the bus already");
        let log = fleet.world.log();
        assert_eq!(run_on(&mut session, Some(id(2)), id(7)), Ok(()));
        assert!(sent(&log).iter().all(|packet| packet.data[0] != 0x79));
        let there: Vec<u8> = session.meant(Target::All).unwrap().iter().map(MotorId::get).collect();
        assert_eq!(there, [1, 3, 7]);
    }

    /// Two that answer at the same time on a line.
    #[test]
    fn a_motor_is_not_the_only_one_if_others_are_not_understood() {
        let fleet = Fleet::of([1, 1, 3].map(|number| MotorSetup::new(id(number))));
        let at_once = Duration::from_millis(1);
        let fleet = fleet.response(at_once, at_once).on_rs485(115_200).unwrap();
        let mut session = Session::by(AnyMaster::SimulatedRs485(fleet.master()));
        let garbled = "(there are: 3), but bytes arrive that are no valid frame";
        for from in [None, Some(id(1))] {
            let message = failed(run_on(&mut session, from, id(2)));
            assert!(message.contains(garbled), "{message}");
        }
        assert_eq!(fleet.drives[2].with(|drive| drive.stored_settings().id), id(3));
    }

    #[test]
    fn a_motor_that_begins_to_turn_while_the_user_is_asked_keeps_its_id() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let mut session = turning(&fleet);
        let log = fleet.world.log();
        let message = failed(change(&mut session, id(1), id(7)));
        assert!(message.contains("turns at 1"), "{message}");
        assert!(sent(&log).iter().all(|packet| packet.data[0] >= 0x90), "something was written");
    }

    #[test]
    fn drive_that_ignores_function_5_gets_its_id_by_0x79_only_if_alone() {
        let fleet = |count| {
            let fleet =
                Fleet::new(count).quirks(Quirks { silent_id_change: true, ..Quirks::default() });
            fleet.on_can(1_000_000).unwrap()
        };
        assert_eq!(run_on(&mut Session::on(&fleet(1)), None, id(7)), Ok(()));
        let fleet = fleet(2);
        let log = fleet.world.log();
        let message = failed(run_on(&mut Session::on(&fleet), Some(id(1)), id(7)));
        assert!(
            message.contains("it was not restarted, and is off: connect it alone"),
            "{message}"
        );
        assert!(sent(&log).iter().all(|packet| ![0x76, 0x79].contains(&packet.data[0])));
    }

    #[test]
    fn firmware_that_answers_as_new_id_but_hears_the_old_gets_its_id() {
        // Firmware 2025070202.
        let quirks =
            Quirks { repeats_last_reply: true, answers_as_new_id: true, ..Quirks::default() };
        let fleet = Fleet::new(1).quirks(quirks).on_can(1_000_000).unwrap();
        assert_eq!(run_on(&mut Session::on(&fleet), None, id(7)), Ok(()));
        assert_eq!(fleet.drives[0].with(|drive| drive.id()), id(7));
    }

    #[test]
    fn drive_that_acknowledges_no_new_id_is_not_restarted() {
        let (fleet, drive) = odd_drive::alone();
        let message = failed(run_on(&mut Session::on(&fleet), None, id(7)));
        assert!(
            message.starts_with("motor 1 has not acknowledged id 7, so it was not restarted"),
            "{message}"
        );
        assert!(!drive.lock().unwrap().received.contains(&0x76));
    }

    #[test]
    fn new_id_is_not_written_to_two_motors_of_one_id_on_rs485() {
        let fleet = Fleet::new(2).all_with_id(id(1)).on_rs485(115_200).unwrap();
        let mut session = Session::by(AnyMaster::SimulatedRs485(fleet.master()));
        let message = failed(run_on(&mut session, Some(id(1)), id(7)));
        let is_refused =
            ["two motors seem to have", "no motor answers"].iter().any(|why| message.contains(why));
        assert!(is_refused, "{message}");
        for drive in &fleet.drives {
            assert_eq!(drive.with(|drive| drive.stored_settings().id), id(1));
        }
    }

    #[test]
    fn new_id_is_not_written_to_two_motors_of_one_id_on_can() {
        let fleet = Fleet::new(2).all_with_id(id(1)).on_can(1_000_000).unwrap();
        let log = fleet.world.log();
        let message = failed(run_on(&mut Session::on(&fleet), None, id(7)));
        assert!(message.contains("two motors seem to have id 1"), "{message}");
        assert!(sent(&log).iter().all(|packet| packet.data[0] >= 0x90), "something was written");
    }
}
