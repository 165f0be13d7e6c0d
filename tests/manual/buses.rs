//! 1, 3, 4, 6, 7: which drives hear a command, and on which channel they answer.

use myactuator_protocol_core::command::*;
use myactuator_protocol_core::drive::{Bus, Event, IgnoreReason, Parameters};
use myactuator_protocol_core::opcode::ReplyRule;
use myactuator_protocol_core::wire::rs485;
use myactuator_protocol_core::{AnyReply, Channel, Kind, Opcode, Packet, Target};
use myactuator_tests::bench::*;
use myactuator_tests::values::*;
use myactuator_tests::vectors::one_of_each;

use super::commands::report;

/// 2 to 7: each kind is answered as its row in the table says.
#[test]
fn every_kind_is_answered_by_its_rule() {
    for command in one_of_each() {
        let opcode = command.opcode().unwrap();
        let reply = Bench::default().send(command);
        let is_same = reply == Some(command.encode());
        let is_answer = reply.is_some_and(|reply| {
            Kind::Known(opcode).answers(&command.encode(), &reply)
                && AnyReply::decode_as(opcode, &reply).is_ok()
        });
        let is_right = match opcode.reply_rule() {
            ReplyRule::Same | ReplyRule::Acknowledge => is_same,
            ReplyRule::Values => is_answer,
            ReplyRule::Silent => reply.is_none(),
            ReplyRule::Garbled => !is_same,
            other => panic!("{opcode}: {other:?}"),
        };
        assert!(is_right, "{opcode}: {reply:02X?}");
    }
}

/// 1.1.2, 4.4, 5.3: replies come at 0x240 + ID, those to 0x300 at 0x300, those to 0x400 + ID at
/// 0x500 + ID.
#[test]
fn replies_come_on_their_channels() {
    let mut bench = Bench::default();
    let mut channel = |channel, data| bench.exchange(channel, data)[0].channel;
    let command = Channel::Command(ID.into());
    assert_eq!(channel(command, ReadStatus2.encode()), Channel::Reply(ID));
    assert_eq!(channel(Channel::Command(Target::All), ReadStatus2.encode()), Channel::Reply(ID));
    assert_eq!(channel(Channel::BusId, BusId::Read.encode()), Channel::BusId);
    assert_eq!(channel(Channel::Motion(ID), [0x80; 8]), Channel::MotionReply(ID));
}

/// 1.1.2: a command at another drive's identifier changes nothing, nor does another drive's reply.
#[test]
fn frames_for_other_drives_are_ignored() {
    let mut bench = Bench::default();
    for channel in [
        Channel::Command(Target::Motor(id(2))),
        Channel::Motion(id(2)),
        Channel::Reply(ID),
        Channel::MotionReply(ID),
    ] {
        assert_eq!(bench.exchange(channel, [0xA2, 0, 0, 0, 0x10, 0x27, 0, 0]), []);
    }
    assert!(!bench.state().output_on);
    assert_eq!(bench.events, [Event::Started]);
}

/// 3.2, 6.2: all drives obey a command to all, and each replies under its own id.
#[test]
fn a_command_to_all_is_obeyed_and_answered_by_each() {
    for bus in [Bus::Can, Bus::Rs485] {
        for motor in (1..=4).map(id) {
            let mut bench = Bench::new(Parameters { id: motor, bus, ..Parameters::default() });
            let packets = bench.exchange(Channel::Command(Target::All), Shutdown.encode());
            let channel = Channel::Reply(motor);
            assert_eq!(packets, [Packet { channel, data: Shutdown.encode() }]);
        }
    }
}

/// 4.4, 7.4: 0x79 reads the id (on CAN as a reply identifier, on RS485 bare) and sets it.
#[test]
fn the_bus_id_is_read_and_set() {
    for (bus, reported) in [(Bus::Can, [0x42, 0x02]), (Bus::Rs485, [0, 2])] {
        let mut bench = Bench::new(Parameters { bus, ..Parameters::default() });
        assert_eq!(bench.send(BusId::Write(id(2))), Some(BusId::Write(id(2)).encode()));
        let before = bench.exchange(Channel::BusId, BusId::Read.encode())[0].data;
        assert_eq!(BusId::decode_reply(&before).unwrap().id(), ID, "not before a restart");
        bench.restart();
        let replies = bench.exchange(Channel::BusId, BusId::Read.encode());
        let data = [0x79, 0, 1, 0, 0, 0, reported[0], reported[1]];
        assert_eq!(replies, [Packet { channel: Channel::BusId, data }]);
        let line = rs485::Frame::from_packet(&replies[0]).unwrap();
        assert_eq!(line.address, Target::All);
    }
}

