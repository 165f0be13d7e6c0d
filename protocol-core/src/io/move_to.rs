//! Moves a motor to an angle and watches it until it is there.

use core::ops::{ControlFlow, Range};

use crate::command::{
    AbsolutePosition, Command, ForcePosition, IncrementalPosition, ReadMultiTurnAngle, ReadRunTime,
    ReadStatus1, ReadStatus2,
};
use crate::error::RequestError;
use crate::id::MotorId;
use crate::io::asking::CallError;
use crate::io::brake::leave_to_brake;
use crate::io::calls::Calls;
use crate::io::on_drop::OnDrop;
use crate::io::outcome::{MoveFailure, MoveProgress, NotArrived};
use crate::io::restart::has_started_since;
use crate::io::standing::{runs, turns};
use crate::master::{Failure, StopKind};
use crate::opcode::Repeat;
use crate::time::{Duration, Instant};
use crate::units::{Angle, CoarseSpeed, MaxSpeed, MaxTorque};

/// How often the motor is looked at.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// In more time than this between two looks the motor may have begun to turn and have come to rest far away.
const LONGEST_LOOK: Duration = Duration::from_millis(100);
/// How often its errors are looked at, in looks.
const ERRORS_EVERY: u32 = 5;
/// How often a command that names a place is sent if no reply comes.
const ATTEMPTS: u8 = 3;
/// A motor stands if it has not turned for this long. One that swings stands for a moment, too.
const STANDS_AFTER: Duration = Duration::from_millis(100);
/// Each move is given `START`, plus `TIMES` times as long as it should take.
const START: Duration = Duration::from_secs(5);
const TIMES: u64 = 3;
/// The speed that a motor without a speed limit is expected to reach.
const UNLIMITED_DPS: u16 = 90;

/// A command that moves a motor to an angle: 0xA4, 0xA8 or 0xA9.
pub trait MoveCommand: Command + Copy {
    /// Where it ends, from here; `None` if that is further than an angle can be.
    fn target(&self, here: Angle) -> Option<Angle>;

    /// The highest speed on the way.
    fn max_speed(&self) -> MaxSpeed;

    /// The largest torque on the way, if the command limits it.
    fn max_torque(&self) -> Option<MaxTorque> {
        None
    }
}

impl MoveCommand for AbsolutePosition {
    fn target(&self, _: Angle) -> Option<Angle> {
        Some(self.angle)
    }

    fn max_speed(&self) -> MaxSpeed {
        self.max_speed
    }
}

impl MoveCommand for ForcePosition {
    fn target(&self, _: Angle) -> Option<Angle> {
        Some(self.angle)
    }

    fn max_speed(&self) -> MaxSpeed {
        self.max_speed
    }

    fn max_torque(&self) -> Option<MaxTorque> {
        Some(self.max_torque)
    }
}

impl MoveCommand for IncrementalPosition {
    fn target(&self, here: Angle) -> Option<Angle> {
        here.raw().checked_add(self.angle.raw()).map(Angle::from_raw)
    }

    fn max_speed(&self) -> MaxSpeed {
        self.max_speed
    }
}

/// When a move has arrived, when it has failed, and what happens then.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default))]
pub struct MoveLimits {
    /// The motor has arrived if it stands still and is no further from the target than this.
    pub tolerance: Angle,
    /// How long the move may take. `None` stands for 5 s plus three times what the way takes at the move's largest
    /// speed, or at 90 dps if it has no speed limit.
    pub time: Option<Duration>,
    /// A motor that comes no nearer for this long has stalled. Coming nearer by less than the tolerance does not count.
    pub stalled_after: Duration,
    /// What happens to a motor that has stalled.
    pub when_stalled: WhenStalled,
    /// How the motor is stopped if it does not arrive, or if the move is left halfway.
    ///
    /// - [`StopKind::Hold`] holds the motor where it is **with all its torque**, whatever limited the torque of the
    ///   move. So a gripper crushes what it has just met, by as much as its way to rest takes.
    /// - [`StopKind::Off`] lets go, even if the move was refused before it was sent. A load falls unless a brake holds
    ///   it, and until the brake does, which takes its time. A motor that another stop already holds is not let go.
    pub stop: StopKind,
}

