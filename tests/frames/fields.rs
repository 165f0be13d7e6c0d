//! Proves, field by field, that every command and every reply lies on the bus as the manual's
//! layout tables say: distinct bytes land in exactly their field, nothing leaks into its neighbours,
//! NULL bytes are written 0 and not read, and what a field may not hold is refused.
//!
//! The tables below are the manual's (sections 2.x.2 and 2.x.3, 4, 5, 7), typed by hand with the
//! corrections that its misprints need: 2.9.2 prints `>>8` three times, 2.11.3 and 2.13.3 number the
//! formulas one too low, 2.20.2 and 2.24.2 print DATA[2] for maxTorque in DATA[1], and 4.3 and 7.3
//! print DATA[0] for DATA[1..=3].

use std::fmt::Debug;
use std::ops::Range;

use myactuator_protocol_core::command::*;
use myactuator_protocol_core::quantity::{Form, Place};
use myactuator_protocol_core::units::*;
use myactuator_protocol_core::{AnyCommand, AnyReply, Data, DecodeError, Opcode, OutOfRange};
use myactuator_tests::values::{degrees, gain, id, percent, up_to};
use myactuator_tests::vectors::sections;

/// The layout tables of commands: section, command byte, name, and each field with its unit, its first
/// byte, its type and the size of a step. All other bytes are NULL. Not here is what has fields that
/// depend on one another, or share bytes: 2.35, 4, 5 and 7.
const COMMANDS: &str = "
    2.1.2   30  read-pid                        index:1:u8
    2.2.2   31  write-pid-ram                   index:1:u8 value:4:f32
    2.3.2   32  write-pid-rom                   index:1:u8 value:4:f32
    2.4.2   42  read-acceleration               index:1:u8
    2.5.2   43  write-acceleration              index:1:u8 acceleration_dps2:4:acceleration
    2.6.2   60  read-multi-turn-encoder
    2.7.2   61  read-multi-turn-encoder-raw
    2.8.2   62  read-multi-turn-encoder-offset
    2.9.2   63  set-encoder-zero                offset_pulses:4:i32
    2.10.2  64  set-current-position-zero
    2.11.2  90  read-single-turn-encoder
    2.12.2  92  read-multi-turn-angle
    2.13.2  94  read-single-turn-angle
    2.13.2  94  read-single-turn-angle-v4.4
    2.14.2  9A  read-status1
    2.15.2  9C  read-status2
    2.16.2  9D  read-status3
    2.17.2  80  shutdown
    2.18.2  81  stop
    2.19.2  A1  torque                          current_a:4:i16*0.01
    2.20.2  A2  speed                           max_torque_pct:1:u8 speed_dps:4:i32*0.01
    2.21.2  A4  absolute-position               max_speed_dps:2:u16 angle_deg:4:i32*0.01
    2.22.2  A6  single-turn-position            direction:1:u8 max_speed_dps:2:u16 angle_deg:4:turn*0.01
    2.23.2  A8  incremental-position            max_speed_dps:2:u16 angle_deg:4:i32*0.01
    2.24.2  A9  force-position                  max_torque_pct:1:u8 max_speed_dps:2:u16 angle_deg:4:i32*0.01
    2.25.2  70  read-running-mode
    2.26.2  76  reset
    2.27.2  77  release-brake
    2.28.2  78  lock-brake
    2.29.2  B1  read-run-time
    2.30.2  B2  read-version-date
    2.31.2  B3  communication-loss-protection   timeout_ms:4:u32
    2.32.2  B4  set-baud-rate                   baud_rate:7:u8
    2.33.2  B5  read-model
    2.34.2  B6  active-reply                    command:1:u8 enable:2:switch interval_ms:3:u16*10
";

