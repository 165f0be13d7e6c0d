//! Stops a motor that moves before anything ends a command early.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::Ordering;

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{BrakeCommand, ReadRunningMode, ReadStatus1, ReadStatus2};
use myactuator_protocol_core::io::{Runner, bring_up};
use myactuator_protocol_core::master::{MotorSet, StopKind};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::CoarseSpeed;

use super::session::Session;
use crate::cli::{Outcome, Unfinished, printer, report, unwritten};

/// How long a motor may take to come to rest.
const LONGEST_BRAKING: Duration = Duration::from_secs(3);
/// A motor stands if it has not turned for this time. An arm that swings also stands, for a moment.
const STANDS_AFTER: Duration = Duration::from_millis(100);
/// The same for a motor that was seen to turn.
const STANDS_AFTER_TURNING: Duration = Duration::from_millis(500);
/// At so many looks at least: a program that is suspended does not look.
const STANDING_LOOKS: u32 = 6;
/// How long to listen whether something else moves a stopped motor. A program that commands a motor sends more often.
const LISTENING: Duration = Duration::from_millis(250);
/// How long to retry on a bus that carries nothing.
pub(super) const LONGEST_OUTAGE: Duration = Duration::from_secs(1);
/// The longest wait before the next look at the bus, and for an interruption by the user.
pub(super) const LONGEST_WAIT: Duration = Duration::from_millis(10);

/// The state of a motor that was switched off.
pub(super) const OFF: &str = "is off (0x80): its shaft is free unless a brake holds it";

/// The state of a motor that runs nothing although it was told to hold.
const RUNS_NOTHING: &str =
    "has confirmed the stop (0x81) but runs nothing (mode 0): its shaft is free";

/// The state of a motor that something else has switched off and then told to hold still.
const ON_AGAIN: &str =
    "was switched off and on again by something else on this bus: its state is not known";

/// The states of motors that were told to hold.
#[derive(Default)]
struct Looks {
    /// Motors that cannot be relied on, each with its state.
    failing: Vec<(MotorId, String)>,
    /// Motors without an error that run nothing (mode 0).
    idle: MotorSet,
    /// Motors without an error whose brakes were last told to lock.
    locked: MotorSet,
}

/// The state of motors of which another program commands some.
fn commanded(motors: MotorSet, some: &str) -> String {
    let have = if motors.len() == 1 { "has" } else { "have" };
    format!(
        "{have} confirmed the stop, but something else on this bus goes on commanding {some}: end that, or cut the power"
    )
}

/// The motors in this list.
fn of(told: &[(MotorId, String)]) -> MotorSet {
    told.iter().map(|(motor, _)| *motor).collect()
}

/// A motor that has yet to stand.
#[derive(Clone, Copy)]
struct Slowing {
    /// The slowest speed that was seen, in raw units; `None` if it was not seen to turn.
    slowest: Option<u16>,
    /// When it must be slower at the latest.
    latest: Instant,
    /// Since when it stands, and at how many looks.
    stands: Option<(Instant, u32)>,
}

impl Slowing {
    /// Notes that it did not turn when it was asked. Returns whether it stands.
    fn note_standing(&mut self, asked_at: Instant) -> bool {
        let (since, looks) = self.stands.get_or_insert((asked_at, 0));
        *looks += 1;
        let after = match self.slowest {
            Some(_) => STANDS_AFTER_TURNING,
            None => STANDS_AFTER,
        };
        asked_at - *since >= after && *looks >= STANDING_LOOKS
    }

    /// Notes its speed when it was asked. Returns whether it slows down, or still has time to.
    fn note_turning(&mut self, speed: CoarseSpeed, asked_at: Instant) -> bool {
        self.stands = None;
        let turns = speed.raw().unsigned_abs();
        if self.slowest.is_none_or(|slowest| turns < slowest) {
            (self.slowest, self.latest) = (Some(turns), asked_at + LONGEST_BRAKING);
        }
        asked_at < self.latest
    }
}

