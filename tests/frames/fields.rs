//! Proves, field by field, that every command and every reply has the layout of the manual's tables:
//!
//! - Distinct bytes land in exactly their field. Nothing leaks into its neighbours.
//! - NULL bytes are written as 0 and not read.
//! - A number that a field may not hold is refused.
//!
//! The layouts are the manual's, typed by hand in `vectors/kinds.txt`: as a table if every field has a place of its
//! own, as cases if fields depend on one another or share bytes.

use std::collections::BTreeMap;
use std::fmt::Debug;
use std::ops::Range;

use myactuator_protocol_core::command::*;
use myactuator_protocol_core::quantity::{Form, Place};
use myactuator_protocol_core::{AnyCommand, AnyReply, Data, DecodeError, Opcode, OutOfRange};
use myactuator_tests::values::id;
use myactuator_tests::vectors::{Entry, entries, hex, sections};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

/// How many bytes a type fills, and the ranges of numbers that it may hold.
fn bytes_and_ranges(kind: &str) -> (usize, &'static [(i64, i64)]) {
    match kind {
        "u8" => (1, &[(0, 0xFF)]),
        "u16" => (2, &[(0, 0xFFFF)]),
        "u32" => (4, &[(0, 0xFFFF_FFFF)]),
        "i8" => (1, &[(-0x80, 0x7F)]),
        "i16" => (2, &[(-0x8000, 0x7FFF)]),
        "i32" => (4, &[(-0x8000_0000, 0x7FFF_FFFF)]),
        // The bits of finite numbers.
        "f32" => (4, &[(0, 0x7F7F_FFFF), (0x8000_0000, 0xFF7F_FFFF)]),
        "switch" => (1, &[(0, 1)]), // 2.34.2
        // 2.5.1, and 0 for no planning (2.20.2, 2.21.1).
        "acceleration" => (4, &[(0, 0), (100, 60_000)]),
        // 2.22.1 says 35999, and both examples of 2.22.4 send 36000.
        "turn" => (2, &[(0, 36_000)]),
        "text" => (7, &[(0, (1 << 56) - 1)]), // 2.33.3
        other => panic!("no type {other}"),
    }
}

/// A field in the tables.
struct Row {
    key: &'static str,
    first: usize,
    bytes: usize,
    ranges: &'static [(i64, i64)],
    step: f64,
}

impl Row {
    fn new(text: &'static str) -> Self {
        let [key, first, kind] = text.split(':').collect::<Vec<_>>()[..] else { panic!("{text}") };
        let (kind, step) = kind.split_once('*').unwrap_or((kind, "1"));
        let (bytes, ranges) = bytes_and_ranges(kind);
        // The float with the bits 1 is the smallest.
        let step = if kind == "f32" { f32::from_bits(1).into() } else { step.parse().expect(text) };
        Self { key, first: first.parse().expect(text), bytes, ranges, step }
    }

    fn place(&self) -> Range<usize> {
        self.first..self.first + self.bytes
    }

    fn allows(&self, raw: i64) -> bool {
        self.ranges.iter().any(|&(min, max)| (min..=max).contains(&raw))
    }

    fn write(&self, data: &mut Data, raw: i64) {
        data[self.place()].copy_from_slice(&raw.to_le_bytes()[..self.bytes]);
    }

    fn read(&self, data: &Data) -> i64 {
        let mut all = [0; 8];
        all[..self.bytes].copy_from_slice(&data[self.place()]);
        let unused = 64 - 8 * self.bytes;
        let raw = i64::from_le_bytes(all);
        if self.ranges[0].0 < 0 { raw << unused >> unused } else { raw }
    }
}

/// Commands, or replies.
struct Side<T> {
    name: &'static str,
    heading: &'static str,
    fields: fn(Opcode) -> &'static [Field],
    decode: fn(Opcode, &Data) -> Result<T, DecodeError>,
    encode: fn(&T) -> Data,
    opcode: fn(&T) -> Option<Opcode>,
}

const COMMAND: Side<AnyCommand> = Side {
    name: "command",
    heading: "Command data",
    fields: Opcode::command_fields,
    decode: AnyCommand::decode_as,
    encode: AnyCommand::encode,
    opcode: AnyCommand::opcode,
};
const REPLY: Side<AnyReply> = Side {
    name: "reply",
    heading: "Reply data",
    fields: Opcode::reply_fields,
    decode: AnyReply::decode_as,
    encode: AnyReply::encode,
    opcode: AnyReply::opcode,
};

