//! What callers and controllers seldom do: calls while something is on its way, frames handed back late, a bus that was
//! cut, a caller's own time-outs.

use super::*;
use crate::command::{ReadStatus2, ReleaseBrake};

fn patient(attempts: u8, millis: u64) -> Patience {
    Patience { attempts, reply_timeout: Duration::from_millis(millis) }
}

fn is_restart_reported(reported: &[Event]) -> bool {
    reported.contains(&Event::Restarted { motor: id(1) })
}

#[test]
fn handed_back_earlier_broadcast_is_not_taken_for_the_one_in_flight() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(ReadMultiTurnAngle, MotorSet::EMPTY).unwrap();
    let earlier = sent(&mut master, ms(0))[0];
    events(&mut master, ms(0));
    master.broadcast(step(), MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(1)), [packet_to_all(step().encode())]);
    master.handle_pushed_out(&earlier);
    assert_eq!(sent(&mut master, ms(2)), [], "the move would be made twice");
}

#[test]
fn poll_at_follows_a_time_out_that_became_shorter() {
    let config = Config { reply_timeout: Duration::from_millis(5), ..Config::CAN };
    let mut master = Master::<2>::new(config.adapting_up_to(Duration::from_millis(40)));
    for motor in [1, 2] {
        master.set_point(id(motor), torque(1.0), ms(0)).unwrap();
    }
    sent(&mut master, ms(0));
    master.handle_timeout(ms(0));
    reply(&mut master, 1, TORQUE_REPLY, ms(1)).unwrap();
    let mut reported = Vec::new();
    let mut now = ms(1);
    for _ in 0..20 {
        reported.extend(events(&mut master, now));
        let Some(at) = master.poll_at() else { break };
        assert!(at > now, "{at:?} is past at {now:?}, and nothing is done");
        now = at;
    }
    assert_eq!(reported, [Event::SetPointUnanswered { motor: id(2) }]);
}

#[test]
fn move_ended_by_a_shutdown_to_all_can_be_requested_again() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = master.request_with(id(1), step(), patient(3, 20)).unwrap();
    sent(&mut master, ms(0));
    // It waits to be sent again when a shutdown to all is requested.
    master.handle_timeout(ms(20));
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(20));
    events(&mut master, ms(20));
    let _ = master.request(id(1), step()).unwrap();
    let at = master.poll_at().unwrap();
    assert_eq!(sent(&mut master, at).len(), 1, "{at:?}");
}

#[test]
fn move_in_flight_is_not_resent_once_a_restart_is_seen() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    let moving = master.request_with(id(1), torque(1.0), patient(3, 600)).unwrap();
    assert_eq!(sent(&mut master, ms(1)).len(), 1);
    assert_eq!(sent(&mut master, ms(601)).len(), 1);
    assert_eq!(sent(&mut master, ms(1_201)), []);
    let reported = events(&mut master, ms(1_201));
    assert!(is_restart_reported(&reported), "{reported:?}");
    assert!(reported.iter().any(|event| moving.outcome(event).is_some()), "{reported:?}");
}

#[test]
fn move_handed_back_after_a_restart_was_seen_is_not_sent_again() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(10));
    sent(&mut master, ms(31));
    sent(&mut master, ms(52));
    events(&mut master, ms(73));
    let moving = master.request_with(id(1), step(), patient(1, 2_000)).unwrap();
    let in_mailbox = sent(&mut master, ms(900))[0];
    // Something else of it is heard after a second.
    reply(&mut master, 1, [0x9A, 50, 30, 1, 0xE5, 0x01, 0, 0], ms(1_100)).unwrap();
    master.handle_pushed_out(&in_mailbox);
    assert_eq!(sent(&mut master, ms(1_100)), []);
    let reported = events(&mut master, ms(1_100));
    assert!(is_restart_reported(&reported), "{reported:?}");
    assert!(reported.iter().any(|event| moving.outcome(event) == Some(Err(Failure::Dropped))));
}

