//! Stops, and when they are confirmed.

use super::*;

#[test]
fn stop_of_all_is_sent_first_and_refuses_motion_until_lifted() {
    let mut master = Master::<4>::new(Config::CAN);
    let in_flight = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    let waiting = master.request(id(2), step()).unwrap();
    master.stop_all(StopKind::Off, id(7).into()).unwrap();
    let packets = sent(&mut master, ms(1));
    assert_eq!(packets.len(), 3, "motors 1, 2 and 7, whatever is in flight");
    assert!(packets.iter().all(|packet| packet.data == Shutdown.encode()));
    let reported = events(&mut master, ms(1));
    assert!(reported.iter().any(|event| in_flight.outcome(event) == Some(Err(Failure::Stopped))));
    assert!(reported.iter().any(|event| waiting.outcome(event) == Some(Err(Failure::Stopped))));
    assert!(reported.contains(&Event::SetPointDropped { motor: id(1) }));

    assert_eq!(master.set_point(id(1), torque(1.0), ms(2)), Err(RequestError::Stopped));
    assert_eq!(master.request(id(3), step()).unwrap_err(), RequestError::Stopped);
    for motor in [1, 2] {
        let event = reply(&mut master, motor, Shutdown.encode(), ms(2));
        assert_eq!(event, Some(Event::StopConfirmed { motor: id(motor) }));
    }
    // Motor 7 is not there: it is sent 15 stops, then that is reported.
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
    let sent_at = |at| sent(&mut master, ms(at)).pop().map(|packet| packet.channel);
    let to = |motor| Some(Channel::Command(Target::Motor(id(motor))));
    let to_all = Some(Channel::Command(Target::All));
    let expected = [to_all, None, to(1), to(2), to(3), to(1)];
    assert_eq!([0, 5, 6, 56, 106, 156].map(sent_at), expected);
}

#[test]
fn no_older_set_point_follows_a_command_that_ends_motion() {
    fn never<C: Command + Copy>(end: C) {
        let mut master = Master::<2>::new(Config::CAN);
        obeys(&mut master, 1);
        master.set_point(id(1), torque(1.0), ms(0)).unwrap();
        let _offered = master.poll_transmit(ms(0));
        let ticket = master.request(id(1), end).unwrap();
        // What was offered before does not count as sent.
        master.handle_transmitted(ms(0));
        assert_eq!(sent(&mut master, ms(1))[0].data, end.encode());
        let answer = reply(&mut master, 1, end.encode(), ms(2));
        let reported: Vec<Event> = answer.into_iter().chain(events(&mut master, ms(2))).collect();
        assert!(reported.iter().any(|event| matches!(ticket.outcome(event), Some(Ok(_)))));
        assert!(reported.contains(&Event::SetPointDropped { motor: id(1) }));
        assert_eq!(sent(&mut master, ms(3_000)), []);
    }
    never(Shutdown);
    never(Stop);
    never(LockBrake);
    never(Reset);
}

#[test]
fn a_stop_is_not_confirmed_by_the_answer_to_an_earlier_one() {
    let mut master = Master::<2>::new(Config::CAN);
    obeys(&mut master, 1);
    let _ = ask(&mut master, 1, Stop, ms(0));
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(1)).len(), 1);
    // Which stop this answers is not known, so the motor gets one more.
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(2)), None);
    assert_eq!(sent(&mut master, ms(2)).len(), 1);
    let confirmed = Event::StopConfirmed { motor: id(1) };
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(3)), Some(confirmed));
}

#[test]
fn stop_does_not_hide_the_outcome_of_a_failed_request() {
    let mut master = Master::<2>::new(Config::CAN);
    let read = master.request(id(1), ReadMultiTurnAngle).unwrap();
    for attempt in 0..3 {
        sent(&mut master, ms(attempt * 21));
        master.handle_timeout(ms(attempt * 21 + 21));
    }
    // Given up, but not reported yet.
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    let reported = events(&mut master, ms(63));
    assert!(reported.iter().any(|event| read.outcome(event).is_some()), "{reported:?}");
}