impl<T: PartialEq + Debug + DeserializeOwned> Side<T> {
    /// Checks that these bytes decode to a value that encodes to them, whatever the NULL bytes hold.
    fn check_bytes(&self, opcode: Opcode, data: Data, nulls: &[usize]) -> T {
        let what = format!("{opcode}, {}: {data:02X?}", self.heading);
        let value = (self.decode)(opcode, &data).unwrap_or_else(|error| panic!("{what}: {error}"));
        assert_eq!((self.encode)(&value), data, "{what}: {value:?}");
        assert_eq!((self.opcode)(&value), Some(opcode), "{what}");
        let mut noisy = data;
        for (place, &null) in nulls.iter().enumerate() {
            let mut one = data;
            one[null] = 0xFF;
            assert_eq!((self.decode)(opcode, &one).as_ref(), Ok(&value), "{what}, NULL {null}");
            noisy[null] = 0xA0 + place as u8;
        }
        assert_eq!((self.decode)(opcode, &noisy).as_ref(), Ok(&value), "{what}, all NULLs");
        if let Some(byte) = opcode.byte() {
            let mut other = data;
            other[0] = !byte;
            let error = DecodeError::WrongOpcode { expected: opcode, found: !byte };
            assert_eq!((self.decode)(opcode, &other), Err(error), "{what}");
        }
        value
    }

    fn check_tables(&self) {
        entries(self.name).for_each(|table| self.check_table(table));
    }

    fn check_table(&self, Entry { section, opcode, rest }: Entry) {
        let byte = opcode.byte().expect("a command byte");
        let rows: Vec<_> = rest.split_whitespace().map(Row::new).collect();
        assert_eq!(sections()[section], self.heading, "{opcode}");
        assert!(section.starts_with(&format!("{}.", opcode.section())), "{opcode}: {section}");
        let fields = (self.fields)(opcode);
        let described = fields.iter().map(|f| (f.key().to_string(), f.place, f.when));
        let expected = rows.iter().map(|row| {
            let place = Place::Bytes { first: row.first as u8, count: row.bytes as u8 };
            (row.key.to_owned(), place, When::Always)
        });
        assert_eq!(described.collect::<Vec<_>>(), expected.collect::<Vec<_>>(), "{section}");
        let is_null = |byte: &usize| rows.iter().all(|row| !row.place().contains(byte));
        let nulls: Vec<_> = (1..8).filter(is_null).collect();
        let filled: usize = rows.iter().map(|row| row.bytes).sum();
        assert_eq!(nulls.len() + filled, 7, "{section}: fields of this test overlap");

        let nothing = [byte, 0, 0, 0, 0, 0, 0, 0];
        let base = self.check_bytes(opcode, nothing, &nulls);
        // Low bytes, and bytes with the sign bit, in each field alone and in all together.
        for salt in [0x10, 0x80] {
            let pattern = std::array::from_fn(|place| salt + place as u8);
            let mut together = (nothing, nothing);
            for (field, row) in fields.iter().zip(&rows) {
                // If that is too large for this field, its largest number.
                let raw = Some(row.read(&pattern)).filter(|&raw| row.allows(raw));
                let raw = raw.unwrap_or(row.ranges[row.ranges.len() - 1].1);
                let mut alone = (nothing, nothing);
                for (made, by_hand) in [&mut alone, &mut together] {
                    row.write(by_hand, raw);
                    assert_eq!(field.put(made, raw), Ok(()), "{section}: {field:?}");
                    assert_eq!(made, by_hand, "{section}: {field:?}");
                    assert_eq!(field.raw(by_hand), raw, "{section}: {field:?}");
                }
                assert_ne!(self.check_bytes(opcode, alone.1, &nulls), base, "{section}: {field:?}");
            }
            self.check_bytes(opcode, together.1, &nulls);
        }
        for (field, row) in fields.iter().zip(&rows) {
            self.check_range(opcode, nothing, field, row);
        }
    }