/// What happens to a motor that has stalled on its way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum WhenStalled {
    /// The move has failed, and the motor is [stopped](MoveLimits::stop).
    #[default]
    Stop,
    /// The motor goes on pressing with the torque that the move allows, as a gripper does ([`ForcePosition`]), and the
    /// move ends well. Its [`angle`](MoveProgress::angle) is where the motor has met something.
    ///
    /// How hard it meets that depends on its speed, which the torque does not limit: let it come slowly. To hold on,
    /// send the same command again as a set-point. Another move finds that the motor comes no nearer, and so fails: it is
    /// [stopped](MoveLimits::stop), and lets go if that is [`StopKind::Off`].
    ///
    /// The motor has met something only if it stands, and stands nearer to its target than where the move began.
    /// Otherwise the move has failed and the motor is stopped. One that turns is driven away
    /// ([`MoveFailure::Turning`]). One that has never moved was held from the start ([`MoveFailure::Stalled`]), for
    /// example because it grips already.
    Press,
}

/// Within 0.2 degrees, in the usual time, with at most a second without progress; otherwise a stop that holds.
impl Default for MoveLimits {
    fn default() -> Self {
        Self {
            tolerance: Angle::from_raw(20),
            time: None,
            stalled_after: Duration::from_secs(1),
            when_stalled: WhenStalled::Stop,
            stop: StopKind::Hold,
        }
    }
}

/// As [`bring_up::move_to`](crate::io::bring_up::move_to). If this future is dropped on the way, the stop is in force,
/// and is the first thing that any other future of the loop sends.
pub async fn move_to<B: Calls<N>, C: MoveCommand, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    command: C,
    limits: &MoveLimits,
    on_look: impl FnMut(&MoveProgress) -> ControlFlow<()>,
) -> Result<MoveProgress, NotArrived<B::Error>> {
    let kind_of_stop = |bus: &mut B| match bus.may_move(motor) {
        Err(RequestError::Stopped) => StopKind::Hold,
        _ => limits.stop,
    };
    let moving = OnDrop::new(bus, |bus: &mut &mut B| {
        let kind = kind_of_stop(bus);
        bus.begin_stop(motor, kind);
    });
    let outcome = go(moving.it, motor, command, limits, on_look).await;
    let result = match outcome {
        Ok(arrival) => Ok(arrival),
        Err(why) => {
            let kind = kind_of_stop(moving.it);
            let is_stopped = moving.it.stop(motor, kind).await;
            if let MoveFailure::Fault(_) = why {
                leave_to_brake(&mut *moving.it, motor).await;
            }
            Err(NotArrived { motor, why, is_stopped })
        }
    };
    moving.end();
    result
}

