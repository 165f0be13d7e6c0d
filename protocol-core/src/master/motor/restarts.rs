//! What shows that a motor has restarted: the turns that it had counted are gone, and the next move starts from
//! wherever it now believes to be.

use crate::command::AnyReply;
use crate::master::config::Config;
use crate::master::event::{Failure, feedback_of};
use crate::master::motor::{Motor, News};
use crate::time::{Duration, Instant};

/// A motor that was silent for so long and answers again may have restarted: that takes 1.1 s.
pub(super) const RESTART_TAKES: Duration = Duration::from_secs(1);

/// No motor turns a degree in less: 10,000 dps.
const DEGREE_TAKES: Duration = Duration::from_micros(100);
/// In degrees: what lies further away is nearer to another turn.
const HALF_A_TURN: u16 = 180;
pub(in crate::master) const HALF_A_TURN_TAKES: Duration = DEGREE_TAKES.times(HALF_A_TURN as u32);

/// Where the motor is, in degrees, if this feedback says so.
pub(in crate::master) fn angle_of(reply: &AnyReply) -> Option<i16> {
    feedback_of(reply).map(|feedback| feedback.angle.raw())
}

impl Motor {
    /// Who was silent for as long as a restart takes gets no more set-points: the first that it heard would move it
    /// from wherever it thinks it is.
    pub(super) fn was_silent(&mut self, config: &Config, now: Instant) {
        let is_silent = self.health.last_seen().is_some_and(|seen| now - seen >= RESTART_TAKES);
        if is_silent && !self.has_restarted {
            self.has_begun_anew(config, now);
        }
    }

    /// It is heard again after so long.
    #[inline]
    pub(super) fn is_back_after(&mut self, silence: Duration, config: &Config, now: Instant) {
        if self.was_missed() && silence >= RESTART_TAKES {
            self.has_begun_anew(config, now);
        }
    }

    /// It has said how long it has run.
    pub(in crate::master) fn has_run_for(
        &mut self,
        run_time_ms: u32,
        config: &Config,
        now: Instant,
    ) {
        let before = core::mem::replace(&mut self.run_time_ms, run_time_ms);
        if run_time_ms < before {
            self.has_begun_anew(config, now);
        }
    }

    /// Feedback of its stream says where it is, in degrees: further from where it was than it can have turned since.
    #[inline(never)]
    pub(in crate::master) fn note_angle(&mut self, angle: i16, config: &Config, now: Instant) {
        let knows_angle = core::mem::take(&mut self.knows_angle);
        let Some(before) = self.latest.filter(|_| knows_angle).and_then(|it| angle_of(&it)) else {
            return;
        };
        let turned = angle.wrapping_sub(before).unsigned_abs();
        let beyond = u32::from(turned.saturating_sub(HALF_A_TURN));
        if DEGREE_TAKES.times(beyond) > now - self.latest_at {
            self.has_begun_anew(config, now);
        }
    }

    /// It has restarted, or may have: nothing moves it until the caller knows.
    #[inline(never)]
    pub(in crate::master) fn has_begun_anew(&mut self, config: &Config, now: Instant) {
        self.has_restarted = true;
        self.reports = 0;
        self.run_time_ms = 0;
        self.knows_angle = false;
        self.news.insert(News::RESTARTED);
        self.drop_what_moves(Failure::Dropped, config, now);
        self.is_sent_no_more();
    }
}
