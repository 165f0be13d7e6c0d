//! Proves, field by field, that every command and every reply lies on the bus as the manual's
//! layout tables say: distinct bytes land in exactly their field, nothing leaks into its neighbours,
//! NULL bytes are written 0 and not read, and what a field may not hold is refused.
//!
//! The tables below are the manual's (sections 2.x.2 and 2.x.3, 4, 5, 7), typed by hand with the
//! corrections that its misprints need: 2.9.2 prints `>>8` three times, 2.11.3 and 2.13.3 number the
//! formulas one too low, 2.20.2 and 2.24.2 print DATA[2] for maxTorque in DATA[1], and 4.3 and 7.3
//! print DATA[0] for DATA[1..=3].

use std::collections::BTreeSet;
use std::fmt::Debug;

use myactuator_protocol_core::command::*;
use myactuator_protocol_core::quantity::{Form, Place};
use myactuator_protocol_core::units::*;
use myactuator_protocol_core::{AnyCommand, AnyReply, Data, DecodeError, Opcode, OutOfRange};
use myactuator_tests::values::{degrees, gain, id, percent, up_to};
use myactuator_tests::vectors::sections;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{from_str, to_string};

/// A type of the manual, what it may hold, and what one step of it is in its unit.
#[derive(Clone, Copy)]
struct Number {
    bytes: usize,
    allowed: &'static [(i64, i64)],
    step: f64,
}

const fn number(bytes: usize, allowed: &'static [(i64, i64)]) -> Number {
    Number { bytes, allowed, step: 1.0 }
}

const U8: Number = number(1, &[(0, 0xFF)]);
const U16: Number = number(2, &[(0, 0xFFFF)]);
const U32: Number = number(4, &[(0, 0xFFFF_FFFF)]);
const I8: Number = number(1, &[(-0x80, 0x7F)]);
const I16: Number = number(2, &[(-0x8000, 0x7FFF)]);
const I32: Number = number(4, &[(-0x8000_0000, 0x7FFF_FFFF)]);
/// Any but infinities and what is no number; the number with the bits 1 is the smallest.
const F32: Number =
    number(4, &[(0, 0x7F7F_FFFF), (0x8000_0000, 0xFF7F_FFFF)]).by(f32::from_bits(1) as f64);
/// 2.34.2.
const SWITCH: Number = number(1, &[(0, 1)]);
/// 2.5.1, and 0 for no planning (2.20.2, 2.21.1).
const ACCELERATION: Number = number(4, &[(0, 0), (100, 60_000)]);
/// 2.22.1 says 35999, and both examples of 2.22.4 send 36000.
const WITHIN_A_TURN: Number = number(2, &[(0, 36_000)]).by(0.01);
/// 2.33.3.
const SEVEN_CHARACTERS: Number = number(7, &[(0, (1 << 56) - 1)]);

impl Number {
    const fn by(self, step: f64) -> Self {
        Self { step, ..self }
    }

    fn allows(&self, raw: i64) -> bool {
        self.allowed.iter().any(|&(min, max)| (min..=max).contains(&raw))
    }

    /// The ends of what it may hold, and their neighbours on the other side.
    fn edges(&self) -> impl DoubleEndedIterator<Item = i64> {
        self.allowed.iter().flat_map(|&(min, max)| [min - 1, min, max, max + 1])
    }

    /// The number in the first of these bytes.
    fn read(&self, bytes: &[u8]) -> i64 {
        let mut all = [0; 8];
        all[..self.bytes].copy_from_slice(&bytes[..self.bytes]);
        let unused = 64 - 8 * self.bytes;
        let is_signed = self.allowed[0].0 < 0;
        let raw = i64::from_le_bytes(all);
        if is_signed { raw << unused >> unused } else { raw }
    }
}

