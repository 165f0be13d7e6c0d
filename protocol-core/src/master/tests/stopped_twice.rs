//! Stops that are confirmed by a second answer, because a mailbox may hold what moves.

use super::*;

/// How many answers it takes until a stop of motor 1 that begins at 500 ms is confirmed.
fn answers_that_confirm(before: impl FnOnce(&mut Master<2>)) -> u32 {
    let mut master = Master::<2>::new(Config::CAN);
    before(&mut master);
    events(&mut master, ms(500));
    master.stop(id(1), StopKind::Off).unwrap();
    let mut answers = 0;
    for now in 500..600 {
        if !sent(&mut master, ms(now)).is_empty() {
            answers += 1;
            if reply(&mut master, 1, Shutdown.encode(), ms(now + 1)) == confirmed(1) {
                return answers;
            }
        }
    }
    panic!("{answers} answers do not confirm it")
}

#[test]
fn motor_moved_by_a_broadcast_confirms_a_stop_with_its_second_answer() {
    let moves = |master: &mut Master<2>| {
        master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
        sent(master, ms(10));
        events(master, ms(200));
    };
    // Nothing was heard since; or one frame, on a cable that makes contact for a moment; or many.
    assert_eq!(answers_that_confirm(moves), 2);
    for heard in [1, 20] {
        let count = answers_that_confirm(|master| {
            moves(master);
            (0..heard).for_each(|time| {
                reply(master, 2, ANGLE_REPLY, ms(210 + 10 * time));
            });
        });
        assert_eq!(count, 2, "{heard} frames");
    }
    // A motor that gets its place only since may be moved, too: here it has none before its stop.
    let count = answers_that_confirm(|master| {
        let _ = ask(master, 2, ReadMultiTurnAngle, ms(1));
        reply(master, 2, ANGLE_REPLY, ms(2)).unwrap();
        moves(master);
    });
    assert_eq!(count, 2);
    // Not a motor that has answered that, or has been stopped since.
    let answered = |master: &mut Master<2>| {
        master.broadcast(torque(1.0), id(1).into()).unwrap();
        sent(master, ms(10));
        reply(master, 1, TORQUE_REPLY, ms(11)).unwrap();
        events(master, ms(200));
    };
    assert_eq!(answers_that_confirm(answered), 1);
    // A motor that has answered one of two may still get the other.
    let answered_one = |master: &mut Master<2>| {
        for at in [10, 11] {
            master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
            assert_eq!(sent(master, ms(at)).len(), 1);
            events(master, ms(at));
        }
        reply(master, 1, TORQUE_REPLY, ms(12));
        for at in [100, 200] {
            reply(master, 2, ANGLE_REPLY, ms(at));
            events(master, ms(at + 90));
        }
    };
    assert_eq!(answers_that_confirm(answered_one), 2);
    let ended = |master: &mut Master<2>| {
        moves(master);
        for at in [210, 300] {
            let _ = master.request(id(1), Shutdown);
            sent(master, ms(at));
            reply(master, 1, Shutdown.encode(), ms(at + 1));
        }
    };
    assert_eq!(answers_that_confirm(ended), 1);
    // Nor a motor that nothing has moved.
    assert_eq!(answers_that_confirm(|_| {}), 1);
}

#[test]
fn shutdown_answered_once_does_not_show_that_a_move_to_all_arrived() {
    let shut_down_once = |master: &mut Master<2>| {
        master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
        sent(master, ms(10));
        events(master, ms(200));
        let ticket = ask(master, 1, Shutdown, ms(210));
        assert_eq!(reply(master, 1, Shutdown.encode(), ms(211)), None);
        // The bus is cut before it goes once more.
        master.handle_bus_down(ms(212));
        let reported = events(master, ms(212));
        assert!(reported.iter().any(|event| ticket.outcome(event) == Some(Err(Failure::BusDown))));
        reply(master, 2, ANGLE_REPLY, ms(400));
    };
    assert_eq!(answers_that_confirm(shut_down_once), 2);
}

#[test]
fn set_point_lost_in_a_cut_takes_a_stop_two_answers() {
    let given_up = |master: &mut Master<2>| {
        master.set_point(id(1), motion(), ms(0)).unwrap();
        sent(master, ms(0));
        (1..200).for_each(|now| drop(events(master, ms(now))));
    };
    assert_eq!(answers_that_confirm(given_up), 2);
    // One frame says that the bus was whole for a moment; another, when all must have come, that it still is.
    for (heard, answers) in [(&[210][..], 2), (&[210, 300], 1)] {
        let count = answers_that_confirm(|master| {
            given_up(master);
            for &at in heard {
                reply(master, 2, ANGLE_REPLY, ms(at));
                events(master, ms(at + 50));
            }
        });
        assert_eq!(count, answers, "{heard:?}");
    }
}

