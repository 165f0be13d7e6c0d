//! What may arrive after a stop, for how long, and which answers count then.

use super::unnamed::{TO_ALL, all_have_moved, all_move, channels, to};
use super::*;

/// All were commanded this, and no motor that has a place is expected to answer.
fn command_all<C: Command>(master: &mut Master<2>, command: C, now: Instant) {
    master.broadcast(command, MotorSet::EMPTY).unwrap();
    assert_eq!(channels(&sent(master, now)), [TO_ALL]);
    events(master, now);
}

/// Motor 1 was switched off by a stop that was sent twice and answered once at 51 ms: the other may be in a mailbox.
fn one_shutdown_unanswered() -> Master<2> {
    let mut master = Master::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    for now in [0, 50] {
        assert_eq!(sent(&mut master, ms(now)).len(), 1);
    }
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(51)), confirmed(1));
    master.lift_stop();
    events(&mut master, ms(52));
    master
}

#[test]
fn earlier_shutdown_may_arrive_after_a_hold_for_time_out_and_late_window() {
    for is_stop in [true, false] {
        let mut master = one_shutdown_unanswered();
        let mut ticket = None;
        if is_stop {
            master.stop(id(1), StopKind::Hold).unwrap();
        } else {
            ticket = Some(master.request(id(1), Stop).unwrap());
        }
        assert_eq!(channels(&sent(&mut master, ms(52))), [to(1)]);
        assert_eq!(reply(&mut master, 1, Stop.encode(), ms(53)), None, "its load may fall yet");
        // 20.4 ms and 40.8 ms after 52 ms.
        assert_eq!(sent(&mut master, ms(113)), []);
        assert_eq!(channels(&sent(&mut master, ms(114))), [to(1)]);
        let reported = reply(&mut master, 1, Stop.encode(), ms(115));
        match ticket {
            None => assert_eq!(reported, confirmed(1)),
            Some(ticket) => assert_eq!(ticket.outcome(&reported.unwrap()), Some(Ok(Stop))),
        }
    }
}

#[test]
fn hold_to_all_kept_by_a_cut_bus_leaves_a_later_shutdown_in_doubt() {
    let mut master = Master::<2>::new(Config::CAN);
    command_all(&mut master, torque(1.0), ms(0));
    // The move has come; nobody has a place.
    reply(&mut master, 2, ANGLE_REPLY, ms(70));
    events(&mut master, ms(120));
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(130))), [TO_ALL]);
    // Here the bus is cut, and whole again at 501 ms.
    events(&mut master, ms(400));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(500))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(501)), None, "it is switched on yet");
    // A late window after that.
    assert_eq!(sent(&mut master, ms(541)), []);
    assert_eq!(channels(&sent(&mut master, ms(542))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(543)), confirmed(1));
}

#[test]
fn shutdown_is_in_doubt_while_a_cut_bus_may_keep_a_hold_to_all() {
    let mut master = Master::<2>::new(Config::CAN);
    command_all(&mut master, Stop, ms(0));
    events(&mut master, ms(300));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(500))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(501)), None);
    assert_eq!(sent(&mut master, ms(541)), []);
    assert_eq!(channels(&sent(&mut master, ms(542))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(543)), confirmed(1));
}

#[test]
fn answered_hold_to_all_leaves_no_later_shutdown_in_doubt() {
    let mut master = Master::<2>::new(Config::CAN);
    command_all(&mut master, Stop, ms(0));
    reply(&mut master, 1, Stop.encode(), ms(1));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(2))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(3)), confirmed(1));
}

#[test]
fn stop_in_doubt_is_repeated_in_time_though_the_bus_may_be_cut() {
    let mut master = Master::<2>::new(Config::CAN);
    command_all(&mut master, torque(1.0), ms(0));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(1))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(2)), None, "it may be moved yet");
    // Nothing was heard since one to all was sent, and only an answer shows when that arrives.
    master.stop_all(StopKind::Off, id(2).into()).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(3))), [TO_ALL, to(2)]);
    // But the answer to that, which cannot come any more then, is not to confirm it.
    assert!(!channels(&sent(&mut master, ms(64))).contains(&to(1)));
    assert!(channels(&sent(&mut master, ms(65))).contains(&to(1)));
}

