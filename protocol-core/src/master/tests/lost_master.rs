//! Drives that have lost their master send the first command back and ignore it.

use super::*;
use crate::command::CommunicationLossProtection;
use crate::units::Milliseconds;

/// A minute (2.29).
const RUN_TIME_REPLY: Data = [0xB1, 0, 0, 0, 0x60, 0xEA, 0, 0];

#[test]
fn echo_of_a_drive_that_lost_its_master_is_no_answer() {
    let mut master = Master::<2>::new(Config::CAN);
    let read = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    let lost = reply(&mut master, 1, [0xF1, 0, 0, 0, 0, 0, 0, 0], ms(1)).unwrap();
    assert_eq!(lost, Event::LostMaster { motor: id(1) });
    // The drive echoes the command and does nothing: an angle of 0 would be a lie.
    assert_eq!(reply(&mut master, 1, ReadMultiTurnAngle.encode(), ms(2)), None);
    assert_eq!(sent(&mut master, ms(2)).len(), 1, "sent again");
    let event = reply(&mut master, 1, ANGLE_REPLY, ms(3)).unwrap();
    assert!(read.outcome(&event).unwrap().is_ok());

    // The stop that is echoed so is sent again as well. The next two answers make communication steady.
    reply(&mut master, 1, [0xF1, 0, 0, 0, 0, 0, 0, 0], ms(4));
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    for now in 5..9 {
        assert_eq!(sent(&mut master, ms(now)).len(), 1);
        let expected = if now == 8 { confirmed(1) } else { None };
        assert_eq!(reply(&mut master, 1, Stop.encode(), ms(now + 1)), expected);
    }
}

/// Its message (0xF1) comes once a second: a master that has just begun may not have heard it.
#[test]
fn first_answer_of_all_that_equals_its_command_is_asked_for_again() {
    let mut master = Master::<2>::new(Config::CAN);
    let read = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    assert_eq!(reply(&mut master, 1, ReadMultiTurnAngle.encode(), ms(1)), None);
    assert_eq!(sent(&mut master, ms(1))[0].data, ReadMultiTurnAngle.encode());
    let event = reply(&mut master, 1, ANGLE_REPLY, ms(2)).unwrap();
    assert!(read.outcome(&event).unwrap().is_ok());

    // A shaft at 0 says so twice, and from then on once.
    let read = ask(&mut master, 2, ReadMultiTurnAngle, ms(3));
    assert_eq!(reply(&mut master, 2, ReadMultiTurnAngle.encode(), ms(4)), None);
    assert_eq!(sent(&mut master, ms(4)).len(), 1);
    let event = reply(&mut master, 2, ReadMultiTurnAngle.encode(), ms(5)).unwrap();
    assert!(read.outcome(&event).unwrap().is_ok());
    let read = ask(&mut master, 2, ReadMultiTurnAngle, ms(6));
    let event = reply(&mut master, 2, ReadMultiTurnAngle.encode(), ms(7)).unwrap();
    assert!(read.outcome(&event).unwrap().is_ok());
    let counts = [1, 2].map(|motor| master.health(id(motor))).map(|it| (it.answered, it.lost));
    assert_eq!(counts, [(2, 0), (3, 0)]);
}

/// That is no attempt that has failed.
#[test]
fn first_answer_of_all_costs_no_attempt() {
    let mut master = Master::<2>::new(Config::CAN);
    let twice = Patience { attempts: 2, reply_timeout: Duration::from_millis(5) };
    let read = master.request_with(id(1), ReadMultiTurnAngle, twice).unwrap();
    sent(&mut master, ms(0));
    assert_eq!(reply(&mut master, 1, ReadMultiTurnAngle.encode(), ms(1)), None);
    assert_eq!(sent(&mut master, ms(1)).len(), 1);
    // The second is lost.
    assert_eq!(sent(&mut master, ms(6)).len(), 1, "the second attempt");
    let event = reply(&mut master, 1, ANGLE_REPLY, ms(7)).unwrap();
    assert!(read.outcome(&event).unwrap().is_ok());
}

