//! Commands to all motors.

use super::*;

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
fn waiting_broadcast_lets_further_attempts_go_and_waits_for_no_restart() {
    let mut master = Master::<4>::new(Config::CAN);
    let _reset = master.request(id(2), Reset).unwrap();
    let read = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    events(&mut master, ms(0));
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    // The first attempt is lost; the second must not wait for the broadcast, which waits for it.
    assert_eq!(sent(&mut master, ms(21))[0].data[0], 0x92);
    let event = reply(&mut master, 1, ANGLE_REPLY, ms(22)).unwrap();
    assert!(read.outcome(&event).is_some());
    assert!(sent(&mut master, ms(22)).is_empty(), "one of the two may still be answered");
    // 40.816 ms from the answer.
    let at = Instant::from_micros(62_816);
    assert_eq!(master.poll_at(), Some(at));
    assert_eq!(sent(&mut master, at)[0].channel, Channel::Command(Target::All));
}

#[test]
fn waiting_broadcast_is_dropped_by_a_stop_and_by_a_bus_down() {
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
fn motors_that_a_broadcast_may_move_are_stopped_with_all() {
    let both: MotorSet = [1, 2].into_iter().map(id).collect();
    type Put = fn(&mut Master<2>, MotorSet) -> Result<(), RequestError>;
    let puts: [(Put, usize); 3] = [
        // One to all, for motors that are not known, and one each.
        (|master, both| master.broadcast(torque(1.0), both), 3),
        (|master, both| master.broadcast(ReleaseBrake, both), 3),
        // A motor without a place is reached by the one to all.
        (|master, both| master.broadcast(ReadMultiTurnAngle, both), 1),
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
fn broadcast_that_may_move_more_motors_than_places_is_refused() {
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
    // A command that moves no motor goes to all, and so does one that moves as many as there are places.
    master.broadcast(ReadMultiTurnAngle, three).unwrap();
    assert_eq!(master.motors(), id(3).into());
    master.handle_bus_down(ms(2));
    events(&mut master, ms(2));
    master.broadcast(torque(1.0), [1, 3].into_iter().map(id).collect()).unwrap();
}

#[test]
fn no_older_set_point_or_move_follows_a_shutdown_to_all() {
    let mut master = Master::<4>::new(Config::CAN);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    let waiting = master.request(id(2), step()).unwrap();
    let read = master.request(id(3), ReadMultiTurnAngle).unwrap();
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    let mut packets = sent(&mut master, ms(0));
    assert_eq!(packets[0], packet_to_all(Shutdown.encode()));
    let reported = events(&mut master, ms(0));
    assert!(reported.contains(&Event::SetPointDropped { motor: id(1) }), "{reported:?}");
    assert!(reported.iter().any(|event| waiting.outcome(event) == Some(Err(Failure::Stopped))));
    assert!(!reported.iter().any(|event| read.outcome(event).is_some()));
    packets.extend(sent(&mut master, ms(100)));
    let to_motor_3 = Channel::Command(id(3).into());
    assert!(packets[1..].iter().all(|packet| packet.channel == to_motor_3), "{packets:?}");
}

#[test]
fn set_point_pushed_out_by_a_shutdown_to_all_is_not_sent_again() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    let pushed_out = sent(&mut master, ms(0))[0];
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(0)), [packet_to_all(Shutdown.encode())]);
    master.handle_pushed_out(&pushed_out);
    assert_eq!(sent(&mut master, ms(1)), []);
}