impl Session {
    /// Does `work`, which moves these motors. If it fails or panics, or if Ctrl-C, Ctrl-\\, Ctrl-Z, a hang-up or a
    /// request to end comes, the motors are stopped (0x81) before anything else.
    pub(super) fn moving<T>(
        &mut self,
        motors: impl Into<MotorSet>,
        work: impl FnOnce(&mut Self) -> Outcome<T>,
    ) -> Outcome<T> {
        self.is_not_left_halfway()?;
        let motors = motors.into();
        self.master.moved = motors;
        match catch_unwind(AssertUnwindSafe(|| work(self))) {
            Ok(outcome) => outcome.map_err(|why| {
                // After a stop elsewhere commands are refused: report the stop instead.
                let why = match (why, self.check_stopped_elsewhere()) {
                    (Unfinished::Failed(_), Err(stopped)) => stopped,
                    (why, _) => why,
                };
                self.again.store(false, Ordering::Relaxed);
                told_with_stop(why, self.stopped_by(StopKind::Hold, motors))
            }),
            Err(panic) => {
                if let Err(Unfinished::Failed(not_stopped)) = self.stop(StopKind::Hold, motors) {
                    report("error", not_stopped);
                }
                resume_unwind(panic)
            }
        }
    }

    /// Stops these motors, waits until they have confirmed, and checks that nothing else goes on moving them.
    pub(super) fn stop(&mut self, kind: StopKind, motors: MotorSet) -> Outcome {
        self.confirm_stop(kind, motors)?;
        self.see_stopped(kind, motors)
    }

    /// Stops these motors in the same way, and returns their states.
    pub(super) fn stopped_by(&mut self, kind: StopKind, motors: MotorSet) -> Outcome<String> {
        self.confirm_stop(kind, motors)?;
        self.stop_what_moves(kind, motors)?;
        self.stopped(motors)
    }

    /// Stops these motors and waits until they have confirmed. Retries if a line fails for a moment.
    pub(super) fn confirm_stop(&mut self, kind: StopKind, motors: MotorSet) -> Outcome {
        if kind == StopKind::Off {
            self.master.off = self.master.off.with(motors);
        }
        let begun = self.master.awake();
        let mut silent = motors;
        while !silent.is_empty() {
            silent = self.silent_at_stop(kind, silent);
            if !silent.is_empty() && self.master.awake() - begun >= LONGEST_OUTAGE {
                let is_there = silent.iter().all(|motor| self.has_heard(motor));
                let doubt = match (is_there, silent.len()) {
                    (true, _) => "",
                    (false, 1) => "if it is on this bus, ",
                    (false, _) => "if they are on this bus, ",
                };
                let its = if silent.len() == 1 { "its" } else { "their" };
                return Err(Unfinished::Failed(format!(
                    "no confirmation of the stop from {}: {doubt}cut {its} power{}",
                    named(silent),
                    self.echo_told_of()
                )));
            }
        }
        Ok(())
    }

    /// Stops these motors and returns those that have not confirmed. A single motor gets a stop of its own: on RS485 a
    /// stop of all would also reach the others on the line, which may hold a load. It is sent if they may move, too.
    fn silent_at_stop(&mut self, kind: StopKind, motors: MotorSet) -> MotorSet {
        let others_move = !self.master.moved.without(motors).is_empty();
        let mut each = motors.iter();
        match (each.next(), each.next()) {
            (Some(only), None) if !others_move => match self.master.stop(only, kind) {
                true => MotorSet::EMPTY,
                false => motors,
            },
            _ => self.tell_all(|session| session.master.stop_all(kind, motors)),
        }
    }

    /// Checks that nothing else on the bus goes on moving these motors, which have confirmed the stop.
    pub(super) fn see_stopped(&mut self, kind: StopKind, motors: MotorSet) -> Outcome {
        self.stop_what_moves(kind, motors)?;
        self.are_left_alone(motors)
    }

    /// Stops those of these motors again that something else has moved since they have confirmed the stop. A program
    /// that gives way to a stop, as this one does, may have sent once more before it heard of the stop.
    pub(super) fn stop_what_moves(&mut self, kind: StopKind, motors: MotorSet) -> Outcome {
        let moved = self.moved_elsewhere(motors);
        if !moved.is_empty() {
            self.confirm_stop(kind, moved)?;
            let _moved = self.moved_elsewhere(motors);
        }
        Ok(())
    }

    /// Fails if something else has moved some of these motors since they confirmed the stop.
    pub(super) fn are_left_alone(&self, motors: MotorSet) -> Outcome {
        let moved = self.moved_on(motors);
        if moved.is_empty() {
            return Ok(());
        }
        let state = commanded(motors, &named(moved));
        Err(Unfinished::Failed(format!("{} {state}", named(motors))))
    }

    /// Listens for replies to something else that moves these motors, and returns the motors it moves. Asks the motors
    /// meanwhile, so that a short communication-loss protection does not let a load go.
    fn moved_elsewhere(&mut self, motors: MotorSet) -> MotorSet {
        let begun = self.master.awake();
        while self.master.awake() - begun < LISTENING {
            // They have just confirmed. If this fails, the next question finds out why.
            self.ask_each(motors, ReadStatus2, None);
            let _ = self.master.run_until(self.master.now() + LONGEST_WAIT, |_| {});
        }
        self.moved_on(motors)
    }