/// A move of all stays in a mailbox through a cut; motor 2 is heard twice since.
fn moved_in_a_cut(master: &mut Master<2>) {
    master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
    sent(master, ms(10));
    events(master, ms(10));
    for at in [200, 280] {
        reply(master, 2, ANGLE_REPLY, ms(at));
        events(master, ms(at + 50));
    }
}

/// The first answer to a stop at this time confirms nothing. Returns when the second does.
fn confirmed_after(master: &mut Master<2>, at: u64) -> u64 {
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(master, ms(at)).len(), 1);
    assert_eq!(reply(master, 1, Shutdown.encode(), ms(at + 1)), None);
    for now in at + 1..at + 200 {
        if !sent(master, ms(now)).is_empty() {
            assert_eq!(reply(master, 1, Shutdown.encode(), ms(now + 1)), confirmed(1));
            return now - at;
        }
    }
    panic!("it never goes again")
}

#[test]
fn second_answer_confirms_a_late_window_after_the_first() {
    let window = Config::CAN.late_window.as_millis();
    let mut master = Master::<2>::new(Config::CAN);
    moved_in_a_cut(&mut master);
    assert!(confirmed_after(&mut master, 400) >= window);
    // What else was sent is over soon, which says nothing of the move of all.
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(10));
    events(&mut master, ms(10));
    reply(&mut master, 2, ANGLE_REPLY, ms(200));
    events(&mut master, ms(200));
    assert!(confirmed_after(&mut master, 230) >= window);
    let mut master = Master::<2>::new(Config::CAN);
    moved_in_a_cut(&mut master);
    master.set_point(id(1), torque(1.0), ms(400)).unwrap();
    sent(&mut master, ms(400));
    events(&mut master, ms(421));
    reply(&mut master, 2, ANGLE_REPLY, ms(425));
    events(&mut master, ms(463));
    assert!(confirmed_after(&mut master, 463) >= window);
}

#[test]
fn answer_to_another_broadcast_does_not_answer_the_move_to_all() {
    for command in [ReadMultiTurnAngle.encode(), Stop.encode(), torque(2.0).encode()] {
        let mut master = Master::<2>::new(Config::CAN);
        moved_in_a_cut(&mut master);
        let (answer, accepted) = match command[0] {
            0x92 => (ANGLE_REPLY, master.broadcast(ReadMultiTurnAngle, id(1).into())),
            0x81 => (command, master.broadcast(Stop, id(1).into())),
            _ => (TORQUE_REPLY, master.broadcast(torque(2.0), id(1).into())),
        };
        accepted.unwrap();
        sent(&mut master, ms(400));
        reply(&mut master, 1, answer, ms(401)).unwrap();
        events(&mut master, ms(401));
        confirmed_after(&mut master, 402);
    }
}

#[test]
fn answer_to_the_first_of_two_set_points_in_a_cut_is_not_the_seconds() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    sent(&mut master, ms(0));
    events(&mut master, ms(21));
    reply(&mut master, 2, ANGLE_REPLY, ms(100));
    events(&mut master, ms(200));
    master.set_point(id(1), torque(2.0), ms(300)).unwrap();
    sent(&mut master, ms(300));
    events(&mut master, ms(321));
    reply(&mut master, 1, TORQUE_REPLY, ms(330));
    confirmed_after(&mut master, 331);
}

#[test]
fn on_rs485_first_answer_after_a_move_to_all_confirms_a_stop() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    events(&mut master, ms(200));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(200)).len(), 1);
    let answer = Frame { address: Target::Motor(id(1)), data: Shutdown.encode() };
    assert_eq!(master.handle_line(&answer, ms(201)), confirmed(1));
}

#[test]
fn stop_after_a_brake_release_to_all_takes_two_answers() {
    assert_eq!(
        answers_that_confirm(|master| {
            master.broadcast(ReleaseBrake, MotorSet::EMPTY).unwrap();
            sent(master, ms(10));
            events(master, ms(200));
        }),
        2
    );
}