/// It may be the echo of a further attempt, for which the late answer to the first was taken.
#[test]
fn first_answer_of_all_to_one_of_two_attempts_is_believed_where_commands_are_echoed() {
    for (echo, attempts, is_believed) in
        [(true, 1, false), (true, 2, true), (false, 1, false), (false, 2, false)]
    {
        let mut master = Master::<2>::new(Config::rs485(115_200, echo));
        let read = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
        let sent_at = [0, 10][attempts - 1];
        assert_eq!(sent(&mut master, ms(sent_at)).len(), attempts - 1, "the second attempt");
        let packet = Packet { channel: Channel::Reply(id(1)), data: ReadMultiTurnAngle.encode() };
        let frame = Frame::from_packet(&packet).unwrap();
        let event = master.handle_line(&frame, ms(sent_at + 4));
        let is_answer =
            event.is_some_and(|event| read.outcome(&event).is_some_and(|it| it.is_ok()));
        assert_eq!(is_answer, is_believed, "{echo} {attempts}");
    }
}

/// What may not be sent twice, and what may be sent only once.
#[test]
fn first_answer_of_all_is_believed_if_it_cannot_be_asked_for_again() {
    let mut master = Master::<2>::new(Config::CAN);
    let protection = CommunicationLossProtection { timeout: Milliseconds::from_raw(500) };
    let protects = ask(&mut master, 1, protection, ms(0));
    let event = reply(&mut master, 1, protection.encode(), ms(1)).unwrap();
    assert!(protects.outcome(&event).unwrap().is_ok());
    let read = master.request_with(id(2), ReadMultiTurnAngle, once(5)).unwrap();
    sent(&mut master, ms(2));
    let event = reply(&mut master, 2, ReadMultiTurnAngle.encode(), ms(3)).unwrap();
    assert!(read.outcome(&event).unwrap().is_ok());
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
        // Which of the two that were sent before was ignored, if any, is not known: it may be the next.
        let event = reply(&mut master, 1, [0xA1, 0x32, 0, 0, 0, 0, 0, 0], ms(24));
        assert!(matches!(event, Some(Event::Stray { .. })), "{event:?}");
        let _read = ask(&mut master, 1, ReadMultiTurnAngle, ms(25));
        assert_eq!(reply(&mut master, 1, ReadMultiTurnAngle.encode(), ms(26)), None);
    }
}

#[test]
fn unknown_drive_that_lost_its_master_ignores_its_first_command() {
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
fn stop_whose_last_attempt_is_ignored_is_given_up_and_goes_on() {
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
    assert_eq!(events(&mut master, answered), [Event::StopUnconfirmed { motor: id(1) }]);
    let again = answered + Duration::from_millis(100);
    assert_eq!(sent(&mut master, again), [packet_to(1, Shutdown.encode())]);
    assert_eq!(
        reply(&mut master, 1, Shutdown.encode(), again + once(1).reply_timeout),
        confirmed(1)
    );
}

#[test]
fn ignored_command_is_resent_only_if_harmless_and_attempts_are_left() {
    let twice = Patience { attempts: 2, ..once(5) };
    let not_executed = Failure::NotExecuted;
    let mut master = Master::<2>::new(Config::CAN);
    reply(&mut master, 1, [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0], ms(0));
    let moved = master.request_with(id(1), step(), twice).unwrap();
    sent(&mut master, ms(1));
    assert_eq!(reply(&mut master, 1, step().encode(), ms(2)), None);
    assert_eq!(sent(&mut master, ms(2)), []);
    assert_eq!(moved.outcome(&events(&mut master, ms(2))[0]), Some(Err(not_executed)));

    reply(&mut master, 2, [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0], ms(10));
    let read = master.request_with(id(2), ReadMultiTurnAngle, once(5)).unwrap();
    sent(&mut master, ms(11));
    assert_eq!(reply(&mut master, 2, ReadMultiTurnAngle.encode(), ms(12)), None);
    assert_eq!(sent(&mut master, ms(12)), []);
    assert_eq!(read.outcome(&events(&mut master, ms(12))[0]), Some(Err(not_executed)));
}

#[test]
fn forgotten_motor_that_lost_its_master_ignores_its_first_command() {
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
fn answer_with_values_after_a_lost_master_is_not_ignored() {
    let mut master = Master::<2>::new(Config::CAN);
    let read = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, [0xF1, 0, 0, 0, 0, 0, 0, 0], ms(1)).unwrap();
    assert_eq!(master.health(id(1)).last_seen, Some(ms(1)));
    let event = reply(&mut master, 1, ANGLE_REPLY, ms(2)).unwrap();
    assert!(read.outcome(&event).is_some());
    // That was sent before: it may ignore the next one, and no more.
    let off = ask(&mut master, 1, Shutdown, ms(2));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(3)), None);
    assert_eq!(sent(&mut master, ms(3)).len(), 1);
    let event = reply(&mut master, 1, Shutdown.encode(), ms(4)).unwrap();
    assert!(off.outcome(&event).is_some());
    master.set_point(id(1), torque(1.0), ms(5)).unwrap();
    sent(&mut master, ms(5));
    reply(&mut master, 1, [0xF1, 0, 0, 0, 0, 0, 0, 0], ms(6)).unwrap();
    assert!(matches!(reply(&mut master, 1, TORQUE_REPLY, ms(7)), Some(Event::Feedback { .. })));
}

