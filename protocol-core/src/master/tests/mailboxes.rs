//! Frames in a controller's mailbox while others overtake them, or while the bus is cut.

use super::*;

/// The stop that is sent at this time and answered a millisecond later.
fn is_stop_confirmed(master: &mut Master<2>, at: Instant) -> bool {
    assert_eq!(sent(master, at).len(), 1, "{at:?}");
    reply(master, 1, Shutdown.encode(), at + Duration::from_millis(1)) == confirmed(1)
}

#[test]
fn answer_to_one_of_two_moves_to_all_does_not_show_the_other_arrived() {
    // No motor is known or expected, so the second goes at once.
    let mut master = Master::<2>::new(Config::CAN);
    for _ in 0..2 {
        master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
        assert_eq!(sent(&mut master, ms(0)).len(), 1);
        events(&mut master, ms(0));
    }
    // The first one is on the bus; the stop overtakes the second.
    reply(&mut master, 1, TORQUE_REPLY, ms(1));
    master.stop(id(1), StopKind::Off).unwrap();
    assert!(!is_stop_confirmed(&mut master, ms(1)), "the second one moves it yet");
    let at = master.poll_at().unwrap();
    assert!(at > ms(60) && at < ms(70), "{at:?}");
    assert!(is_stop_confirmed(&mut master, at));
}

#[test]
fn first_of_three_moves_to_all_may_move_a_motor_that_answered_the_rest() {
    let mut master = Master::<2>::new(Config::CAN);
    for (now, is_answered) in [(0, false), (1, true), (3, true)] {
        master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
        assert_eq!(sent(&mut master, ms(now)).len(), 1);
        events(&mut master, ms(now));
        if is_answered {
            reply(&mut master, 1, TORQUE_REPLY, ms(now + 1));
        }
    }
    master.stop(id(1), StopKind::Off).unwrap();
    assert!(!is_stop_confirmed(&mut master, ms(4)));
}

#[test]
fn read_to_all_does_not_show_that_a_cut_bus_holds_no_move() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(10));
    events(&mut master, ms(10));
    master.broadcast(ReadMultiTurnAngle, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(100)).len(), 1);
    events(&mut master, ms(300));
    master.stop(id(1), StopKind::Off).unwrap();
    assert!(!is_stop_confirmed(&mut master, ms(500)), "the bus is whole again, and it comes");
}

#[test]
fn cut_bus_may_hold_two_moves_to_all() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    // Here the bus is cut.
    for now in [10, 450] {
        master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
        assert_eq!(sent(&mut master, ms(now)).len(), 1);
        events(&mut master, ms(now + 40));
    }
    // And here it is whole again.
    reply(&mut master, 1, TORQUE_REPLY, ms(500));
    master.stop(id(1), StopKind::Off).unwrap();
    assert!(!is_stop_confirmed(&mut master, ms(500)), "the second one moves it yet");
    let at = master.poll_at().unwrap();
    assert!(at > ms(540) && at < ms(550), "{at:?}");
    assert!(is_stop_confirmed(&mut master, at));
}

#[test]
fn motor_that_answered_each_move_to_all_is_moved_by_none_of_them() {
    let mut master = Master::<2>::new(Config::CAN);
    for now in [0, 2, 4] {
        master.broadcast(torque(1.0), id(1).into()).unwrap();
        assert_eq!(sent(&mut master, ms(now)).len(), 1);
        reply(&mut master, 1, TORQUE_REPLY, ms(now + 1)).unwrap();
        events(&mut master, ms(now + 1));
    }
    master.stop(id(1), StopKind::Off).unwrap();
    assert!(is_stop_confirmed(&mut master, ms(6)));
}

#[test]
fn handed_back_second_move_to_all_does_not_show_the_first_arrived() {
    let mut master = Master::<2>::new(Config::CAN);
    let mut last = None;
    for amperes in [1.0, 2.0] {
        master.broadcast(torque(amperes), MotorSet::EMPTY).unwrap();
        last = sent(&mut master, ms(0)).pop();
        events(&mut master, ms(0));
    }
    master.stop(id(1), StopKind::Off).unwrap();
    master.handle_pushed_out(&last.unwrap());
    assert!(!is_stop_confirmed(&mut master, ms(1)), "the first one moves it yet");
}

