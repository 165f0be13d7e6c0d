//! Running for a limited time: what `speed`, `torque` and `motion` have in common.
//!
//! The command is repeated all the time, so that a drive with communication-loss protection keeps running. Each reply
//! shows the state of the motor.

use std::mem::replace;

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{
    BrakeCommand, Command, ReadRunTime, ReadRunningMode, RunTime,
};
use myactuator_protocol_core::io::{CallError, Runner};
use myactuator_protocol_core::master::{Failure, StopKind};
use myactuator_protocol_core::time::Duration;

use super::brake::Lock;
use super::moving::told_with_stop;
use super::progress::Progress;
use super::session::{OneMotor, Session, say};
use crate::cli::{Outcome, Unfinished, arguments as parse};

/// How often the command is sent.
const SEND_EVERY: Duration = Duration::from_millis(10);
/// After how many commands errors are read.
const ERRORS_EVERY: u32 = 10;
/// The gap between two commands is shorter than this, however badly the motor answers. A longer gap means that the
/// program or the machine was frozen. The motor may have stopped on its own, and nobody expects it to go on.
const LONGEST_GAP: Duration = Duration::from_secs(1);
/// After more commands than this in a row without a reply, the motor does not answer.
const MOST_MISSED: u32 = 5;

/// Which motor, and how long.
#[derive(Debug, clap::Args)]
pub(super) struct Span {
    #[command(flatten)]
    pub(super) motor: OneMotor,
    /// How long, s.
    #[arg(long, value_parser = parse::seconds, allow_hyphen_values = true, default_value = "1")]
    pub(super) for_s: Duration,
}

/// What runs, and how it begins and ends.
#[derive(Debug)]
pub(super) struct Run<C> {
    pub(super) command: C,
    /// What the motor does, for the question: "turn at 90 dps".
    pub(super) does: String,
    /// Whether a locked brake must be released first: torque does nothing against it (2.19.1).
    pub(super) needs_open_brake: bool,
    /// How it is stopped. A motor that already ran something, and may hold a load, is held instead.
    pub(super) end: StopKind,
}

/// Asks the user, runs the motor and ends. `may_run` refuses a motor that must not run; `reading` puts a reply into
/// words.
pub(super) fn run<C: Command + Copy>(
    session: &mut Session,
    span: &Span,
    run: &Run<C>,
    may_run: impl Fn(&mut Session) -> Outcome,
    reading: impl Fn(&C::Reply) -> String,
) -> Outcome {
    let motor = span.motor.id;
    let seconds = seconds(span.for_s);
    may_run(session)?;
    let locked = session.ready(motor)?.brake == BrakeCommand::LOCK;
    let opens = run.needs_open_brake && locked;
    // Not every drive answers this.
    let mut may_hold =
        || session.master.ask(motor, ReadRunningMode).ok().is_none_or(|reply| reply.mode.runs());
    let end = match run.end {
        // A load that only the motor holds would fall.
        StopKind::Off if !locked && may_hold() => StopKind::Hold,
        end => end,
    };
    let first = if opens { "have its brake released and " } else { "" };
    let then = match end {
        StopKind::Hold => "then stop and hold still",
        StopKind::Off => "then stop, lock its brake and switch off, or hold still if it has none",
    };
    session.confirm(
        motor,
        &format!("Motor {motor} will {first}{} for {seconds} s, {then}.", run.does),
    )?;
    // The shaft may have been turned before the user answered.
    may_run(session)?;
    let ended = session.moving(motor, |session| {
        if opens {
            session.release_brake(motor)?;
        }
        let mut ran = repeat(session, span, run.command, reading)?;
        let ended = match end {
            StopKind::Off => put_down(session, motor),
            StopKind::Hold => session.stopped_by(StopKind::Hold, motor.into()),
        };
        // An interruption here ends in a stop that is waited for, as everywhere.
        session.check_interrupted()?;
        // If the last stop fails, its error says what is true: no further stop is needed. The same holds for a restart
        // meanwhile, which may be why it fails.
        Ok(match runs_on(session, motor, &mut ran) {
            Ok(()) => ended,
            Err(why) => Err(told_with_stop(why, ended)),
        })
    })??;
    say(&format!("motor {motor} has run for {seconds} s; {ended}"))
}