    /// Checks that both ends of each range are allowed and their neighbours refused.
    fn check_range(&self, opcode: Opcode, nothing: Data, field: &Field, row: &Row) {
        assert_eq!(field.quantity.amount(1), row.step, "{opcode}: {field:?}");
        for raw in row.ranges.iter().flat_map(|&(min, max)| [min - 1, min, max, max + 1]) {
            let what = format!("{opcode}, {}: {raw} as {field:?}", self.heading);
            let (is_allowed, amount) = (row.allows(raw), raw as f64 * row.step);
            let check = |result: Result<(), OutOfRange>| match result {
                Ok(()) => assert!(is_allowed, "{what} is taken"),
                Err(error) => {
                    assert!(!is_allowed && error.quantity == field.quantity, "{what}: {error}");
                    let given = error.given.value();
                    let is_it = (given - amount).abs() <= 1e-9 * amount.abs();
                    assert!(is_it || !given.is_finite(), "{what}: {error}");
                }
            };
            if let Form::Steps(_) | Form::Float | Form::Switch = field.quantity.form {
                assert_eq!(field.quantity.allows(raw), is_allowed, "{what}");
            }
            let mut data = nothing;
            check(field.put(&mut data, raw));
            row.write(&mut data, raw);
            if row.read(&data) == raw {
                check((self.decode)(opcode, &data).map(drop).map_err(|error| match error {
                    DecodeError::OutOfRange(error) => error,
                    other => panic!("{what}: {other}"),
                }));
            }
        }
    }

    fn check_case(&self, opcode: Opcode, case: &Case) {
        let value: T = serde_json::from_value(case.value.clone()).expect("a value");
        let data: Data = hex(&case.data).try_into().expect("eight bytes");
        assert_eq!((self.encode)(&value), data, "{value:?}");
        assert_eq!(self.check_bytes(opcode, data, &case.null), value);
        let there = (self.fields)(opcode).iter().filter(|field| field.is_in(&data));
        let described = there.clone().map(|field| (field.key().to_string(), field.raw(&data)));
        assert_eq!(described.collect::<BTreeMap<_, _>>(), case.fields, "{value:?}");
        let mut made = [opcode.byte().unwrap_or(0), 0, 0, 0, 0, 0, 0, 0];
        for field in there {
            let raw = case.fields[&field.key().to_string()];
            assert_eq!(field.put(&mut made, raw), Ok(()), "{value:?}: {field:?}");
        }
        // An id that was read has three spellings.
        if case.fields.get("access") != Some(&1) {
            assert_eq!(made, data, "{value:?}");
        }
    }
}

#[test]
fn every_field_of_every_command_has_its_bytes() {
    COMMAND.check_tables();
}

#[test]
fn every_field_of_every_reply_has_its_bytes() {
    REPLY.check_tables();
}

#[test]
fn every_kind_has_one_table_a_side_or_cases() {
    for Entry { opcode, rest: facts, .. } in entries("kind") {
        let is_in_cases = facts.contains("no-layout");
        // 2.26.3 and 2.34.3: no reply; 2.32.3: a reply that means nothing.
        let has_reply = !facts.starts_with("Silent") && !facts.starts_with("Garbled");
        for (side, is_there) in [("command", true), ("reply", has_reply)] {
            let count = entries(side).filter(|table| table.opcode == opcode).count();
            assert_eq!(count, usize::from(is_there && !is_in_cases), "{opcode}: {side}");
            assert!(!is_in_cases || cases(side).any(|(of, _)| of == opcode), "{opcode}: {side}");
        }
        if !has_reply {
            let data = [opcode.byte().expect("a command byte"), 0, 0, 0, 0, 0, 0, 0];
            assert_eq!(AnyReply::decode_as(opcode, &data), Err(DecodeError::NoReply(opcode)));
            assert!(!opcode.has_reply() && opcode.reply_fields().is_empty());
        }
    }
}

/// A value, its bytes, which of them are NULL, and the number in each field.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Case {
    value: Value,
    data: String,
    null: Vec<usize>,
    fields: BTreeMap<String, i64>,
}

/// The cases of a side, `command` or `reply`.
fn cases(of: &str) -> impl Iterator<Item = (Opcode, Case)> {
    entries("case").filter_map(move |Entry { opcode, rest, .. }| {
        let (side, json) = rest.split_once(' ').expect("a side and a value");
        assert!(["command", "reply", "both"].contains(&side), "{opcode}: {side}");
        let case = serde_json::from_str(json).unwrap_or_else(|e| panic!("{e} in {json}"));
        (side == of || side == "both").then_some((opcode, case))
    })
}

#[test]
fn values_that_depend_on_one_another_have_their_bytes() {
    cases(COMMAND.name).for_each(|(opcode, case)| COMMAND.check_case(opcode, &case));
    cases(REPLY.name).for_each(|(opcode, case)| REPLY.check_case(opcode, &case));
    // 7.3's table has the bare id in DATA[6], 7.4's example in DATA[7].
    let data = [0x79, 0, 1, 0, 0, 0, 0x1E, 0];
    let told = AnyReply::BusId(BusIdReply::OnRs485(id(0x1E)));
    assert_eq!(AnyReply::decode_as(Opcode::BusId, &data), Ok(told));
}
