//! A bus while a command uses it: opens it, asks before anything moves, and ends with one sentence.

use std::io::{self, BufRead, IsTerminal, Write};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use myactuator_host_std::BusKind;
use myactuator_host_std::open::{AnyMaster, BusAddress, BusError};
use myactuator_host_std::port::SlowAdapter;
#[cfg(test)]
use myactuator_host_std::sim::CanFleet;
use myactuator_protocol_core::command::{Command, ReadStatus1, ReadStatus2, Status1};
use myactuator_protocol_core::error::RequestError;
use myactuator_protocol_core::io::bring_up::{self, BringUpError};
use myactuator_protocol_core::io::{CallError, Runner};
use myactuator_protocol_core::master::{Config, Event, MotorSet};
use myactuator_protocol_core::opcode::Repeat;
use myactuator_protocol_core::{Kind, MotorId, Opcode, Target};
use rustix::process::getpgrp;
use rustix::termios::{QueueSelector, tcflush, tcgetpgrp};

use super::elsewhere::{Watched, stopped_elsewhere};
use super::moving::LONGEST_WAIT;
use super::on_bus::OnBus;
use crate::cli::arguments as parse;
pub(super) use crate::cli::say;
use crate::cli::{Outcome, Unfinished, interrupt, outcome, printable, printer, report, unwritten};

/// What was typed before a question does not answer it.
fn forget_typed() {
    let stdin = io::stdin();
    // That would halt a program in the background.
    let is_in_background = tcgetpgrp(&stdin).is_ok_and(|foreground| foreground != getpgrp());
    if !is_in_background {
        // It fails if it is no terminal, but for example a pipe, which may hold the answer.
        let _ = tcflush(&stdin, QueueSelector::IFlush);
    }
}

/// Whether the user has already said yes.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(super) struct Consent {
    /// Do not ask before a motor moves or its memory is written: for scripts.
    #[arg(long, short, global = true)]
    pub(super) yes: bool,
}

/// Which motor, and whether it may be moved or written to.
#[derive(Debug, clap::Args)]
pub(super) struct OneMotor {
    #[command(flatten)]
    pub(super) on: OnBus,
    /// The motor, 1 to 32.
    #[arg(long, value_parser = parse::motor_id, allow_hyphen_values = true)]
    pub(super) id: MotorId,
    #[command(flatten)]
    pub(super) consent: Consent,
}

impl OneMotor {
    /// Opens its bus to send the motor a command that needs consent.
    pub(super) fn open_to_send(&self, opcode: Opcode) -> Outcome<Session> {
        let mut session = Session::open_to_change(&self.on, self.consent)?;
        session.look_for_two(self.id, opcode.into())?;
        Ok(session)
    }
}

/// Whether the user is asked before a command of this kind is sent: it may move a shaft, let it go or write memory.
pub(super) fn needs_consent(kind: Kind) -> bool {
    kind.is_refused_while_stopped() || kind.repeat() == Repeat::ActsAgain || sets_gains(kind)
}

/// Gains take effect at once, those in ROM too.
pub(super) fn sets_gains(kind: Kind) -> bool {
    matches!(kind, Kind::Known(Opcode::WritePidRam | Opcode::WritePidRom))
}

/// Which motors.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Motors {
    #[command(flatten)]
    pub(super) on: OnBus,
    /// The motor, 1 to 32, or all.
    #[arg(long, value_parser = parse::target, allow_hyphen_values = true, default_value = "all")]
    pub(super) id: Target,
}

/// Which motors are to be stopped.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct ToStop {
    #[command(flatten)]
    pub(super) motors: Motors,
    /// Accepted for scripts that give it to every command: a stop never asks.
    #[arg(long = "yes", short = 'y')]
    _yes: bool,
}

impl Consent {
    /// Fails if the user has not consented and cannot be asked.
    pub(super) fn check(self, bus: &BusAddress) -> Outcome {
        if self.yes || bus.is_simulated() || io::stdin().is_terminal() {
            return Ok(());
        }
        Err(Unfinished::Usage(
            "--yes is missing: this moves a motor or writes its memory, and there is no terminal to ask on"
                .to_owned(),
        ))
    }
}

impl Unfinished {
    /// A scan has failed. The motor that it asked last need not exist, so it is not named.
    pub(super) fn of_scan(error: CallError<BusError>) -> Self {
        match error {
            CallError::Failed { failure, .. } => Self::Failed(failure.to_string()),
            CallError::Refused { refusal, .. } => Self::Failed(refusal.to_string()),
            error => error.into(),
        }
    }
}