/// Stops a motor, locks its brake and switches it off, in this order, so that no load falls.
fn put_down(session: &mut Session, motor: MotorId) -> Outcome<String> {
    session.stop(StopKind::Hold, motor.into())?;
    // The brake is not locked on a shaft that still turns.
    session.come_to_rest(motor)?;
    let mut lock = session.lock_brake(motor)?;
    if let Lock::Holds = lock {
        session.confirm_stop(StopKind::Off, motor.into())?;
        // Only now does the brake hold alone: check that first.
        lock = session.check_brake(motor)?;
    }
    match lock {
        Lock::Holds => {}
        // Only the motor holds the load.
        Lock::IsNotThere => return session.stopped_by(StopKind::Hold, motor.into()),
        // The motor held its load, so it must hold it again.
        Lock::Slips { why, .. } => return Err(session.hold_again(motor, why)),
    }
    session.see_stopped(StopKind::Off, motor.into())?;
    Ok(format!("motor {motor} is stopped, its brake locked again (0x78) and it is off (0x80)"))
}

/// Sends the command repeatedly until the time is up. Fails if the motor restarts meanwhile. Returns its run time since
/// its start.
fn repeat<C: Command + Copy>(
    session: &mut Session,
    span: &Span,
    command: C,
    reading: impl Fn(&C::Reply) -> String,
) -> Outcome<RunTime> {
    let (motor, length) = (span.motor.id, span.for_s);
    let mut ran = session.ask(motor, ReadRunTime)?;
    let start = session.master.now();
    let mut progress = Progress::new(start);
    let mut missed = 0;
    let mut last = start;
    for turn in 0.. {
        let at = SEND_EVERY.times(turn);
        session.wait_until(start + at.min(length))?;
        let now = session.master.now();
        if now - start >= length {
            runs_on(session, motor, &mut ran)?;
            break;
        }
        let gap = now - last;
        if gap > LONGEST_GAP {
            return Err(Unfinished::Failed(format!(
                "this program was held up for {:.2} s, so it does not go on",
                seconds(gap)
            )));
        }
        last = now;
        match session.master.ask(motor, command) {
            Ok(reply) => {
                missed = 0;
                let share = seconds(now - start) / seconds(length);
                progress.show(now, share, || {
                    format!("{:6.2} s {}", seconds(now - start), reading(&reply))
                })?;
            }
            // No retry: the next set-point is due soon.
            Err(CallError::Failed { failure: Failure::NoReply | Failure::NotExecuted, .. })
                if missed < MOST_MISSED =>
            {
                missed += 1;
            }
            Err(error) => return Err(error.into()),
        }
        if turn % ERRORS_EVERY == 0 {
            session.ready(motor)?;
            runs_on(session, motor, &mut ran)?;
            // The first commands after a silence are not obeyed (2.31.1), and motion mode is not in the list of modes.
            if turn > 0 && !command.kind().is_motion() {
                runs(session, motor)?;
            }
        }
    }
    Ok(ran)
}

/// Fails if the motor has restarted since it reported this run time. A quick restart causes no silence, so only this
/// shows it.
fn runs_on(session: &mut Session, motor: MotorId, ran: &mut RunTime) -> Outcome {
    let runs = session.ask(motor, ReadRunTime)?;
    let ran = replace(ran, runs);
    if !runs.shows_restart_since(ran) {
        return Ok(());
    }
    Err(Unfinished::Failed(format!(
        "motor {motor} has restarted during the run: its run time (0xB1) was {} and is now {}; check its supply, and the \
         angle that it reports",
        ran.run_time, runs.run_time
    )))
}

/// Fails if the drive reports that it runs nothing.
fn runs(session: &mut Session, motor: MotorId) -> Outcome {
    if session.ask(motor, ReadRunningMode)?.mode.runs() {
        return Ok(());
    }
    Err(Unfinished::Failed(format!(
        "motor {motor} runs nothing (mode 0), although it gets a command every {SEND_EVERY}: is its communication-loss \
         protection too short ({} makes it longer)?",
        session.hint("timeout --time-ms 500", motor)
    )))
}