/// A field: its name with the unit behind it, its first byte, its type.
type Row = (&'static str, usize, Number);
/// One layout table of the manual: of which kind, its command byte, the section, its fields. All other
/// bytes are NULL.
type Table = (Opcode, u8, &'static str, &'static [Row]);

const INDEX: Row = ("index", 1, U8);
const GAIN: Row = ("value", 4, F32);
const ANGLE: Row = ("angle_deg", 4, I32.by(0.01));
const OFFSET: Row = ("offset_pulses", 4, I32);
const MAX_SPEED: Row = ("max_speed_dps", 2, U16);
const MAX_TORQUE: Row = ("max_torque_pct", 1, U8);
const TEMPERATURE: Row = ("temperature_c", 1, I8);
const CURRENT: Row = ("current_a", 2, I16.by(0.01));
const SPEED: Row = ("speed_dps", 4, I16);
/// 2.15.3, 2.19.3, 2.20.3, 2.21.3, 2.23.3, 2.24.3: the same table six times.
const FEEDBACK: &[Row] = &[TEMPERATURE, CURRENT, SPEED, ("angle_deg", 6, I16)];

/// All but those whose fields depend on one another: see `hand_written`.
const COMMANDS: &[Table] = &[
    (Opcode::ReadPid, 0x30, "2.1.2", &[INDEX]),
    (Opcode::WritePidRam, 0x31, "2.2.2", &[INDEX, GAIN]),
    (Opcode::WritePidRom, 0x32, "2.3.2", &[INDEX, GAIN]),
    (Opcode::ReadAcceleration, 0x42, "2.4.2", &[INDEX]),
    (Opcode::WriteAcceleration, 0x43, "2.5.2", &[INDEX, ("acceleration_dps2", 4, ACCELERATION)]),
    (Opcode::ReadMultiTurnEncoder, 0x60, "2.6.2", &[]),
    (Opcode::ReadMultiTurnEncoderRaw, 0x61, "2.7.2", &[]),
    (Opcode::ReadMultiTurnEncoderOffset, 0x62, "2.8.2", &[]),
    (Opcode::SetEncoderZero, 0x63, "2.9.2", &[OFFSET]),
    (Opcode::SetCurrentPositionZero, 0x64, "2.10.2", &[]),
    (Opcode::ReadSingleTurnEncoder, 0x90, "2.11.2", &[]),
    (Opcode::ReadMultiTurnAngle, 0x92, "2.12.2", &[]),
    (Opcode::ReadSingleTurnAngle, 0x94, "2.13.2", &[]),
    (Opcode::ReadSingleTurnAngleV4_4, 0x94, "2.13.2", &[]),
    (Opcode::ReadStatus1, 0x9A, "2.14.2", &[]),
    (Opcode::ReadStatus2, 0x9C, "2.15.2", &[]),
    (Opcode::ReadStatus3, 0x9D, "2.16.2", &[]),
    (Opcode::Shutdown, 0x80, "2.17.2", &[]),
    (Opcode::Stop, 0x81, "2.18.2", &[]),
    (Opcode::Torque, 0xA1, "2.19.2", &[("current_a", 4, I16.by(0.01))]),
    (Opcode::Speed, 0xA2, "2.20.2", &[MAX_TORQUE, ("speed_dps", 4, I32.by(0.01))]),
    (Opcode::AbsolutePosition, 0xA4, "2.21.2", &[MAX_SPEED, ANGLE]),
    (
        Opcode::SingleTurnPosition,
        0xA6,
        "2.22.2",
        &[("direction", 1, U8), MAX_SPEED, ("angle_deg", 4, WITHIN_A_TURN)],
    ),
    (Opcode::IncrementalPosition, 0xA8, "2.23.2", &[MAX_SPEED, ANGLE]),
    (Opcode::ForcePosition, 0xA9, "2.24.2", &[MAX_TORQUE, MAX_SPEED, ANGLE]),
    (Opcode::ReadRunningMode, 0x70, "2.25.2", &[]),
    (Opcode::Reset, 0x76, "2.26.2", &[]),
    (Opcode::ReleaseBrake, 0x77, "2.27.2", &[]),
    (Opcode::LockBrake, 0x78, "2.28.2", &[]),
    (Opcode::ReadRunTime, 0xB1, "2.29.2", &[]),
    (Opcode::ReadVersionDate, 0xB2, "2.30.2", &[]),
    (Opcode::CommunicationLossProtection, 0xB3, "2.31.2", &[("timeout_ms", 4, U32)]),
    (Opcode::SetBaudRate, 0xB4, "2.32.2", &[("baud_rate", 7, U8)]),
    (Opcode::ReadModel, 0xB5, "2.33.2", &[]),
    (
        Opcode::ActiveReply,
        0xB6,
        "2.34.2",
        &[("command", 1, U8), ("enable", 2, SWITCH), ("interval_ms", 3, U16.by(10.0))],
    ),
];

const REPLIES: &[Table] = &[
    (Opcode::ReadPid, 0x30, "2.1.3", &[INDEX, GAIN]),
    (Opcode::ReadAcceleration, 0x42, "2.4.3", &[INDEX, ("acceleration_dps2", 4, U32)]),
    (Opcode::ReadMultiTurnEncoder, 0x60, "2.6.3", &[("position_pulses", 4, I32)]),
    (Opcode::ReadMultiTurnEncoderRaw, 0x61, "2.7.3", &[("raw_pulses", 4, I32)]),
    (Opcode::ReadMultiTurnEncoderOffset, 0x62, "2.8.3", &[OFFSET]),
    (Opcode::SetCurrentPositionZero, 0x64, "2.10.3", &[OFFSET]),
    (
        Opcode::ReadSingleTurnEncoder,
        0x90,
        "2.11.3",
        &[("position_pulses", 2, U16), ("raw_pulses", 4, U16), ("offset_pulses", 6, U16)],
    ),
    (Opcode::ReadMultiTurnAngle, 0x92, "2.12.3", &[ANGLE]),
    // 0 to 35999, but a drive that reports 36000 is no reason to lose a reading.
    (Opcode::ReadSingleTurnAngle, 0x94, "2.13.3", &[("angle_deg", 6, U16.by(0.01))]),
    // As the manual of V4.4 has it.
    (Opcode::ReadSingleTurnAngleV4_4, 0x94, "2.13.3", &[ANGLE]),
    (
        Opcode::ReadStatus1,
        0x9A,
        "2.14.3",
        &[
            TEMPERATURE,
            ("mosfet_temperature_c", 2, I8),
            ("brake", 3, U8),
            ("voltage_v", 4, U16.by(0.1)),
            ("errors", 6, U16),
        ],
    ),
    (Opcode::ReadStatus2, 0x9C, "2.15.3", FEEDBACK),
    (
        Opcode::ReadStatus3,
        0x9D,
        "2.16.3",
        &[
            TEMPERATURE,
            ("phase_a_current_a", 2, I16.by(0.01)),
            ("phase_b_current_a", 4, I16.by(0.01)),
            ("phase_c_current_a", 6, I16.by(0.01)),
        ],
    ),
    (Opcode::Torque, 0xA1, "2.19.3", FEEDBACK),
    (Opcode::Speed, 0xA2, "2.20.3", FEEDBACK),
    (Opcode::AbsolutePosition, 0xA4, "2.21.3", FEEDBACK),
    (
        Opcode::SingleTurnPosition,
        0xA6,
        "2.22.3",
        &[TEMPERATURE, CURRENT, SPEED, ("encoder_pulses", 6, U16)],
    ),
    (Opcode::IncrementalPosition, 0xA8, "2.23.3", FEEDBACK),
    (Opcode::ForcePosition, 0xA9, "2.24.3", FEEDBACK),
    (Opcode::ReadRunningMode, 0x70, "2.25.3", &[("mode", 7, U8)]),
    (Opcode::ReadRunTime, 0xB1, "2.29.3", &[("run_time_ms", 4, U32)]),
    (Opcode::ReadVersionDate, 0xB2, "2.30.3", &[("version_date", 4, U32)]),
    (Opcode::ReadModel, 0xB5, "2.33.3", &[("model", 1, SEVEN_CHARACTERS)]),
];

/// The replies that the manual calls the same as their command. (So is that of 2.35.3.)
const ECHOES: [(Opcode, &str); 9] = [
    (Opcode::WritePidRam, "2.2.3"),
    (Opcode::WritePidRom, "2.3.3"),
    (Opcode::WriteAcceleration, "2.5.3"),
    (Opcode::SetEncoderZero, "2.9.3"),
    (Opcode::Shutdown, "2.17.3"),
    (Opcode::Stop, "2.18.3"),
    (Opcode::ReleaseBrake, "2.27.3"),
    (Opcode::LockBrake, "2.28.3"),
    (Opcode::CommunicationLossProtection, "2.31.3"),
];

fn replies() -> Vec<Table> {
    let echo = |(opcode, section)| {
        let command = COMMANDS.iter().find(|table| table.0 == opcode).expect("a command");
        (opcode, command.1, section, command.3)
    };
    REPLIES.iter().copied().chain(ECHOES.map(echo)).collect()
}

/// Commands, or replies.
struct Side<T> {
    heading: &'static str,
    fields: fn(Opcode) -> &'static [Field],
    decode: fn(Opcode, &Data) -> Result<T, DecodeError>,
    encode: fn(&T) -> Data,
    opcode: fn(&T) -> Option<Opcode>,
}

const COMMAND: Side<AnyCommand> = Side {
    heading: "Command data",
    fields: Opcode::command_fields,
    decode: AnyCommand::decode_as,
    encode: AnyCommand::encode,
    opcode: AnyCommand::opcode,
};
const REPLY: Side<AnyReply> = Side {
    heading: "Reply data",
    fields: Opcode::reply_fields,
    decode: AnyReply::decode_as,
    encode: AnyReply::encode,
    opcode: AnyReply::opcode,
};

impl<T: PartialEq + Debug> Side<T> {
    /// These bytes decode to a value that encodes to them, whatever the NULL bytes hold.
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
            let [_, rest @ ..] = data;
            let [a, b, c, d, e, f, g] = rest;
            let error = DecodeError::WrongOpcode { expected: opcode, found: !byte };
            assert_eq!((self.decode)(opcode, &[!byte, a, b, c, d, e, f, g]), Err(error), "{what}");
        }
        value
    }

    fn check_table(&self, &(opcode, byte, section, rows): &Table) {
        assert_eq!((opcode.byte(), sections()[section]), (Some(byte), self.heading), "{opcode}");
        assert!(section.starts_with(&format!("{}.", opcode.section())), "{opcode}: {section}");
        let fields = (self.fields)(opcode);
        let described = fields.iter().map(|f| (f.key().to_string(), f.place, f.when));
        let expected = rows.iter().map(|&(key, first, number)| {
            let (first, count) = (first as u8, number.bytes as u8);
            (key.to_owned(), Place::Bytes { first, count }, When::Always)
        });
        assert_eq!(described.collect::<Vec<_>>(), expected.collect::<Vec<_>>(), "{section}");
        let is_in = |byte: usize, row: &Row| (row.1..row.1 + row.2.bytes).contains(&byte);
        let nulls: Vec<_> =
            (1..8).filter(|&byte| !rows.iter().any(|row| is_in(byte, row))).collect();
        let filled: usize = rows.iter().map(|row| row.2.bytes).sum();
        assert_eq!(nulls.len() + filled, 7, "{section}: fields of this test overlap");

        let nothing = [byte, 0, 0, 0, 0, 0, 0, 0];
        let base = self.check_bytes(opcode, nothing, &nulls);
        let pairs = || fields.iter().zip(rows);
        // Low bytes and such with the sign's bit, in each field by itself and in all together.
        for salt in [0x10, 0x80] {
            let pattern: Data = std::array::from_fn(|place| salt + place as u8);
            let mut together = (nothing, nothing);
            for (field, &(_, first, number)) in pairs() {
                // What is too large for this field is its largest.
                let raw = Some(number.read(&pattern[first..])).filter(|&raw| number.allows(raw));
                let raw = raw.unwrap_or_else(|| number.edges().nth_back(1).expect("an end"));
                let bytes = &raw.to_le_bytes()[..number.bytes];
                let mut alone = (nothing, nothing);
                for (made, by_hand) in [&mut alone, &mut together] {
                    by_hand[first..first + number.bytes].copy_from_slice(bytes);
                    assert_eq!(field.put(made, raw), Ok(()), "{section}: {field:?}");
                    assert_eq!(made, by_hand, "{section}: {field:?}");
                    assert_eq!(field.raw(by_hand), raw, "{section}: {field:?}");
                }
                assert_ne!(self.check_bytes(opcode, alone.1, &nulls), base, "{section}: {field:?}");
            }
            self.check_bytes(opcode, together.1, &nulls);
        }
        for (field, &(_, first, number)) in pairs() {
            self.check_range(opcode, nothing, field, first, number);
        }
    }

    /// Both ends of what a field may hold are allowed, their neighbours refused.
    fn check_range(
        &self,
        opcode: Opcode,
        nothing: Data,
        field: &Field,
        first: usize,
        number: Number,
    ) {
        assert_eq!(field.quantity.amount(1), number.step, "{opcode}: {field:?}");
        for raw in number.edges() {
            let what = format!("{opcode}, {}: {raw} as {field:?}", self.heading);
            let is_error = |error: OutOfRange| {
                let given = error.given.value();
                let amount = raw as f64 * number.step;
                error.quantity == field.quantity
                    && (!given.is_finite() || (given - amount).abs() <= 1e-9 * amount.abs())
            };
            if let Form::Steps(_) | Form::Float | Form::Switch = field.quantity.form {
                assert_eq!(field.quantity.allows(raw), number.allows(raw), "{what}");
            }
            let mut data = nothing;
            match field.put(&mut data, raw) {
                Ok(()) => assert!(number.allows(raw), "{what}"),
                Err(error) => assert!(!number.allows(raw) && is_error(error), "{what}: {error}"),
            }
            data[first..first + number.bytes].copy_from_slice(&raw.to_le_bytes()[..number.bytes]);
            if number.read(&data[first..]) == raw {
                match (self.decode)(opcode, &data) {
                    Ok(_) => assert!(number.allows(raw), "{what}"),
                    Err(DecodeError::OutOfRange(error)) => {
                        assert!(!number.allows(raw) && is_error(error), "{what}: {error}");
                    }
                    Err(error) => panic!("{what}: {error}"),
                }
            }
        }
    }

    /// A value, its bytes, those of them that are NULL, and what the description finds there.
    fn check_case(&self, value: T, data: Data, nulls: &[usize], found: &[(&str, i64)]) {
        let opcode = (self.opcode)(&value).expect("a kind of the table");
        assert_eq!((self.encode)(&value), data, "{value:?}");
        assert_eq!(self.check_bytes(opcode, data, nulls), value);
        let there = (self.fields)(opcode).iter().filter(|field| field.is_in(&data));
        let described = there.clone().map(|field| (field.key().to_string(), field.raw(&data)));
        let expected = found.iter().map(|&(key, raw)| (key.to_owned(), raw));
        assert_eq!(described.collect::<Vec<_>>(), expected.collect::<Vec<_>>(), "{value:?}");
        let mut made = [opcode.byte().unwrap_or(0), 0, 0, 0, 0, 0, 0, 0];
        for (field, &(_, raw)) in there.zip(found) {
            assert_eq!(field.put(&mut made, raw), Ok(()), "{value:?}: {field:?}");
        }
        // An id that was read has three spellings.
        if !found.contains(&("access", 1)) {
            assert_eq!(made, data, "{value:?}");
        }
    }
}

