//! The manual's example frames and section headings, from the files in `vectors/`.

use std::collections::BTreeMap;

pub use myactuator_protocol_core::drive::Bus;
use myactuator_protocol_core::{AnyCommand, Channel, Data, MotorId, Opcode, Target};
use serde::Deserialize;
use serde_json::{Map, Value};

/// Who sends a row's frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Direction {
    /// The master.
    Command,
    /// The motor.
    Reply,
}

/// One example frame of the manual; `vectors/README.md` explains the keys.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Row {
    /// Section of the manual, `"2.1.5"`.
    pub section: String,
    /// Number of the example in its section, from 1.
    pub example: u32,
    /// The bus.
    pub bus: Bus,
    /// Who sends it.
    pub direction: Direction,
    /// The motor's id, or `"all"`.
    pub id: Value,
    /// `identifier#data` on CAN, 13 bytes in hex on RS485.
    pub frame: String,
    /// The command, in both directions.
    #[serde(rename = "name")]
    pub opcode: Opcode,
    /// What the frame means.
    pub fields: Map<String, Value>,
    /// The manual's explanation.
    pub text: String,
    /// What is wrong, if print, text and tables disagree.
    pub misprint: Option<String>,
}

impl Row {
    /// The motor or motors of the frame.
    pub fn target(&self) -> Target {
        let Some(id) = self.id.as_u64() else {
            assert_eq!(self.id, "all", "{self}: id must be a number or \"all\"");
            return Target::All;
        };
        let id = u8::try_from(id).ok().and_then(|id| MotorId::new(id).ok());
        Target::Motor(id.expect("an id from 1 to 32"))
    }

    /// The channel that sections 1, 3, 4, 5, 6 and 7 give this frame.
    pub fn channel(&self) -> Channel {
        match (self.opcode, self.direction, self.target()) {
            (Opcode::BusId, _, Target::All) => Channel::BusId,
            (Opcode::Motion, Direction::Command, Target::Motor(id)) => Channel::Motion(id),
            (Opcode::Motion, Direction::Reply, Target::Motor(id)) => Channel::MotionReply(id),
            (_, Direction::Command, target) => Channel::Command(target),
            (_, Direction::Reply, Target::Motor(id)) => Channel::Reply(id),
            _ => panic!("{self}: no channel carries this"),
        }
    }

    /// Identifier and data of a CAN row.
    pub fn can(&self) -> (u16, Data) {
        let (identifier, data) = self.frame.split_once('#').expect("identifier#data");
        let identifier = u16::from_str_radix(identifier, 16).expect("a hexadecimal identifier");
        (identifier, hex(data).try_into().expect("eight data bytes"))
    }

    /// All bytes of an RS485 row.
    pub fn rs485(&self) -> [u8; 13] {
        hex(&self.frame).try_into().expect("13 bytes")
    }

    /// The data bytes, on either bus.
    pub fn data(&self) -> Data {
        match self.bus {
            Bus::Can => self.can().1,
            Bus::Rs485 => {
                let [_, _, _, data @ .., _, _] = self.rs485();
                data
            }
        }
    }
}

impl std::fmt::Display for Row {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { section, example, bus, direction, id, frame, .. } = self;
        write!(f, "{section} example {example}, {bus:?} {direction:?}, id {id}: {frame}")
    }
}

/// The bytes of a text of hexadecimal digits, with or without spaces.
pub fn hex(text: &str) -> Vec<u8> {
    let digits = text.replace(' ', "");
    assert_eq!(digits.len() % 2, 0, "{text}: half a byte is left over");
    let byte = |at| u8::from_str_radix(&digits[at..at + 2], 16).expect(text);
    (0..digits.len()).step_by(2).map(byte).collect()
}

/// Every row of `manual-v4.3.jsonl`, in the manual's order.
pub fn rows() -> Vec<Row> {
    let parse = |line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{e} in {line}"));
    include_str!("../vectors/manual-v4.3.jsonl").lines().map(parse).collect()
}

/// A command of each kind: the manual's first example. The three kinds without one (2.18, 2.27, 2.28) have the command
/// byte and seven NULL.
pub fn one_of_each() -> Vec<AnyCommand> {
    let rows = rows();
    let command = |&opcode: &Opcode| {
        let is_command = |row: &&Row| row.direction == Direction::Command;
        let example = rows.iter().filter(is_command).find(|row| row.opcode == opcode);
        let bare = || [opcode.byte().expect("a command byte"), 0, 0, 0, 0, 0, 0, 0];
        AnyCommand::decode_as(opcode, &example.map_or_else(bare, Row::data)).expect("a command")
    };
    Opcode::ALL.iter().map(command).collect()
}

const KINDS: &str = include_str!("../vectors/kinds.txt");
const INDENT: &str = "    ";

/// The headings of the manual's table of contents, section and title, in its order.
pub fn headings() -> impl Iterator<Item = (&'static str, &'static str)> {
    let headings = KINDS.lines().filter(|line| !line.starts_with(INDENT));
    headings.map(|line| line.split_once(' ').expect("number and heading"))
}

/// The headings of the manual's table of contents by section.
pub fn sections() -> BTreeMap<&'static str, &'static str> {
    headings().collect()
}

/// An indented line below a heading in `kinds.txt`.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Its section.
    pub section: &'static str,
    /// Its kind.
    pub opcode: Opcode,
    /// The rest of the line.
    pub rest: &'static str,
}

/// The lines of `kinds.txt` that begin with this word, in the manual's order.
pub fn entries(word: &str) -> impl Iterator<Item = Entry> {
    let mut section = "";
    KINDS.lines().filter_map(move |line| {
        let Some(entry) = line.strip_prefix(INDENT) else {
            section = line.split(' ').next()?;
            return None;
        };
        let (first, rest) = entry.split_once(' ').expect(line);
        assert!(["kind", "command", "reply", "case"].contains(&first), "no such line: {line}");
        let (name, rest) = rest.split_once(' ').unwrap_or((rest, ""));
        let opcode = name.parse().unwrap_or_else(|error| panic!("{line}: {error}"));
        (first == word).then_some(Entry { section, opcode, rest })
    })
}