    /// The motors that something else has moved since they confirmed the stop.
    fn moved_on(&self, motors: MotorSet) -> MotorSet {
        motors.iter().filter(|motor| self.master.moved_on.contains(*motor)).collect()
    }

    /// The motors that are off, as far as is known.
    fn off(&self, motors: MotorSet) -> MotorSet {
        motors.iter().filter(|motor| self.master.is_off(*motor)).collect()
    }

    /// The states of motors that have confirmed the stop: they hold still, are held by their brakes, or were switched
    /// off.
    ///
    /// # Errors
    /// The states, if a motor holds nothing, does not answer, or does not come to rest.
    pub(super) fn stopped(&mut self, motors: MotorSet) -> Outcome<String> {
        let was_off = self.off(motors);
        let on = motors.without(was_off);
        // By now they have heard this program for a while. A motor that had lost its master confirms its first commands
        // without running them, and runs them now.
        let Looks { mut failing, idle, .. } = self.look_at_held(on);
        let moved = self.moved_on(motors);
        let told = |motor: MotorId| (motor, commanded(motor.into(), "it"));
        failing.extend(moved.iter().map(told));
        if !idle.is_empty() {
            self.confirm_stop(StopKind::Hold, idle)?;
        }
        failing.extend(self.restless(on.without(of(&failing))));
        // Waiting took time, in which their states may have changed.
        let Looks { failing: since, idle, locked } = self.look_at_held(on.without(of(&failing)));
        failing.extend(since);
        let off = self.off(motors);
        let free = idle.without(locked).without(off);
        failing.extend(free.iter().map(|motor| (motor, RUNS_NOTHING.to_owned())));
        failing.extend(was_off.without(off).iter().map(|motor| (motor, ON_AGAIN.to_owned())));
        // A program that sends seldom may be heard only now.
        failing.extend(self.moved_on(motors).without(moved).iter().map(told));
        let off = off.without(of(&failing));
        let locked = idle.without(free).without(off);
        let holding = motors.without(off).without(locked).without(of(&failing));
        let all_well = failing.is_empty();
        let mut others: Vec<_> = off.iter().map(|motor| (motor, OFF.to_owned())).collect();
        others.extend(failing);
        others.sort_unstable_by_key(|(motor, _)| *motor);
        let others = others.into_iter().map(|(motor, told)| format!("motor {motor} {told}"));
        let holding = (!holding.is_empty()).then(|| hold_still(holding));
        let braked = (!locked.is_empty()).then(|| braked(locked));
        let told = holding.into_iter().chain(braked).chain(others).collect::<Vec<_>>().join("; ");
        if all_well { Ok(told) } else { Err(Unfinished::Failed(told)) }
    }

    /// Asks motors that have confirmed the stop (0x81) whether they run it.
    fn look_at_held(&mut self, motors: MotorSet) -> Looks {
        let mut looks = Looks::default();
        let mut without_errors = MotorSet::EMPTY;
        for (motor, status) in self.ask_each(motors, ReadStatus1, None).outcomes {
            let told = match status {
                Ok(status) if status.errors.is_empty() => {
                    without_errors.insert(motor);
                    if status.brake == BrakeCommand::LOCK {
                        looks.locked.insert(motor);
                    }
                    continue;
                }
                Ok(status) => format!(
                    "has confirmed the stop (0x81) but reports an error ({}), for which a drive cuts its output: \
                     only a locked brake holds its shaft",
                    status.errors
                ),
                Err(_) => "has confirmed the stop (0x81), but whether it holds is not known: its errors cannot \
                           be read"
                    .to_owned(),
            };
            looks.failing.push((motor, told));
        }
        for (motor, reply) in self.ask_each(without_errors, ReadRunningMode, None).outcomes {
            if reply.is_ok_and(|reply| !reply.mode.runs()) {
                looks.idle.insert(motor);
            }
        }
        looks
    }

    /// Waits until a motor that slows down stands.
    ///
    /// # Errors
    /// It turns and has not slowed down for [`LONGEST_BRAKING`], or does not answer.
    pub(super) fn come_to_rest(&mut self, motor: MotorId) -> Outcome {
        match self.restless(motor.into()).pop() {
            Some((motor, told)) => Err(Unfinished::Failed(format!("motor {motor} {told}"))),
            None => Ok(()),
        }
    }