#[test]
fn every_field_of_every_command_has_its_bytes() {
    COMMANDS.iter().for_each(|table| COMMAND.check_table(table));
}

#[test]
fn every_field_of_every_reply_has_its_bytes() {
    replies().iter().for_each(|table| REPLY.check_table(table));
}

#[test]
fn every_kind_is_covered() {
    // Typed cases below: 2.35, 4 and 5.
    let by_hand = [Opcode::FunctionControl, Opcode::BusId, Opcode::Motion];
    // 2.26.3 and 2.34.3: no reply; 2.32.3: a reply that means nothing.
    let without_reply = [Opcode::Reset, Opcode::SetBaudRate, Opcode::ActiveReply];
    let tables = |tables: Vec<Table>, others: &[Opcode]| {
        let count = tables.len() + others.len();
        let all: BTreeSet<_> = tables.iter().map(|t| t.0).chain(others.iter().copied()).collect();
        assert_eq!(all.len(), count, "a kind has two tables");
        all
    };
    let all: BTreeSet<_> = Opcode::ALL.iter().copied().collect();
    assert_eq!(tables(COMMANDS.to_vec(), &by_hand), all);
    assert_eq!(tables(replies(), &[by_hand, without_reply].concat()), all);
    for opcode in without_reply {
        let data = [opcode.byte().expect("a command byte"), 0, 0, 0, 0, 0, 0, 0];
        assert_eq!(AnyReply::decode_as(opcode, &data), Err(DecodeError::NoReply(opcode)));
        assert!(!opcode.has_reply() && opcode.reply_fields().is_empty());
    }
}