#[test]
fn handed_back_stop_or_shutdown_to_all_is_sent_again_once_reported_done() {
    let mut master = Master::<2>::new(Config::CAN);
    for end in [Shutdown.encode(), Stop.encode()] {
        let raw = RawCommand::new(end, ReplyRule::Same, false);
        master.broadcast(raw, MotorSet::EMPTY).unwrap();
        let in_mailbox = sent(&mut master, ms(0))[0];
        let done = [Event::BroadcastDone { silent: MotorSet::EMPTY, was_sent: true }];
        assert_eq!(events(&mut master, ms(0)), done);
        // Another motor's command is more urgent.
        master.handle_pushed_out(&in_mailbox);
        assert_eq!(sent(&mut master, ms(0)), [in_mailbox], "nobody has heard it");
        assert_eq!(events(&mut master, ms(0)), [], "that was reported");
    }
    // A bus that carries something holds none of these back.
    reply(&mut master, 2, ANGLE_REPLY, ms(50));
    // A stop that came after it is not to be undone by it: a load that is held would fall.
    obeys(&mut master, 1);
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    let in_mailbox = sent(&mut master, ms(100))[0];
    events(&mut master, ms(100));
    master.stop(id(1), StopKind::Hold).unwrap();
    master.handle_pushed_out(&in_mailbox);
    assert_eq!(sent(&mut master, ms(100))[0].data, Stop.encode());
    reply(&mut master, 1, Stop.encode(), ms(101)).unwrap();
    assert_eq!(sent(&mut master, ms(101)), []);
    // Nor one that comes while it waits to go again.
    master.lift_stop();
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    let in_mailbox = sent(&mut master, ms(200))[0];
    events(&mut master, ms(200));
    master.handle_pushed_out(&in_mailbox);
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(200))[0].data, Stop.encode());
    reply(&mut master, 1, Stop.encode(), ms(201)).unwrap();
    assert_eq!(sent(&mut master, ms(201)), []);
    assert_eq!(events(&mut master, ms(201)), []);
    master.lift_stop();
    // The answer to a question is no longer waited for.
    master.broadcast(ReadMultiTurnAngle, MotorSet::EMPTY).unwrap();
    let in_mailbox = sent(&mut master, ms(300))[0];
    events(&mut master, ms(300));
    master.handle_pushed_out(&in_mailbox);
    assert_eq!(sent(&mut master, ms(300)), []);
}

#[test]
fn stop_to_all_skips_a_motor_whose_later_stop_it_would_undo() {
    let [off, hold] = [Shutdown.encode(), Stop.encode()];
    let (to_all, lock) = (packet_to_all, LockBrake.encode());
    for (end, stop, goes) in [
        (off, StopKind::Off, Some(to_all(off))),
        (off, StopKind::Hold, Some(packet_to(2, off))),
        (hold, StopKind::Hold, Some(to_all(hold))),
        (hold, StopKind::Off, Some(packet_to(2, hold))),
        (lock, StopKind::Hold, Some(to_all(lock))),
        (lock, StopKind::Off, Some(to_all(lock))),
        // It begins anew, which a stopped motor must not.
        (Reset.encode(), StopKind::Off, None),
    ] {
        for is_handed_back in [true, false] {
            let mut master = Master::<2>::new(Config::CAN);
            obeys(&mut master, 1);
            for motor in [1, 2] {
                let _ = ask(&mut master, motor, ReadMultiTurnAngle, ms(0));
                reply(&mut master, motor, ANGLE_REPLY, ms(1)).unwrap();
            }
            master
                .broadcast(RawCommand::new(end, ReplyRule::Same, false), MotorSet::EMPTY)
                .unwrap();
            if is_handed_back {
                let in_mailbox = sent(&mut master, ms(2))[0];
                events(&mut master, ms(2));
                master.stop(id(1), stop).unwrap();
                master.handle_pushed_out(&in_mailbox);
            } else {
                master.stop(id(1), stop).unwrap();
            }
            let stop = packet_to(1, stop.command().1);
            let mut packets = sent(&mut master, ms(2));
            assert_eq!(packets.remove(0), stop);
            assert_eq!(reply(&mut master, 1, stop.data, ms(3)), confirmed(1));
            packets.extend(sent(&mut master, ms(3)));
            assert_eq!(packets, goes.as_slice(), "{stop:02X?}, {is_handed_back}");
        }
    }
}