#[test]
fn move_to_all_is_refused_while_a_motor_has_restarted() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    // A question that is not answered, and an answer after a second.
    let _ = master.request_with(id(1), ReadModel, patient(1, 20)).unwrap();
    sent(&mut master, ms(2));
    events(&mut master, ms(22));
    // One that waits for that.
    let _ = master.request_with(id(2), ReadModel, patient(1, 2_000)).unwrap();
    sent(&mut master, ms(100));
    master.broadcast(step(), MotorSet::EMPTY).unwrap();
    reply(&mut master, 1, [0x9A, 50, 30, 1, 0xE5, 0x01, 0, 0], ms(1_100)).unwrap();
    reply(&mut master, 2, [0xB5, b'X', 0, 0, 0, 0, 0, 0], ms(1_101)).unwrap();
    assert_eq!(sent(&mut master, ms(1_101)), []);
    let reported = events(&mut master, ms(1_101));
    assert!(is_restart_reported(&reported), "{reported:?}");
    assert!(
        reported.contains(&Event::BroadcastDone { silent: MotorSet::EMPTY, was_sent: false }),
        "{reported:?}"
    );
    assert_eq!(master.broadcast(step(), MotorSet::EMPTY), Err(RequestError::Restarted));
    master.broadcast(ReadMultiTurnAngle, MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(1_300));
    events(&mut master, ms(1_400));
    master.resume(id(1));
    master.broadcast(step(), MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(1_500)).len(), 1);
}

#[test]
fn on_rs485_patient_request_delays_a_stop_by_50_ms_at_most() {
    let mut master = Master::<4>::new(Config::rs485(115_200, false));
    let waiting = master.request_with(id(1), ReadMultiTurnAngle, patient(1, 10_000)).unwrap();
    sent(&mut master, ms(0));
    master.stop(id(2), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(1)), [], "the line is in use");
    let at = master.poll_at().unwrap();
    assert!(at <= ms(50), "{at:?}");
    assert_eq!(sent(&mut master, at)[0].data, Shutdown.encode());
    // Nothing else goes during the other exchange, which may still be answered.
    let _ = master.request(id(3), ReadMultiTurnAngle).unwrap();
    let confirm = Frame { address: Target::Motor(id(2)), data: Shutdown.encode() };
    let reported = master.handle_line(&confirm, at + Duration::from_millis(2));
    assert_eq!(reported, Some(Event::StopConfirmed { motor: id(2) }));
    assert_eq!(sent(&mut master, ms(100)), []);
    let answer = Frame { address: Target::Motor(id(1)), data: ANGLE_REPLY };
    let reported = master.handle_line(&answer, ms(101)).unwrap();
    assert!(waiting.outcome(&reported).is_some());
}

#[test]
fn shutdown_is_answered_during_a_stream_without_feedback() {
    let mut master = Master::<2>::new(Config::CAN);
    let mut ticket = None;
    for now in 0..1_000 {
        if now % 10 == 0 {
            master.set_point(id(1), motion(), ms(now)).unwrap();
        }
        if now == 100 {
            ticket = Some(master.request(id(1), Shutdown).unwrap());
        }
        let is_asked = sent(&mut master, ms(now)).iter().any(|it| it.data == Shutdown.encode());
        if let (Some(ticket), true) = (ticket, is_asked) {
            let later = ms(now) + Duration::from_micros(800);
            let reported = reply(&mut master, 1, Shutdown.encode(), later);
            if reported.is_some_and(|event| ticket.outcome(&event).is_some()) {
                return;
            }
        }
        events(&mut master, ms(now));
    }
    panic!("no answer");
}

#[test]
fn stop_is_unconfirmed_while_each_feedback_may_be_that_of_one_before() {
    let mut master = Master::<2>::new(Config::CAN);
    // The first waits in its mailbox until it counts as lost.
    master.set_point(id(1), motion(), ms(0)).unwrap();
    sent(&mut master, ms(0));
    assert_eq!(events(&mut master, ms(21)), [Event::SetPointUnanswered { motor: id(1) }]);
    // From then on each feedback is that to the one before.
    for now in (21..121).step_by(5) {
        master.set_point(id(1), motion(), ms(now)).unwrap();
        assert_eq!(sent(&mut master, ms(now)).len(), 1, "{now}");
        motion_feedback(&mut master, ms(now + 2)).unwrap();
    }
    // It overtakes the last one.
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(121));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(122)), None);
    motion_feedback(&mut master, ms(123)).unwrap();
    assert_eq!(sent(&mut master, ms(123)).len(), 1);
    let confirmed = Some(Event::StopConfirmed { motor: id(1) });
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(124)), confirmed);
}