#[test]
fn a_named_field_is_the_bytes_of_its_name() {
    // 2.24.2, 2.34.2, 2.2.2 and 2.14.3.
    let go =
        ForcePosition { max_torque: percent(60), max_speed: up_to(500), angle: degrees(-360.0) };
    assert_eq!(go.encode(), [0xA9, 0x3C, 0xF4, 0x01, 0x60, 0x73, 0xFF, 0xFF]);
    let command = ReportedCommand::of(Opcode::ReadMultiTurnAngle).expect("a report");
    let interval = ReportInterval::from_raw(0x0203);
    let report = ActiveReply { command, enable: Switch::On, interval };
    assert_eq!(report.encode(), [0xB6, 0x92, 1, 3, 2, 0, 0, 0]);
    let write = WritePidRam { index: PidIndex::SPEED_KI, value: gain(f32::from_bits(0x4433_2211)) };
    assert_eq!(write.encode(), [0x31, 5, 0, 0, 0x11, 0x22, 0x33, 0x44]);
    let status = Status1 {
        temperature: Temperature::from_raw(-15),
        mosfet_temperature: Temperature::from_raw(2),
        brake: BrakeCommand::RELEASE,
        voltage: Voltage::from_raw(0x0405),
        errors: ErrorFlags::from_bits_retain(0x8384),
    };
    assert_eq!(status.encode(Opcode::ReadStatus1), [0x9A, 0xF1, 2, 1, 5, 4, 0x84, 0x83]);
}