/// The same of replies. 2.13.3 says 0 to 35999, but a drive that reports 36000 is no reason to lose a
/// reading; its other row is the manual's of V4.4.
const REPLIES: &str = "
    2.1.3   30  read-pid                        index:1:u8 value:4:f32
    2.2.3   31  write-pid-ram                   index:1:u8 value:4:f32
    2.3.3   32  write-pid-rom                   index:1:u8 value:4:f32
    2.4.3   42  read-acceleration               index:1:u8 acceleration_dps2:4:u32
    2.5.3   43  write-acceleration              index:1:u8 acceleration_dps2:4:acceleration
    2.6.3   60  read-multi-turn-encoder         position_pulses:4:i32
    2.7.3   61  read-multi-turn-encoder-raw     raw_pulses:4:i32
    2.8.3   62  read-multi-turn-encoder-offset  offset_pulses:4:i32
    2.9.3   63  set-encoder-zero                offset_pulses:4:i32
    2.10.3  64  set-current-position-zero       offset_pulses:4:i32
    2.11.3  90  read-single-turn-encoder        position_pulses:2:u16 raw_pulses:4:u16 offset_pulses:6:u16
    2.12.3  92  read-multi-turn-angle           angle_deg:4:i32*0.01
    2.13.3  94  read-single-turn-angle          angle_deg:6:u16*0.01
    2.13.3  94  read-single-turn-angle-v4.4     angle_deg:4:i32*0.01
    2.14.3  9A  read-status1                    temperature_c:1:i8 mosfet_temperature_c:2:i8 brake:3:u8 voltage_v:4:u16*0.1 errors:6:u16
    2.15.3  9C  read-status2                    temperature_c:1:i8 current_a:2:i16*0.01 speed_dps:4:i16 angle_deg:6:i16
    2.16.3  9D  read-status3                    temperature_c:1:i8 phase_a_current_a:2:i16*0.01 phase_b_current_a:4:i16*0.01 phase_c_current_a:6:i16*0.01
    2.17.3  80  shutdown
    2.18.3  81  stop
    2.19.3  A1  torque                          temperature_c:1:i8 current_a:2:i16*0.01 speed_dps:4:i16 angle_deg:6:i16
    2.20.3  A2  speed                           temperature_c:1:i8 current_a:2:i16*0.01 speed_dps:4:i16 angle_deg:6:i16
    2.21.3  A4  absolute-position               temperature_c:1:i8 current_a:2:i16*0.01 speed_dps:4:i16 angle_deg:6:i16
    2.22.3  A6  single-turn-position            temperature_c:1:i8 current_a:2:i16*0.01 speed_dps:4:i16 encoder_pulses:6:u16
    2.23.3  A8  incremental-position            temperature_c:1:i8 current_a:2:i16*0.01 speed_dps:4:i16 angle_deg:6:i16
    2.24.3  A9  force-position                  temperature_c:1:i8 current_a:2:i16*0.01 speed_dps:4:i16 angle_deg:6:i16
    2.25.3  70  read-running-mode               mode:7:u8
    2.27.3  77  release-brake
    2.28.3  78  lock-brake
    2.29.3  B1  read-run-time                   run_time_ms:4:u32
    2.30.3  B2  read-version-date               version_date:4:u32
    2.31.3  B3  communication-loss-protection   timeout_ms:4:u32
    2.33.3  B5  read-model                      model:1:text
";

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
        // A float with the bits 1 is the smallest that there is.
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

struct Table {
    section: &'static str,
    byte: u8,
    opcode: Opcode,
    rows: Vec<Row>,
}

fn tables(text: &'static str) -> impl Iterator<Item = Table> {
    text.trim().lines().map(|line| {
        let mut words = line.split_whitespace();
        let [section, byte, name] = std::array::from_fn(|_| words.next().expect(line));
        let byte = u8::from_str_radix(byte, 16).expect(line);
        let opcode = name.parse().expect(line);
        Table { section, byte, opcode, rows: words.map(Row::new).collect() }
    })
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
            let mut other = data;
            other[0] = !byte;
            let error = DecodeError::WrongOpcode { expected: opcode, found: !byte };
            assert_eq!((self.decode)(opcode, &other), Err(error), "{what}");
        }
        value
    }

    fn check_table(&self, table: &Table) {
        let &Table { section, byte, opcode, ref rows } = table;
        assert_eq!((opcode.byte(), sections()[section]), (Some(byte), self.heading), "{opcode}");
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
        // Low bytes and such with the sign's bit, in each field by itself and in all together.
        for salt in [0x10, 0x80] {
            let pattern = std::array::from_fn(|place| salt + place as u8);
            let mut together = (nothing, nothing);
            for (field, row) in fields.iter().zip(rows) {
                // What is too large for this field is its largest.
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
        for (field, row) in fields.iter().zip(rows) {
            self.check_range(opcode, nothing, field, row);
        }
    }

    /// Both ends of what a field may hold are allowed, their neighbours refused.
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
    tables(COMMANDS).for_each(|table| COMMAND.check_table(&table));
}

#[test]
fn every_field_of_every_reply_has_its_bytes() {
    tables(REPLIES).for_each(|table| REPLY.check_table(&table));
}

#[test]
fn every_kind_is_covered() {
    // Typed cases below: 2.35, 4 and 5.
    let by_hand = [Opcode::FunctionControl, Opcode::BusId, Opcode::Motion];
    // 2.26.3 and 2.34.3: no reply; 2.32.3: a reply that means nothing.
    let without_reply = [Opcode::Reset, Opcode::SetBaudRate, Opcode::ActiveReply];
    for (text, others) in
        [(COMMANDS, by_hand.to_vec()), (REPLIES, [by_hand, without_reply].concat())]
    {
        let mut kinds: Vec<_> = tables(text).map(|table| table.opcode).chain(others).collect();
        kinds.sort();
        assert_eq!(kinds, Opcode::ALL, "each has one table");
    }
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
