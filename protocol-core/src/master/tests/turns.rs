//! Whose turn it is, when the caller has to look next, and what was left over.

use super::*;

const MODEL_REPLY: [u8; 8] = [0xB5, 0x58, 0x38, 0, 0, 0, 0, 0];
/// Of [`Config::CAN`]: 3 ms and 128 frames of 136 us; the late window is twice that.
const TIMEOUT: Duration = Duration::from_micros(20_408);
const WINDOW: Duration = Duration::from_micros(40_816);

fn to_all(data: Data) -> Packet {
    Packet { channel: Channel::Command(Target::All), data }
}

fn is_to(packets: &[Packet], motor: u8) -> bool {
    matches!(packets, [Packet { channel: Channel::Command(Target::Motor(to)), .. }] if *to == id(motor))
}

/// A read that is not answered: its reply may come late.
fn give_up<C: Command>(master: &mut Master<2>, command: C, now: u64) {
    let _ = master.request_with(id(1), command, once(5)).unwrap();
    assert_eq!(sent(master, ms(now)).len(), 1);
    assert_eq!(events(master, ms(now + 5)).len(), 1);
}

#[test]
fn request_waits_until_an_earlier_broadcast_is_over() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadModel, ms(0));
    master.broadcast(ReadMultiTurnAngle, id(2).into()).unwrap();
    let _ = master.request(id(2), ReadPid { index: PidIndex::SPEED_KP }).unwrap();
    assert_eq!(sent(&mut master, ms(1)), [], "one waits for the other");
    reply(&mut master, 1, MODEL_REPLY, ms(1)).unwrap();
    assert_eq!(sent(&mut master, ms(1)), [to_all(ReadMultiTurnAngle.encode())]);
    // What ends motion waits for it, too, once it is in flight.
    let _ = master.request(id(1), Shutdown).unwrap();
    assert_eq!(sent(&mut master, ms(2)), []);
    reply(&mut master, 2, ANGLE_REPLY, ms(2)).unwrap();
    assert_eq!(sent(&mut master, ms(2)).len(), 2);
}

#[test]
fn move_to_all_is_sent_after_earlier_and_before_later_requests() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = master.request(id(1), ReadModel).unwrap();
    master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
    let _ = master.request(id(2), ReadModel).unwrap();
    assert!(is_to(&sent(&mut master, ms(0)), 1));
    reply(&mut master, 1, MODEL_REPLY, ms(1)).unwrap();
    let packets = sent(&mut master, ms(1));
    assert_eq!(packets[0], to_all(torque(1.0).encode()));
    assert!(is_to(&packets[1..], 2), "{packets:?}");
}

#[test]
fn a_move_of_all_is_refused_while_any_motor_is_stopped() {
    let mut master = Master::<2>::new(Config::CAN);
    let everybody = MotorSet::EMPTY;
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(master.broadcast(step(), everybody), Err(RequestError::Stopped));
    master.lift_stop_of(id(1));
    master.stop_all(StopKind::Hold, everybody).unwrap();
    assert_eq!(master.broadcast(step(), everybody), Err(RequestError::Stopped));
    master.lift_stop();
    assert_eq!(master.broadcast(step(), everybody), Ok(()));
}

#[test]
fn waiting_read_to_all_survives_the_stop_of_one_motor() {
    let mut master = Master::<2>::new(Config::CAN);
    for motor in [1, 2] {
        let _ = ask(&mut master, motor, ReadModel, ms(0));
        reply(&mut master, motor, MODEL_REPLY, ms(1)).unwrap();
    }
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(2));
    events(&mut master, ms(2));
    // The shutdown would undo this, were it to go again; the question undoes nothing.
    master.stop(id(1), StopKind::Hold).unwrap();
    master.broadcast(ReadMultiTurnAngle, MotorSet::EMPTY).unwrap();
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(events(&mut master, ms(3)), [], "it waits");
    let packets = sent(&mut master, ms(3));
    assert!(packets.iter().all(|packet| packet.data == Stop.encode()), "{packets:?}");
}

#[test]
fn poll_at_returns_the_time_out_of_a_read_to_all() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(ReadMultiTurnAngle, id(2).into()).unwrap();
    sent(&mut master, ms(1));
    assert_eq!(master.poll_at(), Some(ms(1) + TIMEOUT));
}