#[test]
fn set_point_kept_by_a_cut_bus_follows_no_confirmed_stop() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    sent(&mut master, ms(0));
    motion_feedback(&mut master, ms(1)).unwrap();
    // Here the bus is cut.
    master.set_point(id(1), motion(), ms(10)).unwrap();
    sent(&mut master, ms(10));
    events(&mut master, ms(31));
    events(&mut master, ms(200));
    assert_eq!(master.poll_at(), None);
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(500)).len(), 1);
    // And here it is whole again: the stop goes first, then the set-point.
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(510)), None);
    motion_feedback(&mut master, ms(511)).unwrap();
    let at = master.poll_at().unwrap();
    assert!(at < ms(600), "{at:?}");
    assert_eq!(sent(&mut master, at).len(), 1);
    let confirmed = Some(Event::StopConfirmed { motor: id(1) });
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), at + Duration::from_millis(1)), confirmed);
}

#[test]
fn patient_request_to_a_silent_motor_delays_no_other_on_a_busy_bus() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = master.request_with(id(1), ReadMultiTurnAngle, patient(1, 10_000)).unwrap();
    sent(&mut master, ms(0));
    let foreign = Packet { channel: Channel::Command(id(9).into()), data: [0x92; 8] };
    let mut served = 0;
    for micros in (0..200_000).step_by(200) {
        let now = Instant::from_micros(micros);
        master.handle_frame(&Received::Packet(foreign), now);
        if micros % 5_000 == 0 {
            master.set_point(id(2), torque(1.0), now).unwrap();
        }
        for _ in sent(&mut master, now) {
            served += 1;
            reply(&mut master, 2, TORQUE_REPLY, now + Duration::from_micros(300));
        }
    }
    assert!(served > 30, "{served}");
}

#[test]
fn raw_move_without_a_reply_follows_no_shutdown_and_no_confirmed_stop() {
    let raw = RawCommand::new([0x55; 8], ReplyRule::Silent, true);
    // Handed back after a shutdown to all was requested.
    let mut master = Master::<2>::new(Config::CAN);
    let _ = master.request(id(1), raw).unwrap();
    let in_mailbox = sent(&mut master, ms(0))[0];
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(0));
    master.handle_pushed_out(&in_mailbox);
    assert_eq!(sent(&mut master, ms(50)), []);
    // Overtaken by a stop.
    let mut master = Master::<2>::new(Config::CAN);
    let _ = master.request(id(1), raw).unwrap();
    sent(&mut master, ms(0));
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(0));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(1)), None);
    // Its pause, and the time for which it may yet be on its way.
    let settled = master.poll_at().unwrap();
    assert_eq!(sent(&mut master, settled), []);
    let at = master.poll_at().unwrap();
    assert_eq!(sent(&mut master, at).len(), 1);
    let confirmed = Some(Event::StopConfirmed { motor: id(1) });
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), at + Duration::from_millis(1)), confirmed);
}

#[test]
fn handed_back_read_to_all_does_not_show_that_an_earlier_move_arrived() {
    let mut master = Master::<2>::new(Config::CAN);
    // It is not answered, so the next one need not wait for answers.
    let raw = RawCommand::new([0x55; 8], ReplyRule::Silent, true);
    master.broadcast(raw, MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(0));
    events(&mut master, ms(0));
    master.broadcast(ReadStatus2, MotorSet::EMPTY).unwrap();
    let second = sent(&mut master, ms(0))[0];
    events(&mut master, ms(0));
    master.handle_pushed_out(&second);
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(1));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(2)), None);
}

#[test]
fn each_of_two_lost_answers_may_come_late() {
    let mut master = Master::<2>::new(Config::CAN);
    for now in [0, 25] {
        master.set_point(id(1), torque(1.0), ms(now)).unwrap();
        sent(&mut master, ms(now));
        events(&mut master, ms(now + 21));
    }
    let _ = master.request(id(1), torque(1.0)).unwrap();
    reply(&mut master, 1, TORQUE_REPLY, ms(47)).unwrap();
    assert_eq!(sent(&mut master, ms(47)), [], "the other may come yet");
    reply(&mut master, 1, TORQUE_REPLY, ms(49)).unwrap();
    assert_eq!(sent(&mut master, ms(49)).len(), 1);
}

