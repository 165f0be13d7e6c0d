//! Proves, on both buses, that every example frame of the manual decodes to what the text beside it says and encodes
//! back to the same bytes. The rows and their misprints are in `vectors/`.
//!
//! In every example the NULL bytes are 0, so there are no exceptions.

use std::collections::BTreeMap;

use embedded_can::{Frame as _, Id, StandardId};
use myactuator_host_std::explain::values;
use myactuator_protocol_core::command::MotionRanges;
use myactuator_protocol_core::quantity::Form;
use myactuator_protocol_core::wire::{can, rs485};
use myactuator_protocol_core::{AnyCommand, AnyReply, Firmware, Opcode, Packet};
use myactuator_tests::vectors::{Bus, Direction, Row, rows};
use serde_json::Value;

/// Compares numbers by value: whole ones exactly, others to 1e-5, which is what an `f32` keeps of a motion scale 90
/// rad/s wide.
fn agree(expected: &Value, found: &Value) -> bool {
    match (expected, found) {
        (Value::Number(expected), Value::Number(found)) => {
            let (Some(a), Some(b)) = (expected.as_f64(), found.as_f64()) else { return false };
            if expected.is_f64() { (a - b).abs() <= 1e-5 * a.abs().max(1.0) } else { a == b }
        }
        _ => expected == found,
    }
}

/// Checks that a row's packet means what the manual says, and that its value encodes to these bytes and prints.
fn check(row: &Row, packet: &Packet) {
    assert_eq!(*packet, Packet { channel: row.channel(), data: row.data() }, "{row}");
    let opcode = row.opcode;
    let (found, again, fields, text) = match row.direction {
        Direction::Command => {
            let command = AnyCommand::decode(packet, Firmware::V4_3);
            let command = command.unwrap_or_else(|error| panic!("{row}: {error}"));
            assert_eq!(command.packet(row.target()), Ok(*packet), "{row}");
            let text = command.to_string();
            (command.opcode(), command.encode(), opcode.command_fields(), text)
        }
        Direction::Reply => {
            let reply = AnyReply::decode(packet, Firmware::V4_3);
            let reply = reply.unwrap_or_else(|error| panic!("{row}: {error}"));
            (reply.opcode(), reply.encode(), opcode.reply_fields(), reply.to_string())
        }
    };
    assert_eq!((found, again), (Some(opcode), packet.data), "{row}");

    let found = values(fields, &packet.data, Some(&MotionRanges::V4_3));
    for (key, expected) in &row.fields {
        let value = found.get(key).unwrap_or_else(|| panic!("{row}: no {key} in {found:?}"));
        assert!(agree(expected, value), "{row}: {key} is {expected}, found {value}");
    }
    // A code, a flag set and a motion value have two forms each. The row has at least one of them.
    let there: Vec<_> = fields.iter().filter(|field| field.is_in(&packet.data)).collect();
    for key in found.keys() {
        let told = |key: &String| row.fields.contains_key(key);
        let forms =
            there.iter().map(|field| [field.key().to_string(), format!("{}_raw", field.name)]);
        let mut forms = forms.filter(|forms| forms.contains(key));
        assert!(told(key) || forms.any(|forms| forms.iter().any(told)), "{row}: {key} is not told");
    }

    assert!(text.starts_with(&opcode.to_string()), "{row}: {text}");
    let packet = packet.as_of(Firmware::V4_3);
    assert!(packet.to_string().ends_with(&text), "{row}: {packet}");
    for field in there.iter().filter(|field| !matches!(field.quantity.form, Form::Flags(_))) {
        assert!(text.contains(&field.name.replace('_', " ")), "{row}: no {} in {text}", field.name);
    }
}

#[test]
fn all_examples_of_the_manual_are_in_the_vectors() {
    let count = |bus| rows().iter().filter(|row| row.bus == bus).count();
    assert_eq!((count(Bus::Can), count(Bus::Rs485)), (101, 98));
    let motion = rows().into_iter().filter(|row| row.opcode == Opcode::Motion);
    assert_eq!(motion.map(|row| row.bus).collect::<Vec<_>>(), [Bus::Can; 2]);
}

