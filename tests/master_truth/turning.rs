//! Shafts that turn, drives that lose their turns, and how the feedback of a stream shows that.

use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_tests::dice::Dice;

/// No motor is faster.
const FASTEST_DPS: i64 = 10_000;
/// Within this margin an angle may be one turn or another.
const HALF_A_TURN: i64 = 180;

/// A shaft that turns evenly.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shaft {
    speed_dps: i64,
    /// Its angle at the beginning, in degrees.
    began_at: i64,
    began: Instant,
}

impl Shaft {
    pub(crate) fn new(dice: &mut Dice) -> Self {
        let speeds = [0, 360, -2_000, FASTEST_DPS, -FASTEST_DPS];
        let speed_dps = speeds[dice.below(speeds.len() as u64) as usize];
        let began_at = dice.below(4_000) as i64 - 2_000;
        Self { speed_dps, began_at, began: Instant::ZERO }
    }

    fn degrees(&self, now: Instant) -> i64 {
        self.began_at + self.speed_dps * (now - self.began).as_micros() as i64 / 1_000_000
    }

    /// The angle in feedback.
    pub(crate) fn angle(&self, now: Instant) -> i16 {
        self.degrees(now) as i16
    }

    /// Whether it turns by more than half a turn while a reply may be late.
    pub(crate) fn is_fast(&self) -> bool {
        self.speed_dps.abs() == FASTEST_DPS
    }

    /// The drive restarts and forgets whole turns.
    pub(crate) fn loses_turns(&mut self, now: Instant) {
        (self.began_at, self.began) = (self.degrees(now).rem_euclid(360), now);
    }
}

/// What the feedback of a stream has shown about a motor's angle.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Turning {
    /// The last angle that was reported right after it was measured.
    last: Option<(i16, Instant)>,
    /// When the angle jumped, if no restart was reported since.
    jumped: Option<Instant>,
    /// Until then feedback may belong to an earlier set-point that was given up. The right feedback may then pass for
    /// the feedback to the next set-point, and so on for as long as the stream lasts.
    in_doubt_until: Instant,
    /// Its shaft turns by more than half a turn while a reply may be late.
    pub(crate) is_fast: bool,
}

impl Turning {
    /// An angle is reported. `is_certain`: it was certainly measured just before.
    pub(crate) fn told(&mut self, angle: i16, is_certain: bool, now: Instant, window: Duration) {
        let is_in_doubt = now <= self.in_doubt_until;
        if is_in_doubt {
            self.in_doubt_until = now + window;
        }
        if let Some((before, at)) = self.last {
            let turned = i64::from(angle.wrapping_sub(before).unsigned_abs());
            let possible = FASTEST_DPS * (now - at).as_micros() as i64 / 1_000_000;
            // A degree more, since both are rounded.
            if turned > HALF_A_TURN + possible + 1 {
                self.jumped.get_or_insert(now);
            }
        }
        if is_certain && !is_in_doubt {
            self.last = Some((angle, now));
        }
    }

    /// The next angle shows no jump, because feedback without an angle was reported.
    pub(crate) fn is_unknown(&mut self) {
        self.last = None;
    }

    pub(crate) fn restarted(&mut self) {
        (self.last, self.jumped) = (None, None);
    }

    /// A set-point was given up or pushed aside by a stop.
    pub(crate) fn was_given_up(&mut self, until: Instant) {
        self.in_doubt_until = self.in_doubt_until.max(until);
    }

    /// Whether a reported angle may be so old that it seems a jump.
    pub(crate) fn may_seem_to_jump(&self, now: Instant) -> bool {
        self.is_fast && now <= self.in_doubt_until
    }

    /// Whether the angle has jumped, so that nothing may move the motor.
    pub(crate) fn has_jumped(&self) -> bool {
        self.jumped.is_some()
    }

    /// Whether a restart that a jump of the angle shows was not reported within this time.
    pub(crate) fn is_restart_untold(&self, now: Instant, within: Duration) -> bool {
        self.jumped.is_some_and(|since| now - since > within)
    }
}
