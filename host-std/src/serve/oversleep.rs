//! A thread that sleeps wakes late: Linux lets its timers slip by 50 µs, and an idle processor takes time to start.

use std::time::Duration;

/// A busy machine is late by milliseconds. The thread does not stay awake for so long.
const LONGEST: Duration = Duration::from_micros(200);
/// The share of the latest sleep in the mean: one part in so many.
const WEIGHT: u32 = 8;

/// A look without sleep takes one part in so many away from the mean: within some 10 ms all of it.
const FORGET: u32 = 1_024;

/// By how much sleeps are too long, on average.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Oversleep(Duration);

impl Oversleep {
    /// How long to sleep so as to be awake after `wait`. The rest of it is spent awake.
    pub(super) fn shorten(self, wait: Duration) -> Duration {
        wait.saturating_sub(self.0)
    }

    /// A sleep that was planned to last `planned` has lasted `lasted`.
    pub(super) fn learn(&mut self, planned: Duration, lasted: Duration) {
        if planned.is_zero() {
            // A thread that never sleeps learns nothing, and a busy spell must not keep it awake for ever.
            self.0 -= self.0 / FORGET;
        } else {
            let late = lasted.saturating_sub(planned).min(LONGEST);
            self.0 = (self.0 * (WEIGHT - 1) + late) / WEIGHT;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sleeps_are_shortened_by_their_usual_lateness() {
        let mut oversleep = Oversleep::default();
        let millisecond = Duration::from_millis(1);
        assert_eq!(oversleep.shorten(millisecond), millisecond);
        let lasted = Duration::from_micros(1_080);
        (0..100).for_each(|_| oversleep.learn(millisecond, lasted));
        let slept = oversleep.shorten(millisecond);
        assert!(slept.abs_diff(Duration::from_micros(920)) < Duration::from_micros(1), "{slept:?}");
        assert_eq!(oversleep.shorten(Duration::from_micros(50)), Duration::ZERO);
        // Some looks without sleep are as nothing, but for ever it does not stay awake.
        let mut awake = |looks| {
            (0..looks).for_each(|_| oversleep.learn(Duration::ZERO, Duration::from_micros(2)));
            oversleep.shorten(millisecond)
        };
        assert!(awake(5).abs_diff(slept) < Duration::from_micros(1));
        assert!(awake(10_000) > Duration::from_micros(990));
        (0..100).for_each(|_| oversleep.learn(millisecond, Duration::from_secs(1)));
        assert!(oversleep.shorten(millisecond) >= Duration::from_micros(800));
    }
}