/// 2.35.2, 2.35.3 and 2.35.4: index and value of each function, in the command and in the reply.
#[test]
fn every_function_has_its_index_and_value() {
    use FunctionControl as F;
    let other = |index, value| F::from_index(index, value).expect("a function without a name");
    let cases: [(F, Data, i64); 13] = [
        (other(0xA5, 0), [0x20, 0xA5, 0, 0, 0, 0, 0, 0], 0),
        (other(0, 0x0403_0201), [0x20, 0, 0, 0, 1, 2, 3, 4], 0x0403_0201),
        (other(8, 0x8182_8384), [0x20, 8, 0, 0, 0x84, 0x83, 0x82, 0x81], 0x8182_8384),
        (F::ClearMultiTurn, [0x20, 1, 0, 0, 0, 0, 0, 0], 0),
        (F::CanIdFilter(Switch::Off), [0x20, 2, 0, 0, 0, 0, 0, 0], 0),
        (F::CanIdFilter(Switch::On), [0x20, 2, 0, 0, 1, 0, 0, 0], 1),
        (F::ErrorReporting(Switch::Off), [0x20, 3, 0, 0, 0, 0, 0, 0], 0),
        (F::ErrorReporting(Switch::On), [0x20, 3, 0, 0, 1, 0, 0, 0], 1),
        (F::SaveMultiTurn(Switch::Off), [0x20, 4, 0, 0, 0, 0, 0, 0], 0),
        (F::SaveMultiTurn(Switch::On), [0x20, 4, 0, 0, 1, 0, 0, 0], 1),
        (F::SetCanId(id(0x1E)), [0x20, 5, 0, 0, 0x1E, 0, 0, 0], 0x1E),
        (F::MaxPositiveAngle(0x0403_0201), [0x20, 6, 0, 0, 1, 2, 3, 4], 0x0403_0201),
        (F::MaxNegativeAngle(-2), [0x20, 7, 0, 0, 0xFE, 0xFF, 0xFF, 0xFF], -2),
    ];
    for (function, data, value) in cases {
        let found = [("index", i64::from(data[1])), ("value", value)];
        // The first function has no value, and does not look at one.
        let (nulls, found) = match function {
            F::ClearMultiTurn => (&[2, 3, 4, 5, 6, 7][..], &found[..1]),
            _ => (&[2, 3][..], &found[..]),
        };
        COMMAND.check_case(function.into(), data, nulls, found);
        REPLY.check_case(AnyReply::FunctionControl(function), data, nulls, found);
    }
}