#[test]
fn bus_mended_just_before_the_window_ends_gets_a_whole_window() {
    for is_to_all in [false, true] {
        let mut master = Master::<2>::new(Config::CAN);
        for motor in [1, 2] {
            let _ = ask(&mut master, motor, ReadMultiTurnAngle, ms(0));
            reply(&mut master, motor, ANGLE_REPLY, ms(1)).unwrap();
        }
        // Here the bus is cut. This may be on its way until 63.2 ms, or 63.8 where it is given up at 23 ms.
        if is_to_all {
            master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
        } else {
            master.set_point(id(1), motion(), ms(2)).unwrap();
        }
        sent(&mut master, ms(2));
        events(&mut master, ms(23));
        let whole_again = if is_to_all { ms(62) } else { ms(63) };
        reply(&mut master, 2, ANGLE_REPLY, whole_again);
        events(&mut master, whole_again);
        events(&mut master, ms(64));
        master.stop(id(1), StopKind::Off).unwrap();
        assert!(!is_stop_confirmed(&mut master, ms(66)), "to all: {is_to_all}");
        let at = master.poll_at().unwrap();
        assert!(at > ms(100) && at < ms(110), "{at:?}");
        assert!(is_stop_confirmed(&mut master, at));
    }
}

#[test]
fn hold_is_confirmed_once_no_earlier_shutdown_or_reset_can_arrive() {
    // On a controller that keeps no order among frames of one identifier.
    fn is_held_at_once<C: Command>(command: C) -> bool {
        let mut master = Master::<2>::new(Config::CAN);
        obeys(&mut master, 1);
        let _ = ask(&mut master, 1, command, ms(0));
        // A restart has no answer, and is over when it was sent.
        events(&mut master, ms(0));
        master.stop(id(1), StopKind::Hold).unwrap();
        assert_eq!(sent(&mut master, ms(0))[0].data, Stop.encode());
        let held = Some(Event::StopConfirmed { motor: id(1) });
        if reply(&mut master, 1, Stop.encode(), ms(1)) == held {
            return true;
        }
        let over = ms(63);
        events(&mut master, ms(62));
        assert_eq!(sent(&mut master, over)[0].data, Stop.encode());
        assert_eq!(reply(&mut master, 1, Stop.encode(), ms(64)), held);
        false
    }
    assert!(!is_held_at_once(Shutdown), "its load may fall yet");
    assert!(!is_held_at_once(Reset), "its load may fall yet");
    assert!(is_held_at_once(ReadMultiTurnAngle));
    assert!(is_held_at_once(LockBrake));
}

#[test]
fn stop_that_nothing_pending_can_undo_is_confirmed_at_once() {
    // A Shutdown that still waits has not gone, and does not when the motor is stopped.
    let mut master = Master::<2>::new(Config::CAN);
    obeys(&mut master, 1);
    let _ = master.request(id(1), Shutdown).unwrap();
    master.stop(id(1), StopKind::Hold).unwrap();
    sent(&mut master, ms(0));
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(1)), confirmed(1));
    // A line has no mailboxes: after the window nothing comes.
    let mut master = Master::<2>::new(Config::rs485(115_200, false));
    obeys(&mut master, 1);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    sent(&mut master, ms(0));
    events(&mut master, ms(10));
    events(&mut master, ms(40));
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(sent(&mut master, ms(41)).len(), 1);
    let answer = Frame { address: Target::Motor(id(1)), data: Stop.encode() };
    assert_eq!(master.handle_line(&answer, ms(43)), confirmed(1));
}

