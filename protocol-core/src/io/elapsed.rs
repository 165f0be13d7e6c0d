//! The time that a loop has seen go by.

use crate::time::{Duration, Instant};

/// A pause between two looks counts for no more: of a second four may be longer.
const LONGEST_PAUSE: Duration = Duration::from_millis(250);

/// How long something has gone on, for a loop that looks at the time again and again. Whoever was held up for long
/// between two looks, since the program was suspended for example, has had no more than 250 ms of it: a second in which
/// a driver keeps the loop each time it is used is over after a few of these.
#[derive(Clone, Copy, Debug, Default)]
pub struct Elapsed {
    /// When the time was looked at last.
    pub(super) last: Option<Instant>,
    total: Duration,
}

impl Elapsed {
    /// Who looks again so soon misses none of it.
    pub const LOOK_AGAIN: Duration = Duration::from_millis(5);

    /// Looks at the time. Gives how much has gone by since the first look.
    pub fn at(&mut self, now: Instant) -> Duration {
        self.with_pauses_up_to(LONGEST_PAUSE, now)
    }

    /// As [`at`](Self::at), where of each pause no more than so much counts.
    pub(super) fn with_pauses_up_to(&mut self, longest: Duration, now: Instant) -> Duration {
        if let Some(last) = self.last.replace(now) {
            self.total = self.total + (now - last).min(longest);
        }
        self.total
    }
}
