//! How answers find their questions, and what becomes of those that come late, twice or never.

use super::*;

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
    let reported = events(&mut master, ms(21));
    assert_eq!(ticket.outcome(&reported[0]), Some(Err(Failure::NoReply)));
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
            let reported = events(&mut master, start + Duration::from_secs(10));
            assert_eq!(ticket.outcome(&reported[0]), Some(Err(Failure::NoReply)));
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
fn late_answer_does_not_answer_the_next_request() {
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
fn duplicate_answer_does_not_answer_the_next_request() {
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

/// The drive answers everything twice, 0.3 ms apart.
#[test]
fn second_copy_of_each_answer_is_a_stray() {
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

/// Its second answer may be taken for that to the next question. Then the answer to that one is left over.
#[test]
fn drive_that_answers_everything_twice_is_noticed_however_late_its_second_answers_are() {
    for later in [300, 600, 900, 2_000] {
        let mut master = Master::<2>::new(Config::CAN);
        let (mut coming, mut asked) = (Vec::new(), None);
        let (mut questions, mut answers, mut strays) = (0, 0, 0);
        for now in (0..50_000).step_by(100) {
            let at = Instant::from_micros(now);
            for _ in coming.iter().filter(|it| **it == now) {
                let event = reply(&mut master, 1, ANGLE_REPLY, at).unwrap();
                let is_it = |ticket: &Ticket<_>| ticket.outcome(&event).is_some();
                if asked.take_if(|ticket| is_it(ticket)).is_some() {
                    answers += 1;
                } else {
                    assert!(matches!(event, Event::Stray { .. }), "{event:?}");
                    strays += 1;
                }
            }
            if asked.is_none() && questions < 20 {
                // The next question is sent as soon as this one is answered.
                asked = Some(ask(&mut master, 1, ReadMultiTurnAngle, at));
                questions += 1;
                coming.extend([now + 800, now + 800 + later]);
            }
        }
        // 40 answers to 20 questions.
        assert_eq!((answers, strays), (20, 20), "{later} us");
        assert_eq!(master.health(id(1)).stray, 20, "{later} us");
    }
}

#[test]
fn answers_at_the_same_instant_count_where_the_clock_is_coarse() {
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
    let reported = events(&mut master, ms(0));
    assert!(reported.iter().any(|event| reset.outcome(event) == Some(Ok(NoReply))), "{reported:?}");
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
    let reported = events(&mut master, ms(0));
    assert_eq!(ticket.outcome(&reported[0]), Some(Ok(change)));
    let echo = reply(&mut master, 1, change.encode(), ms(1)).unwrap();
    assert!(matches!(echo, Event::Stray { .. }));
    // Other functions wait for theirs.
    let filter = FunctionControl::CanIdFilter(Switch::On);
    let ticket = ask(&mut master, 2, filter, ms(1));
    let event = reply(&mut master, 2, filter.encode(), ms(2)).unwrap();
    assert_eq!(ticket.outcome(&event), Some(Ok(filter)));
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
fn encoded_bytes_overrule_the_claimed_kind_of_a_command() {
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
fn reply_timeout_of_zero_still_lets_a_reply_arrive() {
    let mut master = Master::<2>::new(Config::CAN);
    let ticket = master.request_with(id(1), ReadModel, once(0)).unwrap();
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
    // 1 ms, then an eighth of twice that.
    assert_eq!(master.health(id(1)).round_trip, Duration::from_micros(1_125));
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
    let feedback = TORQUE_REPLY;
    let late = reply(&mut master, 1, feedback, ms(30)).unwrap();
    assert!(matches!(late, Event::Feedback { .. }) && ticket.outcome(&late).is_none(), "{late:?}");
    assert_eq!(sent(&mut master, ms(30)).len(), 1);
    let event = reply(&mut master, 1, feedback, ms(31)).unwrap();
    assert!(ticket.outcome(&event).is_some());
    assert!(master.set_point(id(1), torque(3.0), ms(31)).is_ok());
}

#[test]
fn wait_for_a_late_answer_ends_only_with_that_answer() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    sent(&mut master, ms(0));
    events(&mut master, ms(21));
    let _first = master.request_with(id(1), ReadMultiTurnAngle, once(5)).unwrap();
    sent(&mut master, ms(22));
    events(&mut master, ms(28));
    let second = master.request_with(id(1), ReadMultiTurnAngle, once(5)).unwrap();
    // Late feedback of the lost set-point, twice; an error report.
    for (data, at) in
        [(TORQUE_REPLY, 30), (TORQUE_REPLY, 30), ([0x9A, 50, 40, 0, 0xE0, 1, 2, 0], 35)]
    {
        reply(&mut master, 1, data, ms(at)).unwrap();
        assert!(sent(&mut master, ms(at)).is_empty(), "{data:02X?}");
    }
    let late = reply(&mut master, 1, ANGLE_REPLY, ms(40)).unwrap();
    assert!(second.outcome(&late).is_none());
    assert_eq!(sent(&mut master, ms(40)).len(), 1);
}

#[test]
fn late_window_begins_anew_when_the_bus_is_down() {
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
fn tickets_are_never_the_same() {
    let mut master = Master::<2>::new(Config::CAN);
    let mut earlier = Vec::new();
    for now in (0..600).step_by(2) {
        let ticket = ask(&mut master, 1, ReadModel, ms(now));
        let event = reply(&mut master, 1, *b"\xB5X8S2V10", ms(now + 1)).unwrap();
        assert!(matches!(ticket.outcome(&event), Some(Ok(_))));
        assert!(earlier.iter().all(|it: &Ticket<_>| it.outcome(&event).is_none()));
        earlier.push(ticket);
        assert!(master.forget(id(1)));
    }
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
fn motor_without_pending_work_has_no_deadline() {
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

#[test]
fn fourth_request_waits_until_the_first_given_up_cannot_be_answered() {
    let mut master = Master::<2>::new(Config::CAN);
    for index in [1, 4, 5] {
        let at = 10 * u64::from(index);
        let index = PidIndex::from_raw(index);
        let _ticket = master.request_with(id(1), ReadPid { index }, once(5)).unwrap();
        sent(&mut master, ms(at));
        assert_eq!(events(&mut master, ms(at + 5)).len(), 1, "it is given up");
    }
    let _ticket = master.request(id(1), ReadMultiTurnAngle).unwrap();
    assert_eq!(sent(&mut master, ms(55)), []);
    // A stop does not wait, nor does a command to all.
    let mut stopped = master.clone();
    stopped.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(sent(&mut stopped, ms(55)), [packet_to(1, Stop.encode())]);
    let mut all = master.clone();
    all.broadcast(ReadModel, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut all, ms(55)), [packet_to_all(ReadModel.encode())]);
    // Late replies to the first may come for 40.8 ms.
    let end = Instant::from_micros(15_000 + 40_816);
    assert_eq!(master.poll_at(), Some(end));
    assert_eq!(sent(&mut master, end).len(), 1);
}

/// A second answer to the first may come for 40.8 ms.
#[test]
fn read_of_another_kind_and_a_set_point_go_at_once_after_a_read_that_took_two_attempts() {
    let mut master = Master::<2>::new(Config::CAN);
    let angle = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    assert_eq!(sent(&mut master, ms(21)).len(), 1, "the second attempt");
    let event = reply(&mut master, 1, ANGLE_REPLY, ms(22)).unwrap();
    assert!(angle.outcome(&event).is_some());
    let model = master.request(id(1), ReadModel).unwrap();
    assert_eq!(sent(&mut master, ms(22)), [packet_to(1, ReadModel.encode())]);
    let event = reply(&mut master, 1, *b"\xB5X8S2V10", ms(23)).unwrap();
    assert!(model.outcome(&event).is_some());
    master.set_point(id(1), torque(1.0), ms(23)).unwrap();
    assert_eq!(sent(&mut master, ms(23)), [packet_to(1, torque(1.0).encode())]);
}

#[test]
fn motor_without_a_request_stays_present_while_the_bus_is_down() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    for now in 2..10 {
        master.handle_bus_down(ms(now));
    }
    assert_eq!(master.health(id(1)).presence, Presence::Present);
    // Nor is one that waits for its stop, which goes when the bus is back.
    master.stop(id(1), StopKind::Hold).unwrap();
    for now in 10..20 {
        master.handle_bus_down(ms(now));
    }
    assert_eq!(master.health(id(1)).presence, Presence::Present);
}

/// Within 500 us of an equal reply, or two frames where these take longer, a reply may be a duplicate.
#[test]
fn reply_500_us_or_two_frames_after_another_is_no_duplicate() {
    for (bit_rate, later, is_answer) in [
        (1_000_000, 499, false),
        (1_000_000, 500, true),
        (250_000, 1_081, false),
        (250_000, 1_082, true),
    ] {
        let at = |micros| Instant::from_micros(micros);
        let mut master = Master::<2>::new(Config {
            shortest_response: Duration::from_micros(272),
            ..Config::can(bit_rate)
        });
        let _ = ask(&mut master, 1, ReadMultiTurnAngle, at(0));
        reply(&mut master, 1, ANGLE_REPLY, at(2_000)).unwrap();
        let second = ask(&mut master, 1, ReadMultiTurnAngle, at(2_100));
        let reported = reply(&mut master, 1, ANGLE_REPLY, at(2_000 + later));
        let is_answered = reported.is_some_and(|event| second.outcome(&event).is_some());
        assert_eq!(is_answered, is_answer, "{bit_rate} bit/s: {later} us");
    }
}

#[test]
fn debug_output_of_a_ticket_shows_its_id() {
    let mut master = Master::<2>::new(Config::CAN);
    let ticket = master.request(id(2), ReadMultiTurnAngle).unwrap();
    assert_eq!(std::format!("{ticket:?}"), std::format!("Ticket({:?})", ticket.id()));
}

#[test]
fn late_replies_to_one_question_are_expected_until_the_latest_end() {
    use crate::master::late::{LateReplies, Of, Question};
    let question = Question::of(Kind::Known(Opcode::ReadModel), &ReadModel.encode());
    let mut late = LateReplies::default();
    let config = &Config::CAN;
    assert!(!late.expect(question, Of::Request, 1, ms(20), config));
    assert!(!late.expect(question, Of::RequestStopped, 1, ms(30), config));
    let end = Some(ms(30) + config.late_window);
    assert_eq!(late.next_end(), end);
    late.expect(question, Of::RequestStopped, 1, ms(10), config);
    assert_eq!(late.next_end(), end, "the longest counts");
    // Three of them, reported as the last was given up.
    for _ in 0..3 {
        let taken = late.take(&ReadModel.packet(id(1)), false);
        assert_eq!(taken.map(|(of, _)| of), Some(Of::RequestStopped));
    }
    assert_eq!(late.take(&ReadModel.packet(id(1)), false), None);
}

#[test]
fn immediate_answer_to_a_broadcast_counts_where_the_clock_is_coarse() {
    let config = Config { shortest_response: Duration::ZERO, ..Config::CAN };
    let mut master = Master::<2>::new(config);
    let t = ask(&mut master, 1, ReadMultiTurnAngle, ms(10));
    let event = reply(&mut master, 1, ANGLE_REPLY, ms(10)).unwrap();
    assert!(t.outcome(&event).is_some());
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(10)).len(), 1);
    let event = reply(&mut master, 1, ANGLE_REPLY, ms(10));
    assert!(matches!(event, Some(Event::BroadcastReply { .. })), "{event:?}");
}

#[test]
fn two_reports_at_the_same_instant_are_both_reports() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1));
    let _ = ask(&mut master, 1, report_angle(Switch::On), ms(2));
    while master.poll_event().is_some() {}
    for t in [20, 20] {
        let event = reply(&mut master, 1, ANGLE_REPLY, ms(t));
        assert!(matches!(event, Some(Event::Report { .. })), "{event:?}");
    }
}

