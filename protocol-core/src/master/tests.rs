//! The rules of the master, one test a rule. Times are chosen by hand: the reply time-out of
//! [`Config::CAN`] is 20.4 ms, its late window 40.8 ms.

mod behind_a_stop;
mod doubts;
mod every_cycle;
mod mailboxes;
mod odd_orders;
mod restarts;
mod turns;
mod unnamed;

use std::vec::Vec;

use super::*;
use crate::command::{
    AbsolutePosition, ActiveReply, AnyReply, BaudCode, BusId, Command, FunctionControl,
    IncrementalPosition, LockBrake, NoReply, PidIndex, RawCommand, RawMotion, RawReply, ReadModel,
    ReadMultiTurnAngle, ReadPid, ReadRunTime, ReadStatus1, ReleaseBrake, ReportedCommand, Reset,
    SetBaudRate, SetPoint, Shutdown, Stop, Switch, Torque,
};
use crate::data::Data;
use crate::opcode::{LOST_MASTER_BYTE, Opcode, ReplyRule};
use crate::packet::{Channel, Packet};
use crate::time::Duration;
use crate::units::{Angle, Current, MaxSpeed, ReportInterval};
use crate::wire::can::Received;
use crate::wire::rs485::Frame;

const ANGLE_REPLY: [u8; 8] = [0x92, 0, 0, 0, 0xA0, 0x8C, 0, 0];

fn id(id: u8) -> MotorId {
    MotorId::new(id).unwrap()
}

fn ms(millis: u64) -> Instant {
    Instant::from_millis(millis)
}

fn torque(amperes: f32) -> Torque {
    Torque { current: Current::from_amperes(amperes).unwrap() }
}

fn step() -> IncrementalPosition {
    IncrementalPosition { max_speed: MaxSpeed::from_raw(100), angle: Angle::from_raw(9_000) }
}

/// Everything the master sends at this time, which it is told first.
fn sent<const N: usize>(master: &mut Master<N>, now: Instant) -> Vec<Packet> {
    master.handle_timeout(now);
    let mut packets = Vec::new();
    while let Some(packet) = master.poll_transmit(now) {
        master.handle_transmitted(now);
        packets.push(packet);
    }
    packets
}

fn events<const N: usize>(master: &mut Master<N>, now: Instant) -> Vec<Event> {
    master.handle_timeout(now);
    core::iter::from_fn(|| master.poll_event()).collect()
}

fn reply<const N: usize>(
    master: &mut Master<N>,
    motor: u8,
    data: [u8; 8],
    now: Instant,
) -> Option<Event> {
    let packet = Packet { channel: Channel::Reply(id(motor)), data };
    master.handle_frame(&Received::Packet(packet), now)
}

/// Makes a request and sends it.
fn ask<C: Command, const N: usize>(
    master: &mut Master<N>,
    motor: u8,
    command: C,
    now: Instant,
) -> Ticket<C> {
    let ticket = master.request(id(motor), command).unwrap();
    sent(master, now);
    ticket
}

#[test]
fn fits_its_budget() {
    assert!(size_of::<Master<8>>() <= 2_040, "{}", size_of::<Master<8>>());
    assert!(size_of::<Master<32>>() <= 7_224, "{}", size_of::<Master<32>>());
}

#[test]
fn an_answer_finds_its_question_by_motor_command_byte_and_index() {
    let mut master = Master::<4>::new(Config::CAN);
    let angle = master.request(id(1), ReadMultiTurnAngle).unwrap();
    let gain = master.request(id(2), ReadPid { index: PidIndex::SPEED_KP }).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 2, "both at once");
    // Another motor's angle, another index, another command byte.
    for (motor, data) in
        [(2, ANGLE_REPLY), (2, [0x30, 5, 0, 0, 0, 0, 0, 0]), (1, [0x60, 0, 0, 0, 1, 0, 0, 0])]
    {
        let event = reply(&mut master, motor, data, ms(1)).unwrap();
        assert!(matches!(event, Event::Stray { .. }), "{event:?}");
    }
    let event = reply(&mut master, 2, [0x30, 4, 0, 0, 0, 0, 0x80, 0x3F], ms(1)).unwrap();
    assert!(angle.outcome(&event).is_none());
    assert_eq!(gain.outcome(&event).unwrap().unwrap().value.value(), 1.0);
    let event = reply(&mut master, 1, ANGLE_REPLY, ms(2)).unwrap();
    assert_eq!(angle.outcome(&event).unwrap().unwrap().angle.degrees(), 360.0);
    assert_eq!(master.health(id(2)).stray, 2);
    assert_eq!(master.health(id(1)).answered, 1);
    assert_eq!(master.health(id(1)).presence, Presence::Present);
}

#[test]
fn a_read_is_tried_three_times_and_then_given_up() {
    let mut master = Master::<4>::new(Config::CAN);
    let ticket = master.request(id(1), ReadMultiTurnAngle).unwrap();
    for attempt in 0..3 {
        assert_eq!(sent(&mut master, ms(attempt * 21)).len(), 1);
        assert!(events(&mut master, ms(attempt * 21 + 20)).is_empty(), "not before 20 ms");
        assert!(sent(&mut master, ms(attempt * 21 + 20)).is_empty());
        master.handle_timeout(ms(attempt * 21 + 21));
    }
    let event = master.poll_event().unwrap();
    assert_eq!(ticket.outcome(&event), Some(Err(Failure::NoReply)));
    assert!(sent(&mut master, ms(63)).is_empty());
    assert_eq!(master.health(id(1)).lost, 3);
    assert_eq!(master.health(id(1)).presence, Presence::Silent);
}

#[test]
fn a_relative_move_is_never_sent_twice_unless_the_caller_says_so() {
    let mut master = Master::<4>::new(Config::CAN);
    let ticket = master.request(id(1), step()).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    let told = events(&mut master, ms(21));
    assert_eq!(ticket.outcome(&told[0]), Some(Err(Failure::NoReply)));
    assert!(sent(&mut master, ms(21)).is_empty());

    let patience = Patience { reply_timeout: Duration::from_millis(5), attempts: 2 };
    let _ticket = master.request_with(id(2), step(), patience).unwrap();
    assert_eq!(sent(&mut master, ms(100)).len(), 1);
    assert_eq!(sent(&mut master, ms(106)).len(), 1);
}

#[test]
fn a_patience_of_seconds_is_kept() {
    let patience = Patience { reply_timeout: Duration::from_secs(10), attempts: 1 };
    for config in [Config::CAN, Config::rs485(115_200, false)] {
        let mut master = Master::<2>::new(config);
        let tickets = [1, 1].map(|motor| {
            let start = master.now;
            let ticket = master.request_with(id(motor), ReadMultiTurnAngle, patience).unwrap();
            assert_eq!(sent(&mut master, start).len(), 1);
            for after in (100..9_999).step_by(100).chain([9_999]) {
                assert_eq!(events(&mut master, start + Duration::from_millis(after)), []);
            }
            let told = events(&mut master, start + Duration::from_secs(10));
            assert_eq!(ticket.outcome(&told[0]), Some(Err(Failure::NoReply)));
            // What may come late, comes no more.
            events(&mut master, start + Duration::from_secs(11));
            ticket
        });
        assert_eq!(master.health(id(1)).lost as usize, tickets.len());
        // One that takes as long as that is the answer.
        let start = master.now;
        let ticket = master.request_with(id(1), ReadMultiTurnAngle, patience).unwrap();
        assert_eq!(sent(&mut master, start).len(), 1);
        let event = reply(&mut master, 1, ANGLE_REPLY, start + Duration::from_millis(9_999));
        assert!(ticket.outcome(&event.unwrap()).unwrap().is_ok());
    }
}

#[test]
fn a_late_answer_is_not_taken_for_the_next_ones() {
    let mut master = Master::<4>::new(Config::CAN);
    let _ = ask(&mut master, 1, step(), ms(0));
    events(&mut master, ms(21));
    // The next request of the same kind waits ...
    let second = master.request(id(1), step()).unwrap();
    assert!(sent(&mut master, ms(22)).is_empty());
    // ... until the late reply has come,
    let late = reply(&mut master, 1, [0xA8, 30, 0, 0, 0, 0, 0, 0], ms(25)).unwrap();
    assert!(matches!(late, Event::Stray { .. }) && second.outcome(&late).is_none());
    assert_eq!(sent(&mut master, ms(25)).len(), 1);
    // or until it cannot come any more.
    events(&mut master, ms(46));
    let third = master.request(id(1), step()).unwrap();
    assert!(sent(&mut master, ms(80)).is_empty());
    assert!(master.poll_at().unwrap() > ms(80));
    assert_eq!(sent(&mut master, ms(89)).len(), 1);
    let event = reply(&mut master, 1, [0xA8, 30, 0, 0, 0, 0, 0, 0], ms(90)).unwrap();
    assert!(third.outcome(&event).unwrap().is_ok());
}

#[test]
fn a_doubled_answer_is_not_taken_for_the_next_ones() {
    let mut master = Master::<4>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    let at = Instant::from_micros;
    assert!(matches!(reply(&mut master, 1, ANGLE_REPLY, at(900)), Some(Event::Reply { .. })));
    let second = master.request(id(1), ReadMultiTurnAngle).unwrap();
    sent(&mut master, at(900));
    // 130 µs after the first: no drive is so quick.
    let doubled = reply(&mut master, 1, ANGLE_REPLY, at(1_030)).unwrap();
    assert!(second.outcome(&doubled).is_none());
    let event = reply(&mut master, 1, ANGLE_REPLY, at(1_800)).unwrap();
    assert!(second.outcome(&event).is_some());
}

/// A drive that answers everything twice, 0.3 ms apart.
#[test]
fn a_second_answer_is_not_taken_for_that_to_the_next_of_its_kind() {
    let mut master = Master::<4>::new(Config::CAN);
    let at = Instant::from_micros;
    for cycle in 0..5 {
        let start = 10_000 * cycle;
        let ticket = ask(&mut master, 1, ReadMultiTurnAngle, at(start));
        // It is sent at once, or 0.1 ms later; the second answer comes 0.3 ms after the first.
        let event = reply(&mut master, 1, ANGLE_REPLY, at(start + 800)).unwrap();
        assert!(ticket.outcome(&event).is_some());
        let next = ask(&mut master, 1, ReadMultiTurnAngle, at(start + 800 + 100 * (cycle % 2)));
        let second = reply(&mut master, 1, ANGLE_REPLY, at(start + 1_100)).unwrap();
        assert!(matches!(second, Event::Stray { .. }), "{second:?}");
        let event = reply(&mut master, 1, ANGLE_REPLY, at(start + 1_700)).unwrap();
        assert!(next.outcome(&event).is_some(), "{event:?}");
        let last = reply(&mut master, 1, ANGLE_REPLY, at(start + 2_000)).unwrap();
        assert!(matches!(last, Event::Stray { .. }), "{last:?}");
    }
    // The same of a stream.
    let feedback = [0xA1, 0x32, 0x64, 0, 0, 0, 45, 0];
    master.set_point(id(1), torque(1.0), ms(60)).unwrap();
    sent(&mut master, ms(60));
    assert!(reply(&mut master, 1, feedback, at(60_800)).unwrap().feedback().is_some());
    master.set_point(id(1), torque(1.0), at(60_800)).unwrap();
    sent(&mut master, at(60_800));
    assert!(matches!(reply(&mut master, 1, feedback, at(61_100)), Some(Event::Stray { .. })));
    assert!(reply(&mut master, 1, feedback, at(61_600)).unwrap().feedback().is_some());
}

#[test]
fn an_answer_so_soon_after_another_counts_where_the_clock_is_coarse() {
    let mut master = Master::<4>::new(Config { shortest_response: Duration::ZERO, ..Config::CAN });
    for _ in 0..2 {
        let ticket = ask(&mut master, 1, ReadMultiTurnAngle, ms(1));
        let event = reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
        assert!(ticket.outcome(&event).is_some());
    }
}