#[test]
fn read_to_all_is_sent_once_the_last_can_no_longer_be_answered() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadModel, ms(0));
    reply(&mut master, 1, MODEL_REPLY, ms(1)).unwrap();
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    sent(&mut master, ms(10));
    let reported = events(&mut master, ms(31));
    assert_eq!(reported, [Event::BroadcastDone { silent: id(1).into(), was_sent: true }]);
    assert_eq!(master.poll_at(), None, "nobody waits for that");
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(31)), []);
    // What another motor says does not put it off: the command moves no motor, however late it arrives.
    reply(&mut master, 2, MODEL_REPLY, ms(40));
    assert_eq!(sent(&mut master, ms(40)), []);
    let at = ms(10) + TIMEOUT + WINDOW;
    assert_eq!(master.poll_at(), Some(at));
    assert_eq!(sent(&mut master, at), [to_all(ReadMultiTurnAngle.encode())]);
}

#[test]
fn bus_down_extends_how_long_a_broadcast_may_be_answered() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadModel, ms(0));
    reply(&mut master, 1, MODEL_REPLY, ms(1)).unwrap();
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    sent(&mut master, ms(10));
    events(&mut master, ms(31));
    // Its time was up at 71.2 ms.
    master.handle_bus_down(ms(60));
    let _ = master.request(id(1), ReadMultiTurnAngle).unwrap();
    assert_eq!(sent(&mut master, ms(72)), [], "the answer would be taken for this one's");
    let at = ms(60) + WINDOW;
    assert_eq!(master.poll_at(), Some(at));
    assert!(is_to(&sent(&mut master, at), 1));
}

#[test]
fn read_is_retried_though_a_shutdown_went_to_all() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadModel, ms(0));
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(1));
    let again = sent(&mut master, ms(21));
    assert!(is_to(&again, 1) && again[0].data == ReadModel.encode(), "{again:?}");
}

#[test]
fn withdrawing_a_finished_request_leaves_the_next_one() {
    let mut master = Master::<2>::new(Config::CAN);
    let over = ask(&mut master, 1, ReadModel, ms(0));
    reply(&mut master, 1, MODEL_REPLY, ms(1)).unwrap();
    let _ = master.request(id(1), step()).unwrap();
    master.withdraw(over.id());
    assert!(is_to(&sent(&mut master, ms(2)), 1));
}

#[test]
fn on_rs485_command_waits_a_turnaround_after_anything_heard() {
    let config = Config::rs485(115_200, false);
    let Bus::Rs485 { turnaround, .. } = config.bus else { unreachable!() };
    let mut master = Master::<2>::new(config);
    let heard = Packet { channel: Channel::Reply(id(2)), data: MODEL_REPLY };
    master.handle_line(&Frame::from_packet(&heard).unwrap(), ms(10));
    let _ = master.request(id(1), ReadModel).unwrap();
    assert_eq!(sent(&mut master, ms(10)), []);
    assert_eq!(master.poll_at(), Some(ms(10) + turnaround));
    assert!(is_to(&sent(&mut master, ms(10) + turnaround), 1));
}

#[test]
fn another_reply_does_not_show_that_a_move_to_all_arrived() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(0));
    events(&mut master, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(2));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(3)), None, "it moves the motor yet");
}

#[test]
fn a_stop_does_not_wait_for_late_replies_to_reads() {
    let stopped = Some(Event::StopConfirmed { motor: id(1) });
    // The set-point that was given up is answered late, the read never.
    let mut master = Master::<2>::new(Config::CAN);
    give_up(&mut master, ReadModel, 0);
    master.set_point(id(1), torque(1.0), ms(6)).unwrap();
    sent(&mut master, ms(6));
    assert_eq!(events(&mut master, ms(27)), [Event::SetPointUnanswered { motor: id(1) }]);
    assert!(matches!(reply(&mut master, 1, TORQUE_REPLY, ms(28)), Some(Event::Feedback { .. })));
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(28));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(29)), stopped);

    // The set-point is answered in time.
    let mut master = Master::<2>::new(Config::CAN);
    give_up(&mut master, ReadModel, 0);
    master.set_point(id(1), torque(1.0), ms(6)).unwrap();
    sent(&mut master, ms(6));
    assert!(matches!(reply(&mut master, 1, TORQUE_REPLY, ms(7)), Some(Event::Feedback { .. })));
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(8));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(9)), stopped);
}

#[test]
fn motor_with_a_pending_set_point_or_request_is_not_forgotten() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    assert!(!master.forget(id(1)), "a set-point waits");
    sent(&mut master, ms(0));
    assert!(!master.forget(id(1)), "and is in flight");
    reply(&mut master, 1, TORQUE_REPLY, ms(1)).unwrap();
    let _ = master.request(id(1), ReadModel).unwrap();
    assert!(!master.forget(id(1)), "a request waits");
    sent(&mut master, ms(1));
    assert!(!master.forget(id(1)), "and is in flight");
    reply(&mut master, 1, MODEL_REPLY, ms(2)).unwrap();
    assert!(master.forget(id(1)));
}