/// The time-out of the first attempt was over, and the request waited for its second.
#[test]
fn request_dropped_between_attempts_delays_its_like_for_a_late_window() {
    for is_withdrawn in [true, false] {
        let mut master = Master::<2>::new(Config::CAN);
        let twice = Patience { reply_timeout: Duration::from_millis(5), attempts: 2 };
        let ticket = master.request_with(id(1), step(), twice).unwrap();
        assert_eq!(sent(&mut master, ms(0)).len(), 1);
        assert_eq!(events(&mut master, ms(5)), []);
        if is_withdrawn {
            master.withdraw(ticket.id());
        } else {
            master.handle_bus_down(ms(5));
        }
        assert_eq!(events(&mut master, ms(5)).len(), 1);
        let _again = master.request(id(1), step()).unwrap();
        assert_eq!(sent(&mut master, ms(6)), []);
        assert_eq!(sent(&mut master, ms(50)).len(), 1);
    }
}

/// Otherwise the report would name the ticket of the new request.
#[test]
fn request_is_refused_until_the_stopped_one_is_reported_as_failed() {
    let mut master = Master::<2>::new(Config::CAN);
    let first = master.request(id(1), ReadModel).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(0));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(1)), confirmed(1));
    assert_eq!(master.request(id(1), ReadModel).unwrap_err(), RequestError::Busy);
    assert!(!master.forget(id(1)), "nor is the motor forgotten");
    let stopped = Event::Failed { ticket: first.id(), failure: Failure::Stopped };
    assert_eq!(events(&mut master, ms(1)), [stopped]);
    assert!(master.request(id(1), ReadModel).is_ok());
}

