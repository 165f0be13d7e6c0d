//! Whether a motor was spoken to steadily.
//!
//! A drive that heard nothing for longer than its protection time (0xB3) cuts its output. After that it answers the
//! first commands and does not obey: communication has to be steady again first (2.31.1). Only a drive with a message of
//! its own for that (0xF1) says so. So a motor that was not spoken to steadily is not believed to hold (0x81), and is
//! told again.

use crate::master::motor::Motor;
use crate::master::motor::stopping::LastStop;
use crate::master::stop::StopKind;
use crate::time::{Duration, Instant};

/// After a longer pause a drive may have let go. What [keeps motors alive](crate::io::KeepAlive) pauses no longer.
pub(crate) const LONGEST_PAUSE: Duration = Duration::from_millis(150);

/// How many commands in a row a motor has to answer until it obeys for sure. It obeys the last of them.
const STEADY_AFTER: u8 = 3;

/// How many commands a motor has answered since the last long pause.
#[derive(Clone, Copy, Debug)]
pub(super) struct Answered(u8);

impl Default for Answered {
    /// A motor that was not heard before is believed: nothing is known of a pause.
    fn default() -> Self {
        Self(STEADY_AFTER)
    }
}

impl Motor {
    /// Whether it obeys for sure.
    pub(super) fn is_steady(&self) -> bool {
        self.answered.0 >= STEADY_AFTER
    }

    /// Whether it has answered nothing since a long pause.
    pub(super) fn is_anew(&self) -> bool {
        self.answered.0 == 0
    }

    /// It may have let go: the next commands may be answered and not obeyed.
    #[inline(never)]
    pub(crate) fn may_let_go(&mut self) {
        if self.health.last_seen().is_some() {
            self.answered = Answered(0);
        }
    }

    /// A command is sent now. Before it there was a pause, or the motor was not heard.
    #[inline]
    pub(crate) fn note_pause(&mut self, longest: Duration, now: Instant) {
        let was_silent = || self.health.last_seen().is_some_and(|seen| now - seen > longest);
        if now - self.sent > longest || self.was_missed() && was_silent() {
            self.may_let_go();
        }
    }

    /// It has answered a command. A hold that it has confirmed before a long pause no longer counts.
    #[inline]
    pub(super) fn note_answer(&mut self) {
        if self.is_steady() {
            return;
        }
        self.answered.0 += 1;
        if let LastStop::Confirmed(StopKind::Hold) = self.last_stop {
            self.last_stop = LastStop::MayHaveLetGo;
        }
    }

    /// Whether it has confirmed that it holds, and may have let go since.
    pub(crate) fn may_have_let_go(&self) -> bool {
        matches!(self.last_stop, LastStop::MayHaveLetGo)
    }
}