#[test]
fn duplicate_feedback_is_not_taken_for_late_feedback() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    sent(&mut master, ms(0));
    events(&mut master, ms(21));
    master.set_point(id(1), torque(1.0), ms(22)).unwrap();
    sent(&mut master, ms(22));
    reply(&mut master, 1, TORQUE_REPLY, ms(23)).unwrap();
    reply(&mut master, 1, TORQUE_REPLY, ms(23) + Duration::from_micros(300)).unwrap();
    let _ = master.request(id(1), torque(1.0)).unwrap();
    assert_eq!(sent(&mut master, ms(24)), []);
}

#[test]
fn read_replaced_by_a_stop_may_be_answered_for_61_ms() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(0));
    reply(&mut master, 1, Shutdown.encode(), ms(1)).unwrap();
    events(&mut master, ms(1));
    let _ = master.request(id(1), ReadMultiTurnAngle).unwrap();
    assert_eq!(sent(&mut master, ms(50)), []);
    assert_eq!(sent(&mut master, ms(62)).len(), 1);
}

#[test]
fn read_handed_back_and_sent_again_has_one_answer() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = master.request(id(1), ReadMultiTurnAngle).unwrap();
    let pushed_out = sent(&mut master, ms(0))[0];
    master.handle_pushed_out(&pushed_out);
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(2));
    assert!(master.is_anything_in_flight(), "nothing can come late");
}

#[test]
fn answer_after_two_attempts_measures_no_round_trip() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    assert_eq!(sent(&mut master, ms(21)).len(), 1);
    reply(&mut master, 1, ANGLE_REPLY, ms(22)).unwrap();
    assert_eq!(master.health(id(1)).round_trip, Duration::ZERO);
}

#[test]
fn on_rs485_answer_in_the_clock_step_of_its_command_counts() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    let answer = Frame { address: Target::Motor(id(1)), data: ANGLE_REPLY };
    let ticket = ask(&mut master, 1, ReadMultiTurnAngle, ms(1));
    assert!(ticket.outcome(&master.handle_line(&answer, ms(1)).unwrap()).is_some());
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(2)).len(), 1);
    let reported = master.handle_line(&answer, ms(2));
    assert!(matches!(reported, Some(Event::BroadcastReply { .. })), "{reported:?}");
}

#[test]
fn read_offered_before_a_stop_is_not_taken_for_the_stop() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = master.request(id(1), ReadMultiTurnAngle).unwrap();
    master.poll_transmit(ms(0)).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    master.handle_transmitted(ms(0));
    assert_eq!(sent(&mut master, ms(0))[0].data, Shutdown.encode());
}

#[test]
fn stop_after_a_lifted_one_drops_the_set_point_put_between() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(0));
    master.lift_stop();
    master.set_point(id(1), motion(), ms(0)).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    for now in [1, 2] {
        reply(&mut master, 1, Shutdown.encode(), ms(now));
        let packets = sent(&mut master, ms(now));
        assert!(packets.iter().all(|it| it.data == Shutdown.encode()), "{packets:?}");
    }
}

#[test]
fn motor_that_answered_one_broadcast_may_answer_the_next_late() {
    let mut master = Master::<2>::new(Config::CAN);
    for now in [0, 10] {
        master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
        assert_eq!(sent(&mut master, ms(now)).len(), 1);
        if now == 0 {
            reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
        }
        events(&mut master, ms(now + 21));
    }
    let _ = master.request(id(1), ReadMultiTurnAngle).unwrap();
    assert_eq!(sent(&mut master, ms(32)), []);
}