#[test]
fn on_rs485_shutdown_after_a_hold_to_all_is_confirmed_by_one_answer() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    command_all(&mut master, Stop, ms(0));
    master.stop(id(1), StopKind::Off).unwrap();
    // Nothing meets the answers to the one to all, for 5 ms and the turnaround.
    assert_eq!(sent(&mut master, ms(5)), []);
    assert_eq!(channels(&sent(&mut master, ms(6))), [to(1)]);
    let answer = Frame { address: Target::Motor(id(1)), data: Shutdown.encode() };
    assert_eq!(master.handle_line(&answer, ms(7)), confirmed(1));
}

#[test]
fn motor_that_an_earlier_move_to_all_may_reach_is_not_forgotten() {
    let mut master = Master::<2>::new(Config::CAN);
    command_all(&mut master, torque(1.0), ms(0));
    command_all(&mut master, ReadMultiTurnAngle, ms(1));
    let _ = ask(&mut master, 1, ReadRunTime, ms(2));
    reply(&mut master, 1, [0xB1, 0, 0, 0, 1, 0, 0, 0], ms(3)).unwrap();
    assert!(!master.forget(id(1)), "it may lie in a mailbox");
    // The bus is whole at 30 ms, and what is to come does so within the late window.
    reply(&mut master, 2, ANGLE_REPLY, ms(30));
    events(&mut master, ms(70));
    assert!(!master.forget(id(1)), "it may come yet");
    events(&mut master, ms(71));
    assert!(master.forget(id(1)), "it has come");
}

#[test]
fn lock_counts_as_answered_only_once_no_move_to_all_can_arrive() {
    let mut master = Master::<2>::new(Config::CAN);
    command_all(&mut master, torque(1.0), ms(0));
    let locked = master.request(id(1), LockBrake).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(1))), [to(1)]);
    assert_eq!(reply(&mut master, 1, LockBrake.encode(), ms(2)), None);
    // 20.4 ms and 40.8 ms after the move.
    assert_eq!(sent(&mut master, ms(61)), []);
    assert_eq!(channels(&sent(&mut master, ms(62))), [to(1)]);
    let reported = reply(&mut master, 1, LockBrake.encode(), ms(63)).unwrap();
    assert!(locked.outcome(&reported).is_some());
}

/// Motor 1 has not answered the move of all, is sent two shutdowns, and answers the first: it is sent once more.
fn in_doubt_and_asked_twice() -> Master<2> {
    let mut master = Master::new(Config::CAN);
    command_all(&mut master, torque(1.0), ms(0));
    master.stop_all(StopKind::Off, id(1).into()).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(1))), [TO_ALL, to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(2)), None, "it may be moved yet");
    master
}

#[test]
fn answer_right_after_the_moves_feedback_does_not_confirm_the_stop() {
    let mut master = in_doubt_and_asked_twice();
    // Which of the two arrived after the move is not known.
    reply(&mut master, 1, TORQUE_REPLY, ms(3));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(4)), None);
    assert_eq!(channels(&sent(&mut master, ms(4))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(5)), confirmed(1));
}

#[test]
fn answer_that_confirms_nothing_is_no_longer_owed() {
    let mut master = in_doubt_and_asked_twice();
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(3)), None, "the other's");
    reply(&mut master, 1, TORQUE_REPLY, ms(4));
    assert_eq!(channels(&sent(&mut master, ms(4))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(5)), confirmed(1));
    // All three were answered, so that another need not wait.
    master.lift_stop();
    let _ = master.request(id(1), Shutdown).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(6))), [to(1)]);
}

