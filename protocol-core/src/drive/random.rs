//! The drive's own random numbers: a small xorshift generator, the same on every run for a seed.

use crate::time::Duration;

#[derive(Clone, Debug)]
pub(super) struct Random(u32);

impl Random {
    pub(super) const fn new(seed: u32) -> Self {
        // Xorshift never leaves 0, so a seed of 0 stands for another.
        Self(if seed == 0 { 0x9E37_79B9 } else { seed })
    }

    pub(super) fn next(&mut self) -> u32 {
        let mut x = self.0;
        x ^= x << 13;
        x ^= x >> 17;
        x ^= x << 5;
        self.0 = x;
        x
    }

    /// A span from `min` to `max`, both included; `min` where `max` is shorter.
    pub(super) fn between(&mut self, min: Duration, max: Duration) -> Duration {
        let steps = max.as_micros().saturating_sub(min.as_micros()).saturating_add(1);
        let random = u64::from(self.next()) << 32 | u64::from(self.next());
        // `steps` is 0 for no span that a drive has, but the remainder of a division by 0 would panic.
        min + Duration::from_micros(random.checked_rem(steps).unwrap_or(random))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_stay_between_their_ends_and_reach_both() {
        let (min, max) = (Duration::from_micros(700), Duration::from_micros(703));
        let mut random = Random::new(0);
        let mut seen = [0; 4];
        for _ in 0..400 {
            seen[(random.between(min, max).as_micros() - 700) as usize] += 1;
        }
        assert!(seen.iter().all(|&times| times > 50), "{seen:?}");
        assert_eq!(random.between(max, min), max);
    }

    #[test]
    fn a_seed_gives_the_same_spans_again() {
        let spans = |seed| {
            let mut random = Random::new(seed);
            [(); 4].map(|()| random.next())
        };
        assert_eq!(spans(7), spans(7));
        assert_ne!(spans(7), spans(8));
    }
}
