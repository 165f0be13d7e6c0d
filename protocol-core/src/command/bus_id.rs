//! Reading and setting the motor id of whatever is connected (manual 4 on CAN, 7 on RS485).
//!
//! The command names no motor: **every** motor on the bus obeys. With more than one connected, a
//! write gives all of them the same id.

use crate::command::{Field, Fields};
use crate::data::{self, Data};
use crate::error::DecodeError;
use crate::id::MotorId;
use crate::opcode::Opcode;
use crate::packet::{Channel, Packet};
use crate::quantity::{Form, Given, OutOfRange, Quantity, Unit};

const READ: u8 = 1;
const WRITE: u8 = 0;

code! {
    /// What is to be done with the id (4.1).
    Access "access" {
        /// Write the id.
        WRITE = 0 "write",
        /// Read the id.
        READ = 1 "read",
    }
}

const ACCESS: Field = Field::bytes("access", "Read or write.", &Access::QUANTITY, 2, 1);
const NEW_ID: Field =
    Field::bytes("motor_id", "The new id.", &MotorId::QUANTITY, 7, 1).only_when(2, WRITE);

/// Read or set the motor id: 0x79, on CAN at identifier 0x300, on RS485 at address 0xCD.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum BusId {
    /// Asks which motors are there. Every motor answers.
    Read,
    /// Tells every motor that hears it to take this id.
    Write(MotorId),
}

impl BusId {
    /// The data field.
    #[inline]
    pub const fn encode(&self) -> Data {
        match self {
            Self::Read => [0x79, 0, READ, 0, 0, 0, 0, 0],
            Self::Write(id) => [0x79, 0, WRITE, 0, 0, 0, 0, id.get()],
        }
    }

    /// The command to all that are connected.
    pub const fn packet(&self) -> Packet {
        Packet { channel: Channel::BusId, data: self.encode() }
    }
}

table_command!(BusId, Opcode::BusId);
reply_to!(BusId -> BusIdReply);

impl Fields for BusId {
    const FIELDS: &'static [Field] = &[ACCESS, NEW_ID];

    #[inline]
    fn put(&self, data: &mut Data) {
        *data = self.encode();
    }

    fn read(data: &Data) -> Result<Self, DecodeError> {
        if is_read(data)? { Ok(Self::Read) } else { Ok(Self::Write(MotorId::new(data[7])?)) }
    }
}

/// What a drive answers to [`BusId`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum BusIdReply {
    /// The new id, as it was sent.
    Written(MotorId),
    /// The id that was read, as drives on CAN return it: the reply identifier 0x240 + id in the last
    /// two bytes (4.4).
    OnCan(MotorId),
    /// The id that was read, as drives on RS485 return it: the bare id in the last byte (7.4).
    OnRs485(MotorId),
}

impl BusIdReply {
    /// The id, in either form.
    pub const fn id(&self) -> MotorId {
        match *self {
            Self::Written(id) | Self::OnCan(id) | Self::OnRs485(id) => id,
        }
    }
}

/// The id that a drive reports in its last two bytes, 0 for none. It is a reply identifier, or a bare id in either
/// byte, because the table and the example of 7 disagree about which.
pub(super) const fn told_id(told: u16) -> u8 {
    match told.to_le_bytes() {
        [low, 0x02] if low >= 0x41 && low <= 0x60 => low - 0x40,
        [0, id] | [id, 0] if id <= 32 => id,
        _ => 0,
    }
}

reply_type!(BusIdReply);

impl Fields for BusIdReply {
    const FIELDS: &'static [Field] = &{
        const TOLD: Quantity =
            Quantity { name: "motor id", unit: Unit::None, form: Form::ReplyIdentifier };
        let told = Field::bytes("motor_id", "The id that acts.", &TOLD, 6, 2).only_when(2, READ);
        [ACCESS, NEW_ID, told]
    };

    #[inline(never)]
    fn put(&self, data: &mut Data) {
        *data = match self {
            Self::Written(id) => BusId::Write(*id).encode(),
            Self::OnCan(id) => [0x79, 0, READ, 0, 0, 0, 0x40 + id.get(), 0x02],
            Self::OnRs485(id) => [0x79, 0, READ, 0, 0, 0, 0, id.get()],
        };
    }

    fn read(data: &Data) -> Result<Self, DecodeError> {
        if !is_read(data)? {
            return Ok(Self::Written(MotorId::new(data[7])?));
        }
        let told = data::get_u16::<6>(data);
        let id = MotorId::new(told_id(told)).map_err(|_| DecodeError::NotABusId(told))?;
        Ok(if told > 0x240 && data[7] == 0x02 { Self::OnCan(id) } else { Self::OnRs485(id) })
    }
}

/// Anything but read and write is refused: a drive that took it for a write would take a new id.
fn is_read(data: &Data) -> Result<bool, OutOfRange> {
    const ALLOWED: Quantity = Quantity::whole("access", WRITE as i64, READ as i64);
    match data[2] {
        READ => Ok(true),
        WRITE => Ok(false),
        other => Err(OutOfRange { quantity: &ALLOWED, given: Given::steps(other as u32, 1) }),
    }
}
