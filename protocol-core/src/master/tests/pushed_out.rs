//! Frames that a controller hands back because another was more urgent.

use super::*;

#[test]
fn handed_back_request_is_sent_again() {
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
fn handed_back_frame_has_used_no_attempt() {
    let mut master = Master::<2>::new(Config::CAN);
    let patience = Patience { attempts: 2, reply_timeout: Duration::from_millis(5) };
    let ticket = master.request_with(id(1), ReadMultiTurnAngle, patience).unwrap();
    let pushed_out = sent(&mut master, ms(0))[0];
    master.handle_pushed_out(&pushed_out);
    for at in [0, 5] {
        assert_eq!(sent(&mut master, ms(at)), [pushed_out], "{at}");
    }
    assert_eq!(sent(&mut master, ms(10)), []);
    let reported = events(&mut master, ms(10));
    assert_eq!(
        reported.iter().find_map(|event| ticket.outcome(event)),
        Some(Err(Failure::NoReply))
    );
}

#[test]
fn motor_whose_frame_was_handed_back_has_had_no_turn() {
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

/// Set-points that were sent before it would push the stop out once more, each of them.
#[test]
fn handed_back_stop_is_sent_again_before_set_points_of_others() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    sent(&mut master, ms(0));
    reply(&mut master, 1, TORQUE_REPLY, ms(1)).unwrap();
    master.stop(id(2), StopKind::Off).unwrap();
    let pushed_out = packet_to(2, Shutdown.encode());
    assert_eq!(sent(&mut master, ms(1)), [pushed_out]);
    master.set_point(id(1), torque(2.0), ms(1)).unwrap();
    master.handle_pushed_out(&pushed_out);
    assert_eq!(sent(&mut master, ms(1)), [pushed_out]);
    assert_eq!(reply(&mut master, 2, Shutdown.encode(), ms(2)), confirmed(2));
    assert_eq!(sent(&mut master, ms(2)), [packet_to(1, torque(2.0).encode())]);
}

#[test]
fn handed_back_set_point_gives_way_to_a_newer_one_and_to_a_stop() {
    let mut master = Master::<2>::new(Config::CAN);
    obeys(&mut master, 1);
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
fn handed_back_set_point_is_dropped_for_a_waiting_shutdown() {
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
fn handed_back_broadcast_is_sent_again() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    let packets = sent(&mut master, ms(0));
    assert_eq!(sent(&mut master, ms(0)), []);
    master.handle_pushed_out(&packets[0]);
    assert_eq!(sent(&mut master, ms(0)), packets);
}

#[test]
fn handed_back_broadcast_without_reply_is_sent_again_before_its_report() {
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

#[test]
fn set_point_handed_back_when_too_old_is_not_sent_again() {
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
fn withdrawn_request_is_not_sent_once_it_is_handed_back() {
    let mut master = Master::<2>::new(Config::CAN);
    let ticket = master.request(id(1), step()).unwrap();
    let packets = sent(&mut master, ms(0));
    master.withdraw(ticket.id());
    master.handle_pushed_out(&packets[0]);
    assert_eq!(sent(&mut master, ms(1)), []);
}

/// A newer set-point that was put since is sent.
#[test]
fn withdrawn_set_point_is_not_sent_once_it_is_handed_back() {
    for has_newer in [false, true] {
        let mut master = Master::<2>::new(Config::CAN);
        master.set_point(id(1), torque(1.0), ms(0)).unwrap();
        let pushed_out = sent(&mut master, ms(0))[0];
        master.withdraw_set_point(id(1));
        if has_newer {
            master.set_point(id(1), torque(2.0), ms(1)).unwrap();
        }
        master.handle_pushed_out(&pushed_out);
        let newer = packet_to(1, torque(2.0).encode());
        assert_eq!(sent(&mut master, ms(1)), Vec::from_iter(has_newer.then_some(newer)));
        let is_dropped = events(&mut master, ms(1)) == [Event::SetPointDropped { motor: id(1) }];
        assert_eq!(is_dropped, !has_newer);
    }
}

#[test]
fn handed_back_set_point_that_gives_way_counts_as_superseded() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    let pushed_out = sent(&mut master, ms(0))[0];
    master.set_point(id(1), torque(2.0), ms(1)).unwrap();
    master.handle_pushed_out(&pushed_out);
    assert_eq!(master.health(id(1)).superseded, 1);
}

/// The caller's own command may have reached the motor: its answer is no confirmation.
#[test]
fn handed_back_stop_leaves_the_answer_to_an_earlier_shutdown_owed() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, Shutdown, ms(0));
    master.stop(id(1), StopKind::Off).unwrap();
    let stop = sent(&mut master, ms(1))[0];
    master.handle_pushed_out(&stop);
    assert_eq!(sent(&mut master, ms(2)), [stop]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(3)), None);
}

