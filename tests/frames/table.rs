//! Proves that the table of opcodes, the types and the manual agree. Each kind is unique and has:
//!
//! - an example in the manual, unless `kinds.txt` says that there is none;
//! - a section that exists and names its command byte;
//! - the reply rule that the examples show;
//! - the buses on which the examples show it.

use std::collections::{BTreeSet, HashMap};

use myactuator_protocol_core::opcode::{Buses, ReplyRule, UnknownOpcode};
use myactuator_protocol_core::wire::{can, rs485};
use myactuator_protocol_core::{
    AnyCommand, Channel, Firmware, Kind, MotorId, Opcode, RequestError, Target,
};
use myactuator_tests::vectors::{Bus, Direction, Entry, Row, entries, rows, sections};

/// Whether the manual prints no example of the kind.
fn is_without_example(kind: Opcode) -> bool {
    entries("kind").any(|entry| entry.opcode == kind && entry.rest.contains("no-example"))
}

fn of_firmware(firmware: Firmware) -> impl Iterator<Item = Opcode> {
    Opcode::ALL.iter().copied().filter(move |opcode| opcode.is_in(firmware))
}

/// The rows of the kind.
fn of(opcode: Opcode, rows: &[Row]) -> Vec<&Row> {
    rows.iter().filter(|row| row.opcode == opcode).collect()
}

/// Each reply with the command of its example. (One command to all has several.)
fn exchanges(rows: &[Row]) -> Vec<(&Row, &Row)> {
    let key = |row: &Row| (row.section.clone(), row.example, row.bus);
    let commands: HashMap<_, _> =
        rows.iter().filter(|r| r.direction == Direction::Command).map(|r| (key(r), r)).collect();
    rows.iter()
        .filter(|row| row.direction == Direction::Reply)
        .map(|reply| (commands[&key(reply)], reply))
        .collect()
}

#[test]
fn bytes_and_names_are_unique() {
    let kinds: BTreeSet<Opcode> = Opcode::ALL.iter().copied().collect();
    let names: BTreeSet<&str> = Opcode::ALL.iter().map(|opcode| opcode.name()).collect();
    assert_eq!((kinds.len(), names.len()), (Opcode::ALL.len(), Opcode::ALL.len()));
    for &opcode in Opcode::ALL {
        let kebab = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || "-.".contains(c);
        assert!(opcode.name().chars().all(kebab), "{opcode}");
        assert_eq!(opcode.name().parse(), Ok(opcode));
    }
    assert_eq!("read".parse::<Opcode>(), Err(UnknownOpcode));
    for &firmware in Firmware::ALL {
        for byte in 0..=255 {
            let mut known = of_firmware(firmware).filter(|opcode| opcode.byte() == Some(byte));
            assert_eq!(Opcode::of_firmware(firmware, byte), known.next(), "{firmware}: {byte:#X}");
            assert_eq!(known.next(), None, "{firmware}: {byte:#X} has two kinds");
        }
    }
    for byte in 0..=255 {
        let oldest = Firmware::ALL.iter().find_map(|&f| Opcode::of_firmware(f, byte));
        assert_eq!(Opcode::from_byte(byte), oldest, "{byte:#X}");
        assert_eq!(Opcode::try_from(byte), oldest.ok_or(UnknownOpcode), "{byte:#X}");
    }
}

#[test]
fn the_kinds_are_those_of_the_manual() {
    for &opcode in Opcode::ALL {
        let lines = entries("kind").filter(|entry| entry.opcode == opcode);
        assert_eq!(lines.count(), 1, "lines in kinds.txt for {opcode}");
    }
    // Every command byte in a heading of the manual: two digits in parentheses. 4 and 7 are the same command.
    let named: BTreeSet<u8> = sections()
        .values()
        .filter_map(|heading| heading.split_once("(0x")?.1.strip_suffix(')'))
        .filter(|digits| digits.len() == 2)
        .map(|digits| u8::from_str_radix(digits, 16).expect("two hexadecimal digits"))
        .collect();
    let known = Opcode::ALL.iter().copied();
    assert_eq!(known.clone().filter_map(Opcode::byte).collect::<BTreeSet<_>>(), named);
    assert!(known.filter(|opcode| opcode.byte().is_none()).eq([Opcode::Motion]));
}

