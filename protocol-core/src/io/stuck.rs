//! When a bus that takes nothing counts as down.

use crate::time::{Duration, Instant};

/// A bus that takes nothing for so long counts as down.
pub(super) const STUCK_AFTER: Duration = Duration::from_millis(20);

/// Watches for a bus that takes nothing.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StuckWatch {
    since: Option<Instant>,
}

impl StuckWatch {
    pub(super) const fn new() -> Self {
        Self { since: None }
    }

    /// Something is offered to the bus. Gives the time up to which a bus that does not take it
    /// counts as merely busy.
    pub(super) fn offered(&mut self, now: Instant) -> Instant {
        *self.since.get_or_insert(now) + STUCK_AFTER
    }

    /// The bus took it, or gave a reason why not.
    pub(super) fn clear(&mut self) {
        self.since = None;
    }
}