    /// Waits until these motors, which slow down, stand. Returns those that do not: they turn and have not slowed down
    /// for [`LONGEST_BRAKING`], or do not answer, or the user does not want to wait.
    fn restless(&mut self, motors: MotorSet) -> Vec<(MotorId, String)> {
        let mut restless = Vec::new();
        let mut turning = motors;
        let latest = self.master.now() + LONGEST_BRAKING;
        let mut slowing = [Slowing { slowest: None, latest, stands: None }; MotorId::COUNT];
        while !turning.is_empty() {
            // What they say is no older, also if this program is suspended meanwhile.
            let asked_at = self.master.now();
            for (motor, reply) in self.ask_each(turning, ReadStatus2, None).outcomes {
                let slowing = &mut slowing[motor.index()];
                let told = match reply.map(|reply| reply.speed) {
                    Ok(speed) if !bring_up::turns(speed) => {
                        if !slowing.note_standing(asked_at) && !self.is_not_to_wait() {
                            continue;
                        }
                        None
                    }
                    Ok(speed) if self.is_not_to_wait() => Some(format!(
                        "has confirmed the stop (0x81) and still turns at {speed}: this program did not wait until it stands"
                    )),
                    Ok(speed) if slowing.note_turning(speed, asked_at) => continue,
                    Ok(speed) => Some(format!(
                        "has confirmed the stop (0x81), but turns at {speed} and does not slow down: cut its power"
                    )),
                    Err(error) => Some(format!(
                        "has confirmed the stop (0x81), but whether it stands is not known: {error}"
                    )),
                };
                turning.remove(motor);
                restless.extend(told.map(|told| (motor, told)));
            }
            if !turning.is_empty() {
                let _ = self.master.run_until(self.master.now() + LONGEST_WAIT, |_| {});
            }
        }
        restless
    }

    /// Whether Ctrl-C or the like has come; if the motors were stopped for one, whether it has come again.
    pub(super) fn is_not_to_wait(&self) -> bool {
        self.again.load(Ordering::Relaxed)
    }

    /// Ends the work if the user has interrupted it.
    pub(super) fn check_interrupted(&self) -> Outcome {
        if self.interrupted.load(Ordering::Relaxed) {
            Err(Unfinished::Interrupted("interrupted".to_owned()))
        } else {
            Ok(())
        }
    }

    /// Ends the work if the motors that it moves were stopped elsewhere.
    pub(super) fn check_stopped_elsewhere(&self) -> Outcome {
        match self.master.stopped.get() {
            MotorSet::EMPTY => Ok(()),
            stopped => Err(Unfinished::Failed(format!(
                "something else on this bus has stopped {}",
                named(stopped)
            ))),
        }
    }

    /// Waits until what was printed is read, ready to be interrupted.
    pub(super) fn wait_for_reader(&self) -> Outcome {
        let printed = printer::OUT.wait(|| self.check_interrupted().is_err());
        printed.map_err(|error| unwritten(&error))?;
        self.check_interrupted()
    }

    /// Waits, ready to be interrupted.
    pub(super) fn wait_until(&mut self, until: Instant) -> Outcome {
        loop {
            self.check_interrupted()?;
            if self.master.now() >= until {
                return Ok(());
            }
            if self.master.poll()?.is_none() {
                let wake = until.min(self.master.now() + LONGEST_WAIT);
                self.master.idle(wake);
            }
        }
    }
}

/// Motors in a sentence: "motor 1" or "motors 1 2".
pub(super) fn named(motors: MotorSet) -> String {
    let noun = if motors.len() == 1 { "motor" } else { "motors" };
    format!("{noun} {motors}")
}

/// Says that these motors are stopped and have no error. Whether they have a protection cannot be read back.
fn hold_still(motors: MotorSet) -> String {
    let are = match motors.len() {
        1 => "is stopped and holds still (0x81) unless its protection (0xB3) ends that",
        _ => "are stopped and hold still (0x81) unless their protection (0xB3) ends that",
    };
    format!("{} {are}", named(motors))
}

/// Says that these motors are stopped, and run nothing behind their brakes.
fn braked(motors: MotorSet) -> String {
    let are = match motors.len() {
        1 => "is stopped and runs nothing (mode 0): its brake holds it, which it reports as locked",
        _ => {
            "are stopped and run nothing (mode 0): their brakes hold them, which they report as locked"
        }
    };
    format!("{} {are}", named(motors))
}