#[test]
fn motor_with_unreported_failure_or_under_restart_is_not_forgotten() {
    let mut master = Master::<2>::new(Config::CAN);
    let _read = master.request_with(id(1), ReadModel, once(5)).unwrap();
    sent(&mut master, ms(0));
    master.handle_timeout(ms(5));
    assert!(!master.forget(id(1)));
    assert_eq!(events(&mut master, ms(5)).len(), 1);
    assert!(master.forget(id(1)));
    let _reset = ask(&mut master, 2, Reset, ms(10));
    events(&mut master, ms(1_900));
    assert!(!master.forget(id(2)));
    events(&mut master, ms(2_010));
    assert!(master.forget(id(2)));
}

/// A step was offered and withdrawn; the request in its place was never offered.
#[test]
fn request_put_after_the_offer_does_not_count_as_sent() {
    let mut master = Master::<2>::new(Config::CAN);
    let ticket = master.request(id(1), step()).unwrap();
    assert!(master.poll_transmit(ms(0)).is_some());
    master.withdraw(ticket.id());
    assert!(master.poll_event().is_some());
    let _read = master.request(id(1), ReadModel).unwrap();
    master.handle_transmitted(ms(0));
    assert_eq!(sent(&mut master, ms(1)), [packet_to(1, ReadModel.encode())]);
}