#[test]
fn a_motor_is_forgotten_once_no_mailbox_can_move_it_any_more() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, step(), ms(0));
    assert_eq!(events(&mut master, ms(21)).len(), 1);
    assert_eq!(events(&mut master, ms(70)), []);
    assert!(!master.forget(id(1)), "the bus may be cut");
    // It is not, or no more.
    reply(&mut master, 2, ANGLE_REPLY, ms(80)).unwrap();
    assert_eq!(events(&mut master, ms(80)), []);
    assert!(!master.forget(id(1)), "what lay in a mailbox comes now");
    assert_eq!(master.poll_at(), None);
    assert_eq!(events(&mut master, ms(81) + WINDOW), []);
    assert!(master.forget(id(1)));
}

#[test]
fn lost_move_handed_back_does_not_make_the_next_one_go_twice() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = master.request(id(1), step()).unwrap();
    let lost = sent(&mut master, ms(0))[0];
    assert_eq!(events(&mut master, ms(21)).len(), 1);
    let _ = master.request(id(1), step()).unwrap();
    assert_eq!(sent(&mut master, ms(21)), [], "the reply to the first may come late");
    master.handle_pushed_out(&lost);
    assert_eq!(sent(&mut master, ms(22)).len(), 1);
    assert!(matches!(events(&mut master, ms(43))[..], [Event::Failed { .. }]));
    assert_eq!(sent(&mut master, ms(200)), []);
}

#[test]
fn handed_back_reset_is_sent_again_at_once() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = master.request(id(1), Reset).unwrap();
    let reset = sent(&mut master, ms(0))[0];
    master.handle_pushed_out(&reset);
    assert_eq!(sent(&mut master, ms(1)), [reset], "no drive restarts");
}

#[test]
fn unchanged_run_time_is_no_restart() {
    let mut master = Master::<2>::new(Config::CAN);
    for now in [0, 1] {
        let _ = ask(&mut master, 1, ReadRunTime, ms(now));
        let event = reply(&mut master, 1, [0xB1, 0, 0, 0, 0x10, 0x27, 0, 0], ms(now + 1));
        assert!(matches!(event, Some(Event::Reply { .. })), "{event:?}");
    }
    assert_eq!(events(&mut master, ms(3)), []);
}

#[test]
fn time_outs_follow_the_answers() {
    let config = Config { reply_timeout: Duration::from_millis(5), ..Config::CAN };
    let longest = Duration::from_millis(40);
    let mut master = Master::<2>::new(config.adapting_up_to(longest));
    assert_eq!(master.config().reply_timeout, longest, "nothing is known yet");
    let _ = ask(&mut master, 1, ReadModel, ms(0));
    reply(&mut master, 1, MODEL_REPLY, ms(1)).unwrap();
    assert_eq!(master.config().reply_timeout, Duration::from_millis(5));
}

#[test]
fn a_relative_move_is_given_the_usual_time() {
    let config = Config { reply_timeout: Duration::from_millis(5), ..Config::CAN };
    let mut master = Master::<2>::new(config);
    let _ = ask(&mut master, 1, step(), ms(0));
    assert!(matches!(events(&mut master, ms(5))[..], [Event::Failed { .. }]), "it writes no ROM");
}

#[test]
fn set_point_waits_until_the_first_of_three_late_replies_cannot_come() {
    let mut master = Master::<2>::new(Config::CAN);
    give_up(&mut master, ReadModel, 0);
    give_up(&mut master, ReadRunTime, 5);
    give_up(&mut master, ReadMultiTurnAngle, 10);
    assert_eq!(master.poll_at(), None, "nothing waits");
    master.set_point(id(1), torque(1.0), ms(20)).unwrap();
    assert_eq!(sent(&mut master, ms(20)), [], "its reply could not be recognised if it were late");
    assert_eq!(master.poll_at(), Some(ms(5) + WINDOW));
    assert_eq!(sent(&mut master, ms(5) + WINDOW).len(), 1);
}

#[test]
fn handed_back_request_is_sent_before_the_next_set_point() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    assert_eq!(sent(&mut master, ms(0))[0].data, torque(1.0).encode());
    let _ = master.request(id(1), ReadModel).unwrap();
    reply(&mut master, 1, TORQUE_REPLY, ms(1)).unwrap();
    master.set_point(id(1), torque(2.0), ms(2)).unwrap();
    // It is the request's turn, and what is more urgent takes its mailbox.
    let request = master.poll_transmit(ms(2)).unwrap();
    assert_eq!(request.data, ReadModel.encode());
    master.handle_transmitted(ms(2));
    master.handle_pushed_out(&request);
    assert_eq!(master.poll_transmit(ms(2)).unwrap().data, ReadModel.encode());
}