/// 4.2 to 4.4 and 7.2 to 7.4.
#[test]
fn the_bus_id_lies_where_it_is_told() {
    let written = [("access", 0), ("motor_id", 0x1E)];
    let (write, data) = (BusId::Write(id(0x1E)), [0x79, 0, 0, 0, 0, 0, 0, 0x1E]);
    COMMAND.check_case(write.into(), data, &[1, 3, 4, 5, 6], &written);
    let echo = AnyReply::BusId(BusIdReply::Written(id(0x1E)));
    REPLY.check_case(echo, data, &[1, 3, 4, 5, 6], &written);
    let (read, data) = (BusId::Read, [0x79, 0, 1, 0, 0, 0, 0, 0]);
    COMMAND.check_case(read.into(), data, &[1, 3, 4, 5, 6, 7], &[("access", 1)]);
    // 4.4: the reply identifier; 7.4: the bare id in DATA[7].
    for (told, [low, high], number) in [
        (BusIdReply::OnCan(id(1)), [0x41, 2], 1),
        (BusIdReply::OnCan(id(32)), [0x60, 2], 32),
        (BusIdReply::OnRs485(id(1)), [0, 1], 1),
        (BusIdReply::OnRs485(id(0x1E)), [0, 0x1E], 0x1E),
    ] {
        let found = [("access", 1), ("motor_id", number)];
        let data = [0x79, 0, 1, 0, 0, 0, low, high];
        REPLY.check_case(AnyReply::BusId(told), data, &[1, 3, 4, 5], &found);
    }
    // 7.3's table has the bare id in DATA[6].
    let data = [0x79, 0, 1, 0, 0, 0, 0x1E, 0];
    let told = AnyReply::BusId(BusIdReply::OnRs485(id(0x1E)));
    assert_eq!(AnyReply::decode_as(Opcode::BusId, &data), Ok(told));
}

/// 5.2 and 5.3, the high bits first.
#[test]
fn motion_values_have_their_bits() {
    let keys = ["position_rad", "velocity_rad_s", "kp", "kd", "torque_nm"];
    for (steps, data) in [
        ([0; 5], [0; 8]),
        ([0xF1F2, 0, 0, 0, 0], [0xF1, 0xF2, 0, 0, 0, 0, 0, 0]),
        ([0, 0xABC, 0, 0, 0], [0, 0, 0xAB, 0xC0, 0, 0, 0, 0]),
        ([0, 0, 0xABC, 0, 0], [0, 0, 0, 0x0A, 0xBC, 0, 0, 0]),
        ([0, 0, 0, 0xABC, 0], [0, 0, 0, 0, 0, 0xAB, 0xC0, 0]),
        ([0, 0, 0, 0, 0xABC], [0, 0, 0, 0, 0, 0, 0x0A, 0xBC]),
        ([0x1234, 0x567, 0x89A, 0xBCD, 0xEF0], [0x12, 0x34, 0x56, 0x78, 0x9A, 0xBC, 0xDE, 0xF0]),
    ] {
        let [position, rest @ ..] = steps;
        let [velocity, kp, kd, torque] = rest.map(|step| U12::new(step).expect("12 bits"));
        let raw = RawMotion { position, velocity, kp, kd, torque };
        let found: Vec<_> = keys.into_iter().zip(steps.map(i64::from)).collect();
        COMMAND.check_case(raw.into(), data, &[], &found);
    }
    let keys = ["id_byte", keys[0], keys[1], keys[4]];
    for (steps, data) in [
        ([1, 0, 0, 0], [1, 0, 0, 0, 0, 0, 0, 0]),
        ([0x20, 0, 0, 0], [0x20, 0, 0, 0, 0, 0, 0, 0]),
        ([0, 0xF1F2, 0, 0], [0, 0xF1, 0xF2, 0, 0, 0, 0, 0]),
        ([1, 0, 0xABC, 0], [1, 0, 0, 0xAB, 0xC0, 0, 0, 0]),
        ([1, 0, 0, 0xABC], [1, 0, 0, 0, 0x0A, 0xBC, 0, 0]),
        ([2, 0x3456, 0x789, 0xABC], [2, 0x34, 0x56, 0x78, 0x9A, 0xBC, 0, 0]),
    ] {
        let [id_byte, position, velocity, torque] = steps;
        let [velocity, torque] = [velocity, torque].map(|step| U12::new(step).expect("12 bits"));
        let raw = RawMotionFeedback { id_byte: id_byte as u8, position, velocity, torque };
        let found: Vec<_> = keys.into_iter().zip(steps.map(i64::from)).collect();
        REPLY.check_case(AnyReply::Motion(raw), data, &[6, 7], &found);
    }
}