#[test]
fn a_short_frame_counts_as_a_stray() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadModel, ms(0));
    let short =
        Received::WrongLength { channel: Channel::Reply(id(1)), length: 3, first: Some(0xB5) };
    assert_eq!(master.handle_frame(&short, ms(1)), None);
    assert_eq!(master.health(id(1)).stray, 1);
}

/// The reply that was heard 0.45 ms before has other bytes.
#[test]
fn answer_soon_after_that_to_another_command_is_no_duplicate() {
    let at = Instant::from_micros;
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, at(0));
    reply(&mut master, 1, ANGLE_REPLY, at(1_000)).unwrap();
    let second = ask(&mut master, 1, ReadModel, at(1_100));
    let reported = reply(&mut master, 1, *b"\xB5X8S2V10", at(1_450));
    assert!(reported.is_some_and(|event| second.outcome(&event).is_some()));
}

#[test]
fn motor_heard_between_short_outages_stays_present() {
    let mut master = Master::<2>::new(Config::CAN);
    for now in (0..10).map(|time| 10 * time) {
        let _read = master.request(id(1), ReadMultiTurnAngle).unwrap();
        master.handle_bus_down(ms(now));
        events(&mut master, ms(now));
        let _read = ask(&mut master, 1, ReadMultiTurnAngle, ms(now + 1));
        reply(&mut master, 1, ANGLE_REPLY, ms(now + 2)).unwrap();
        let _read = master.request(id(1), ReadMultiTurnAngle).unwrap();
        master.handle_bus_down(ms(now + 3));
        assert_eq!(master.health(id(1)).presence, Presence::Present);
        events(&mut master, ms(now + 3));
    }
}

#[test]
fn read_displaced_from_the_late_replies_is_not_taken_for_a_move() {
    use crate::master::late::{LateReplies, Of, Question};
    let mut late = LateReplies::default();
    let read = |opcode| Question::without_key(Kind::Known(opcode));
    let opcodes =
        [Opcode::ReadModel, Opcode::ReadStatus1, Opcode::ReadRunTime, Opcode::ReadMultiTurnAngle];
    for opcode in opcodes {
        assert!(!late.expect(read(opcode), Of::Request, 1, ms(20), &Config::CAN), "{opcode:?}");
    }
}

#[test]
fn later_frame_does_not_shorten_how_long_an_earlier_one_may_arrive() {
    use crate::master::on_its_way::OnItsWay;
    let mut on_its_way = OnItsWay::default();
    on_its_way.put(ms(100), false, &Config::CAN);
    on_its_way.put(ms(50), false, &Config::CAN);
    assert_eq!(on_its_way.end(), Some(ms(100) + Config::CAN.late_window));
}

/// The time-out may grow to 40 ms, and nothing was measured before.
#[test]
fn stop_confirmation_is_measured_and_late_reply_lengthens_time_outs() {
    let longest = Duration::from_millis(40);
    let mut master = Master::<2>::new(Config::CAN.adapting_up_to(longest));
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(0));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(1)), confirmed(1));
    let shortest = Config::CAN.reply_timeout;
    assert_eq!(master.config().reply_timeout, shortest);
    let once = master.patience(1);
    let _read = master.request_with(id(1), ReadModel, once).unwrap();
    sent(&mut master, ms(2));
    assert_eq!(events(&mut master, ms(25)).len(), 1);
    reply(&mut master, 1, *b"\xB5X8S2V10", ms(26)).unwrap();
    assert!(master.config().reply_timeout > shortest);
}