async fn go<B: Calls<N>, C: MoveCommand, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    command: C,
    limits: &MoveLimits,
    mut on_look: impl FnMut(&MoveProgress) -> ControlFlow<()>,
) -> Result<MoveProgress, MoveFailure<B::Error>> {
    if command.max_torque() == Some(MaxTorque::NO_LIMIT) {
        return Err(MoveFailure::NoTorque);
    }
    // Several questions come before the move: a drive that has lost its master obeys only when it is spoken to steadily
    // (2.31.1).
    let errors = bus.ask(motor, ReadStatus1).await?.errors;
    if !errors.is_empty() {
        return Err(MoveFailure::Fault(errors));
    }
    let ran = bus.ask(motor, ReadRunTime).await?.run_time.into();
    let begun = bus.now();
    let from = bus.ask(motor, ReadMultiTurnAngle).await?.angle;
    let mut last = Look { at: begun, angle: from, dps: 0 };
    let target = command.target(from).ok_or(MoveFailure::OutOfRange { here: from })?;
    // A command that names a place may be sent again.
    let attempts = if command.kind().repeat() == Repeat::ActsAgain { 1 } else { ATTEMPTS };
    bus.ask_often(motor, command, Some(attempts)).await.map_err(|error| match error {
        CallError::Failed { failure: Failure::NoReply, .. } => MoveFailure::Silent { at: from },
        error => error.into(),
    })?;

    let start = bus.now();
    let time = limits.time.unwrap_or_else(|| usual_time(from, target, command.max_speed()));
    let mut nearest = Nearest { distance: u32::MAX, since: start };
    let mut last_turn = LastTurn { at: start, speed: CoarseSpeed::from_raw(0) };
    let mut looks = 0;
    loop {
        bus.wait_until(start + LOOK_EVERY.times(looks)).await?;
        let at = bus.now();
        let reading = bus.ask(motor, ReadMultiTurnAngle).await;
        let angle = reading.map_err(unseen_since(last.angle))?.angle;
        let feedback = bus.ask(motor, ReadStatus2).await.map_err(unseen_since(angle))?;
        let look = Look { at, angle, dps: feedback.speed.raw().unsigned_abs() };
        // If the caller took its time, nobody looked meanwhile, and the motor may have turned at any speed.
        let is_sure = bus.now() - last.at <= LONGEST_LOOK;
        if look.has_jumped_from(&last, bus.now())
            && (is_sure
                || may_have_started(bus, motor, begun, ran).await.map_err(unseen_since(angle))?)
        {
            bus.note_restart(motor);
        }
        last = look;
        // After a restart the target is no longer where it was.
        bus.may_move(motor).map_err(CallError::refused(motor))?;
        // The caller may have been held up since the motor was asked: what it says is from between `at` and now.
        let now = bus.now();
        let progress = MoveProgress { from, target, time: now - start, angle, feedback };
        let distance = angle.raw().abs_diff(target.raw());
        let tolerance = limits.tolerance.raw().unsigned_abs();
        let has_arrived = distance <= tolerance && feedback.speed.raw() == 0;
        last_turn.note(feedback.speed, now);
        let has_stalled = nearest.has_stalled(distance, tolerance, at..now, limits.stalled_after);
        let is_time_up = at - start > time;
        let is_over = has_arrived || has_stalled || is_time_up;
        // An error may just have come. Then the motor does not hold where it stands, or comes no nearer because of the
        // error.
        if looks % ERRORS_EVERY == 0 || is_over {
            let errors = bus.ask(motor, ReadStatus1).await.map_err(unseen_since(angle))?.errors;
            if !errors.is_empty() {
                return Err(MoveFailure::Fault(errors));
            }
        }
        if !has_arrived && on_look(&progress).is_break() {
            return Err(MoveFailure::GivenUp);
        }
        let runs = if is_over { runs(bus, motor).await } else { Some(true) };
        if runs.is_none() {
            // It may not know that question, or be gone.
            bus.ask(motor, ReadStatus1).await.map_err(unseen_since(angle))?;
        }
        if runs == Some(false) {
            let has_started = may_have_started(bus, motor, begun, ran).await;
            if has_started.map_err(unseen_since(angle))? {
                bus.note_restart(motor);
            }
            bus.may_move(motor).map_err(CallError::refused(motor))?;
            return Err(MoveFailure::LetGo { at: angle });
        }
        if has_arrived {
            return Ok(progress);
        }
        if has_stalled {
            return end_of_stall(progress, limits, &last_turn, at);
        }
        if is_time_up {
            return Err(MoveFailure::TimedOut { at: angle, target });
        }
        looks += 1;
    }
}

/// Whether the drive has started since `then`, when it had run for `ran`, or may have: the target may be elsewhere now.
async fn may_have_started<B: Calls<N>, const N: usize>(
    bus: &mut B,
    motor: MotorId,
    then: Instant,
    ran: Duration,
) -> Result<bool, CallError<B::Error>> {
    Ok(has_started_since(bus, motor, then, ran).await?.unwrap_or(true))
}

