//! Proves that the table of opcodes, the types and the manual agree: each kind is unique, has an
//! example in the manual, a section that exists and names its command byte, the reply rule that the
//! examples show, and the buses that it is shown on.

use std::collections::{BTreeMap, BTreeSet};

use myactuator_protocol_core::command::{LockBrake, ReleaseBrake, Stop};
use myactuator_protocol_core::opcode::{Buses, ReplyRule};
use myactuator_protocol_core::wire::can;
use myactuator_protocol_core::{
    AnyCommand, AnyReply, Channel, Data, MotorId, Opcode, RequestError, Target,
};
use myactuator_tests::line::{Line, frame_bytes};
use myactuator_tests::vectors::{Bus, Direction, Row, rows, sections};

/// The kinds of which the manual prints no example, with the frame that the table of their section
/// gives (2.18.2, 2.27.2, 2.28.2: a command byte and seven NULL; 2.18.3, 2.27.3, 2.28.3: the reply
/// is the same).
fn without_example() -> [(Opcode, AnyCommand, AnyReply, Data); 3] {
    [
        (Opcode::Stop, Stop.into(), AnyReply::Stop(Stop), 0x81),
        (Opcode::ReleaseBrake, ReleaseBrake.into(), AnyReply::ReleaseBrake(ReleaseBrake), 0x77),
        (Opcode::LockBrake, LockBrake.into(), AnyReply::LockBrake(LockBrake), 0x78),
    ]
    .map(|(opcode, command, reply, byte)| (opcode, command, reply, [byte, 0, 0, 0, 0, 0, 0, 0]))
}

/// The rows of the kind.
fn of(opcode: Opcode, rows: &[Row]) -> Vec<&Row> {
    rows.iter().filter(|row| row.name == opcode.name()).collect()
}

/// Each reply with the command of its example. (One command to all has several.)
fn exchanges(rows: &[Row]) -> Vec<(&Row, &Row)> {
    let key = |row: &Row| (row.section.clone(), row.example, row.bus);
    let commands: BTreeMap<_, _> =
        rows.iter().filter(|r| r.direction == Direction::Command).map(|r| (key(r), r)).collect();
    rows.iter()
        .filter(|row| row.direction == Direction::Reply)
        .map(|reply| (commands[&key(reply)], reply))
        .collect()
}

#[test]
fn bytes_and_names_are_unique() {
    let bytes: BTreeSet<u8> = Opcode::ALL.iter().filter_map(|opcode| opcode.byte()).collect();
    assert_eq!(bytes.len(), Opcode::ALL.len() - 1, "all but motion mode have a byte of their own");
    assert_eq!(Opcode::Motion.byte(), None);
    let names: BTreeSet<&str> = Opcode::ALL.iter().map(|opcode| opcode.name()).collect();
    assert_eq!(names.len(), Opcode::ALL.len());
    let kinds: BTreeSet<Opcode> = Opcode::ALL.iter().copied().collect();
    assert_eq!(kinds.len(), Opcode::ALL.len());

    for name in names {
        let kebab = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        assert!(name.chars().all(kebab), "{name}");
        assert_eq!(Opcode::from_name(name).map(Opcode::name), Some(name));
    }
    for byte in 0..=255 {
        assert_eq!(Opcode::from_byte(byte).and_then(Opcode::byte), bytes.get(&byte).copied());
    }
}

#[test]
fn the_kinds_are_those_of_the_manual() {
    // Every command byte that a heading of the manual names, two digits in parentheses; 4 and 7 are
    // the same command.
    let named: BTreeSet<u8> = sections()
        .values()
        .filter_map(|heading| heading.split_once("(0x")?.1.strip_suffix(')'))
        .filter(|digits| digits.len() == 2)
        .map(|digits| u8::from_str_radix(digits, 16).expect("two hexadecimal digits"))
        .collect();
    let table: BTreeSet<u8> = Opcode::ALL.iter().filter_map(|opcode| opcode.byte()).collect();
    assert_eq!(table, named);
    assert_eq!(table.len(), 36);
}