pub(super) fn seconds(span: Duration) -> f64 {
    span.as_micros() as f64 / 1e6
}

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};
    use std::sync::atomic::{AtomicBool, Ordering};

    use myactuator_host_std::sim::bus::trace::{Event, Log, Record};
    use myactuator_host_std::sim::plant::Load;
    use myactuator_host_std::sim::{CanFleet, Fleet};
    use myactuator_protocol_core::command::{
        AccelerationIndex, ErrorFlags, MotionRanges, MotionSetPoint, ReleaseBrake, Speed, Stop,
        Torque, WriteAcceleration,
    };
    use myactuator_protocol_core::drive::Quirks;
    use myactuator_protocol_core::io::bring_up;
    use myactuator_protocol_core::time::Instant;
    use myactuator_protocol_core::units::{
        Acceleration, Current, MaxTorque, Milliseconds, SpeedTarget,
    };
    use myactuator_protocol_core::wire::can::SimpleFrame;

    use super::super::simulated::{CtrlC, OtherMaster, Sends, sent, to_first, typed};
    use super::*;

    const TURN: Speed =
        Speed { max_torque: MaxTorque::NO_LIMIT, speed: SpeedTarget::from_raw(9_000) };

    fn fleet() -> CanFleet {
        Fleet::new(1).on_can(1_000_000).unwrap()
    }

    /// Turns the motor and calls `then` at the first reply. Returns how it ended.
    fn turn(session: &mut Session, then: impl Fn()) -> Unfinished {
        let outcome = session.moving(MotorId::MIN, |session| {
            repeat(session, &typed("--id 1"), TURN, |_| {
                then();
                String::new()
            })
        });
        outcome.unwrap_err()
    }

    /// The first bytes of what was sent.
    fn commands(log: &Log<SimpleFrame>) -> Vec<u8> {
        sent(log).iter().map(|packet| packet.data[0]).collect()
    }

    /// The motor once counted as having run, because it held still when it was checked.
    #[test]
    fn motor_whose_protection_expires_between_commands_has_not_run() {
        let fleet = fleet();
        let mut session = Session::on(&fleet);
        let protection = Milliseconds::from_raw(5);
        bring_up::protect(&mut session.master, MotorId::MIN, protection).unwrap();
        let outcome = session.moving(MotorId::MIN, |session| {
            repeat(session, &typed("--id 1"), TURN, |_| String::new())
        });
        let message = format!("{:?}", outcome.expect_err("it has not turned"));
        assert!(message.contains("motor 1 runs nothing (mode 0)"), "{message}");
        let longer = "('myactuator timeout --time-ms 500 --bus sim:1 --id 1' makes it longer)";
        assert!(message.contains(longer), "{message}");
    }

    #[test]
    fn brake_locks_on_a_standing_shaft_before_the_output_goes_off() {
        let fleet = Fleet::new(1).brakes(true).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        session.release_brake(MotorId::MIN).unwrap();
        // More than friction holds: 1 A are 2.3 N·m.
        let torque = Torque { current: Current::from_raw(100) };
        repeat(&mut session, &typed("--id 1"), torque, |_| String::new()).unwrap();
        assert!(session.standing(MotorId::MIN).is_err());
        let log = fleet.world.log();
        put_down(&mut session, MotorId::MIN).unwrap();
        let ends = |byte: &u8| matches!(byte, 0x76..=0x81);
        let sent: Vec<u8> = commands(&log).into_iter().filter(ends).collect();
        assert_eq!(sent, [0x81, 0x78, 0x80]);
        session.standing(MotorId::MIN).unwrap();
    }

    /// The load falls if the output goes off before the brake has locked.
    #[test]
    fn a_load_stays_where_it_is_while_a_slow_brake_locks() {
        let load = Load { torque_nm: 5.0, ..Load::NONE };
        let quirks = Quirks { slow_brake: true, ..Quirks::default() };
        let fleet = Fleet::new(1).brakes(true).quirks(quirks).load(load).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        session.ask(MotorId::MIN, Stop).unwrap();
        session.release_brake(MotorId::MIN).unwrap();
        let angle_deg = || fleet.drives[0].with(|drive| drive.state().angle_deg);
        session.stop(StopKind::Hold, MotorId::MIN.into()).unwrap();
        let held_deg = angle_deg();
        put_down(&mut session, MotorId::MIN).unwrap();
        let sunk_deg = (angle_deg() - held_deg).abs();
        assert!(sunk_deg < 0.5, "{sunk_deg}");
        assert!(!fleet.drives[0].with(|drive| drive.state().output_on));
    }

    /// A motor without a brake acknowledges 0x78, too.
    #[test]
    fn a_motor_that_has_no_brake_goes_on_holding_its_load() {
        let load = Load { torque_nm: 5.0, ..Load::NONE };
        let fleet = Fleet::new(1).load(load).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        let angle_deg = || fleet.drives[0].with(|drive| drive.state().angle_deg);
        session.stop(StopKind::Hold, MotorId::MIN.into()).unwrap();
        let held_deg = angle_deg();
        let message = put_down(&mut session, MotorId::MIN).unwrap();
        assert_eq!(
            message,
            "motor 1 is stopped and holds still (0x81) unless its protection (0xB3) ends that"
        );
        let sunk_deg = (angle_deg() - held_deg).abs();
        assert!(sunk_deg < 0.5, "{sunk_deg}");
    }

    #[test]
    fn motor_holds_its_load_again_when_its_brake_does_not_hold() {
        let load = Load { torque_nm: 5.0, ..Load::NONE };
        let fleet = Fleet::new(1).brakes(true).load(load).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        session.release_brake(MotorId::MIN).unwrap();
        fleet.drives[0].with(|drive| drive.plant_mut().force_brake(Some(true)));
        let Err(Unfinished::Failed(message)) = put_down(&mut session, MotorId::MIN) else {
            panic!("its load falls")
        };
        assert!(
            message.contains("its brake was told to lock (0x78) and does not hold"),
            "{message}"
        );
        assert!(
            message.ends_with(
                "motor 1 is stopped and holds still (0x81) unless its protection (0xB3) ends that"
            ),
            "{message}"
        );
        assert!(fleet.drives[0].with(|drive| drive.state().output_on));
    }

    #[test]
    fn error_during_a_run_stops_the_motor_and_is_reported() {
        let fleet = fleet();
        let mut session = Session::on(&fleet);
        let log = fleet.world.log();
        let drive = fleet.drives[0].clone();
        let why = turn(&mut session, || drive.with(|drive| drive.raise_fault(ErrorFlags::STALL)));
        let Unfinished::Failed(message) = why else { panic!("{why:?}") };
        assert!(message.starts_with("motor 1 reports an error (motor stalled): "), "{message}");
        let truth = "; motor 1 has confirmed the stop (0x81) but reports an error (motor stalled), for \
                     which a drive cuts its output: only a locked brake holds its shaft";
        assert!(message.ends_with(truth), "{message}");
        // It is stopped before its state is read.
        let mut commands = commands(&log);
        commands.retain(|byte| *byte != 0x9C);
        assert!(commands.ends_with(&[0x81, 0x9A]), "{commands:02X?}");
    }

    /// Runs the motor like this for this time, and stops it at the end.
    fn run_to_end<C: Command + Copy>(
        session: &mut Session,
        command: C,
        (for_s, opens, end): (f32, bool, StopKind),
        then: impl Fn(),
    ) -> Outcome {
        let run_it = Run { command, does: "turn".to_owned(), needs_open_brake: opens, end };
        let typed = typed(&format!("--id 1 --for-s {for_s} --yes"));
        let reading = |_: &C::Reply| {
            then();
            String::new()
        };
        run(session, &typed, &run_it, |_| Ok(()), reading)
    }

    /// Otherwise a load that only the motor holds would fall, and a turning shaft would turn on.
    #[test]
    fn run_ends_with_brake_locked_and_output_off_unless_the_motor_held() {
        let put_down: &[u8] = &[0x81, 0x78, 0x80];
        for (has_brake, held, last) in [
            (false, false, &[0x81, 0x78, 0x81][..]),
            (true, false, put_down),
            (true, true, &[0x81]),
        ] {
            let fleet = Fleet::new(1).brakes(has_brake).on_can(1_000_000).unwrap();
            let mut session = Session::on(&fleet);
            session.ask(MotorId::MIN, ReleaseBrake).unwrap();
            if held {
                session.ask(MotorId::MIN, Stop).unwrap();
            }
            let log = fleet.world.log();
            run_to_end(&mut session, TURN, (0.3, true, StopKind::Off), || {}).unwrap();
            let is_end = |byte: &u8| matches!(byte, 0x77..=0x81);
            let mut ends: Vec<u8> = commands(&log).into_iter().filter(is_end).collect();
            ends.dedup();
            assert_eq!(ends, last, "{ends:02X?}");
            session.standing(MotorId::MIN).unwrap();
        }
    }

    /// A motor without a brake reports the same, and its load would fall if it were switched off.
    #[test]
    fn motor_that_reports_lock_after_its_release_holds_at_the_end() {
        let quirks = Quirks { brake_told_by_motion: true, ..Quirks::default() };
        let fleet = Fleet::new(1).quirks(quirks).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        let log = fleet.world.log();
        run_to_end(&mut session, TURN, (0.3, true, StopKind::Off), || {}).unwrap();
        let sent = commands(&log);
        let mut ends = sent.iter().copied().filter(|byte| matches!(byte, 0x78 | 0x80 | 0x81));
        assert!(ends.clone().all(|byte| byte != 0x80));
        assert_eq!(ends.next_back(), Some(0x81));
        assert!(fleet.drives[0].with(|drive| drive.state().output_on));
    }

    #[test]
    fn final_stop_that_does_not_hold_is_reported_once() {
        let fleet = fleet();
        let drive = fleet.drives[0].clone();
        let outcome =
            run_to_end(&mut Session::on(&fleet), TURN, (0.25, false, StopKind::Hold), || {
                // What turns it is stronger than the motor.
                drive.with(|drive| drive.plant_mut().lead(0.0, 200.0)).unwrap();
            });
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        assert_eq!(message.matches("does not slow down").count(), 1, "{message}");
    }

    #[test]
    fn final_stop_that_another_master_undoes_is_reported_once() {
        for end in [StopKind::Hold, StopKind::Off] {
            let fleet = fleet();
            // The first of these comes after the run.
            for after_ms in (320..5_000).step_by(20) {
                let after = Sends::Once(Duration::from_millis(after_ms));
                OtherMaster::attach(&fleet, to_first(TURN.encode()), after);
            }
            let mut session = Session::on(&fleet);
            let outcome = run_to_end(&mut session, TURN, (0.3, false, end), || {});
            let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
            assert_eq!(message.matches("goes on commanding").count(), 1, "{message}");
        }
    }

    /// Torque does nothing against a locked brake (2.19.1), and a load would fall if nothing held it.
    #[test]
    fn brake_opens_while_the_motor_holds_before_a_torque_runs() {
        let fleet = Fleet::new(1).brakes(true).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        let log = fleet.world.log();
        let torque = Torque { current: Current::from_raw(100) };
        run_to_end(&mut session, torque, (0.1, true, StopKind::Off), || {}).unwrap();
        let mut begun = commands(&log);
        begun.retain(|byte| [0x77, 0x81, 0xA1].contains(byte));
        assert_eq!(begun[..3], [0x77, 0x81, 0xA1], "{begun:02X?}");
    }

    #[test]
    fn final_stop_without_confirmation_is_reported_once() {
        for end in [StopKind::Hold, StopKind::Off] {
            for opens in [false, true] {
                // The other one goes on acknowledging frames. One command without a reply is no failure.
                let cut = "cut@1+995ms".parse().unwrap();
                let fleet = Fleet::new(2).brakes(true).faults([cut]).on_can(1_000_000).unwrap();
                let mut session = Session::on(&fleet);
                let outcome = run_to_end(&mut session, TURN, (1.0, opens, end), || {});
                let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
                let silent = message.matches("no confirmation of the stop from motor 1").count();
                assert_eq!(silent, 1, "{message}");
            }
        }
    }

    #[test]
    fn ctrl_c_while_a_motor_comes_to_rest_waits_and_is_no_failure() {
        // From 90 dps it takes 0.9 s.
        let slowly = WriteAcceleration {
            index: AccelerationIndex::SPEED_DECELERATION,
            acceleration: Acceleration::try_from_raw(100).unwrap(),
        };
        for (opens, end) in [(false, StopKind::Hold), (true, StopKind::Hold), (true, StopKind::Off)]
        {
            // Soon after the last stop, and while the motor is waited for.
            for after_ms in [1_010, 1_100, 1_600] {
                let fleet = Fleet::new(1).brakes(true).on_can(1_000_000).unwrap();
                let mut session = Session::on(&fleet);
                session.ask(MotorId::MIN, slowly).unwrap();
                CtrlC::attach(&fleet, &session, Duration::from_millis(after_ms));
                let outcome = run_to_end(&mut session, TURN, (1.0, opens, end), || {});
                let message = "interrupted; motor 1 is stopped and holds still (0x81) unless its protection (0xB3) ends that".to_owned();
                assert_eq!(outcome, Err(Unfinished::Interrupted(message)), "{end:?} {after_ms}");
                session.standing(MotorId::MIN).unwrap();
            }
        }
    }

    /// The error of a run of one second with this restart.
    fn error_of_run_with_restart<C: Command + Copy>(command: C, end: StopKind, at: &str) -> String {
        let restart = format!("reset@1+{at}").parse().unwrap();
        let fleet = Fleet::new(1).faults([restart]).on_can(1_000_000).unwrap();
        fleet.world.run_for(Duration::from_secs(1));
        let outcome = run_to_end(&mut Session::on(&fleet), command, (1.0, false, end), || {});
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{at}: {outcome:?}") };
        assert!(message.starts_with("motor 1 has restarted during the run: "), "{at}: {message}");
        message
    }

    /// The motor once counted as having run: the simulated restart takes 44 ms, too short for a silence.
    #[test]
    fn restart_without_a_silence_is_reported() {
        let still = MotionSetPoint { kp: 10.0, kd: 1.0, ..MotionSetPoint::default() };
        let motion = MotionRanges::V4_3.quantise(&still).unwrap();
        // In the middle, and right before the end.
        for at in ["1500ms", "1930ms"] {
            let hold = StopKind::Hold;
            for message in [
                error_of_run_with_restart(TURN, hold, at),
                error_of_run_with_restart(motion, hold, at),
            ] {
                assert!(
                    message.ends_with("motor 1 is stopped and holds still (0x81) unless its protection (0xB3) ends that"),
                    "{at}: {message}"
                );
            }
        }
    }

    /// The motor once counted as having run, or as having heard nothing for too long.
    #[test]
    fn restart_during_the_final_stop_is_reported() {
        // Before the stop is confirmed, and while the program listens whether something else moves the motor.
        for ms in (2_000..2_010).chain([2_200]) {
            let at = format!("{ms}ms");
            let message = error_of_run_with_restart(TURN, StopKind::Hold, &at);
            let (holds, off) = (
                "motor 1 is stopped and holds still (0x81) unless its protection (0xB3) ends that",
                "its shaft is free",
            );
            assert!(message.ends_with(holds) || message.ends_with(off), "{at}: {message}");
            let message = error_of_run_with_restart(TURN, StopKind::Off, &at);
            assert!(
                message.contains("; motor 1 is off (0x80)") || message.ends_with(holds),
                "{at}: {message}"
            );
        }
    }

    #[test]
    fn motor_that_another_master_stopped_is_not_started_again() {
        for (first, holds, how) in [
            (
                0x81,
                true,
                "is stopped and holds still (0x81) unless its protection (0xB3) ends that",
            ),
            (0x80, false, "is off (0x80): its shaft is free unless a brake holds it"),
        ] {
            let fleet = fleet();
            let stop = to_first([first, 0, 0, 0, 0, 0, 0, 0]);
            OtherMaster::attach(&fleet, stop, Sends::Once(Duration::from_millis(300)));
            let mut session = Session::on(&fleet);
            let log = fleet.world.log();
            let why = turn(&mut session, || {});
            let message = format!("something else on this bus has stopped motor 1; motor 1 {how}");
            assert_eq!(why, Unfinished::Failed(message));
            // One command may have been in flight already. The motor is stopped as it was, and not switched on for
            // that.
            let sent = commands(&log);
            let stopped = sent.iter().position(|byte| *byte == first).unwrap();
            let after = &sent[stopped + 1..];
            assert!(after.iter().filter(|byte| **byte == 0xA2).count() <= 1, "{after:02X?}");
            assert!(
                after.iter().all(|byte| [first, 0xA2, 0x9C, 0x9A, 0x70].contains(byte)),
                "{after:02X?}"
            );
            assert_eq!(fleet.drives[0].with(|drive| drive.state().output_on), holds);
            let latest = session.master.now();
            assert!(latest < Instant::from_millis(750), "{latest:?}");
        }
    }

    #[test]
    fn program_that_was_held_up_stops_the_motor_and_moves_it_no_more() {
        let fleet = fleet();
        let mut session = Session::on(&fleet);
        let log = fleet.world.log();
        let frozen = AtomicBool::new(false);
        let outcome = session.moving(MotorId::MIN, |session| {
            repeat(session, &typed("--id 1 --for-s 60"), TURN, |_| {
                if !frozen.swap(true, Ordering::Relaxed) {
                    log.take();
                    fleet.world.run_for(Duration::from_secs(5));
                }
                String::new()
            })
        });
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        assert!(message.starts_with("this program was held up for 5.0"), "{message}");
        assert!(
            message.ends_with(
                "; motor 1 is stopped and holds still (0x81) unless its protection (0xB3) ends that"
            ),
            "{message}"
        );
        let commands = commands(&log);
        assert!(!commands.contains(&0xA2) && commands.contains(&0x81), "{commands:02X?}");
    }

    #[test]
    fn a_panic_stops_the_motor_before_it_goes_on() {
        let fleet = fleet();
        let mut session = Session::on(&fleet);
        let log = fleet.world.log();
        let panics = AssertUnwindSafe(|| turn(&mut session, || panic!("made up")));
        catch_unwind(panics).unwrap_err();
        let mut commands = commands(&log);
        commands.retain(|byte| *byte != 0x9C);
        assert_eq!((commands.contains(&0xA2), commands.last()), (true, Some(&0x81)));
    }

    #[test]
    fn silent_motor_is_reported_with_advice_to_cut_its_power() {
        // The other one goes on acknowledging frames.
        let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        let (world, station) = (fleet.world.clone(), fleet.drives[0].station());
        let why = turn(&mut session, || world.cut(station));
        let Unfinished::Failed(message) = why else { panic!("{why:?}") };
        assert!(message.contains("from motor 1: cut its power"), "{message}");
    }

    #[test]
    fn motor_that_falls_silent_in_a_run_gets_six_more_commands() {
        // After the 21st command, and not soon before errors are read. The other one goes on acknowledging frames.
        let cut = "cut@1+206ms".parse().unwrap();
        let fleet = Fleet::new(2).faults([cut]).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        let log = fleet.world.log();
        turn(&mut session, || {});
        let turned = commands(&log).into_iter().filter(|byte| *byte == 0xA2).count();
        assert_eq!(turned, 21 + 6);
    }

    #[test]
    fn single_lost_replies_do_not_add_up_to_a_silence() {
        let lose = "lose=0.05".parse().unwrap();
        let fleet = Fleet::new(1).faults([lose]).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        let log = fleet.world.log();
        repeat(&mut session, &typed("--id 1 --for-s 2"), TURN, |_| String::new()).unwrap();
        let is_lost = |record: &Record<SimpleFrame>| matches!(record.event, Event::Faulted { .. });
        let lost = log.take().iter().filter(|record| is_lost(record)).count();
        // Most of the exchanges are those of the run.
        assert!(lost > 2 * MOST_MISSED as usize, "{lost}");
    }
}
