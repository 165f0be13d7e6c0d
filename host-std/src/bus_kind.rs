//! Which of the two buses is meant.

use std::fmt;

/// The two buses that the protocol runs on (manual 1.1, 1.2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, clap::ValueEnum)]
pub enum BusKind {
    /// CAN, standard identifiers, eight data bytes.
    #[default]
    Can,
    /// RS485, 13 bytes a frame.
    Rs485,
}

impl BusKind {
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