/// A lock may be answered for another of its sendings, but no drive takes as long as a caller may wait.
#[test]
fn lock_after_a_patient_one_waits_at_most_50_ms_and_the_late_window() {
    let mut master = Master::<2>::new(Config::CAN);
    let patient = Patience { reply_timeout: Duration::from_millis(200), attempts: 2 };
    let _first = master.request_with(id(1), LockBrake, patient).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    assert_eq!(sent(&mut master, ms(200)).len(), 1);
    let answer = reply(&mut master, 1, LockBrake.encode(), ms(201));
    assert!(matches!(answer, Some(Event::Reply { .. })), "{answer:?}");
    let _second = master.request_with(id(1), LockBrake, patient).unwrap();
    let over = ms(250) + Config::CAN.late_window;
    assert_eq!(sent(&mut master, ms(290)), []);
    assert_eq!(master.poll_at(), Some(over));
    assert_eq!(sent(&mut master, over).len(), 1);
}

#[test]
fn duplicate_of_the_last_answer_does_not_answer_the_same_broadcast() {
    let micros = Instant::from_micros;
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, micros(0));
    reply(&mut master, 1, ANGLE_REPLY, micros(1_000)).unwrap();
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    assert_eq!(sent(&mut master, micros(1_050)).len(), 1);
    // Later than an answer takes at least.
    let copy = reply(&mut master, 1, ANGLE_REPLY, micros(1_450));
    assert!(matches!(copy, Some(Event::Stray { .. })), "{copy:?}");
    let answer = reply(&mut master, 1, ANGLE_REPLY, micros(2_000));
    assert!(matches!(answer, Some(Event::BroadcastReply { .. })), "{answer:?}");
}

/// Only the last answer can come once more, and the stray answered nothing.
#[test]
fn answer_to_a_broadcast_soon_after_a_stray_of_its_kind_counts() {
    let micros = Instant::from_micros;
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadModel, micros(0));
    reply(&mut master, 1, *b"\xB5X8S2V10", micros(500)).unwrap();
    let unasked = reply(&mut master, 1, ANGLE_REPLY, micros(1_000));
    assert!(matches!(unasked, Some(Event::Stray { .. })), "{unasked:?}");
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    assert_eq!(sent(&mut master, micros(1_050)).len(), 1);
    let answer = reply(&mut master, 1, ANGLE_REPLY, micros(1_450));
    assert!(matches!(answer, Some(Event::BroadcastReply { .. })), "{answer:?}");
}

/// A stop that is sent again and again goes on owing answers: as many are counted as two stops have sendings.
#[test]
fn owed_answers_to_one_question_are_counted_up_to_thirty() {
    use crate::master::late::{LateReplies, Of, Question};
    let stop = Question::without_key(Opcode::Stop.into());
    let mut late = LateReplies::default();
    for _ in 0..3 {
        late.expect(stop, Of::Nobody, 15, ms(1), &Config::CAN);
    }
    let is_one = |_: &u32| late.take(&Stop.packet(id(1)), false).is_some();
    assert_eq!((0..100).take_while(is_one).count(), 30);
}

#[test]
fn report_makes_a_motor_present_before_any_answer_or_after_an_outage() {
    let report = [0x9A, 50, 30, 1, 0xE5, 0x01, 0, 0];
    for downs in [0, 3] {
        let mut master = Master::<2>::new(Config::CAN);
        for now in 0..downs {
            let _read = master.request(id(1), ReadMultiTurnAngle).unwrap();
            master.handle_bus_down(ms(now));
            events(&mut master, ms(now));
        }
        let _read = ask(&mut master, 1, ReadMultiTurnAngle, ms(10));
        let before = if downs == 0 { Presence::Unknown } else { Presence::Silent };
        assert_eq!(master.health(id(1)).presence, before);
        reply(&mut master, 1, report, ms(11)).unwrap();
        assert_eq!(master.health(id(1)).presence, Presence::Present, "{downs}");
    }
}

#[test]
fn set_point_and_broadcast_are_awaited_for_at_least_a_millisecond() {
    let mut master = Master::<2>::new(Config { reply_timeout: Duration::ZERO, ..Config::CAN });
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.broadcast(ReadModel, id(2).into()).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    assert_eq!(events(&mut master, Instant::from_micros(999)), []);
    assert_eq!(events(&mut master, Instant::from_micros(1_000)).len(), 2);
}