/// A master that starts between two of a drive's messages has not heard that the drive has lost its master.
#[test]
fn echo_of_a_move_is_no_answer_though_no_lost_master_was_reported() {
    let mut master = Master::<2>::new(Config::CAN);
    let moved = ask(&mut master, 1, step(), ms(0));
    // It would be feedback of 0 degrees Celsius and 1 A.
    assert_eq!(reply(&mut master, 1, step().encode(), ms(1)), None);
    assert_eq!(sent(&mut master, ms(1)), []);
    assert_eq!(moved.outcome(&events(&mut master, ms(1))[0]), Some(Err(Failure::NotExecuted)));
    master.set_point(id(1), torque(1.0), ms(2)).unwrap();
    sent(&mut master, ms(2));
    let event = reply(&mut master, 1, torque(1.0).encode(), ms(3));
    assert_eq!(event, Some(Event::SetPointUnanswered { motor: id(1) }));
    assert_eq!(master.latest_feedback(id(1)), None);
}

#[test]
fn answer_that_may_equal_its_command_counts() {
    let mut master = Master::<2>::new(Config::CAN);
    // At rest, at 0 degrees and 0 degrees Celsius.
    master.set_point(id(1), torque(0.0), ms(0)).unwrap();
    sent(&mut master, ms(0));
    let event = reply(&mut master, 1, torque(0.0).encode(), ms(1));
    assert!(matches!(event, Some(Event::Feedback { .. })), "{event:?}");
    // One of which its caller says that it is acknowledged.
    let raw = RawCommand::new([0xC0, 0, 1, 2, 3, 4, 5, 6], ReplyRule::Same, false);
    let read = ask(&mut master, 1, raw, ms(2));
    let event = reply(&mut master, 1, raw.encode(), ms(3)).unwrap();
    assert!(read.outcome(&event).unwrap().is_ok());
}

#[test]
fn echo_of_an_ignored_broadcast_is_no_answer() {
    // Whether its message was heard, or shows by values that are those of the command.
    let heard = |master: &mut Master<2>| {
        reply(master, 1, [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0], ms(10)).unwrap();
    };
    for (is_heard, is_value) in [(true, false), (false, true)] {
        let mut master = Master::<2>::new(Config::CAN);
        let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
        reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
        if is_heard {
            heard(&mut master);
        }
        let echo = if is_value { torque(1.0).encode() } else { Shutdown.encode() };
        match is_value {
            true => master.broadcast(torque(1.0), id(1).into()).unwrap(),
            false => master.broadcast(Shutdown, id(1).into()).unwrap(),
        }
        assert_eq!(sent(&mut master, ms(11)).len(), 1);
        let event = reply(&mut master, 1, echo, ms(12));
        assert!(!matches!(event, Some(Event::BroadcastReply { .. })), "{event:?}");
        let silent = id(1).into();
        let reported = events(&mut master, ms(60));
        assert!(
            reported.contains(&Event::BroadcastDone { silent, was_sent: true }),
            "{reported:?}"
        );
        // It ignores one, and executes the next.
        let save = FunctionControl::SaveMultiTurn(Switch::On);
        let write = ask(&mut master, 1, save, ms(200));
        let event = reply(&mut master, 1, save.encode(), ms(201)).unwrap();
        assert!(write.outcome(&event).unwrap().is_ok(), "{event:?}");
    }
}