#[test]
fn can_rows_decode_to_their_meaning_and_encode_to_their_bytes() {
    for row in rows().iter().filter(|row| row.bus == Bus::Can) {
        let (identifier, data) = row.can();
        let id = StandardId::new(identifier).expect("11 bits");
        let frame = can::SimpleFrame::new(id, &data).expect("eight bytes");
        let can::Received::Packet(packet) = can::decode(&frame) else {
            panic!("{row}: {:?}", can::decode(&frame))
        };
        check(row, &packet);
        for again in [can::encode(&packet), Some(can::SimpleFrame::from_packet(&packet))] {
            let again: can::SimpleFrame = again.expect("a frame");
            assert_eq!((again.id(), again.data()), (Id::Standard(id), &data[..]), "{row}");
            assert!(!again.is_remote_frame());
        }
    }
}

#[test]
fn rs485_rows_decode_to_their_meaning_and_encode_to_their_bytes() {
    for row in rows().iter().filter(|row| row.bus == Bus::Rs485) {
        let bytes = row.rs485();
        let mut receiver = rs485::Receiver::new();
        let fed = bytes.map(|byte| receiver.feed(byte));
        assert!(fed[..12].iter().all(|fed| *fed == rs485::Fed::Wanting), "{row}: {fed:?}");
        let rs485::Fed::Frame(frame) = fed[12] else { panic!("{row}: {:?}", fed[12]) };
        assert_eq!(rs485::Frame::decode(&bytes), Ok(frame), "{row}");
        let packet = match row.direction {
            Direction::Command => frame.as_command(),
            Direction::Reply => frame.as_reply().expect("a reply"),
        };
        check(row, &packet);
        let again = rs485::Frame::from_packet(&packet).expect("a frame");
        assert_eq!(again.encode(), bytes, "{row}");
    }
}

#[test]
fn the_two_buses_have_the_same_examples() {
    let rows = rows();
    let twin_section = |section: &str| match section {
        "3.2" => "6.2".to_owned(),
        "4.4" => "7.4".to_owned(),
        same => same.to_owned(),
    };
    let key =
        |row: &Row| (twin_section(&row.section), row.example, row.direction, row.id.to_string());
    let mut alone = Vec::new();
    for can in rows.iter().filter(|row| row.bus == Bus::Can) {
        let twins: Vec<_> =
            rows.iter().filter(|row| row.bus == Bus::Rs485 && key(row) == key(can)).collect();
        let [twin] = twins[..] else {
            assert!(twins.is_empty(), "{can}: several RS485 rows");
            alone.push(can.section.as_str());
            continue;
        };
        assert_eq!((can.opcode, &can.fields), (twin.opcode, &twin.fields), "{can} and {twin}");
        // 4.4 has the id as a reply identifier, 7.4 as the bare number.
        let told_apart = can.section == "4.4"
            && can.direction == Direction::Reply
            && can.fields["access_raw"] == 1;
        assert_eq!(can.data() == twin.data(), !told_apart, "{can} and {twin}");
        if can.section == twin.section {
            assert_eq!(can.text, twin.text, "{can}");
            assert_eq!(can.misprint, twin.misprint, "{can}");
        }
    }
    assert_eq!(alone, ["2.34.4", "5.4", "5.4"], "CAN rows without an RS485 row");
}

/// The number of rows of each section in which the manual contradicts itself. `vectors/README.md` says how each is
/// read.
#[test]
fn the_misprints_are_the_listed_ones() {
    let rows = rows();
    let mut found = BTreeMap::new();
    for row in rows.iter().filter(|row| row.misprint.is_some()) {
        *found.entry(row.section.as_str()).or_insert(0) += 1;
    }
    let on_both = [("2.15.4", 2), ("2.22.4", 4), ("2.31.4", 2), ("2.35.5", 2)];
    let on_one = [("3.2", 2), ("4.4", 2), ("5.4", 2), ("6.2", 3), ("7.4", 2)];
    assert_eq!(found, on_both.into_iter().chain(on_one).collect());
}
