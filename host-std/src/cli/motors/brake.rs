//! `myactuator brake`: releases or locks the holding brake.

use clap::ValueEnum;
use myactuator_host_std::open::BusError;
use myactuator_protocol_core::command::{BrakeCommand, ReadStatus1, ReleaseBrake};
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::io::bring_up::{self, BRAKE_MOVES, BringUpError};
use myactuator_protocol_core::master::StopKind;
use myactuator_protocol_core::{MotorId, Opcode};

use super::help::SIGNALS;
use super::moving::{LONGEST_WAIT, told_with_stop};
use super::session::{OneMotor, Session, say};
use crate::cli::{Outcome, Unfinished, report};

/// Release or lock a motor's brake
///
/// A release lets the shaft go, and a load with it, so two motors with the same id are refused. 'speed' and 'move' send
/// none: simulated drives open the brake for them, and hold; the manual does not say whether real ones do. Ctrl-C ends
/// a release at once.
///
/// A lock is refused while the motor turns and runs something: stop it first. After a lock the shaft must stand. If it
/// does not, and the motor held it before, the brake is opened again and the motor holds (0x77, 0x81). Ctrl-C ends this
/// program when the lock is finished.
///
/// A release is done when the motor has acknowledged it; a lock when the motor also reports it, and its shaft stands.
///
/// Exit status: 0 done, 1 not, 2 wrong usage.
#[derive(Debug, clap::Args)]
#[command(after_help = SIGNALS)]
pub(in crate::cli) struct Arguments {
    /// What to do with it.
    #[arg(value_enum)]
    action: Action,
    #[command(flatten)]
    motor: OneMotor,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Action {
    /// Let the shaft go (0x77): a load can turn it then.
    Release,
    /// Hold the shaft (0x78).
    Lock,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let motor = arguments.motor.id;
    match arguments.action {
        Action::Release => {
            let mut session = arguments.motor.open_to_send(Opcode::ReleaseBrake)?;
            session.ask(motor, ReadStatus1)?;
            session.confirm(
                motor,
                &format!("Motor {motor}'s brake will let the shaft go: a load can turn it then."),
            )?;
            if session.let_go(motor)? {
                say(&format!(
                    "motor {motor}: brake released: a load can turn its shaft now, unless the motor holds it"
                ))
            } else {
                say(&format!("motor {motor}: the release of its brake is acknowledged (0x77)"))
            }
        }
        Action::Lock => lock(&mut Session::open_at_once(&arguments.motor.on)?, motor),
    }
}

fn lock(session: &mut Session, motor: MotorId) -> Outcome {
    match session.lock_brake(motor)? {
        Lock::Holds => say(&format!("motor {motor}: brake locked")),
        Lock::IsNotThere => Err(Unfinished::Failed(format!(
            "motor {motor}: the brake was told to lock (0x78), but the motor does not report that: it may have no brake"
        ))),
        Lock::Slips { why, holds: None } => Err(session.hold_again(motor, why)),
        Lock::Slips { why, .. } => Err(why),
    }
}

/// The result of locking a brake.
pub(super) enum Lock {
    Holds,
    /// The motor does not report the lock: it has no brake.
    IsNotThere,
    /// The shaft turns behind the brake. `holds`: whether its motor holds it again, if known.
    Slips {
        why: Unfinished,
        holds: Option<bool>,
    },
}

/// What has failed after a brake was told to open.
fn half_open(error: Unfinished) -> Unfinished {
    match error {
        Unfinished::Failed(told) => {
            Unfinished::Failed(format!("{told}; its brake may be open even so"))
        }
        other => other,
    }
}

impl Session {
    /// Lets the motor hold, releases its brake, and waits until that is open.
    pub(super) fn release_brake(&mut self, motor: MotorId) -> Outcome {
        let outcome = bring_up::release_brake(&mut self.master, motor);
        self.unless_half_open(outcome)
    }

    /// Releases the brake and holds again, after the motor was switched off or its brake slips. Returns `why` with the
    /// state of the motor.
    pub(super) fn hold_again(&mut self, motor: MotorId, why: Unfinished) -> Unfinished {
        self.master.off = self.master.off.without(motor.into());
        self.master.master().lift_stop_of(motor);
        // No drive holds behind a locked brake. An error changes nothing: the brake may be open even so.
        let _ = bring_up::release_brake(&mut self.master, motor);
        told_with_stop(why, self.stopped_by(StopKind::Hold, motor.into()))
    }