#[test]
fn what_depends_on_another_field_is_refused_too() {
    let refused = |opcode, data, given: f64| {
        let error = AnyCommand::decode_as(opcode, &data).expect_err("out of range");
        let reply = AnyReply::decode_as(opcode, &data).expect_err("out of range");
        assert_eq!(error, reply, "{data:02X?}");
        let DecodeError::OutOfRange(error) = error else { panic!("{data:02X?}: {error}") };
        assert_eq!(error.given.value(), given, "{data:02X?}");
    };
    // 2.35.4: 0 or 1.
    for function in [2, 3, 4] {
        refused(Opcode::FunctionControl, [0x20, function, 0, 0, 2, 0, 0, 0], 2.0);
        refused(Opcode::FunctionControl, [0x20, function, 0, 0, 1, 0, 0, 1], 16_777_217.0);
    }
    // 4.1, 7.1 and 2.35.4: an id is 1 to 32, the flag 0 or 1.
    for bad in [0, 33, 0xFF] {
        refused(Opcode::BusId, [0x79, 0, 0, 0, 0, 0, 0, bad], bad.into());
        refused(Opcode::FunctionControl, [0x20, 5, 0, 0, bad, 0, 0, 0], bad.into());
    }
    refused(Opcode::FunctionControl, [0x20, 5, 0, 0, 1, 1, 0, 0], 257.0);
    refused(Opcode::FunctionControl, [0x20, 5, 0, 0, 0xE8, 3, 0, 0], 1_000.0);
    refused(Opcode::BusId, [0x79, 0, 2, 0, 0, 0, 0, 1], 2.0);
    // 4.3 and 7.3: neither a reply identifier nor a bare id.
    for (low, high) in [(0, 0), (0x40, 2), (0x61, 2), (0x41, 1), (33, 0), (0, 33), (1, 1)] {
        let told = AnyReply::decode_as(Opcode::BusId, &[0x79, 0, 1, 0, 0, 0, low, high]);
        assert_eq!(told, Err(DecodeError::NotABusId(u16::from_le_bytes([low, high]))));
    }
}