/// Where answers may come at once, each may be a duplicate of the last one.
#[test]
fn stops_whose_answers_may_be_duplicates_are_confirmed_in_the_end() {
    let config = Config { shortest_response: Duration::ZERO, ..Config::CAN };
    let mut master = Master::<2>::new(config);
    master.stop(id(1), StopKind::Off).unwrap();
    let mut stops: usize = (0..60).map(|now| sent(&mut master, ms(now)).len()).sum();
    master.lift_stop();
    master.stop(id(1), StopKind::Off).unwrap();
    stops += sent(&mut master, ms(60)).len();
    // The bus is whole again; each is answered after 0.8 ms.
    let micros = |micros| ms(100) + Duration::from_micros(micros);
    let mut answers: Vec<Instant> = (0..stops as u64).map(|it| micros(200 * it)).collect();
    for _ in 0..100 {
        let at = match answers.is_empty() {
            true => master.poll_at().unwrap(),
            false => answers.remove(0),
        };
        if reply(&mut master, 1, Shutdown.encode(), at) == confirmed(1) {
            return;
        }
        let again = sent(&mut master, at).into_iter();
        answers.extend(again.map(|_| at + Duration::from_micros(800)));
    }
    panic!("no end");
}

/// Two answers to a stop that was lifted are pending.
#[test]
fn duplicate_of_an_owed_answer_causes_no_other_attempt() {
    let config = Config { shortest_response: Duration::ZERO, ..Config::CAN };
    let mut master = Master::<2>::new(config);
    master.stop(id(1), StopKind::Off).unwrap();
    let attempts: usize = (0..=42).map(|now| sent(&mut master, ms(now)).len()).sum();
    assert_eq!(attempts, 3);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(43)), confirmed(1));
    master.lift_stop();
    let _read = master.request(id(1), RawCommand::new([0x55; 8], ReplyRule::Silent, true)).unwrap();
    assert_eq!(sent(&mut master, ms(43)).len(), 1);
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(44)).len(), 1);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(45)), None);
    assert_eq!(sent(&mut master, ms(45)).len(), 1, "it goes once more for that");
    let copied = ms(45) + Duration::from_micros(300);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), copied), None);
    assert_eq!(sent(&mut master, copied), []);
}

#[test]
fn stop_cut_off_after_its_first_answer_is_not_confirmed_by_the_next() {
    let mut master = Master::<2>::new(Config::CAN);
    // It is in a mailbox: commands to one motor are more urgent.
    master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(10)).len(), 1);
    events(&mut master, ms(10));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(15)).len(), 1);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(16)), None);
    // The bus is cut after that answer: the stop that goes once more has none.
    let mut times = 17..300;
    let mut next = |master: &mut Master<2>| times.find(|&now| !sent(master, ms(now)).is_empty());
    next(&mut master).unwrap();
    let third = next(&mut master).unwrap();
    // It is intact again: first the stop arrives, and then what is in the mailbox.
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(third + 1)), None, "{third}");
}

#[test]
fn stop_sent_for_long_owes_no_more_answers_than_two_stops() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    let mut now = 0;
    while now < 30_000 {
        sent(&mut master, ms(now));
        events(&mut master, ms(now));
        now += 1;
    }
    while sent(&mut master, ms(now)).is_empty() {
        now += 1;
    }
    events(&mut master, ms(now + 21));
    master.lift_stop();
    master.stop(id(1), StopKind::Off).unwrap();
    let mut stops = sent(&mut master, ms(now + 22)).len();
    for at in now + 23..now + 423 {
        if reply(&mut master, 1, Shutdown.encode(), ms(at)) == confirmed(1) {
            assert!(stops <= 31, "{stops} stops");
            return;
        }
        stops += sent(&mut master, ms(at)).len();
    }
    panic!("{stops} stops and no end");
}

#[test]
fn first_answer_after_a_cut_confirms_no_stop_though_others_were_heard() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    sent(&mut master, ms(0));
    (1..30).for_each(|now| drop(events(&mut master, ms(now))));
    // Then the bus is cut.
    reply(&mut master, 2, ANGLE_REPLY, ms(30));
    (30..200).for_each(|now| drop(events(&mut master, ms(now))));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(500)).len(), 1);
    assert_eq!(sent(&mut master, ms(521)).len(), 1);
    // The bus is whole again: what the mailboxes hold comes, by its priority.
    reply(&mut master, 2, ANGLE_REPLY, ms(525));
    events(&mut master, ms(525));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(526)), None);
}