#[test]
fn duplicate_of_the_first_answer_is_not_that_to_the_second_stop() {
    let mut master = in_doubt_and_asked_twice();
    let soon = ms(2) + Duration::from_micros(300);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), soon), None, "no drive is so quick");
    reply(&mut master, 1, TORQUE_REPLY, ms(3));
    assert_eq!(sent(&mut master, ms(4)), []);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(5)), None, "the other's");
    assert_eq!(channels(&sent(&mut master, ms(5))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(6)), confirmed(1));
}

#[test]
fn reply_between_two_attempts_of_a_request_is_a_stray() {
    let mut master = Master::<2>::new(Config::CAN);
    let angle = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    assert_eq!(events(&mut master, ms(21)), [], "it is to go once more");
    let reported = reply(&mut master, 1, ANGLE_REPLY, ms(22)).unwrap();
    assert!(matches!(reported, Event::Stray { .. }), "{reported:?}");
    assert_eq!(channels(&sent(&mut master, ms(23))), [to(1)]);
    let reported = reply(&mut master, 1, ANGLE_REPLY, ms(24)).unwrap();
    assert!(angle.outcome(&reported).is_some());
}

#[test]
fn handed_back_stop_to_all_owes_one_answer_for_each_frame_on_the_bus() {
    // Before the motor has confirmed its own, and after.
    for is_confirmed in [false, true] {
        let mut master = all_move();
        master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
        let packets = sent(&mut master, ms(100));
        assert_eq!(channels(&packets), [TO_ALL, to(1)]);
        if is_confirmed {
            assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(101)), confirmed(1));
            master.handle_pushed_out(&packets[0]);
        } else {
            master.handle_pushed_out(&packets[0]);
            assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(101)), confirmed(1));
        }
        assert_eq!(channels(&sent(&mut master, ms(102))), [TO_ALL]);
        assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(103)), None);
        // Each of the two that were on the bus was answered.
        master.lift_stop();
        let _ = master.request(id(1), Shutdown).unwrap();
        assert_eq!(channels(&sent(&mut master, ms(104))), [to(1)], "{is_confirmed}");
    }
}

#[test]
fn stop_to_all_handed_back_after_the_next_stop_owes_it_no_answer() {
    let mut master = all_move();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(100));
    assert_eq!(channels(&packets), [TO_ALL, to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(101)), confirmed(1));
    master.lift_stop();
    master.set_point(id(1), torque(1.0), ms(102)).unwrap();
    assert_eq!(sent(&mut master, ms(102)).len(), 1);
    reply(&mut master, 1, TORQUE_REPLY, ms(103)).unwrap();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    master.handle_pushed_out(&packets[0]);
    assert_eq!(channels(&sent(&mut master, ms(104))), [TO_ALL, to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(105)), confirmed(1));
}

#[test]
fn callers_stop_to_all_handed_back_is_not_taken_for_the_stop_in_force() {
    let mut master = all_move();
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(100))), [TO_ALL, to(1)]);
    for now in [101, 102] {
        reply(&mut master, 1, Stop.encode(), ms(now));
    }
    master.broadcast(Stop, MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(103));
    assert_eq!(channels(&packets), [TO_ALL]);
    master.handle_pushed_out(&packets[0]);
    // It is over once it was sent.
    assert_eq!(events(&mut master, ms(104)), []);
    assert_eq!(channels(&sent(&mut master, ms(104))), [TO_ALL]);
    let over = Event::BroadcastDone { silent: MotorSet::EMPTY, was_sent: true };
    assert_eq!(events(&mut master, ms(104)), [over]);
}

#[test]
fn waiting_hold_to_all_is_dropped_once_a_motor_is_to_be_off() {
    let mut master = all_move();
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    master.stop_all(StopKind::Hold, id(2).into()).unwrap();
    let packets = sent(&mut master, ms(100));
    assert_eq!(channels(&packets), [to(1), to(2)]);
    assert_eq!([packets[0].data, packets[1].data], [Shutdown.encode(), Stop.encode()]);
}