    /// Releases a brake and lets the shaft go. Returns whether the motor reports an open brake. Prints a warning if it
    /// has acknowledged the command but still reports "lock".
    fn let_go(&mut self, motor: MotorId) -> Outcome<bool> {
        // A motor that has lost its master obeys the third command (2.31.1).
        self.ask(motor, ReadStatus1)?;
        self.ask(motor, ReadStatus1)?;
        let told = self.master.ask(motor, ReleaseBrake).map(drop).map_err(BringUpError::Call);
        self.unless_half_open(told)?;
        let says = self.brake_has_moved(motor).map_err(half_open)?;
        if says != BrakeCommand::RELEASE {
            warn_of(motor, says);
        }
        Ok(says == BrakeCommand::RELEASE)
    }

    /// Waits until a brake has had the time to move, and returns what its motor reports of it.
    fn brake_has_moved(&mut self, motor: MotorId) -> Outcome<BrakeCommand> {
        let moved = self.master.now() + BRAKE_MOVES;
        // In a silence the protection would lock the brake again.
        while self.master.now() < moved {
            self.ask(motor, ReadStatus1)?;
            self.wait_until(self.master.now() + LONGEST_WAIT)?;
        }
        Ok(self.ask(motor, ReadStatus1)?.brake)
    }

    fn unless_half_open(&mut self, outcome: Result<(), BringUpError<BusError>>) -> Outcome {
        outcome.map_err(|error| match error {
            BringUpError::Call(error) => half_open(self.failed(error)),
            error => error.into(),
        })
    }

    /// Locks the brake of a motor that stands, waits until it has had the time to, and checks whether it holds. If not,
    /// a motor that held before holds again, unless a stop refuses that.
    pub(super) fn lock_brake(&mut self, motor: MotorId) -> Outcome<Lock> {
        let outcome = bring_up::lock_brake(&mut self.master, motor);
        self.locked(outcome)
    }

    /// Checks a locked brake again, after its motor was switched off.
    pub(super) fn check_brake(&mut self, motor: MotorId) -> Outcome<Lock> {
        let outcome = bring_up::check_brake(&mut self.master, motor);
        self.locked(outcome)
    }

    fn locked(&mut self, outcome: Result<(), BringUpError<BusError>>) -> Outcome<Lock> {
        match outcome {
            Ok(()) => Ok(Lock::Holds),
            Err(BringUpError::BrakeNotLocked { .. }) => Ok(Lock::IsNotThere),
            Err(error @ BringUpError::BrakeSlips { holds, .. }) => {
                Ok(Lock::Slips { why: error.into(), holds })
            }
            Err(BringUpError::Call(error)) => Err(self.failed(error)),
            Err(error) => Err(error.into()),
        }
    }
}

fn warn_of(motor: MotorId, says: BrakeCommand) {
    report(
        "warning",
        format!(
            "motor {motor} has acknowledged the release of its brake (0x77) but still reports {says}, \
             as firmware 2025070202 does while it obeys no command: check that the shaft is free"
        ),
    );
}

#[cfg(test)]
mod tests {
    use myactuator_host_std::sim::Fleet;
    use myactuator_protocol_core::command::Stop;
    use myactuator_protocol_core::drive::Quirks;
    use myactuator_protocol_core::time::Duration;
    use myactuator_protocol_core::units::Milliseconds;

    use super::super::odd_drive;
    use super::super::simulated::sent;
    use super::*;

    /// Checks that a motor holds its load again if its brake slips this long after a lock.
    fn is_held_again(mode: Option<u8>, slips_after_ms: u64) {
        let (fleet, drive) = odd_drive::alone();
        let mut is = drive.lock().unwrap();
        (is.mode, is.draws, is.is_open) = (mode, true, true);
        is.slips_after = Some(Duration::from_millis(slips_after_ms));
        drop(is);
        let outcome = lock(&mut Session::on(&fleet), MotorId::MIN);
        let case = format!("mode {mode:?}, {slips_after_ms} ms: {outcome:?}");
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{case}") };
        assert!(
            message.ends_with("it is open again, and the motor holds: do not switch it off"),
            "{case}"
        );
        let is = drive.lock().unwrap();
        let locked = is.received.iter().position(|byte| *byte == 0x78).unwrap();
        let mut then =
            is.received[locked..].iter().copied().filter(|byte| matches!(byte, 0x76..=0x81));
        assert_eq!([then.next(), then.next(), then.next()], [0x78, 0x77, 0x81].map(Some), "{case}");
        assert!(is.is_open, "{case}");
    }