#[test]
fn handed_back_lost_set_point_is_not_taken_for_the_one_in_flight() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    let lost = sent(&mut master, ms(0))[0];
    assert_eq!(events(&mut master, ms(21)).len(), 1);
    master.set_point(id(1), torque(2.0), ms(21)).unwrap();
    assert_eq!(sent(&mut master, ms(21)).len(), 1);
    master.handle_pushed_out(&lost);
    assert_eq!(sent(&mut master, ms(22)), []);
    assert_eq!(master.health(id(1)).lost, 0);
}

#[test]
fn handed_back_set_point_is_sent_again_while_a_read_waits() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    let pushed_out = sent(&mut master, ms(0))[0];
    let _read = master.request(id(1), ReadModel).unwrap();
    master.handle_pushed_out(&pushed_out);
    let packets: Vec<Packet> = (1..25).flat_map(|now| sent(&mut master, ms(now))).collect();
    assert!(packets.contains(&pushed_out), "{packets:?}");
}

/// The attempt counted as lost, and a stop takes its place before it is sent again.
#[test]
fn attempt_handed_back_after_a_stop_does_not_count_as_lost() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = master.request(id(1), ReadModel).unwrap();
    let read = sent(&mut master, ms(0))[0];
    master.handle_timeout(ms(21));
    assert_eq!(master.health(id(1)).lost, 1);
    master.stop(id(1), StopKind::Off).unwrap();
    master.handle_pushed_out(&read);
    assert_eq!(master.health(id(1)).lost, 0);
}

/// A driver reports both at once: that it has taken a frame, and which one had to make way for it.
#[test]
fn move_taken_is_not_resent_if_the_displaced_frame_is_reported_first() {
    let mut master = Master::<2>::new(Config::CAN);
    let _read = master.request(id(2), ReadMultiTurnAngle).unwrap();
    let made_way = sent(&mut master, ms(0))[0];
    let _step = master.request(id(1), step()).unwrap();
    let step = master.poll_transmit(ms(1)).unwrap();
    assert_eq!(step.data[0], 0xA8);
    master.handle_pushed_out(&made_way);
    master.handle_transmitted(ms(1));
    assert_eq!(sent(&mut master, ms(2)), [made_way], "the step is on its way already");
}

/// All are switched off by a frame that waits in a mailbox; motor 2 is to be held since. What is offered to motor 1
/// makes that frame go back, which is said before it is said that it was taken.
fn handed_back_before_it_is_said(offer: impl FnOnce(&mut Master<2>), first: bool) -> Option<Event> {
    let mut master = Master::<2>::new(Config::CAN);
    for motor in [1, 2] {
        let _ = ask(&mut master, motor, ReadMultiTurnAngle, ms(0));
        reply(&mut master, motor, ANGLE_REPLY, ms(1)).unwrap();
    }
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(2)), [packet_to_all(Shutdown.encode())]);
    events(&mut master, ms(2));
    master.stop(id(2), StopKind::Hold).unwrap();
    assert_eq!(sent(&mut master, ms(3)).len(), 1);
    offer(&mut master);
    master.handle_timeout(ms(4));
    let offered = master.poll_transmit(ms(4)).unwrap();
    assert!(matches!(offered.data[0], 0xA1 | 0xA8), "{offered:?}");
    if first {
        master.handle_pushed_out(&packet_to_all(Shutdown.encode()));
        master.handle_transmitted(ms(4));
    } else {
        master.handle_transmitted(ms(4));
        master.handle_pushed_out(&packet_to_all(Shutdown.encode()));
    }
    // Motor 1 is switched off individually now. What was taken before may arrive after that.
    let stop = packet_to(1, Shutdown.encode());
    assert!(sent(&mut master, ms(4)).contains(&stop), "the stop goes at once");
    reply(&mut master, 1, Shutdown.encode(), ms(5))
}

