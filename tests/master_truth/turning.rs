//! Shafts that turn, drives that lose their turns, and what shows that in the feedback of a stream.

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
    /// Where it was when it began, in degrees.
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

    /// The drive restarts, and knows no whole turns any more.
    pub(crate) fn loses_turns(&mut self, now: Instant) {
        (self.began_at, self.began) = (self.degrees(now).rem_euclid(360), now);
    }
}

/// What the feedback of a stream has shown of where a motor is.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Turning {
    /// The last angle that was reported right after it was measured.
    last: Option<(i16, Instant)>,
    /// It jumped then, and no restart was reported yet.
    jumped: Option<Instant>,
    /// Until then feedback may be that to an earlier set-point, which was given up. If its own feedback then comes, it
    /// may be taken for that to the next set-point. So this lasts for as long as the stream.
    in_doubt_until: Instant,
    /// Its shaft turns by more than half a turn while a reply may be late.
    pub(crate) is_fast: bool,
}

impl Turning {
    /// An angle is reported. It may or may not be certain that it was measured just before.
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

    /// Its next angle shows nothing, since something else was reported of it.
    pub(crate) fn is_unknown(&mut self) {
        self.last = None;
    }

    pub(crate) fn restarted(&mut self) {
        (self.last, self.jumped) = (None, None);
    }

    /// A set-point was given up, or pushed aside by a stop.
    pub(crate) fn was_given_up(&mut self, until: Instant) {
        self.in_doubt_until = self.in_doubt_until.max(until);
    }

    /// Its reported angle differs from where it is now by so much that this may seem a jump.
    pub(crate) fn may_seem_to_jump(&self, now: Instant) -> bool {
        self.is_fast && now <= self.in_doubt_until
    }

    /// It has jumped, so that nothing may move it.
    pub(crate) fn has_jumped(&self) -> bool {
        self.jumped.is_some()
    }

    /// A restart that shows by a jump of the angle has not been reported for this long.
    pub(crate) fn is_restart_untold(&self, now: Instant, within: Duration) -> bool {
        self.jumped.is_some_and(|since| now - since > within)
    }
}