#[test]
fn stop_is_confirmed_once_no_earlier_set_point_can_arrive() {
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
fn stop_is_sent_once_more_when_an_earlier_set_point_counts_as_lost() {
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
fn requested_shutdown_is_answered_once_no_lost_set_point_can_arrive() {
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
        // The set-point can no longer be answered, but still arrive.
        let unanswered = lost + Config::CAN.late_window;
        assert_eq!(master.poll_at(), Some(unanswered));
        assert_eq!(sent(&mut master, unanswered), []);
        assert_eq!(master.poll_at(), Some(over));
        assert_eq!(sent(&mut master, over)[0].data, Shutdown.encode());
        let reported = reply(&mut master, 1, Shutdown.encode(), over + Duration::from_millis(1));
        assert_eq!(ticket.unwrap().outcome(&reported.unwrap()), Some(Ok(Shutdown)));
    }
}

#[test]
fn no_set_point_is_sent_before_an_earlier_requested_shutdown() {
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
    let reported = reply(&mut master, 1, Shutdown.encode(), over + Duration::from_millis(1));
    assert_eq!(ticket.outcome(&reported.unwrap()), Some(Ok(Shutdown)));
    assert!(matches!(sent(&mut master, over + Duration::from_millis(1))[..], [_]), "its turn");
}

#[test]
fn cyclic_stop_of_all_is_confirmed_once_the_motor_answers() {
    let mut master = Master::<2>::new(Config::CAN);
    obeys(&mut master, 1);
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
fn on_rs485_cyclic_stop_of_all_does_not_block_a_motors_own_stop() {
    let of_motor_1 = |data| Frame { address: Target::Motor(id(1)), data };
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    master.handle_line(&of_motor_1(ANGLE_REPLY), ms(1)).unwrap();
    let mut reported = Vec::new();
    for now in 2..20 {
        master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
        for packet in sent(&mut master, ms(now)) {
            if packet.channel != Channel::Command(Target::All) {
                let answered = ms(now) + Duration::from_micros(900);
                reported.extend(master.handle_line(&of_motor_1(Stop.encode()), answered));
            }
        }
    }
    assert!(reported.contains(&Event::StopConfirmed { motor: id(1) }), "{reported:?}");
}

#[test]
fn stop_of_one_motor_leaves_the_others_moving() {
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
fn on_rs485_answering_motors_are_stopped_before_silent_ones() {
    let mut master = Master::<4>::new(Config::rs485(1_000_000, false));
    let line = |motor, data| Frame { address: Target::Motor(id(motor)), data };
    let mut now = ms(0);
    for motor in 1..=4 {
        let _ticket = master.request_with(id(motor), ReadModel, once(5)).unwrap();
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

/// Motor 1 has answered once, and no more; motor 2 was sent something last. Only its answer brings motor 2 forward.
#[test]
fn on_rs485_motor_gone_silent_is_stopped_after_answering_ones() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    for (motor, at, is_there) in [(1, 0, true), (1, 10, false), (2, 40, true)] {
        let _ticket = master.request_with(id(motor), ReadModel, once(5)).unwrap();
        assert_eq!(sent(&mut master, ms(at)).len(), 1);
        if is_there {
            let line = Frame { address: Target::Motor(id(motor)), data: *b"\xB5X8S2V10" };
            master.handle_line(&line, ms(at + 1)).unwrap();
        }
        events(&mut master, ms(at + 6));
    }
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(50)), [packet_to_all(Stop.encode())]);
    assert_eq!(sent(&mut master, ms(56)), [packet_to(2, Stop.encode())]);
}

#[test]
fn stop_lifted_before_it_was_sent_is_still_sent() {
    let mut master = Master::<2>::new(Config::CAN);
    let _read = master.request(id(1), ReadModel).unwrap();
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    master.lift_stop();
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    let packets = sent(&mut master, ms(0));
    assert_eq!(packets[0].data, Stop.encode(), "before anything newer");
}

/// Nothing was sent between the two: an answer to the first shows that the motor stands.
#[test]
fn stop_lifted_and_called_again_goes_on_unless_a_move_was_between() {
    let read = ReadMultiTurnAngle.encode();
    let brake = ReleaseBrake.encode();
    for (between, answer, goes_on) in [
        (None, None, true),
        (Some(read), Some(ANGLE_REPLY), true),
        (Some(brake), Some(brake), false),
    ] {
        let mut master = Master::<2>::new(Config::CAN);
        let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
        reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
        master.stop(id(1), StopKind::Off).unwrap();
        let now = is_given_up(&mut master, 1, 2);
        master.lift_stop();
        if let Some(data) = between {
            let moves = data == brake;
            let _ = ask(&mut master, 1, RawCommand::new(data, ReplyRule::Same, moves), ms(now));
            reply(&mut master, 1, answer.unwrap(), ms(now + 1)).unwrap();
        }
        master.stop(id(1), StopKind::Off).unwrap();
        assert_eq!(sent(&mut master, ms(now + 2)), [packet_to(1, Shutdown.encode())]);
        let reported = reply(&mut master, 1, Shutdown.encode(), ms(now + 3));
        assert_eq!(reported == confirmed(1), goes_on, "{between:X?}");
    }
}

/// The set-point was put after the first stop, and is older than the next one.
#[test]
fn set_point_that_waits_for_a_lifted_stop_is_dropped_by_the_next() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.lift_stop();
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(1)), confirmed(1));
    assert_eq!(sent(&mut master, ms(1)), []);
    assert_eq!(events(&mut master, ms(1)), [Event::SetPointDropped { motor: id(1) }]);
}

