//! Drives that have lost their master send the first command back and ignore it.

use super::*;

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
fn a_drive_that_has_lost_its_master_and_says_more_than_the_command_has_not_ignored_it() {
    let mut master = Master::<2>::new(Config::CAN);
    let read = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, [0xF1, 0, 0, 0, 0, 0, 0, 0], ms(1)).unwrap();
    assert_eq!(master.health(id(1)).last_seen, Some(ms(1)));
    let event = reply(&mut master, 1, ANGLE_REPLY, ms(2)).unwrap();
    assert!(read.outcome(&event).is_some());
    master.set_point(id(1), torque(1.0), ms(3)).unwrap();
    sent(&mut master, ms(3));
    reply(&mut master, 1, [0xF1, 0, 0, 0, 0, 0, 0, 0], ms(4)).unwrap();
    assert!(matches!(reply(&mut master, 1, TORQUE_REPLY, ms(5)), Some(Event::Feedback { .. })));
}