#[test]
fn set_point_overtaken_by_a_stop_has_its_whole_window() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    sent(&mut master, ms(0));
    master.stop(id(1), StopKind::Off).unwrap();
    assert!(!is_stop_confirmed(&mut master, ms(0)));
    let at = master.poll_at().unwrap();
    assert!(at > ms(61) && at < ms(62), "its reply's time and the window: {at:?}");
}

/// Motion, torque and a step are in mailboxes, and count as lost.
fn three_lost_moves() -> Master<2> {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    sent(&mut master, ms(0));
    events(&mut master, ms(21));
    master.set_point(id(1), torque(1.0), ms(21)).unwrap();
    sent(&mut master, ms(21));
    events(&mut master, ms(42));
    let _ = master.request_with(id(1), step(), once(5)).unwrap();
    sent(&mut master, ms(42));
    assert_eq!(events(&mut master, ms(47)).len(), 1);
    master
}

#[test]
fn set_point_displaced_from_the_late_replies_may_still_move_the_motor() {
    let mut master = three_lost_moves();
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(48));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(49)), None, "motion may come yet");
    // One goes to all, since there is no place for motor 3, and no motor has room for the late answer to it.
    assert!(master.stop_all(StopKind::Off, (1..=3).map(id).collect()).is_err());
    assert_eq!(sent(&mut master, ms(50)).len(), 2);
    reply(&mut master, 1, TORQUE_REPLY, ms(51)).unwrap();
    reply(&mut master, 1, [0xA8, 0, 0, 0, 0, 0, 0, 0], ms(52)).unwrap();
    assert_eq!(reply(&mut master, 2, Shutdown.encode(), ms(53)), confirmed(2));
    assert_eq!(sent(&mut master, ms(54)), [], "motion may come yet");
    assert!(is_stop_confirmed(&mut master, ms(115)));
}

#[test]
fn answers_to_two_lost_moves_do_not_show_that_the_third_arrived() {
    let mut master = three_lost_moves();
    // Motion is no longer waited for, and the bus is intact again.
    events(&mut master, ms(62));
    reply(&mut master, 1, TORQUE_REPLY, ms(63)).unwrap();
    reply(&mut master, 1, [0xA8, 0, 0, 0, 0, 0, 0, 0], ms(64)).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    assert!(!is_stop_confirmed(&mut master, ms(65)), "motion may come yet");
    assert!(is_stop_confirmed(&mut master, ms(107)));
}

#[test]
fn feedback_does_not_show_that_another_frame_left_its_mailbox() {
    // A move that has no reply.
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, RawCommand::new([0x55; 8], ReplyRule::Silent, true), ms(0));
    events(&mut master, ms(5));
    master.set_point(id(1), torque(1.0), ms(5)).unwrap();
    assert_eq!(sent(&mut master, ms(5)).len(), 1);
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(6));
    reply(&mut master, 1, TORQUE_REPLY, ms(7)).unwrap();
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(8)), None);
    // What switches off a motor that is to be held.
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    sent(&mut master, ms(0));
    events(&mut master, ms(21));
    let _ = ask(&mut master, 1, Shutdown, ms(21));
    master.stop(id(1), StopKind::Hold).unwrap();
    sent(&mut master, ms(22));
    reply(&mut master, 1, TORQUE_REPLY, ms(23)).unwrap();
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(24)), None);
}

#[test]
fn failure_of_an_earlier_stop_is_not_reported_for_the_next() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    for attempt in 0..15 {
        assert_eq!(sent(&mut master, ms(21 * attempt)).len(), 1);
    }
    // It is unconfirmed, and no events are polled.
    master.handle_timeout(ms(315));
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    assert_eq!(events(&mut master, ms(315)), []);
}