impl From<BusError> for Unfinished {
    fn from(error: BusError) -> Self {
        Self::Failed(error.to_string())
    }
}

impl From<BringUpError<BusError>> for Unfinished {
    fn from(error: BringUpError<BusError>) -> Self {
        match error {
            BringUpError::Call(CallError::Bus(error)) => error.into(),
            BringUpError::Call(CallError::Refused { motor, refusal: RequestError::Restarted }) => {
                Self::Failed(format!(
                    "motor {motor} has restarted, or was silent for so long that it may have: its turns may be lost, \
                     so check its angle before you move it again"
                ))
            }
            error => Self::Failed(error.to_string()),
        }
    }
}

impl From<CallError<BusError>> for Unfinished {
    fn from(error: CallError<BusError>) -> Self {
        BringUpError::Call(error).into()
    }
}

/// A bus in use.
#[derive(Debug)]
pub(super) struct Session {
    pub(super) master: Watched,
    pub(super) address: BusAddress,
    pub(super) yes: bool,
    /// Set by Ctrl-C and the like while a motor moves.
    pub(super) interrupted: Arc<AtomicBool>,
    /// Set by them, too; cleared when the motor is stopped, so that it shows a second one.
    pub(super) again: Arc<AtomicBool>,
    /// How often garbled bytes were the answers of several motors to a command to all.
    pub(super) garbled_by_all: u32,
}

impl Session {
    /// Opens a bus to read from its motors.
    pub(super) fn open(on: &OnBus) -> Outcome<Self> {
        Self::open_on(on.to_look()?)
    }

    /// Opens a bus to end the motion of its motors. That needs no consent, and Ctrl-C and the like do not end it: it is
    /// short.
    pub(super) fn open_at_once(on: &OnBus) -> Outcome<Self> {
        // The command goes out even if signals cannot be watched for.
        let _ = interrupt::watch();
        Self::open_on(on.to_act()?)
    }

    /// The same, to stop them.
    pub(super) fn open_to_stop(on: &OnBus) -> Outcome<Self> {
        Self::open_at_once(on).map_err(|why| match why {
            Unfinished::Failed(why) => Unfinished::Failed(format!(
                "{why}; no motor was told to stop: if one must stop now, cut its power"
            )),
            other => other,
        })
    }

    fn open_on(address: BusAddress) -> Outcome<Self> {
        let config = address.config();
        let session = Self::open_with(address, config)?;
        session.note_slow_adapter();
        Ok(session)
    }

    /// Says how an adapter that is slow gets faster.
    pub(super) fn note_slow_adapter(&self) {
        if let Some(slow) = self.address.serial_port().and_then(SlowAdapter::at) {
            report("note", slow);
        }
    }

    /// Opens a bus with this configuration.
    pub(super) fn open_with(address: BusAddress, config: Config) -> Result<Self, BusError> {
        let master = AnyMaster::open_with(&address, config)?;
        if let BusAddress::Simulated { motors, kind } = &address {
            let kind = match kind {
                BusKind::Can => "a CAN bus",
                BusKind::Rs485 => "an RS485 line",
            };
            report(
                "simulated drives",
                format!(
                    "{motors} on {kind}, new in each run; --bus or MYACTUATOR_BUS names a real bus"
                ),
            );
        }
        Ok(Self {
            master: Watched::new(master),
            address,
            yes: false,
            interrupted: interrupt::flag(),
            again: interrupt::again(),
            garbled_by_all: 0,
        })
    }

    /// Opens a bus to move its motors or write their memory, if the user has consented or can be asked.
    pub(super) fn open_to_change(on: &OnBus, consent: Consent) -> Outcome<Self> {
        let address = on.to_act()?;
        consent.check(&address)?;
        Ok(Self { yes: consent.yes, ..Self::open_on(address)? })
    }

    /// A session on simulated drives, for tests.
    #[cfg(test)]
    pub(super) fn on(fleet: &CanFleet) -> Self {
        Self::by(AnyMaster::SimulatedCan(fleet.master()))
    }