#[test]
fn motor_switched_off_is_not_switched_on_by_a_later_hold() {
    let mut master = Master::<4>::new(Config::CAN);
    obeys(&mut master, 1);
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
    obeys(&mut master, 2);
    // As a caller does that leaves a control loop.
    master.stop_all(StopKind::Hold, id(2).into()).unwrap();
    assert_eq!(first_stops(&mut master, ms(100)), [(2, 0x81)], "the one that has got no stop yet");
    assert_eq!(first_stops(&mut master, ms(102)), [(1, 0x80)]);
    master.lift_stop_of(id(1));
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(first_stops(&mut master, ms(200)), [(1, 0x80)], "all are stopped still");
    master.lift_stop();
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(first_stops(&mut master, ms(300)), [(1, 0x81)]);

    // Nor by one to all at once.
    let mut line = Master::<4>::new(Config::rs485(115_200, false));
    obeys(&mut line, 1);
    line.stop(id(1), StopKind::Off).unwrap();
    line.stop_all(StopKind::Hold, id(2).into()).unwrap();
    let first = line.poll_transmit(ms(0)).unwrap();
    assert_eq!((first.channel, first.data[0]), (Channel::Command(id(1).into()), 0x80));
}

#[test]
fn motor_switched_off_is_not_switched_on_by_a_requested_hold() {
    let mut master = Master::<4>::new(Config::CAN);
    obeys(&mut master, 1);
    obeys(&mut master, 2);
    let _read = ask(&mut master, 2, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 2, ANGLE_REPLY, ms(1)).unwrap();
    master.stop(id(2), StopKind::Hold).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(master.request(id(1), Stop).err(), Some(RequestError::Stopped));
    assert_eq!(sent(&mut master, ms(100)).len(), 2, "the stops");
    for (motor, stop) in [(1, Shutdown.encode()), (2, Stop.encode())] {
        reply(&mut master, motor, stop, ms(101)).unwrap();
    }
    assert!(master.request(id(2), Stop).is_ok(), "it is held already");
    assert!(master.request(id(1), Shutdown).is_ok());
    sent(&mut master, ms(102));
    reply(&mut master, 1, Shutdown.encode(), ms(103)).unwrap();
    assert_eq!(master.request(id(1), Stop).err(), Some(RequestError::Stopped));
    master.lift_stop_of(id(1));
    assert!(master.request(id(1), Stop).is_ok());
}