#[test]
fn seen_restart_is_reported_once_and_ends_active_reports() {
    let mut master = Master::<2>::new(Config::CAN);
    let run_time = |millis: u32| {
        let [a, b, c, d] = millis.to_le_bytes();
        [0xB1, 0, 0, 0, a, b, c, d]
    };
    let _ = ask(&mut master, 1, report_angle(Switch::On), ms(0));
    events(&mut master, ms(0));
    let _ = ask(&mut master, 1, ReadRunTime, ms(10));
    reply(&mut master, 1, run_time(60_000), ms(11)).unwrap();
    // Not answered, and then heard after a second.
    let _ = master.request_with(id(1), ReadModel, patient(1, 20)).unwrap();
    sent(&mut master, ms(20));
    events(&mut master, ms(40));
    let _ = ask(&mut master, 1, ReadModel, ms(1_200));
    reply(&mut master, 1, [0xB5, b'X', 0, 0, 0, 0, 0, 0], ms(1_201)).unwrap();
    assert!(is_restart_reported(&events(&mut master, ms(1_201))));
    let _ = ask(&mut master, 1, ReadRunTime, ms(1_210));
    reply(&mut master, 1, run_time(500), ms(1_211)).unwrap();
    assert_eq!(events(&mut master, ms(1_211)), []);
    assert!(master.request(id(1), ReadMultiTurnAngle).is_ok(), "it reports no more");
}

#[test]
fn on_rs485_stop_waits_for_the_answer_to_the_read_it_replaces() {
    let micros = Instant::from_micros;
    let stops: [fn(&mut Master<4>); 2] = [
        |master| master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap(),
        |master| master.stop(id(1), StopKind::Off).unwrap(),
    ];
    for stop in stops {
        for is_answered in [true, false] {
            let mut master = Master::<4>::new(Config::rs485(115_200, false));
            let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
            stop(&mut master);
            assert_eq!(sent(&mut master, micros(500)), [], "the drive is answering");
            if is_answered {
                let answer = Frame { address: Target::Motor(id(1)), data: ANGLE_REPLY };
                master.handle_line(&answer, micros(1_900));
            }
            let at = master.poll_at().unwrap();
            assert_eq!(at, if is_answered { ms(2) } else { ms(5) });
            assert_eq!(sent(&mut master, at)[0].data, Shutdown.encode());
        }
    }
}

#[test]
fn stop_is_unconfirmed_while_a_brake_release_may_still_arrive() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReleaseBrake, ms(0));
    // It is in a mailbox, and the stop overtakes it.
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(1));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(2)), None, "a load may fall yet");
    reply(&mut master, 1, ReleaseBrake.encode(), ms(3)).unwrap();
    assert_eq!(sent(&mut master, ms(3)).len(), 1);
    let confirmed = Some(Event::StopConfirmed { motor: id(1) });
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(4)), confirmed);
    // Those of all.
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(ReleaseBrake, MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(0));
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(1));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(2)), None);
    // Handed back after a shutdown to all was requested.
    let mut master = Master::<2>::new(Config::CAN);
    let released = master.request(id(1), ReleaseBrake).unwrap();
    let in_mailbox = sent(&mut master, ms(0))[0];
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    master.handle_pushed_out(&in_mailbox);
    assert_eq!(sent(&mut master, ms(50)), [packet_to_all(Shutdown.encode())]);
    let reported = events(&mut master, ms(50));
    assert!(reported.iter().any(|event| released.outcome(event) == Some(Err(Failure::Stopped))));
}

#[test]
fn reset_sent_before_a_stop_is_reported_as_a_restart() {
    let mut master = Master::<2>::new(Config::CAN);
    let reset = ask(&mut master, 1, Reset, ms(0));
    master.stop(id(1), StopKind::Off).unwrap();
    let reported = events(&mut master, ms(1));
    assert_eq!(reset.outcome(&reported[0]), Some(Err(Failure::Stopped)));
    assert!(is_restart_reported(&reported), "{reported:?}");
    master.lift_stop();
    let refused = master.set_point(id(1), torque(1.0), ms(2));
    assert_eq!(refused, Err(RequestError::Restarted), "nobody knows where it is");
    // One that was still waiting has restarted nothing.
    let _waits = master.request(id(2), Reset).unwrap();
    master.stop(id(2), StopKind::Off).unwrap();
    assert_eq!(events(&mut master, ms(3)).len(), 1);
}