#[test]
fn both_answers_of_a_request_sent_twice_are_accounted_for() {
    let mut master = Master::<4>::new(Config::CAN);
    let first = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    sent(&mut master, ms(21));
    let event = reply(&mut master, 1, ANGLE_REPLY, ms(22)).unwrap();
    assert!(first.outcome(&event).is_some());
    let second = master.request(id(1), ReadMultiTurnAngle).unwrap();
    assert!(sent(&mut master, ms(22)).is_empty(), "one reply may still come");
    let doubled = reply(&mut master, 1, ANGLE_REPLY, ms(23)).unwrap();
    assert!(second.outcome(&doubled).is_none());
    assert_eq!(sent(&mut master, ms(23)).len(), 1);
}

#[test]
fn one_request_a_motor_at_a_time_and_no_more_motors_than_places() {
    let mut master = Master::<2>::new(Config::CAN);
    let _one = master.request(id(1), ReadMultiTurnAngle).unwrap();
    assert_eq!(master.request(id(1), ReadModel).unwrap_err(), RequestError::Busy);
    let _two = master.request(id(32), ReadModel).unwrap();
    let full = master.request(id(3), ReadModel).unwrap_err();
    assert_eq!(full, RequestError::TooManyMotors { capacity: 2 });
    assert_eq!(
        master.request(id(1), BusId::Read).unwrap_err(),
        RequestError::AllMotorsOnly(Opcode::BusId)
    );
}

#[test]
fn commands_without_reply_are_done_when_sent_and_give_the_drive_time() {
    let mut master = Master::<2>::new(Config::CAN);
    let reset = ask(&mut master, 1, Reset, ms(0));
    let told = events(&mut master, ms(0));
    assert!(told.iter().any(|event| reset.outcome(event) == Some(Ok(NoReply))), "{told:?}");
    // Nothing goes to that motor for two seconds; others are served.
    let _read = master.request(id(1), ReadMultiTurnAngle).unwrap();
    let _other = master.request(id(2), ReadMultiTurnAngle).unwrap();
    let packets = sent(&mut master, ms(100));
    assert_eq!(packets.len(), 1);
    assert_eq!(packets[0].channel, Channel::Command(Target::Motor(id(2))));
    for now in (200..2_000).step_by(100) {
        assert!(
            sent(&mut master, ms(now))
                .iter()
                .all(|packet| packet.channel != Channel::Command(Target::Motor(id(1))))
        );
    }
    assert_eq!(sent(&mut master, ms(2_003)).len(), 1);
}

#[test]
fn an_id_change_is_done_when_sent_whether_it_is_echoed_or_not() {
    let mut master = Master::<2>::new(Config::CAN);
    let change = FunctionControl::SetCanId(id(9));
    let ticket = ask(&mut master, 1, change, ms(0));
    let told = events(&mut master, ms(0));
    assert_eq!(ticket.outcome(&told[0]), Some(Ok(change)));
    let echo = reply(&mut master, 1, change.encode(), ms(1)).unwrap();
    assert!(matches!(echo, Event::Stray { .. }));
    // Other functions wait for theirs.
    let filter = FunctionControl::CanIdFilter(Switch::On);
    let ticket = ask(&mut master, 2, filter, ms(1));
    let event = reply(&mut master, 2, filter.encode(), ms(2)).unwrap();
    assert_eq!(ticket.outcome(&event), Some(Ok(filter)));
}

#[test]
fn only_the_newest_set_point_is_sent() {
    let mut master = Master::<2>::new(Config::CAN);
    for amperes in [1.0, 2.0, 3.0] {
        master.set_point(id(1), torque(amperes), ms(0)).unwrap();
    }
    let packets = sent(&mut master, ms(0));
    assert_eq!(packets.len(), 1);
    assert_eq!(packets[0].data, torque(3.0).encode());
    assert_eq!(master.health(id(1)).superseded, 2);
    // While it is in flight the next waits, and is replaced in turn.
    master.set_point(id(1), torque(4.0), ms(1)).unwrap();
    master.set_point(id(1), torque(5.0), ms(1)).unwrap();
    assert!(sent(&mut master, ms(1)).is_empty());
    let event = reply(&mut master, 1, [0xA1, 30, 0, 0, 0, 0, 7, 0], ms(1)).unwrap();
    assert_eq!(event.feedback().unwrap().1.angle.degrees(), 7.0);
    assert_eq!(sent(&mut master, ms(1))[0].data, torque(5.0).encode());
}

#[test]
fn a_set_point_replaced_between_offer_and_sending_is_not_lost() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    assert_eq!(master.poll_transmit(ms(0)).unwrap().data, torque(1.0).encode());
    master.set_point(id(1), torque(2.0), ms(0)).unwrap();
    master.handle_transmitted(ms(0));
    assert_eq!(sent(&mut master, ms(0))[0].data, torque(2.0).encode());
}

#[test]
fn a_set_point_that_is_too_old_or_meets_a_dead_bus_is_dropped() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    let told = events(&mut master, ms(53));
    assert_eq!(told, [Event::SetPointDropped { motor: id(1) }]);
    assert!(sent(&mut master, ms(53)).is_empty());

    master.set_point(id(1), torque(1.0), ms(60)).unwrap();
    let moving = master.request(id(2), step()).unwrap();
    master.handle_bus_down(ms(60));
    assert!(sent(&mut master, ms(60)).is_empty(), "nothing is kept");
    let told = events(&mut master, ms(60));
    assert!(told.contains(&Event::SetPointDropped { motor: id(1) }));
    assert!(told.iter().any(|event| moving.outcome(event) == Some(Err(Failure::BusDown))));
    let read = master.request(id(1), ReadMultiTurnAngle).unwrap();
    master.handle_bus_down(ms(60));
    let told = events(&mut master, ms(60));
    assert_eq!(read.outcome(&told[0]), Some(Err(Failure::BusDown)), "nobody waits for ever");

    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    master.handle_bus_down(ms(60));
    assert_eq!(sent(&mut master, ms(60)).len(), 2, "a stop waits for the bus");
}

#[test]
fn requests_and_set_points_of_a_motor_take_turns() {
    let mut master = Master::<2>::new(Config::CAN);
    let read = master.request(id(1), ReadMultiTurnAngle).unwrap();
    let mut answered = false;
    for tick in 0..4 {
        let now = ms(tick * 2);
        master.set_point(id(1), torque(1.0), now).unwrap();
        let packets = sent(&mut master, now);
        assert_eq!(packets.len(), 1);
        let data =
            if packets[0].data[0] == 0x92 { ANGLE_REPLY } else { [0xA1, 30, 0, 0, 0, 0, 0, 0] };
        let event = reply(&mut master, 1, data, now + Duration::from_millis(1)).unwrap();
        answered |= read.outcome(&event).is_some();
    }
    assert!(answered, "set-points must not starve a request");
}

#[test]
fn an_unanswered_set_point_does_not_hold_up_the_next() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    sent(&mut master, ms(0));
    master.set_point(id(1), torque(2.0), ms(20)).unwrap();
    assert_eq!(events(&mut master, ms(21)), [Event::SetPointUnanswered { motor: id(1) }]);
    assert_eq!(sent(&mut master, ms(21))[0].data, torque(2.0).encode());
}

#[test]
fn motion_mode_feedback_comes_on_its_own_channel() {
    let mut master = Master::<2>::new(Config::CAN);
    let set_point = RawMotion::decode(&[0xE6, 0x66, 0x82, 0xE0, 0x52, 0x33, 0x3B, 0x55]);
    master.set_point(id(1), set_point, ms(0)).unwrap();
    assert_eq!(sent(&mut master, ms(0))[0].channel, Channel::Motion(id(1)));
    // Its id byte names another motor, or none (5.4): the identifier is the truth.
    for (turn, id_byte) in [1, 2, 0, 33].into_iter().enumerate() {
        let data = [id_byte, 0xE6, 0x66, 0x82, 0xEB, 0x55, 0, 0];
        let packet = Packet { channel: Channel::MotionReply(id(1)), data };
        let now = ms(1 + 2 * turn as u64);
        let event = master.handle_frame(&Received::Packet(packet), now).unwrap();
        let Event::Feedback { motor, reply: AnyReply::Motion(feedback) } = event else {
            panic!("{event:?}")
        };
        assert_eq!((motor, feedback.id_byte, feedback.position), (id(1), id_byte, 58_982));
        master.set_point(id(1), set_point, now).unwrap();
        assert_eq!(sent(&mut master, now).len(), 1);
    }
}

#[test]
fn motion_feedback_stands_for_no_other_reply() {
    // Its first byte is the id, here that of 0x20 and of 0x9C.
    let feedback = |motor: u8, first: u8| {
        let data = [first, 2, 0x80, 0, 0, 0, 0, 0];
        Received::Packet(Packet { channel: Channel::MotionReply(id(motor)), data })
    };
    let mut master = Master::<2>::new(Config::CAN);
    let filter = FunctionControl::CanIdFilter(Switch::On);
    master.broadcast(filter, id(32).into()).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    let event = master.handle_frame(&feedback(32, 0x20), ms(2)).unwrap();
    assert!(matches!(event, Event::Stray { .. }), "{event:?}");
    assert_eq!(master.poll_event(), None);
    let event = Master::<2>::new(Config::CAN).handle_frame(&feedback(1, 0x9C), ms(2)).unwrap();
    assert!(matches!(event, Event::Stray { .. }), "{event:?}");
}

/// A relative move that says it is something else.
#[derive(Clone, Copy)]
struct Lying(Kind);

impl Command for Lying {
    type Reply = RawReply;

    fn kind(&self) -> Kind {
        self.0
    }

    fn encode(&self) -> Data {
        step().encode()
    }

    fn decode_reply(data: &Data) -> Result<RawReply, crate::DecodeError> {
        Ok(RawReply(*data))
    }
}

impl SetPoint for Lying {}

#[test]
fn the_bytes_hold_against_a_claim() {
    let harmless = Kind::Raw { byte: 0xA8, reply: ReplyRule::Values, moves: false };
    for claim in [harmless, Opcode::ReadStatus2.into()] {
        let mut master = Master::<2>::new(Config::CAN);
        let refused = master.set_point(id(1), Lying(claim), ms(0)).unwrap_err();
        assert_eq!(refused, RequestError::NotASetPoint(Opcode::IncrementalPosition));
        let _ticket = master.request(id(1), Lying(claim)).unwrap();
        assert_eq!(sent(&mut master, ms(0)).len(), 1);
        // It is not sent again.
        assert_eq!(sent(&mut master, ms(30)).len(), 0, "{claim:?}");
        master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
        assert_eq!(
            master.request(id(2), Lying(claim)).unwrap_err(),
            RequestError::Stopped,
            "{claim:?}"
        );
    }
}

#[test]
fn a_raw_command_is_carried_and_matched_like_any_other() {
    let mut master = Master::<2>::new(Config::CAN);
    let power = RawCommand::new([0x71, 0, 0, 0, 0, 0, 0, 0], ReplyRule::Values, false);
    let ticket = master.request(id(1), power).unwrap();
    assert_eq!(sent(&mut master, ms(0))[0], power.packet_to(id(1).into()).unwrap());
    let other = reply(&mut master, 1, [0x72, 0, 0, 0, 0, 0, 1, 0], ms(1)).unwrap();
    assert!(matches!(other, Event::Stray { .. }), "{other:?}");
    let data = [0x71, 0, 0, 0, 0, 0, 0xE8, 3];
    let event = reply(&mut master, 1, data, ms(1)).unwrap();
    assert_eq!(ticket.outcome(&event), Some(Ok(RawReply(data))));
    // It is sent once only, and one that may move not at all while the motors are stopped.
    let ticket = master.request(id(1), power).unwrap();
    assert_eq!(sent(&mut master, ms(2)).len(), 1);
    master.handle_timeout(ms(60));
    let event = master.poll_event().unwrap();
    assert_eq!(ticket.outcome(&event), Some(Err(Failure::NoReply)));
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    let moves = RawCommand::new([0x72, 0, 0, 0, 0, 0, 0, 0], ReplyRule::Values, true);
    assert_eq!(master.request(id(2), moves).unwrap_err(), RequestError::Stopped);
    assert!(master.request(id(2), power).is_ok());
    // What the table knows is what the table says it is.
    let torque = RawCommand::new([0xA1, 0, 0, 0, 1, 0, 0, 0], ReplyRule::Silent, false);
    let mut master = Master::<2>::new(Config::CAN);
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(master.request(id(2), torque).unwrap_err(), RequestError::Stopped);
}