/// The message of the loss goes before feedback that waits in the drive, since it has the lower identifier.
#[test]
fn feedback_sent_before_the_loss_leaves_the_next_command_ignored() {
    // In time, or late.
    for said_at in [1, 22] {
        let mut master = Master::<2>::new(Config::CAN);
        master.set_point(id(1), motion(), ms(0)).unwrap();
        sent(&mut master, ms(0));
        events(&mut master, ms(said_at));
        reply(&mut master, 1, [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0], ms(said_at)).unwrap();
        let feedback = motion_feedback(&mut master, ms(said_at + 1));
        assert_eq!(matches!(feedback, Some(Event::Feedback { .. })), said_at == 1, "{feedback:?}");
        let read = ask(&mut master, 1, ReadMultiTurnAngle, ms(24));
        // All zero: 0 degrees, if it were an answer.
        assert_eq!(reply(&mut master, 1, ReadMultiTurnAngle.encode(), ms(25)), None);
        assert_eq!(sent(&mut master, ms(25)).len(), 1, "it is asked again");
        let event = reply(&mut master, 1, ANGLE_REPLY, ms(26)).unwrap();
        assert!(read.outcome(&event).unwrap().is_ok());
        // It ignores one, and no more.
        let write = ask(&mut master, 1, FunctionControl::SaveMultiTurn(Switch::On), ms(30));
        let event =
            reply(&mut master, 1, FunctionControl::SaveMultiTurn(Switch::On).encode(), ms(31));
        assert!(write.outcome(&event.unwrap()).unwrap().is_ok());
    }
}

/// The answer may also be an ignored command that is sent back: it ends nothing, and the next command may be ignored.
#[test]
fn answer_equal_to_its_command_does_not_show_what_the_drive_ignored() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0], ms(1)).unwrap();
    // 0 degrees. It waited in the drive.
    assert_eq!(reply(&mut master, 1, ReadMultiTurnAngle.encode(), ms(2)), None);
    master.stop(id(1), StopKind::Off).unwrap();
    for now in [3, 5] {
        assert_eq!(sent(&mut master, ms(now)), [packet_to(1, Shutdown.encode())]);
        let event = reply(&mut master, 1, Shutdown.encode(), ms(now + 1));
        assert_eq!(event, if now == 3 { None } else { confirmed(1) });
    }
}

#[test]
fn answer_to_a_broadcast_before_the_loss_leaves_the_next_command_ignored() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    master.broadcast(Shutdown, id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(2)).len(), 1);
    reply(&mut master, 1, [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0], ms(3)).unwrap();
    reply(&mut master, 1, Shutdown.encode(), ms(4));
    events(&mut master, ms(100));
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(200));
    assert_eq!(reply(&mut master, 1, ReadMultiTurnAngle.encode(), ms(201)), None, "ignored");
}

/// A read was sent before the message and after it: which of the two was answered, and which ignored, is not known.
#[test]
fn answer_to_one_of_two_attempts_does_not_show_what_was_ignored() {
    let mut master = Master::<2>::new(Config::CAN);
    let read = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, [0xF1, 0, 0, 0, 0, 0, 0, 0], ms(2)).unwrap();
    assert_eq!(sent(&mut master, ms(21)).len(), 1);
    let answer = reply(&mut master, 1, ANGLE_REPLY, ms(22)).unwrap();
    assert!(read.outcome(&answer).is_some());
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(25)).len(), 1);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(26)), None);
    assert_eq!(sent(&mut master, ms(26)).len(), 1, "once more");
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(27)), confirmed(1));
}

/// The echo of the set-point is all 0, as feedback may be.
#[test]
fn a_set_point_of_0_that_was_ignored_is_no_feedback() {
    let mut master = Master::<2>::new(Config::CAN);
    reply(&mut master, 1, [0xF1, 0, 0, 0, 0, 0, 0, 0], ms(0)).unwrap();
    master.set_point(id(1), torque(0.0), ms(1)).unwrap();
    assert_eq!(sent(&mut master, ms(1)).len(), 1);
    let echo = reply(&mut master, 1, torque(0.0).encode(), ms(2));
    assert_eq!(echo, Some(Event::SetPointUnanswered { motor: id(1) }));
}