    /// A session with this master, for tests.
    #[cfg(test)]
    pub(super) fn by(master: AnyMaster<{ MotorId::COUNT }>) -> Self {
        Self {
            master: Watched::new(master),
            address: BusAddress::Simulated { motors: 1, kind: BusKind::Can },
            yes: true,
            interrupted: Arc::default(),
            again: Arc::default(),
            garbled_by_all: 0,
        }
    }

    /// Asks the user whether to do this with these motors, unless there is consent or they are simulated. What has
    /// arrived meanwhile answers nothing that follows.
    ///
    /// # Errors
    /// The user does not want it, or another program has stopped one of the motors meanwhile.
    pub(super) fn confirm(&mut self, motors: impl Into<MotorSet>, what: &str) -> Outcome {
        if self.yes || self.address.is_simulated() {
            return Ok(());
        }
        // Notes come before the question.
        let _ = printer::ERR.wait_for(outcome::IN_ORDER);
        forget_typed();
        let mut ask = io::stderr().lock();
        write!(ask, "{} Go on? [y/N] ", printable(what)).map_err(|error| unwritten(&error))?;
        let mut answer = String::new();
        io::stdin().lock().read_line(&mut answer).map_err(|error| unwritten(&error))?;
        if matches!(answer.trim().to_ascii_lowercase().as_str(), "y" | "yes") {
            self.take_what_waits(motors.into())
        } else {
            Err(Unfinished::Failed("not confirmed, so nothing was done".to_owned()))
        }
    }

    /// Takes what has arrived since the bus was last looked at.
    ///
    /// # Errors
    /// Another program has stopped one of these motors.
    fn take_what_waits(&mut self, motors: MotorSet) -> Outcome {
        let soon = self.master.now() + LONGEST_WAIT;
        let mut stopped = MotorSet::EMPTY;
        self.master.run_until(soon, |event| {
            stopped_elsewhere(&event).into_iter().for_each(|motor| stopped.insert(motor));
        })?;
        match motors.iter().find(|motor| stopped.contains(*motor)) {
            Some(motor) => Err(Unfinished::Failed(format!(
                "something else on this bus has stopped motor {motor} meanwhile, so nothing was done"
            ))),
            None => Ok(()),
        }
    }

    pub(super) fn ask<C: Command>(&mut self, motor: MotorId, command: C) -> Outcome<C::Reply> {
        self.master.ask(motor, command).map_err(|error| self.failed(error))
    }

    /// Whether two motors seem to have this id.
    pub(super) fn is_shared(&mut self, motor: MotorId) -> Outcome<bool> {
        self.ask(motor, ReadStatus2)?;
        let mut answers_again = false;
        let hear = |event| {
            answers_again |= matches!(event, Event::Stray { motor: who, .. } if who == motor);
        };
        // Meanwhile a second motor would answer the first question.
        let status = self.master.ask_with(motor, ReadStatus1, None, hear);
        status?;
        // A closer look takes half a second, so it needs a reason.
        Ok(answers_again && bring_up::is_shared(&mut self.master, motor)?)
    }

    /// Says so if two motors seem to have this id, and returns what was said.
    pub(super) fn note_shared(&mut self, motor: MotorId) -> Option<String> {
        let note = (self.is_shared(motor) == Ok(true)).then(|| shared(motor))?;
        report("note", &note);
        Some(note)
    }

    /// Before a command that needs consent: checks whether two motors have this id, since both would obey.
    ///
    /// - A command that does not move is refused then. The answer of one motor says nothing about the other, which may
    ///   drop a load or store what was meant for one.
    /// - A command that moves is sent, with a note. The answers of both are watched, and one stop stops both. Another
    ///   program that asks the motor looks the same.
    /// - There is no check before 0xB6: it ends reports, which look like a second motor.
    pub(super) fn look_for_two(&mut self, motor: MotorId, kind: Kind) -> Outcome {
        if !needs_consent(kind) || kind == Opcode::ActiveReply.into() {
            return Ok(());
        }
        if !kind.moves() {
            return self.refuse_shared(motor);
        }
        // If the motor does not answer, the next question reports that.
        if self.is_shared(motor) == Ok(true) {
            report("note", format!("{}. Both will do this", shared(motor)));
        }
        Ok(())
    }

