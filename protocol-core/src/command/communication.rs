//! Communication-loss protection, bit rate and active reply (manual 2.31, 2.32 and 2.34).

use crate::command::NoReply;
use crate::data::Data;
use crate::opcode::{Opcode, Usage};
use crate::quantity::{Form, Given, Name, OutOfRange, Quantity, Unit};
use crate::units::{Milliseconds, ReportInterval};

command! {
    /// Set after how long without a command the drive cuts its output and locks the brake: 0xB3
    /// (2.31). It is kept in ROM. Not while the motor starts or moves.
    ///
    /// To run again, the drive first needs steady, continuous communication (2.31.1): it can run once the gaps between
    /// commands are within this time again (2.31.4). Without the protection, a motor whose master falls silent goes on
    /// with its last command (2.31.4).
    ///
    /// By the manual the reply is the same frame, but its own example returns zeros. So any reply acknowledges, and its
    /// value is handed on unchanged.
    CommunicationLossProtection -> Self {
        /// The longest silence; 0 switches the protection off.
        timeout: Milliseconds => 4,
    }
}

code! {
    /// The bit rates that the manual gives a code (2.32.4). It gives none for the 1.5 and 2.5 Mbit/s of RS485;
    /// [`from_raw`](Self::from_raw) takes any other code.
    BaudCode "baud code" {
        /// CAN at 500 kbit/s, RS485 at 115200 bit/s.
        CAN_500K_RS485_115200 = 0 "can-500k-rs485-115200",
        /// CAN at 1 Mbit/s, RS485 at 500 kbit/s.
        CAN_1M_RS485_500K = 1 "can-1m-rs485-500k",
        /// RS485 at 1 Mbit/s; not valid on CAN.
        RS485_1M = 2 "rs485-1m",
    }
}

impl BaudCode {
    /// Bit rate on CAN, `None` where the manual gives none.
    pub const fn can_bits_per_second(self) -> Option<u32> {
        match self {
            Self::CAN_500K_RS485_115200 => Some(500_000),
            Self::CAN_1M_RS485_500K => Some(1_000_000),
            _ => None,
        }
    }

    /// Bit rate on RS485, `None` where the manual gives none.
    pub const fn rs485_bits_per_second(self) -> Option<u32> {
        match self {
            Self::CAN_500K_RS485_115200 => Some(115_200),
            Self::CAN_1M_RS485_500K => Some(500_000),
            Self::RS485_1M => Some(1_000_000),
            _ => None,
        }
    }
}

command! {
    /// Set the bit rate of the bus, in ROM: 0xB4 (2.32). It acts when the drive is powered on again (2.32.1). What
    /// comes back means nothing, and need not be at the old rate (2.32.3): do not wait for a reply.
    SetBaudRate -> NoReply {
        /// The new rate.
        baud_rate: BaudCode => 7,
    }
}

/// What a drive can report unasked, by its command byte (2.34.2): the kinds of [`Usage::Report`] in the table. (The
/// manual's list also has 0x9E, but it describes no such command; it has no name here.)
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ReportedCommand(u8);

impl ReportedCommand {
    /// The code of this kind, `None` if its reply cannot be reported.
    pub const fn of(opcode: Opcode) -> Option<Self> {
        match (opcode.usage(), opcode.byte()) {
            (Usage::Report, Some(byte)) => Some(Self(byte)),
            _ => None,
        }
    }

    /// The kind whose reply is reported, `None` for codes without a name.
    pub fn opcode(self) -> Option<Opcode> {
        Opcode::from_byte(self.0).filter(|opcode| opcode.usage() == Usage::Report)
    }

    /// The names of the commands that can be reported.
    pub const QUANTITY: Quantity =
        Quantity { name: "reported command", unit: Unit::None, form: Form::Code(&REPORTED) };
}

const REPORTED: [Name; reported_count()] = {
    let mut names = [Name { raw: 0, name: "", meaning: "" }; reported_count()];
    let (mut row, mut count) = (0, 0);
    while row < Opcode::ALL.len() {
        let opcode = Opcode::ALL[row];
        if let Some(code) = ReportedCommand::of(opcode) {
            names[count] =
                Name { raw: code.0 as u16, name: opcode.name(), meaning: opcode.meaning() };
            count += 1;
        }
        row += 1;
    }
    names
};

const fn reported_count() -> usize {
    let (mut row, mut count) = (0, 0);
    while row < Opcode::ALL.len() {
        count += ReportedCommand::of(Opcode::ALL[row]).is_some() as usize;
        row += 1;
    }
    count
}

code_methods!(ReportedCommand);

/// A byte that switches something: 0 or 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum Switch {
    /// 0.
    Off,
    /// 1.
    On,
}

impl Switch {
    /// Name and allowed range.
    pub const QUANTITY: Quantity =
        Quantity { name: "switch", unit: Unit::None, form: Form::Switch };
    pub(crate) const BYTES: u8 = 1;

    /// On for `true`.
    pub const fn from_bool(on: bool) -> Self {
        if on { Self::On } else { Self::Off }
    }

    /// Whether it is on.
    pub const fn is_on(self) -> bool {
        matches!(self, Self::On)
    }

    pub(crate) const fn from_raw(raw: u32) -> Result<Self, OutOfRange> {
        match raw {
            0 => Ok(Self::Off),
            1 => Ok(Self::On),
            other => Err(OutOfRange { quantity: &Self::QUANTITY, given: Given::steps(other, 1) }),
        }
    }

    #[inline(always)]
    pub(crate) const fn put<const AT: usize>(self, data: &mut Data) {
        data[AT] = self as u8;
    }

    #[inline(always)]
    pub(crate) const fn read<const AT: usize>(data: &Data) -> Result<Self, OutOfRange> {
        Self::from_raw(data[AT] as u32)
    }
}

command! {
    /// Have the drive send the reply to a read command unasked, at an interval: 0xB6 (2.34), CAN only. Several commands
    /// take turns. There is no reply, and from then on the drive does not answer when it is asked for what it reports.
    ActiveReply -> NoReply {
        /// Whose reply.
        command: ReportedCommand => 1,
        /// Start or end.
        enable: Switch => 2,
        /// How often.
        interval: ReportInterval => 3,
    }
}