#[test]
fn a_motor_whose_replies_lose_every_arbitration_gets_its_turn() {
    let mut master = Master::<8>::new(Config::CAN);
    stream_to(&mut master, 1..=6, ms(0));
    assert_eq!(sent(&mut master, ms(0)).len(), 6);
    let at = Instant::from_micros;
    // The others may be two commands ahead of motor 6, but not three.
    for (answered, more) in [(700, 5), (1_400, 5), (2_100, 0)] {
        feedback_of_all(&mut master, 1..=5, at(answered));
        stream_to(&mut master, 1..=5, at(answered));
        assert_eq!(sent(&mut master, at(answered)).len(), more, "{answered}");
    }
    feedback_of_all(&mut master, 6..=6, at(2_100));
    assert_eq!(sent(&mut master, at(2_100)).len(), 5);
}

/// The answer of a motor has to come within the time of 128 frames.
#[test]
fn of_more_than_21_motors_none_gets_two_rounds_ahead() {
    for (motors, ahead) in [(21, 2), (22, 1)] {
        let mut master = Master::<32>::new(Config::CAN);
        stream_to(&mut master, 1..=motors, ms(0));
        sent(&mut master, ms(0));
        // The last one does not answer, and the bus is full.
        let goes_again = |now: &u64| {
            let now = Instant::from_micros(*now);
            feedback_of_all(&mut master, 1..=motors - 1, now);
            stream_to(&mut master, 1..=motors - 1, now);
            !sent(&mut master, now).is_empty()
        };
        let rounds = [3_000, 3_600, 4_200].iter().copied().take_while(goes_again).count();
        assert_eq!(rounds, ahead, "of {motors}");
    }
}

#[test]
fn a_bus_that_was_full_is_quiet_as_soon_as_its_frames_are_gone() {
    let mut master = Master::<8>::new(Config::CAN);
    let mut now = Instant::from_micros(100);
    let pause = Duration::from_micros(240);
    let mut answer = |master: &mut Master<8>, motor| {
        now += pause;
        feedback_of_all(master, motor..=motor, now);
        stream_to(master, motor..=motor, now);
        (sent(master, now).len(), now)
    };
    stream_to(&mut master, 1..=8, ms(0));
    sent(&mut master, ms(0));
    // For half a second there is always a frame on the bus: two in 240 µs, each for 136 µs at the most.
    for _ in 0..250 {
        for motor in 1..=8 {
            assert_eq!(answer(&mut master, motor).0, 1);
        }
    }
    // Then an answer of motor 8 is lost, and the others may be two commands ahead of it.
    for _ in 0..2 {
        assert!((1..=7).all(|motor| answer(&mut master, motor).0 == 1));
    }
    assert!((1..=7).all(|motor| answer(&mut master, motor).0 == 0));
    let last = now;
    assert_eq!(sent(&mut master, last + Duration::from_millis(1)).len(), 7);
}

/// What comes together was held back: it may have been on the bus long before, when the reply of motor 1 was not ready.
#[test]
fn replies_of_a_burst_do_not_show_that_no_more_urgent_one_waited() {
    let mut master = Master::<8>::new(Config::CAN);
    let at = Instant::from_micros;
    stream_to(&mut master, 1..=3, ms(0));
    assert_eq!(sent(&mut master, ms(0)).len(), 3);
    // The others may be two commands ahead of motor 1. Its reply is due 2 ms after its command.
    for (burst, more) in [(1_000, 2), (2_300, 2), (3_100, 0)] {
        feedback_of_all(&mut master, 2..=3, at(burst));
        stream_to(&mut master, 2..=3, at(burst));
        assert_eq!(sent(&mut master, at(burst)).len(), more, "{burst}");
    }
    // Three quarters of the longest pause, and three frames.
    assert_eq!(sent(&mut master, at(3_100 + 975 + 407)), []);
    assert_eq!(sent(&mut master, at(3_100 + 975 + 408)).len(), 2);
}

