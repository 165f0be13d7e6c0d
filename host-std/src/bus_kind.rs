//! Which of the two buses is meant.

use std::fmt;
use std::str::FromStr;

use crate::Unexpected;

/// The slowest and the fastest serial line, bit/s.
#[cfg(feature = "sim")]
pub(crate) const LINE_RATES: std::ops::RangeInclusive<u32> = 1_200..=12_000_000;

/// The two buses that the protocol runs on (manual 1.1, 1.2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum BusKind {
    /// CAN, standard identifiers, eight data bytes.
    #[default]
    Can,
    /// RS485, 13 bytes a frame.
    Rs485,
}

impl BusKind {
    /// Both of them.
    pub const ALL: [Self; 2] = [Self::Can, Self::Rs485];

    /// Its name in tools: `"can"` or `"rs485"`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Can => "can",
            Self::Rs485 => "rs485",
        }
    }
}

impl fmt::Display for BusKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for BusKind {
    type Err = Unexpected;

    fn from_str(text: &str) -> Result<Self, Unexpected> {
        let known = Self::ALL.into_iter().find(|bus| bus.name() == text);
        known.ok_or_else(|| Unexpected::new("can or rs485", text))
    }
}
