//! [`Explanation`], and its output for programs and for people.

use std::fmt;

use myactuator_protocol_core::command::{Field, MotionRanges, Phrase};
use myactuator_protocol_core::opcode::LOST_MASTER_BYTE;
use myactuator_protocol_core::{Data, Opcode, Target};
use serde_json::{Value, json};

use super::values::{Values, values};
use crate::BusKind;
use crate::text::can::Stamp;

/// Whether a frame goes to a motor or comes from one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum FrameDirection {
    /// From the master.
    Command,
    /// From a motor.
    Reply,
    /// Either of these: the bytes do not show which.
    Either,
}

impl FrameDirection {
    /// Its name in tools: `"command"`, `"reply"` or `"either"`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Command => "command",
            Self::Reply => "reply",
            Self::Either => "either",
        }
    }
}

/// A data field, and its fields in one reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    pub(super) fields: &'static [Field],
    pub(super) data: Data,
    pub(super) ranges: Option<MotionRanges>,
}

impl Reading {
    /// Its values; the unit ends each key.
    pub fn values(&self) -> Values {
        values(self.fields, &self.data, self.ranges.as_ref())
    }

    /// Whether it has no values.
    pub fn is_empty(&self) -> bool {
        !self.fields.iter().any(|field| field.is_in(&self.data))
    }

    /// Whether every bit that is set belongs to the command byte or to a field.
    pub(super) fn is_exact(&self, opcode: Opcode) -> bool {
        let mut rest = self.data;
        if opcode.byte().is_some() {
            rest[0] = 0;
        }
        for field in self.fields.iter().filter(|field| field.is_in(&self.data)) {
            field.place.put(&mut rest, 0);
        }
        rest == [0; 8]
    }
}

/// As a phrase for people.
impl fmt::Display for Reading {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { fields, data, ranges } = self;
        Phrase { fields, data, ranges: ranges.as_ref() }.fmt(f)
    }
}

/// What a decoded frame says.
#[derive(Clone, Debug, PartialEq)]
pub struct Decoded {
    /// What it says. If the direction is not known, this is what it says as a command.
    pub reading: Reading,
    /// What it says as a reply, if the direction is not known and that differs.
    pub if_reply: Option<Reading>,
    /// The decoded value as this library encodes it. It differs from the frame only in bytes without a meaning (NULL in
    /// the manual) or with two spellings (4.3, 7.3).
    pub canonical: String,
}

/// A frame, or bytes that are not a frame, and what is known about them.
#[derive(Clone, Debug, PartialEq)]
pub struct Explanation {
    /// When and where it was heard, if known; otherwise `Default`.
    pub stamp: Stamp,
    /// The frame in the notation of [`text`](crate::text), or the text or bytes that are no frame.
    pub raw: String,
    /// The bus it came on.
    pub bus: BusKind,
    /// The motor or motors of the frame; `None` if it names no motor of the protocol.
    pub id: Option<Target>,
    /// Its direction, [`Either`](FrameDirection::Either) if the bytes do not show it; `None` if it has none.
    pub direction: Option<FrameDirection>,
    /// Its kind, if the firmware has one for it.
    pub opcode: Option<Opcode>,
    /// Its command byte, if it has one.
    pub byte: Option<u8>,
    /// What it says, or one sentence about why it says nothing.
    pub outcome: Result<Decoded, String>,
}

impl Explanation {
    /// For what is not a frame of the protocol: the text or bytes, and one sentence why.
    pub fn no_frame(bus: BusKind, raw: impl Into<String>, sentence: impl Into<String>) -> Self {
        Self {
            stamp: Stamp::default(),
            raw: raw.into(),
            bus,
            id: None,
            direction: None,
            opcode: None,
            byte: None,
            outcome: Err(sentence.into()),
        }
    }

    /// Whether the frame was decoded.
    pub const fn is_decoded(&self) -> bool {
        self.outcome.is_ok()
    }

    /// As a JSON object with the keys `time` and `interface` if known, then `raw`, `bus`, `id`, `direction`, `name`,
    /// `opcode`, and then either `fields` (possibly `fields_if_reply`) and `canonical`, or `error`. Anything else that
    /// is not known is null, and so is the name of a raw command.
    pub fn to_json(&self) -> Value {
        let mut object = json!({});
        if let Some(time) = &self.stamp.time {
            object["time"] = time.clone().into();
        }
        if let Some(interface) = &self.stamp.interface {
            object["interface"] = interface.clone().into();
        }
        object["raw"] = self.raw.clone().into();
        object["bus"] = self.bus.name().into();
        object["id"] = self.id.map_or(Value::Null, |id| match id {
            Target::Motor(id) => id.get().into(),
            Target::All => "all".into(),
        });
        object["direction"] = self.direction.map(FrameDirection::name).into();
        object["name"] = self.opcode.map(Opcode::name).into();
        object["opcode"] = self.byte.map(|byte| format!("0x{byte:02X}")).into();
        match &self.outcome {
            Ok(decoded) => {
                object["fields"] = decoded.reading.values().into();
                if let Some(reply) = &decoded.if_reply {
                    object["fields_if_reply"] = reply.values().into();
                }
                object["canonical"] = decoded.canonical.clone().into();
            }
            Err(sentence) => object["error"] = sentence.clone().into(),
        }
        object
    }
}

/// One line for people. Text that was not a frame is copied as it came: a program that shows it on a terminal has to
/// handle control characters.
impl fmt::Display for Explanation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.stamp != Stamp::default() {
            write!(f, "{} ", self.stamp)?;
        }
        f.write_str(&self.raw)?;
        if let Some(id) = self.id {
            write!(f, "  {id}")?;
        }
        if let Some(direction) = self.direction {
            let words = match direction {
                FrameDirection::Either => "command or reply",
                known => known.name(),
            };
            write!(f, "  {words}")?;
        }
        let decoded = match &self.outcome {
            Ok(decoded) => decoded,
            Err(sentence) => return write!(f, "  error: {sentence}"),
        };
        match (self.opcode, self.byte) {
            (Some(opcode), _) => write!(f, "  {opcode}")?,
            (None, Some(byte)) => {
                write!(f, "  raw: command byte 0x{byte:02X} is not known")?;
                if byte == LOST_MASTER_BYTE {
                    f.write_str(LOST_MASTER)?;
                }
            }
            (None, None) => {}
        }
        let nothing = if decoded.reading.is_empty() {
            ": no values"
        } else {
            write!(f, ": {}", decoded.reading)?;
            ""
        };
        if let Some(reply) = &decoded.if_reply {
            write!(f, "{nothing}; if it is a reply: {reply}")?;
        }
        if self.opcode == Some(Opcode::Motion) && decoded.reading.ranges.is_none() {
            f.write_str(" (the ranges of this firmware depend on the motor: give them)")?;
        }
        if decoded.canonical != self.raw {
            write!(f, "; the usual spelling is {}", decoded.canonical)?;
        }
        Ok(())
    }
}

pub(super) const LOST_MASTER: &str =
    "; drives were seen to send it once a second after they lost their master";