/// 4.1, 7.1: all connected drives take a new id. Their replies look like commands, but no drive answers them.
#[test]
fn several_drives_take_the_same_id_and_do_not_answer_each_other() {
    for bus in [Bus::Can, Bus::Rs485] {
        let with_id = |n| Bench::new(Parameters { id: id(n), bus, ..Parameters::default() });
        let mut motors = [1, 2].map(with_id);
        for data in [BusId::Read.encode(), BusId::Write(id(5)).encode()] {
            let mut line = vec![data];
            let mut packets = 0;
            while let Some(data) = line.pop() {
                packets += 1;
                assert!(packets <= 3, "they answer each other");
                for bench in &mut motors {
                    let replies = bench.exchange(Channel::BusId, data);
                    line.extend(replies.iter().map(|reply| reply.data));
                }
            }
            assert_eq!(packets, 3);
        }
        for bench in &motors {
            assert_eq!(bench.drive.stored_settings().id, id(5));
        }
    }
}

/// 2.34.1: active replies exist on CAN only. 5: so does motion mode.
#[test]
fn active_reply_and_motion_are_not_on_rs485() {
    let mut bench = Bench::on_rs485();
    bench.send(report(Opcode::ReadStatus2, Switch::On, 1));
    bench.send(RawMotion::decode(&[0x80; 8]));
    bench.run(millis(100));
    assert!(bench.sent.is_empty());
    let can_only = |opcode| move |event: &Event| matches!(event, Event::Ignored { reason: IgnoreReason::CanOnly(o), .. } if *o == opcode);
    assert!(bench.events.iter().any(can_only(Opcode::ActiveReply)));
    assert!(bench.events.iter().any(can_only(Opcode::Motion)));
}

/// 1.1.1: CAN runs at 1 Mbit/s, and code 1 (2.32.4) is that rate.
#[test]
fn a_new_drive_speaks_at_1_mbit_per_second() {
    let rate = Bench::default().drive.baud_rate();
    assert_eq!((rate.raw(), rate.can_bits_per_second()), (1, Some(1_000_000)));
}

/// 3.1, 6.1: a command to all has the content and the effect of the one to a single motor.
#[test]
fn a_command_to_all_is_one_to_each() {
    for bus in [Bus::Can, Bus::Rs485] {
        for command in one_of_each() {
            let opcode = command.opcode().unwrap();
            if [Opcode::Motion, Opcode::BusId].contains(&opcode) {
                continue; // 5 has no identifier for all, 4 and 7 no other.
            }
            let after = |target| {
                let mut bench = Bench::new(Parameters { bus, ..Parameters::default() });
                let packet = command.packet(target).unwrap();
                let replies = bench.exchange(packet.channel, packet.data);
                bench.run(millis(100));
                (replies, bench.state(), *bench.drive.stored_settings())
            };
            assert_eq!(after(Target::All), after(ID.into()), "{opcode} on {bus:?}");
        }
    }
}

/// 2.1.4, 2.4.4, 2.22.1, 2.34.2, 2.35.4, 4.1: a value that the manual does not name has neither effect nor answer.
#[test]
fn values_that_the_manual_does_not_name_have_no_effect_or_reply() {
    let mut bench = Bench::default();
    let before = *bench.drive.stored_settings();
    let unnamed: [(u8, &[u8]); 7] = [
        (0x30, &[0, 3, 6, 10, 255]),
        (0x31, &[0, 3, 6, 10, 255]),
        (0x32, &[0, 3, 6, 10, 255]),
        (0x42, &[4, 255]),
        (0x43, &[4, 255]),
        (0x20, &[0, 8, 255]),
        // 0x9E is in the list of 2.34.2 and is no command of this manual; 0x30 is one, and not in it.
        (0xB6, &[0x9E, 0x30, 0]),
    ];
    for (byte, codes) in unnamed {
        for &code in codes {
            let data = [byte, code, 1, 1, 0xE8, 3, 0, 0];
            assert_eq!(bench.exchange(Channel::Command(ID.into()), data), [], "{data:02X?}");
        }
    }
    for direction in [2, 255] {
        let data = [0xA6, direction, 100, 0, 0x10, 0x27, 0, 0];
        assert_eq!(bench.exchange(Channel::Command(ID.into()), data), [], "{data:02X?}");
    }
    for id in [0, 33, 255] {
        assert_eq!(bench.exchange(Channel::BusId, [0x79, 0, 0, 0, 0, 0, 0, id]), [], "{id}");
    }
    // 9: 0xA3 and 0xA5 were commands of earlier versions.
    for byte in [0xA3, 0xA5, 0x00, 0xFF] {
        let data = [byte, 0, 0, 0, 1, 0, 0, 0];
        assert_eq!(bench.exchange(Channel::Command(ID.into()), data), [], "{byte:#X}");
    }
    assert_eq!(*bench.drive.stored_settings(), before);
    assert!(!bench.state().output_on);
}