/// The load that the brake holds would fall, after a shutdown or after the caller has withdrawn the release.
#[test]
fn ignored_brake_release_is_not_resent_once_it_was_ended() {
    for is_withdrawn in [true, false] {
        let mut master = Master::<2>::new(Config::CAN);
        reply(&mut master, 1, [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0], ms(0)).unwrap();
        let release = ask(&mut master, 1, ReleaseBrake, ms(1));
        if is_withdrawn {
            master.withdraw(release.id());
        } else {
            master.broadcast(Shutdown, id(1).into()).unwrap();
        }
        assert_eq!(reply(&mut master, 1, ReleaseBrake.encode(), ms(2)), None);
        let reported = events(&mut master, ms(2));
        assert_eq!(release.outcome(&reported[0]), Some(Err(Failure::NotExecuted)));
        let released = packet_to(1, ReleaseBrake.encode());
        for now in [2, 4, 30, 100] {
            assert!(!sent(&mut master, ms(now)).contains(&released), "{is_withdrawn}");
        }
    }
}

/// The bytes are those of the command to all.
#[test]
fn the_echo_of_an_ignored_move_to_all_is_no_feedback_of_a_set_point() {
    let mut master = Master::<2>::new(Config::CAN);
    reply(&mut master, 1, [0xF1, 0, 0, 0, 0, 0, 0, 0], ms(0)).unwrap();
    master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(1)), [packet_to_all(torque(1.0).encode())]);
    master.set_point(id(1), torque(2.0), ms(1)).unwrap();
    assert_eq!(sent(&mut master, ms(1)), [packet_to(1, torque(2.0).encode())]);
    let event = reply(&mut master, 1, torque(1.0).encode(), ms(2));
    assert_eq!(event, Some(Event::SetPointUnanswered { motor: id(1) }));
}

/// Its message was not heard. A drive takes longer than a millisecond to start, so that no run time is 0.
#[test]
fn a_run_time_of_zero_is_a_read_that_was_ignored() {
    let mut master = Master::<2>::new(Config::CAN);
    let read = ask(&mut master, 1, ReadRunTime, ms(0));
    let event = reply(&mut master, 1, RUN_TIME_REPLY, ms(1)).unwrap();
    assert!(read.outcome(&event).unwrap().is_ok());
    let read = ask(&mut master, 1, ReadRunTime, ms(2));
    assert_eq!(reply(&mut master, 1, ReadRunTime.encode(), ms(3)), None);
    assert_eq!(sent(&mut master, ms(3)).len(), 1, "it is asked again");
    let event = reply(&mut master, 1, RUN_TIME_REPLY, ms(4)).unwrap();
    assert!(read.outcome(&event).unwrap().is_ok());
    assert!(!master.has_restarted(id(1)));
    let read = master.request_with(id(1), ReadRunTime, once(5)).unwrap();
    sent(&mut master, ms(5));
    reply(&mut master, 1, ReadRunTime.encode(), ms(6));
    let events = events(&mut master, ms(6));
    assert_eq!(events, [Event::Failed { ticket: read.id(), failure: Failure::NotExecuted }]);
    assert!(!master.has_restarted(id(1)));
}

/// Its message was not heard, nor may the angle be 0.
#[test]
fn the_first_answer_after_a_pause_is_asked_for_again_if_it_equals_the_read() {
    for (pause, is_asked_again) in [(150, false), (151, true)] {
        let mut master = Master::<2>::new(Config::CAN);
        let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
        reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
        let read = ask(&mut master, 1, ReadMultiTurnAngle, ms(pause));
        let first = reply(&mut master, 1, ReadMultiTurnAngle.encode(), ms(pause + 1));
        assert_eq!(first.is_none(), is_asked_again);
        if is_asked_again {
            assert_eq!(sent(&mut master, ms(pause + 2)).len(), 1);
            let again = reply(&mut master, 1, ReadMultiTurnAngle.encode(), ms(pause + 3));
            assert!(read.outcome(&again.unwrap()).unwrap().is_ok(), "0 degrees all the same");
        }
    }
}

#[test]
fn command_to_all_that_comes_back_after_the_loss_is_not_the_ignored_one() {
    let mut master = Master::<2>::new(Config::CAN);
    obeys(&mut master, 1);
    master.broadcast(LockBrake, id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(2)).len(), 1);
    reply(&mut master, 1, [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0], ms(3)).unwrap();
    reply(&mut master, 1, LockBrake.encode(), ms(4));
    assert!(master.has_lost_master(id(1)), "it may ignore the next command");
}