#[test]
fn impossibly_quick_answer_to_the_only_stop_is_a_stray() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(0))), [to(1)]);
    // No drive answers before 0.27 ms, and no other stop was sent.
    let reported = reply(&mut master, 1, Shutdown.encode(), Instant::from_micros(100)).unwrap();
    assert!(matches!(reported, Event::Stray { .. }), "{reported:?}");
    assert_eq!(master.health(id(1)).stray, 1);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(1)), confirmed(1));
}

#[test]
fn feedback_counts_while_a_stop_to_all_and_one_to_the_motor_are_awaited() {
    let mut master = all_have_moved();
    master.set_point(id(1), torque(1.0), ms(99)).unwrap();
    assert_eq!(sent(&mut master, ms(99)).len(), 1);
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(100))), [TO_ALL, to(1)]);
    let reported = reply(&mut master, 1, TORQUE_REPLY, ms(101));
    assert!(reported.is_some_and(|it| it.feedback().is_some()));
    // So it has arrived, and the stop after it.
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(102)), confirmed(1));
}

#[test]
fn answer_to_a_stop_not_sent_yet_measures_no_round_trip() {
    let mut master = Master::<2>::new(Config::CAN.adapting_up_to(Duration::from_millis(100)));
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    command_all(&mut master, torque(1.0), ms(10));
    reply(&mut master, 1, TORQUE_REPLY, ms(11));
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(90));
    reply(&mut master, 1, ANGLE_REPLY, ms(91)).unwrap();
    events(&mut master, ms(300));
    let (timeout, health) = (master.config().reply_timeout, master.health(id(1)));
    assert_eq!(timeout, Config::CAN.reply_timeout, "two of 1 ms were measured");
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    master.poll_transmit(ms(300)).unwrap();
    master.handle_transmitted(ms(300));
    // To the one to all: its own is to be sent yet, and what it was sent last was at 90 ms.
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(301)), confirmed(1));
    assert_eq!(master.config().reply_timeout, timeout);
    assert_eq!(master.health(id(1)).round_trip, health.round_trip);
}

#[test]
fn motor_that_answers_between_two_attempts_of_a_stop_is_present() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(0))), [to(1)]);
    master.handle_timeout(ms(21));
    assert_eq!(master.health(id(1)).presence, Presence::Late);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(22)), confirmed(1));
    assert_eq!(master.health(id(1)).presence, Presence::Present);
}

#[test]
fn shutdown_to_all_sent_individually_skips_a_motor_already_off() {
    let mut master = Master::<4>::new(Config::CAN);
    // The one to all waits for this.
    let _ = ask(&mut master, 3, ReadMultiTurnAngle, ms(0));
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    master.stop(id(2), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(1))), [to(2)]);
    // It would undo that, so each of the others gets it individually.
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(2))), [to(3), to(1)]);
}

#[test]
fn bus_down_extends_how_long_a_move_may_still_arrive() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(1)).len(), 1);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(2)), None);
    // Without that it went at 62 ms.
    master.handle_bus_down(ms(50));
    assert_eq!(sent(&mut master, ms(80)), []);
    assert_eq!(channels(&sent(&mut master, ms(100))), [to(1)]);
}

#[test]
fn handed_back_hold_to_all_is_not_sent_after_a_shutdown_to_all() {
    let mut master = all_have_moved();
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(100));
    assert_eq!(channels(&packets), [TO_ALL, to(1)]);
    for now in [101, 102] {
        reply(&mut master, 1, Stop.encode(), ms(now));
    }
    events(&mut master, ms(102));
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(103)), [packet_to_all(Shutdown.encode())]);
    events(&mut master, ms(103));
    master.handle_pushed_out(&packets[0]);
    assert_eq!(sent(&mut master, ms(103)), [], "all were switched off since");
}