#[test]
fn stop_in_the_place_of_another_reports_no_failed_request() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Hold).unwrap();
    sent(&mut master, ms(0));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(events(&mut master, ms(0)), []);
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(events(&mut master, ms(0)), []);
}

#[test]
fn stop_is_not_confirmed_by_the_answer_to_an_earlier_stop_to_all() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    master.broadcast(Stop, id(1).into()).unwrap();
    sent(&mut master, ms(1));
    // It moves again, and is stopped individually.
    master.set_point(id(1), torque(1.0), ms(1)).unwrap();
    sent(&mut master, ms(1));
    reply(&mut master, 1, TORQUE_REPLY, ms(2)).unwrap();
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(sent(&mut master, ms(3)).len(), 1);
    let reported = reply(&mut master, 1, Stop.encode(), ms(4));
    assert_ne!(
        reported,
        Some(Event::StopConfirmed { motor: id(1) }),
        "that to all is not answered yet"
    );
    assert_eq!(sent(&mut master, ms(4)).len(), 1);
    let confirmed = Some(Event::StopConfirmed { motor: id(1) });
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(5)), confirmed);
}

#[test]
fn stop_is_confirmed_once_no_earlier_move_to_all_can_arrive() {
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
    reply(&mut master, 1, TORQUE_REPLY, ms(4)).unwrap();
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
fn lost_move_is_not_displaced_from_the_late_replies_by_reads() {
    let mut master = Master::<2>::new(Config::CAN);
    // A move and a read were given up, and a second read is in flight when the motor is stopped.
    let _ = master.request_with(id(1), step(), once(5)).unwrap();
    sent(&mut master, ms(0));
    events(&mut master, ms(5));
    let _ = master.request_with(id(1), ReadMultiTurnAngle, once(5)).unwrap();
    sent(&mut master, ms(5));
    events(&mut master, ms(10));
    let _ = master.request_with(id(1), ReadModel, once(5)).unwrap();
    sent(&mut master, ms(10));
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(11));
    // Once more before an answer came.
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(12));
    // The first is the answer to the earlier stop; after the second the move may yet come.
    for now in [13, 14, 15] {
        let reported = reply(&mut master, 1, Shutdown.encode(), ms(now));
        assert_ne!(reported, Some(Event::StopConfirmed { motor: id(1) }), "after {now} ms");
        sent(&mut master, ms(now));
    }
    // It is stopped once more when the move can come no more.
    let at = master.poll_at().unwrap();
    assert_eq!(sent(&mut master, at).len(), 1);
    let soon = at + Duration::from_millis(1);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), soon), confirmed(1));
}