#[test]
fn motor_that_a_lost_set_point_may_move_is_not_forgotten() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    // It waits in a mailbox until it counts as lost.
    sent(&mut master, ms(0));
    assert_eq!(events(&mut master, ms(21)), [Event::SetPointUnanswered { motor: id(1) }]);
    assert!(!master.forget(id(1)));
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(22));
    assert_eq!(
        reply(&mut master, 1, Shutdown.encode(), ms(23)),
        None,
        "it may come behind the stop"
    );
    // Of a question that was given up nothing of the kind is to be feared.
    let _ = master.request_with(id(2), ReadMultiTurnAngle, patient(1, 20)).unwrap();
    sent(&mut master, ms(23));
    events(&mut master, ms(50));
    assert!(master.forget(id(2)));
}

#[test]
fn move_to_all_kept_by_a_cut_bus_follows_no_confirmed_stop() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    // Here the bus is cut.
    master.broadcast(step(), MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(10));
    events(&mut master, ms(31));
    events(&mut master, ms(200));
    assert_eq!(master.poll_at(), None);
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(500)).len(), 1);
    // And here it is whole again: the stop goes first, then the move.
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(510)), None);
    let at = master.poll_at().unwrap();
    assert!(at > ms(510) && at < ms(600), "{at:?}");
    assert_eq!(sent(&mut master, at).len(), 1);
    let confirmed = Some(Event::StopConfirmed { motor: id(1) });
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), at + Duration::from_millis(1)), confirmed);
}

#[test]
fn feedback_of_one_kept_set_point_does_not_show_the_other_arrived() {
    let mut master = Master::<2>::new(Config::CAN);
    for now in [0, 200] {
        master.set_point(id(1), motion(), ms(now)).unwrap();
        assert_eq!(sent(&mut master, ms(now)).len(), 1);
        assert_eq!(events(&mut master, ms(now + 21)), [Event::SetPointUnanswered { motor: id(1) }]);
        events(&mut master, ms(now + 30));
        events(&mut master, ms(if now == 0 { 100 } else { 240 }));
    }
    // The bus is whole again, the first one goes, and the stop overtakes the second.
    motion_feedback(&mut master, ms(250)).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(250));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(251)), None);
    motion_feedback(&mut master, ms(252)).unwrap();
    let at = master.poll_at().unwrap();
    assert!(at < ms(320), "{at:?}");
    assert_eq!(sent(&mut master, at).len(), 1);
    let confirmed = Some(Event::StopConfirmed { motor: id(1) });
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), at + Duration::from_millis(1)), confirmed);
}

#[test]
fn attempt_handed_back_after_its_time_out_was_neither_sent_nor_lost() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = master.request_with(id(1), ReadMultiTurnAngle, patient(2, 20)).unwrap();
    let in_mailbox = sent(&mut master, ms(0))[0];
    master.handle_timeout(ms(21));
    assert_eq!(master.health(id(1)).lost, 1);
    master.handle_pushed_out(&in_mailbox);
    assert_eq!(master.health(id(1)).lost, 0);
    for now in [21, 42] {
        assert_eq!(sent(&mut master, ms(now)).len(), 1, "both attempts are left");
    }
    events(&mut master, ms(63));
    assert_eq!(master.health(id(1)).lost, 2);
}

#[test]
fn command_handed_back_after_it_was_given_up_was_not_lost() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    let in_mailbox = sent(&mut master, ms(0))[0];
    assert_eq!(events(&mut master, ms(21)), [Event::SetPointUnanswered { motor: id(1) }]);
    assert_eq!(master.health(id(1)).lost, 1);
    master.handle_pushed_out(&in_mailbox);
    assert_eq!(master.health(id(1)).lost, 0);
    // Of two attempts one was sent.
    let _ = master.request_with(id(1), ReadMultiTurnAngle, patient(2, 20)).unwrap();
    let in_mailbox = sent(&mut master, ms(22))[0];
    assert_eq!(sent(&mut master, ms(43)).len(), 1);
    assert_eq!(events(&mut master, ms(64)).len(), 1);
    assert_eq!(master.health(id(1)).lost, 2);
    master.handle_pushed_out(&in_mailbox);
    assert_eq!(master.health(id(1)).lost, 1);
}

