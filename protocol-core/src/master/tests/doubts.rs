//! Commands to all that are in a mailbox while another was sent since, and frames that are handed back after a restart
//! or a failure.

use super::unnamed::{channels, to};
use super::*;

/// Motor 1 is to hold after `before`. Returns whether its first confirmation counts, and otherwise when the next
/// frame is due.
fn held_after(before: impl Fn(&mut Master<2>), at: u64) -> Result<(), Instant> {
    let mut master = Master::<2>::new(Config::CAN);
    before(&mut master);
    obeys(&mut master, 1);
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(sent(&mut master, ms(at))[0].data, Stop.encode());
    match reply(&mut master, 1, Stop.encode(), ms(at + 1)) {
        None => Err(master.poll_at().unwrap()),
        reported => {
            assert_eq!(reported, confirmed(1));
            Ok(())
        }
    }
}

fn to_all<C: Command>(master: &mut Master<2>, command: C, at: u64) -> Packet {
    master.broadcast(command, MotorSet::EMPTY).unwrap();
    let in_mailbox = sent(master, ms(at))[0];
    events(master, ms(at));
    in_mailbox
}

#[test]
fn hold_is_in_doubt_while_an_earlier_shutdown_or_reset_to_all_may_arrive() {
    // No motor has a place, so nothing waits for answers. Each command may arrive for 61.2 ms.
    let reset = |master: &mut Master<2>| _ = to_all(master, Reset, 0);
    let off = |master: &mut Master<2>| _ = to_all(master, Shutdown, 0);
    let read = |master: &mut Master<2>| _ = to_all(master, ReadMultiTurnAngle, 1);
    for lets_go in [&reset as &dyn Fn(&mut Master<2>), &off] {
        for is_another_sent in [false, true] {
            let reported = held_after(
                |master| {
                    lets_go(master);
                    if is_another_sent {
                        read(master);
                    }
                },
                2,
            );
            assert!(reported.is_err_and(|at| at > ms(60) && at < ms(64)), "{reported:?}");
        }
    }
    assert_eq!(held_after(read, 2), Ok(()));
    // A lock lets no motor go, and a motor that has answered the Shutdown is off already.
    assert_eq!(held_after(|master| _ = to_all(master, LockBrake, 0), 2), Ok(()));
    let answered = |master: &mut Master<2>| {
        off(master);
        reply(master, 1, Shutdown.encode(), ms(1));
        read(master);
    };
    assert_eq!(held_after(answered, 2), Ok(()));
    // Of two Shutdowns one was answered.
    let answered_once = |master: &mut Master<2>| {
        for at in [0, 1] {
            to_all(master, Shutdown, at);
        }
        reply(master, 1, Shutdown.encode(), ms(2));
    };
    assert!(held_after(answered_once, 3).is_err());
    // It was handed back, and goes to the others.
    let mut master = Master::<2>::new(Config::CAN);
    obeys(&mut master, 1);
    let in_mailbox = to_all(&mut master, Shutdown, 0);
    master.stop(id(1), StopKind::Hold).unwrap();
    sent(&mut master, ms(1));
    master.handle_pushed_out(&in_mailbox);
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(2)), confirmed(1));
}

#[test]
fn pending_shutdown_to_all_delays_only_the_confirmation_of_holds() {
    let mut master = Master::<2>::new(Config::CAN);
    to_all(&mut master, Shutdown, 0);
    for motor in [1, 2] {
        let kind = if motor == 1 { StopKind::Hold } else { StopKind::Off };
        master.stop(id(motor), kind).unwrap();
    }
    assert_eq!(sent(&mut master, ms(1)).len(), 2);
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(2)), None);
    // The answer to the command to all comes first.
    reply(&mut master, 2, Shutdown.encode(), ms(2));
    sent(&mut master, ms(2));
    assert_eq!(reply(&mut master, 2, Shutdown.encode(), ms(3)), confirmed(2));
    // A lock of its brake is answered at once, too.
    let mut master = Master::<2>::new(Config::CAN);
    to_all(&mut master, Shutdown, 0);
    master.stop(id(2), StopKind::Hold).unwrap();
    let locked = master.request(id(1), LockBrake).unwrap();
    sent(&mut master, ms(1));
    let reported = reply(&mut master, 1, LockBrake.encode(), ms(2)).unwrap();
    assert!(matches!(locked.outcome(&reported), Some(Ok(_))));
}