#[test]
fn bus_down_extends_how_long_a_lost_set_point_may_arrive() {
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
fn motor_switched_off_individually_can_be_held_once_that_is_lifted() {
    let mut master = Master::<2>::new(Config::CAN);
    let stop = |master: &mut Master<2>, kind, now| {
        master.stop(id(1), kind).unwrap();
        let data = sent(master, ms(now))[0].data;
        assert_eq!(reply(master, 1, data, ms(now + 1)), confirmed(1));
        data
    };
    assert_eq!(stop(&mut master, StopKind::Off, 0), Shutdown.encode());
    assert_eq!(stop(&mut master, StopKind::Hold, 100), Shutdown.encode(), "it stays off");
    master.lift_stop_of(id(1));
    assert_eq!(stop(&mut master, StopKind::Hold, 200), Stop.encode());
}

/// How long a caller would wait for a move says nothing of when that arrives.
#[test]
fn stop_after_a_patient_move_is_confirmed_within_100_ms() {
    for config in [Config::CAN, Config::rs485(1_000_000, false)] {
        let mut master = Master::<2>::new(config);
        let for_ever = Patience { reply_timeout: Duration::from_secs(3_600), attempts: 1 };
        let _ = master.request_with(id(1), step(), for_ever).unwrap();
        assert_eq!(sent(&mut master, ms(100)).len(), 1);
        master.stop(id(1), StopKind::Off).unwrap();
        let mut confirmed_at = None;
        for now in 101..1_000 {
            for stop in sent(&mut master, ms(now)) {
                assert_eq!(stop, packet_to(1, Shutdown.encode()));
                let answer = match config.is_rs485() {
                    true => master
                        .handle_line(&Frame { address: id(1).into(), data: stop.data }, ms(now)),
                    false => reply(&mut master, 1, stop.data, ms(now) + Duration::from_micros(700)),
                };
                if answer == confirmed(1) {
                    confirmed_at = Some(now);
                }
            }
        }
        // 50 ms for the move, and a late window of 40.8 ms or 10.3 ms.
        let at = confirmed_at.expect("it is confirmed");
        assert!(at <= 200, "{at} ms");
    }
}

/// A request whose place the stop takes may be answered as late as the stop.
#[test]
fn late_window_of_a_replaced_read_begins_with_the_stops_time_out() {
    let mut master = Master::<2>::new(Config::CAN);
    let _read = ask(&mut master, 1, ReadModel, ms(0));
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(15));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(16)), confirmed(1));
    assert_eq!(events(&mut master, ms(16)).len(), 1);
    let _read = master.request(id(1), ReadModel).unwrap();
    assert_eq!(sent(&mut master, ms(75)), []);
    assert_eq!(sent(&mut master, ms(77)).len(), 1);
}

#[test]
fn answer_that_comes_before_a_stop_was_sent_does_not_confirm_it() {
    let mut master = Master::<2>::new(Config::CAN);
    let _read = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    assert_ne!(reply(&mut master, 1, Shutdown.encode(), ms(5)), confirmed(1));
    assert_eq!(sent(&mut master, ms(5)), [packet_to(1, Shutdown.encode())]);
}

/// The request has three attempts, and its answer is no confirmation.
#[test]
fn repeated_stop_takes_the_place_of_a_requested_shutdown() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(0));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(1)), confirmed(1));
    let ticket = ask(&mut master, 1, Shutdown, ms(2));
    master.stop(id(1), StopKind::Off).unwrap();
    let stopped = Event::Failed { ticket: ticket.id(), failure: Failure::Stopped };
    assert_eq!(events(&mut master, ms(3)), [stopped]);
    assert_eq!(sent(&mut master, ms(3)), [packet_to(1, Shutdown.encode())]);
}

/// It is the only stop that these motors get, and none confirms it.
#[test]
fn stop_of_all_called_again_is_sent_to_all_while_no_motor_is_known() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    for now in [0, 10, 20] {
        master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
        assert_eq!(sent(&mut master, ms(now)), [packet_to_all(Shutdown.encode())]);
    }
}

#[test]
fn stop_of_more_motors_than_places_is_sent_to_all() {
    let mut master = Master::<1>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    assert!(master.stop_all(StopKind::Off, id(2).into()).is_err());
    let expected = [packet_to_all(Shutdown.encode()), packet_to(1, Shutdown.encode())];
    assert_eq!(sent(&mut master, ms(1)), expected);
}

#[test]
fn on_rs485_stop_to_all_of_another_kind_is_sent_at_once() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    master.stop_all(StopKind::Hold, id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(1)), [packet_to_all(Stop.encode())]);
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(20)), [packet_to_all(Shutdown.encode())]);
}