#[test]
fn command_replaced_by_a_stop_and_handed_back_changes_no_loss_count() {
    for is_stream in [true, false] {
        let mut master = Master::<2>::new(Config::CAN);
        let once = master.request_with(id(1), ReadStatus2, patient(1, 5)).unwrap();
        sent(&mut master, ms(0));
        let failed = Event::Failed { ticket: once.id(), failure: Failure::NoReply };
        assert_eq!(events(&mut master, ms(5)), [failed]);
        if is_stream {
            master.set_point(id(1), motion(), ms(6)).unwrap();
        } else {
            let _ = master.request(id(1), ReadMultiTurnAngle).unwrap();
        }
        let in_mailbox = sent(&mut master, ms(6))[0];
        master.stop(id(1), StopKind::Off).unwrap();
        sent(&mut master, ms(6));
        master.handle_pushed_out(&in_mailbox);
        assert_eq!(master.health(id(1)).lost, 1, "of a stream: {is_stream}");
    }
}

#[test]
fn set_point_handed_back_after_late_feedback_was_not_answered() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    sent(&mut master, ms(0));
    assert_eq!(events(&mut master, ms(21)), [Event::SetPointUnanswered { motor: id(1) }]);
    master.set_point(id(1), motion(), ms(22)).unwrap();
    let in_mailbox = sent(&mut master, ms(22))[0];
    motion_feedback(&mut master, ms(23)).unwrap();
    master.handle_pushed_out(&in_mailbox);
    let health = master.health(id(1));
    assert_eq!((health.answered, health.lost), (0, 1), "of one command");
}

#[test]
fn second_attempt_handed_back_after_the_answer_was_not_answered() {
    let mut master = Master::<2>::new(Config::CAN);
    let read = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    let in_mailbox = sent(&mut master, ms(21))[0];
    let reported = reply(&mut master, 1, ANGLE_REPLY, ms(22)).unwrap();
    assert!(read.outcome(&reported).is_some());
    master.handle_pushed_out(&in_mailbox);
    let health = master.health(id(1));
    assert_eq!((health.answered, health.lost), (0, 1), "of one command");
}

#[test]
fn repeated_shutdown_does_not_wait_for_new_moves_to_all() {
    let mut master = Master::<2>::new(Config::CAN);
    let move_all = |master: &mut Master<2>| master.broadcast(torque(1.0), MotorSet::EMPTY);
    move_all(&mut master).unwrap();
    sent(&mut master, ms(0));
    let ticket = master.request(id(1), Shutdown).unwrap();
    let mut moves = 0;
    let mut is_over = |now: u64| {
        let master = &mut master;
        events(master, ms(now));
        // Others move all as often as they may, and this motor does not answer that.
        let _ = move_all(master);
        let packets = sent(master, ms(now));
        moves += packets.iter().filter(|it| it.data == torque(1.0).encode()).count();
        let is_asked = packets.iter().any(|it| it.data == Shutdown.encode());
        let reported = is_asked.then(|| reply(master, 1, Shutdown.encode(), ms(now + 1))).flatten();
        reported.is_some_and(|reported| ticket.outcome(&reported) == Some(Ok(Shutdown)))
    };
    // The first one may move it until 61.2 ms.
    let over = (1..100).find(|&now| is_over(now));
    assert!(over.is_some_and(|over| over >= 62), "{over:?}");
    assert_eq!(moves, 0, "they wait, too");
    assert!(sent(&mut master, ms(101)).iter().any(|it| it.data == torque(1.0).encode()));
}

#[test]
fn frames_that_fill_the_line_delay_no_stop() {
    let mut master = Master::<2>::new(Config::rs485(115_200, false));
    let of_another = Frame { address: Target::Motor(id(2)), data: ANGLE_REPLY };
    // With an adapter that delivers every millisecond, and frames all the time, as from two motors of one id that
    // answer each other.
    let looks_at = |master: &mut Master<2>, at| {
        master.handle_line(&of_another, at);
        !sent(master, at).is_empty()
    };
    assert!(!looks_at(&mut master, ms(0)));
    master.stop(id(1), StopKind::Hold).unwrap();
    let sent_at = (1..100).find(|&at| looks_at(&mut master, ms(at)));
    assert_eq!(sent_at, Some(1));
}