    #[test]
    fn motor_holds_its_load_again_whenever_its_brake_is_seen_to_slip() {
        for slips_after_ms in [100, 300] {
            is_held_again(Some(3), slips_after_ms);
            // All that is known is that it draws a current.
            is_held_again(None, slips_after_ms);
        }
    }

    /// The brake slips, so it is released for the motor to hold the load; the drive ignores the first three tries.
    #[test]
    fn brake_whose_release_is_not_confirmed_is_released_once_more() {
        let (fleet, drive) = odd_drive::alone();
        let mut is = drive.lock().unwrap();
        (is.mode, is.is_open, is.ignored_releases) = (Some(3), true, 3);
        is.slips_after = Some(Duration::from_millis(100));
        drop(is);
        let outcome = lock(&mut Session::on(&fleet), MotorId::MIN);
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        assert!(message.contains("not confirmed that it is open again"), "{message}");
        assert!(message.contains("motor 1 is stopped and holds still (0x81)"), "{message}");
        assert!(drive.lock().unwrap().is_open);
    }

    #[test]
    fn idle_motor_gets_no_brake_release_when_its_brake_slips() {
        let (fleet, drive) = odd_drive::alone();
        let mut is = drive.lock().unwrap();
        (is.mode, is.is_open) = (Some(0), true);
        is.slips_after = Some(Duration::from_millis(300));
        drop(is);
        let Err(Unfinished::Failed(message)) = lock(&mut Session::on(&fleet), MotorId::MIN) else {
            panic!("it slips");
        };
        assert!(message.ends_with("does not hold: the shaft turns at 50 dps"), "{message}");
        assert!(!drive.lock().unwrap().received.contains(&0x77));
    }

    #[test]
    fn brake_reported_locked_after_acknowledged_release_is_no_failure() {
        let quirks = Quirks { brake_told_by_motion: true, ..Quirks::default() };
        let fleet = Fleet::new(1).brakes(true).quirks(quirks).on_can(1_000_000).unwrap();
        let log = fleet.world.log();
        let mut session = Session::on(&fleet);
        assert_eq!(session.let_go(MotorId::MIN), Ok(false));
        assert!(sent(&log).iter().any(|packet| packet.data[0] == 0x77));
        // A motor that does not acknowledge it is a failure.
        let nobody = MotorId::new(9).unwrap();
        assert!(matches!(session.let_go(nobody), Err(Unfinished::Failed(_))));
        // While the motor holds, it reports an open brake.
        assert_eq!(session.release_brake(MotorId::MIN), Ok(()));
    }

    #[test]
    fn motor_that_has_lost_its_master_obeys_the_release() {
        let fleet = Fleet::new(1).brakes(true).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        let protection = Milliseconds::from_raw(100);
        bring_up::protect(&mut session.master, MotorId::MIN, protection).unwrap();
        // Its protection ends that.
        session.master.ask(MotorId::MIN, Stop).unwrap();
        fleet.world.run_for(Duration::from_millis(150));
        // Longer than the protection, which would lock the brake again.
        assert!(BRAKE_MOVES > Duration::from_millis(100));
        assert_eq!(session.let_go(MotorId::MIN), Ok(true));
        assert!(fleet.drives[0].with(|drive| drive.state().brake == BrakeCommand::RELEASE));
    }

    #[test]
    fn a_motor_that_falls_silent_after_its_release_may_have_an_open_brake() {
        let fleet = Fleet::new(1).brakes(true).faults(["cut@1+20ms".parse().unwrap()]);
        let fleet = fleet.on_can(1_000_000).unwrap();
        let outcome = Session::on(&fleet).let_go(MotorId::MIN);
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        assert!(message.ends_with("its brake may be open even so"), "{message}");
        assert_eq!(fleet.drives[0].with(|drive| drive.state().brake), BrakeCommand::RELEASE);
    }
}
