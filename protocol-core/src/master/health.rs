//! How well a motor answers.

use crate::time::{Duration, Instant};

/// Whether a motor is there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Presence {
    /// Nothing was heard of it yet.
    #[default]
    Unknown,
    /// It answered last time.
    Present,
    /// It did not answer the last one or two commands.
    Late,
    /// It did not answer three commands or more in a row, or could not be sent as many because the bus carried nothing.
    Silent,
}

/// How well a motor has answered so far. Counters stop at their largest value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Health {
    /// Whether it is there.
    pub presence: Presence,
    /// When anything was last heard of it; `None` if never.
    pub last_seen: Option<Instant>,
    /// Time from a command's sending to its reply, averaged over some eight replies. One of more than 150 ms counts as
    /// twice the average, or as 150 ms if that is shorter.
    pub round_trip: Duration,
    /// Replies that came in time. If a controller hands back a command for which a late reply may have been counted,
    /// one is subtracted.
    pub answered: u32,
    /// Commands without a reply in time, each attempt counted. What a controller hands back afterwards is subtracted.
    /// Equal frames cannot be told apart: if a stop took the place of several attempts, or was confirmed by the answer
    /// to an earlier one, this may be off by the number of frames handed back.
    pub lost: u16,
    /// Replies that nothing waited for.
    pub stray: u16,
    /// Set-points that were replaced by a newer one or dropped before they were sent.
    pub superseded: u16,
}

/// A longer one may only say that the caller did not look in time: it counts as twice the mean, up to this.
const LONGEST_ROUND_TRIP_US: u64 = 150_000;
pub(super) const SILENT_AFTER: u8 = 3;

/// [`Health`] as it is stored, in less space.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Record {
    /// If it was heard at all.
    heard_at: Instant,
    was_heard: bool,
    round_trip_us: u32,
    pub(super) answered: u32,
    pub(super) lost: u16,
    pub(super) stray: u16,
    pub(super) superseded: u16,
}

impl Record {
    pub(super) fn health(&self, presence: Presence) -> Health {
        let &Self { answered, lost, stray, superseded, .. } = self;
        let (last_seen, round_trip) = (self.last_seen(), self.round_trip());
        Health { presence, last_seen, round_trip, answered, lost, stray, superseded }
    }

    pub(super) fn last_seen(&self) -> Option<Instant> {
        self.was_heard.then_some(self.heard_at)
    }

    /// When it was last heard, or the beginning of time.
    pub(super) fn heard_at(&self) -> Instant {
        self.heard_at
    }

    pub(super) fn round_trip(&self) -> Duration {
        Duration::from_micros(self.round_trip_us.into())
    }

    /// Something was heard of it. Returns when it was last heard before.
    pub(super) fn note_heard(&mut self, now: Instant) -> Option<Instant> {
        let before = self.last_seen();
        (self.heard_at, self.was_heard) = (now, true);
        before
    }

    /// A reply came in time. How long it took is not known if several attempts were under way.
    pub(super) fn count_answer(&mut self, round_trip: Option<Duration>) {
        self.answered = self.answered.saturating_add(1);
        if let Some(round_trip) = round_trip {
            let measured_us = round_trip.as_micros();
            self.round_trip_us = match self.round_trip_us {
                0 => measured_us.min(LONGEST_ROUND_TRIP_US) as u32,
                average_us if measured_us > LONGEST_ROUND_TRIP_US => {
                    (average_us + average_us / 8).min(LONGEST_ROUND_TRIP_US as u32)
                }
                average_us => average_us - average_us / 8 + measured_us as u32 / 8,
            };
        }
    }

    /// No reply came in time.
    pub(super) fn count_miss(&mut self) {
        self.lost = self.lost.saturating_add(1);
    }

    /// A command that counted as lost was never on the bus.
    pub(super) fn uncount_miss(&mut self) {
        self.lost = self.lost.saturating_sub(1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_round_trip_is_the_mean_up_to_150_ms() {
        for (first, mean) in [(1, 1), (150, 150), (151, 150)] {
            let mut record = Record::default();
            record.count_answer(Some(Duration::from_millis(first)));
            assert_eq!(record.round_trip(), Duration::from_millis(mean));
        }
    }
}