#[test]
fn bus_down_extends_how_long_a_move_to_all_may_arrive() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
    let pushed_out = sent(&mut master, ms(1))[0];
    assert_eq!(
        events(&mut master, ms(1)),
        [Event::BroadcastDone { silent: MotorSet::EMPTY, was_sent: true }]
    );
    // It stays in a queue for as long as the bus is down.
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
fn endless_broadcasts_do_not_block_a_waiting_request() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadModel, ms(0));
    reply(&mut master, 1, *b"\xB5X8S2V10", ms(1)).unwrap();
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    sent(&mut master, ms(1));
    let _waiting = master.request(id(1), ReadModel).unwrap();
    for now in 2..10 {
        let reported = reply(&mut master, 1, ANGLE_REPLY, ms(now));
        assert!(matches!(reported, Some(Event::BroadcastReply { .. })));
        // As the loops do: what can be sent is sent before the next event is polled.
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

/// Motors 1 and 2 have a place and `command` goes to all, in a controller that may hand it back; then motor 1 is
/// stopped so, one stop after the other.
fn overtaken_by<C: Command>(command: C, kinds: &[StopKind]) -> (Master<2>, Packet) {
    let mut master = Master::<2>::new(Config::CAN);
    master.give_places([1, 2].into_iter().map(id).collect()).unwrap();
    master.broadcast(command, MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(100));
    for &kind in kinds {
        master.lift_stop();
        master.stop(id(1), kind).unwrap();
        assert_eq!(sent(&mut master, ms(101)).len(), 1);
    }
    (master, packets[0])
}

#[test]
fn handed_back_broadcast_goes_to_all_again_unless_it_would_undo_a_stop() {
    // What is sent besides motor 1's stop, or once that is given up.
    fn goes<C: Command>(command: C, kinds: &[StopKind]) -> Option<Packet> {
        let (mut master, packet) = overtaken_by(command, kinds);
        master.handle_pushed_out(&packet);
        let packets = (102..1_000).flat_map(|now| sent(&mut master, ms(now)));
        let own = Channel::Command(id(1).into());
        packets.into_iter().find(|packet| packet.channel != own)
    }
    let (hold, off) = (StopKind::Hold, StopKind::Off);
    let (let_go, held) = (Shutdown.encode(), Stop.encode());
    for kinds in [&[hold][..], &[off, hold]] {
        assert_eq!(goes(Shutdown, kinds), Some(packet_to(2, let_go)), "{kinds:?}");
        assert_eq!(goes(Stop, kinds), Some(packet_to_all(held)), "{kinds:?}");
    }
    for kinds in [&[off][..], &[hold, off]] {
        assert_eq!(goes(Shutdown, kinds), Some(packet_to_all(let_go)), "{kinds:?}");
        assert_eq!(goes(Stop, kinds), Some(packet_to(2, held)), "{kinds:?}");
    }
}

#[test]
fn handed_back_hold_to_all_skips_a_motor_that_is_to_be_off() {
    let mut master = Master::<2>::new(Config::CAN);
    master.give_places(id(2).into()).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(2));
    reply(&mut master, 1, Shutdown.encode(), ms(3)).unwrap();
    let (hold, off) = (Stop.encode(), Shutdown.encode());
    master.lift_stop();
    master.broadcast(Stop, MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(100));
    assert_eq!(packets, [packet_to_all(hold)]);
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(101)), [packet_to(1, off)]);
    master.handle_pushed_out(&packets[0]);
    assert_eq!(sent(&mut master, ms(101)), [packet_to(2, hold)]);
}

#[test]
fn handed_back_reset_to_all_is_not_sent_again_once_a_motor_was_stopped() {
    let (mut master, packet) = overtaken_by(Reset, &[]);
    master.handle_pushed_out(&packet);
    assert_eq!(sent(&mut master, ms(102)), [packet], "nobody was stopped");
    for kind in [StopKind::Hold, StopKind::Off] {
        for is_lifted in [false, true] {
            let (mut master, packet) = overtaken_by(Reset, &[kind]);
            if is_lifted {
                master.lift_stop();
            }
            master.handle_pushed_out(&packet);
            let later: Vec<Packet> =
                (102..120).flat_map(|now| sent(&mut master, ms(now))).collect();
            assert_eq!(later, [], "{kind:?} {is_lifted}");
        }
    }
}

#[test]
fn hold_to_all_does_not_switch_on_a_motor_stopped_off() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(0));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(1)), confirmed(1));
    let _ = master.broadcast(Stop, MotorSet::EMPTY);
    let packets = sent(&mut master, ms(2));
    assert!(!packets.contains(&packet_to_all(Stop.encode())), "{packets:?}");
}

