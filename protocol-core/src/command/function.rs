//! Function control: seven special functions behind one command byte (manual 2.35).

use crate::command::communication::Switch;
use crate::command::layout::Fields;
use crate::command::{Command, expect_opcode};
use crate::error::DecodeError;
use crate::field::{self, Data};
use crate::id::MotorId;
use crate::opcode::Opcode;

/// One of the special functions: 0x20 (2.35). Not while the motor starts or moves. The reply is the
/// same frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum FunctionControl {
    /// 1: forget the turns, take the position as the new zero and save it. Takes effect after a
    /// restart.
    ClearMultiTurn,
    /// 2: listen only to the own CAN identifier, which is faster. The broadcast 0x280 needs it off.
    /// Kept over power-off.
    CanIdFilter(Switch),
    /// 3: send [`Status1`](crate::command::Status1) every 100 ms while an error lasts.
    ErrorReporting(Switch),
    /// 4: save the turns at power-off. Off, the drive is in single-turn mode. Takes effect after a
    /// restart.
    SaveMultiTurn(Switch),
    /// 5: change the CAN id. Takes effect after a restart.
    SetCanId(MotorId),
    /// 6: the largest positive angle of position commands. Takes effect at once. The manual tells no
    /// unit, so the number is passed as it is.
    MaxPositiveAngle(i32),
    /// 7: the largest negative angle of position commands, as
    /// [`MaxPositiveAngle`](Self::MaxPositiveAngle).
    MaxNegativeAngle(i32),
    /// A function that V4.3 does not name.
    Unknown {
        /// Its index.
        index: u8,
        /// Its value.
        value: u32,
    },
}

impl FunctionControl {
    /// The index that selects the function.
    #[inline]
    pub const fn index(&self) -> u8 {
        match *self {
            Self::ClearMultiTurn => 1,
            Self::CanIdFilter(_) => 2,
            Self::ErrorReporting(_) => 3,
            Self::SaveMultiTurn(_) => 4,
            Self::SetCanId(_) => 5,
            Self::MaxPositiveAngle(_) => 6,
            Self::MaxNegativeAngle(_) => 7,
            Self::Unknown { index, .. } => index,
        }
    }

    /// The value that goes with it, as its 32 bits.
    #[inline]
    pub const fn value(&self) -> u32 {
        match *self {
            Self::ClearMultiTurn => 0,
            Self::CanIdFilter(on) | Self::ErrorReporting(on) | Self::SaveMultiTurn(on) => on as u32,
            Self::SetCanId(id) => id.get() as u32,
            Self::MaxPositiveAngle(angle) | Self::MaxNegativeAngle(angle) => angle as u32,
            Self::Unknown { value, .. } => value,
        }
    }

    /// Its name in tools; `"unknown"` where the manual gives none.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::ClearMultiTurn => "clear-multi-turn",
            Self::CanIdFilter(_) => "can-id-filter",
            Self::ErrorReporting(_) => "error-reporting",
            Self::SaveMultiTurn(_) => "save-multi-turn",
            Self::SetCanId(_) => "set-can-id",
            Self::MaxPositiveAngle(_) => "max-positive-angle",
            Self::MaxNegativeAngle(_) => "max-negative-angle",
            Self::Unknown { .. } => "unknown",
        }
    }

    /// The function with this index and value.
    ///
    /// # Errors
    /// [`OutOfRange`](crate::OutOfRange) if the function does not take that value. The value of
    /// [`ClearMultiTurn`](Self::ClearMultiTurn) is not looked at.
    pub const fn from_index(index: u8, value: u32) -> Result<Self, crate::OutOfRange> {
        macro_rules! checked {
            ($variant:ident, $result:expr) => {
                match $result {
                    Ok(value) => Ok(Self::$variant(value)),
                    Err(error) => Err(error),
                }
            };
        }
        match index {
            1 => Ok(Self::ClearMultiTurn),
            2 => checked!(CanIdFilter, Switch::from_raw(value)),
            3 => checked!(ErrorReporting, Switch::from_raw(value)),
            4 => checked!(SaveMultiTurn, Switch::from_raw(value)),
            5 => checked!(SetCanId, MotorId::new(if value > 255 { 255 } else { value as u8 })),
            6 => Ok(Self::MaxPositiveAngle(value as i32)),
            7 => Ok(Self::MaxNegativeAngle(value as i32)),
            _ => Ok(Self::Unknown { index, value }),
        }
    }

    /// The data field.
    #[inline]
    pub const fn encode(&self) -> Data {
        let mut data = [0x20, self.index(), 0, 0, 0, 0, 0, 0];
        field::put_u32::<4>(&mut data, self.value());
        data
    }
}

impl Command for FunctionControl {
    const OPCODE: Opcode = Opcode::FunctionControl;
    type Reply = Self;

    #[inline]
    fn encode(&self) -> Data {
        Self::encode(self)
    }

    #[inline]
    fn decode(data: &Data) -> Result<Self, DecodeError> {
        expect_opcode(data, Self::OPCODE)?;
        Fields::read(data)
    }
}

impl Fields for FunctionControl {
    #[inline(never)]
    fn put(&self, data: &mut Data) {
        data[1] = self.index();
        field::put_u32::<4>(data, self.value());
    }

    #[inline]
    fn read(data: &Data) -> Result<Self, DecodeError> {
        Ok(Self::from_index(data[1], field::get_u32::<4>(data))?)
    }
}

echo!(FunctionControl);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_id_filter_is_function_2() {
        // The text of 2.35.5 example 2 says index 1, the frame is right.
        let on = FunctionControl::CanIdFilter(Switch::On);
        assert_eq!(on.encode(), [0x20, 0x02, 0, 0, 0x01, 0, 0, 0]);
    }

    #[test]
    fn every_function_decodes_to_itself() {
        for function in [
            FunctionControl::ClearMultiTurn,
            FunctionControl::ErrorReporting(Switch::Off),
            FunctionControl::SaveMultiTurn(Switch::On),
            FunctionControl::SetCanId(MotorId::new(32).unwrap()),
            FunctionControl::MaxPositiveAngle(36_000),
            FunctionControl::MaxNegativeAngle(-36_000),
            FunctionControl::Unknown { index: 8, value: 0xDEAD_BEEF },
        ] {
            assert_eq!(FunctionControl::decode(&function.encode()), Ok(function));
        }
        assert_eq!(
            FunctionControl::MaxNegativeAngle(-2).encode(),
            [0x20, 7, 0, 0, 0xFE, 0xFF, 0xFF, 0xFF]
        );
    }

    #[test]
    fn values_that_a_function_does_not_take_are_refused() {
        assert!(FunctionControl::from_index(2, 2).is_err());
        assert!(FunctionControl::from_index(5, 0).is_err());
        assert!(FunctionControl::from_index(5, 33).is_err());
        assert!(FunctionControl::from_index(5, 257).is_err());
    }
}