/// Why the work ended, and whether the motors have stopped.
pub(super) fn told_with_stop(why: Unfinished, stopped: Outcome<String>) -> Unfinished {
    let sentence = match &why {
        Unfinished::Usage(sentence)
        | Unfinished::Failed(sentence)
        | Unfinished::Interrupted(sentence) => sentence.as_str(),
        Unfinished::FailedAndReported => "the command failed",
        Unfinished::ReaderLeft => "nobody reads the output any more",
    };
    match (stopped, &why) {
        (Err(Unfinished::Failed(not_stopped)), _) => {
            Unfinished::Failed(format!("{sentence}; {not_stopped}"))
        }
        (Ok(stopped), Unfinished::Interrupted(_)) => {
            Unfinished::Interrupted(format!("{sentence}; {stopped}"))
        }
        (Ok(stopped), _) => Unfinished::Failed(format!("{sentence}; {stopped}")),
        (Err(why), _) => why,
    }
}

#[cfg(test)]
mod tests {
    use myactuator_host_std::open::AnyMaster;
    use myactuator_host_std::sim::plant::{Arm, Load};
    use myactuator_host_std::sim::{CanFleet, Fleet};
    use myactuator_protocol_core::command::ErrorFlags;
    use myactuator_protocol_core::command::{
        AbsolutePosition, AccelerationIndex, Speed, WriteAcceleration,
    };
    use myactuator_protocol_core::drive::Quirks;
    use myactuator_protocol_core::io::bring_up;
    use myactuator_protocol_core::units::{
        Acceleration, Angle, MaxSpeed, MaxTorque, Milliseconds, SpeedTarget,
    };

    use super::super::simulated::{OtherMaster, Sends, to_first};
    use super::*;

    #[test]
    fn stop_of_one_motor_on_rs485_leaves_the_others_on() {
        let fleet = Fleet::new(2).on_rs485(115_200).unwrap();
        let mut session = Session::by(AnyMaster::SimulatedRs485(fleet.master()));
        let [one, other] = [1, 2].map(|id| MotorId::new(id).unwrap());
        let hold =
            AbsolutePosition { max_speed: MaxSpeed::from_raw(90), angle: Angle::from_raw(0) };
        for motor in [one, other] {
            session.ask(motor, hold).unwrap();
        }
        session.stop(StopKind::Off, one.into()).unwrap();
        let is_on = |at: usize| fleet.drives[at].with(|drive| drive.state().output_on);
        assert_eq!((is_on(0), is_on(1)), (false, true), "a load on the other would fall");
    }

    #[test]
    fn help_says_how_long_a_stop_listens_for_other_masters() {
        let all = clap::Command::new("typed");
        let all = <super::super::Subcommand as clap::Subcommand>::augment_subcommands(all);
        for name in ["stop", "shutdown"] {
            let help = all.find_subcommand(name).unwrap().get_long_about().unwrap().to_string();
            assert!(help.contains(&format!("For {} ms after", LISTENING.as_millis())), "{help}");
        }
    }