#[test]
fn handed_back_hold_to_all_is_not_sent_after_a_shutdown_of_one_motor() {
    let mut master = all_have_moved();
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(100));
    assert_eq!(channels(&packets), [TO_ALL, to(1)]);
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(101)), confirmed(1));
    events(&mut master, ms(101));
    // Later than any answer is expected: the answer to this is reported.
    events(&mut master, ms(250));
    let off = master.request(id(1), Shutdown).unwrap();
    let mut reported = None;
    for now in 250..400 {
        for packet in sent(&mut master, ms(now)) {
            let event = reply(&mut master, 1, packet.data, ms(now) + Duration::from_micros(900));
            reported = reported.or(event.and_then(|event| off.outcome(&event)));
        }
        events(&mut master, ms(now));
    }
    assert!(reported.is_some());
    master.handle_pushed_out(&packets[0]);
    assert_eq!(sent(&mut master, ms(400)), [], "motor 1 was switched off since");
}

#[test]
fn handed_back_shutdown_to_all_is_not_sent_after_a_hold_of_unknown_motors() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(0));
    events(&mut master, ms(90));
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(100));
    assert_eq!(packets, [packet_to_all(Shutdown.encode())]);
    events(&mut master, ms(100));
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(101)), [packet_to_all(Stop.encode())]);
    master.handle_pushed_out(&packets[0]);
    assert_eq!(sent(&mut master, ms(101)), [], "a hold of all is in force");
}

#[test]
fn handed_back_hold_to_all_is_not_sent_after_a_shutdown_of_unknown_motors() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(0));
    events(&mut master, ms(90));
    master.broadcast(Stop, MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(100));
    assert_eq!(packets, [packet_to_all(Stop.encode())]);
    events(&mut master, ms(100));
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(101)), [packet_to_all(Shutdown.encode())]);
    master.lift_stop();
    master.handle_pushed_out(&packets[0]);
    assert_eq!(sent(&mut master, ms(101)), [], "all were switched off since");
}

#[test]
fn answer_that_may_be_to_a_shutdown_to_all_confirms_no_later_stop() {
    let mut master = Master::<2>::new(Config::CAN);
    command_all(&mut master, Shutdown, ms(0));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(1)).len(), 1);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(2)), None);
}

/// On CAN, the stop to all (0x280) overtakes a set-point of motion mode (0x401) in the mailboxes.
#[test]
fn answer_to_a_stop_to_all_confirms_nothing_while_a_set_point_is_in_flight() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(step(), id(1).into()).unwrap();
    sent(&mut master, ms(0));
    reply(&mut master, 1, [0xA8, 30, 0, 0, 0, 0, 7, 0], ms(1));
    events(&mut master, ms(1));
    sent(&mut master, ms(150));
    let _ = ask(&mut master, 1, ReadStatus1, ms(190));
    reply(&mut master, 1, [0x9A, 0, 0, 0, 0, 0, 0, 0], ms(191));
    master.set_point(id(1), motion(), ms(200)).unwrap();
    assert_eq!(sent(&mut master, ms(200)).len(), 1);
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(master.poll_transmit(ms(200)), Some(packet_to_all([0x81, 0, 0, 0, 0, 0, 0, 0])));
    master.handle_transmitted(ms(200));
    // Both mailboxes are full, so that its own waits.
    let heard = reply(&mut master, 1, [0x81, 0, 0, 0, 0, 0, 0, 0], ms(201));
    assert_ne!(heard, confirmed(1), "the set-point lies in a mailbox yet");
}

