//! The time that a loop has seen go by.

use crate::time::{Duration, Instant};

/// A pause between two looks counts for no more.
const LONGEST_PAUSE: Duration = Duration::from_millis(10);
/// Whoever is held up for longer than this, again and again, was not suspended: from so many times on all of it counts.
const HELD_UP: Duration = Duration::from_millis(30);
const OFTEN: u8 = 3;
/// Unless so much has gone by between.
const WORKS_AGAIN: Duration = Duration::from_millis(100);

/// How long something has gone on, for a loop that looks at the time again and again. Whoever was held up for long
/// between two looks, since the program was suspended for example, has had no more than 10 ms of it. But where that
/// comes again and again, since a driver keeps the loop each time it is used, all of it counts from the fourth time on.
#[derive(Clone, Copy, Debug, Default)]
pub struct Elapsed {
    looks: Looks,
    /// How often it was held up with little between, and what the total was then.
    held_up: (u8, Duration),
}

/// When the time was looked at last, and how much of it has counted.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Looks {
    pub(super) last: Option<Instant>,
    total: Duration,
}

impl Looks {
    /// Looks at the time. Gives what has counted since the first look: of no pause more than 10 ms.
    pub(super) fn at(&mut self, now: Instant) -> Duration {
        self.note(now, |pause| pause.min(LONGEST_PAUSE))
    }

    fn note(&mut self, now: Instant, counts: impl FnOnce(Duration) -> Duration) -> Duration {
        if let Some(last) = self.last.replace(now) {
            self.total = self.total + counts(now - last);
        }
        self.total
    }
}

impl Elapsed {
    /// Who looks again so soon misses none of it.
    pub const LOOK_AGAIN: Duration = Duration::from_millis(5);

    /// Looks at the time. Gives how much has gone by since the first look.
    pub fn at(&mut self, now: Instant) -> Duration {
        let Self { mut looks, .. } = *self;
        let total = looks.note(now, |pause| match pause > HELD_UP {
            true => self.hold_up(pause),
            false => pause.min(LONGEST_PAUSE),
        });
        self.looks = looks;
        total
    }

    /// Takes note of such a pause. Gives how much of it counts.
    fn hold_up(&mut self, pause: Duration) -> Duration {
        let (times, then) = self.held_up;
        let times = if self.looks.total - then > WORKS_AGAIN { 0 } else { times };
        let counts = if times < OFTEN { LONGEST_PAUSE } else { pause };
        self.held_up = (times.saturating_add(1), self.looks.total + counts);
        counts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_that_is_suspended_now_and_then_has_had_little_of_it() {
        let (mut elapsed, mut now) = (Elapsed::default(), Instant::ZERO);
        for _ in 0..10 {
            now += Duration::from_secs(3_600);
            elapsed.at(now);
            for _ in 0..30 {
                now += Elapsed::LOOK_AGAIN;
                elapsed.at(now);
            }
        }
        // The first look has no pause before it.
        assert_eq!(elapsed.at(now), Duration::from_millis(10 * 150 + 9 * 10));
    }

    #[test]
    fn one_that_is_held_up_at_each_look_has_had_all_of_it_but_for_the_first() {
        let second = |at: u64| Instant::from_millis(1_000 * at);
        let mut elapsed = Elapsed::default();
        let had = [0, 1, 2, 3, 4, 5].map(|at| elapsed.at(second(at)).as_millis());
        assert_eq!(had, [0, 10, 20, 30, 1_030, 2_030]);
    }
}
