//! Function control: seven special functions behind one command byte (manual 2.35).

use crate::command::communication::Switch;
use crate::command::{Field, Fields};
use crate::data::{self, Data};
use crate::error::DecodeError;
use crate::id::MotorId;
use crate::opcode::Opcode;
use crate::quantity::{Given, OutOfRange, Quantity};

code! {
    /// Which special function (2.35.4).
    FunctionIndex "function index" {
        /// Forget the turns, take the position as the new zero and save it.
        CLEAR_MULTI_TURN = 1 "clear-multi-turn",
        /// Listen only to the own CAN identifier.
        CAN_ID_FILTER = 2 "can-id-filter",
        /// Report errors unasked.
        ERROR_REPORTING = 3 "error-reporting",
        /// Save the turns at power-off.
        SAVE_MULTI_TURN = 4 "save-multi-turn",
        /// Change the CAN id.
        SET_CAN_ID = 5 "set-can-id",
        /// Limit the positive angle of position commands.
        MAX_POSITIVE_ANGLE = 6 "max-positive-angle",
        /// Limit the negative angle of position commands.
        MAX_NEGATIVE_ANGLE = 7 "max-negative-angle",
    }
}

/// One of the special functions: 0x20 (2.35). Not while the motor starts or moves. The reply is the
/// same frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
#[non_exhaustive]
pub enum FunctionControl {
    /// 1: forget the turns, take the position as the new zero and save it. Takes effect after a
    /// restart.
    ClearMultiTurn,
    /// 2: listen only to the own CAN identifier, which is faster. A drive with the filter on does not
    /// hear commands to [all](crate::Target::All) motors at 0x280 (2.35.5). It is saved.
    CanIdFilter(Switch),
    /// 3: send [`Status1`](crate::command::Status1) every 100 ms while an error lasts. The manual does not
    /// say that this is saved.
    ErrorReporting(Switch),
    /// 4: save the turns at power-off. Off, the drive is in single-turn mode. Takes effect after a
    /// restart.
    SaveMultiTurn(Switch),
    /// 5: change the CAN id. It is saved in ROM, and takes effect after a restart.
    SetCanId(MotorId),
    /// 6: the largest positive angle of position commands. It is saved in ROM, and takes effect at once.
    /// The manual gives no unit, so the number is passed as it is.
    MaxPositiveAngle(i32),
    /// 7: the largest negative angle of position commands. It too is saved in ROM, takes effect at once
    /// and has no unit in the manual.
    MaxNegativeAngle(i32),
    /// A function that V4.3 does not name. [`FunctionControl::from_index`] makes it.
    Other(OtherFunction),
}

/// A special function without a name here. It can never be one that has a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(try_from = "(u8, u32)", into = "(u8, u32)"))]
pub struct OtherFunction {
    index: u8,
    value: u32,
}

impl From<OtherFunction> for (u8, u32) {
    fn from(function: OtherFunction) -> Self {
        (function.index, function.value)
    }
}

/// Only an index without a name.
impl TryFrom<(u8, u32)> for OtherFunction {
    type Error = OutOfRange;
    fn try_from((index, value): (u8, u32)) -> Result<Self, OutOfRange> {
        const UNNAMED: Quantity =
            Quantity::whole("index of a function without a name (none of 1 to 7)", 0, 255);
        match FunctionControl::from_index(index, value) {
            Ok(FunctionControl::Other(other)) => Ok(other),
            _ => Err(OutOfRange { quantity: &UNNAMED, given: Given::steps(index.into(), 1) }),
        }
    }
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
            Self::Other(other) => other.index,
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
            Self::Other(other) => other.value,
        }
    }

    /// The function with this index and value.
    ///
    /// # Errors
    /// [`OutOfRange`] if the function does not take that value. The value of
    /// [`ClearMultiTurn`](Self::ClearMultiTurn) is not looked at.
    pub const fn from_index(index: u8, value: u32) -> Result<Self, OutOfRange> {
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
            5 => checked!(SetCanId, MotorId::from_u32(value)),
            6 => Ok(Self::MaxPositiveAngle(value as i32)),
            7 => Ok(Self::MaxNegativeAngle(value as i32)),
            _ => Ok(Self::Other(OtherFunction { index, value })),
        }
    }

    /// The data field.
    #[inline]
    pub const fn encode(&self) -> Data {
        let [a, b, c, d] = self.value().to_le_bytes();
        [0x20, self.index(), 0, 0, a, b, c, d]
    }
}

table_command!(FunctionControl, Opcode::FunctionControl);
targeted!(FunctionControl);
reply_to!(FunctionControl -> FunctionControl);
reply_type!(FunctionControl);

impl Fields for FunctionControl {
    const FIELDS: &'static [Field] = &{
        const ANGLE: Quantity = Quantity::whole("largest angle", i32::MIN as i64, i32::MAX as i64);
        const VALUE: Quantity = Quantity::whole("value", 0, u32::MAX as i64);
        const fn value(meaning: &'static str, quantity: &'static Quantity) -> Field {
            Field::bytes("value", meaning, quantity, 4, 4)
        }
        const SWITCH: Field = value("Whether it is on.", &Switch::QUANTITY);
        const LIMIT: Field =
            value("The largest angle, in a unit that the manual does not give.", &ANGLE);
        [
            Field::bytes("index", "Which function.", &FunctionIndex::QUANTITY, 1, 1),
            SWITCH.only_when(1, 2),
            SWITCH.only_when(1, 3),
            SWITCH.only_when(1, 4),
            value("The new id.", &MotorId::QUANTITY).only_when(1, 5),
            LIMIT.only_when(1, 6),
            LIMIT.only_when(1, 7),
            value("The value of a function without a name.", &VALUE)
                .only_when_none(1, &[1, 2, 3, 4, 5, 6, 7]),
        ]
    };

    #[inline(never)]
    fn put(&self, data: &mut Data) {
        *data = self.encode();
    }

    #[inline]
    fn read(data: &Data) -> Result<Self, DecodeError> {
        Ok(Self::from_index(data[1], data::get_u32::<4>(data))?)
    }
}