/// What `kinds.txt` must say of a kind: how it is answered, and where it differs from most kinds.
fn facts(opcode: Opcode) -> Vec<String> {
    let mut facts = vec![format!("{:?}", opcode.reply_rule())];
    facts.extend(opcode.key_byte().map(|place| format!("key-{place}")));
    let (repeat, buses) = (format!("{:?}", opcode.repeat()), format!("{:?}", opcode.buses()));
    let (reach, usage) = (format!("{:?}", opcode.reach()), format!("{:?}", opcode.usage()));
    let is_usual = |fact: &String| ["Harmless", "Both", "OneOrAll", "Plain"].contains(&&**fact);
    facts.extend([repeat, buses, reach, usage].into_iter().filter(|fact| !is_usual(fact)));
    let having: Vec<_> = Firmware::ALL.iter().filter(|&&f| opcode.is_in(f)).collect();
    if having.len() < Firmware::ALL.len() {
        facts.extend(having.iter().map(|firmware| format!("only-{firmware}")));
    }
    facts
}

#[test]
fn facts_of_a_kind_are_the_manuals() {
    for Entry { section, opcode, rest } in entries("kind") {
        let of_tests = ["no-layout", "no-example"];
        let typed = rest.split(' ').filter(|fact| !of_tests.contains(fact));
        assert_eq!(typed.collect::<Vec<_>>(), facts(opcode), "{opcode}");
        assert_eq!(section, opcode.section(), "{opcode}");
        let named = match opcode.byte() {
            Some(byte) => format!("(0x{byte:02X})"),
            None => "(0x400 + ID)".to_owned(),
        };
        assert!(sections()[section].ends_with(&named), "{opcode}: {}", sections()[section]);
    }
}

#[test]
fn each_row_stands_in_a_section_of_its_kind() {
    let sections = sections();
    for row in rows() {
        let opcode = row.opcode;
        assert!(sections.contains_key(row.section.as_str()), "{row}");
        assert!(sections[row.section.as_str()].starts_with("Examples"), "{row}");
        let chapter = row.section.rsplit_once('.').expect("a section of a chapter").0;
        match chapter {
            // The broadcasts show commands of other sections.
            "3" | "6" => {
                assert_eq!(row.target() == Target::All, row.direction == Direction::Command)
            }
            // The bus id has a chapter for each bus.
            "7" => assert_eq!(opcode, Opcode::BusId),
            _ => assert_eq!(chapter, opcode.section(), "{row}"),
        }
        if let Some(byte) = opcode.byte() {
            assert_eq!(row.data()[0], byte, "{row}");
        }
    }
}

#[test]
fn the_reply_rules_are_those_that_the_examples_show() {
    let rows = rows();
    let exchanges = exchanges(&rows);
    for opcode in of_firmware(Firmware::V4_3) {
        if is_without_example(opcode) {
            continue;
        }
        let of_kind: Vec<_> =
            exchanges.iter().filter(|(command, _)| command.opcode == opcode).collect();
        let same = of_kind.iter().filter(|(command, reply)| command.data() == reply.data()).count();
        match opcode.reply_rule() {
            ReplyRule::Same => {
                assert!(!of_kind.is_empty(), "{opcode}: no reply in the manual");
                assert_eq!(same, of_kind.len(), "{opcode}: a reply differs from its command");
            }
            ReplyRule::Values => {
                assert!(same < of_kind.len(), "{opcode}: no reply but the command itself");
            }
            // 2.31.4: one reply is the same as its command, the other is not.
            ReplyRule::Acknowledge => assert!(same > 0 && same < of_kind.len(), "{opcode}"),
            ReplyRule::Silent | ReplyRule::Garbled => assert!(of_kind.is_empty(), "{opcode}"),
            other => panic!("{opcode}: {other:?} is not of this manual"),
        }
        assert_eq!(opcode.has_reply(), !of_kind.is_empty(), "{opcode}");
    }
}