    /// The long help of a subcommand, as one line.
    fn help_of(name: &str) -> String {
        let all = clap::Command::new("typed");
        let mut all = <super::super::Subcommand as clap::Subcommand>::augment_subcommands(all);
        let help = all.find_subcommand_mut(name).unwrap().render_long_help().to_string();
        // Where lines break depends on the width of the terminal.
        help.split_whitespace().collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn help_says_when_protection_ends_a_hold() {
        for name in ["stop", "move", "speed"] {
            let help = help_of(name);
            assert!(help.contains("when that time is up its output is off"), "{name}: {help}");
        }
    }

    #[test]
    fn help_of_stop_says_that_a_port_has_one_user_and_how_long_it_takes() {
        for name in ["stop", "shutdown"] {
            let help = help_of(name);
            let [one, takes] = ["can be opened by one program at a time", "A stop of all takes"];
            assert!(help.contains(one) && help.contains(takes), "{name}: {help}");
        }
    }

    /// A motor that stops on its own when it has heard nothing for this time.
    fn protected_after(millis: u32) -> (CanFleet, Session) {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        let silence = Milliseconds::from_raw(millis);
        bring_up::protect(&mut session.master, MotorId::MIN, silence).unwrap();
        (fleet, session)
    }

    /// The program was held up behind its stop.
    #[test]
    fn motor_that_lost_its_master_is_stopped_again_until_it_holds() {
        let motor = MotorId::MIN;
        let (fleet, mut session) = protected_after(100);
        session.stop(StopKind::Hold, motor.into()).unwrap();
        fleet.world.run_for(Duration::from_millis(200));
        let is_on = || fleet.drives[0].with(|drive| drive.state().output_on);
        assert!(!is_on(), "it has let go");
        let holds =
            "motor 1 is stopped and holds still (0x81) unless its protection (0xB3) ends that"
                .to_owned();
        assert_eq!(session.stopped(motor.into()), Ok(holds));
        assert!(is_on());
    }

    /// The motor has lost its master. It has no brake, and reports a locked one whenever it obeys no motion command.
    #[test]
    fn motor_that_reports_a_locked_brake_is_stopped_again_until_it_holds() {
        let quirks = Quirks { brake_told_by_motion: true, ..Quirks::default() };
        let fleet = Fleet::new(1).quirks(quirks).on_can(1_000_000).unwrap();
        let silence = Milliseconds::from_raw(100);
        bring_up::protect(&mut Session::on(&fleet).master, MotorId::MIN, silence).unwrap();
        fleet.world.run_for(Duration::from_millis(200));
        let mut session = Session::on(&fleet);
        session.stop(StopKind::Hold, MotorId::MIN.into()).unwrap();
        let holds =
            "motor 1 is stopped and holds still (0x81) unless its protection (0xB3) ends that"
                .to_owned();
        assert_eq!(session.stopped(MotorId::MIN.into()), Ok(holds));
        assert!(fleet.drives[0].with(|drive| drive.state().output_on));
    }

    #[test]
    fn motor_held_by_its_locked_brake_is_not_reported_as_holding() {
        let fleet = Fleet::new(1).brakes(true).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        session.stop(StopKind::Hold, MotorId::MIN.into()).unwrap();
        let message = session.stopped(MotorId::MIN.into()).unwrap();
        assert_eq!(message, braked(MotorId::MIN.into()));
        // Unless the shaft turns.
        fleet.drives[0].with(|drive| drive.plant_mut().lead(0.0, 200.0)).unwrap();
        let outcome = session.stopped(MotorId::MIN.into());
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        assert!(message.contains("turns at 200"), "{message}");
    }

    #[test]
    fn error_raised_while_a_motor_comes_to_rest_is_reported() {
        let fault = "stall@1+300ms".parse().unwrap();
        let fleet = Fleet::new(1).faults([fault]).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        session.stop(StopKind::Hold, MotorId::MIN.into()).unwrap();
        assert!(session.ready(MotorId::MIN).is_ok(), "it has not come yet");
        let outcome = session.stopped(MotorId::MIN.into());
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        assert!(message.contains("motor stalled"), "{message}");
    }

    /// It has no error, and no brake that it reports as locked.
    #[test]
    fn motor_that_restarts_while_it_comes_to_rest_is_not_reported_holding() {
        let fault = "reset@1+300ms".parse().unwrap();
        let fleet = Fleet::new(1).faults([fault]).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        session.stop(StopKind::Hold, MotorId::MIN.into()).unwrap();
        assert!(fleet.drives[0].with(|drive| drive.state().output_on), "it has not come yet");
        let message = format!("motor 1 {RUNS_NOTHING}");
        assert_eq!(session.stopped(MotorId::MIN.into()), Err(Unfinished::Failed(message)));
    }

    /// It sends after the time in which others are listened for, and so little that friction holds the shaft.
    #[test]
    fn another_master_that_is_heard_while_a_motor_comes_to_rest_is_reported() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let torque = to_first([0xA1, 0, 0, 0, 1, 0, 0, 0]);
        OtherMaster::attach(&fleet, torque, Sends::Once(Duration::from_millis(320)));
        let mut session = Session::on(&fleet);
        session.stop(StopKind::Hold, MotorId::MIN.into()).unwrap();
        assert!(session.master.now() < Instant::from_millis(320), "it has not come yet");
        let outcome = session.stopped(MotorId::MIN.into());
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        assert!(message.contains("something else on this bus goes on commanding it"), "{message}");
    }

    /// Only one of them is to be confirmed here.
    #[test]
    fn stop_of_one_of_two_motors_that_move_stops_both() {
        let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        let both: MotorSet = MotorId::all().take(2).collect();
        let turn = Speed { max_torque: MaxTorque::NO_LIMIT, speed: SpeedTarget::from_raw(9_000) };
        let outcome: Outcome = session.moving(both, |session| {
            both.iter().try_for_each(|motor| session.ask(motor, turn).map(drop))?;
            session.confirm_stop(StopKind::Hold, MotorId::MIN.into())?;
            let later = session.master.now() + Duration::from_secs(1);
            session.wait_until(later)
        });
        assert_eq!(outcome, Ok(()));
        for drive in &fleet.drives {
            let speed_dps = drive.with(|drive| drive.plant().output_speed_dps());
            assert!(speed_dps.abs() < 1.0, "motor {}: {speed_dps} dps", drive.motor());
        }
    }