#[test]
fn motor_new_under_a_shutdown_of_all_is_not_held_by_a_stop() {
    let mut master = Master::<4>::new(Config::CAN);
    master.stop_all(StopKind::Off, id(1).into()).unwrap();
    sent(&mut master, ms(0));
    master.stop(id(2), StopKind::Hold).unwrap();
    assert_eq!(sent(&mut master, ms(1)), [packet_to(2, Shutdown.encode())]);
}

#[test]
fn motor_new_in_a_hold_of_all_after_a_shutdown_of_all_is_switched_off() {
    let mut master = Master::<4>::new(Config::CAN);
    master.stop_all(StopKind::Off, id(1).into()).unwrap();
    sent(&mut master, ms(0));
    master.stop_all(StopKind::Hold, id(2).into()).unwrap();
    assert_eq!(sent(&mut master, ms(1)), [packet_to(2, Shutdown.encode())]);
}

#[test]
fn motor_new_under_a_shutdown_of_all_is_not_held_by_a_broadcast() {
    let mut master = Master::<4>::new(Config::CAN);
    master.stop_all(StopKind::Off, id(1).into()).unwrap();
    sent(&mut master, ms(0));
    reply(&mut master, 1, Shutdown.encode(), ms(1));
    let _ = ask(&mut master, 2, ReadMultiTurnAngle, ms(2));
    reply(&mut master, 2, ANGLE_REPLY, ms(3));
    master.broadcast(Stop, MotorSet::EMPTY).unwrap();
    let all: Vec<_> = (4..200).flat_map(|t| sent(&mut master, ms(t))).collect();
    assert_eq!(all, []);
}

#[test]
fn read_to_all_drops_no_waiting_set_point() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 2);
    assert_eq!(events(&mut master, ms(0)), []);
}

#[test]
fn broadcast_in_flight_survives_a_restart_and_a_bus_down() {
    for is_restart in [true, false] {
        let mut master = Master::<2>::new(Config::CAN);
        master.broadcast(torque(1.0), id(1).into()).unwrap();
        assert_eq!(sent(&mut master, ms(0)).len(), 1);
        if is_restart {
            master.note_restart(id(1));
        } else {
            master.handle_bus_down(ms(1));
        }
        events(&mut master, ms(1));
        let event = reply(&mut master, 1, TORQUE_REPLY, ms(2));
        assert!(matches!(event, Some(Event::BroadcastReply { .. })), "{event:?}");
    }
}

#[test]
fn broadcast_counts_as_answered_or_lost_for_each_expected_motor() {
    let mut master = Master::<2>::new(Config::CAN);
    for motor in 1..=2 {
        let _ = ask(&mut master, motor, ReadModel, ms(0));
        reply(&mut master, motor, *b"\xB5X8S2V10", ms(1)).unwrap();
    }
    master.broadcast(ReadMultiTurnAngle, (1..=2).map(id).collect()).unwrap();
    assert_eq!(sent(&mut master, ms(2)).len(), 1);
    reply(&mut master, 1, ANGLE_REPLY, ms(3)).unwrap();
    assert_eq!(events(&mut master, ms(23)).len(), 1);
    let counts = |master: &Master<2>, motor| {
        let health = master.health(id(motor));
        (health.answered, health.lost)
    };
    assert_eq!([counts(&master, 1), counts(&master, 2)], [(2, 0), (1, 1)]);
    reply(&mut master, 2, ANGLE_REPLY, ms(24)).unwrap();
    assert_eq!(counts(&master, 2), (1, 1), "too late");
}

#[test]
fn silent_motor_is_present_once_it_answers_a_broadcast() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadModel, ms(0));
    for attempt in 1..=3 {
        sent(&mut master, ms(21 * attempt));
    }
    assert_eq!(master.health(id(1)).presence, Presence::Silent);
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(64)), [packet_to_all(ReadMultiTurnAngle.encode())]);
    let event = reply(&mut master, 1, ANGLE_REPLY, ms(65));
    assert!(matches!(event, Some(Event::BroadcastReply { .. })), "{event:?}");
    assert_eq!(master.health(id(1)).presence, Presence::Present);
}