#[test]
fn each_reply_answers_its_command_and_none_of_another_kind() {
    let rows = rows();
    let exchanges = exchanges(&rows);
    assert_eq!(exchanges.len(), rows.iter().filter(|r| r.direction == Direction::Reply).count());
    for (command, reply) in &exchanges {
        let opcode = command.opcode;
        let kind = Kind::Known(opcode);
        assert!(kind.answers(&command.data(), &reply.data()), "{command} and {reply}");
        for (_, other) in &exchanges {
            if opcode != Opcode::Motion && other.opcode != opcode {
                assert!(!kind.answers(&command.data(), &other.data()), "{command} and {other}");
            }
        }
        if let Some(key) = opcode.key_byte() {
            let mut other = reply.data();
            other[key] ^= 1;
            assert!(!kind.answers(&command.data(), &other), "{command}: byte {key} is no key");
        }
    }
}

#[test]
fn each_kind_has_an_example_on_its_buses() {
    let rows = rows();
    for opcode in of_firmware(Firmware::V4_3) {
        let examples = of(opcode, &rows);
        assert_eq!(examples.is_empty(), is_without_example(opcode), "{opcode}");
        if !examples.is_empty() {
            let any = |is: fn(&Row) -> bool| examples.iter().any(|row| is(row));
            assert!(any(|row| row.direction == Direction::Command), "{opcode}");
            assert!(any(|row| row.bus == Bus::Can), "{opcode}");
            let on_rs485 = any(|row| row.bus == Bus::Rs485);
            assert_eq!(opcode.buses() == Buses::Both, on_rs485, "{opcode}");
        }
        let refused = Kind::from(opcode).check_on_rs485();
        match opcode.buses() {
            Buses::Both => assert_eq!(refused, Ok(())),
            Buses::CanOnly => assert_eq!(refused, Err(RequestError::CanOnly(opcode))),
        }
    }
}

#[test]
fn channels_are_those_that_the_examples_show() {
    for row in rows().iter().filter(|row| row.direction == Direction::Command) {
        assert_eq!(Kind::from(row.opcode).channel_to(row.target()), Ok(row.channel()), "{row}");
        if row.bus == Bus::Can {
            assert_eq!(can::channel_at(row.can().0), Some(row.channel()), "{row}");
        }
    }
    let one = Target::Motor(MotorId::new(7).expect("1 to 32"));
    for &opcode in Opcode::ALL {
        let (to_one, to_all) =
            (Kind::from(opcode).channel_to(one), Kind::from(opcode).channel_to(Target::All));
        match opcode {
            Opcode::Motion => assert_eq!(to_all, Err(RequestError::OneMotorOnly(opcode))),
            Opcode::BusId => assert_eq!(to_one, Err(RequestError::AllMotorsOnly(opcode))),
            _ => {
                assert_eq!(to_one, Ok(Channel::Command(one)), "{opcode}");
                assert_eq!(to_all, Ok(Channel::Command(Target::All)), "{opcode}");
            }
        }
    }
}

#[test]
fn each_type_has_its_own_row_of_the_table() {
    for &opcode in Opcode::ALL {
        let mut data = [opcode.byte().unwrap_or(0), 0, 0, 0, 0, 0, 0, 0];
        data[7] = u8::from(opcode == Opcode::BusId); // an id that exists
        let command = AnyCommand::decode_as(opcode, &data).expect("a command of zeros");
        assert_eq!((command.opcode(), command.kind()), (Some(opcode), Kind::Known(opcode)));
        // If two types shared a row of the table, it would show here.
        let to_all = command.packet(Target::All);
        let packet = to_all.or_else(|_| command.packet(MotorId::MIN.into())).expect("a packet");
        assert_eq!(packet.data, data, "{opcode}");
        for &firmware in Firmware::ALL {
            let found = AnyCommand::decode(&packet, firmware).map(|found| found.opcode());
            let known = opcode.is_in(firmware).then_some(opcode);
            // The other layout of the byte, where there is one.
            let of_byte = opcode.byte().and_then(|byte| Opcode::of_firmware(firmware, byte));
            assert_eq!(found, Ok(known.or(of_byte)), "{opcode} of {firmware}");
        }
        let on_rs485 = rs485::Frame::from_packet(&packet);
        assert_eq!(on_rs485.is_some(), opcode.buses() == Buses::Both, "{opcode}");
    }
}