/// The bus is never quiet, and no reply loses arbitration to that of motor 8.
#[test]
fn a_reply_is_waited_for_by_others_for_the_usual_time_out_however_long_its_own_is() {
    let mut master = Master::<8>::new(Config::CAN);
    let patience = Patience { reply_timeout: Duration::from_millis(500), attempts: 1 };
    let _silent = master.put_request(id(8), &ReadStatus1, Some(patience)).unwrap();
    stream_to(&mut master, 1..=2, ms(0));
    assert_eq!(sent(&mut master, ms(0)).len(), 3);
    let mut streamed_at = Vec::new();
    for tick in 1..200 {
        let now = Instant::from_micros(tick * 300);
        let first = id(1 + (tick % 2) as u8);
        // The frames of another master.
        master.handle_frame(&crate::wire::can::Received::Packet(torque(1.0).packet(first)), now);
        if master.motor(first).is_some_and(|motor| motor.stream.in_flight().is_some()) {
            feedback_of_all(&mut master, first.get()..=first.get(), now);
            stream_to(&mut master, first.get()..=first.get(), now);
        }
        if !sent(&mut master, now).is_empty() {
            streamed_at.push(now);
        }
    }
    let pauses = streamed_at.windows(2).filter(|two| two[1] - two[0] > Duration::from_millis(1));
    let ends: Vec<_> = pauses.map(|two| two[1]).collect();
    // Two commands ahead, and then none until a look finds the time-out of 20,408 us over.
    assert_eq!(ends, [Instant::from_micros(20_700)]);
}

/// At which milliseconds motors 2 to 4 get no set-point, because this one may still be waiting to answer.
fn others_are_held_up_at(silent: u8) -> Vec<u64> {
    let mut master = Master::<8>::new(Config::CAN);
    let _silent = master.request(id(silent), ReadStatus1).unwrap();
    let mut held_up_at = Vec::new();
    for tick in 0..100 {
        let now = ms(tick);
        stream_to(&mut master, 2..=4, now);
        let others = sent(&mut master, now).iter().filter(|packet| packet.data[0] == 0xA4).count();
        match others {
            3 => {
                for motor in 2..=4 {
                    let at = now + Duration::from_micros(510 + 120 * u64::from(motor));
                    feedback_of_all(&mut master, motor..=motor, at);
                }
            }
            0 => held_up_at.push(tick),
            _ => panic!("{others} of 3 at {tick} ms"),
        }
    }
    held_up_at
}

#[test]
fn silent_motor_holds_others_up_only_until_it_could_have_answered() {
    // At first they get two commands ahead of it. After a time-out, at 21 and 42 ms, they wait at once, for it had no
    // turn meanwhile.
    assert_eq!(others_are_held_up_at(5), [3, 21, 22, 42, 43]);
    // The answer of motor 1 would come before theirs.
    assert_eq!(others_are_held_up_at(1), [21, 22, 42, 43]);
}

/// Motors 1 to 4 stream beside motor 5, which is not there. For each command to it, whether the others waited.
fn waits_for_absent_fifth(commands: usize) -> Vec<bool> {
    let mut master = Master::<8>::new(Config::CAN);
    let mut waits = Vec::new();
    for now in (1..).map(ms) {
        stream_to(&mut master, 1..=5, now);
        let packets = sent(&mut master, now);
        let goes = |motor| {
            packets.iter().any(|packet| packet.channel == Channel::Command(id(motor).into()))
        };
        if goes(5) && waits.len() == commands {
            break;
        }
        if goes(5) {
            waits.push(false);
        }
        if goes(1) {
            feedback_of_all(&mut master, 1..=4, now + Duration::from_micros(990));
        } else if let Some(waits) = waits.last_mut() {
            *waits = true;
        }
        events(&mut master, now);
    }
    waits
}

/// It may be back, and its answers lose every arbitration.
#[test]
fn others_wait_for_the_first_three_answers_of_a_silent_motor_and_for_every_eighth_for_ever() {
    // The count of unanswered commands goes on at 3 after 255.
    let unanswered = (0..3).chain((3..=255).cycle());
    let expected = unanswered.map(|count| count < 3 || count % 8 == 0);
    let waits = waits_for_absent_fifth(600);
    assert_eq!(waits, expected.take(600).collect::<Vec<_>>());
}

/// Motor 2 has answered once, and motor 1 has had this many turns since. Also what time it is.
fn with_one_that_rested(turns: u32) -> (Master<2>, Instant) {
    let mut master = Master::<2>::new(Config::CAN);
    let mut now = ms(0);
    let _ = ask(&mut master, 2, ReadModel, now);
    reply(&mut master, 2, *b"\xB5X8S2V10", ms(1)).unwrap();
    for _ in 0..turns {
        now += Duration::from_millis(1);
        master.set_point(id(1), torque(1.0), now).unwrap();
        sent(&mut master, now);
        reply(&mut master, 1, TORQUE_REPLY, now + Duration::from_micros(900));
    }
    now += Duration::from_millis(1);
    (master, now)
}