/// Switches reports of the angle every 10 ms on or off.
fn report_angle(enable: Switch) -> ActiveReply {
    ActiveReply {
        command: ReportedCommand::of(Opcode::ReadMultiTurnAngle).unwrap(),
        enable,
        interval: ReportInterval::from_raw(1),
    }
}

#[test]
fn what_a_motor_reports_by_itself_is_not_asked_for_and_answers_nothing() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, report_angle(Switch::On), ms(0));
    events(&mut master, ms(7));
    let refused = master.request(id(1), ReadMultiTurnAngle).unwrap_err();
    assert_eq!(refused, RequestError::Reported(Opcode::ReadMultiTurnAngle));
    let event = reply(&mut master, 1, ANGLE_REPLY, ms(10)).unwrap();
    assert!(matches!(event, Event::Report { reply: AnyReply::ReadMultiTurnAngle(_), .. }));
    let _off = ask(&mut master, 1, report_angle(Switch::Off), ms(20));
    events(&mut master, ms(27));
    assert!(master.request(id(1), ReadMultiTurnAngle).is_ok());
}

#[test]
fn what_a_motor_reported_before_its_reset_may_be_asked_for_after_it() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, report_angle(Switch::On), ms(0));
    events(&mut master, ms(7));
    assert!(master.request(id(1), ReadMultiTurnAngle).is_err());
    let _ = ask(&mut master, 1, Reset, ms(10));
    events(&mut master, ms(20));
    assert!(master.request(id(1), ReadMultiTurnAngle).is_ok());
}

#[test]
fn what_all_are_told_to_report_is_known_of_each() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    master.broadcast(report_angle(Switch::On), MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(100)).len(), 1);
    events(&mut master, ms(150));
    let refused = master.request(id(1), ReadMultiTurnAngle).unwrap_err();
    assert_eq!(refused, RequestError::Reported(Opcode::ReadMultiTurnAngle));
    master.broadcast(Reset, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(200)).len(), 1);
    events(&mut master, ms(250));
    assert!(master.request(id(1), ReadMultiTurnAngle).is_ok());
}

#[test]
fn a_late_reply_with_the_status_is_no_error_report() {
    let mut master = Master::<2>::new(Config::CAN);
    let read = ask(&mut master, 1, ReadStatus1, ms(0));
    let at = (1..100).map(ms).find(|&at| {
        let _repeats = sent(&mut master, at);
        events(&mut master, at).iter().any(|event| read.outcome(event).is_some())
    });
    let at = at.expect("it is given up");
    let status = [0x9A, 50, 40, 0, 0xE0, 1, 2, 0];
    assert!(matches!(reply(&mut master, 1, status, at), Some(Event::Stray { .. })));
}

#[test]
fn an_error_report_is_told_as_a_report() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    let event = reply(&mut master, 1, [0x9A, 50, 40, 0, 0xE0, 1, 2, 0], ms(1)).unwrap();
    assert!(matches!(event, Event::Report { reply: AnyReply::ReadStatus1(_), .. }));
}

#[test]
fn the_echo_of_a_drive_that_lost_its_master_is_no_answer() {
    let mut master = Master::<2>::new(Config::CAN);
    let read = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    let lost = reply(&mut master, 1, [0xF1, 0, 0, 0, 0, 0, 0, 0], ms(1)).unwrap();
    assert_eq!(lost, Event::LostMaster { motor: id(1) });
    // The drive echoes the command and does nothing: an angle of 0 would be a lie.
    assert_eq!(reply(&mut master, 1, ReadMultiTurnAngle.encode(), ms(2)), None);
    assert_eq!(sent(&mut master, ms(2)).len(), 1, "sent again");
    let event = reply(&mut master, 1, ANGLE_REPLY, ms(3)).unwrap();
    assert!(read.outcome(&event).unwrap().is_ok());

    // The stop that is echoed so is sent again as well.
    reply(&mut master, 1, [0xF1, 0, 0, 0, 0, 0, 0, 0], ms(4));
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(5)).len(), 1);
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(6)), None);
    assert_eq!(sent(&mut master, ms(6)).len(), 1);
    assert_eq!(
        reply(&mut master, 1, Stop.encode(), ms(7)),
        Some(Event::StopConfirmed { motor: id(1) })
    );
}

#[test]
fn a_short_frame_completes_nothing() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    let short = |first| Received::WrongLength {
        channel: Channel::Reply(id(1)),
        length: 1,
        first: Some(first),
    };
    assert_eq!(master.handle_frame(&short(0x92), ms(1)), None);
    assert!(master.is_anything_in_flight());
    assert_eq!(master.handle_frame(&short(0xF1), ms(1)), Some(Event::LostMaster { motor: id(1) }));
}

#[test]
fn a_broadcast_collects_answers_and_names_the_silent() {
    let mut master = Master::<4>::new(Config::CAN);
    let expected: MotorSet = [1, 2, 3].into_iter().map(id).collect();
    let earlier = ask(&mut master, 1, ReadModel, ms(0));
    master.broadcast(ReadMultiTurnAngle, expected).unwrap();
    assert!(sent(&mut master, ms(0)).is_empty(), "a request is in flight");
    let _ = reply(&mut master, 1, *b"\xB5X8S2V10", ms(1))
        .filter(|event| earlier.outcome(event).is_some())
        .unwrap();
    assert_eq!(sent(&mut master, ms(1))[0].channel, Channel::Command(Target::All));
    assert_eq!(master.broadcast(ReadModel, expected), Err(RequestError::Busy));
    for motor in [1, 3] {
        let event = reply(&mut master, motor, ANGLE_REPLY, ms(2)).unwrap();
        assert!(matches!(event, Event::BroadcastReply { .. }));
    }
    let twice = reply(&mut master, 1, ANGLE_REPLY, ms(3)).unwrap();
    assert!(matches!(twice, Event::Stray { .. }));
    assert_eq!(
        events(&mut master, ms(23)),
        [Event::BroadcastDone { silent: id(2).into(), was_sent: true }]
    );
}

#[test]
fn a_stop_goes_before_everything_and_keeps_motion_away() {
    let mut master = Master::<4>::new(Config::CAN);
    let in_flight = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    let waiting = master.request(id(2), step()).unwrap();
    master.stop_all(StopKind::Off, id(7).into()).unwrap();
    let packets = sent(&mut master, ms(1));
    assert_eq!(packets.len(), 3, "motors 1, 2 and 7, whatever is in flight");
    assert!(packets.iter().all(|packet| packet.data == Shutdown.encode()));
    let told = events(&mut master, ms(1));
    assert!(told.iter().any(|event| in_flight.outcome(event) == Some(Err(Failure::Stopped))));
    assert!(told.iter().any(|event| waiting.outcome(event) == Some(Err(Failure::Stopped))));
    assert!(told.contains(&Event::SetPointDropped { motor: id(1) }));

    assert_eq!(master.set_point(id(1), torque(1.0), ms(2)), Err(RequestError::Stopped));
    assert_eq!(master.request(id(3), step()).unwrap_err(), RequestError::Stopped);
    for motor in [1, 2] {
        let event = reply(&mut master, motor, Shutdown.encode(), ms(2));
        assert_eq!(event, Some(Event::StopConfirmed { motor: id(motor) }));
    }
    // Motor 7 is not there: it is told 15 times, then the caller is.
    let mut frames = 1;
    let mut now = 2;
    while master.is_anything_in_flight() {
        now += 21;
        frames += sent(&mut master, ms(now)).len();
    }
    assert_eq!(frames, 15);
    assert_eq!(events(&mut master, ms(now)), [Event::StopUnconfirmed { motor: id(7) }]);
    master.lift_stop();
    assert!(master.set_point(id(1), torque(1.0), ms(now)).is_ok());
}

#[test]
fn every_motor_gets_its_first_stop_before_any_gets_its_second() {
    let slow = Config { reply_timeout: Duration::from_secs(2), ..Config::rs485(115_200, false) };
    let mut master = Master::<4>::new(slow);
    master.stop_all(StopKind::Hold, [id(1), id(2), id(3)].into_iter().collect()).unwrap();
    // One to all, whose answers would meet the next; then nobody answers, and a stop waits for 50 ms at
    // the most.
    let told = |at| sent(&mut master, ms(at)).pop().map(|packet| packet.channel);
    let to = |motor| Some(Channel::Command(Target::Motor(id(motor))));
    let to_all = Some(Channel::Command(Target::All));
    let expected = [to_all, None, to(1), to(2), to(3), to(1)];
    assert_eq!([0, 5, 6, 56, 106, 156].map(told), expected);
}

#[test]
fn no_older_set_point_follows_what_ends_motion() {
    fn never<C: Command + Copy>(end: C) {
        let mut master = Master::<2>::new(Config::CAN);
        master.set_point(id(1), torque(1.0), ms(0)).unwrap();
        let _offered = master.poll_transmit(ms(0));
        let ticket = master.request(id(1), end).unwrap();
        // What was offered before does not count as sent.
        master.handle_transmitted(ms(0));
        assert_eq!(sent(&mut master, ms(1))[0].data, end.encode());
        let answer = reply(&mut master, 1, end.encode(), ms(2));
        let told: Vec<Event> = answer.into_iter().chain(events(&mut master, ms(2))).collect();
        assert!(told.iter().any(|event| matches!(ticket.outcome(event), Some(Ok(_)))));
        assert!(told.contains(&Event::SetPointDropped { motor: id(1) }));
        assert_eq!(sent(&mut master, ms(3_000)), []);
    }
    never(Shutdown);
    never(Stop);
    never(LockBrake);
    never(Reset);
}

#[test]
fn a_timeout_of_nothing_still_lets_a_reply_come() {
    let mut master = Master::<2>::new(Config::CAN);
    let once = Patience { reply_timeout: Duration::ZERO, attempts: 1 };
    let ticket = master.request_with(id(1), ReadModel, once).unwrap();
    sent(&mut master, ms(1));
    assert_eq!(events(&mut master, ms(1)), []);
    let now = ms(1) + Duration::from_micros(700);
    let event = reply(&mut master, 1, *b"\xB5X8S2V10", now).unwrap();
    assert!(ticket.outcome(&event).is_some_and(|outcome| outcome.is_ok()));
}

#[test]
fn a_gap_does_not_spoil_the_mean_round_trip() {
    let mut master = Master::<2>::new(Config::CAN);
    for (asked, came) in [(0, 1), (10, 60_010)] {
        let _ticket = ask(&mut master, 1, ReadModel, ms(asked));
        reply(&mut master, 1, *b"\xB5X8S2V10", ms(came)).unwrap();
    }
    // 1 ms, then an eighth of 250 ms.
    assert_eq!(master.health(id(1)).round_trip, Duration::from_micros(875 + 31_250));
}

#[test]
fn rs485_carries_one_exchange_at_a_time() {
    let mut master = Master::<4>::new(Config::rs485(1_000_000, false));
    let first = master.request(id(1), ReadMultiTurnAngle).unwrap();
    let _second = master.request(id(2), ReadMultiTurnAngle).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    assert_eq!(sent(&mut master, ms(1)).len(), 0);
    let line = |motor, data| Frame { address: Target::Motor(id(motor)), data };
    let event = master.handle_line(&line(1, ANGLE_REPLY), ms(1)).unwrap();
    assert!(first.outcome(&event).is_some());
    assert_eq!(sent(&mut master, ms(1)).len(), 0, "the drives turn around for 100 µs");
    assert!(master.poll_at().unwrap() <= Instant::from_micros(1_120));
    assert_eq!(sent(&mut master, Instant::from_micros(1_120)).len(), 1);
    let motion = RawMotion::decode(&[0; 8]);
    assert_eq!(master.set_point(id(1), motion, ms(2)), Err(RequestError::CanOnly(Opcode::Motion)));
}