/// The feedback begins with the motor's id, 0x20, which is also the byte of the broadcast command.
#[test]
fn motion_feedback_does_not_answer_a_broadcast_whatever_its_id_byte() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(FunctionControl::ErrorReporting(Switch::On), MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    events(&mut master, ms(0));
    master.set_point(id(32), motion(), ms(1)).unwrap();
    assert_eq!(sent(&mut master, ms(1)).len(), 1);
    let data = [0x20, 0x80, 0, 0x80, 0x08, 0, 0, 0];
    let packet = Packet { channel: Channel::MotionReply(id(32)), data };
    master.handle_frame(&Received::Packet(packet), ms(2)).unwrap();
    // Nothing that moves it is on its way any more.
    master.stop(id(32), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(2)).len(), 1);
    assert_eq!(reply(&mut master, 32, Shutdown.encode(), ms(3)), confirmed(32));
}

#[test]
fn broadcast_without_reply_is_done_when_sent_whatever_is_expected() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(Reset, id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    let done = Event::BroadcastDone { silent: id(1).into(), was_sent: true };
    assert!(events(&mut master, ms(0)).contains(&done));
}

#[test]
fn hold_to_all_does_not_wait_for_an_unsent_read() {
    let mut master = Master::<2>::new(Config::CAN);
    let _read = master.request(id(1), ReadModel).unwrap();
    master.broadcast(Stop, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(0))[0], packet_to_all(Stop.encode()));
}

#[test]
fn reset_to_all_is_reported_though_another_motor_was_forgotten() {
    let mut master = Master::<2>::new(Config::CAN);
    for motor in 1..=2 {
        let _ = ask(&mut master, motor, ReadModel, ms(0));
        reply(&mut master, motor, *b"\xB5X8S2V10", ms(1)).unwrap();
    }
    assert!(master.forget(id(1)));
    master.broadcast(Reset, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(2)).len(), 1);
    assert!(events(&mut master, ms(2)).contains(&Event::Restarted { motor: id(2) }));
}

#[test]
fn motor_can_be_forgotten_while_a_read_to_all_waits() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadModel, ms(0));
    reply(&mut master, 1, *b"\xB5X8S2V10", ms(1)).unwrap();
    master.broadcast(ReadMultiTurnAngle, MotorSet::EMPTY).unwrap();
    assert!(master.forget(id(1)));
}

/// The last answer is remembered also if it was to a broadcast: the same frame once more, within 0.5 ms of both,
/// answers nothing.
#[test]
fn duplicate_answer_to_a_broadcast_does_not_answer_the_next_request() {
    let master = &mut Master::<2>::new(Config::CAN);
    // It has a place.
    master.stop(id(1), StopKind::Off).unwrap();
    sent(master, ms(0));
    assert_eq!(reply(master, 1, Shutdown.encode(), ms(1)), confirmed(1));
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    sent(master, ms(10));
    let first = reply(master, 1, ANGLE_REPLY, ms(11));
    assert!(matches!(first, Some(Event::BroadcastReply { .. })), "{first:?}");
    let ticket = ask(master, 1, ReadMultiTurnAngle, ms(11));
    let doubled = reply(master, 1, ANGLE_REPLY, Instant::from_micros(11_300)).unwrap();
    assert_eq!(ticket.outcome(&doubled), None);
}

/// A torque is sent after the answer to the stop to all, and after that a stop, which is lost.
#[test]
fn duplicate_answer_to_a_stop_to_all_confirms_no_later_stop() {
    let master = &mut Master::<2>::new(Config::CAN);
    master.broadcast(Stop, id(1).into()).unwrap();
    sent(master, ms(0));
    let first = reply(master, 1, [0x81, 0, 0, 0, 0, 0, 0, 0], ms(1));
    assert!(matches!(first, Some(Event::BroadcastReply { .. })), "{first:?}");
    master.set_point(id(1), torque(1.0), ms(1)).unwrap();
    assert_eq!(sent(master, ms(1)).len(), 1);
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(sent(master, ms(1)).len(), 1);
    let doubled = reply(master, 1, [0x81, 0, 0, 0, 0, 0, 0, 0], Instant::from_micros(1_300));
    assert_ne!(doubled, confirmed(1), "it was lost, and the motor turns");
}