#[test]
fn stop_is_in_doubt_after_a_set_point_pushed_a_shutdown_to_all_out() {
    let offer = |master: &mut Master<2>| master.set_point(id(1), torque(1.0), ms(4)).unwrap();
    assert_eq!(handed_back_before_it_is_said(offer, false), None);
    assert_eq!(handed_back_before_it_is_said(offer, true), None);
}

#[test]
fn stop_is_in_doubt_after_a_move_pushed_a_shutdown_to_all_out() {
    let offer = |master: &mut Master<2>| {
        let _step = master.request(id(1), step()).unwrap();
    };
    assert_eq!(handed_back_before_it_is_said(offer, false), None);
    assert_eq!(handed_back_before_it_is_said(offer, true), None);
}

#[test]
fn set_point_that_expires_between_offer_and_sending_counts_as_sent() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    sent(&mut master, ms(0));
    events(&mut master, ms(21));
    master.set_point(id(1), torque(1.0), ms(30)).unwrap();
    let expired = ms(30) + Config::CAN.set_point_max_age;
    let packet = master.poll_transmit(expired).unwrap();
    assert_eq!(packet.data[0], 0xA1);
    let old = Packet { channel: Channel::Motion(id(1)), data: motion().encode() };
    master.handle_pushed_out(&old);
    master.handle_transmitted(expired);
    // It is in a mailbox.
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, expired + Duration::from_millis(1)).len(), 1);
    let at = expired + Duration::from_millis(2);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), at), None);
}

/// Otherwise the request of its motor has each turn of a set-point that makes way again and again.
#[test]
fn handed_back_set_point_keeps_its_turn() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    let _read = master.request(id(1), ReadModel).unwrap();
    for _ in 0..3 {
        let offered = master.poll_transmit(ms(0)).unwrap();
        assert_eq!(offered.data[0], 0xA1);
        master.handle_transmitted(ms(0));
        master.handle_pushed_out(&offered);
    }
}

/// The lock is sent once more, and waits for the attempts of the read, which do not wait for it.
#[test]
fn handed_back_lock_to_all_and_a_later_read_do_not_block_each_other() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(LockBrake, MotorSet::EMPTY).unwrap();
    let to_all = packet_to_all(LockBrake.encode());
    assert_eq!(sent(&mut master, ms(0)), [to_all]);
    let _read = master.request(id(1), ReadModel).unwrap();
    assert_eq!(sent(&mut master, ms(0)), [packet_to(1, ReadModel.encode())]);
    master.handle_pushed_out(&to_all);
    // Three attempts of 20.4 ms, and somebody looks every millisecond.
    let again = (1..200).find(|&now| {
        events(&mut master, ms(now));
        sent(&mut master, ms(now)).contains(&to_all)
    });
    assert_eq!(again, Some(63));
}

/// The earlier broadcast was handed back and ended by a stop, so that it was never sent again.
#[test]
fn new_broadcast_delays_no_request_for_an_earlier_handed_back_one() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(ReadModel, MotorSet::EMPTY).unwrap();
    let in_mailbox = sent(&mut master, ms(0))[0];
    master.handle_pushed_out(&in_mailbox);
    master.stop(id(1), StopKind::Off).unwrap();
    master.handle_bus_down(ms(1));
    events(&mut master, ms(1));
    assert_eq!(sent(&mut master, ms(1)), [packet_to(1, Shutdown.encode())]);
    reply(&mut master, 1, Shutdown.encode(), ms(2)).unwrap();
    master.broadcast(ReadModel, MotorSet::EMPTY).unwrap();
    let _read = master.request(id(2), ReadMultiTurnAngle).unwrap();
    let packets = sent(&mut master, ms(100));
    assert_eq!(
        packets,
        [packet_to_all(ReadModel.encode()), packet_to(2, ReadMultiTurnAngle.encode())]
    );
}

