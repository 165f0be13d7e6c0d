//! Streams of set-points and their feedback.

use super::*;

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
    let event = reply(&mut master, 1, TORQUE_REPLY, ms(1)).unwrap();
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
fn set_point_that_is_too_old_or_meets_a_bus_down_is_dropped() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    let reported = events(&mut master, ms(53));
    assert_eq!(reported, [Event::SetPointDropped { motor: id(1) }]);
    assert!(sent(&mut master, ms(53)).is_empty());

    master.set_point(id(1), torque(1.0), ms(60)).unwrap();
    let moving = master.request(id(2), step()).unwrap();
    master.handle_bus_down(ms(60));
    assert!(sent(&mut master, ms(60)).is_empty(), "nothing is kept");
    let reported = events(&mut master, ms(60));
    assert!(reported.contains(&Event::SetPointDropped { motor: id(1) }));
    assert!(reported.iter().any(|event| moving.outcome(event) == Some(Err(Failure::BusDown))));
    let read = master.request(id(1), ReadMultiTurnAngle).unwrap();
    master.handle_bus_down(ms(60));
    let reported = events(&mut master, ms(60));
    assert_eq!(read.outcome(&reported[0]), Some(Err(Failure::BusDown)), "nobody waits for ever");

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
    obeys(&mut master, 1);
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
fn motion_feedback_is_not_taken_for_another_reply() {
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

#[test]
fn lost_feedback_delays_at_most_two_set_points() {
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
        let reported = events(&mut master, ms(now) + Duration::from_micros(950));
        unanswered +=
            reported.iter().filter(|e| matches!(e, Event::SetPointUnanswered { .. })).count();
    }
    assert_eq!(unanswered, 9);
    // Each holds the next one back until three times what feedback takes, so two at the most.
    assert!(answered >= 99 - 9 - 2 * 9, "{answered}");
}

#[test]
fn the_first_set_point_on_any_clock_and_after_any_pause_is_sent() {
    for start in [0, 30_000, 10_000_000_000] {
        let mut master = Master::<2>::new(Config::CAN);
        master.set_point(id(1), torque(1.0), ms(start)).unwrap();
        assert_eq!(sent(&mut master, ms(start)).len(), 1, "{start}");
    }
}

/// Feedback of either kind may come, and would be taken for the answer to a request of its kind.
#[test]
fn stream_that_changes_its_kind_refuses_requests_of_both_until_answered() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    let streamed = |opcode| Some(RequestError::Streamed(opcode));
    assert_eq!(master.request(id(1), torque(1.0)).err(), streamed(Opcode::Torque));
    assert_eq!(master.request(id(1), motion()).err(), streamed(Opcode::Motion));
    reply(&mut master, 1, TORQUE_REPLY, ms(1)).unwrap();
    assert_eq!(master.request(id(1), motion()).err(), streamed(Opcode::Motion));
    let _asked = master.request(id(1), torque(1.0)).unwrap();
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

/// Streams a set-point at this time; after how many milliseconds it counts as lost.
fn is_lost_after(master: &mut Master<2>, now: u64) -> Option<u64> {
    master.set_point(id(1), torque(1.0), ms(now)).unwrap();
    sent(master, ms(now));
    let unanswered = [Event::SetPointUnanswered { motor: id(1) }];
    (1..30).find(|after| events(master, ms(now + after)) == unanswered)
}

#[test]
fn feedback_counts_as_lost_soon_only_where_its_usual_time_is_known() {
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

/// Motor 2 usually answers after 1 ms. It is sent a set-point at 100 ms.
fn stream_to_second() -> Master<2> {
    let mut master = Master::<2>::new(Config::CAN);
    let torque_feedback = [0xA1, 0x32, 0x64, 0, 0, 0, 45, 0];
    master.set_point(id(2), torque(1.0), ms(0)).unwrap();
    sent(&mut master, ms(0));
    reply(&mut master, 2, torque_feedback, ms(1)).unwrap();
    master.set_point(id(2), torque(1.0), ms(100)).unwrap();
    sent(&mut master, ms(100));
    master
}

#[test]
fn feedback_is_not_given_up_while_the_bus_is_busy_with_more_urgent_replies() {
    let mut master = stream_to_second();
    for micros in (100_200..115_000).step_by(200) {
        let now = Instant::from_micros(micros);
        reply(&mut master, 1, ANGLE_REPLY, now).unwrap();
        assert_eq!(events(&mut master, now), []);
    }
}

/// Replies on these channels come all the time. Returns after how many microseconds motor 2's feedback is given up.
fn is_given_up_after(channels: [Channel; 2], first_after: u64) -> Option<u64> {
    let mut master = stream_to_second();
    let mut next = channels.into_iter();
    let (first, rest) = (next.next().unwrap(), next.next().unwrap());
    let times =
        core::iter::once((first, first_after)).chain((1..75).map(|it| (rest, 2_140 + 200 * it)));
    times.into_iter().find_map(|(channel, after)| {
        let now = Instant::from_micros(100_000 + after);
        let is_motion = matches!(channel, Channel::MotionReply(_));
        let data = if is_motion { [1, 0x80, 0, 0, 0, 0, 0, 0] } else { ANGLE_REPLY };
        master.handle_frame(&Received::Packet(Packet { channel, data }), now);
        let is_lost = events(&mut master, now) == [Event::SetPointUnanswered { motor: id(2) }];
        is_lost.then_some(after)
    })
}

#[test]
fn feedback_is_given_up_when_a_less_urgent_reply_has_come() {
    let [first, third] = [1, 3].map(|motor| Channel::Reply(id(motor)));
    // Three times as long as usual is 3 ms; the first look after that.
    assert_eq!(is_given_up_after([third, first], 2_136), Some(3_140));
    assert_eq!(is_given_up_after([Channel::MotionReply(id(1)), first], 2_136), Some(3_140));
    // A frame takes up to 136 us: this may have begun before the feedback was to be expected, 2 ms after its command.
    assert_eq!(is_given_up_after([third, first], 2_135), None);
    assert_eq!(is_given_up_after([first, first], 2_136), None);
}

#[test]
fn feedback_of_motion_mode_is_not_given_up_for_a_normal_reply_which_is_more_urgent() {
    let mut master = Master::<2>::new(Config::CAN);
    for at in [0, 100] {
        master.set_point(id(1), motion(), ms(at)).unwrap();
        sent(&mut master, ms(at));
        if at == 0 {
            let channel = Channel::MotionReply(id(1));
            let packet = Packet { channel, data: [1, 0x80, 0, 0, 0, 0, 0, 0] };
            assert!(master.handle_frame(&Received::Packet(packet), ms(1)).is_some());
        }
    }
    for micros in (100_200..115_000).step_by(200) {
        let now = Instant::from_micros(micros);
        reply(&mut master, 2, ANGLE_REPLY, now).unwrap();
        assert_eq!(events(&mut master, now), [], "{now}");
    }
}

#[test]
fn lone_set_point_is_dropped_after_50_ms() {
    let mut master = Master::<2>::new(Config::CAN);
    assert_eq!(events(&mut master, ms(0)), []);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    assert_eq!(events(&mut master, ms(49)), []);
    assert_eq!(events(&mut master, ms(50)), [Event::SetPointDropped { motor: id(1) }]);
    assert_eq!(master.health(id(1)).superseded, 1);
}