/// A caller that sleeps until `poll_at` is woken for that: until then the requests of all others wait for that move.
#[test]
fn sent_reset_ends_a_waiting_move_to_all_in_time() {
    let master = &mut Master::<2>::new(Config::CAN);
    let _ = master.request(id(1), Reset).unwrap();
    master.broadcast(torque(1.0), id(2).into()).unwrap();
    let _ = master.request(id(2), ReadMultiTurnAngle).unwrap();
    let mut packets = sent(master, ms(1));
    while master.poll_event().is_some() {}
    if packets.len() == 1 {
        // Nothing but the time that it says itself is needed.
        let at = master.poll_at().expect("the move is to be ended, and the angle asked");
        packets.extend(sent(master, at));
    }
    assert_eq!(packets.len(), 2, "the restart and the angle");
}

/// The time at which a dropped attempt can no longer be answered is noticed, although nothing is sent meanwhile.
#[test]
fn broadcast_goes_once_no_dropped_request_can_be_answered_in_its_place() {
    let master = &mut Master::<2>::new(Config::CAN);
    let _ = ask(master, 1, ReleaseBrake, ms(0));
    master.handle_timeout(ms(21));
    // It waits to be sent again, and is dropped.
    assert_eq!(master.request(id(1), Shutdown).unwrap_err(), RequestError::Busy);
    assert_eq!(events(master, ms(21)).len(), 1);
    master.broadcast(ReleaseBrake, id(1).into()).unwrap();
    assert_eq!(sent(master, ms(21)), []);
    let over = ms(21) + Config::CAN.late_window;
    assert_eq!(master.poll_at(), Some(over));
    assert_eq!(sent(master, over).len(), 1);
}

/// It would then wait for the answers to that, too.
#[test]
fn request_that_waits_for_a_late_reply_goes_before_a_later_command_to_all_of_its_kind() {
    let master = &mut Master::<2>::new(Config::CAN);
    let [read, of_all] = [1, 4].map(|index| ReadPid { index: PidIndex::from_raw(index) });
    let _ = master.request_with(id(1), read, once(5)).unwrap();
    sent(master, ms(0));
    assert_eq!(events(master, ms(5)).len(), 1);
    let _ = master.request_with(id(1), read, once(5)).unwrap();
    master.broadcast(of_all, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(master, ms(6)), []);
    let over = ms(5) + Config::CAN.late_window;
    assert_eq!(sent(master, over), [packet_to(1, read.encode())]);
    reply(master, 1, read.encode(), over + Duration::from_millis(1));
    assert_eq!(sent(master, over + Duration::from_millis(1)), [packet_to_all(of_all.encode())]);
}

/// A stop has ended the broadcast. Its answer comes, and the same frame once more.
#[test]
fn duplicate_answer_to_an_ended_broadcast_confirms_no_stop() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadStatus1, ms(0));
    reply(&mut master, 1, [0x9A, 0, 0, 0, 0, 0, 0, 0], ms(1));
    master.broadcast(Shutdown, id(1).into()).unwrap();
    sent(&mut master, ms(100));
    master.handle_timeout(Instant::from_micros(100_700));
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    sent(&mut master, Instant::from_micros(100_700));
    let off = [0x80, 0, 0, 0, 0, 0, 0, 0];
    let first = reply(&mut master, 1, off, Instant::from_micros(100_800));
    let again = reply(&mut master, 1, off, Instant::from_micros(101_100));
    assert_ne!(again, confirmed(1), "the drive has not heard the stop; first {first:?}");
}