/// A command is sent even if the free line between two frames is not seen: because they follow one another closely, or
/// because the clock's steps are longer than the drives take to turn around.
#[test]
fn frames_that_fill_the_line_delay_no_command() {
    let of_another = Frame { address: Target::Motor(id(2)), data: ANGLE_REPLY };
    let puts: [fn(&mut Master<2>); 3] = [
        |master| _ = master.request(id(1), ReadModel).unwrap(),
        |master| master.set_point(id(1), torque(1.0), ms(0)).unwrap(),
        |master| master.broadcast(ReadModel, id(1).into()).unwrap(),
    ];
    for (every, within) in [(1_000, 1_000), (50, 100)] {
        for put in puts {
            let mut master = Master::<2>::new(Config::rs485(115_200, false));
            master.handle_line(&of_another, ms(0));
            put(&mut master);
            let times = (1..1_000).map(|count| ms(0) + Duration::from_micros(every * count));
            let sent_at = times.into_iter().find(|&at| {
                master.handle_line(&of_another, at);
                !sent(&mut master, at).is_empty()
            });
            assert_eq!(sent_at, Some(ms(0) + Duration::from_micros(within)), "{every}");
        }
    }
}

/// A motor that has answered turns around before the next command, whatever waits.
#[test]
fn on_rs485_next_command_waits_for_the_turnaround_of_an_answer() {
    let mut master = Master::<2>::new(Config::rs485(115_200, false));
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    master.set_point(id(1), torque(1.0), ms(1)).unwrap();
    let answer = Frame { address: Target::Motor(id(1)), data: ANGLE_REPLY };
    assert!(matches!(master.handle_line(&answer, ms(2)), Some(Event::Reply { .. })));
    let after = |micros| ms(2) + Duration::from_micros(micros);
    assert_eq!(sent(&mut master, after(99)), []);
    assert_eq!(sent(&mut master, after(100)).len(), 1);
}

/// Nothing is to be called between an offer and its sending. If it is, the frame is sent once more, not left out.
#[test]
fn frame_offered_before_a_shutdown_to_all_or_restart_is_not_sent_yet() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(master.poll_transmit(ms(0)), Some(packet_to(1, Stop.encode())));
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    master.handle_transmitted(ms(0));
    assert!(sent(&mut master, ms(0)).contains(&packet_to(1, Shutdown.encode())));

    let mut master = Master::<2>::new(Config::CAN);
    let read = master.request(id(1), ReadModel).unwrap();
    assert!(master.poll_transmit(ms(0)).is_some());
    master.note_restart(id(1));
    master.handle_transmitted(ms(0));
    assert_eq!(sent(&mut master, ms(0)), [packet_to(1, ReadModel.encode())]);
    let event = reply(&mut master, 1, *b"\xB5X8S2V10", ms(1)).unwrap();
    assert!(read.outcome(&event).is_some());
}

/// A caller asks for it again. Until then nothing older moves the motor.
#[test]
fn what_ends_motion_is_busy_and_ends_it_all_the_same() {
    let mut master = Master::<2>::new(Config::CAN);
    let moving = master.request_with(id(1), torque(1.0), patient(3, 20)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    assert_eq!(master.request(id(1), Shutdown).err(), Some(RequestError::Busy));
    assert_eq!(sent(&mut master, ms(20)), []);
    let reported = events(&mut master, ms(20));
    assert!(reported.iter().any(|it| moving.outcome(it) == Some(Err(Failure::NoReply))));
    let _ = master.request(id(1), Shutdown).unwrap();
}

#[test]
fn move_of_all_that_waits_is_dropped_by_what_ends_the_motion_of_a_busy_motor() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = master.request_with(id(1), ReadStatus2, patient(1, 20)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.broadcast(step(), MotorSet::EMPTY).unwrap();
    assert_eq!(master.request(id(1), Shutdown).err(), Some(RequestError::Busy));
    assert_eq!(sent(&mut master, ms(100)), []);
}

#[test]
fn set_point_that_waits_behind_a_read_is_dropped_by_what_ends_motion() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = master.request_with(id(1), ReadStatus2, patient(1, 20)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    assert_eq!(master.request(id(1), Shutdown).err(), Some(RequestError::Busy));
    assert_eq!(sent(&mut master, ms(20)), []);
    assert!(events(&mut master, ms(20)).contains(&Event::SetPointDropped { motor: id(1) }));
}