#[test]
fn on_rs485_nobody_speaks_while_an_unwanted_answer_may_come() {
    let mut master = Master::<4>::new(Config::rs485(1_000_000, false));
    let faster = SetBaudRate { baud_rate: BaudCode::CAN_1M_RS485_500K };
    let _set = master.request(id(1), faster).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    let _other = master.request(id(2), ReadModel).unwrap();
    assert!(sent(&mut master, ms(4)).is_empty(), "0xB4 is answered with garbage (2.32.3)");
    assert_eq!(sent(&mut master, ms(6)).len(), 1);
}

fn feedback_of_all(master: &mut Master<8>, motors: core::ops::RangeInclusive<u8>, now: Instant) {
    for motor in motors {
        let answer = reply(master, motor, [0xA4, 0, 0, 0, 0, 0, 0, 0], now);
        assert!(matches!(answer, Some(Event::Feedback { .. })), "{answer:?}");
    }
}

fn stream_to(master: &mut Master<8>, motors: core::ops::RangeInclusive<u8>, now: Instant) {
    let go = AbsolutePosition { max_speed: MaxSpeed::from_raw(1), angle: Angle::from_raw(0) };
    for motor in motors {
        master.set_point(id(motor), go, now).unwrap();
    }
}

#[test]
fn a_motor_whose_replies_lose_every_arbitration_gets_its_turn() {
    let mut master = Master::<8>::new(Config::CAN);
    stream_to(&mut master, 1..=6, ms(0));
    assert_eq!(sent(&mut master, ms(0)).len(), 6);
    feedback_of_all(&mut master, 1..=5, ms(1));
    // The others may be one command ahead of motor 6, but not two.
    stream_to(&mut master, 1..=5, ms(1));
    assert_eq!(sent(&mut master, ms(1)).len(), 5);
    feedback_of_all(&mut master, 1..=5, ms(2));
    stream_to(&mut master, 1..=5, ms(2));
    assert_eq!(sent(&mut master, ms(2)).len(), 0);
    feedback_of_all(&mut master, 6..=6, ms(2));
    assert_eq!(sent(&mut master, ms(2)).len(), 5);
}

#[test]
fn a_bus_that_was_full_is_quiet_as_soon_as_its_frames_are_gone() {
    let mut master = Master::<8>::new(Config::CAN);
    let mut now = Instant::from_micros(100);
    let pause = Duration::from_micros(240);
    let mut answer = |master: &mut Master<8>, motor| {
        now += pause;
        feedback_of_all(master, motor..=motor, now);
        stream_to(master, motor..=motor, now);
        (sent(master, now).len(), now)
    };
    stream_to(&mut master, 1..=8, ms(0));
    sent(&mut master, ms(0));
    // For half a second there is always a frame on the bus: two in 240 µs, each for 136 µs at the most.
    for _ in 0..250 {
        for motor in 1..=8 {
            assert_eq!(answer(&mut master, motor).0, 1);
        }
    }
    // Then an answer of motor 8 is lost, and the others may be one command ahead of it.
    assert!((1..=7).all(|motor| answer(&mut master, motor).0 == 1));
    assert!((1..=7).all(|motor| answer(&mut master, motor).0 == 0));
    let last = now;
    assert_eq!(sent(&mut master, last + Duration::from_millis(1)).len(), 7);
}

#[test]
fn nobody_waits_for_a_motor_that_had_its_chance() {
    let mut master = Master::<8>::new(Config::CAN);
    let _silent = master.request(id(1), ReadStatus1).unwrap();
    let mut held_at = Vec::new();
    for tick in 0..40 {
        let now = ms(tick);
        stream_to(&mut master, 2..=4, now);
        let others = sent(&mut master, now).iter().filter(|packet| packet.data[0] == 0xA4).count();
        match others {
            3 => feedback_of_all(&mut master, 2..=4, now + Duration::from_micros(990)),
            0 => held_at.push(tick),
            _ => panic!("{others} of 3 at {tick} ms"),
        }
    }
    // Once, because at 2 ms a reply could still have waited for the bus; then the silent motor is
    // known, also after its time-out at 21 ms.
    assert!(held_at.len() <= 1, "held at {held_at:?}");
}

#[test]
fn late_answers_to_a_broadcast_are_not_taken_for_others() {
    let mut master = Master::<4>::new(Config::CAN);
    for motor in 1..=3 {
        let _ticket = master.request(id(motor), ReadModel).unwrap();
    }
    sent(&mut master, ms(0));
    for motor in 1..=3 {
        reply(&mut master, motor, *b"\xB5X8S2V10", ms(1)).unwrap();
    }
    // Motors 1 and 2 are expected, 1 and 3 hear it; 1 answers in time.
    master.broadcast(ReadMultiTurnAngle, [1, 2].into_iter().map(id).collect()).unwrap();
    assert_eq!(sent(&mut master, ms(2)).len(), 1);
    assert!(matches!(
        reply(&mut master, 1, ANGLE_REPLY, ms(3)),
        Some(Event::BroadcastReply { .. })
    ));
    assert_eq!(
        events(&mut master, ms(24)),
        [Event::BroadcastDone { silent: id(2).into(), was_sent: true }]
    );
    let tickets = [1, 2, 3].map(|motor| master.request(id(motor), ReadMultiTurnAngle).unwrap());
    assert_eq!(sent(&mut master, ms(24)).len(), 1, "motor 1 has answered, the others may yet");
    // Another kind is not mixed up; the late answer of the unexpected motor 3 frees its request.
    let late = reply(&mut master, 3, ANGLE_REPLY, ms(25)).unwrap();
    assert!(matches!(late, Event::Stray { .. }) && tickets[2].outcome(&late).is_none());
    assert_eq!(sent(&mut master, ms(25)).len(), 1);
    // Sent at 2 ms, with 21 ms to answer and a late window of 40 ms.
    for motor in [1, 3] {
        reply(&mut master, motor, ANGLE_REPLY, ms(27)).unwrap();
    }
    let at = master.poll_at().unwrap();
    assert!((ms(62)..ms(66)).contains(&at), "{at:?}");
    assert!(sent(&mut master, ms(61)).is_empty());
    assert_eq!(sent(&mut master, at).len(), 1);
}

#[test]
fn a_broadcast_waits_for_the_late_answers_to_the_one_before() {
    let mut master = Master::<4>::new(Config::CAN);
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    sent(&mut master, ms(0));
    assert_eq!(
        events(&mut master, ms(21)),
        [Event::BroadcastDone { silent: id(1).into(), was_sent: true }]
    );
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    assert!(sent(&mut master, ms(21)).is_empty());
    let late = reply(&mut master, 1, ANGLE_REPLY, ms(22));
    assert!(!matches!(late, Some(Event::BroadcastReply { .. })));
    assert_eq!(sent(&mut master, ms(22)).len(), 1, "it has come, so nothing can be mistaken");
    // And a reply from just before it is none to it.
    let doubled = reply(&mut master, 1, ANGLE_REPLY, Instant::from_micros(22_100));
    assert!(!matches!(doubled, Some(Event::BroadcastReply { .. })));
    let answer = reply(&mut master, 1, ANGLE_REPLY, ms(23));
    assert!(matches!(answer, Some(Event::BroadcastReply { .. })));
}

#[test]
fn a_broadcast_lets_further_attempts_go_and_waits_for_no_restart() {
    let mut master = Master::<4>::new(Config::CAN);
    let _reset = master.request(id(2), Reset).unwrap();
    let read = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    events(&mut master, ms(0));
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    // The first attempt is lost; the second must not wait for the broadcast, which waits for it.
    assert_eq!(sent(&mut master, ms(21))[0].data[0], 0x92);
    let event = reply(&mut master, 1, ANGLE_REPLY, ms(22)).unwrap();
    assert!(read.outcome(&event).is_some());
    assert!(sent(&mut master, ms(22)).is_empty(), "the first attempt may still be answered");
    let at = master.poll_at().unwrap();
    assert!((ms(62)..ms(66)).contains(&at), "{at:?}");
    assert_eq!(sent(&mut master, at)[0].channel, Channel::Command(Target::All));
}

#[test]
fn a_request_and_a_stream_of_the_same_kind_exclude_each_other() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    let refused = RequestError::Streamed(Opcode::Torque);
    assert_eq!(master.request(id(1), torque(2.0)).unwrap_err(), refused);
    sent(&mut master, ms(0));
    assert_eq!(master.request(id(1), torque(2.0)).unwrap_err(), refused);
    // Its feedback may come late, and is no answer.
    events(&mut master, ms(21));
    let ticket = master.request(id(1), torque(2.0)).unwrap();
    assert_eq!(master.set_point(id(1), torque(3.0), ms(22)), Err(RequestError::Busy));
    assert_eq!(sent(&mut master, ms(22)), []);
    let feedback = [0xA1, 30, 0, 0, 0, 0, 7, 0];
    let late = reply(&mut master, 1, feedback, ms(30)).unwrap();
    assert!(matches!(late, Event::Feedback { .. }) && ticket.outcome(&late).is_none(), "{late:?}");
    assert_eq!(sent(&mut master, ms(30)).len(), 1);
    let event = reply(&mut master, 1, feedback, ms(31)).unwrap();
    assert!(ticket.outcome(&event).is_some());
    assert!(master.set_point(id(1), torque(3.0), ms(31)).is_ok());
}

#[test]
fn only_what_is_surely_a_late_answer_ends_the_wait_for_it() {
    let mut master = Master::<2>::new(Config::CAN);
    let once = Patience { reply_timeout: Duration::from_millis(5), attempts: 1 };
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    sent(&mut master, ms(0));
    events(&mut master, ms(21));
    let _first = master.request_with(id(1), ReadMultiTurnAngle, once).unwrap();
    sent(&mut master, ms(22));
    events(&mut master, ms(28));
    let second = master.request_with(id(1), ReadMultiTurnAngle, once).unwrap();
    // Late feedback of the lost set-point, twice; an error report.
    for (data, at) in [
        ([0xA1, 30, 0, 0, 0, 0, 7, 0], 30),
        ([0xA1, 30, 0, 0, 0, 0, 7, 0], 30),
        ([0x9A, 50, 40, 0, 0xE0, 1, 2, 0], 35),
    ] {
        reply(&mut master, 1, data, ms(at)).unwrap();
        assert!(sent(&mut master, ms(at)).is_empty(), "{data:02X?}");
    }
    let late = reply(&mut master, 1, ANGLE_REPLY, ms(40)).unwrap();
    assert!(second.outcome(&late).is_none());
    assert_eq!(sent(&mut master, ms(40)).len(), 1);
}

#[test]
fn a_stop_is_not_confirmed_by_the_answer_to_an_earlier_one() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, Stop, ms(0));
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(1)).len(), 1);
    // Whose answer this is nobody knows, so the motor is told once more.
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(2)), None);
    assert_eq!(sent(&mut master, ms(2)).len(), 1);
    let confirmed = Event::StopConfirmed { motor: id(1) };
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(3)), Some(confirmed));
}

#[test]
fn a_stop_takes_no_request_its_outcome() {
    let mut master = Master::<2>::new(Config::CAN);
    let read = master.request(id(1), ReadMultiTurnAngle).unwrap();
    for attempt in 0..3 {
        sent(&mut master, ms(attempt * 21));
        master.handle_timeout(ms(attempt * 21 + 21));
    }
    // Given up, but not told yet.
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    let told = events(&mut master, ms(63));
    assert!(told.iter().any(|event| read.outcome(event).is_some()), "{told:?}");
}

#[test]
fn while_the_bus_is_down_late_answers_do_not_grow_old() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, step(), ms(0));
    events(&mut master, ms(21));
    master.handle_bus_down(ms(55));
    let second = master.request(id(1), step()).unwrap();
    assert!(sent(&mut master, ms(70)).is_empty(), "40 ms from when the bus was down");
    assert_eq!(sent(&mut master, ms(98)).len(), 1);
    let event = reply(&mut master, 1, [0xA8, 30, 0, 0, 0, 0, 0, 0], ms(99)).unwrap();
    assert!(second.outcome(&event).is_some());
}