#[test]
fn hold_is_in_doubt_while_a_cut_bus_may_keep_a_shutdown_to_all() {
    // Nothing was heard since it was sent, and then of another drive.
    let reported = held_after(
        |master| {
            to_all(master, Shutdown, 0);
            events(master, ms(300));
        },
        500,
    );
    assert!(reported.is_err_and(|at| at > ms(540) && at < ms(545)), "{reported:?}");
    let reported = held_after(
        |master| {
            to_all(master, Shutdown, 0);
            reply(master, 2, ANGLE_REPLY, ms(100));
            events(master, ms(150));
        },
        500,
    );
    assert_eq!(reported, Ok(()));
}

/// A motor that is known, and then silent until its restart is reported.
fn restarted(between: impl FnOnce(&mut Master<2>) -> Packet) -> (Master<2>, Packet) {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    let _ = master.request_with(id(1), ReadModel, once(20)).unwrap();
    sent(&mut master, ms(2));
    events(&mut master, ms(70));
    let in_mailbox = between(&mut master);
    reply(&mut master, 1, [0x9A, 50, 30, 1, 0xE5, 0x01, 0, 0], ms(1_100)).unwrap();
    (master, in_mailbox)
}

#[test]
fn move_to_all_handed_back_after_a_reported_restart_is_not_sent_again() {
    for (expected, is_resumed) in
        [(id(1).into(), false), (MotorSet::EMPTY, false), (id(1).into(), true)]
    {
        let (mut master, in_mailbox) = restarted(|master| {
            master.broadcast(step(), expected).unwrap();
            sent(master, ms(1_090))[0]
        });
        let reported: Vec<Event> = core::iter::from_fn(|| {
            master.places.news.iter().next()?;
            master.change(id(1), take_news)?
        })
        .collect();
        assert!(reported.contains(&Event::Restarted { motor: id(1) }), "{reported:?}");
        master.handle_pushed_out(&in_mailbox);
        if is_resumed {
            master.resume(id(1));
        }
        assert_eq!(master.poll_transmit(ms(1_100)), None, "{expected:?}");
        let reported = events(&mut master, ms(1_100));
        assert!(
            reported.contains(&Event::BroadcastDone { silent: expected, was_sent: false }),
            "{reported:?}"
        );
    }
}

#[test]
fn last_attempt_of_a_failed_stop_handed_back_does_not_count_as_lost() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    let mut in_mailbox = None;
    for attempt in 0..15 {
        in_mailbox = sent(&mut master, ms(2 + 21 * attempt)).pop();
    }
    assert_eq!(events(&mut master, ms(317)), [Event::StopUnconfirmed { motor: id(1) }]);
    let counted = |master: &Master<2>| (master.health(id(1)).answered, master.health(id(1)).lost);
    assert_eq!(counted(&master), (1, 15));
    master.handle_pushed_out(&in_mailbox.unwrap());
    assert_eq!(counted(&master), (1, 14));
}

#[test]
fn broadcast_handed_back_after_its_time_out_does_not_count_as_lost() {
    let mut master = Master::<2>::new(Config::CAN);
    // This one is lost, and stays so.
    let patience = master.patience(1);
    let _read = master.request_with(id(1), ReadMultiTurnAngle, patience).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    assert_eq!(events(&mut master, ms(21)).len(), 1);
    master.broadcast(Shutdown, [id(1), id(2)].into()).unwrap();
    let to_all = sent(&mut master, ms(102)).pop().unwrap();
    let silent = [id(1), id(2)].into();
    assert_eq!(events(&mut master, ms(123)), [Event::BroadcastDone { silent, was_sent: true }]);
    assert_eq!(master.health(id(1)).lost, 2);
    master.handle_pushed_out(&to_all);
    assert_eq!(master.health(id(1)).lost, 1);
    // It is sent once more, and that is not counted.
    assert_eq!(sent(&mut master, ms(124)), [to_all]);
    events(&mut master, ms(150));
    master.handle_pushed_out(&to_all);
    assert_eq!(master.health(id(1)).lost, 1);
}