#[test]
fn handed_back_stop_to_all_is_sent_before_a_later_broadcast_and_read() {
    let mut master = Master::<1>::new(Config::CAN);
    let both: MotorSet = [id(1), id(2)].into();
    assert!(master.stop_all(StopKind::Off, both).is_err(), "there is one place");
    let to_all = packet_to_all(Shutdown.encode());
    assert_eq!(sent(&mut master, ms(0))[0], to_all);
    reply(&mut master, 1, Shutdown.encode(), ms(1));
    master.handle_pushed_out(&to_all);
    master.broadcast(ReadMultiTurnAngle, MotorSet::EMPTY).unwrap();
    let _read = master.request(id(1), ReadModel).unwrap();
    let packets = sent(&mut master, ms(1) + Duration::from_micros(10));
    assert_eq!(packets[0], to_all);
    assert!(!packets.contains(&packet_to(1, ReadModel.encode())), "it may push that out again");
}

/// The stop is sent long after the start of the clock.
#[test]
fn stop_to_all_handed_back_once_is_not_pushed_out_by_a_read_again() {
    let mut master = Master::<1>::new(Config::CAN);
    let both: MotorSet = [id(1), id(2)].into();
    assert!(master.stop_all(StopKind::Off, both).is_err(), "there is one place");
    let to_all = packet_to_all(Shutdown.encode());
    assert_eq!(sent(&mut master, ms(1_000))[0], to_all);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(1_001)), confirmed(1));
    master.handle_pushed_out(&to_all);
    let _read = master.request(id(1), ReadModel).unwrap();
    let soon = |micros| ms(1_001) + Duration::from_micros(micros);
    assert_eq!(sent(&mut master, soon(10)), [to_all]);
    assert_eq!(sent(&mut master, soon(20)), []);
    assert_eq!(sent(&mut master, ms(1_002)), [packet_to(1, ReadModel.encode())]);
}

#[test]
fn broadcast_handed_back_once_keeps_the_bus_though_the_next_is_put() {
    let mut master = Master::<2>::new(Config::CAN);
    let to_all = [packet_to_all(ReadModel.encode())];
    master.broadcast(ReadModel, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(2)), to_all);
    master.handle_pushed_out(&to_all[0]);
    assert_eq!(sent(&mut master, ms(2)), to_all);
    assert_eq!(events(&mut master, ms(2)).len(), 1);
    master.set_point(id(1), torque(1.0), ms(2)).unwrap();
    master.broadcast(ReadMultiTurnAngle, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(2) + Duration::from_micros(10)), []);
    // The bus was quiet since.
    assert_eq!(sent(&mut master, ms(3)), [packet_to(1, torque(1.0).encode())]);
}

#[test]
fn broadcast_handed_back_once_is_not_pushed_out_by_a_read_again() {
    // Sooner than a reply time-out after the beginning, and long after it.
    for at in [2, 1_000] {
        let mut master = Master::<2>::new(Config::CAN);
        let to_all = packet_to_all(ReadMultiTurnAngle.encode());
        // No motor is expected to answer, so what is heard does not show where it is.
        master.broadcast(ReadMultiTurnAngle, MotorSet::EMPTY).unwrap();
        assert_eq!(sent(&mut master, ms(at)), [to_all]);
        master.handle_pushed_out(&to_all);
        assert_eq!(sent(&mut master, ms(at)), [to_all]);
        let soon = |micros| ms(at) + Duration::from_micros(micros);
        reply(&mut master, 1, ANGLE_REPLY, soon(300));
        let _read = master.request(id(2), ReadModel).unwrap();
        assert_eq!(sent(&mut master, soon(310)), [], "{at}");
        let quiet = master.poll_at().unwrap();
        assert_eq!(sent(&mut master, quiet), [packet_to(2, ReadModel.encode())], "{at}");
    }
}