fn motion() -> RawMotion {
    RawMotion::decode(&[0xE6, 0x66, 0x82, 0xE0, 0x52, 0x33, 0x3B, 0x55])
}

fn motion_feedback(master: &mut Master<2>, now: Instant) -> Option<Event> {
    let data = [1, 0x80, 0, 0x80, 0x08, 0, 0, 0];
    let packet = Packet { channel: Channel::MotionReply(id(1)), data };
    master.handle_frame(&Received::Packet(packet), now)
}

#[test]
fn a_stop_is_confirmed_only_when_nothing_sent_before_can_move_the_motor_any_more() {
    // On CAN a stop (0x141) overtakes a set-point (0x401) that waits in another mailbox.
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(0))[0].data, Shutdown.encode());
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(1)), None);
    assert_eq!(sent(&mut master, ms(1)), []);
    // The set-point has reached the drive, which turns again.
    assert!(matches!(motion_feedback(&mut master, ms(3)), Some(Event::Feedback { .. })));
    assert_eq!(sent(&mut master, ms(3))[0].data, Shutdown.encode());
    let confirmed = Some(Event::StopConfirmed { motor: id(1) });
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(4)), confirmed);
}

#[test]
fn a_stop_is_confirmed_at_once_when_the_feedback_came_before() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    sent(&mut master, ms(0));
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(0));
    motion_feedback(&mut master, ms(1)).unwrap();
    let confirmed = Some(Event::StopConfirmed { motor: id(1) });
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(1)), confirmed);
}

#[test]
fn a_stop_goes_once_more_when_a_set_point_before_it_counts_as_lost() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    sent(&mut master, ms(0));
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(0));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(1)), None);
    let at = master.poll_at().unwrap();
    assert!(at < ms(100), "{at:?}");
    assert_eq!(sent(&mut master, at)[0].data, Shutdown.encode());
    let confirmed = Some(Event::StopConfirmed { motor: id(1) });
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), at + Duration::from_millis(1)), confirmed);
}

#[test]
fn a_request_that_ends_motion_is_answered_when_no_lost_set_point_can_move_the_motor_any_more() {
    for patience in [None, Some(Patience { attempts: 1, reply_timeout: Config::CAN.reply_timeout })]
    {
        let mut master = Master::<2>::new(Config::CAN);
        master.set_point(id(1), motion(), ms(0)).unwrap();
        sent(&mut master, ms(0));
        // 20 ms later it counts as lost, and may reach the drive for 41 ms from when anything is heard.
        let lost = master.poll_at().unwrap().max(ms(21));
        assert_eq!(events(&mut master, lost), [Event::SetPointUnanswered { motor: id(1) }]);
        let ticket = match patience {
            Some(patience) => master.request_with(id(1), Shutdown, patience),
            None => master.request(id(1), Shutdown),
        };
        assert_eq!(sent(&mut master, lost)[0].data, Shutdown.encode());
        assert_eq!(reply(&mut master, 1, Shutdown.encode(), lost + Duration::from_millis(1)), None);
        // Until then nothing was heard: the bus may have been cut.
        let over = lost + Duration::from_millis(1) + Config::CAN.late_window;
        assert_eq!(master.poll_at(), Some(over));
        assert_eq!(sent(&mut master, over)[0].data, Shutdown.encode());
        let told = reply(&mut master, 1, Shutdown.encode(), over + Duration::from_millis(1));
        assert_eq!(ticket.unwrap().outcome(&told.unwrap()), Some(Ok(Shutdown)));
    }
}

#[test]
fn no_set_point_goes_before_what_was_asked_for_earlier_to_end_motion() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    sent(&mut master, ms(0));
    let lost = master.poll_at().unwrap().max(ms(21));
    assert_eq!(events(&mut master, lost), [Event::SetPointUnanswered { motor: id(1) }]);
    let ticket = master.request(id(1), Shutdown).unwrap();
    // A newer one, at every step: for the first attempt, for the second, and when it goes once more.
    let put = |master: &mut Master<2>, at| master.set_point(id(1), motion(), at).unwrap();
    put(&mut master, lost);
    assert_eq!(sent(&mut master, lost)[0].data, Shutdown.encode());
    assert_eq!(sent(&mut master, lost), []);
    let again = lost + Config::CAN.reply_timeout;
    put(&mut master, again);
    assert_eq!(events(&mut master, again), []);
    assert_eq!(sent(&mut master, again)[0].data, Shutdown.encode());
    let answered = again + Duration::from_millis(1);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), answered), None);
    // Until then nothing was heard: the bus may have been cut. And the second may be answered yet.
    let over = again + Config::CAN.reply_timeout + Config::CAN.late_window;
    put(&mut master, answered);
    assert_eq!(sent(&mut master, answered), []);
    put(&mut master, over);
    assert_eq!(sent(&mut master, over)[0].data, Shutdown.encode());
    let told = reply(&mut master, 1, Shutdown.encode(), over + Duration::from_millis(1));
    assert_eq!(ticket.outcome(&told.unwrap()), Some(Ok(Shutdown)));
    assert!(matches!(sent(&mut master, over + Duration::from_millis(1))[..], [_]), "its turn");
}

#[test]
fn who_stops_in_every_cycle_is_told_when_the_motor_stands() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    // It answers after 1.5 ms.
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(2)).len(), 1);
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(3)), []);
    let confirmed = Some(Event::StopConfirmed { motor: id(1) });
    let answered = ms(3) + Duration::from_micros(500);
    assert_eq!(reply(&mut master, 1, Stop.encode(), answered), confirmed);
    // The next one is a stop of its own, and so is one of another kind.
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(4))[0].data, Stop.encode());
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(5))[0].data, Shutdown.encode());
}

#[test]
fn who_stops_all_in_every_cycle_on_a_line_keeps_no_motors_own_stop_back() {
    let of_motor_1 = |data| Frame { address: Target::Motor(id(1)), data };
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    master.handle_line(&of_motor_1(ANGLE_REPLY), ms(1)).unwrap();
    let mut told = Vec::new();
    for now in 2..20 {
        master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
        for packet in sent(&mut master, ms(now)) {
            if packet.channel != Channel::Command(Target::All) {
                let answered = ms(now) + Duration::from_micros(900);
                told.extend(master.handle_line(&of_motor_1(Stop.encode()), answered));
            }
        }
    }
    assert!(told.contains(&Event::StopConfirmed { motor: id(1) }), "{told:?}");
}

#[test]
fn one_motor_is_stopped_by_itself() {
    let mut master = Master::<2>::new(Config::CAN);
    for motor in 1..=2 {
        master.set_point(id(motor), torque(1.0), ms(0)).unwrap();
    }
    master.stop(id(1), StopKind::Hold).unwrap();
    let packets = sent(&mut master, ms(0));
    assert_eq!(packets[0].data, Stop.encode());
    assert_eq!(packets[1].data, torque(1.0).encode());
    assert_eq!(master.set_point(id(1), torque(1.0), ms(1)), Err(RequestError::Stopped));
    assert_eq!(master.set_point(id(2), torque(1.0), ms(1)), Ok(()));
    master.lift_stop_of(id(1));
    assert_eq!(master.set_point(id(1), torque(1.0), ms(1)), Ok(()));
}

#[test]
fn a_frame_that_was_pushed_out_waits_again() {
    let mut master = Master::<2>::new(Config::CAN);
    let ticket = master.request(id(1), step()).unwrap();
    let pushed_out = sent(&mut master, ms(0))[0];
    master.handle_pushed_out(&pushed_out);
    assert_eq!(
        sent(&mut master, ms(1)),
        [pushed_out],
        "it was never sent, so this is no second time"
    );
    let event = reply(&mut master, 1, [0xA8, 30, 0, 0, 0, 0, 0, 0], ms(2)).unwrap();
    assert!(ticket.outcome(&event).unwrap().is_ok());
    assert_eq!(master.health(id(1)).lost, 0);
}

#[test]
fn a_frame_that_was_pushed_out_has_used_no_attempt() {
    let mut master = Master::<2>::new(Config::CAN);
    let patience = Patience { attempts: 2, reply_timeout: Duration::from_millis(5) };
    let ticket = master.request_with(id(1), ReadMultiTurnAngle, patience).unwrap();
    let pushed_out = sent(&mut master, ms(0))[0];
    master.handle_pushed_out(&pushed_out);
    for at in [0, 5] {
        assert_eq!(sent(&mut master, ms(at)), [pushed_out], "{at}");
    }
    assert_eq!(sent(&mut master, ms(10)), []);
    let told = events(&mut master, ms(10));
    assert_eq!(told.iter().find_map(|event| ticket.outcome(event)), Some(Err(Failure::NoReply)));
}

#[test]
fn a_motor_whose_frame_was_pushed_out_has_had_no_turn() {
    let mut master = Master::<8>::new(Config::CAN);
    stream_to(&mut master, 3..=3, ms(0));
    stream_to(&mut master, 1..=2, ms(0));
    sent(&mut master, ms(0));
    feedback_of_all(&mut master, 1..=3, ms(1));
    stream_to(&mut master, 3..=3, ms(1));
    let pushed_out = sent(&mut master, ms(1))[0];
    master.handle_pushed_out(&pushed_out);
    // All three have had one turn, and motor 3 is the first of equals.
    stream_to(&mut master, 1..=2, ms(1));
    assert_eq!(sent(&mut master, ms(1))[0], pushed_out);
}

#[test]
fn a_set_point_that_was_pushed_out_gives_way_to_a_newer_one_and_to_a_stop() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    let pushed_out = sent(&mut master, ms(0))[0];
    master.set_point(id(1), torque(2.0), ms(1)).unwrap();
    master.handle_pushed_out(&pushed_out);
    assert_eq!(sent(&mut master, ms(1))[0].data, torque(2.0).encode());

    let pushed_out = Packet { data: torque(2.0).encode(), ..pushed_out };
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(1))[0].data, Stop.encode());
    master.handle_pushed_out(&pushed_out);
    assert_eq!(sent(&mut master, ms(2)), []);
    // It never left, so it cannot move the motor any more.
    let confirmed = Some(Event::StopConfirmed { motor: id(1) });
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(2)), confirmed);
}

#[test]
fn a_lost_reply_of_a_stream_costs_its_own_frame_and_no_more() {
    let mut master = Master::<2>::new(Config::CAN);
    let mut unanswered = 0;
    let mut answered = 0;
    for now in 1..100 {
        master.set_point(id(1), motion(), ms(now)).unwrap();
        let is_sent = !sent(&mut master, ms(now)).is_empty();
        // Every tenth feedback is lost.
        if is_sent && now % 10 != 0 {
            let then = ms(now) + Duration::from_micros(900);
            answered += u32::from(motion_feedback(&mut master, then).is_some());
        }
        let told = events(&mut master, ms(now) + Duration::from_micros(950));
        unanswered += told.iter().filter(|e| matches!(e, Event::SetPointUnanswered { .. })).count();
    }
    assert_eq!(unanswered, 9);
    // Each holds the next one back until three times what feedback takes, so two at the most.
    assert!(answered >= 99 - 9 - 2 * 9, "{answered}");
}

#[test]
fn a_read_of_another_kind_does_not_wait_for_a_late_reply() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, step(), ms(0));
    events(&mut master, ms(21));
    let _read = master.request(id(1), ReadModel).unwrap();
    assert_eq!(sent(&mut master, ms(22)).len(), 1);
}

#[test]
fn another_master_s_reply_does_not_end_the_wait_for_a_late_one() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, step(), ms(0));
    events(&mut master, ms(21));
    let _second = master.request(id(1), step()).unwrap();
    reply(&mut master, 1, ANGLE_REPLY, ms(25)).unwrap();
    assert_eq!(sent(&mut master, ms(26)), []);
}

#[test]
fn an_error_report_is_told_while_something_else_may_come_late() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, step(), ms(0));
    events(&mut master, ms(21));
    let event = reply(&mut master, 1, [0x9A, 50, 40, 0, 0xE0, 1, 2, 0], ms(25)).unwrap();
    assert!(matches!(event, Event::Report { reply: AnyReply::ReadStatus1(_), .. }), "{event:?}");
}