#[test]
fn handed_back_broadcast_leaves_the_loss_of_the_one_before_counted() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    master.broadcast(Shutdown, id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(2)).len(), 1);
    events(&mut master, ms(23));
    assert_eq!(master.health(id(1)).lost, 1);
    master.broadcast(Stop, id(1).into()).unwrap();
    let to_all = sent(&mut master, ms(100)).pop().unwrap();
    master.handle_pushed_out(&to_all);
    assert_eq!(master.health(id(1)).lost, 1);
}

#[test]
fn feedback_counts_as_lost_after_a_time_out_below_the_longest_response() {
    let mut config = Config { reply_timeout: Duration::from_micros(1_200), ..Config::CAN };
    config.late_window = Duration::from_millis(3);
    let mut master = Master::<2>::new(config);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    let at = master.poll_at().unwrap();
    assert_eq!(at, Instant::from_micros(1_200));
    assert_eq!(events(&mut master, at), [Event::SetPointUnanswered { motor: id(1) }]);
}

#[test]
fn shutdown_to_all_overtaken_by_a_hold_does_not_reach_the_held_motor() {
    let [off, hold] = [Shutdown.encode(), Stop.encode()];
    for is_confirmed in [true, false] {
        for is_handed_back in [true, false] {
            let mut master = Master::<2>::new(Config::CAN);
            obeys(&mut master, 1);
            obeys(&mut master, 2);
            let both = [1, 2].into_iter().map(id).collect();
            master.stop_all(StopKind::Hold, both).unwrap();
            assert_eq!(sent(&mut master, ms(0)).len(), 2);
            if is_confirmed || is_handed_back {
                for motor in [1, 2] {
                    assert_eq!(reply(&mut master, motor, hold, ms(1)), confirmed(motor));
                }
            }
            master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
            if is_handed_back {
                let in_mailbox = sent(&mut master, ms(2))[0];
                assert_eq!(in_mailbox, packet_to_all(off));
                master.stop(id(1), StopKind::Hold).unwrap();
                master.handle_pushed_out(&in_mailbox);
            } else {
                master.stop(id(1), StopKind::Hold).unwrap();
            }
            let mut packets = Vec::new();
            for at in 2..100 {
                for packet in sent(&mut master, ms(at)) {
                    let Channel::Command(Target::Motor(motor)) = packet.channel else {
                        panic!("{packet:?}")
                    };
                    reply(&mut master, motor.get(), packet.data, ms(at + 1));
                    packets.push(packet);
                }
            }
            assert!(packets.contains(&packet_to(2, off)), "{packets:?}");
            assert!(!packets.contains(&packet_to(1, off)), "{packets:?}");
        }
    }
}

#[test]
fn brake_release_in_flight_is_not_resent_after_a_shutdown_to_all() {
    for is_handed_back in [false, true] {
        let mut master = Master::<2>::new(Config::CAN);
        let ticket = master.request(id(1), ReleaseBrake).unwrap();
        let in_mailbox = sent(&mut master, ms(0));
        assert_eq!(in_mailbox.len(), 1);
        master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
        if is_handed_back {
            master.handle_pushed_out(&in_mailbox[0]);
        }
        let (mut packets, mut failures) = (Vec::new(), Vec::new());
        for at in 1..100 {
            master.handle_timeout(ms(at));
            packets.extend(sent(&mut master, ms(at)));
            failures.extend(events(&mut master, ms(at)).iter().filter_map(|it| ticket.outcome(it)));
        }
        assert_eq!(packets, [packet_to_all(Shutdown.encode())]);
        let why = if is_handed_back { Failure::Stopped } else { Failure::NoReply };
        assert_eq!(failures, [Err(why)]);
    }
}