#[test]
fn the_list_of_sections_is_whole() {
    let sections = sections();
    assert_eq!(sections.len(), 210);
    // Each number follows the one before it, and its parent exists.
    for number in sections.keys() {
        let (parent, last) = number.rsplit_once('.').unwrap_or(("", number));
        let last: u32 = last.parse().expect("a number");
        if !parent.is_empty() {
            assert!(sections.contains_key(parent), "{number} has no parent");
        }
        let dot = if parent.is_empty() { "" } else { "." };
        let before = format!("{parent}{dot}{}", last - 1);
        assert!(last == 1 || sections.contains_key(before.as_str()), "{before} is missing");
    }
}

#[test]
fn each_kinds_section_exists_and_names_it() {
    let sections = sections();
    for &opcode in Opcode::ALL {
        let heading = sections.get(opcode.section());
        let heading = heading.unwrap_or_else(|| panic!("{opcode}: no {}", opcode.section()));
        let named = match opcode.byte() {
            Some(byte) => format!("(0x{byte:02X})"),
            None => "(0x400 + ID)".to_owned(),
        };
        assert!(heading.ends_with(&named), "{opcode}: {} is {heading}", opcode.section());
    }
}

#[test]
fn each_row_stands_in_a_section_of_its_kind() {
    let sections = sections();
    for row in rows() {
        let opcode = Opcode::from_name(&row.name).unwrap_or_else(|| panic!("{row}: {}", row.name));
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
fn each_kind_has_an_example() {
    let rows = rows();
    let listed = without_example().map(|(opcode, ..)| opcode);
    for &opcode in Opcode::ALL {
        let examples = of(opcode, &rows);
        assert_eq!(examples.is_empty(), listed.contains(&opcode), "{opcode}");
        if !examples.is_empty() {
            assert!(examples.iter().any(|row| row.direction == Direction::Command), "{opcode}");
        }
    }
}

#[test]
fn kinds_without_an_example_are_as_their_table_says() {
    let id = MotorId::new(1).expect("1 to 32");
    for (opcode, command, reply, data) in without_example() {
        assert_eq!(opcode.reply_rule(), ReplyRule::Echo, "{opcode}");
        assert_eq!((command.opcode(), reply.opcode()), (opcode, opcode));
        assert_eq!((command.encode(), reply.encode()), (data, data), "{opcode}");
        assert_eq!(AnyCommand::decode_as(opcode, &data), Ok(command));
        assert_eq!(AnyReply::decode_as(opcode, &data), Ok(reply));
        let packet = command.packet(Target::Motor(id)).expect("a packet");
        assert_eq!(can::identifier(packet.channel), 0x141, "{opcode}");

        let bytes = frame_bytes(1, data);
        assert_eq!(Line::after(&bytes).frames(), [bytes], "{opcode}");
    }
}

#[test]
fn the_reply_rules_are_those_that_the_examples_show() {
    let rows = rows();
    let exchanges = exchanges(&rows);
    for &opcode in Opcode::ALL {
        if without_example().iter().any(|(listed, ..)| *listed == opcode) {
            continue;
        }
        let of_kind: Vec<_> =
            exchanges.iter().filter(|(command, _)| command.name == opcode.name()).collect();
        let same = of_kind.iter().filter(|(command, reply)| command.data() == reply.data()).count();
        match opcode.reply_rule() {
            ReplyRule::Echo => {
                assert!(!of_kind.is_empty(), "{opcode}: no reply in the manual");
                assert_eq!(same, of_kind.len(), "{opcode}: a reply differs from its command");
            }
            ReplyRule::Values => {
                assert!(same < of_kind.len(), "{opcode}: no reply but the command itself");
            }
            // 2.31.4: one reply is the same as its command, the other is not.
            ReplyRule::Acknowledge => assert!(same > 0 && same < of_kind.len(), "{opcode}"),
            ReplyRule::Silent | ReplyRule::Garbled => assert!(of_kind.is_empty(), "{opcode}"),
        }
        assert_eq!(opcode.has_reply(), !of_kind.is_empty(), "{opcode}");
    }
    let silent = |rule| Opcode::ALL.iter().copied().filter(move |o| o.reply_rule() == rule);
    // 2.26.3 and 2.34.3; 2.32.3; 2.31.3 with 2.31.4.
    assert!(silent(ReplyRule::Silent).eq([Opcode::Reset, Opcode::ActiveReply]));
    assert!(silent(ReplyRule::Garbled).eq([Opcode::SetBaudRate]));
    assert!(silent(ReplyRule::Acknowledge).eq([Opcode::CommunicationLossProtection]));
}

#[test]
fn each_reply_answers_its_command_and_none_of_another_kind() {
    let rows = rows();
    let exchanges = exchanges(&rows);
    assert_eq!(exchanges.len(), rows.iter().filter(|r| r.direction == Direction::Reply).count());
    for (command, reply) in &exchanges {
        let opcode = Opcode::from_name(&command.name).expect("a kind");
        assert!(opcode.answers(&command.data(), &reply.data()), "{command} and {reply}");
        for (_, other) in &exchanges {
            if opcode != Opcode::Motion && other.name != command.name {
                assert!(!opcode.answers(&command.data(), &other.data()), "{command} and {other}");
            }
        }
        if let Some(key) = opcode.key_byte() {
            let mut other = reply.data();
            other[key] ^= 1;
            assert!(!opcode.answers(&command.data(), &other), "{command}: byte {key} is no key");
        }
    }
}

#[test]
fn indexed_kinds_have_their_index_as_key() {
    // DATA[1] is an index in 2.1 to 2.5, 2.34 and 2.35; DATA[2] the flag of 4 and 7.
    let keys: Vec<(Opcode, usize)> =
        Opcode::ALL.iter().filter_map(|&opcode| Some((opcode, opcode.key_byte()?))).collect();
    let expected = [
        (Opcode::FunctionControl, 1),
        (Opcode::ReadPid, 1),
        (Opcode::WritePidRam, 1),
        (Opcode::WritePidRom, 1),
        (Opcode::ReadAcceleration, 1),
        (Opcode::WriteAcceleration, 1),
        (Opcode::BusId, 2),
        (Opcode::ActiveReply, 1),
    ];
    assert_eq!(keys, expected);
}

#[test]
fn buses_are_those_that_the_examples_show() {
    let rows = rows();
    for &opcode in Opcode::ALL {
        let examples = of(opcode, &rows);
        let rs485 = examples.iter().any(|row| row.bus == Bus::Rs485);
        if !examples.is_empty() {
            assert_eq!(opcode.buses() == Buses::Both, rs485, "{opcode}");
            assert!(examples.iter().any(|row| row.bus == Bus::Can), "{opcode}");
        }
        let refused = Kind::from(opcode).check_on_rs485();
        match opcode.buses() {
            Buses::Both => assert_eq!(refused, Ok(())),
            Buses::CanOnly => assert_eq!(refused, Err(RequestError::CanOnly(opcode))),
        }
    }
    // 2.34.1 and the title of 5.
    let can_only = Opcode::ALL.iter().filter(|opcode| opcode.buses() == Buses::CanOnly);
    assert!(can_only.eq(&[Opcode::ActiveReply, Opcode::Motion]));
}

#[test]
fn channels_are_those_that_the_examples_show() {
    for row in rows().iter().filter(|row| row.direction == Direction::Command) {
        let opcode = Opcode::from_name(&row.name).expect("a kind");
        assert_eq!(Kind::from(opcode).channel_to(row.target()), Ok(row.channel()), "{row}");
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
fn a_types_kind_is_the_tables() {
    for &opcode in Opcode::ALL {
        let mut data = [0; 8];
        if let Some(byte) = opcode.byte() {
            data[0] = byte;
        }
        data[7] = u8::from(opcode == Opcode::BusId); // an id that exists
        let command = AnyCommand::decode_as(opcode, &data).expect("a command of zeros");
        assert_eq!(command.opcode(), opcode);
        // A table row that two types shared would show here.
        let to_all = command.packet(Target::All);
        let packet = to_all.or_else(|_| command.packet(MotorId::MIN.into())).expect("a packet");
        assert_eq!(AnyCommand::decode(&packet, Firmware::V4_3), Ok(command));
        assert_eq!(packet.data, data, "{opcode}");
    }
}