/// The same move to all was put again and dropped. What comes is the first one, handed back, and no motor's answer.
#[test]
fn echo_of_a_move_to_all_proves_no_stop_after_an_equal_one_was_dropped() {
    for is_put_again in [false, true] {
        let mut master = Master::<2>::new(Config::CAN);
        master.broadcast(step(), id(1).into()).unwrap();
        let moved = sent(&mut master, ms(0));
        let done = |was_sent| [Event::BroadcastDone { silent: id(1).into(), was_sent }];
        assert_eq!(events(&mut master, ms(21)), done(true));
        if is_put_again {
            master.broadcast(step(), id(1).into()).unwrap();
        }
        master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
        if is_put_again {
            assert_eq!(events(&mut master, ms(22)), done(false));
        }
        sent(&mut master, ms(22));
        reply(&mut master, 1, moved[0].data, ms(23));
        let hold = [0x81, 0, 0, 0, 0, 0, 0, 0];
        assert_eq!(reply(&mut master, 1, hold, ms(24)), None, "again: {is_put_again}");
    }
}

#[test]
fn duplicate_answer_to_an_ended_broadcast_answers_no_move() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(step(), id(1).into()).unwrap();
    sent(&mut master, ms(100));
    let ticket = master.request(id(1), step()).unwrap();
    master.handle_timeout(Instant::from_micros(100_700));
    master.stop(id(2), StopKind::Hold).unwrap();
    sent(&mut master, Instant::from_micros(100_700));
    let data = [0xA8, 30, 0, 0, 0, 0, 7, 0];
    let first = reply(&mut master, 1, data, Instant::from_micros(101_000));
    let moved = sent(&mut master, Instant::from_micros(101_000));
    assert_eq!(moved.len(), 1, "{first:?} {moved:?}");
    let again = reply(&mut master, 1, data, Instant::from_micros(101_290));
    assert!(again.is_none_or(|it| ticket.outcome(&it).is_none()), "{first:?} {moved:?} {again:?}");
    let answer = reply(&mut master, 1, data, Instant::from_micros(102_000)).unwrap();
    assert!(matches!(ticket.outcome(&answer), Some(Ok(_))), "{answer:?}");
}

/// Motors 1 and 2 were moved with all, and stopped in one way, then in the other. A program reads all by one command
/// every 20 ms; each drive answers everything after a millisecond.
#[test]
fn repeated_reads_to_all_keep_no_stop_unconfirmed() {
    let both = || MotorSet::from([id(1), id(2)]);
    for (first, then) in [(StopKind::Off, StopKind::Hold), (StopKind::Hold, StopKind::Off)] {
        let mut master = Master::<2>::new(Config::CAN);
        let (mut answers, mut confirmed) = (Vec::new(), MotorSet::EMPTY);
        for now in 0..1_000 {
            for packet in core::mem::take(&mut answers) {
                let event = master.handle_frame(&Received::Packet(packet), ms(now));
                if let Some(Event::StopConfirmed { motor }) = event {
                    confirmed.insert(motor);
                }
            }
            events(&mut master, ms(now));
            match now {
                1 => master.broadcast(step(), both()).unwrap(),
                10 => master.stop_all(first, both()).unwrap(),
                13 => {
                    master.lift_stop();
                    master.stop_all(then, both()).unwrap();
                    confirmed = MotorSet::EMPTY;
                }
                14.. if now % 20 == 0 => drop(master.broadcast(ReadMultiTurnAngle, both())),
                _ => {}
            }
            for packet in sent(&mut master, ms(now)) {
                let data = match packet.data {
                    [0xA8, ..] => [0xA8, 25, 0, 0, 1, 0, 1, 0],
                    data => data,
                };
                let hears = |motor: &MotorId| match packet.channel {
                    Channel::Command(Target::Motor(one)) => one == *motor,
                    _ => true,
                };
                let heard = both().iter().filter(hears);
                answers.extend(heard.map(|it| Packet { channel: Channel::Reply(it), data }));
            }
        }
        assert_eq!(confirmed, both(), "{then:?}");
    }
}