/// Why a look at a motor that was last seen at `at` has failed.
fn unseen_since<E>(at: Angle) -> impl Fn(CallError<E>) -> MoveFailure<E> {
    move |error| match error {
        // It had heard nothing for too long, and has ended the move on its own.
        CallError::Failed { failure: Failure::NotExecuted, .. } => MoveFailure::LetGo { at },
        CallError::Failed { failure: Failure::NoReply, .. } => MoveFailure::Silent { at },
        error => error.into(),
    }
}

/// The outcome for a motor that comes no nearer.
fn end_of_stall<E>(
    progress: MoveProgress,
    limits: &MoveLimits,
    last_turn: &LastTurn,
    asked_at: Instant,
) -> Result<MoveProgress, MoveFailure<E>> {
    let MoveProgress { from, target, angle: at, .. } = progress;
    if last_turn.is_recent(asked_at, limits.stalled_after) {
        return Err(MoveFailure::Turning { at, target, speed: last_turn.speed });
    }
    let distance = |angle: Angle| angle.raw().abs_diff(target.raw());
    let tolerance = limits.tolerance.raw().unsigned_abs();
    match limits.when_stalled {
        WhenStalled::Press if distance(at).saturating_add(tolerance) < distance(from) => {
            Ok(progress)
        }
        WhenStalled::Press | WhenStalled::Stop => Err(MoveFailure::Stalled { at, target }),
    }
}

/// A look at the motor.
struct Look {
    /// When it began.
    at: Instant,
    angle: Angle,
    dps: u16,
}

impl Look {
    /// Whether the motor is more than half a turn further from its last place than it can have turned at twice the
    /// speed that was seen: then it has lost its turns.
    fn has_jumped_from(&self, last: &Self, now: Instant) -> bool {
        let dps = 2 * u64::from(self.dps.max(last.dps));
        let most_hundredths = 18_000 + dps * (now - last.at).as_micros() / 10_000;
        u64::from(self.angle.raw().abs_diff(last.angle.raw())) > most_hundredths
    }
}

/// How near the motor has come so far, and when.
struct Nearest {
    distance: u32,
    since: Instant,
}

impl Nearest {
    /// Whether it has come no nearer for `after`, when it was `distance` away at some time of this look. Coming nearer
    /// by less than the tolerance does not count.
    fn has_stalled(
        &mut self,
        distance: u32,
        tolerance: u32,
        look: Range<Instant>,
        after: Duration,
    ) -> bool {
        if distance.saturating_add(tolerance) < self.distance {
            *self = Self { distance, since: look.end };
        }
        look.start - self.since > after
    }
}

/// When the motor last turned, and how fast.
struct LastTurn {
    at: Instant,
    speed: CoarseSpeed,
}

impl LastTurn {
    fn note(&mut self, speed: CoarseSpeed, now: Instant) {
        if turns(speed) {
            *self = Self { at: now, speed };
        }
    }

    /// Whether it may still be turning: it turned within `STANDS_AFTER`, or within `stalled_after` if that is shorter.
    /// A motor that has turned only until it last came nearer has had all the time to come to rest that the caller
    /// allows.
    fn is_recent(&self, now: Instant, stalled_after: Duration) -> bool {
        now - self.at <= STANDS_AFTER.min(stalled_after)
    }
}