#[test]
fn replies_from_before_a_cut_do_not_show_that_the_bus_is_whole_again() {
    for is_to_all in [false, true] {
        let mut master = Master::<2>::new(Config::CAN);
        let _ = master.request_with(id(1), ReadMultiTurnAngle, once(5)).unwrap();
        sent(&mut master, ms(0));
        assert_eq!(events(&mut master, ms(5)).len(), 1);
        master.set_point(id(2), torque(1.0), ms(5)).unwrap();
        sent(&mut master, ms(5));
        // Both have answered when the bus is cut, and an adapter holds that. This stays in a mailbox.
        if is_to_all {
            master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
        } else {
            master.set_point(id(1), motion(), ms(6)).unwrap();
        }
        assert_eq!(sent(&mut master, ms(6)).len(), 1);
        events(&mut master, ms(6));
        master.stop(id(1), StopKind::Off).unwrap();
        assert_eq!(sent(&mut master, ms(7)).len(), 1);
        reply(&mut master, 1, ANGLE_REPLY, ms(16)).unwrap();
        reply(&mut master, 2, TORQUE_REPLY, ms(16)).unwrap();
        for now in 17..200 {
            sent(&mut master, ms(now));
        }
        // It is whole again, and of two mailboxes the stop's goes first.
        assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(200)), None, "to all: {is_to_all}");
        let at = master.poll_at().unwrap();
        assert!(at > ms(240) && at < ms(241), "{at:?}");
        // The last of those before may be answered yet.
        assert_eq!(sent(&mut master, at), []);
        let at = master.poll_at().unwrap();
        assert!(is_stop_confirmed(&mut master, at));
    }
}

#[test]
fn reply_from_before_a_cut_that_lengthens_the_window_does_not_either() {
    let longest_reply_timeout = Duration::from_millis(40);
    let mut master = Master::<2>::new(Config { longest_reply_timeout, ..Config::CAN });
    // One answer after 1 ms: the shortest time-outs do.
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    master.set_point(id(2), torque(1.0), ms(10)).unwrap();
    sent(&mut master, ms(10));
    // This may be heard of until 32.4 ms, and come until 73.2 ms on a bus that is whole.
    master.broadcast(step(), MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(12)).len(), 1);
    events(&mut master, ms(12));
    // On its way when the bus was cut. A mean of 3.4 ms and four times 5.1 ms: the window is 44.3 ms now.
    reply(&mut master, 2, TORQUE_REPLY, ms(30)).unwrap();
    assert_eq!(master.config().reply_timeout, Duration::from_micros(23_875));
    for now in 31..100 {
        sent(&mut master, ms(now));
    }
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(100)).len(), 1);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(101)), None, "it may lie in a mailbox");
}

#[test]
fn shutdown_to_all_handed_back_before_it_was_reported_undoes_no_hold() {
    let [off, hold] = [Shutdown.encode(), Stop.encode()];
    // In flight, sent with no motor expected to answer, and over.
    for (expected, over) in [(id(1).into(), 0), (MotorSet::EMPTY, 0), (id(1).into(), 21)] {
        for is_stopped_before in [false, true] {
            let mut master = Master::<2>::new(Config::CAN);
            obeys(&mut master, 1);
            for motor in [1, 2] {
                let _ = ask(&mut master, motor, ReadMultiTurnAngle, ms(0));
                reply(&mut master, motor, ANGLE_REPLY, ms(1)).unwrap();
            }
            let stop = |master: &mut Master<2>| {
                master.stop(id(1), StopKind::Hold).unwrap();
                assert_eq!(sent(master, ms(2)), [packet_to(1, hold)]);
            };
            if is_stopped_before {
                stop(&mut master);
                assert_eq!(reply(&mut master, 1, hold, ms(3)), confirmed(1));
            }
            master.broadcast(Shutdown, expected).unwrap();
            let in_mailbox = sent(&mut master, ms(3))[0];
            if !is_stopped_before {
                stop(&mut master);
            }
            let now = 3 + over;
            master.handle_timeout(ms(now));
            master.handle_pushed_out(&in_mailbox);
            // What was asked for after the stop goes to all.
            let goes = if is_stopped_before { packet_to_all(off) } else { packet_to(2, off) };
            let mut packets = sent(&mut master, ms(now));
            packets.retain(|packet| *packet != packet_to(1, hold));
            assert_eq!(packets, [goes], "{expected:?}, {over}, {is_stopped_before}");
        }
    }
    // Nothing switches on what a stop has switched off, whenever that was.
    let mut master = Master::<2>::new(Config::CAN);
    obeys(&mut master, 1);
    let _ = ask(&mut master, 2, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 2, ANGLE_REPLY, ms(1)).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    assert!(is_stop_confirmed(&mut master, ms(2)));
    master.broadcast(Stop, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(3)), [packet_to(2, hold)]);
}

