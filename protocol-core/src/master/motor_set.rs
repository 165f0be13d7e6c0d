//! A set of motors.

use core::fmt;

use crate::id::MotorId;

/// Some of the 32 motors of a bus.
///
/// ```
/// use myactuator_protocol_core::{MotorId, master::MotorSet};
///
/// let arm: MotorSet = (1..=3).filter_map(|id| MotorId::new(id).ok()).collect();
/// assert_eq!(arm.len(), 3);
/// assert_eq!(arm.to_string(), "1 2 3");
/// assert_eq!(format!("{arm:?}"), "MotorSet(1 2 3)");
/// ```
#[derive(Clone, Copy, Default, PartialEq, Eq, Hash)]
#[must_use = "of a stop they are those that have not confirmed it: cut their power"]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(transparent))]
pub struct MotorSet(u32);

impl MotorSet {
    /// No motor.
    pub const EMPTY: Self = Self(0);
    /// All 32.
    pub const ALL: Self = Self(u32::MAX);

    /// Adds a motor.
    pub const fn insert(&mut self, motor: MotorId) {
        self.0 |= 1 << motor.index();
    }

    /// Removes a motor.
    pub const fn remove(&mut self, motor: MotorId) {
        self.0 &= !(1 << motor.index());
    }

    /// Whether the motor is in it.
    pub const fn contains(self, motor: MotorId) -> bool {
        self.0 & 1 << motor.index() != 0
    }

    /// The motors of this set that are not in the other.
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// The motors of this set and of the other.
    pub const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// How many motors.
    pub const fn len(self) -> usize {
        self.0.count_ones() as usize
    }

    /// Whether there is none.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The motors in order.
    pub fn iter(self) -> impl Iterator<Item = MotorId> + Clone {
        MotorId::all().filter(move |&motor| self.contains(motor))
    }
}

impl FromIterator<MotorId> for MotorSet {
    fn from_iter<I: IntoIterator<Item = MotorId>>(motors: I) -> Self {
        let mut set = Self::EMPTY;
        motors.into_iter().for_each(|motor| set.insert(motor));
        set
    }
}

impl From<MotorId> for MotorSet {
    fn from(motor: MotorId) -> Self {
        Self(1 << motor.index())
    }
}

impl<const M: usize> From<[MotorId; M]> for MotorSet {
    fn from(motors: [MotorId; M]) -> Self {
        Self::from_iter(motors)
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for MotorSet {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "[");
        for (place, motor) in self.iter().enumerate() {
            if place > 0 {
                defmt::write!(f, " ");
            }
            defmt::write!(f, "{=u8}", motor.get());
        }
        defmt::write!(f, "]");
    }
}

impl fmt::Debug for MotorSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "MotorSet({self})")
    }
}

/// The ids, separated by spaces.
impl fmt::Display for MotorSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, motor) in self.iter().enumerate() {
            if place > 0 {
                f.write_str(" ")?;
            }
            write!(f, "{motor}")?;
        }
        Ok(())
    }
}