/// The answer looks like feedback of a set-point that was given up meanwhile.
#[test]
fn late_answer_to_a_broadcast_does_not_show_that_a_set_point_arrived() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    let line = |data| Frame { address: Target::Motor(id(1)), data };
    let us = Instant::from_micros;
    master.broadcast(torque(1.0), id(1).into()).unwrap();
    assert_eq!(sent(&mut master, us(0)).len(), 1);
    events(&mut master, us(5_300));
    master.set_point(id(1), torque(2.0), us(5_300)).unwrap();
    assert_eq!(sent(&mut master, us(5_400)).len(), 1);
    assert!(events(&mut master, us(10_800)).contains(&Event::SetPointUnanswered { motor: id(1) }));
    master.handle_line(&line(TORQUE_REPLY), us(15_100));
    // It is answered when those answers are no longer expected.
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, us(15_250)), [packet_to(1, Shutdown.encode())]);
    assert_eq!(events(&mut master, us(16_000)), []);
    assert_eq!(master.handle_line(&line(Shutdown.encode()), us(16_100)), None, "once more");
}

/// The late feedback may come for as long as other feedback comes that may be it.
#[test]
fn broadcast_of_a_streams_kind_is_sent_though_one_feedback_was_lost() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    // It is lost.
    assert_eq!(events(&mut master, ms(21)), [Event::SetPointUnanswered { motor: id(1) }]);
    let mut ticket = None;
    let mut outcome = None;
    for now in (22..2_000).step_by(2) {
        if now == 30 {
            master.broadcast(torque(0.0), MotorSet::EMPTY).unwrap();
            ticket = Some(master.request(id(2), ReadModel).unwrap());
        }
        master.set_point(id(1), torque(1.0), ms(now)).unwrap();
        for packet in sent(&mut master, ms(now)) {
            if packet.channel == Channel::Command(id(1).into()) {
                reply(&mut master, 1, TORQUE_REPLY, ms(now + 1));
            }
            if packet == packet_to(2, ReadModel.encode()) {
                outcome = Some(now);
            }
        }
        events(&mut master, ms(now + 1));
    }
    assert!(ticket.is_some());
    assert!(outcome.is_some_and(|at| at <= 150), "motor 2 was asked at {outcome:?}");
}

/// The Shutdown waits for two seconds, until the drive has restarted.
#[test]
fn hold_to_all_waits_for_an_earlier_shutdown_of_a_restarting_motor() {
    let mut master = Master::<2>::new(Config::CAN);
    let _reset = ask(&mut master, 1, Reset, ms(0));
    events(&mut master, ms(0));
    let _off = master.request(id(1), Shutdown).unwrap();
    master.broadcast(Stop, MotorSet::EMPTY).unwrap();
    let went = (1..2_100).find(|&now| {
        let packets = sent(&mut master, ms(now));
        if packets.contains(&packet_to(1, Shutdown.encode())) {
            reply(&mut master, 1, Shutdown.encode(), ms(now) + Duration::from_micros(900));
        }
        packets.contains(&packet_to_all(Stop.encode()))
    });
    assert!(went.is_some_and(|now| now > 2_000), "{went:?}");
}

