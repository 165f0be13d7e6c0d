//! `myactuator zero`: makes the present position the zero, for good.

use myactuator_protocol_core::command::ReadMultiTurnAngle;
use myactuator_protocol_core::io::bring_up;
use myactuator_protocol_core::{MotorId, Opcode};

use super::help::SIGNALS;
use super::session::{OneMotor, Session, say};
use crate::cli::Outcome;

/// Make a motor's present position its zero, and check that it is kept
///
/// If the motor has a brake that is open, it is locked (0x78). The motor is switched off (0x80), stores its position as
/// zero in its ROM (0x64) and restarts (0x76). Then zero and angle are read back. Ctrl-C ends this program when that is
/// finished.
///
/// A motor that turns is refused: stop it first. So are two motors with the same id.
///
/// Exit status: 0 zero kept, 1 not, 2 wrong usage.
#[derive(Debug, clap::Args)]
#[command(after_help = SIGNALS)]
pub(in crate::cli) struct Arguments {
    #[command(flatten)]
    motor: OneMotor,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let motor = arguments.motor.id;
    let mut session = arguments.motor.open_to_send(Opcode::SetCurrentPositionZero)?;
    session.standing(motor)?;
    let before = session.ask(motor, ReadMultiTurnAngle)?.angle;
    session.confirm(motor, &format!(
        "Motor {motor} will be switched off, make its present position ({before}) the zero in its ROM, and restart: hold the shaft if a load pulls at it."
    ))?;
    say(&make(&mut session, motor)?)
}

/// Makes the zero, and returns it in words.
fn make(session: &mut Session, motor: MotorId) -> Outcome<String> {
    session.is_finished_first()?;
    let before = session.ask(motor, ReadMultiTurnAngle)?.angle;
    let offset = bring_up::zero_here(&mut session.master, motor)
        .map_err(|error| session.not_brought_up(error))?;
    let after = session.ask(motor, ReadMultiTurnAngle)?.angle;
    Ok(format!(
        "motor {motor}: what was {before} is the zero (offset {offset}); after its restart the motor reads {after}"
    ))
}

#[cfg(test)]
mod tests {
    use myactuator_host_std::sim::Fleet;
    use myactuator_protocol_core::command::AbsolutePosition;
    use myactuator_protocol_core::io::Runner;
    use myactuator_protocol_core::time::Duration;
    use myactuator_protocol_core::units::{Angle, MaxSpeed};

    use super::super::simulated::{sent, turning};
    use super::*;
    use crate::cli::Unfinished;

    #[test]
    fn a_motor_that_begins_to_turn_while_the_user_is_asked_gets_no_zero() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let mut session = turning(&fleet);
        let log = fleet.world.log();
        let message = make(&mut session, MotorId::MIN).unwrap_err();
        assert!(
            matches!(&message, Unfinished::Failed(message) if message.contains("turns at 1")),
            "{message:?}"
        );
        assert!(sent(&log).iter().all(|packet| packet.data[0] >= 0x90), "something was written");
    }

    #[test]
    fn current_position_becomes_the_zero() {
        let mut session = Session::on(&Fleet::new(1).on_can(1_000_000).unwrap());
        let (max_speed, angle) = (MaxSpeed::from_raw(360), Angle::from_raw(3_000));
        session.ask(MotorId::MIN, AbsolutePosition { max_speed, angle }).unwrap();
        let arrived = session.master.now() + Duration::from_secs(2);
        session.wait_until(arrived).unwrap();
        let message = make(&mut session, MotorId::MIN).unwrap();
        // It arrives within 0.1 degrees, and stays there while its output is off.
        let degrees = |behind| -> f64 {
            let (_, rest) = message.split_once(behind).unwrap();
            rest.split(' ').next().unwrap().parse().unwrap()
        };
        assert!((degrees("what was ") - 30.0).abs() < 0.1, "{message}");
        assert!(degrees("the motor reads ").abs() < 0.1, "{message}");
    }
}