#[test]
fn the_first_set_point_on_any_clock_and_after_any_pause_is_sent() {
    for start in [0, 30_000, 10_000_000_000] {
        let mut master = Master::<2>::new(Config::CAN);
        master.set_point(id(1), torque(1.0), ms(start)).unwrap();
        assert_eq!(sent(&mut master, ms(start)).len(), 1, "{start}");
    }
}

#[test]
fn the_echo_of_an_ignored_set_point_is_no_feedback() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    sent(&mut master, ms(0));
    reply(&mut master, 1, [0xF1, 0, 0, 0, 0, 0, 0, 0], ms(1)).unwrap();
    // A newer one waits: it is not that one that comes back.
    master.set_point(id(1), torque(2.0), ms(1)).unwrap();
    let event = reply(&mut master, 1, torque(1.0).encode(), ms(2));
    assert_eq!(event, Some(Event::SetPointUnanswered { motor: id(1) }));
}

#[test]
fn the_echo_of_an_ignored_set_point_that_was_given_up_is_no_feedback() {
    for is_newer_in_flight in [true, false] {
        let mut master = Master::<2>::new(Config::CAN);
        master.set_point(id(1), torque(1.0), ms(0)).unwrap();
        sent(&mut master, ms(0));
        assert_eq!(events(&mut master, ms(21)), [Event::SetPointUnanswered { motor: id(1) }]);
        if is_newer_in_flight {
            master.set_point(id(1), torque(2.0), ms(21)).unwrap();
            assert_eq!(sent(&mut master, ms(21)).len(), 1);
        }
        reply(&mut master, 1, [0xF1, 0, 0, 0, 0, 0, 0, 0], ms(22)).unwrap();
        // The bus has held the first one back.
        let event = reply(&mut master, 1, torque(1.0).encode(), ms(23));
        assert!(!matches!(event, Some(Event::Feedback { .. })), "{is_newer_in_flight}: {event:?}");
        // The next one is executed.
        let event = reply(&mut master, 1, [0xA1, 0x32, 0, 0, 0, 0, 0, 0], ms(24));
        let is_feedback = matches!(event, Some(Event::Feedback { .. }));
        assert_eq!(is_feedback, is_newer_in_flight, "{event:?}");
    }
}

#[test]
fn a_stream_does_not_go_on_by_itself_after_a_restart() {
    let mut master = Master::<2>::new(Config::CAN);
    let mut now = 0;
    master.set_point(id(1), motion(), ms(0)).unwrap();
    sent(&mut master, ms(0));
    motion_feedback(&mut master, ms(1)).unwrap();
    // Silent for 1 s, as long as a restart takes: the first set-point that it heard then would move it.
    let told = loop {
        now += 5;
        master.set_point(id(1), motion(), ms(now)).unwrap();
        sent(&mut master, ms(now));
        let told = events(&mut master, ms(now + 4));
        if told.contains(&Event::Restarted { motor: id(1) }) {
            break now;
        }
        assert!(now < 2_000, "{told:?}");
    };
    assert!((1_000..1_030).contains(&told), "{told}");
    let refused = master.set_point(id(1), motion(), ms(now + 5));
    assert_eq!(refused, Err(RequestError::Restarted));
    assert_eq!(sent(&mut master, ms(now + 5)), []);
    // Its answer says so once more: now it can be asked where it is.
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(now + 100));
    reply(&mut master, 1, ANGLE_REPLY, ms(now + 101)).unwrap();
    assert!(events(&mut master, ms(now + 101)).contains(&Event::Restarted { motor: id(1) }));
    let moved = master.request(
        id(1),
        IncrementalPosition { max_speed: MaxSpeed::from_raw(10), angle: Angle::from_raw(100) },
    );
    assert!(matches!(moved, Err(RequestError::Restarted)));
    master.resume(id(1));
    assert!(master.set_point(id(1), motion(), ms(now + 5)).is_ok());
}

#[test]
fn a_run_time_that_goes_back_is_that_of_a_restart() {
    let mut master = Master::<2>::new(Config::CAN);
    for (at, run_time) in [(0, 60_000_u32), (10, 60_010), (20, 300)] {
        let _ = ask(&mut master, 1, ReadRunTime, ms(at));
        let [a, b, c, d] = run_time.to_le_bytes();
        reply(&mut master, 1, [0xB1, 0, 0, 0, a, b, c, d], ms(at + 1)).unwrap();
        let told = events(&mut master, ms(at + 1));
        assert_eq!(told.contains(&Event::Restarted { motor: id(1) }), at == 20, "{told:?}");
    }
}

#[test]
fn a_motor_that_reports_no_more_may_be_asked_again() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, report_angle(Switch::On), ms(0));
    events(&mut master, ms(7));
    for now in (10..2_000).step_by(10) {
        reply(&mut master, 1, ANGLE_REPLY, ms(now)).unwrap();
        master.handle_timeout(ms(now));
    }
    assert!(master.request(id(1), ReadMultiTurnAngle).is_err());
    master.handle_timeout(ms(3_100));
    assert!(master.request(id(1), ReadMultiTurnAngle).is_ok());
}

#[test]
fn a_motor_that_rested_for_long_does_not_starve() {
    let mut master = Master::<2>::new(Config::CAN);
    let mut now = ms(0);
    let _ = ask(&mut master, 2, ReadModel, now);
    reply(&mut master, 2, *b"\xB5X8S2V10", ms(1)).unwrap();
    for _ in 0..300 {
        now += Duration::from_millis(1);
        master.set_point(id(1), torque(1.0), now).unwrap();
        sent(&mut master, now);
        reply(&mut master, 1, [0xA1, 30, 0, 0, 0, 0, 7, 0], now + Duration::from_micros(900));
    }
    now += Duration::from_millis(1);
    master.set_point(id(1), torque(1.0), now).unwrap();
    let _read = master.request(id(2), ReadModel).unwrap();
    assert_eq!(sent(&mut master, now).len(), 2);
}

#[test]
fn tickets_are_never_the_same() {
    let mut master = Master::<2>::new(Config::CAN);
    let first = ask(&mut master, 1, ReadModel, ms(0));
    reply(&mut master, 1, *b"\xB5X8S2V10", ms(1)).unwrap();
    let mut now = 2;
    for _ in 0..300 {
        assert!(master.forget(id(1)));
        let next = ask(&mut master, 1, ReadModel, ms(now));
        let event = reply(&mut master, 1, *b"\xB5X8S2V10", ms(now + 1)).unwrap();
        assert!(first.outcome(&event).is_none() && next.outcome(&event).is_some());
        now += 2;
    }
}

#[test]
fn on_rs485_the_living_are_stopped_before_the_dead() {
    let mut master = Master::<4>::new(Config::rs485(1_000_000, false));
    let line = |motor, data| Frame { address: Target::Motor(id(motor)), data };
    let mut now = ms(0);
    for motor in 1..=4 {
        let once = Patience { reply_timeout: Duration::from_millis(5), attempts: 1 };
        let _ticket = master.request_with(id(motor), ReadModel, once).unwrap();
        assert_eq!(sent(&mut master, now).len(), 1);
        now += Duration::from_millis(1);
        if motor == 4 {
            master.handle_line(&line(4, *b"\xB5X8S2V10"), now).unwrap();
        }
        now += Duration::from_millis(6);
        events(&mut master, now);
    }
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, now)[0].channel, Channel::Command(Target::All));
    now += Duration::from_millis(6);
    assert_eq!(sent(&mut master, now)[0].channel, Channel::Command(Target::Motor(id(4))));
}

#[test]
fn a_stop_that_is_lifted_before_it_was_sent_is_sent_all_the_same() {
    let mut master = Master::<2>::new(Config::CAN);
    let _read = master.request(id(1), ReadModel).unwrap();
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    master.lift_stop();
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    let packets = sent(&mut master, ms(0));
    assert_eq!(packets[0].data, Stop.encode(), "before anything newer");
}

#[test]
fn a_motor_that_is_ahead_stays_so() {
    let mut master = Master::<8>::new(Config::CAN);
    // Motor 1 is a round ahead of motor 2, whose reply waits for the bus.
    stream_to(&mut master, 1..=1, ms(0));
    sent(&mut master, ms(0));
    feedback_of_all(&mut master, 1..=1, ms(1));
    stream_to(&mut master, 1..=2, ms(1));
    assert_eq!(sent(&mut master, ms(1)).len(), 2);
    feedback_of_all(&mut master, 1..=1, ms(2));
    stream_to(&mut master, 1..=1, ms(2));
    assert_eq!(sent(&mut master, ms(2)), [], "not two rounds");
}

#[test]
fn a_set_point_that_was_pushed_out_does_not_go_before_a_stop_that_waits() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    let pushed_out = sent(&mut master, ms(0))[0];
    let _stop = master.request(id(1), Shutdown).unwrap();
    assert_eq!(sent(&mut master, ms(0)), [], "it waits for the feedback");
    master.handle_pushed_out(&pushed_out);
    assert_eq!(sent(&mut master, ms(1))[0].data, Shutdown.encode());
    assert!(events(&mut master, ms(1)).contains(&Event::SetPointDropped { motor: id(1) }));
    assert!(reply(&mut master, 1, Shutdown.encode(), ms(2)).is_some());
    assert_eq!(sent(&mut master, ms(3)), []);
}

#[test]
fn a_drive_that_lost_its_master_before_it_was_known_ignores_its_first_command() {
    let mut master = Master::<2>::new(Config::CAN);
    let lost = reply(&mut master, 1, [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0], ms(0));
    assert_eq!(lost, Some(Event::LostMaster { motor: id(1) }));
    let read = ask(&mut master, 1, ReadMultiTurnAngle, ms(1));
    assert_eq!(reply(&mut master, 1, ReadMultiTurnAngle.encode(), ms(2)), None);
    assert_eq!(sent(&mut master, ms(2)).len(), 1, "once more");
    let event = reply(&mut master, 1, ANGLE_REPLY, ms(3)).unwrap();
    assert!(read.outcome(&event).unwrap().is_ok());
}

#[test]
fn a_stop_that_a_drive_has_ignored_goes_again_also_after_its_last_attempt() {
    let mut master = Master::<2>::new(Config::CAN);
    reply(&mut master, 1, [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0], ms(0)).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    let mut last = ms(1);
    assert_eq!(sent(&mut master, last).len(), 1);
    // Fifteen in all.
    for _ in 1..15 {
        last += Config::CAN.reply_timeout;
        assert_eq!(events(&mut master, last), []);
        assert_eq!(sent(&mut master, last).len(), 1);
    }
    let answered = last + Duration::from_millis(1);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), answered), None, "it is ignored");
    assert_eq!(events(&mut master, answered), []);
    assert_eq!(sent(&mut master, answered)[0].data, Shutdown.encode());
    let confirmed = Some(Event::StopConfirmed { motor: id(1) });
    assert_eq!(
        reply(&mut master, 1, Shutdown.encode(), answered + Duration::from_millis(1)),
        confirmed
    );
}

#[test]
fn what_was_switched_off_is_switched_on_by_no_other_stop() {
    let mut master = Master::<4>::new(Config::CAN);
    let first_stops = |master: &mut Master<4>, now| -> Vec<(u8, u8)> {
        let stops = sent(master, now);
        let motors = stops.iter().filter_map(|packet| match packet.channel {
            Channel::Command(Target::Motor(motor)) => Some((motor.get(), packet.data[0])),
            _ => None,
        });
        let stops_of = motors.collect();
        for packet in stops {
            let Channel::Command(Target::Motor(motor)) = packet.channel else { continue };
            reply(master, motor.get(), packet.data, now + Duration::from_millis(1));
        }
        stops_of
    };
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(first_stops(&mut master, ms(0)), [(1, 0x80)]);
    // As whoever leaves a control loop does.
    master.stop_all(StopKind::Hold, id(2).into()).unwrap();
    assert_eq!(first_stops(&mut master, ms(100)), [(1, 0x80), (2, 0x81)]);
    master.lift_stop_of(id(1));
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(first_stops(&mut master, ms(200)), [(1, 0x80)], "all are stopped still");
    master.lift_stop();
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(first_stops(&mut master, ms(300)), [(1, 0x81)]);

    // Nor by one to all at once.
    let mut line = Master::<4>::new(Config::rs485(115_200, false));
    line.stop(id(1), StopKind::Off).unwrap();
    line.stop_all(StopKind::Hold, id(2).into()).unwrap();
    let first = line.poll_transmit(ms(0)).unwrap();
    assert_eq!((first.channel, first.data[0]), (Channel::Command(id(1).into()), 0x80));
}

