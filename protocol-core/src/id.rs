//! Motor ids and the targets of commands: [`MotorId`] and [`Target`].

use core::fmt::{self, Write as _};
use core::num::NonZeroU8;
use core::str::FromStr;

use crate::quantity::{Given, OutOfRange, Quantity};

/// The number of a motor on its bus, 1 to 32 (manual 1.1.2, 1.2.2).
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(try_from = "u8", into = "u8"))]
pub struct MotorId(NonZeroU8);

impl MotorId {
    /// The allowed ids.
    pub const QUANTITY: Quantity = Quantity::whole("motor id", 1, 32);
    /// How many ids there are.
    pub const COUNT: usize = 32;
    /// The smallest id, 1, with which drives leave the factory.
    pub const MIN: Self = Self(NonZeroU8::MIN);

    /// A motor id from its number.
    ///
    /// # Errors
    /// [`OutOfRange`] unless `id` is 1 to 32.
    #[inline]
    pub const fn new(id: u8) -> Result<Self, OutOfRange> {
        Self::from_u32(id as u32)
    }

    #[inline]
    pub(crate) const fn from_u32(id: u32) -> Result<Self, OutOfRange> {
        match NonZeroU8::new(id as u8) {
            Some(nonzero) if id <= 32 => Ok(Self(nonzero)),
            _ => Err(OutOfRange { quantity: &Self::QUANTITY, given: Given::steps(id, 1) }),
        }
    }

    /// The number, 1 to 32.
    #[inline]
    pub const fn get(self) -> u8 {
        self.0.get()
    }

    /// The index of this motor in an array of [`COUNT`](Self::COUNT), 0 to 31.
    #[inline]
    pub const fn index(self) -> usize {
        (self.get() - 1) as usize
    }

    /// All 32 ids in order.
    pub fn all() -> impl DoubleEndedIterator<Item = Self> + Clone {
        (1..=32).filter_map(|id| Self::new(id).ok())
    }
}

impl TryFrom<u8> for MotorId {
    type Error = OutOfRange;
    fn try_from(id: u8) -> Result<Self, OutOfRange> {
        Self::new(id)
    }
}

impl From<MotorId> for u8 {
    fn from(id: MotorId) -> u8 {
        id.get()
    }
}

/// A text that is not a motor id.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotAMotorId {
    /// It is not a whole number.
    #[error("{}, but no number was given", MotorId::QUANTITY)]
    NotANumber,
    /// The number is not allowed.
    #[error("{0}")]
    OutOfRange(OutOfRange),
}

/// A decimal number, 1 to 32.
impl FromStr for MotorId {
    type Err = NotAMotorId;
    fn from_str(text: &str) -> Result<Self, NotAMotorId> {
        let id = text.parse().map_err(|_| NotAMotorId::NotANumber)?;
        Self::from_u32(id).map_err(NotAMotorId::OutOfRange)
    }
}

impl fmt::Debug for MotorId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "MotorId({self})")
    }
}

impl fmt::Display for MotorId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.get().fmt(f)
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for MotorId {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "motor {}", self.get());
    }
}

/// The target of a command: one motor, or all on the bus (manual 3 and 6).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Target {
    /// One motor.
    Motor(MotorId),
    /// Every motor on the bus: RS485 address 0xCD, CAN identifier 0x280.
    ///
    /// On CAN it reaches only the drives whose id filter is off ([function
    /// 2](crate::command::FunctionControl::CanIdFilter), 2.35.4, 2.35.5). The others neither obey nor answer. So send a
    /// command that all must hear, above all a stop, to each motor.
    All,
}

impl From<MotorId> for Target {
    fn from(id: MotorId) -> Self {
        Target::Motor(id)
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Target::Motor(id) => {
                let mut text = heapless::String::<8>::new();
                write!(text, "motor {id}")?;
                f.pad(&text)
            }
            Target::All => f.pad("all motors"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_1_to_32_are_ids() {
        for id in 0..=255 {
            assert_eq!(MotorId::new(id).is_ok(), (1..=32).contains(&id), "{id}");
        }
        assert_eq!("32".parse(), MotorId::new(32).map_err(NotAMotorId::OutOfRange));
        assert_eq!("three".parse::<MotorId>(), Err(NotAMotorId::NotANumber));
        let error = "1000".parse::<MotorId>().unwrap_err();
        assert_eq!(std::format!("{error}"), "motor id must be 1 to 32, but 1000 was given");
        assert!(MotorId::all().map(MotorId::get).eq(1..=32));
        assert!(MotorId::all().map(MotorId::index).eq(0..32));
    }
}
