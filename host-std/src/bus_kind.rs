//! Which of the two buses is meant.

use std::fmt;
use std::str::FromStr;

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

/// Text that is the name of neither bus.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected can or rs485, found {0:?}")]
pub struct NotABus(String);

impl FromStr for BusKind {
    type Err = NotABus;

    fn from_str(text: &str) -> Result<Self, NotABus> {
        let known = Self::ALL.into_iter().find(|bus| bus.name() == text);
        known.ok_or_else(|| NotABus(text.to_owned()))
    }
}
