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

/// The answers of a motor to commands, without a long pause in between.
#[derive(Clone, Copy, Debug)]
pub(super) struct InARow {
    number: u8,
    /// When the last came.
    last: Instant,
}

impl Default for InARow {
    /// A motor that has not answered this master before is believed: nothing is known of a pause.
    fn default() -> Self {
        Self { number: STEADY_AFTER, last: Instant::ZERO }
    }
}

impl Motor {
    /// Whether it obeys for sure.
    pub(super) fn is_steady(&self) -> bool {
        self.in_a_row.number >= STEADY_AFTER
    }

    /// Its drive says that it has let go.
    pub(crate) fn is_unsteady(&mut self) {
        self.in_a_row.number = 0;
    }

    /// Whether it has confirmed that it holds, and may have let go since.
    pub(crate) fn may_have_let_go(&self) -> bool {
        matches!(self.last_stop, LastStop::MayHaveLetGo)
    }

    /// Whether its last answer is longer ago.
    #[inline]
    pub(super) fn was_silent_for(&self, pause: Duration, now: Instant) -> bool {
        let InARow { last, .. } = self.in_a_row;
        last > Instant::ZERO && now - last > pause
    }

    /// It has answered a command. A hold that it has confirmed before a long pause no longer counts.
    #[inline]
    pub(super) fn count_in_a_row(&mut self, longest_pause: Duration, now: Instant) {
        if self.was_silent_for(longest_pause, now) {
            self.is_unsteady();
        }
        self.in_a_row.last = now;
        if self.is_steady() {
            return;
        }
        self.in_a_row.number += 1;
        if let LastStop::Confirmed(StopKind::Hold) = self.last_stop {
            self.last_stop = LastStop::MayHaveLetGo;
        }
    }
}