#[test]
fn a_function_without_a_name_is_none_with_a_name() {
    for index in 0..=255 {
        let is_named = (1..=7).contains(&index);
        for value in [0, 1, 2, 32, 33, 0x8182_8384] {
            let allowed = match index {
                2..=4 => value <= 1,
                5 => (1..=32).contains(&value),
                _ => true,
            };
            let function = FunctionControl::from_index(index, value);
            assert_eq!(function.is_ok(), allowed, "{index} {value}");
            if let Ok(function) = function {
                let value = if index == 1 { 0 } else { value };
                assert_eq!((function.index(), function.value()), (index, value));
                assert_eq!(matches!(function, FunctionControl::Other(_)), !is_named, "{index}");
            }
            assert_eq!(OtherFunction::try_from((index, value)).is_ok(), !is_named, "{index}");
            let json = from_str::<FunctionControl>(&format!(r#"{{"other":[{index},{value}]}}"#));
            assert_eq!(json.ok(), function.ok().filter(|_| !is_named), "{index} {value}");
        }
    }
}

/// Every code that the manual names, with its number and its name here, and no other.
fn check_codes<T>(
    make: fn(u8) -> T,
    raw: fn(T) -> u8,
    name: fn(T) -> Option<&'static str>,
    named: &[(T, u8, &str)],
) where
    T: Copy + PartialEq + Debug + ToString + Serialize + DeserializeOwned,
{
    for byte in 0..=255 {
        let code = make(byte);
        assert_eq!(raw(code), byte, "{code:?}");
        let with_name = named.iter().find(|(_, number, _)| *number == byte);
        assert_eq!(name(code), with_name.map(|&(.., name)| name), "{code:?}");
        for &(other, number, _) in named {
            assert_eq!(code == other, byte == number, "{code:?} and {other:?}");
            assert_eq!(code.to_string() == other.to_string(), byte == number, "{code:?}");
        }
        let json = to_string(&code).expect("JSON");
        assert_eq!(json.starts_with('"'), with_name.is_some(), "{json}");
        for json in [json, byte.to_string()] {
            assert_eq!(from_str::<T>(&json).ok(), Some(code), "{json}");
        }
    }
    assert!(from_str::<T>("256").is_err() && from_str::<T>(r#""no-such-code""#).is_err());
}

macro_rules! check_codes {
    ($type:ident: $($code:ident $raw:literal $name:literal),+) => {
        check_codes($type::from_raw, $type::raw, $type::name, &[$(($type::$code, $raw, $name)),+]);
        assert_eq!($type::ALL, [$($type::$code),+]);
    };
}

#[test]
fn codes_are_the_manuals() {
    // 2.1.4
    check_codes!(PidIndex: CURRENT_KP 1 "current-kp", CURRENT_KI 2 "current-ki",
        SPEED_KP 4 "speed-kp", SPEED_KI 5 "speed-ki", POSITION_KP 7 "position-kp",
        POSITION_KI 8 "position-ki", POSITION_KD 9 "position-kd");
    // 2.4.4
    check_codes!(AccelerationIndex: POSITION_ACCELERATION 0 "position-acceleration",
        POSITION_DECELERATION 1 "position-deceleration",
        SPEED_ACCELERATION 2 "speed-acceleration", SPEED_DECELERATION 3 "speed-deceleration");
    // 2.14.3
    check_codes!(BrakeCommand: LOCK 0 "lock", RELEASE 1 "release");
    // 2.22.1
    check_codes!(Direction: CLOCKWISE 0 "clockwise", COUNTER_CLOCKWISE 1 "counter-clockwise");
    // 2.25.3
    check_codes!(Mode: CURRENT 1 "current", SPEED 2 "speed", POSITION 3 "position");
    // 2.32.4
    check_codes!(BaudCode: CAN_500K_RS485_115200 0 "can-500k-rs485-115200",
        CAN_1M_RS485_500K 1 "can-1m-rs485-500k", RS485_1M 2 "rs485-1m");
    // 2.35.4
    check_codes!(FunctionIndex: CLEAR_MULTI_TURN 1 "clear-multi-turn",
        CAN_ID_FILTER 2 "can-id-filter", ERROR_REPORTING 3 "error-reporting",
        SAVE_MULTI_TURN 4 "save-multi-turn", SET_CAN_ID 5 "set-can-id",
        MAX_POSITIVE_ANGLE 6 "max-positive-angle", MAX_NEGATIVE_ANGLE 7 "max-negative-angle");
    // 4.1
    check_codes!(Access: WRITE 0 "write", READ 1 "read");
    // 2.34.2, which names 0x9E too and describes no such command.
    let report = |opcode| ReportedCommand::of(opcode).expect("a report");
    check_codes(
        ReportedCommand::from_raw,
        ReportedCommand::raw,
        ReportedCommand::name,
        &[
            (report(Opcode::ReadMultiTurnEncoder), 0x60, "read-multi-turn-encoder"),
            (report(Opcode::ReadMultiTurnEncoderRaw), 0x61, "read-multi-turn-encoder-raw"),
            (report(Opcode::ReadMultiTurnEncoderOffset), 0x62, "read-multi-turn-encoder-offset"),
            (report(Opcode::ReadMultiTurnAngle), 0x92, "read-multi-turn-angle"),
            (report(Opcode::ReadStatus1), 0x9A, "read-status1"),
            (report(Opcode::ReadStatus2), 0x9C, "read-status2"),
            (report(Opcode::ReadStatus3), 0x9D, "read-status3"),
        ],
    );
}

#[test]
fn bit_rates_are_those_of_2_32_4() {
    let rates = [0, 1, 2, 3].map(|raw| {
        let code = BaudCode::from_raw(raw);
        (code.can_bits_per_second(), code.rs485_bits_per_second())
    });
    assert_eq!(
        rates,
        [
            (Some(500_000), Some(115_200)),
            (Some(1_000_000), Some(500_000)),
            (None, Some(1_000_000)),
            (None, None),
        ]
    );
}

#[test]
fn error_flags_and_levels_are_those_of_2_14_3_and_8_2() {
    use ErrorLevel::{One, Two};
    let manual = [
        (0x0002, ErrorFlags::STALL, Some(One)),
        (0x0004, ErrorFlags::UNDER_VOLTAGE, Some(Two)),
        (0x0008, ErrorFlags::OVER_VOLTAGE, Some(Two)),
        (0x0010, ErrorFlags::OVER_CURRENT, Some(One)),
        (0x0040, ErrorFlags::OVER_POWER, Some(Two)),
        (0x0080, ErrorFlags::CALIBRATION_PARAMETERS, Some(One)),
        (0x0100, ErrorFlags::OVER_SPEED, Some(Two)),
        (0x0800, ErrorFlags::COMPONENT_OVER_TEMPERATURE, None),
        (0x1000, ErrorFlags::MOTOR_OVER_TEMPERATURE, Some(Two)),
        (0x2000, ErrorFlags::ENCODER_CALIBRATION, Some(Two)),
        (0x4000, ErrorFlags::ENCODER_DATA, None),
    ];
    for (bits, flag, level) in manual {
        assert_eq!((flag.bits(), flag.level()), (bits, level), "{flag}");
        assert!(flag.name().is_some() && flag.description().is_some());
        // Only what recovers by itself needs no restart.
        assert_eq!(flag.needs_restart(), level != Some(Two), "{flag}");
    }
    assert_eq!(ErrorFlags::NAMED, manual.map(|(_, flag, _)| flag));
}

#[test]
fn steps_have_the_size_that_the_manual_gives() {
    assert_eq!(Temperature::from_raw(-40).celsius(), -40.0); // 1 °C, 2.14.3
    assert_eq!(Voltage::from_raw(485).volts(), 48.5); // 0.1 V, 2.14.3
    assert_eq!(Current::from_raw(-125).amperes(), -1.25); // 0.01 A, 2.15.3
    assert_eq!(CoarseSpeed::from_raw(-500).dps(), -500.0); // 1 dps, 2.15.3
    assert_eq!(CoarseAngle::from_raw(-45).degrees(), -45.0); // 1 degree, 2.15.3
    assert_eq!(Angle::from_raw(-36_025).degrees(), -360.25); // 0.01 degree, 2.12.3
    assert_eq!(ReportedSingleTurnAngle::from_raw(35_950).degrees(), 359.5); // 0.01 degree, 2.13.3
    assert_eq!(SingleTurnTarget::MAX.degrees(), 360.0); // 0.01 degree, 2.22.1
    assert_eq!(SpeedTarget::from_raw(-150).dps(), -1.5); // 0.01 dps, 2.20.1
    assert_eq!(MaxSpeed::from_raw(500).dps(), 500.0); // 1 dps, 2.21.1
    assert_eq!(MaxTorque::from_raw(60).percent(), 60.0); // 1 % of rated current, 2.20.1
    assert_eq!(Acceleration::MAX.dps2(), 60_000.0); // 1 dps/s, 2.5.1
    assert_eq!(ReportedAcceleration::from_raw(7).dps2(), 7.0); // 1 dps/s, 2.4.3
    assert_eq!(ReportInterval::from_raw(3).millis(), 30.0); // 10 ms, 2.34.2
}