    #[test]
    fn error_of_one_motor_is_reported_beside_another_that_is_commanded_elsewhere() {
        let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
        let torque = to_first([0xA1, 0, 0, 0, 10, 0, 0, 0]);
        OtherMaster::attach(&fleet, torque, Sends::Every(Duration::from_millis(5)));
        fleet.drives[1].with(|drive| drive.raise_fault(ErrorFlags::STALL));
        let motors = MotorId::all().take(2).collect();
        let outcome = Session::on(&fleet).stopped_by(StopKind::Hold, motors);
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        for part in
            ["motor 1 has confirmed the stop, but something else", "motor 2", "motor stalled"]
        {
            assert!(message.contains(part), "{message}");
        }
    }

    #[test]
    fn short_protection_does_not_expire_while_a_stop_is_confirmed() {
        let motor = MotorId::MIN;
        let (fleet, mut session) = protected_after(30);
        for _ in 0..3 {
            session.ask(motor, ReadStatus2).unwrap();
        }
        session.stop(StopKind::Hold, motor.into()).unwrap();
        assert!(fleet.drives[0].with(|drive| drive.state().output_on));
    }

    /// Turns a motor that slows down by 100 dps a second, and is interrupted.
    fn interrupted_at(raw_speed: i32) -> (Outcome, f32) {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        let index = AccelerationIndex::SPEED_DECELERATION;
        let acceleration = Acceleration::try_from_raw(100).unwrap();
        session.ask(MotorId::MIN, WriteAcceleration { index, acceleration }).unwrap();
        let outcome = session.moving(MotorId::MIN, |session| {
            let (max_torque, speed) = (MaxTorque::NO_LIMIT, SpeedTarget::from_raw(raw_speed));
            session.ask(MotorId::MIN, Speed { max_torque, speed })?;
            let later = session.master.now() + Duration::from_secs(1);
            session.wait_until(later)?;
            Err(Unfinished::Interrupted("interrupted".to_owned()))
        });
        (outcome, session.ask(MotorId::MIN, ReadStatus2).unwrap().speed.dps())
    }

    #[test]
    fn interrupted_motor_is_reported_holding_only_once_it_stands() {
        // From 180 dps it takes 1.8 s.
        let (outcome, dps) = interrupted_at(18_000);
        let message = "interrupted; motor 1 is stopped and holds still (0x81) unless its protection (0xB3) ends that";
        assert_eq!(outcome, Err(Unfinished::Interrupted(message.to_owned())));
        assert!(dps.abs() <= 2.0, "{dps} dps");
        // From 540 dps it takes 5.4 s.
        let (outcome, dps) = interrupted_at(54_000);
        assert_eq!(outcome, Err(Unfinished::Interrupted(message.to_owned())));
        assert!(dps.abs() <= 2.0, "{dps} dps");
    }