#[test]
fn motor_that_a_broadcast_may_yet_move_is_not_forgotten() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(torque(1.0), id(1).into()).unwrap();
    assert!(!master.forget(id(1)), "it waits");
    sent(&mut master, ms(0));
    assert!(!master.forget(id(1)), "it is in flight");
    let over = Event::BroadcastDone { silent: id(1).into(), was_sent: true };
    assert!(events(&mut master, ms(21)).contains(&over));
    assert!(!master.forget(id(1)), "it may lie in a mailbox");
    let feedback = [0xA1, 0x32, 0x64, 0, 0, 0, 0x68, 1];
    reply(&mut master, 1, feedback, ms(30));
    assert!(master.forget(id(1)), "it has come");
    // A command that moves no motor does not matter.
    to_all(&mut master, ReadMultiTurnAngle, 100);
    let _read = ask(&mut master, 1, ReadRunTime, ms(200));
    reply(&mut master, 1, [0xB1, 0, 0, 0, 1, 0, 0, 0], ms(201)).unwrap();
    to_all(&mut master, ReadMultiTurnAngle, 202);
    assert!(master.forget(id(1)));
}

#[test]
fn no_older_hold_of_one_motor_follows_a_shutdown_or_reset_to_all() {
    let hold_by_stop = |master: &mut Master<2>| master.stop(id(1), StopKind::Hold).unwrap();
    let hold_by_request = |master: &mut Master<2>| _ = master.request(id(1), Stop).unwrap();
    let off = |master: &mut Master<2>| master.broadcast(Shutdown, MotorSet::EMPTY);
    let restart = |master: &mut Master<2>| master.broadcast(Reset, MotorSet::EMPTY);
    for (hold, end) in [
        (&hold_by_stop as &dyn Fn(&mut Master<2>), &off as &dyn Fn(&mut Master<2>) -> _),
        (&hold_by_request, &off),
        (&hold_by_request, &restart),
    ] {
        for answers in [0, 1] {
            let mut master = Master::<2>::new(Config::CAN);
            // A set-point is lost, so that an answer to the hold leaves it in doubt.
            master.set_point(id(1), torque(1.0), ms(0)).unwrap();
            sent(&mut master, ms(0));
            events(&mut master, ms(21));
            hold(&mut master);
            assert_eq!(sent(&mut master, ms(22))[0].data, Stop.encode());
            for _ in 0..answers {
                assert_eq!(reply(&mut master, 1, Stop.encode(), ms(23)), None);
            }
            end(&mut master).unwrap();
            // It does not wait for the end of that doubt.
            let mut packets = sent(&mut master, ms(24));
            reply(&mut master, 1, Shutdown.encode(), ms(25));
            packets.extend(sent(&mut master, ms(25)));
            let is_to_all = |packet: &Packet| packet.channel == Channel::Command(Target::All);
            assert!(packets.iter().any(is_to_all), "{packets:?}");
            for at in 26..400 {
                for packet in sent(&mut master, ms(at)) {
                    if packet.channel == Channel::Command(id(1).into()) {
                        reply(&mut master, 1, packet.data, ms(at + 1));
                    }
                    packets.push(packet);
                }
            }
            let is_hold = |packet: &Packet| packet.data == Stop.encode();
            assert!(!packets.iter().any(is_hold), "{answers}: {packets:?}");
        }
    }
}

#[test]
fn hold_to_all_waits_for_an_older_shutdown_of_one_motor() {
    let mut master = Master::<2>::new(Config::CAN);
    let off = master.request(id(1), Shutdown).unwrap();
    master.broadcast(Stop, MotorSet::EMPTY).unwrap();
    let of_one = packet_to(1, Shutdown.encode());
    assert_eq!(sent(&mut master, ms(0)), [of_one]);
    let reported = reply(&mut master, 1, Shutdown.encode(), ms(1)).unwrap();
    assert!(off.outcome(&reported).is_some());
    assert_eq!(sent(&mut master, ms(1)), [packet_to_all(Stop.encode())]);
}