    /// Fails if two motors seem to have this id, after a closer look.
    fn refuse_shared(&mut self, motor: MotorId) -> Outcome {
        // If nothing answers, that is the error.
        self.ask(motor, ReadStatus2)?;
        match bring_up::is_shared(&mut self.master, motor) {
            Ok(false) => Ok(()),
            Ok(true) => Err(Unfinished::Failed(format!(
                "{} (one motor looks like two if another program asks it, too, or if its active reply (0xB6) is on: end that){}",
                shared(motor),
                self.echo_told_of()
            ))),
            Err(error) => Err(self.failed(error)),
        }
    }

    /// The motors that are meant: one, or all that answer.
    pub(super) fn meant(&mut self, target: Target) -> Outcome<MotorSet> {
        match target {
            Target::Motor(motor) => Ok(motor.into()),
            Target::All => {
                let found = bring_up::scan(&mut self.master, MotorSet::ALL, |_, _| {})
                    .map_err(Unfinished::of_scan)?;
                if found.is_empty() {
                    return Err(self.nobody());
                }
                self.note_garbled();
                Ok(found)
            }
        }
    }

    /// Reads a motor's state. Fails if the motor reports errors.
    pub(super) fn ready(&mut self, motor: MotorId) -> Outcome<Status1> {
        let status = self.ask(motor, ReadStatus1)?;
        self.healthy(motor, status.errors)?;
        Ok(status)
    }

    /// From now on Ctrl-C and the like only set flags; the work ends where it looks at them.
    pub(super) fn is_not_left_halfway(&self) -> Outcome {
        interrupt::watch()
            .map_err(|error| Unfinished::Failed(format!("cannot watch for Ctrl-C: {error}")))
    }

    /// From now on Ctrl-C and the like end nothing on this bus. A note says at once that they end the program when this
    /// is done.
    pub(super) fn is_finished_first(&mut self) -> Outcome {
        self.is_not_left_halfway()?;
        self.master.finished_first = Some(self.interrupted.clone());
        Ok(())
    }

    /// Fails if the motor turns.
    pub(super) fn standing(&mut self, motor: MotorId) -> Outcome {
        let speed = self.ask(motor, ReadStatus2)?.speed;
        if bring_up::turns(speed) {
            Err(BringUpError::Turns { motor, speed }.into())
        } else {
            Ok(())
        }
    }
}

/// Says that two motors seem to have this id.
pub(super) fn shared(id: MotorId) -> String {
    format!("two motors seem to have id {id}: connect only one of them")
}

#[cfg(test)]
mod tests {
    use myactuator_host_std::port::PortError;
    use myactuator_host_std::sim::Fleet;
    use myactuator_protocol_core::command::{ErrorFlags, FunctionControl, Switch};
    use myactuator_protocol_core::opcode::ReplyRule;
    use myactuator_protocol_core::time::Duration;

    use super::super::simulated::{OtherMaster, Sends, echo_is_missing, sent, to_first};
    use super::*;

    /// The outcome of a check before this command to motor 1, and whether anything was sent.
    fn look(fleet: &Fleet, kind: impl Into<Kind>) -> (Outcome, bool) {
        let fleet = fleet.on_can(1_000_000).unwrap();
        let log = fleet.world.log();
        let outcome = Session::on(&fleet).look_for_two(MotorId::MIN, kind.into());
        (outcome, !sent(&log).is_empty())
    }

    #[test]
    fn shared_id_check_refuses_writes_looks_before_moves_and_skips_reads() {
        use Opcode::{
            ActiveReply, CommunicationLossProtection, FunctionControl, IncrementalPosition,
            LockBrake, Motion, ReadPid, ReadStatus1, ReleaseBrake, Reset, SetBaudRate,
            SetEncoderZero, Shutdown, Stop, Torque, WriteAcceleration, WritePidRam, WritePidRom,
        };
        let two = Fleet::new(2).all_with_id(MotorId::MIN);
        let raw = |moves| Kind::Raw { byte: 0xC0, reply: ReplyRule::Values, moves };
        let writes = [WritePidRam, WritePidRom, WriteAcceleration, SetEncoderZero, Reset];
        let others = [ReleaseBrake, FunctionControl, CommunicationLossProtection, SetBaudRate];
        for kind in writes.into_iter().chain(others).map(Kind::from).chain([raw(false)]) {
            let (outcome, _) = look(&two, kind);
            assert!(matches!(outcome, Err(Unfinished::Failed(_))), "{kind}: {outcome:?}");
        }
        assert_eq!(look(&Fleet::new(1), Reset), (Ok(()), true));
        for kind in
            [Torque, IncrementalPosition, Motion].map(Kind::from).into_iter().chain([raw(true)])
        {
            assert_eq!(look(&two, kind), (Ok(()), true), "{kind}");
        }
        // No check before commands that read or end motion, nor before the one that ends reports.
        for kind in [ReadPid, ReadStatus1, Stop, Shutdown, LockBrake, ActiveReply] {
            assert_eq!(look(&two, kind), (Ok(()), false), "{kind}");
        }
    }

