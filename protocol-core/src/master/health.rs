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
    /// It did not answer last time, or the time before.
    Late,
    /// It did not answer three times or more.
    Silent,
}

/// How well a motor has answered so far. Counters stay at their largest value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Health {
    /// Whether it is there.
    pub presence: Presence,
    /// When anything was last heard of it, to 1 ms; `None` for never and for more than 30 s ago.
    pub last_seen: Option<Instant>,
    /// Time from a command's sending to its reply, averaged over some eight replies.
    pub round_trip: Duration,
    /// Replies that came in time.
    pub answered: u32,
    /// Commands without a reply in time, each attempt counted.
    pub lost: u16,
    /// Replies that nothing waited for.
    pub stray: u16,
    /// Set-points that were replaced by a newer one or dropped before they were sent.
    pub superseded: u16,
}

const SILENT_AFTER: u8 = 3;

/// The counters behind [`Health`].
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tally {
    answered: u32,
    pub(super) lost: u16,
    pub(super) stray: u16,
    pub(super) superseded: u16,
    /// In steps of 4 µs, so up to 262 ms.
    round_trip: u16,
}

impl Tally {
    pub(super) fn answered(&mut self, round_trip: Option<Duration>) {
        self.answered = self.answered.saturating_add(1);
        if let Some(span) = round_trip {
            let measured = u16::try_from(span.as_micros() >> 2).unwrap_or(u16::MAX);
            self.round_trip = match self.round_trip {
                0 => measured,
                average => average - average / 8 + measured / 8,
            };
        }
    }

    pub(super) fn health(&self, misses: u8, last_seen: Option<Instant>) -> Health {
        let presence = match misses {
            0 if self.answered == 0 => Presence::Unknown,
            0 => Presence::Present,
            1..SILENT_AFTER => Presence::Late,
            _ => Presence::Silent,
        };
        Health {
            presence,
            last_seen,
            round_trip: Duration::from_micros(u64::from(self.round_trip) << 2),
            answered: self.answered,
            lost: self.lost,
            stray: self.stray,
            superseded: self.superseded,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_round_trip_is_the_mean() {
        let mut tally = Tally::default();
        tally.answered(Some(Duration::from_micros(1000)));
        assert_eq!(tally.health(0, None).round_trip, Duration::from_micros(1000));
    }
}
