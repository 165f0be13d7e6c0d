//! Communication-loss protection (0xB3, manual 2.31), as [`decisions`](super::decisions) says.

use crate::time::{Duration, Instant};

/// How many commands make communication steady again.
pub(super) const STEADY_COMMANDS: u8 = 3;
/// As [`STEADY_COMMANDS`], for drives with the quirk `lost_master_heartbeat`.
pub(super) const STEADY_COMMANDS_SEEN: u8 = 2;

/// What a command means to the protection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Heard {
    /// Communication has been good all along.
    Steady,
    /// Communication has just become steady again, with this command.
    Recovered,
    /// Communication is not steady yet.
    Unsteady {
        /// Whether it is the first after a silence.
        first: bool,
    },
}

#[derive(Clone, Debug, Default)]
pub(super) struct Protection {
    last: Option<Instant>,
    /// Commands in time since the loss.
    lost: Option<u8>,
}

impl Protection {
    pub(super) const fn is_tripped(&self) -> bool {
        self.lost.is_some()
    }

    /// Notes a command.
    pub(super) fn hear(&mut self, now: Instant, timeout: Duration, needed: u8) -> Heard {
        let in_time = self.last.is_some_and(|last| now - last <= timeout);
        self.last = Some(now);
        let Some(count) = self.lost else { return Heard::Steady };
        let count = if in_time { count.saturating_add(1) } else { 1 };
        if count >= needed {
            self.lost = None;
            Heard::Recovered
        } else {
            self.lost = Some(count);
            Heard::Unsteady { first: count == 1 }
        }
    }

    /// Whether communication has just been lost.
    pub(super) fn check(&mut self, now: Instant, timeout: Duration) -> bool {
        let lost = timeout > Duration::ZERO
            && !self.is_tripped()
            && self.last.is_some_and(|last| now - last > timeout);
        if lost {
            self.lost = Some(0);
        }
        lost
    }

    /// Until when the next command must have come.
    pub(super) fn deadline(&self, timeout: Duration) -> Option<Instant> {
        let watching = timeout > Duration::ZERO && !self.is_tripped();
        self.last.filter(|_| watching).map(|last| last + timeout)
    }

    /// Ends a trip. Returns whether there was one.
    pub(super) fn forgive(&mut self) -> bool {
        self.lost.take().is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_from_the_start_is_no_loss() {
        let timeout = Duration::from_millis(100);
        assert!(!Protection::default().check(Instant::from_millis(1_000_000), timeout));
    }
}
