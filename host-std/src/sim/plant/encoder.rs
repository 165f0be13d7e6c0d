//! What the encoders show.

/// Noise as a function of the step: the same seed and step give the same value, however often it is read.
#[derive(Clone, Copy, Debug)]
pub(super) struct Noise {
    seed: u64,
    step: u64,
}

impl Noise {
    pub(super) const fn new(seed: u64) -> Self {
        Self { seed, step: 0 }
    }

    /// Another seed, at the same step.
    pub(super) const fn reseed(&mut self, seed: u64) {
        self.seed = seed;
    }

    pub(super) const fn step(&mut self) {
        self.step = self.step.wrapping_add(1);
    }

    /// The noise of this step, with a mean of 0 and 1 rms: the sum of four uniform values, within ±2√3.
    pub(super) fn now(self) -> f64 {
        let mut bits = splitmix(self.seed ^ splitmix(self.step));
        let mut sum = 0.0;
        for _ in 0..4 {
            sum += (bits & 0xFFFF) as f64 - 32_767.5;
            bits >>= 16;
        }
        // Four times the variance of 65536 uniform values, (65536² - 1) / 12, is the square of this.
        const RMS: f64 = 37_837.227;
        sum / RMS
    }
}

/// A step of SplitMix64.
const fn splitmix(seed: u64) -> u64 {
    let mut bits = seed.wrapping_add(0x9E37_79B9_7F4A_7C15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    bits ^ (bits >> 31)
}