/// The stop to all was answered before the motor's own was sent, and the move to all was not answered.
#[test]
fn stop_is_still_sent_when_a_set_point_is_lost_after_its_first_answer() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(step(), id(1).into()).unwrap();
    sent(&mut master, ms(0));
    events(&mut master, ms(100));
    let go = AbsolutePosition { max_speed: MaxSpeed::from_raw(1), angle: Angle::from_raw(0) };
    master.set_point(id(1), go, ms(200)).unwrap();
    assert_eq!(sent(&mut master, ms(200)).len(), 1);
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    // One mailbox.
    assert_eq!(master.poll_transmit(ms(200)), Some(packet_to_all([0x80, 0, 0, 0, 0, 0, 0, 0])));
    master.handle_transmitted(ms(200));
    assert_eq!(reply(&mut master, 1, [0x80, 0, 0, 0, 0, 0, 0, 0], ms(201)), None);
    let (mut at, mut stops) = (ms(201), 0);
    while let Some(next) = master.poll_at().filter(|_| stops < 20) {
        at = at.max(next);
        stops += sent(&mut master, at).len();
        events(&mut master, at);
    }
    assert!(
        stops > 0,
        "its own stop was never sent, and nothing is reported: it waits since {at:?} for ever"
    );
}

/// Motor 1 has not answered a move of all, whose answer is no longer expected; it was asked for its angle since.
fn moved_and_read() -> Master<2> {
    let mut master = Master::new(Config::CAN);
    master.broadcast(torque(1.0), id(1).into()).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(0))), [TO_ALL]);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(49));
    reply(&mut master, 1, ANGLE_REPLY, ms(50)).unwrap();
    events(&mut master, ms(99));
    master
}

#[test]
fn answer_to_a_read_does_not_show_that_a_move_to_all_has_arrived() {
    let mut master = moved_and_read();
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(100))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(101)), None);
    // 40.8 ms later.
    assert_eq!(sent(&mut master, ms(141)), []);
    assert_eq!(channels(&sent(&mut master, ms(142))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(143)), confirmed(1));
}

/// The first answer comes after more than half of the attempts, and may belong to what was asked before: the next stop
/// waits until no such answer is pending. Its answer is the first that counts, and shows that what is in a mailbox
/// leaves it now.
#[test]
fn stop_after_a_move_to_all_and_a_lost_shutdown_takes_three_answers() {
    let mut master = moved_and_read();
    let _lost = master.request_with(id(1), Shutdown, once(5)).unwrap();
    assert_eq!(sent(&mut master, ms(100)).len(), 1);
    events(&mut master, ms(105));
    master.stop(id(1), StopKind::Off).unwrap();
    let (mut sendings, mut answered) = (0, 0);
    for now in 105..1_000 {
        if !sent(&mut master, ms(now)).is_empty() {
            sendings += 1;
            // 8 of 15 attempts are lost.
            if sendings > 8 {
                answered += 1;
                let answer =
                    reply(&mut master, 1, Shutdown.encode(), ms(now) + Duration::from_micros(900));
                if answer == confirmed(1) {
                    break;
                }
                assert_eq!(answer, None);
            }
        }
    }
    assert_eq!(answered, 3, "the one that is owed, one for the mailbox, one that confirms");
}

/// Nothing shows when a command without a reply has left its mailbox.
#[test]
fn stop_right_after_a_restart_is_confirmed_once_that_must_have_arrived() {
    let mut master = Master::<2>::new(Config::CAN);
    obeys(&mut master, 1);
    assert_eq!(events(&mut master, ms(0)), []);
    let _reset = master.request(id(1), Reset).unwrap();
    sent(&mut master, ms(0));
    events(&mut master, ms(0));
    master.stop(id(1), StopKind::Hold).unwrap();
    let stop = [packet_to(1, Stop.encode())];
    assert_eq!(sent(&mut master, ms(1)), stop);
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(3)), None);
    // The stop was put at 0 ms. Its time-out is 20.4 ms, and the late window 40.8 ms.
    let again = (4..100).find(|&now| sent(&mut master, ms(now)) == stop);
    assert_eq!(again, Some(62));
    let confirmed = reply(&mut master, 1, Stop.encode(), ms(63));
    assert_eq!(confirmed, Some(Event::StopConfirmed { motor: id(1) }));
}
