//! `myactuator timeout`: the motor's own communication-loss protection.

use myactuator_protocol_core::io::bring_up::{self, Protection};
use myactuator_protocol_core::units::Milliseconds;
use myactuator_protocol_core::{MotorId, Opcode};

use super::help::SIGNALS;
use super::session::{OneMotor, Session, say};
use crate::cli::{Outcome, arguments as parse, report};

/// Below this time, a motor may hear nothing from this program for longer.
const SHORT_MS: u32 = 50;

/// Set after how long without a command a motor cuts its output on its own (0xB3)
///
/// This communication-loss protection stops a motor when its master is killed or the bus is cut. The motor stores the
/// time in its ROM. Ctrl-C ends this program when the motor has acknowledged.
///
/// A motor that holds its position lets go, too, when it hears nothing for that time; a brake locks then. While this
/// program moves a motor it sends every 10 to 20 ms, and less often on a busy machine: below 50 ms the protection may
/// end a movement.
///
/// A motor that turns is refused: stop it first. So are two motors with the same id.
///
/// Exit status: 0 acknowledged, 1 not, 2 wrong usage.
#[derive(Debug, clap::Args)]
#[command(after_help = SIGNALS)]
pub(in crate::cli) struct Arguments {
    #[command(flatten)]
    motor: OneMotor,
    /// The time, ms; 0 switches the protection off.
    #[arg(long, value_parser = parse::milliseconds, allow_hyphen_values = true)]
    time_ms: Milliseconds,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let mut session = arguments.motor.open_to_send(Opcode::CommunicationLossProtection)?;
    run_on(&mut session, arguments.motor.id, arguments.time_ms)
}

fn run_on(session: &mut Session, motor: MotorId, time: Milliseconds) -> Outcome {
    session.standing(motor)?;
    note_short(time);
    session.confirm(motor, &question(motor, time))?;
    protect(session, motor, time)
}

fn protect(session: &mut Session, motor: MotorId, time: Milliseconds) -> Outcome {
    session.is_finished_first()?;
    let told = bring_up::protect(&mut session.master, motor, time);
    let told = told.map_err(|error| session.not_brought_up(error))?;
    say(&sentence(motor, time, told))
}

/// Prints a note about a time that is short for this program itself.
fn note_short(time: Milliseconds) {
    if (1..SHORT_MS).contains(&time.raw()) {
        report(
            "note",
            format!(
                "below {SHORT_MS} ms the protection may end a movement of this program: it sends every 10 to 20 ms, and \
                 less often on a busy machine"
            ),
        );
    }
}

fn question(motor: MotorId, time: Milliseconds) -> String {
    match time.raw() {
        0 => format!("Motor {motor} will go on with what it does when it hears nothing any more."),
        _ => format!(
            "Motor {motor} will cut its output when it hears nothing for {time}, also while it holds still or a position \
             and no program runs: a load can fall then."
        ),
    }
}

fn sentence(motor: MotorId, time: Milliseconds, told: Protection) -> String {
    let set = match time.raw() {
        0 => format!("motor {motor}: the communication-loss protection is off"),
        _ => format!(
            "motor {motor} cuts its output when it hears nothing for {time}: try it before you rely on it"
        ),
    };
    match told {
        Protection::Confirmed => set,
        Protection::AcknowledgedOnly(other) => format!(
            "motor {motor} has acknowledged {time} with {other}, and the setting cannot be read back: stop \
             sending, and see what the motor does"
        ),
    }
}

#[cfg(test)]
mod tests {
    use myactuator_host_std::sim::Fleet;

    use super::super::simulated::{sent, turning};
    use super::*;
    use crate::cli::Unfinished;

    #[test]
    fn a_turning_motor_gets_no_protection() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let mut session = turning(&fleet);
        let log = fleet.world.log();
        // The user is not asked about it. To a motor that begins to turn meanwhile nothing is written, either.
        for set in [run_on, protect] {
            let outcome = set(&mut session, MotorId::MIN, Milliseconds::from_raw(500));
            let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
            assert!(
                message.starts_with("motor 1 turns at 1")
                    && message.ends_with("stop it first, and wait until it stands"),
                "{message}"
            );
            assert!(sent(&log).iter().all(|packet| packet.data[0] != 0xB3));
        }
    }

    #[test]
    fn question_before_a_protection_says_that_it_ends_a_hold() {
        let asked = |millis| question(MotorId::MIN, Milliseconds::from_raw(millis));
        assert!(asked(100).contains("also while it holds still or a position"), "{}", asked(100));
        assert!(!asked(0).contains("hold"), "{}", asked(0));
    }

    #[test]
    fn protection_that_was_only_acknowledged_is_not_reported_as_set() {
        let message = |protection| sentence(MotorId::MIN, Milliseconds::from_raw(500), protection);
        assert!(
            message(Protection::Confirmed).starts_with("motor 1 cuts its output when it hears")
        );
        let doubt = message(Protection::AcknowledgedOnly(Milliseconds::from_raw(0)));
        assert!(doubt.starts_with("motor 1 has acknowledged 500 ms with 0 ms"), "{doubt}");
    }
}