    #[test]
    fn two_motors_of_one_id_are_refused() {
        let refused = |fleet: &Fleet| {
            let mut session = Session::on(&fleet.on_can(1_000_000).unwrap());
            session.refuse_shared(MotorId::MIN)
        };
        assert_eq!(refused(&Fleet::new(2)), Ok(()));
        let outcome = refused(&Fleet::new(2).all_with_id(MotorId::MIN));
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        assert!(message.starts_with("two motors seem to have id 1: connect only one"), "{message}");
    }

    /// The answer that counts as the echo of its command is missing, and others seem to be too many.
    #[test]
    fn adapter_that_does_not_echo_as_its_address_says_is_named_beside_two_motors() {
        let mut session = echo_is_missing();
        let outcome = session.refuse_shared(MotorId::MIN);
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        assert!(message.contains("leave out ',echo'"), "{message}");
    }

    /// A motor that reports its errors on its own (function 3) has to be restarted for them.
    #[test]
    fn a_motor_that_reports_its_errors_is_not_refused() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        session.ask(MotorId::MIN, FunctionControl::ErrorReporting(Switch::On)).unwrap();
        fleet.drives[0].with(|drive| drive.raise_fault(ErrorFlags::STALL));
        for _ in 0..5 {
            session.wait_until(session.master.now() + Duration::from_millis(30)).unwrap();
            assert_eq!(session.refuse_shared(MotorId::MIN), Ok(()));
        }
    }

    #[test]
    fn motor_that_another_program_stops_during_the_question_is_not_moved() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let stop = to_first([0x81, 0, 0, 0, 0, 0, 0, 0]);
        OtherMaster::attach(&fleet, stop, Sends::Once(Duration::from_millis(10)));
        let mut session = Session::on(&fleet);
        fleet.world.run_for(Duration::from_secs(1));
        let stopped = session.take_what_waits(MotorId::MIN.into());
        let message =
            "something else on this bus has stopped motor 1 meanwhile, so nothing was done";
        assert_eq!(stopped, Err(Unfinished::Failed(message.to_owned())));
        fleet.world.run_for(Duration::from_secs(1));
        assert_eq!(session.take_what_waits(MotorId::MIN.into()), Ok(()), "that was before");
    }

    /// Another program has asked for the status before, when the motor turned.
    #[test]
    fn reply_that_came_during_the_question_answers_nothing_that_follows() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let asks = to_first(ReadStatus2.encode());
        OtherMaster::attach(&fleet, asks, Sends::Once(Duration::from_millis(10)));
        fleet.drives[0].with(|drive| drive.plant_mut().lead(0.0, 200.0)).unwrap();
        let mut session = Session::on(&fleet);
        fleet.world.run_for(Duration::from_millis(50));
        fleet.drives[0].with(|drive| drive.plant_mut().lead(0.0, 0.0)).unwrap();
        fleet.world.run_for(Duration::from_secs(1));
        session.take_what_waits(MotorId::MIN.into()).unwrap();
        assert_eq!(session.standing(MotorId::MIN), Ok(()));
    }

    #[test]
    fn bus_that_carries_nothing_is_reported_without_naming_motors() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        fleet.world.cut(fleet.drives[0].station());
        let outcome = Session::on(&fleet).meant(Target::All);
        let message = "the bus carried nothing, so the command was dropped: check its wiring, its bit rate and the \
                       motors' power";
        assert_eq!(outcome, Err(Unfinished::Failed(message.to_owned())));
    }

    #[test]
    fn message_of_a_port_in_use_says_how_to_end_its_owner_safely() {
        let message = PortError::InUse("/dev/ttyUSB0".to_owned()).to_string();
        assert!(
            message.contains("by Ctrl-C or SIGTERM so that it can stop its motors"),
            "{message}"
        );
        assert!(message.contains("SIGKILL"), "{message}");
        assert!(message.contains("its motors go on then until they are stopped"), "{message}");
    }
}