#[test]
fn a_motor_that_rested_for_long_does_not_starve() {
    // In rounds of eight bits, motor 2 would seem to be ahead after 129 to 255.
    for turns in [130, 200, 255, 300] {
        let (mut master, now) = with_one_that_rested(turns);
        master.set_point(id(1), torque(1.0), now).unwrap();
        let _read = master.request(id(2), ReadModel).unwrap();
        let order = [packet_to(2, ReadModel.encode()), packet_to(1, torque(1.0).encode())];
        assert_eq!(sent(&mut master, now), order, "after {turns}");
    }
}

#[test]
fn motor_gets_at_most_two_rounds_ahead_of_a_waiting_reply() {
    let mut master = Master::<8>::new(Config::CAN);
    // Motor 1 is a round ahead of motor 2, whose reply waits for the bus.
    stream_to(&mut master, 1..=1, ms(0));
    sent(&mut master, ms(0));
    feedback_of_all(&mut master, 1..=1, ms(1));
    stream_to(&mut master, 1..=2, ms(1));
    assert_eq!(sent(&mut master, ms(1)).len(), 2);
    for (answered, more) in [(1_700, 1), (2_400, 0)] {
        let answered = Instant::from_micros(answered);
        feedback_of_all(&mut master, 1..=1, answered);
        stream_to(&mut master, 1..=1, answered);
        assert_eq!(sent(&mut master, answered).len(), more, "not three rounds");
    }
}

#[test]
fn poll_at_counts_the_queued_frames_until_the_bus_is_quiet() {
    let mut master = Master::<32>::new(Config::CAN);
    for motor in 1..=20 {
        let _ticket = master.request(id(motor), ReadMultiTurnAngle).unwrap();
    }
    assert_eq!(sent(&mut master, ms(0)).len(), 20);
    // A frame takes 136 us, and three more without any make a quiet bus.
    assert_eq!(master.poll_at(), Some(Instant::from_micros(23 * 136)));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    assert_eq!(master.poll_at(), Some(Instant::from_micros(24 * 136)));
    // None is queued any more.
    reply(&mut master, 2, ANGLE_REPLY, ms(4)).unwrap();
    assert_eq!(master.poll_at(), Some(Instant::from_micros(4_000 + 3 * 136)));
}

#[test]
fn a_set_point_and_a_request_of_one_motor_go_in_turn() {
    let mut master = Master::<2>::new(Config::CAN);
    let mut order = Vec::new();
    for now in 0..6 {
        master.set_point(id(1), torque(1.0), ms(2 * now)).unwrap();
        let _ = master.request(id(1), ReadMultiTurnAngle);
        let packets = sent(&mut master, ms(2 * now));
        let [Packet { data, .. }] = packets[..] else { panic!("{packets:?}") };
        order.push(data[0]);
        let answer = if data[0] == 0x92 { ANGLE_REPLY } else { TORQUE_REPLY };
        reply(&mut master, 1, answer, ms(2 * now + 1)).unwrap();
    }
    assert_eq!(order, [0xA1, 0x92, 0xA1, 0x92, 0xA1, 0x92]);
}

#[test]
fn motor_whose_request_must_wait_keeps_no_turn_from_others() {
    let mut master = Master::<2>::new(Config::CAN);
    // Motor 1 has the first place and was served more often.
    for now in [0, 2, 4] {
        let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(now));
        reply(&mut master, 1, ANGLE_REPLY, ms(now + 1)).unwrap();
    }
    let _given_up = master.request_with(id(2), ReadMultiTurnAngle, once(5)).unwrap();
    sent(&mut master, ms(6));
    assert_eq!(events(&mut master, ms(11)).len(), 1, "it is given up");
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(12));
    reply(&mut master, 1, ANGLE_REPLY, ms(13)).unwrap();
    let _waits = master.request(id(2), ReadMultiTurnAngle).unwrap();
    let _goes = master.request(id(1), ReadMultiTurnAngle).unwrap();
    let packets = sent(&mut master, ms(14));
    let to_first = Channel::Command(Target::Motor(id(1)));
    assert!(matches!(packets[..], [Packet { channel, .. }] if channel == to_first), "{packets:?}");
}

#[test]
fn stream_that_rested_has_no_claim_to_missed_turns() {
    let (mut master, now) = with_one_that_rested(300);
    for motor in 1..=2 {
        master.set_point(id(motor), torque(1.0), now).unwrap();
    }
    assert_eq!(sent(&mut master, now).len(), 2);
}