/// The bus has carried it. Otherwise a caller that asks all again at once would keep set-points back for ever: the bus
/// is never quiet.
#[test]
fn answered_broadcast_handed_back_before_delays_no_set_point() {
    let mut master = Master::<2>::new(Config::CAN);
    let to_all = packet_to_all(ReadMultiTurnAngle.encode());
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(2)), [to_all]);
    master.handle_pushed_out(&to_all);
    assert_eq!(sent(&mut master, ms(2)), [to_all]);
    master.set_point(id(2), torque(1.0), ms(2)).unwrap();
    let answered = ms(2) + Duration::from_micros(300);
    for motor in [1, 2] {
        reply(&mut master, motor, ANGLE_REPLY, answered);
    }
    assert_eq!(events(&mut master, answered).len(), 1);
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    assert_eq!(sent(&mut master, answered), [to_all, packet_to(2, torque(1.0).encode())]);
}

/// The answer comes when the stop was handed back, or when it was sent again.
#[test]
fn answer_to_a_read_to_all_does_not_show_that_a_stop_to_all_was_sent() {
    for is_sent_before in [false, true] {
        let mut master = Master::<1>::new(Config::CAN);
        let both: MotorSet = [id(1), id(2)].into();
        assert!(master.stop_all(StopKind::Off, both).is_err(), "there is one place");
        let stop = packet_to_all(Shutdown.encode());
        let question = packet_to_all(ReadMultiTurnAngle.encode());
        assert_eq!(sent(&mut master, ms(0))[0], stop);
        reply(&mut master, 1, Shutdown.encode(), ms(1));
        master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
        assert_eq!(sent(&mut master, ms(1)), [question]);
        master.handle_pushed_out(&stop);
        let soon = |micros| ms(1) + Duration::from_micros(micros);
        let mut packets = if is_sent_before { sent(&mut master, soon(10)) } else { Vec::new() };
        reply(&mut master, 1, ANGLE_REPLY, soon(300));
        assert_eq!(events(&mut master, soon(300)).len(), 1);
        let _read = master.request(id(1), ReadModel).unwrap();
        packets.extend(sent(&mut master, soon(310)));
        assert_eq!(packets, [stop], "{is_sent_before}");
    }
}

/// Motor 1 was stopped and its answer is lost; the hold of motor 2 came back after motor 2 was to be off.
#[test]
fn handed_back_hold_leaves_the_following_shutdown_a_first_stop() {
    let mut master = Master::<2>::new(Config::CAN);
    for motor in [1, 2] {
        let _read = ask(&mut master, motor, ReadMultiTurnAngle, ms(0));
        reply(&mut master, motor, ANGLE_REPLY, ms(1)).unwrap();
    }
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(2)), [packet_to(1, Shutdown.encode())]);
    master.stop(id(2), StopKind::Hold).unwrap();
    assert_eq!(sent(&mut master, ms(10)), [packet_to(2, Stop.encode())]);
    master.stop(id(2), StopKind::Off).unwrap();
    master.handle_pushed_out(&packet_to(2, Stop.encode()));
    // The second of motor 1 is due, and older.
    let (first, second) = (packet_to(2, Shutdown.encode()), packet_to(1, Shutdown.encode()));
    assert_eq!(sent(&mut master, ms(30)), [first, second]);
}

/// A motion command begins with a position, of which the first byte may be that of a Shutdown. Motor 1 was stopped
/// first.
#[test]
fn handed_back_motion_command_is_not_taken_for_a_stop() {
    let mut master = Master::<2>::new(Config::CAN);
    let motion = RawMotion::decode(&[0x80, 0, 0x80, 0, 0, 0, 0, 0]);
    master.set_point(id(1), motion, ms(0)).unwrap();
    let in_mailbox = sent(&mut master, ms(0))[0];
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.handle_pushed_out(&in_mailbox);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(1)), confirmed(1));
    let _read = ask(&mut master, 2, ReadMultiTurnAngle, ms(2));
    reply(&mut master, 2, ANGLE_REPLY, ms(3)).unwrap();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(4))[0], packet_to(2, Shutdown.encode()), "its first");
}