#[test]
fn motor_new_in_a_repeated_stop_is_stopped_before_the_others_again() {
    type Again = fn(&mut Master<2>);
    let ways: [Again; 2] = [
        |master| master.stop_all(StopKind::Hold, id(2).into()).unwrap(),
        |master| {
            master.stop(id(1), StopKind::Hold).unwrap();
            master.stop(id(2), StopKind::Hold).unwrap();
        },
    ];
    for again in ways {
        let mut master = Master::<2>::new(Config::CAN);
        obeys(&mut master, 1);
        master.stop_all(StopKind::Hold, id(1).into()).unwrap();
        assert_eq!(sent(&mut master, ms(0)), [packet_to(1, Stop.encode())]);
        assert_eq!(reply(&mut master, 1, Stop.encode(), ms(1)), confirmed(1));
        obeys(&mut master, 2);
        again(&mut master);
        assert_eq!(sent(&mut master, ms(2)), [packet_to(2, Stop.encode())]);
        assert_eq!(reply(&mut master, 2, Stop.encode(), ms(3)), confirmed(2));
        assert_eq!(sent(&mut master, ms(3)), [packet_to(1, Stop.encode())]);
    }
}

/// Motor 1 was stopped like this `before`, and something was sent to it `since`. Whether it is stopped now before the
/// second attempt of motor 3, which is older.
fn is_first(
    before: impl FnOnce(&mut Master<4>),
    since: impl FnOnce(&mut Master<4>) -> (Packet, Data),
) -> bool {
    let mut master = Master::<4>::new(Config::CAN);
    obeys(&mut master, 1);
    before(&mut master);
    assert_eq!(sent(&mut master, ms(0)), [packet_to(1, Shutdown.encode())]);
    reply(&mut master, 1, Shutdown.encode(), ms(1)).unwrap();
    events(&mut master, ms(1));
    master.lift_stop();
    master.stop(id(3), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(2)).len(), 1);
    let (packet, answer) = since(&mut master);
    assert_eq!(sent(&mut master, ms(3)), [packet]);
    reply(&mut master, 1, answer, ms(4));
    events(&mut master, ms(10));
    master.stop(id(1), StopKind::Off).unwrap();
    let stops = sent(&mut master, ms(30));
    stops.first() == Some(&packet_to(1, Shutdown.encode()))
}

#[test]
fn stopped_motor_goes_after_others_until_it_is_sent_a_move() {
    let stop = |master: &mut Master<4>| master.stop(id(1), StopKind::Off).unwrap();
    let asks = |master: &mut Master<4>| {
        let _asked = master.request(id(1), Shutdown).unwrap();
    };
    let sends = |data: Data, moves: bool| {
        move |master: &mut Master<4>| {
            let _sent = master.request(id(1), RawCommand::new(data, ReplyRule::Same, moves));
            (packet_to(1, data), data)
        }
    };
    let read = ReadMultiTurnAngle.encode();
    assert!(!is_first(stop, sends(read, false)));
    assert!(is_first(asks, sends(read, false)), "a caller's own command is no stop");
    assert!(is_first(stop, sends(ReleaseBrake.encode(), true)));
    // 0xB6 moves nothing, and is refused all the same.
    let report = [0xB6, 0x60, 0, 0, 0, 0, 0, 0];
    assert!(is_first(stop, sends(report, false)));
    let streams = |master: &mut Master<4>| {
        master.set_point(id(1), torque(1.0), ms(3)).unwrap();
        (packet_to(1, torque(1.0).encode()), TORQUE_REPLY)
    };
    assert!(is_first(stop, streams));
}

/// Somebody presses a button just before.
#[test]
fn a_stop_is_not_lifted_by_whoever_knows_only_of_those_before() {
    let stops: [fn(&mut Master<2>); 2] = [
        |master| master.stop(id(1), StopKind::Hold).unwrap(),
        |master| master.stop_all(StopKind::Hold, id(1).into()).unwrap(),
    ];
    for stop in stops {
        let mut master = Master::<2>::new(Config::CAN);
        stop(&mut master);
        let known = master.stop_count();
        stop(&mut master);
        assert!(!master.lift_stop_if(known));
        assert!(master.is_stopped(id(1)));
        let known = master.stop_count();
        assert!(master.lift_stop_if(known));
        assert!(!master.is_stopped(id(1)));
    }
}