/// Something else is heard, and the bus is quiet then; but a drive needs some time to answer.
#[test]
fn motor_is_waited_for_until_the_longest_response_is_over() {
    let mut master = Master::<8>::new(Config::CAN);
    let at = Instant::from_micros;
    stream_to(&mut master, 1..=1, ms(0));
    sent(&mut master, ms(0));
    feedback_of_all(&mut master, 1..=1, ms(1));
    stream_to(&mut master, 1..=2, ms(1));
    assert_eq!(sent(&mut master, ms(1)).len(), 2);
    feedback_of_all(&mut master, 1..=1, at(1_550));
    stream_to(&mut master, 1..=1, at(1_550));
    assert_eq!(sent(&mut master, at(1_550)).len(), 1);
    feedback_of_all(&mut master, 1..=1, at(2_100));
    reply(&mut master, 3, ANGLE_REPLY, at(2_220)).unwrap();
    stream_to(&mut master, 1..=1, at(2_600));
    assert_eq!(sent(&mut master, at(2_600)), [], "1.6 ms after its command");
    assert_eq!(sent(&mut master, at(3_000)).len(), 1);
}

#[test]
fn waiting_move_to_all_is_sent_before_a_later_read() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 2, ReadModel, ms(0));
    master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
    let _read = master.request(id(1), ReadModel).unwrap();
    reply(&mut master, 2, MODEL_REPLY, ms(1)).unwrap();
    assert_eq!(sent(&mut master, ms(1))[0], to_all(torque(1.0).encode()));
}

/// The next set-point of the silent motor always waits, so that it has no rest in which to join the others.
#[test]
fn motor_back_after_a_silence_has_no_claim_to_missed_turns() {
    let mut master = Master::<2>::new(Config::CAN);
    let mut packets = Vec::<Packet>::new();
    let mut turns = |span: core::ops::Range<u64>, is_there: bool| {
        let mut turns = [0; 2];
        for now in span {
            for packet in core::mem::take(&mut packets) {
                let motor = if packet == packet_to(1, packet.data) { 1 } else { 2 };
                turns[usize::from(motor) - 1] += 1;
                if motor == 1 || is_there {
                    reply(&mut master, motor, TORQUE_REPLY, ms(now));
                }
            }
            packets = sent(&mut master, ms(now));
            for motor in 1..=2 {
                master.set_point(id(motor), torque(1.0), ms(now)).unwrap();
            }
            events(&mut master, ms(now));
        }
        turns
    };
    let alone = turns(0..1_000, false);
    assert!(alone[0] > 900, "{alone:?}");
    let [first, second] = turns(1_000..1_100, true);
    assert!(first > 70 && second > 70, "{first}, {second}");
}

/// Its set-points wait for the end of its restart, and the others go on.
#[test]
fn motor_back_after_a_restart_has_no_claim_to_missed_turns() {
    let mut master = Master::<4>::new(Config::CAN);
    let _reset = master.request(id(2), Reset).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    events(&mut master, ms(0));
    let mut packets = Vec::<Packet>::new();
    let mut last = [0; 3];
    for now in 1..4_000 {
        for packet in core::mem::take(&mut packets) {
            let motor = (1..=3).find(|&motor| packet == packet_to(motor, packet.data)).unwrap();
            last[usize::from(motor) - 1] = now;
            reply(&mut master, motor, TORQUE_REPLY, ms(now));
        }
        // After the restart, the other is not waited for long.
        let longest = last.iter().map(|at| now - at).max().unwrap();
        assert!(now < 3_000 || longest <= 20, "at {now}: {last:?}");
        packets = sent(&mut master, ms(now));
        for motor in 1..=3 {
            master.resume(id(motor));
            master.set_point(id(motor), torque(1.0), ms(now)).unwrap();
        }
        events(&mut master, ms(now));
        if last[1] == 0 {
            continue;
        }
        assert!(last[0].min(last[2]) + 20 > now, "at {now}: {last:?}");
    }
    assert!(last[1] > 0);
}

/// All were asked for their model, and motor 1 may answer that yet, so that the next read to all waits.
#[test]
fn requested_shutdown_does_not_wait_for_a_waiting_read_to_all() {
    let mut master = Master::<2>::new(Config::CAN);
    let _read = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    master.broadcast(ReadModel, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(2)).len(), 1);
    events(&mut master, ms(2));
    master.broadcast(ReadMultiTurnAngle, MotorSet::EMPTY).unwrap();
    let _off = master.request(id(1), Shutdown).unwrap();
    assert_eq!(sent(&mut master, ms(3)), [packet_to(1, Shutdown.encode())]);
}