/// How long a motor usually takes at most.
fn usual_time(from: Angle, to: Angle, max_speed: MaxSpeed) -> Duration {
    let dps = match max_speed.raw() {
        0 => UNLIMITED_DPS,
        dps => dps,
    };
    let hundredths = u64::from(from.raw().abs_diff(to.raw()));
    START + Duration::from_micros(TIMES * hundredths * 10_000 / u64::from(dps))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::Feedback;
    use crate::units::{CoarseAngle, Current, Temperature};

    #[test]
    fn move_gets_three_times_its_usual_time_and_five_seconds() {
        let time = |from, to, dps| {
            usual_time(Angle::from_raw(from), Angle::from_raw(to), MaxSpeed::from_raw(dps))
                .as_millis()
        };
        assert_eq!(time(0, 9_000, 90), 8_000);
        assert_eq!(time(1_000, -8_000, 45), 11_000);
        assert_eq!(time(0, 9_000, 0), 8_000);
    }

    #[test]
    fn turn_lost_between_two_looks_is_a_jump() {
        let look = |ms, degrees: i32, dps| Look {
            at: Instant::from_millis(ms),
            angle: Angle::from_raw(100 * degrees),
            dps,
        };
        // 180 degrees and, in 50 ms at twice 500 dps, another 50.
        let last = look(100, 720, 500);
        for (degrees, is_jump) in [(720, false), (490, false), (489, true), (951, true)] {
            let jumped = look(120, degrees, 0).has_jumped_from(&last, Instant::from_millis(150));
            assert_eq!(jumped, is_jump, "{degrees}");
        }
        assert!(
            !look(120, 950, 500).has_jumped_from(&look(100, 720, 0), Instant::from_millis(150))
        );
    }

    #[test]
    fn move_that_comes_no_nearer_than_its_tolerance_has_stalled() {
        let at = Instant::from_millis;
        let after = Duration::from_millis(100);
        let mut nearest = Nearest { distance: u32::MAX, since: at(0) };
        let look = |began_ms| at(began_ms)..at(began_ms + 5);
        assert!(!nearest.has_stalled(1_000, 20, look(10), after));
        assert!(!nearest.has_stalled(970, 20, look(90), after), "it came nearer");
        // From the end of that look to the beginning of this one.
        assert!(!nearest.has_stalled(960, 20, look(195), after));
        assert!(nearest.has_stalled(955, 20, look(196), after), "by a creep");
    }

    /// What becomes of one that began at 0, is to be at 40 degrees, turned for the last time so long ago, and stands
    /// at `degrees`.
    fn pressing(degrees: i32, turned_ms_ago: u64, stalled_after_ms: u64) -> bool {
        let angle = |degrees: i32| Angle::from_raw(100 * degrees);
        let at = angle(degrees);
        let feedback = Feedback {
            temperature: Temperature::from_raw(25),
            current: Current::from_raw(0),
            speed: CoarseSpeed::from_raw(0),
            angle: CoarseAngle::from_raw(0),
        };
        let time = Duration::from_secs(2);
        let progress =
            MoveProgress { from: angle(0), target: angle(40), time, angle: at, feedback };
        let limits = MoveLimits {
            when_stalled: WhenStalled::Press,
            stalled_after: Duration::from_millis(stalled_after_ms),
            ..MoveLimits::default()
        };
        let now = Instant::from_millis(2_000);
        let last_turn = LastTurn {
            at: Instant::from_millis(2_000 - turned_ms_ago),
            speed: CoarseSpeed::from_raw(9),
        };
        end_of_stall::<()>(progress, &limits, &last_turn, now).is_ok()
    }

    #[test]
    fn only_a_motor_nearer_than_at_its_start_presses() {
        assert!(pressing(20, 1_000, 1_000));
        assert!(!pressing(0, 1_000, 1_000), "it has not moved");
        assert!(!pressing(-20, 1_000, 1_000), "it was driven away, and stands");
        assert!(!pressing(81, 1_000, 1_000), "it was driven past");
    }

    #[test]
    fn motor_that_stands_for_a_moment_does_not_press() {
        assert!(!pressing(20, 100, 1_000), "it swings, or slips");
        assert!(pressing(20, 101, 1_000));
        assert!(!pressing(20, 0, 0), "it turns");
        assert!(pressing(20, 21, 20), "it has had the time that it was given");
    }

    #[test]
    fn motor_that_stands_still_has_stalled_with_a_zero_tolerance() {
        let at = Instant::from_millis;
        let after = Duration::from_millis(100);
        let mut nearest = Nearest { distance: u32::MAX, since: at(0) };
        assert!(!nearest.has_stalled(1_000, 0, at(10)..at(10), after));
        assert!(nearest.has_stalled(1_000, 0, at(111)..at(111), after));
    }
}