#[test]
fn hold_is_confirmed_once_no_shutdown_to_all_can_arrive() {
    let hold = Stop.encode();
    let overtaken = |is_rs485: bool| {
        let mut master =
            Master::<2>::new(if is_rs485 { Config::rs485(115_200, false) } else { Config::CAN });
        master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
        let in_mailbox = sent(&mut master, ms(0))[0];
        events(&mut master, ms(0));
        obeys(&mut master, 1);
        master.stop(id(1), StopKind::Hold).unwrap();
        (master, in_mailbox)
    };
    // It reaches the motor after the Hold, or its answer is lost.
    for is_answered in [true, false] {
        let (mut master, _) = overtaken(false);
        assert_eq!(sent(&mut master, ms(0))[0].data, hold);
        assert_eq!(reply(&mut master, 1, hold, ms(1)), None, "its load may fall yet");
        let at = if is_answered {
            reply(&mut master, 1, Shutdown.encode(), ms(2));
            ms(2)
        } else {
            master.poll_at().unwrap()
        };
        assert!(is_answered || at > ms(60) && at < ms(70), "{at:?}");
        // A caller that asks for it in every cycle gets its confirmation, too.
        master.stop(id(1), StopKind::Hold).unwrap();
        assert_eq!(sent(&mut master, at)[0].data, hold);
        assert_eq!(reply(&mut master, 1, hold, at + Duration::from_millis(1)), confirmed(1));
    }
    // A restart lets a load fall, too.
    let mut master = Master::<2>::new(Config::CAN);
    obeys(&mut master, 1);
    master.broadcast(Reset, MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(0));
    master.stop(id(1), StopKind::Hold).unwrap();
    sent(&mut master, ms(1));
    assert_eq!(reply(&mut master, 1, hold, ms(2)), None);
    // It was handed back, or reached the motor before.
    let (mut master, in_mailbox) = overtaken(false);
    sent(&mut master, ms(0));
    master.handle_pushed_out(&in_mailbox);
    assert_eq!(reply(&mut master, 1, hold, ms(1)), confirmed(1));
    let (mut master, _) = overtaken(false);
    sent(&mut master, ms(0));
    reply(&mut master, 1, Shutdown.encode(), ms(1));
    assert_eq!(reply(&mut master, 1, hold, ms(2)), confirmed(1));
    // A line keeps the order.
    let (mut master, _) = overtaken(true);
    let answer = Frame { address: Target::Motor(id(1)), data: hold };
    sent(&mut master, ms(10));
    assert_eq!(master.handle_line(&answer, ms(13)), confirmed(1));
}

#[test]
fn cyclic_hold_is_confirmed_once_no_shutdown_to_all_can_arrive() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(0));
    events(&mut master, ms(0));
    let reported = (0..150).find(|&now| {
        master.stop(id(1), StopKind::Hold).unwrap();
        let is_sent = !sent(&mut master, ms(now)).is_empty();
        reply(&mut master, 2, ANGLE_REPLY, ms(now));
        is_sent && reply(&mut master, 1, Stop.encode(), ms(now + 1)) == confirmed(1)
    });
    assert!(reported.is_some_and(|at| at > 60 && at < 110), "{reported:?}");
}