/// Otherwise the motor would be off in the end, though it was to be held with all.
#[test]
fn hold_to_all_is_sent_after_an_earlier_requested_shutdown() {
    let mut master = Master::<2>::new(Config::CAN);
    let _off = master.request(id(1), Shutdown).unwrap();
    master.broadcast(Stop, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(0)), [packet_to(1, Shutdown.encode())]);
    reply(&mut master, 1, Shutdown.encode(), ms(1)).unwrap();
    assert_eq!(sent(&mut master, ms(1)), [packet_to_all(Stop.encode())]);
}

#[test]
fn read_to_all_does_not_wait_for_a_read_of_a_restarting_motor() {
    let mut master = Master::<2>::new(Config::CAN);
    let _reset = ask(&mut master, 1, Reset, ms(0));
    events(&mut master, ms(0));
    let _read = master.request(id(1), ReadModel).unwrap();
    master.broadcast(ReadMultiTurnAngle, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(1)), [packet_to_all(ReadMultiTurnAngle.encode())]);
}

/// The shutdown waits until its motor has taken a command that has no answer.
#[test]
fn move_to_all_is_sent_after_an_earlier_requested_shutdown() {
    let mut master = Master::<2>::new(Config::CAN);
    let _unanswered = ask(&mut master, 1, report_angle(Switch::Off), ms(0));
    events(&mut master, ms(0));
    let _off = master.request(id(1), Shutdown).unwrap();
    master.broadcast(torque(1.0), id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(0)), []);
    let settled = master.poll_at().unwrap();
    assert_eq!(sent(&mut master, settled), [packet_to(1, Shutdown.encode())]);
    let answered = settled + Duration::from_millis(1);
    reply(&mut master, 1, Shutdown.encode(), answered).unwrap();
    assert_eq!(sent(&mut master, answered), [packet_to_all(torque(1.0).encode())]);
}

/// Frames of 125 us, commands before answers and these by id, a FIFO of three, a host that looks at once, and drives
/// that answer 250 us after their command. A motor whose answer makes way for commands again and again falls behind.
#[test]
fn streams_have_equal_shares_though_answers_wait_for_the_bus() {
    for motors in 4..=12 {
        let mut master = Master::<12>::new(Config::CAN);
        let (mut fifo, mut answers, mut turns) = (Vec::<Packet>::new(), Vec::new(), [0_u32; 12]);
        for slot in 0..4_000 {
            let now = Instant::ZERO + Duration::from_micros(125).times(slot);
            if !fifo.is_empty() {
                let Channel::Command(Target::Motor(motor)) = fifo.remove(0).channel else {
                    continue;
                };
                turns[motor.index()] += 1;
                answers.push((motor, slot + 2));
            } else if let Some(&answer) = answers.iter().filter(|(_, due)| *due <= slot).min() {
                answers.retain(|it| *it != answer);
                reply(&mut master, answer.0.get(), TORQUE_REPLY, now);
            }
            events(&mut master, now);
            for motor in 1..=motors {
                master.set_point(id(motor), torque(1.0), now).unwrap();
            }
            while fifo.len() < 3 {
                let Some(packet) = master.poll_transmit(now) else { break };
                master.handle_transmitted(now);
                fifo.push(packet);
            }
        }
        let turns = &turns[..usize::from(motors)];
        let (most, least) = (turns.iter().max().unwrap(), turns.iter().min().unwrap());
        assert!(least * 100 >= most * 90, "{turns:?}");
    }
}

/// RS485: each stop is a turn, and the others rest meanwhile.
#[test]
fn motor_that_was_stopped_for_long_then_gets_as_many_turns_as_others() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    let mut turns = [0; 2];
    for now in 0..300 {
        if now < 200 {
            master.stop(id(1), StopKind::Hold).unwrap();
        } else {
            master.lift_stop();
            (1..=2).for_each(|motor| {
                master.set_point(id(motor), torque(1.0), ms(now)).unwrap();
            });
        }
        master.handle_timeout(ms(now));
        let Some(packet) = master.poll_transmit(ms(now)) else { continue };
        master.handle_transmitted(ms(now));
        let Channel::Command(Target::Motor(motor)) = packet.channel else { continue };
        let is_move = packet.data[0] == 0xA1;
        turns[motor.index()] += u32::from(is_move);
        let data = if is_move { TORQUE_REPLY } else { packet.data };
        says(&mut master, motor.get(), data, ms(now) + Duration::from_micros(800));
        while master.poll_event().is_some() {}
    }
    assert!(turns.iter().all(|&turns| turns > 30), "{turns:?}");
}
