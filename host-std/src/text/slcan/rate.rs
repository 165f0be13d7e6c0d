//! The bit rates of the CAN bus behind an adapter.

use std::str::FromStr;

use crate::Unexpected;

/// The bit rates that adapters know, from the slowest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Rate {
    /// 10 kbit/s, `S0`.
    Kbit10 = 10_000,
    /// 20 kbit/s, `S1`.
    Kbit20 = 20_000,
    /// 50 kbit/s, `S2`.
    Kbit50 = 50_000,
    /// 100 kbit/s, `S3`.
    Kbit100 = 100_000,
    /// 125 kbit/s, `S4`.
    Kbit125 = 125_000,
    /// 250 kbit/s, `S5`.
    Kbit250 = 250_000,
    /// 500 kbit/s, `S6`.
    Kbit500 = 500_000,
    /// 800 kbit/s, `S7`.
    Kbit800 = 800_000,
    /// 1 Mbit/s, `S8`: the rate of motors as delivered.
    Mbit1 = 1_000_000,
}

impl Rate {
    /// All of them, in the order of their digits.
    pub const ALL: [Self; 9] = [
        Self::Kbit10,
        Self::Kbit20,
        Self::Kbit50,
        Self::Kbit100,
        Self::Kbit125,
        Self::Kbit250,
        Self::Kbit500,
        Self::Kbit800,
        Self::Mbit1,
    ];

    /// The rate in bit/s.
    pub const fn bits_per_second(self) -> u32 {
        self as u32
    }

    pub(super) fn digit(self) -> u8 {
        let slower = Self::ALL.iter().filter(|rate| **rate < self).count();
        b'0' + slower as u8
    }

    pub(super) fn from_digit(digit: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|rate| rate.digit() == digit)
    }
}

/// Reads a bit rate in bit/s, in decimal digits.
impl FromStr for Rate {
    type Err = Unexpected;

    fn from_str(text: &str) -> Result<Self, Unexpected> {
        let known = Self::ALL.into_iter().find(|rate| rate.bits_per_second().to_string() == text);
        known.ok_or_else(|| {
            let rates = Self::ALL.map(|rate| rate.bits_per_second().to_string()).join(", ");
            Unexpected::new(format!("a bit rate that SLCAN adapters know ({rates})"), text)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_rates_that_adapters_know_are_read() {
        for rate in Rate::ALL {
            assert_eq!(rate.bits_per_second().to_string().parse(), Ok(rate));
        }
        for text in ["", "1000", "+500000", "0500000", "500 000", "fast"] {
            assert_eq!(text.parse::<Rate>().unwrap_err().found, text);
        }
    }
}
