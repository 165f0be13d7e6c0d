//! `myactuator reset`: a restart, which also clears the errors that nothing else clears.

use myactuator_protocol_core::command::ReadMultiTurnAngle;
use myactuator_protocol_core::io::bring_up;
use myactuator_protocol_core::units::Angle;
use myactuator_protocol_core::{MotorId, Opcode};

use super::help::SIGNALS;
use super::session::{OneMotor, Session, say};
use crate::cli::Outcome;

/// Restart a motor (0x76), which also clears errors whose cause is gone
///
/// If the motor has a brake that is open, it is locked first (0x78). Ctrl-C ends this program when the motor has
/// restarted.
///
/// During the restart the shaft is free unless a brake holds it, and whole turns are lost unless multi-turn saving
/// (function 4) is on. A motor that turns is refused: stop it first. So are two motors with the same id.
///
/// Exit status: 0 restarted and without an error, 1 not, 2 wrong usage.
#[derive(Debug, clap::Args)]
#[command(after_help = SIGNALS)]
pub(in crate::cli) struct Arguments {
    #[command(flatten)]
    motor: OneMotor,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    run_on(&mut arguments.motor.open_to_send(Opcode::Reset)?, arguments.motor.id)
}

fn run_on(session: &mut Session, motor: MotorId) -> Outcome {
    session.standing(motor)?;
    let before = session.ask(motor, ReadMultiTurnAngle)?.angle;
    session.confirm(motor, &format!(
        "Motor {motor} will restart: hold the shaft if a load pulls at it. Its whole turns may be lost (it reads {before})."
    ))?;
    restart(session, motor)?;
    let after = session.ask(motor, ReadMultiTurnAngle)?.angle;
    say(&restarted(motor, before, after))?;
    session.ready(motor).map(|_| ())
}

fn restarted(motor: MotorId, before: Angle, after: Angle) -> String {
    let degrees = after.degrees_f64() - before.degrees_f64();
    let lost = match (degrees / 360.0).round().abs() {
        0.0 => String::new(),
        1.0 => ": a whole turn was lost, and angles count from what it reads now".to_owned(),
        turns => {
            format!(": {turns} whole turns were lost, and angles count from what it reads now")
        }
    };
    format!("motor {motor} has restarted: it read {before} and reads {after}{lost}")
}

fn restart(session: &mut Session, motor: MotorId) -> Outcome {
    session.is_finished_first()?;
    session.standing(motor)?;
    bring_up::restart(&mut session.master, motor, motor)
        .map_err(|error| session.not_brought_up(error))
}

#[cfg(test)]
mod tests {
    use myactuator_host_std::sim::Fleet;
    use myactuator_host_std::sim::plant::Load;
    use myactuator_protocol_core::command::{BaudCode, ErrorFlags, SetBaudRate};
    use myactuator_protocol_core::drive::Quirks;
    use myactuator_protocol_core::io::Runner;
    use myactuator_protocol_core::time::Duration;

    use super::super::{
        odd_drive,
        simulated::{sent, turning},
    };
    use super::*;
    use crate::cli::Unfinished;

    #[test]
    fn restart_clears_an_error_whose_cause_is_gone() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        fleet.drives[0].with(|drive| drive.raise_fault(ErrorFlags::STALL));
        let later = session.master.now() + Duration::from_secs(2);
        session.wait_until(later).unwrap();
        assert!(session.ready(MotorId::MIN).is_err());
        fleet.drives[0].with(|drive| drive.clear_fault(ErrorFlags::all()));
        assert_eq!(restart(&mut session, MotorId::MIN), Ok(()));
        assert!(session.ready(MotorId::MIN).is_ok());
    }

    #[test]
    fn brake_holds_the_load_while_its_motor_restarts() {
        let load = Load { torque_nm: 5.0, ..Load::NONE };
        let quirks = Quirks { slow_brake: true, ..Quirks::default() };
        let fleet = Fleet::new(1).brakes(true).quirks(quirks).load(load).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        session.release_brake(MotorId::MIN).unwrap();
        let angle_deg = || fleet.drives[0].with(|drive| drive.plant().output_angle_deg());
        let held_deg = angle_deg();
        assert_eq!(restart(&mut session, MotorId::MIN), Ok(()));
        let sunk_deg = (angle_deg() - held_deg).abs();
        assert!(sunk_deg < 1.0, "{sunk_deg}");
    }

    #[test]
    fn silence_after_a_restart_with_a_new_bit_rate_hints_at_all_rates() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        let baud_rate = BaudCode::CAN_500K_RS485_115200;
        session.ask(MotorId::MIN, SetBaudRate { baud_rate }).unwrap();
        session.address = "slcan:/dev/ttyACM0@1000000".parse().unwrap();
        let message = restart(&mut session, MotorId::MIN);
        let Err(Unfinished::Failed(message)) = message else { panic!("{message:?}") };
        assert!(message.starts_with("motor 1 does not answer: check its power, "), "{message}");
        let hint = "'myactuator scan --all-rates --bus slcan:/dev/ttyACM0@1000000' tries";
        assert!(message.contains(hint), "{message}");
        let other_id = "its id ('myactuator scan --bus slcan:/dev/ttyACM0@1000000')";
        assert!(message.contains(other_id), "{message}");
    }

    #[test]
    fn whole_turns_lost_in_a_restart_are_reported() {
        let message = |before, after| {
            restarted(MotorId::MIN, Angle::from_raw(before), Angle::from_raw(after))
        };
        let same = "motor 1 has restarted: it read 92.32 deg and reads 92.31 deg";
        assert_eq!(message(9_232, 9_231), same);
        let lost = "motor 1 has restarted: it read 192.32 deg and reads -167.68 deg: a whole turn was lost, and angles \
                    count from what it reads now";
        assert_eq!(message(19_232, -16_768), lost);
        assert!(message(-200_000, -19_998).contains(": 5 whole turns were lost"));
    }

    #[test]
    fn a_turning_motor_is_not_restarted() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let mut session = turning(&fleet);
        let log = fleet.world.log();
        // The user is not asked about it. A motor that begins to turn meanwhile is not restarted, either.
        for message in [run_on, restart].map(|reset| reset(&mut session, MotorId::MIN)) {
            let Err(Unfinished::Failed(message)) = message else { panic!("{message:?}") };
            assert!(
                message.starts_with("motor 1 turns at 1")
                    && message.ends_with("stop it first, and wait until it stands"),
                "{message}"
            );
            assert!(sent(&log).iter().all(|packet| packet.data[0] != 0x76));
        }
    }

    #[test]
    fn motor_whose_run_time_goes_on_has_not_restarted() {
        let (fleet, drive) = odd_drive::alone();
        drive.lock().unwrap().run_time_ms = 50_000;
        let message = restart(&mut Session::on(&fleet), MotorId::MIN);
        let Err(Unfinished::Failed(message)) = message else { panic!("{message:?}") };
        assert!(
            message.starts_with("motor 1 was told to restart and goes on running"),
            "{message}"
        );
    }
}
