//! [`Explanation`], and how it is written for programs and for people.

use std::fmt;

use myactuator_protocol_core::{Opcode, Target};
use serde_json::{Value, json};

use super::fields::Fields;
use super::prose::prose;
use crate::BusKind;
use crate::text::can::Stamp;

/// Whether a frame goes to a motor or comes from one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum FrameDirection {
    /// From the master.
    Command,
    /// From a motor.
    Reply,
    /// The bytes cannot tell.
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

/// What a decoded frame says.
#[derive(Clone, Debug, PartialEq)]
pub struct Decoded {
    /// Its values; the unit ends each key. Where the direction is open, those of a command.
    pub fields: Fields,
    /// Its values if it is a reply, where the direction is open and they differ.
    pub fields_if_reply: Option<Fields>,
    /// What the library's own encoder makes of the decoded value. It differs from the frame only
    /// in bytes that mean nothing (NULL in the manual) or have two spellings (4.3, 7.3).
    pub canonical: String,
}

/// A frame, or bytes that are none, and what is known about it.
#[derive(Clone, Debug, PartialEq)]
pub struct Explanation {
    /// When and where it was heard, for whom knows that: `Default` else.
    pub stamp: Stamp,
    /// The frame in the notation of [`text`](crate::text), or the text or bytes that are no frame.
    pub raw: String,
    /// The bus it came on.
    pub bus: BusKind,
    /// Whose frame it is: one motor's or all motors'. `None` where no motor of the protocol is
    /// named.
    pub id: Option<Target>,
    /// Which way it went, where that is known or at least a question.
    pub direction: Option<FrameDirection>,
    /// The kind of frame, where it is known.
    pub opcode: Option<Opcode>,
    /// What it says, or one sentence about why it says nothing.
    pub outcome: Result<Decoded, String>,
}

impl Explanation {
    /// For what is no frame of the protocol: the text or bytes, and one sentence why.
    pub fn no_frame(bus: BusKind, raw: impl Into<String>, sentence: impl Into<String>) -> Self {
        Self {
            stamp: Stamp::default(),
            raw: raw.into(),
            bus,
            id: None,
            direction: None,
            opcode: None,
            outcome: Err(sentence.into()),
        }
    }

    /// Whether the frame was decoded.
    pub const fn is_decoded(&self) -> bool {
        self.outcome.is_ok()
    }

    /// As a JSON object with the keys `time` and `interface` where they are known, then `raw`, `bus`,
    /// `id`, `direction`, `name`, `opcode` and then `fields` (perhaps `fields_if_reply`) and
    /// `canonical`, or `error`. What else is not known is null.
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
        let byte = self.opcode.and_then(Opcode::byte);
        object["opcode"] = byte.map(|byte| format!("0x{byte:02X}")).into();
        match &self.outcome {
            Ok(decoded) => {
                object["fields"] = decoded.fields.clone().into();
                if let Some(fields) = &decoded.fields_if_reply {
                    object["fields_if_reply"] = fields.clone().into();
                }
                object["canonical"] = decoded.canonical.clone().into();
            }
            Err(sentence) => object["error"] = sentence.clone().into(),
        }
        object
    }
}

/// One line for people. Text that was no frame stands in it as it came: who shows it on a terminal
/// takes care of control characters.
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
        if let Some(opcode) = self.opcode {
            write!(f, "  {opcode}")?;
        }
        if !decoded.fields.is_empty() {
            write!(f, ": {}", prose(&decoded.fields))?;
        }
        if let Some(fields) = &decoded.fields_if_reply {
            let nothing = if decoded.fields.is_empty() { ": no values" } else { "" };
            write!(f, "{nothing}; if it is a reply: {}", prose(fields))?;
        }
        if self.opcode == Some(Opcode::Motion) {
            f.write_str(" (by the ranges of protocol V4.3; other firmware has others)")?;
        }
        if decoded.canonical != self.raw {
            write!(f, "; the usual spelling is {}", decoded.canonical)?;
        }
        Ok(())
    }
}