#[test]
fn an_ignored_command_goes_once_more_only_if_that_is_harmless_and_attempts_are_left() {
    let once = Patience { reply_timeout: Duration::from_millis(5), attempts: 1 };
    let twice = Patience { attempts: 2, ..once };
    let not_executed = Failure::NotExecuted;
    let mut master = Master::<2>::new(Config::CAN);
    reply(&mut master, 1, [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0], ms(0));
    let moved = master.request_with(id(1), step(), twice).unwrap();
    sent(&mut master, ms(1));
    assert_eq!(reply(&mut master, 1, step().encode(), ms(2)), None);
    assert_eq!(sent(&mut master, ms(2)), []);
    assert_eq!(moved.outcome(&events(&mut master, ms(2))[0]), Some(Err(not_executed)));

    reply(&mut master, 2, [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0], ms(10));
    let read = master.request_with(id(2), ReadMultiTurnAngle, once).unwrap();
    sent(&mut master, ms(11));
    assert_eq!(reply(&mut master, 2, ReadMultiTurnAngle.encode(), ms(12)), None);
    assert_eq!(sent(&mut master, ms(12)), []);
    assert_eq!(read.outcome(&events(&mut master, ms(12))[0]), Some(Err(not_executed)));
}

#[test]
fn a_motor_that_nobody_asked_for_long_has_not_restarted() {
    let mut master = Master::<2>::new(Config::CAN);
    for at in [0, 2_000] {
        let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(at));
        reply(&mut master, 1, ANGLE_REPLY, ms(at + 1)).unwrap();
        assert_eq!(events(&mut master, ms(at + 1)), []);
    }
}

#[test]
fn a_motor_that_reports_seldom_is_waited_for_longer() {
    let mut master = Master::<2>::new(Config::CAN);
    let interval = ReportInterval::from_raw(100); // 1 s
    let _ = ask(&mut master, 1, ActiveReply { interval, ..report_angle(Switch::On) }, ms(0));
    events(&mut master, ms(7));
    reply(&mut master, 1, ANGLE_REPLY, ms(1_000)).unwrap();
    // Three intervals, and the second that a restart takes.
    master.handle_timeout(ms(4_999));
    assert!(master.request(id(1), ReadMultiTurnAngle).is_err());
    master.handle_timeout(ms(5_000));
    assert!(master.request(id(1), ReadMultiTurnAngle).is_ok());
}

#[test]
fn a_broadcast_that_waits_is_dropped_by_a_stop_and_by_a_bus_that_is_down() {
    let ends: [fn(&mut Master<2>); 3] = [
        |master| master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap(),
        |master| master.stop(id(2), StopKind::Hold).unwrap(),
        |master| master.handle_bus_down(ms(0)),
    ];
    for end in ends {
        let mut master = Master::<2>::new(Config::CAN);
        master.broadcast(step(), id(1).into()).unwrap();
        end(&mut master);
        let is_step = |packet: &Packet| packet.data == step().encode();
        assert!(!sent(&mut master, ms(0)).iter().any(is_step));
        let silent = id(1).into();
        assert!(
            events(&mut master, ms(0)).contains(&Event::BroadcastDone { silent, was_sent: false })
        );
    }
}

#[test]
fn whom_a_broadcast_may_move_is_stopped_with_all() {
    let both: MotorSet = [1, 2].into_iter().map(id).collect();
    type Put = fn(&mut Master<2>, MotorSet) -> Result<(), RequestError>;
    let puts: [(Put, usize); 3] = [
        // One to all, who may be more, and one each.
        (|master, both| master.broadcast(torque(1.0), both), 3),
        (|master, both| master.broadcast(ReleaseBrake, both), 3),
        (|master, both| master.broadcast(ReadMultiTurnAngle, both), 0),
    ];
    for (put, stops) in puts {
        let mut master = Master::<2>::new(Config::CAN);
        put(&mut master, both).unwrap();
        assert_eq!(sent(&mut master, ms(0)).len(), 1);
        master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
        let data: Vec<Data> = sent(&mut master, ms(1)).iter().map(|packet| packet.data).collect();
        assert_eq!(data, [Stop.encode(); 3][..stops]);
    }
}

#[test]
fn a_broadcast_that_may_move_more_motors_than_there_is_room_for_is_refused() {
    let mut master = Master::<2>::new(Config::CAN);
    let too_many = Err(RequestError::TooManyMotors { capacity: 2 });
    let three = [1, 2, 3].into_iter().map(id).collect();
    assert_eq!(master.broadcast(torque(1.0), three), too_many);
    let _ = ask(&mut master, 3, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 3, ANGLE_REPLY, ms(1)).unwrap();
    let two = [1, 2].into_iter().map(id).collect();
    assert_eq!(master.broadcast(torque(1.0), two), too_many, "motor 3 has a place");
    assert_eq!(sent(&mut master, ms(1)), []);
    assert_eq!(master.motors(), id(3).into(), "nobody was given one for it");
    // What moves nobody is asked of all, and so is what moves as many as there are places.
    master.broadcast(ReadMultiTurnAngle, three).unwrap();
    assert_eq!(master.motors(), id(3).into());
    master.handle_bus_down(ms(2));
    events(&mut master, ms(2));
    master.broadcast(torque(1.0), [1, 3].into_iter().map(id).collect()).unwrap();
}

#[test]
fn only_a_motor_that_has_a_place_and_nothing_under_way_is_forgotten() {
    let mut master = Master::<2>::new(Config::CAN);
    assert!(!master.forget(id(1)), "it was never known");
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    assert!(!master.forget(id(1)), "it is being asked");
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    assert!(master.forget(id(1)));
    assert_eq!(master.motors(), MotorSet::EMPTY);
}

#[test]
fn a_stop_in_the_place_of_another_tells_of_no_request() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Hold).unwrap();
    sent(&mut master, ms(0));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(events(&mut master, ms(0)), []);
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(events(&mut master, ms(0)), []);
}

#[test]
fn a_frame_holds_up_those_that_are_queued() {
    let mut master = Master::<32>::new(Config::CAN);
    for motor in 1..=20 {
        let _ticket = master.request(id(motor), ReadMultiTurnAngle).unwrap();
    }
    assert_eq!(sent(&mut master, ms(0)).len(), 20);
    // A frame takes 136 us, and three more without any make a quiet bus.
    assert_eq!(master.poll_at(), Some(Instant::from_micros(23 * 136)));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    assert_eq!(master.poll_at(), Some(Instant::from_micros(24 * 136)));
    // None is queued any more.
    reply(&mut master, 2, ANGLE_REPLY, ms(4)).unwrap();
    assert_eq!(master.poll_at(), Some(Instant::from_micros(4_000 + 3 * 136)));
}

#[test]
fn what_a_motor_without_a_place_says_is_a_report_if_it_can_be_one() {
    let mut master = Master::<2>::new(Config::CAN);
    let angle = reply(&mut master, 1, ANGLE_REPLY, ms(0)).unwrap();
    assert!(matches!(angle, Event::Report { .. }), "{angle:?}");
    let gain = reply(&mut master, 1, [0x30, 4, 0, 0, 0, 0, 0x80, 0x3F], ms(1)).unwrap();
    assert!(matches!(gain, Event::Stray { .. }), "{gain:?}");
}

#[test]
fn the_newest_feedback_of_a_stream_is_kept() {
    let mut master = Master::<2>::new(Config::CAN);
    assert_eq!(master.latest_feedback(id(1)), None);
    for (at, angle) in [(0, 45), (10, 46)] {
        master.set_point(id(1), torque(1.0), ms(at)).unwrap();
        sent(&mut master, ms(at));
        let event = reply(&mut master, 1, [0xA1, 0x32, 0x64, 0, 0, 0, angle, 0], ms(at + 1));
        let Some(Event::Feedback { reply, .. }) = event else { panic!("{event:?}") };
        assert_eq!(master.latest_feedback(id(1)), Some((reply, ms(at + 1))));
    }
}

#[test]
fn a_motor_with_nothing_to_do_by_itself_is_not_looked_at() {
    let mut master = Master::<2>::new(Config::CAN);
    let _reset = ask(&mut master, 1, Reset, ms(0));
    events(&mut master, ms(0));
    assert_eq!(master.due, ms(2_000), "when it has restarted, and no sooner");
    master.handle_timeout(ms(2_000));
    assert!(!master.motors[0].lingers());
    assert!(master.places.waiting.is_empty() && !master.is_anything_in_flight());
    let _read = master.request(id(1), ReadMultiTurnAngle).unwrap();
    assert_eq!(master.poll_at(), None, "it waits for the bus alone");
    assert!(master.places.stops.is_empty());
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(master.places.stops.count(), 1);
}

/// Streams a set-point at this time; after how many milliseconds it counts as lost.
fn is_lost_after(master: &mut Master<2>, now: u64) -> Option<u64> {
    master.set_point(id(1), torque(1.0), ms(now)).unwrap();
    sent(master, ms(now));
    let unanswered = [Event::SetPointUnanswered { motor: id(1) }];
    (1..30).find(|after| events(master, ms(now + after)) == unanswered)
}

#[test]
fn feedback_counts_as_lost_soon_only_where_it_is_known_how_long_it_takes() {
    let mut master = Master::<2>::new(Config::CAN);
    assert_eq!(is_lost_after(&mut master, 0), Some(21), "nothing was ever answered");

    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    sent(&mut master, ms(0));
    reply(&mut master, 1, [0xA1, 0x32, 0x64, 0, 0, 0, 45, 0], ms(1)).unwrap();
    // Three times as long as usual; but not when it stays away again and again.
    for (at, after) in [(100, 3), (200, 3), (300, 21)] {
        assert_eq!(is_lost_after(&mut master, at), Some(after));
    }
}

#[test]
fn feedback_that_takes_long_is_waited_for_no_longer_than_a_reply() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    sent(&mut master, ms(0));
    reply(&mut master, 1, [0xA1, 0x32, 0x64, 0, 0, 0, 45, 0], ms(10)).unwrap();
    // Three times as long as usual would be 30 ms.
    assert_eq!(is_lost_after(&mut master, 100), Some(21));
}

#[test]
fn on_a_busy_bus_feedback_is_waited_for() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    sent(&mut master, ms(0));
    reply(&mut master, 1, [0xA1, 0x32, 0x64, 0, 0, 0, 45, 0], ms(1)).unwrap();
    master.set_point(id(1), torque(1.0), ms(100)).unwrap();
    sent(&mut master, ms(100));
    for micros in (100_200..115_000).step_by(200) {
        let now = Instant::from_micros(micros);
        reply(&mut master, 2, ANGLE_REPLY, now).unwrap();
        assert_eq!(events(&mut master, now), []);
    }
}

#[test]
fn the_fourth_question_waits_for_the_end_of_the_first_that_was_given_up() {
    let once = Patience { reply_timeout: Duration::from_millis(5), attempts: 1 };
    let mut master = Master::<2>::new(Config::CAN);
    for index in [1, 4, 5] {
        let at = 10 * u64::from(index);
        let index = PidIndex::from_raw(index);
        let _ticket = master.request_with(id(1), ReadPid { index }, once).unwrap();
        sent(&mut master, ms(at));
        assert_eq!(events(&mut master, ms(at + 5)).len(), 1, "it is given up");
    }
    let _ticket = master.request(id(1), ReadMultiTurnAngle).unwrap();
    assert_eq!(sent(&mut master, ms(55)), []);
    // Late replies to the first may come for 40.8 ms.
    let end = Instant::from_micros(15_000 + 40_816);
    assert_eq!(master.poll_at(), Some(end));
    assert_eq!(sent(&mut master, end).len(), 1);
}

