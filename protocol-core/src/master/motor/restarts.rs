//! What shows that a motor has restarted: the turns that it had counted are lost, and its next move starts from
//! wherever it now believes to be.

use crate::command::{AnyReply, RunTime};
use crate::master::config::Config;
use crate::master::event::{Failure, feedback_of};
use crate::master::motor::stopping::LastStop;
use crate::master::motor::{LastSent, Motor, News};
use crate::time::{Duration, Instant};

/// A motor that was silent for this long and answers again may have restarted: that takes 1.1 s.
pub(super) const RESTART_TAKES: Duration = Duration::from_secs(1);

/// A drive's clock may differ by this much, and by one part in this many of the time that it has run.
const CLOCKS_DIFFER: u32 = steps(Duration::from_millis(250));
const CLOCKS_DIFFER_BY: u32 = 64;
/// A drive's time starts anew after 49.7 days, and steps wrap after 50.9: for longer times nothing can be concluded.
const MAY_WRAP: u32 = steps(Duration::from_secs(48 * 24 * 3_600));

/// A time in steps of 1,024 us, which wrap: milliseconds would need a 64-bit division.
const fn steps(span: Duration) -> u32 {
    (span.as_micros() >> 10) as u32
}

/// A point in time in these steps.
fn step_of(at: Instant) -> u32 {
    steps(at - Instant::ZERO)
}

/// No motor turns a degree in less time: 10,000 dps.
const DEGREE_TAKES: Duration = Duration::from_micros(100);
/// In degrees: a position further away is nearer to another turn.
const HALF_A_TURN: u16 = 180;
pub(crate) const HALF_A_TURN_TAKES: Duration = DEGREE_TAKES.times(HALF_A_TURN as u32);

/// Motion mode reports the position on a scale of the firmware's, which need not be known here. On the narrowest, of 25
/// rad (V4.3), a turn is a quarter of it, and 10,000 dps are 458 steps in a millisecond.
const EIGHTH_OF_SCALE: u16 = 1 << 13;
const STEP_TAKES: Duration = Duration::from_micros(2);

/// The motor's position according to feedback.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Position {
    Degrees(i16),
    /// In steps of the scale of motion mode.
    OfScale(u16),
}

impl Position {
    pub(crate) fn of(reply: &AnyReply) -> Option<Self> {
        match reply {
            AnyReply::Motion(raw) => Some(Self::OfScale(raw.position)),
            _ => feedback_of(reply).map(|feedback| Self::Degrees(feedback.angle.raw())),
        }
    }

    /// How long the way to `other` takes at least, without its first half turn, or eighth of the scale; `None` if it is
    /// no longer than that. After another kind of stream the way is not known.
    fn shortest_way_to(self, other: Self) -> Option<Duration> {
        let (beyond, takes) = match (self, other) {
            (Self::Degrees(from), Self::Degrees(to)) => {
                let turned = to.wrapping_sub(from).unsigned_abs();
                (turned.checked_sub(HALF_A_TURN)?, DEGREE_TAKES)
            }
            (Self::OfScale(from), Self::OfScale(to)) => {
                (to.abs_diff(from).checked_sub(EIGHTH_OF_SCALE)?, STEP_TAKES)
            }
            _ => return None,
        };
        Some(takes.times(beyond.into()))
    }
}

impl Motor {
    /// A motor that did not answer last time, and was silent for as long as a restart takes, is not moved: the first
    /// move that it hears would start from wherever it believes to be. The exception is a motor that the caller has
    /// resumed since its last answer, or the last that did not come. Returns whether it has restarted.
    pub(crate) fn note_restart_if_silent(&mut self, config: &Config, now: Instant) -> bool {
        if self.was_missed() && !self.last_sent.contains(LastSent::IS_RESUMED) {
            self.note_silence(config, now);
        }
        self.has_restarted
    }

    /// It is silent. Notes a restart if that has lasted for as long as one takes.
    #[inline(never)]
    pub(super) fn note_silence(&mut self, config: &Config, now: Instant) {
        let is_silent = self.health.last_seen().is_some_and(|seen| now - seen >= RESTART_TAKES);
        if is_silent && !self.has_restarted {
            self.begin_anew(config, now);
        }
    }

    /// It is heard for the first time, so it has started, unless it was told to restart: that may be yet to come.
    #[inline(never)]
    pub(super) fn note_first_heard(&mut self, config: &Config, now: Instant) {
        let (now, latest) = (step_of(now), step_of(now + config.restart_time));
        if self.started_by.wrapping_sub(now) > latest.wrapping_sub(now) {
            self.started_by = now;
        }
    }

    /// It has said how long it had run when it was asked last, or up to this much `earlier`.
    pub(crate) fn note_run_time(
        &mut self,
        runs: RunTime,
        earlier: Duration,
        config: &Config,
        now: Instant,
    ) {
        let run = steps(Duration::from_millis(runs.run_time.raw().into()));
        // It has run at least this long: from when it is known to have started until it was asked. If that start lies
        // ahead, this wraps to more than any run time.
        let asked = step_of(self.sent).wrapping_sub(steps(earlier));
        let least = asked.wrapping_sub(self.started_by);
        let most = run.saturating_add(CLOCKS_DIFFER + run / CLOCKS_DIFFER_BY);
        if (most..MAY_WRAP).contains(&least) {
            self.begin_anew(config, now);
        }
        self.started_by = step_of(now).wrapping_sub(run);
    }

    /// Feedback of its stream reports its position. Notes a restart if that is further away than it can have turned.
    #[inline(never)]
    pub(crate) fn note_position(&mut self, position: Position, config: &Config, now: Instant) {
        let shortest = self.position.and_then(|before| before.shortest_way_to(position));
        if shortest.is_some_and(|shortest| shortest > now - self.position_at) {
            self.begin_anew(config, now);
        }
    }

    /// It has restarted, or may have: nothing moves it until the caller knows.
    #[inline(never)]
    pub(crate) fn begin_anew(&mut self, config: &Config, now: Instant) {
        self.has_restarted = true;
        self.is_left_to_hold = false;
        self.reports = 0;
        // A command may be about to restart it.
        self.started_by = step_of(now + config.restart_time);
        self.position = None;
        self.doubt_hold();
        if let LastStop::Confirmed(_) = self.last_stop {
            self.last_stop = LastStop::None;
        }
        self.news.insert(News::RESTARTED);
        self.drop_what_moves(Failure::Dropped, config, now);
    }
}