    #[test]
    fn second_ctrl_c_ends_the_wait_for_a_motor_that_still_turns() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        session.stop(StopKind::Hold, MotorId::MIN.into()).unwrap();
        fleet.drives[0].with(|drive| drive.plant_mut().lead(0.0, 200.0)).unwrap();
        session.again.store(true, Ordering::Relaxed);
        let begun = session.master.now();
        let outcome = session.stopped(MotorId::MIN.into());
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        assert!(
            message.starts_with("motor 1 has confirmed the stop (0x81) and still turns at 200"),
            "{message}"
        );
        assert!(session.master.now() - begun < Duration::from_millis(20));
    }

    #[test]
    fn motor_that_does_not_slow_down_is_not_reported_holding() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        session.stop(StopKind::Hold, MotorId::MIN.into()).unwrap();
        // What turns it is stronger than the motor.
        fleet.drives[0].with(|drive| drive.plant_mut().lead(0.0, 200.0)).unwrap();
        let begun = session.master.now();
        let outcome = session.stopped(MotorId::MIN.into());
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        assert!(
            message.starts_with("motor 1 has confirmed the stop (0x81), but turns at 200")
                && message.ends_with("and does not slow down: cut its power"),
            "{message}"
        );
        assert!(session.master.now() - begun < Duration::from_millis(3_100));
    }

    /// A long arm that swings a little turns hardly at all for more than a tenth of a second.
    #[test]
    fn swinging_arm_is_not_at_rest_where_it_turns_back() {
        for (length_m, start_deg) in [(0.4, 90.0), (2.0, 10.0)] {
            let arm = Arm { mass_kg: 5.0, length_m, down_deg: 0.0 };
            let load = Load { arm: Some(arm), ..Load::NONE };
            let fleet = Fleet::new(1).load(load).start_angle_deg(start_deg);
            let mut session = Session::on(&fleet.on_can(1_000_000).unwrap());
            let outcome = session.come_to_rest(MotorId::MIN);
            let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
            assert!(message.contains("does not slow down"), "{message}");
        }
    }

    #[test]
    fn several_stopped_motors_are_awaited_together() {
        let fleet = Fleet::new(6).on_can(1_000_000).unwrap();
        let motors: MotorSet = MotorId::all().take(6).collect();
        let mut session = Session::on(&fleet);
        session.stop(StopKind::Hold, motors).unwrap();
        for turned in &fleet.drives[..3] {
            turned.with(|drive| drive.plant_mut().lead(0.0, 200.0)).unwrap();
        }
        // These are silent now; the last one acknowledges their frames.
        for silent in &fleet.drives[3..5] {
            fleet.world.cut(silent.station());
        }
        let begun = session.master.now();
        let outcome = session.stopped(motors);
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        let message: Vec<&str> = message.split("; ").collect();
        assert_eq!(
            message[0],
            "motor 6 is stopped and holds still (0x81) unless its protection (0xB3) ends that"
        );
        for (message, motor) in message[1..].iter().zip(1..) {
            let how =
                if motor <= 3 { "does not slow down" } else { "whether it holds is not known" };
            assert!(
                message.starts_with(&format!("motor {motor} ")) && message.contains(how),
                "{message}"
            );
        }
        assert_eq!(message.len(), 6, "{message:?}");
        let took = session.master.now() - begun;
        assert!(took < Duration::from_millis(3_200), "{took:?}");
    }

    /// An arm that swings stands for a moment at each end, and a program that is suspended sees nothing in between.
    #[test]
    fn motor_stands_that_has_not_turned_for_a_time_and_at_six_looks() {
        let at = Instant::from_millis;
        let not_seen = Slowing { slowest: None, latest: at(3_000), stands: None };
        let looks_until_it_stands = |mut slowing: Slowing, first_looks_ms: &[u64], next_ms: u64| {
            let looks = first_looks_ms.iter().copied().chain((next_ms..).step_by(10));
            looks.take_while(|&ms| !slowing.note_standing(at(ms))).count() + 1
        };
        // A look every 10 ms: 100 ms after the first one.
        assert_eq!(looks_until_it_stands(not_seen, &[], 10), 11);
        // Suspended for two seconds after the first.
        assert_eq!(looks_until_it_stands(not_seen, &[10], 2_000), 6);
        let mut seen = not_seen;
        assert!(seen.note_turning(CoarseSpeed::from_raw(30), at(0)));
        assert_eq!(looks_until_it_stands(seen, &[], 10), 51);
        // It turns again.
        assert!(!seen.note_standing(at(10)));
        assert!(seen.note_turning(CoarseSpeed::from_raw(30), at(2_999)));
        assert!(!seen.note_turning(CoarseSpeed::from_raw(30), at(3_000)), "no slower for 3 s");
        assert!(seen.note_turning(CoarseSpeed::from_raw(20), at(3_001)));
        assert!(!seen.note_standing(at(3_600)));
    }

    #[test]
    fn stopped_motor_that_falls_silent_is_not_reported_as_success() {
        let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        session.stop(StopKind::Hold, MotorId::MIN.into()).unwrap();
        // The other one acknowledges its frames.
        fleet.world.cut(fleet.drives[0].station());
        let outcome = session.stopped(MotorId::MIN.into());
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        assert!(message.ends_with("whether it holds is not known: its errors cannot be read"));
        let message = "motor 1 has confirmed the stop (0x81), but whether it stands is not known: no reply: is the motor \
                    powered, and is this its id?";
        let outcome = session.come_to_rest(MotorId::MIN);
        assert_eq!(outcome, Err(Unfinished::Failed(message.to_owned())));
    }

    #[test]
    fn motor_that_was_switched_off_is_not_reported_holding() {
        let mut session = Session::on(&Fleet::new(1).on_can(1_000_000).unwrap());
        let outcome: Outcome = session.moving(MotorId::MIN, |session| {
            session.stop(StopKind::Off, MotorId::MIN.into())?;
            Err(Unfinished::ReaderLeft)
        });
        let message = "nobody reads the output any more; motor 1 is off (0x80): its shaft is free unless a brake holds it";
        assert_eq!(outcome, Err(Unfinished::Failed(message.to_owned())));
    }
}