#[test]
fn stop_to_all_handed_back_late_undoes_no_later_stop_of_all() {
    let [off, hold] = [Shutdown.encode(), Stop.encode()];
    let goes = |end: Data, kind: StopKind| {
        let mut master = Master::<2>::new(Config::CAN);
        let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
        reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
        let end = RawCommand::new(end, ReplyRule::Same, false);
        master.broadcast(end, MotorSet::EMPTY).unwrap();
        let in_mailbox = sent(&mut master, ms(2))[0];
        master.stop_all(kind, MotorSet::EMPTY).unwrap();
        let (_, data) = kind.command();
        for at in 2..120 {
            if !sent(&mut master, ms(at)).is_empty() {
                reply(&mut master, 1, data, ms(at + 1));
            }
        }
        master.lift_stop();
        master.handle_pushed_out(&in_mailbox);
        sent(&mut master, ms(130))
    };
    assert_eq!(goes(off, StopKind::Hold), []);
    assert_eq!(goes(hold, StopKind::Off), []);
    // No motor is restarted.
    assert_eq!(goes(Reset.encode(), StopKind::Hold), []);
    assert_eq!(goes(Reset.encode(), StopKind::Off), []);
    // Motors that this master does not know must also be stopped.
    assert_eq!(goes(off, StopKind::Off), [packet_to_all(off)]);
    assert_eq!(goes(hold, StopKind::Hold), [packet_to_all(hold)]);
}

/// Motor 1 answers each frame a millisecond later. Returns what was sent in these milliseconds, and whether a stop was
/// confirmed.
fn obeyed(master: &mut Master<2>, span: core::ops::Range<u64>) -> (Vec<Packet>, bool) {
    let (mut all, mut is_confirmed) = (Vec::new(), false);
    for at in span {
        for packet in sent(master, ms(at)) {
            if packet.channel == Channel::Command(id(1).into()) {
                is_confirmed |= reply(master, 1, packet.data, ms(at + 1)) == confirmed(1);
            }
            all.push(packet);
        }
        events(master, ms(at));
    }
    (all, is_confirmed)
}

#[test]
fn stop_in_doubt_is_confirmed_though_another_motor_is_put_in_doubt() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    events(&mut master, ms(21));
    master.stop(id(1), StopKind::Off).unwrap();
    assert!(!obeyed(&mut master, 21..22).1, "the set-point may lie in a mailbox");
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    obeyed(&mut master, 23..24);
    master.stop(id(2), StopKind::Hold).unwrap();
    assert!(obeyed(&mut master, 24..2_000).1);
}

#[test]
fn stop_to_all_handed_back_undoes_no_later_stop_lifted_since() {
    let goes = |is_off: bool, kind: StopKind, by_request: bool| {
        let mut master = Master::<2>::new(Config::CAN);
        if is_off {
            master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
        } else {
            master.broadcast(Stop, MotorSet::EMPTY).unwrap();
        }
        let in_mailbox = sent(&mut master, ms(0))[0];
        events(&mut master, ms(0));
        match (by_request, kind) {
            (false, _) => master.stop(id(1), kind).unwrap(),
            (true, StopKind::Hold) => drop(master.request(id(1), Stop).unwrap()),
            (true, StopKind::Off) => drop(master.request(id(1), Shutdown).unwrap()),
        }
        obeyed(&mut master, 1..150);
        master.lift_stop_of(id(1));
        master.handle_pushed_out(&in_mailbox);
        obeyed(&mut master, 150..160).0.len()
    };
    for by_request in [false, true] {
        assert_eq!(goes(true, StopKind::Hold, by_request), 0);
        assert_eq!(goes(false, StopKind::Off, by_request), 0);
        assert_eq!(goes(true, StopKind::Off, by_request), 1);
        assert_eq!(goes(false, StopKind::Hold, by_request), 1);
    }
}

#[test]
fn motor_held_before_a_shutdown_to_all_gets_it_despite_a_later_hold() {
    for is_handed_back in [true, false] {
        let mut master = Master::<2>::new(Config::CAN);
        master.stop(id(1), StopKind::Hold).unwrap();
        assert!(obeyed(&mut master, 0..5).1);
        master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
        if is_handed_back {
            let in_mailbox = sent(&mut master, ms(5))[0];
            master.stop(id(2), StopKind::Hold).unwrap();
            master.handle_pushed_out(&in_mailbox);
        } else {
            master.stop(id(2), StopKind::Hold).unwrap();
        }
        let (packets, _) = obeyed(&mut master, 5..20);
        let off = packet_to(1, Shutdown.encode());
        assert!(packets.contains(&off), "{packets:?}");
        assert!(!packets.contains(&packet_to_all(Shutdown.encode())), "{packets:?}");
    }
}

