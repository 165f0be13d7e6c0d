//! The only source of randomness.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng as _, SeedableRng};

/// A stream of random numbers that a seed and a stream number determine.
#[derive(Clone, Debug)]
pub struct Random(ChaCha8Rng);

/// Separate streams, so that more randomness in one place leaves the others unchanged.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Stream {
    ToNodes,
    ToPorts,
    Babble,
    Line,
    Echo,
}

impl Random {
    pub(crate) fn new(seed: u64, stream: Stream) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(stream as u64);
        Self(rng)
    }

    /// True with this probability. Draws nothing if the outcome is certain; NaN is never.
    pub(crate) fn chance(&mut self, probability: f32) -> bool {
        if probability >= 1.0 {
            return true;
        }
        // An f32 distinguishes 24 bits.
        probability > 0.0 && ((self.0.next_u32() >> 8) as f32) < probability * 16_777_216.0
    }

    /// A number from 0 to `limit - 1`; 0 for a limit of 0.
    pub(crate) fn below(&mut self, limit: u64) -> u64 {
        ((u128::from(self.0.next_u64()) * u128::from(limit)) >> 64) as u64
    }

    pub(crate) fn byte(&mut self) -> u8 {
        self.0.next_u32() as u8
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chance_is_as_likely_as_its_probability() {
        let mut random = Random::new(7, Stream::Line);
        let hits = (0..10_000).filter(|_| random.chance(0.25)).count();
        // Standard deviation 43.
        assert!((2_300..2_700).contains(&hits), "{hits}");
        assert!(!random.chance(f32::NAN) && !random.chance(0.0) && !random.chance(-1.0));
        assert!(random.chance(1.0) && random.chance(2.0));
    }

    #[test]
    fn below_stays_below() {
        let mut random = Random::new(7, Stream::Line);
        let drawn: Vec<u64> = (0..1_000).map(|_| random.below(3)).collect();
        assert!((0..3).all(|value| drawn.contains(&value)));
        assert!(drawn.iter().all(|&value| value < 3));
        assert_eq!(random.below(0), 0);
    }

    #[test]
    fn streams_of_one_seed_differ() {
        let draw = |stream| Random::new(1, stream).below(u64::MAX);
        assert_ne!(draw(Stream::ToNodes), draw(Stream::ToPorts));
        assert_eq!(draw(Stream::ToNodes), draw(Stream::ToNodes));
    }
}
