//! The time that a loop has seen go by.

use crate::time::{Duration, Instant};

/// A longer pause between two looks counts as this, so that four of them make a second.
const LONGEST_PAUSE: Duration = Duration::from_millis(250);

/// How long something has gone on, for a loop that looks at the time again and again.
///
/// A pause between two looks counts for at most 250 ms, because the program may have been suspended. So, with a driver
/// that blocks the loop each time it is used, a second is over after a few such pauses.
#[derive(Clone, Copy, Debug, Default)]
pub struct Elapsed {
    /// When the time was last looked at.
    pub(super) last: Option<Instant>,
    total: Duration,
}

impl Elapsed {
    /// A loop that looks again this soon misses nothing.
    pub const LOOK_AGAIN: Duration = Duration::from_millis(5);

    /// Looks at the time. Returns how much has gone by since the first look.
    pub fn at(&mut self, now: Instant) -> Duration {
        self.with_pauses_up_to(LONGEST_PAUSE, now)
    }

    /// As [`at`](Self::at), but a longer pause counts as `longest`.
    pub(super) fn with_pauses_up_to(&mut self, longest: Duration, now: Instant) -> Duration {
        if let Some(last) = self.last.replace(now) {
            self.total = self.total + (now - last).min(longest);
        }
        self.total
    }
}