#[test]
fn requested_hold_is_answered_once_no_shutdown_to_all_can_arrive() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(0));
    events(&mut master, ms(0));
    let held = master.request(id(1), Stop).unwrap();
    assert_eq!(sent(&mut master, ms(1)).len(), 1);
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(2)), None, "its load may fall yet");
    let reported = (2..150).find_map(|at| {
        let is_sent = !sent(&mut master, ms(at)).is_empty();
        let event = reply(&mut master, 1, Stop.encode(), ms(at + 1)).filter(|_| is_sent)?;
        held.outcome(&event)
    });
    assert!(matches!(reported, Some(Ok(_))), "{reported:?}");
}

#[test]
fn read_to_all_ended_by_a_stop_and_handed_back_was_not_sent() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    let in_mailbox = sent(&mut master, ms(0))[0];
    // This ends it, and is more urgent.
    master.stop_all(StopKind::Hold, id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(1))[0].data, Stop.encode());
    master.handle_pushed_out(&in_mailbox);
    let done = Event::BroadcastDone { silent: id(1).into(), was_sent: false };
    assert_eq!(events(&mut master, ms(1)), [done]);
    assert_eq!(sent(&mut master, ms(1)), []);
}

#[test]
fn handed_back_reset_to_all_does_not_follow_a_stop_of_unknown_motors() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(Reset, MotorSet::EMPTY).unwrap();
    let reset = sent(&mut master, ms(0));
    assert_eq!(reset, [packet_to_all(Reset.encode())]);
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    master.handle_pushed_out(&reset[0]);
    assert_eq!(sent(&mut master, ms(1)), [packet_to_all(Stop.encode())]);
    for at in 2..100 {
        assert_eq!(sent(&mut master, ms(at)), [], "at {at} ms");
    }
}

#[test]
fn answer_to_an_attempt_before_a_pending_move_confirms_no_stop() {
    let mut master = Master::<2>::new(Config::CAN);
    // In a mailbox until 40 ms.
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(1)).len(), 1);
    // The second attempt reaches the drive at 39 ms, and is answered late.
    assert_eq!(sent(&mut master, ms(22)).len(), 1);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(23)), None, "to the first");
    assert_eq!(sent(&mut master, ms(64)), []);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(66)), None, "to the second");
    assert!(is_stop_confirmed(&mut master, ms(85)));
}

/// The move of one motor is not answered; another motor is heard for a moment, and then the stop is answered.
#[test]
fn move_without_reply_may_arrive_after_a_cut_though_the_window_has_grown() {
    let longest_reply_timeout = Duration::from_millis(40);
    let mut master = Master::<2>::new(Config { longest_reply_timeout, ..Config::CAN });
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    master.set_point(id(2), torque(1.0), ms(10)).unwrap();
    sent(&mut master, ms(10));
    let moves = RawCommand::new([0x72, 0, 0, 0, 0, 0, 0, 0], ReplyRule::Silent, true);
    let _ = master.request(id(1), moves).unwrap();
    assert_eq!(sent(&mut master, ms(12)).len(), 1);
    // On its way when the bus was cut.
    reply(&mut master, 2, TORQUE_REPLY, ms(30)).unwrap();
    for now in 31..100 {
        events(&mut master, ms(now));
    }
    reply(&mut master, 2, TORQUE_REPLY, ms(100)).unwrap();
    events(&mut master, ms(100));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(101)).len(), 1);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(102)), None, "it comes now");
}

/// The move can no longer arrive, and no stop was sent since: the motor may be forgotten.
#[test]
fn unanswered_read_does_not_make_an_expired_move_pending_again() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, step(), ms(0));
    assert_eq!(events(&mut master, ms(21)).len(), 1);
    reply(&mut master, 2, ANGLE_REPLY, ms(30)).unwrap();
    events(&mut master, ms(30));
    events(&mut master, ms(75));
    let _ = master.request_with(id(1), ReadModel, once(5)).unwrap();
    assert_eq!(sent(&mut master, ms(80)).len(), 1);
    assert_eq!(events(&mut master, ms(85)).len(), 1);
    assert!(master.forget(id(1)));
}