#[test]
fn a_broadcast_that_was_pushed_out_is_sent_again() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    let packets = sent(&mut master, ms(0));
    assert_eq!(sent(&mut master, ms(0)), []);
    master.handle_pushed_out(&packets[0]);
    assert_eq!(sent(&mut master, ms(0)), packets);
}

#[test]
fn a_broadcast_that_nobody_answers_and_was_pushed_out_is_sent_again_before_it_is_told() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(Reset, MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(0));
    master.handle_pushed_out(&packets[0]);
    assert_eq!(events(&mut master, ms(0)), []);
    assert_eq!(sent(&mut master, ms(0)), packets);
    assert_eq!(
        events(&mut master, ms(0)),
        [Event::BroadcastDone { silent: MotorSet::EMPTY, was_sent: true }]
    );
}

fn packet_to_all(data: [u8; 8]) -> Packet {
    Packet { channel: Channel::Command(Target::All), data }
}

#[test]
fn no_older_set_point_or_move_follows_what_ends_the_motion_of_all() {
    let mut master = Master::<4>::new(Config::CAN);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    let waiting = master.request(id(2), step()).unwrap();
    let read = master.request(id(3), ReadMultiTurnAngle).unwrap();
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    let mut packets = sent(&mut master, ms(0));
    assert_eq!(packets[0], packet_to_all(Shutdown.encode()));
    let told = events(&mut master, ms(0));
    assert!(told.contains(&Event::SetPointDropped { motor: id(1) }), "{told:?}");
    assert!(told.iter().any(|event| waiting.outcome(event) == Some(Err(Failure::Stopped))));
    assert!(!told.iter().any(|event| read.outcome(event).is_some()));
    packets.extend(sent(&mut master, ms(100)));
    let to_motor_3 = Channel::Command(id(3).into());
    assert!(packets[1..].iter().all(|packet| packet.channel == to_motor_3), "{packets:?}");
}

#[test]
fn a_set_point_that_was_pushed_out_by_what_ends_the_motion_of_all_is_not_sent_again() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    let pushed_out = sent(&mut master, ms(0))[0];
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(0)), [packet_to_all(Shutdown.encode())]);
    master.handle_pushed_out(&pushed_out);
    assert_eq!(sent(&mut master, ms(1)), []);
}

#[test]
fn a_stop_is_not_confirmed_by_the_answer_to_an_earlier_one_to_all() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    master.broadcast(Stop, id(1).into()).unwrap();
    sent(&mut master, ms(1));
    // It moves again, and is stopped by itself.
    master.set_point(id(1), torque(1.0), ms(1)).unwrap();
    sent(&mut master, ms(1));
    reply(&mut master, 1, [0xA1, 30, 0, 0, 0, 0, 7, 0], ms(2)).unwrap();
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(sent(&mut master, ms(3)).len(), 1);
    let told = reply(&mut master, 1, Stop.encode(), ms(4));
    assert_ne!(
        told,
        Some(Event::StopConfirmed { motor: id(1) }),
        "that to all is not answered yet"
    );
    assert_eq!(sent(&mut master, ms(4)).len(), 1);
    let confirmed = Some(Event::StopConfirmed { motor: id(1) });
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(5)), confirmed);
}

#[test]
fn a_stop_is_confirmed_only_when_no_command_to_all_can_move_the_motor_any_more() {
    // On CAN a stop (0x141) overtakes a command to all (0x280) that waits in another mailbox.
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    master.broadcast(torque(1.0), id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(1)).len(), 1);
    // Motor 2 gets its place only now.
    let both = [1, 2].into_iter().map(id).collect();
    master.stop_all(StopKind::Off, both).unwrap();
    assert_eq!(sent(&mut master, ms(1)).len(), 3, "to all, and to each");
    for (motor, now) in [(1, 2), (2, 2), (1, 3), (2, 3)] {
        assert_eq!(reply(&mut master, motor, Shutdown.encode(), ms(now)), None, "{motor}");
    }
    assert_eq!(sent(&mut master, ms(3)), []);
    // Motor 1 answers what was sent to all, motor 2 does not.
    reply(&mut master, 1, [0xA1, 30, 0, 0, 0, 0, 7, 0], ms(4)).unwrap();
    assert_eq!(sent(&mut master, ms(4)).len(), 1);
    let confirmed = |motor| Some(Event::StopConfirmed { motor: id(motor) });
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(5)), confirmed(1));
    let at = master.poll_at().unwrap();
    assert!(at > ms(20) && at < ms(100), "{at:?}");
    assert_eq!(sent(&mut master, at).len(), 1);
    let soon = at + Duration::from_millis(1);
    assert_eq!(reply(&mut master, 2, Shutdown.encode(), soon), confirmed(2));
}

#[test]
fn while_the_bus_is_down_a_command_to_all_does_not_grow_old() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
    let pushed_out = sent(&mut master, ms(1))[0];
    assert_eq!(
        events(&mut master, ms(1)),
        [Event::BroadcastDone { silent: MotorSet::EMPTY, was_sent: true }]
    );
    // It lies in a queue for as long as the bus is down.
    master.handle_bus_down(ms(60));
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(90)).len(), 2, "to all, and to motor 1");
    for now in [91, 92] {
        assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(now)), None);
        assert_eq!(sent(&mut master, ms(now)), []);
    }
    // Handed back it was never sent, and nothing moves any more.
    master.handle_pushed_out(&pushed_out);
    assert_eq!(sent(&mut master, ms(93)).len(), 1);
    let confirmed = Some(Event::StopConfirmed { motor: id(1) });
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(94)), confirmed);
}

#[test]
fn what_may_still_move_the_motor_makes_way_for_no_other_late_reply() {
    let mut master = Master::<2>::new(Config::CAN);
    let once = Patience { attempts: 1, reply_timeout: Duration::from_millis(5) };
    // A move and a read were given up, and a second read is in flight when the motor is stopped.
    let _ = master.request_with(id(1), step(), once).unwrap();
    sent(&mut master, ms(0));
    events(&mut master, ms(5));
    let _ = master.request_with(id(1), ReadMultiTurnAngle, once).unwrap();
    sent(&mut master, ms(5));
    events(&mut master, ms(10));
    let _ = master.request_with(id(1), ReadModel, once).unwrap();
    sent(&mut master, ms(10));
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(11));
    // Once more before an answer came.
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(12));
    // The first is the answer to the earlier stop; after the second the move may yet come.
    for now in [13, 14, 15] {
        let told = reply(&mut master, 1, Shutdown.encode(), ms(now));
        assert_ne!(told, Some(Event::StopConfirmed { motor: id(1) }), "after {now} ms");
        sent(&mut master, ms(now));
    }
}

#[test]
fn a_move_that_waited_before_a_restart_was_seen_is_not_sent() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    sent(&mut master, ms(0));
    reply(&mut master, 1, [0xA1, 30, 0, 0, 0, 0, 7, 0], ms(1)).unwrap();
    for now in [10, 40, 70] {
        master.set_point(id(1), torque(1.0), ms(now)).unwrap();
        sent(&mut master, ms(now));
        events(&mut master, ms(now + 25));
    }
    master.set_point(id(1), torque(1.0), ms(1_200)).unwrap();
    sent(&mut master, ms(1_200));
    let moving = master.request(id(1), step()).unwrap();
    reply(&mut master, 1, [0xA1, 30, 0, 0, 0, 0, 7, 0], ms(1_201)).unwrap();
    assert_eq!(sent(&mut master, ms(1_201)), []);
    let told = events(&mut master, ms(1_201));
    assert!(told.contains(&Event::Restarted { motor: id(1) }), "{told:?}");
    assert!(told.iter().any(|event| moving.outcome(event) == Some(Err(Failure::Dropped))));
}

#[test]
fn a_motor_that_was_forgotten_ignores_its_first_command_all_the_same() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    reply(&mut master, 1, [0xF1, 0, 0, 0, 0, 0, 0, 0], ms(2)).unwrap();
    assert!(master.forget(id(1)));
    let _ = ask(&mut master, 1, Shutdown, ms(3));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(4)), None, "it was ignored");
    assert_eq!(sent(&mut master, ms(4)).len(), 1);
}

#[test]
fn who_asks_all_again_and_again_keeps_nobody_else_waiting() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadModel, ms(0));
    reply(&mut master, 1, *b"\xB5X8S2V10", ms(1)).unwrap();
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    sent(&mut master, ms(1));
    let _waiting = master.request(id(1), ReadModel).unwrap();
    for now in 2..10 {
        let told = reply(&mut master, 1, ANGLE_REPLY, ms(now));
        assert!(matches!(told, Some(Event::BroadcastReply { .. })));
        // As the loops do: what can be sent is sent before the next event is told.
        let packets = sent(&mut master, ms(now));
        if packets.iter().any(|packet| packet.data[0] == 0xB5) {
            return;
        }
        assert!(
            events(&mut master, ms(now))
                .contains(&Event::BroadcastDone { silent: MotorSet::EMPTY, was_sent: true })
        );
        master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
        sent(&mut master, ms(now));
    }
    panic!("it never got its turn");
}

#[test]
fn a_set_point_that_was_pushed_out_when_it_is_too_old_is_not_sent_again() {
    let mut master = Master::<2>::new(Config::can(250_000));
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    let pushed_out = sent(&mut master, ms(0))[0];
    master.handle_timeout(ms(51));
    // The loops hand it back between two sendings.
    master.handle_pushed_out(&pushed_out);
    assert_eq!(master.poll_transmit(ms(51)), None);
    assert_eq!(events(&mut master, ms(51)), [Event::SetPointDropped { motor: id(1) }]);
}

#[test]
fn while_the_bus_is_down_what_moves_does_not_grow_old() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    sent(&mut master, ms(0));
    assert_eq!(events(&mut master, ms(21)), [Event::SetPointUnanswered { motor: id(1) }]);
    master.handle_bus_down(ms(55));
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(80));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(81)), None, "40 ms from then");
}

#[test]
fn on_a_line_feedback_that_is_lost_holds_the_others_up_for_three_usual_times_and_no_longer() {
    let config = Config::rs485(1_000_000, false);
    let line = |motor, data| Frame { address: Target::Motor(id(motor)), data };
    let feedback = [0xA1, 0x32, 0x64, 0, 0, 0, 45, 0];
    for (config, usual_us, lost_after_us) in [
        // Three times 0.9 ms; no sooner than 2 ms; and no later than any reply.
        (config, 900, 2_700),
        (config, 500, 2_000),
        (config, 3_000, config.reply_timeout.as_micros()),
    ] {
        let mut master = Master::<2>::new(config);
        let mut now = ms(0);
        master.set_point(id(1), torque(1.0), now).unwrap();
        assert_eq!(sent(&mut master, now).len(), 1);
        now += Duration::from_micros(usual_us);
        master.handle_line(&line(1, feedback), now).unwrap();
        let timeouts = [lost_after_us, lost_after_us, config.reply_timeout.as_micros()];
        // Not where it stays away again and again.
        for timeout in timeouts.map(Duration::from_micros) {
            now += Duration::from_millis(1);
            master.set_point(id(1), torque(1.0), now).unwrap();
            assert_eq!(sent(&mut master, now).len(), 1);
            master.set_point(id(2), torque(1.0), now).unwrap();
            let before = now + (timeout - Duration::from_micros(1));
            assert_eq!(events(&mut master, before), [], "{usual_us}");
            assert!(sent(&mut master, before).is_empty());
            assert_eq!(master.poll_at(), Some(now + timeout), "{usual_us}");
            now += timeout;
            assert_eq!(events(&mut master, now), [Event::SetPointUnanswered { motor: id(1) }]);
            assert_eq!(sent(&mut master, now)[0].channel, Channel::Command(id(2).into()));
            now += Duration::from_micros(usual_us);
            master.handle_line(&line(2, feedback), now).unwrap();
        }
    }
}