#[test]
fn broadcast_waits_for_a_late_answer_of_its_kind_during_another_stream() {
    let mut master = Master::<2>::new(Config::CAN);
    let _lost = master.request_with(id(1), torque(1.0), once(5)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    assert_eq!(events(&mut master, ms(6)).len(), 1);
    let go = AbsolutePosition { max_speed: MaxSpeed::from_raw(1), angle: Angle::from_raw(0) };
    master.set_point(id(1), go, ms(7)).unwrap();
    master.broadcast(torque(0.0), MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(7));
    assert_eq!(packets, [packet_to(1, go.encode())]);
}

/// Each would wait for the other if the broadcast waited for it.
#[test]
fn a_request_of_its_kind_that_was_put_later_waits_for_the_broadcast() {
    let mut master = Master::<2>::new(Config::CAN);
    let _earlier = ask(&mut master, 1, ReadModel, ms(0));
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    let _later = master.request(id(2), ReadMultiTurnAngle).unwrap();
    assert_eq!(sent(&mut master, ms(0)), [], "the broadcast waits for the model");
    reply(&mut master, 1, *b"\xB5X8S2V10", ms(1)).unwrap();
    let to_all =
        Packet { channel: Channel::Command(Target::All), data: ReadMultiTurnAngle.encode() };
    assert_eq!(sent(&mut master, ms(1)), [to_all]);
}

/// Both motors have answered the second move. The first may move them until 165.8 ms. The read waits for the Shutdown,
/// which must not wait for the read.
#[test]
fn shutdown_to_all_does_not_wait_for_a_later_read_while_an_earlier_move_may_arrive() {
    let mut master = Master::<2>::new(Config::CAN);
    let both = MotorSet::from([id(1), id(2)]);
    let moved = [0xA8, 30, 0, 0, 0, 0, 7, 0];
    master.broadcast(step(), both).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    // Nothing is heard of it.
    events(&mut master, ms(21));
    for at in [62, 90] {
        events(&mut master, ms(at));
    }
    master.broadcast(step(), both).unwrap();
    assert_eq!(sent(&mut master, ms(100)).len(), 1);
    for motor in [1, 2] {
        reply(&mut master, motor, moved, ms(101)).unwrap();
    }
    events(&mut master, ms(101));
    let _first = ask(&mut master, 2, ReadModel, ms(124));
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    let _later = master.request(id(1), ReadMultiTurnAngle).unwrap();
    assert_eq!(sent(&mut master, ms(124)), [], "the answer to the first read is awaited");
    // The bus is intact.
    reply(&mut master, 2, *b"\xB5X8S2V10", ms(125)).unwrap();
    assert_eq!(sent(&mut master, ms(125)).first(), Some(&packet_to_all(Shutdown.encode())));
}

/// The answer to a set-point may be that to a torque to all. The stop comes when that torque can no longer come.
#[test]
fn stop_is_unconfirmed_while_the_set_point_may_come_whose_answer_may_be_that_to_a_broadcast() {
    let line = |data| Frame { address: Target::Motor(id(1)), data };
    let is_feedback = |event| matches!(event, Some(Event::Feedback { .. }));
    // It may come until 10.26 ms after that answer.
    for (at, is_confirmed) in [(17, false), (24, true)] {
        let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
        master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
        assert_eq!(sent(&mut master, ms(0)), [packet_to_all(torque(1.0).encode())]);
        events(&mut master, ms(0));
        master.set_point(id(1), torque(2.0), ms(12)).unwrap();
        assert_eq!(sent(&mut master, ms(12)), [packet_to(1, torque(2.0).encode())]);
        assert!(is_feedback(master.handle_line(&line(TORQUE_REPLY), ms(13))));
        events(&mut master, ms(16));
        master.stop(id(1), StopKind::Off).unwrap();
        assert_eq!(sent(&mut master, ms(at)), [packet_to(1, Shutdown.encode())]);
        let answer = master.handle_line(&line(Shutdown.encode()), ms(at + 1));
        assert_eq!(answer == confirmed(1), is_confirmed, "at {at} ms: {answer:?}");
    }
}

#[test]
fn set_point_handed_back_after_what_may_answer_a_broadcast_was_not_answered() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.set_point(id(1), torque(2.0), ms(1)).unwrap();
    let in_mailbox = sent(&mut master, ms(1))[0];
    reply(&mut master, 1, TORQUE_REPLY, ms(2)).unwrap();
    let counted = |master: &Master<2>| (master.health(id(1)).answered, master.health(id(1)).lost);
    assert_eq!(counted(&master), (1, 0));
    master.handle_pushed_out(&in_mailbox);
    assert_eq!(counted(&master), (0, 0));
}

#[test]
fn move_to_all_does_not_follow_a_restart_whose_motor_is_resumed_at_once() {
    let mut master = Master::<2>::new(Config::CAN);
    let _reset = master.request(id(1), Reset).unwrap();
    master.broadcast(torque(1.0), id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(0)), [packet_to(1, Reset.encode())]);
    master.resume(id(1));
    assert_eq!((1..100).flat_map(|now| sent(&mut master, ms(now))).count(), 0);
}