/// Motor 3 was stopped, and does not answer: its second stop is due, and older than that of motor 1.
#[test]
fn handed_back_stop_is_a_first_one_unless_its_motor_was_held_before() {
    for was_held_before in [false, true] {
        let mut master = Master::<4>::new(Config::CAN);
        obeys(&mut master, 1);
        let stop = packet_to(1, Shutdown.encode());
        if was_held_before {
            // To hold; it is to be off now.
            master.stop(id(1), StopKind::Hold).unwrap();
            assert_eq!(sent(&mut master, ms(0)).len(), 1);
            assert_eq!(reply(&mut master, 1, Stop.encode(), ms(1)), confirmed(1));
        }
        master.stop(id(3), StopKind::Off).unwrap();
        assert_eq!(sent(&mut master, ms(2)).len(), 1);
        master.stop(id(1), StopKind::Off).unwrap();
        assert_eq!(sent(&mut master, ms(10)), [stop]);
        master.handle_pushed_out(&stop);
        let stops = sent(&mut master, ms(30));
        assert_eq!(stops.first() == Some(&stop), !was_held_before, "{stops:?}");
    }
}

/// The first stop of motor 3 was sent, and never answered; the motor was heard since the second, which comes back.
#[test]
fn handed_back_second_stop_is_sent_after_a_first_stop_of_another() {
    let mut master = Master::<4>::new(Config::CAN);
    let [first, second] = [1, 3].map(|motor| packet_to(motor, Shutdown.encode()));
    master.stop(id(3), StopKind::Off).unwrap();
    for at in [2, 23] {
        assert_eq!(sent(&mut master, ms(at)), [second], "{at}");
    }
    reply(&mut master, 3, ANGLE_REPLY, ms(24)).unwrap();
    // Motor 1 is sent something after that: only that it has got no stop yet brings it forward.
    master.set_point(id(1), torque(1.0), ms(25)).unwrap();
    assert_eq!(sent(&mut master, ms(25)), [packet_to(1, torque(1.0).encode())]);
    master.handle_pushed_out(&second);
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(26)), [first, second]);
}

/// Motor 2 was to be held and then to be off. The hold comes back, so it may not have reached the motor; but the
/// shutdown was sent.
#[test]
fn shutdown_sent_once_is_no_first_stop_though_the_hold_is_handed_back() {
    let mut master = Master::<4>::new(Config::CAN);
    let [first, second] = [1, 2].map(|motor| packet_to(motor, Shutdown.encode()));
    master.stop(id(2), StopKind::Hold).unwrap();
    assert_eq!(sent(&mut master, ms(1)), [packet_to(2, Stop.encode())]);
    master.stop(id(2), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(2)), [second]);
    master.handle_pushed_out(&packet_to(2, Stop.encode()));
    reply(&mut master, 2, ANGLE_REPLY, ms(4)).unwrap();
    master.set_point(id(1), torque(1.0), ms(10)).unwrap();
    assert_eq!(sent(&mut master, ms(10)), [packet_to(1, torque(1.0).encode())]);
    events(&mut master, ms(23));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(23)), [first, second]);
}

/// No motor is kept back any more for a frame that no longer makes way.
#[test]
fn motor_that_answered_since_its_frame_was_handed_back_delays_no_other() {
    let mut master = Master::<2>::new(Config::CAN);
    let stop = packet_to(1, Shutdown.encode());
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(0)), [stop]);
    master.handle_pushed_out(&stop);
    assert_eq!(sent(&mut master, ms(0)), [stop]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(1)), confirmed(1));
    master.lift_stop();
    // Motor 2 has had one turn more, so that motor 1 goes first, and is not behind then.
    for at in [2, 4] {
        let _read = ask(&mut master, 2, ReadMultiTurnAngle, ms(at));
        reply(&mut master, 2, ANGLE_REPLY, ms(at + 1)).unwrap();
    }
    for motor in [1, 2] {
        master.set_point(id(motor), torque(1.0), ms(6)).unwrap();
    }
    let to_both = [1, 2].map(|motor| packet_to(motor, torque(1.0).encode()));
    assert_eq!(sent(&mut master, ms(6)), to_both);
}