/// When something is first sent on a line after these two: what `before` asks is sent at 0 ms and not answered.
fn sent_on_line(before: impl Fn(&mut Master<2>), then: impl Fn(&mut Master<2>)) -> Instant {
    // What a drive answers without being waited for has 5 ms.
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    before(&mut master);
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    then(&mut master);
    let mut times = (1..20).map(ms);
    times.find(|&at| !sent(&mut master, at).is_empty()).expect("it is sent")
}

#[test]
fn on_rs485_nothing_is_sent_while_a_broadcast_may_be_answered() {
    let read = |master: &mut Master<2>| _ = master.request(id(1), ReadMultiTurnAngle).unwrap();
    let unheard = |master: &mut Master<2>| master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    // And 0.1 ms for the drives to turn around.
    assert_eq!(sent_on_line(unheard, read), ms(6));
    let move_all = |master: &mut Master<2>| master.broadcast(step(), id(1).into()).unwrap();
    let stop = |master: &mut Master<2>| master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(sent_on_line(move_all, stop), ms(5));
    let stop_all = |master: &mut Master<2>| master.stop_all(StopKind::Off, id(1).into()).unwrap();
    assert_eq!(sent_on_line(move_all, stop_all), ms(5));
    let off = |master: &mut Master<2>| _ = master.request(id(1), Shutdown).unwrap();
    assert_eq!(sent_on_line(move_all, off), ms(5));
}

#[test]
fn on_rs485_shutdown_to_all_waits_for_the_answer_to_the_hold_before() {
    let hold = |master: &mut Master<2>| master.stop(id(1), StopKind::Hold).unwrap();
    let off_all = |master: &mut Master<2>| master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    assert_eq!(sent_on_line(hold, off_all), ms(5));
}

/// The move to all was in the controller for 59 ms, and the set-point may still be there.
#[test]
fn answer_to_a_move_to_all_is_not_the_feedback_of_an_equal_set_point() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    events(&mut master, ms(0));
    // The bus is whole: motor 2 answers.
    let _ = ask(&mut master, 2, ReadMultiTurnAngle, ms(20));
    reply(&mut master, 2, ANGLE_REPLY, ms(21)).unwrap();
    events(&mut master, ms(21));
    master.set_point(id(1), torque(1.0), ms(59)).unwrap();
    assert_eq!(sent(&mut master, ms(59)).len(), 1);
    // That to all has lain in the controller for 59 ms; now its answer comes.
    reply(&mut master, 1, TORQUE_REPLY, ms(60));
    events(&mut master, ms(60));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(62))), [to(1)]);
    assert_eq!(
        reply(&mut master, 1, Shutdown.encode(), ms(63)),
        None,
        "the set-point of 59 ms may come"
    );
}

/// A stop has taken the place of the set-point, which may still be in the controller.
#[test]
fn answer_to_a_move_to_all_is_not_late_feedback_of_an_equal_set_point() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    events(&mut master, ms(0));
    // The bus is whole: motor 2 answers.
    let _ = ask(&mut master, 2, ReadMultiTurnAngle, ms(20));
    reply(&mut master, 2, ANGLE_REPLY, ms(21)).unwrap();
    events(&mut master, ms(21));
    master.set_point(id(1), torque(1.0), ms(45)).unwrap();
    assert_eq!(sent(&mut master, ms(45)).len(), 1);
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(46))), [to(1)]);
    reply(&mut master, 1, TORQUE_REPLY, ms(47));
    events(&mut master, ms(64));
    assert_eq!(
        reply(&mut master, 1, Shutdown.encode(), ms(64)),
        None,
        "the set-point of 45 ms may come"
    );
}

#[test]
fn duplicate_feedback_does_not_answer_a_move_to_all() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    events(&mut master, ms(0));
    master.set_point(id(1), torque(1.0), ms(1)).unwrap();
    assert_eq!(sent(&mut master, ms(1)).len(), 1);
    reply(&mut master, 1, TORQUE_REPLY, ms(2));
    reply(&mut master, 1, TORQUE_REPLY, ms(2) + Duration::from_micros(140));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(3))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(4)), None, "the move to all may come");
}

#[test]
fn duplicate_late_feedback_is_not_that_of_the_second_set_point() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    events(&mut master, ms(21));
    master.set_point(id(1), torque(2.0), ms(21)).unwrap();
    assert_eq!(sent(&mut master, ms(21)).len(), 1);
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(22))), [to(1)]);
    // The answer to the first set-point, twice. The second set-point is in a mailbox.
    assert!(reply(&mut master, 1, TORQUE_REPLY, ms(23)).is_some());
    reply(&mut master, 1, TORQUE_REPLY, ms(23) + Duration::from_micros(140));
    assert_eq!(
        reply(&mut master, 1, Shutdown.encode(), ms(24)),
        None,
        "the second set-point may come"
    );
}

#[test]
fn stop_first_answered_before_a_cut_is_not_confirmed_right_after_it() {
    let mut master = Master::<2>::new(Config::CAN);
    // Motion mode has the least urgent ids: it is in a mailbox, and the stop overtakes it.
    master.set_point(id(1), motion(), ms(0)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(1))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(2)), None);
    // The bus is cut from here to 190 ms: nothing is heard, and nothing leaves the mailboxes.
    let mut stops = 0;
    for now in 3..190 {
        stops += sent(&mut master, ms(now)).len();
        assert_eq!(events(&mut master, ms(now)), []);
    }
    assert!(stops > 1);
    // Now a stop goes, before the set-point, and is answered.
    assert_eq!(
        reply(&mut master, 1, Shutdown.encode(), ms(191)),
        None,
        "the set-point comes behind it"
    );
}

#[test]
fn set_point_may_follow_a_cut_though_another_motor_was_heard_before_it() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    let _ = ask(&mut master, 2, ReadMultiTurnAngle, ms(20));
    reply(&mut master, 2, ANGLE_REPLY, ms(21)).unwrap();
    for now in 21..100 {
        events(&mut master, ms(now));
    }
    master.stop(id(1), StopKind::Off).unwrap();
    for now in 100..190 {
        sent(&mut master, ms(now));
        assert_eq!(events(&mut master, ms(now)), []);
    }
    assert_eq!(
        reply(&mut master, 1, Shutdown.encode(), ms(191)),
        None,
        "the set-point comes behind it"
    );
}

#[test]
fn move_to_all_may_follow_a_cut_though_another_motor_was_heard_before_it() {
    for named in [MotorSet::EMPTY, id(1).into()] {
        let mut master = Master::<2>::new(Config::CAN);
        let go = AbsolutePosition { max_speed: MaxSpeed::from_raw(1), angle: Angle::from_raw(0) };
        let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
        reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
        master.broadcast(go, named).unwrap();
        assert_eq!(sent(&mut master, ms(2)).len(), 1);
        for now in 2..24 {
            events(&mut master, ms(now));
        }
        let _ = ask(&mut master, 2, ReadMultiTurnAngle, ms(24));
        reply(&mut master, 2, ANGLE_REPLY, ms(25)).unwrap();
        for now in 25..100 {
            events(&mut master, ms(now));
        }
        master.stop(id(1), StopKind::Off).unwrap();
        for now in 100..190 {
            sent(&mut master, ms(now));
            assert_eq!(events(&mut master, ms(now)), []);
        }
        assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(191)), None, "{named:?}");
    }
}

/// The motor answers its first request 300 us after a frame that answered nothing.
#[test]
fn first_answer_of_a_motor_is_not_taken_for_a_duplicate() {
    let mut master = Master::<2>::new(Config::CAN);
    let at = |micros| Instant::from_micros(micros);
    let asked = master.request(id(1), ReadMultiTurnAngle).unwrap();
    assert_eq!(sent(&mut master, at(1_000)).len(), 1);
    let other = reply(&mut master, 1, TORQUE_REPLY, at(1_100));
    assert!(matches!(other, Some(Event::Stray { .. })), "{other:?}");
    let answer = reply(&mut master, 1, ANGLE_REPLY, at(1_400)).unwrap();
    assert!(asked.outcome(&answer).is_some());
}