/// What ends motion is put after a set-point, and dropped because the bus is down.
#[test]
fn handed_back_set_point_does_not_follow_a_shutdown_that_was_never_sent() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    let set_point = sent(&mut master, ms(0));
    let off = master.request(id(1), Shutdown).unwrap();
    assert_eq!(sent(&mut master, ms(1)), []);
    master.handle_bus_down(ms(15));
    let failed = events(&mut master, ms(15));
    assert!(failed.iter().any(|event| off.outcome(event) == Some(Err(Failure::BusDown))));
    master.handle_pushed_out(&set_point[0]);
    assert_eq!(sent(&mut master, ms(16)), []);
}

/// Only what moves the motor waits until the caller knows of the restart.
#[test]
fn handed_back_release_of_a_brake_after_a_restart_is_sent_again() {
    let mut master = Master::<2>::new(Config::CAN);
    master.handle_timeout(ms(1));
    master.note_restart(id(1));
    events(&mut master, ms(1));
    let _release = master.request(id(1), ReleaseBrake).unwrap();
    let released = sent(&mut master, ms(2));
    assert_eq!(released, [packet_to(1, ReleaseBrake.encode())]);
    master.handle_pushed_out(&released[0]);
    assert_eq!(sent(&mut master, ms(3)), released);
}

/// The stop is put between the set-point and its return, and not sent yet.
#[test]
fn set_point_handed_back_before_a_stop_is_sent_does_not_follow_it() {
    let mut master = Master::<2>::new(Config::CAN);
    obeys(&mut master, 1);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    let set_point = sent(&mut master, ms(0));
    master.stop(id(1), StopKind::Hold).unwrap();
    master.handle_pushed_out(&set_point[0]);
    master.lift_stop();
    assert_eq!(sent(&mut master, ms(1)), [packet_to(1, Stop.encode())]);
    assert_eq!(events(&mut master, ms(1)), [Event::SetPointDropped { motor: id(1) }]);
    let confirmed = reply(&mut master, 1, Stop.encode(), ms(2));
    assert_eq!(confirmed, Some(Event::StopConfirmed { motor: id(1) }));
    assert_eq!(sent(&mut master, ms(3)), []);
}

/// No stop has dropped it.
#[test]
fn release_of_a_brake_handed_back_after_a_restart_fails_as_dropped() {
    let mut master = Master::<2>::new(Config::CAN);
    let release = ask(&mut master, 1, ReleaseBrake, ms(0)).id();
    master.note_restart(id(1));
    master.handle_pushed_out(&packet_to(1, ReleaseBrake.encode()));
    assert_eq!(sent(&mut master, ms(1)), []);
    let dropped = Event::Failed { ticket: release, failure: Failure::Dropped };
    assert_eq!(events(&mut master, ms(1)), [Event::Restarted { motor: id(1) }, dropped]);
}

#[test]
fn handed_back_reset_that_was_withdrawn_is_not_sent_again() {
    let mut master = Master::<2>::new(Config::CAN);
    let ticket = ask(&mut master, 1, Reset, ms(0));
    master.withdraw(ticket.id());
    master.handle_pushed_out(&Reset.packet(id(1)));
    let times = (0..5_000).step_by(10);
    assert_eq!(times.map(|now| sent(&mut master, ms(now)).len()).sum::<usize>(), 0);
}

/// A set-point of motion mode may have any bytes.
#[test]
fn handed_back_set_point_with_the_bytes_of_a_request_is_no_request() {
    let mut master = Master::<2>::new(Config::CAN);
    let set_point = RawMotion::decode(&ReadMultiTurnAngle.encode());
    master.set_point(id(1), set_point, ms(0)).unwrap();
    assert_eq!(sent(&mut master, ms(0)), [set_point.packet(id(1))]);
    // It counts as lost, and the request is sent.
    let _request = ask(&mut master, 1, ReadMultiTurnAngle, ms(21));
    assert!(master.motor(id(1)).unwrap().request.in_flight().is_some());
    master.handle_pushed_out(&set_point.packet(id(1)));
    assert_eq!(sent(&mut master, ms(22)), []);
}
