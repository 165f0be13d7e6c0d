//! RS485: one exchange at a time.

use super::*;

#[test]
fn rs485_carries_one_exchange_at_a_time() {
    let mut master = Master::<4>::new(Config::rs485(1_000_000, false));
    let first = master.request(id(1), ReadMultiTurnAngle).unwrap();
    let _second = master.request(id(2), ReadMultiTurnAngle).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    assert_eq!(sent(&mut master, ms(1)).len(), 0);
    let line = |motor, data| Frame { address: Target::Motor(id(motor)), data };
    let event = master.handle_line(&line(1, ANGLE_REPLY), ms(1)).unwrap();
    assert!(first.outcome(&event).is_some());
    assert_eq!(sent(&mut master, ms(1)).len(), 0, "the drives turn around for 100 µs");
    assert!(master.poll_at().unwrap() <= Instant::from_micros(1_120));
    assert_eq!(sent(&mut master, Instant::from_micros(1_120)).len(), 1);
    let motion = RawMotion::decode(&[0; 8]);
    assert_eq!(master.set_point(id(1), motion, ms(2)), Err(RequestError::CanOnly(Opcode::Motion)));
}

#[test]
fn on_rs485_nothing_is_sent_while_an_unwanted_answer_may_come() {
    let mut master = Master::<4>::new(Config::rs485(1_000_000, false));
    let faster = SetBaudRate { baud_rate: BaudCode::CAN_1M_RS485_500K };
    let _set = master.request(id(1), faster).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    let _other = master.request(id(2), ReadModel).unwrap();
    assert!(sent(&mut master, ms(4)).is_empty(), "0xB4 is answered with garbage (2.32.3)");
    assert_eq!(sent(&mut master, ms(6)).len(), 1);
}

#[test]
fn lost_feedback_holds_the_line_for_three_usual_response_times() {
    let config = Config::rs485(1_000_000, false);
    let line = |motor, data| Frame { address: Target::Motor(id(motor)), data };
    let feedback = [0xA1, 0x32, 0x64, 0, 0, 0, 45, 0];
    for (config, usual_us, lost_after_us) in [
        // Three times 0.9 ms; no sooner than 2 ms; and no later than any reply.
        (config, 900, 2_700),
        (config, 500, 2_000),
        (config, 3_000, config.reply_timeout.as_micros()),
    ] {
        let mut master = Master::<2>::new(config);
        let mut now = ms(0);
        master.set_point(id(1), torque(1.0), now).unwrap();
        assert_eq!(sent(&mut master, now).len(), 1);
        now += Duration::from_micros(usual_us);
        master.handle_line(&line(1, feedback), now).unwrap();
        let timeouts = [lost_after_us, lost_after_us, config.reply_timeout.as_micros()];
        // Not where it stays away again and again.
        for timeout in timeouts.map(Duration::from_micros) {
            now += Duration::from_millis(1);
            master.set_point(id(1), torque(1.0), now).unwrap();
            assert_eq!(sent(&mut master, now).len(), 1);
            master.set_point(id(2), torque(1.0), now).unwrap();
            let before = now + (timeout - Duration::from_micros(1));
            assert_eq!(events(&mut master, before), [], "{usual_us}");
            assert!(sent(&mut master, before).is_empty());
            assert_eq!(master.poll_at(), Some(now + timeout), "{usual_us}");
            now += timeout;
            assert_eq!(events(&mut master, now), [Event::SetPointUnanswered { motor: id(1) }]);
            assert_eq!(sent(&mut master, now)[0].channel, Channel::Command(id(2).into()));
            now += Duration::from_micros(usual_us);
            master.handle_line(&line(2, feedback), now).unwrap();
        }
    }
}

#[test]
fn stop_waits_50_ms_for_another_motors_patient_exchange() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    let patient = Patience { reply_timeout: Duration::from_millis(200), attempts: 1 };
    let _ = master.request_with(id(1), ReadModel, patient).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.stop(id(2), StopKind::Off).unwrap();
    for now in [6, 30, 49] {
        assert_eq!(sent(&mut master, ms(now)), [], "after {now} ms");
    }
    assert_eq!(sent(&mut master, ms(50)).len(), 1);
}

/// Only the hold to all stops motors that were not named, and the line keeps the order: motor 1 is off in the end.
#[test]
fn waiting_hold_to_all_is_sent_before_a_later_shutdown_of_one_motor() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    let packets: Vec<Packet> = (0..10).flat_map(|now| sent(&mut master, ms(now))).collect();
    let off = packet_to(1, Shutdown.encode());
    assert_eq!(packets, [packet_to_all(Stop.encode()), off]);
}

#[test]
fn stop_waits_at_most_60_ms_for_a_patient_broadcast() {
    let config =
        Config { reply_timeout: Duration::from_millis(1_000), ..Config::rs485(1_000_000, false) };
    let mut master = Master::<2>::new(config);
    master.broadcast(ReadMultiTurnAngle, id(2).into()).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.stop(id(1), StopKind::Off).unwrap();
    let at = (1..2_000).find(|&now| !sent(&mut master, ms(now)).is_empty());
    assert!(at.is_some_and(|at| at <= 60), "{at:?}");
}

#[test]
fn frames_that_fill_the_line_delay_no_stop_after_a_patient_read() {
    let config = Config {
        reply_timeout: Duration::from_millis(1_000),
        bus: Bus::Rs485 { turnaround: Duration::from_millis(1), echo: false },
        ..Config::rs485(1_000_000, false)
    };
    let mut master = Master::<2>::new(config);
    let _ = ask(&mut master, 2, ReadMultiTurnAngle, ms(0));
    master.stop(id(1), StopKind::Off).unwrap();
    let at = (1..3_000).find(|&now| {
        let frame = Frame { address: Target::Motor(id(9)), data: ANGLE_REPLY };
        master.handle_line(&frame, ms(now));
        master.handle_timeout(ms(now));
        while master.poll_event().is_some() {}
        let offered = master.poll_transmit(ms(now) + Duration::from_micros(500));
        offered.is_some()
    });
    assert!(at.is_some_and(|at| at <= 60), "{at:?}");
}

#[test]
fn line_waits_for_the_stop_answer_of_a_motor_forgotten_meanwhile() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    let _ = master.stop(id(1), StopKind::Hold);
    let mut t = 0;
    while events(&mut master, ms(t)).is_empty() {
        sent(&mut master, ms(t));
        t += 1;
    }
    let at = loop {
        t += 1;
        if !sent(&mut master, ms(t)).is_empty() {
            break t;
        }
    };
    assert!(master.is_anything_in_flight());
    let _ = master.request(id(2), ReadMultiTurnAngle);
    assert!(master.forget(id(1)));
    let now = ms(at) + Duration::from_micros(600);
    assert_eq!(sent(&mut master, now), [], "the answer to the stop is due");
}

/// What the transport wants goes first, at this time.
fn status_goes_first(master: &mut Master<4>, at: Instant) {
    assert!(master.poll_transmit(at).is_some());
    assert_eq!(master.let_status_go_first(id(1)), Some(ReadStatus1.packet(id(1))));
    master.handle_transmitted(at);
}

#[test]
fn status_for_the_transport_is_not_reported_and_keeps_the_line() {
    let config = Config::rs485(1_000_000, false);
    let line = |data| Frame { address: Target::Motor(id(1)), data };
    let mut master = Master::<4>::new(config);
    let read = master.request(id(1), ReadMultiTurnAngle).unwrap();
    status_goes_first(&mut master, ms(0));
    assert!(sent(&mut master, ms(1)).is_empty());
    assert_eq!(master.handle_line(&line(STATUS_REPLY), ms(1)), None);
    assert!(sent(&mut master, ms(1)).is_empty(), "the drives turn around for 100 us");
    assert_eq!(sent(&mut master, ms(2))[0].data[0], 0x92);
    let event = master.handle_line(&line(ANGLE_REPLY), ms(3)).unwrap();
    assert!(read.outcome(&event).is_some_and(|it| it.is_ok()));
    assert_eq!(master.health(id(1)).stray, 0);
    // One that is not answered keeps the line for as long as a stop would.
    let (_read, sent_at) = (master.request(id(1), ReadMultiTurnAngle).unwrap(), ms(10));
    status_goes_first(&mut master, sent_at);
    let free = sent_at + config.reply_timeout + Duration::from_micros(100);
    assert_eq!(master.poll_at(), Some(free));
    assert_eq!(sent(&mut master, free).len(), 1);
    master.handle_line(&line(ANGLE_REPLY), free + Duration::from_millis(1)).unwrap();
    // It may come late, and no other read of the status meanwhile.
    let _status = master.request(id(1), ReadStatus1).unwrap();
    let wait = config.reply_timeout + config.late_window;
    let (before, over) = (sent_at + (wait - Duration::from_micros(1)), sent_at + wait);
    assert_eq!(events(&mut master, before), []);
    assert!(sent(&mut master, before).is_empty());
    assert_eq!(master.poll_at(), Some(over));
    assert_eq!(events(&mut master, over), []);
    assert_eq!(sent(&mut master, over).len(), 1);
}

#[test]
fn only_the_first_attempt_of_a_stop_is_offered_as_first_stop() {
    let mut master = Master::<4>::new(Config::rs485(1_000_000, false));
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(master.poll_transmit(ms(0)).unwrap().data[0], 0x81);
    assert!(master.offers_first_stop());
    assert_eq!(sent(&mut master, ms(0))[0].data[0], 0x81);
    assert_eq!(events(&mut master, ms(10)), []);
    status_goes_first(&mut master, ms(10));
    assert!(master.poll_transmit(ms(20)).is_some());
    assert!(!master.offers_first_stop());
}

#[test]
fn status_is_not_put_first_if_requested_or_without_room_for_its_answer() {
    let mut master = Master::<4>::new(Config::rs485(1_000_000, false));
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    let _read = master.request(id(1), ReadStatus1).unwrap();
    assert!(master.poll_transmit(ms(0)).is_some());
    assert_eq!(master.let_status_go_first(id(1)), None);
    assert_eq!(master.let_status_go_first(id(2)), None, "it has no place");
    // Three other questions may be answered late.
    let config = Config { late_window: ms(100) - ms(0), ..Config::rs485(1_000_000, false) };
    let mut master = Master::<4>::new(config);
    for (at, index) in
        [(0, PidIndex::CURRENT_KP), (6, PidIndex::SPEED_KP), (12, PidIndex::POSITION_KP)]
    {
        let _read = master.request_with(id(1), ReadPid { index }, once(5)).unwrap();
        assert_eq!(sent(&mut master, ms(at)).len(), 1);
        assert_eq!(events(&mut master, ms(at + 5)).len(), 1);
    }
    master.stop(id(1), StopKind::Hold).unwrap();
    assert!(master.poll_transmit(ms(18)).is_some());
    assert_eq!(master.let_status_go_first(id(1)), None);
}

#[test]
fn late_window_of_the_transports_status_ends_in_time() {
    let config = Config { late_window: ms(9) - ms(0), ..Config::rs485(1_000_000, false) };
    let mut master = Master::<4>::new(config);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    let _read = master.request(id(1), ReadMultiTurnAngle).unwrap();
    assert_eq!(events(&mut master, ms(0)), []);
    status_goes_first(&mut master, ms(0));
    let over = ms(9) + config.reply_timeout;
    assert_eq!(events(&mut master, over), []);
    assert_eq!(sent(&mut master, over).len(), 1);
    assert!(master.poll_at().unwrap() > over);
}

/// The first move was never answered; the second is answered late.
#[test]
fn lost_move_before_a_confirmed_stop_leaves_no_later_stop_in_doubt() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    let answer = |master: &mut Master<2>, data, at| {
        master.handle_line(&Frame { address: Target::Motor(id(1)), data }, at)
    };
    let _ = ask(&mut master, 1, step(), ms(0));
    assert_eq!(events(&mut master, ms(6)).len(), 1);
    assert_eq!(events(&mut master, ms(17)), []);
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(18)).len(), 1);
    assert_eq!(answer(&mut master, Shutdown.encode(), ms(19)), confirmed(1));
    master.lift_stop();
    let _ = ask(&mut master, 1, step(), ms(20));
    assert_eq!(events(&mut master, ms(26)).len(), 1);
    let late = answer(&mut master, [0xA8, 30, 0, 0, 0, 0, 0, 0], ms(28));
    assert!(matches!(late, Some(Event::Stray { .. })), "{late:?}");
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(29)).len(), 1);
    assert_eq!(answer(&mut master, Shutdown.encode(), ms(30)), confirmed(1));
}

#[test]
fn on_rs485_set_point_waits_for_the_answers_to_a_broadcast_read() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.set_point(id(1), torque(1.0), ms(1)).unwrap();
    assert_eq!(sent(&mut master, ms(1)), []);
    let angle = Frame { address: Target::Motor(id(1)), data: ANGLE_REPLY };
    assert!(master.handle_line(&angle, ms(2)).is_some());
    assert_eq!(sent(&mut master, ms(3)).len(), 1);
}

fn off(master: &mut Master<2>, at: u64) -> Option<Event> {
    master.handle_line(&Frame { address: Target::Motor(id(1)), data: Shutdown.encode() }, ms(at))
}

/// Lifts the stop and stops the motor anew, with a set-point in between; that stop is not heard.
fn is_moved_and_stopped_in_vain(master: &mut Master<2>, at: u64) {
    master.lift_stop();
    master.set_point(id(1), torque(1.0), ms(at)).unwrap();
    assert_eq!(sent(master, ms(at)), [packet_to(1, torque(1.0).encode())]);
    master.handle_line(&Frame { address: Target::Motor(id(1)), data: TORQUE_REPLY }, ms(at));
    master.stop(id(1), StopKind::Off).unwrap();
    let at = ms(at) + Duration::from_micros(200);
    assert_eq!(sent(master, at), [packet_to(1, Shutdown.encode())]);
}

/// An adapter may hold the answer to the stop to all back, so that it comes after that to the motor's own.
#[test]
fn on_rs485_answer_to_a_stop_to_all_confirms_no_stop_of_the_motor() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    master.stop_all(StopKind::Off, id(1).into()).unwrap();
    let frames: Vec<Packet> = (0..7).flat_map(|now| sent(&mut master, ms(now))).collect();
    assert_eq!(frames, [packet_to_all(Shutdown.encode()), packet_to(1, Shutdown.encode())]);
    assert_eq!(off(&mut master, 7), None, "it may be that to all");
    assert_eq!(sent(&mut master, ms(8)), [packet_to(1, Shutdown.encode())]);
    assert_eq!(off(&mut master, 9), confirmed(1));
    is_moved_and_stopped_in_vain(&mut master, 10);
    assert_eq!(off(&mut master, 11), None);
    assert_eq!(sent(&mut master, ms(12)).len(), 1);
    assert_eq!(off(&mut master, 13), confirmed(1));
}

/// An answer to the stop to all that comes at once costs no second stop.
#[test]
fn on_rs485_answer_to_a_stop_to_all_may_precede_the_motors_own_stop() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    master.stop_all(StopKind::Off, id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(0)), [packet_to_all(Shutdown.encode())]);
    assert_eq!(off(&mut master, 1), None);
    assert_eq!(sent(&mut master, ms(6)), [packet_to(1, Shutdown.encode())]);
    assert_eq!(off(&mut master, 7), confirmed(1));
}

/// Each of several sendings has its whole time, whichever is answered first.
#[test]
fn on_rs485_answer_to_an_earlier_sending_confirms_no_later_stop() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    assert_eq!(sent(&mut master, ms(6)).len(), 1, "it was not answered");
    assert_eq!(off(&mut master, 7), confirmed(1));
    assert_eq!(events(&mut master, ms(20)), []);
    is_moved_and_stopped_in_vain(&mut master, 20);
    // The second has until then, and 10.262 ms more: 6 ms and 5.262 ms.
    assert_eq!(off(&mut master, 21), None);
}

#[test]
fn request_with_fifteen_attempts_is_not_taken_for_a_stop() {
    let mut master = Master::<4>::new(Config::rs485(1_000_000, false));
    let often = Patience { reply_timeout: Duration::from_millis(5), attempts: 15 };
    let _ = master.request_with(id(1), ReadModel, often).unwrap();
    assert!(master.poll_transmit(ms(0)).is_some());
    assert!(!master.offers_first_stop());
}

/// The line keeps the order: the set-point that was lost came before the one that was answered.
#[test]
fn on_rs485_feedback_ends_the_doubt_about_earlier_set_points() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    let answer = |master: &mut Master<2>, data, at| {
        master.handle_line(&Frame { address: Target::Motor(id(1)), data }, at)
    };
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    assert_eq!(events(&mut master, ms(6)).len(), 1);
    master.set_point(id(1), torque(2.0), ms(13)).unwrap();
    assert_eq!(sent(&mut master, ms(13)).len(), 1);
    answer(&mut master, TORQUE_REPLY, ms(14)).unwrap();
    events(&mut master, ms(17));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(18)).len(), 1);
    assert_eq!(answer(&mut master, Shutdown.encode(), ms(19)), confirmed(1));
}

/// Motor 1 is to be off, so that the hold to all goes to motor 2 individually.
#[test]
fn on_rs485_individual_hold_waits_for_the_answer_to_a_read() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    let off = Frame { address: Target::Motor(id(1)), data: Shutdown.encode() };
    assert_eq!(master.handle_line(&off, ms(1)), confirmed(1));
    let _read = master.request(id(2), ReadModel).unwrap();
    assert_eq!(sent(&mut master, ms(2)).len(), 1);
    master.broadcast(Stop, MotorSet::EMPTY).unwrap();
    for now in 3..7 {
        assert_eq!(sent(&mut master, ms(now)), [], "at {now} ms");
    }
    assert_eq!(sent(&mut master, ms(7)), [packet_to(2, Stop.encode())]);
}

/// Motor 1 has confirmed a hold; switching it off delays no motor that has got no stop yet.
#[test]
fn first_stop_is_sent_before_the_second_stop_of_another_motor() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    obeys(&mut master, 1);
    let hold = |motor| Frame { address: Target::Motor(id(motor)), data: Stop.encode() };
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(sent(&mut master, ms(0)), [packet_to(1, Stop.encode())]);
    assert_eq!(master.handle_line(&hold(1), ms(1)), confirmed(1));
    master.stop(id(1), StopKind::Off).unwrap();
    master.stop(id(2), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(2)), [packet_to(2, Shutdown.encode())]);
}

/// Its answer came too late to count, but it came.
#[test]
fn motor_heard_since_its_request_is_stopped_before_a_silent_one() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    let _ = master.request_with(id(1), ReadMultiTurnAngle, once(2)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    assert_eq!(events(&mut master, ms(2)).len(), 1);
    let _ = master.request_with(id(2), ReadMultiTurnAngle, once(2)).unwrap();
    assert_eq!(sent(&mut master, ms(3)).len(), 1);
    assert_eq!(events(&mut master, ms(5)).len(), 1);
    master.handle_line(&Frame { address: Target::Motor(id(2)), data: ANGLE_REPLY }, ms(6)).unwrap();
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    let stops: Vec<Packet> = (7..14).flat_map(|now| sent(&mut master, ms(now))).collect();
    assert_eq!(stops, [packet_to_all(Stop.encode()), packet_to(2, Stop.encode())]);
}

/// The stop was confirmed or given up before, and is called for once more during the request.
#[test]
fn repeated_stop_waits_50_ms_for_another_motors_patient_request() {
    for is_given_up_before in [false, true] {
        let mut master = Master::<4>::new(Config::rs485(1_000_000, false));
        let mut asked_at = 10;
        master.stop(id(1), StopKind::Off).unwrap();
        if is_given_up_before {
            asked_at += is_given_up(&mut master, 1, 0);
        } else {
            assert_eq!(sent(&mut master, ms(0)), [packet_to(1, Shutdown.encode())]);
            let frame = Frame { address: Target::Motor(id(1)), data: Shutdown.encode() };
            assert_eq!(master.handle_line(&frame, ms(1)), confirmed(1));
        }
        let patience = Patience { reply_timeout: Duration::from_secs(10), attempts: 1 };
        let _model = master.request_with(id(2), ReadModel, patience).unwrap();
        assert_eq!(sent(&mut master, ms(asked_at)), [packet_to(2, ReadModel.encode())]);
        master.stop(id(1), StopKind::Off).unwrap();
        let goes =
            |now: &u64| sent(&mut master, ms(*now)).contains(&packet_to(1, Shutdown.encode()));
        let sent_at = (asked_at + 1..asked_at + 200).find(goes);
        // Its time is up after 50 ms.
        assert_eq!(sent_at, Some(asked_at + 50), "{is_given_up_before}");
    }
}

/// When motor 2 confirms its stop, 1 ms from now or later, while motor 1 is let go and stopped anew every millisecond
/// and answers after 900 us.
fn confirms_while_another_is_stopped_anew(master: &mut Master<2>, from: u64) -> Option<u64> {
    (from + 1..from + 1_000).find(|&now| {
        master.lift_stop_of(id(1));
        master.stop(id(1), StopKind::Off).unwrap();
        let [Packet { channel: Channel::Command(address), data }] = sent(master, ms(now))[..]
        else {
            return false;
        };
        let answered = ms(now) + Duration::from_micros(900);
        master.handle_line(&Frame { address, data }, answered) == confirmed(2)
    })
}

#[test]
fn lost_stop_is_resent_though_another_motor_is_stopped_in_every_cycle() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    obeys(&mut master, 1);
    master.stop(id(2), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(0)), [packet_to(2, Shutdown.encode())]);
    // Behind the time-out of the first.
    assert_eq!(confirms_while_another_is_stopped_anew(&mut master, 0), Some(7));
}

/// Motor 2 seems dead, and is not known to be alive.
#[test]
fn motor_with_lost_answers_is_stopped_during_cyclic_stops_of_another() {
    for lost in 1..4 {
        let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
        let mut now = 0;
        for _ in 0..lost {
            let _read = master.request_with(id(2), ReadModel, once(5)).unwrap();
            assert_eq!(sent(&mut master, ms(now)).len(), 1);
            assert_eq!(events(&mut master, ms(now + 6)).len(), 1);
            now += 40;
        }
        master.stop(id(1), StopKind::Off).unwrap();
        assert_eq!(sent(&mut master, ms(now)), [packet_to(1, Shutdown.encode())]);
        master.stop(id(2), StopKind::Off).unwrap();
        let at = confirms_while_another_is_stopped_anew(&mut master, now);
        assert_eq!(at, Some(now + 6), "{lost} answers were lost");
    }
}

/// The last stop to all was sent less than 100 ms ago, but motor 1 was moved since.
#[test]
fn stop_to_all_is_sent_at_once_if_a_motor_was_moved_since_the_last() {
    for is_moved in [false, true] {
        let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
        let says = |master: &mut Master<2>, data, at| {
            master.handle_line(&Frame { address: Target::Motor(id(1)), data }, ms(at))
        };
        let _read = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
        says(&mut master, ANGLE_REPLY, 1).unwrap();
        master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
        assert_eq!(sent(&mut master, ms(10)), [packet_to_all(Shutdown.encode())]);
        // Its first answer may be that to the one to all.
        for (at, expected) in [(17, None), (19, confirmed(1))] {
            assert_eq!(sent(&mut master, ms(at)), [packet_to(1, Shutdown.encode())]);
            assert_eq!(says(&mut master, Shutdown.encode(), at + 1), expected);
        }
        master.lift_stop();
        if is_moved {
            master.set_point(id(1), torque(1.0), ms(22)).unwrap();
            assert_eq!(sent(&mut master, ms(22)).len(), 1);
            says(&mut master, TORQUE_REPLY, 23).unwrap();
        }
        master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
        let to_all = packet_to_all(Shutdown.encode());
        assert_eq!(sent(&mut master, ms(24)).contains(&to_all), is_moved);
    }
}

/// The port takes nothing meanwhile, so motors without a place have not heard the stop yet.
#[test]
fn waiting_stop_to_all_is_sent_though_lifted_and_called_again() {
    for (kind, data) in [(StopKind::Off, Shutdown.encode()), (StopKind::Hold, Stop.encode())] {
        let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
        master.stop_all(kind, id(1).into()).unwrap();
        assert_eq!(sent(&mut master, ms(10)), [packet_to_all(data)]);
        for at in [17, 19] {
            assert_eq!(sent(&mut master, ms(at)), [packet_to(1, data)]);
            let answer = Frame { address: Target::Motor(id(1)), data };
            master.handle_line(&answer, ms(at + 1));
        }
        master.lift_stop();
        master.set_point(id(1), torque(1.0), ms(22)).unwrap();
        assert_eq!(sent(&mut master, ms(22)).len(), 1);
        master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
        master.lift_stop();
        master.stop_all(kind, MotorSet::EMPTY).unwrap();
        assert_eq!(sent(&mut master, ms(50)), [packet_to_all(data)]);
    }
}

/// Nothing else tells motor 2 to stop; motor 1 is as it was.
#[test]
fn stop_to_all_is_sent_at_once_if_one_of_two_was_moved_or_forgotten() {
    for (is_moved, is_forgotten) in [(false, false), (true, false), (false, true)] {
        let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
        let says = |master: &mut Master<2>, address, data, now| {
            let answered = ms(now) + Duration::from_micros(900);
            master.handle_line(&Frame { address, data }, answered)
        };
        let to_all = packet_to_all(Shutdown.encode());
        master.stop_all(StopKind::Off, [id(1), id(2)].into()).unwrap();
        let mut packets = Vec::new();
        for now in 0..50 {
            for packet in sent(&mut master, ms(now)) {
                packets.push(packet);
                if let Channel::Command(motor @ Target::Motor(_)) = packet.channel {
                    says(&mut master, motor, packet.data, now);
                }
            }
        }
        assert_eq!(packets[0], to_all);
        master.lift_stop();
        if is_moved {
            master.set_point(id(2), torque(1.0), ms(50)).unwrap();
            assert_eq!(sent(&mut master, ms(50)).len(), 1);
            says(&mut master, id(2).into(), TORQUE_REPLY, 50).unwrap();
        }
        if is_forgotten {
            assert!(master.forget(id(2)));
        }
        master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
        let goes = sent(&mut master, ms(52)).contains(&to_all);
        assert_eq!(goes, is_moved || is_forgotten, "{is_moved} {is_forgotten}");
    }
}

/// On CAN, an exchange that a stop takes the place of may be answered as late as the stop. Here nothing is in flight
/// any more when the stop is sent.
#[test]
fn on_rs485_stop_does_not_extend_the_late_window_of_a_read() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    let _read = master.request_with(id(1), ReadModel, once(5)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    events(&mut master, ms(5));
    // Its late window ends at 15.26 ms.
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(12)).len(), 1);
    let answer = Frame { address: id(1).into(), data: Shutdown.encode() };
    assert_eq!(master.handle_line(&answer, ms(13)), confirmed(1));
    master.lift_stop();
    let _read = master.request(id(1), ReadModel).unwrap();
    assert_eq!(sent(&mut master, ms(15)), []);
    assert_eq!(sent(&mut master, ms(16)).len(), 1);
}

/// A frame that nobody asked for delays no stop. This one ends the exchange that the stop of motor 2 has waited for.
#[test]
fn stop_waits_a_turnaround_after_the_answer_to_a_patient_read() {
    let config = Config::rs485(1_000_000, false);
    let Bus::Rs485 { turnaround, .. } = config.bus else { unreachable!() };
    let mut master = Master::<2>::new(config);
    let patient = Patience { reply_timeout: Duration::from_millis(200), attempts: 1 };
    let _read = master.request_with(id(1), ReadMultiTurnAngle, patient).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.stop(id(2), StopKind::Off).unwrap();
    let answer = Frame { address: Target::Motor(id(1)), data: ANGLE_REPLY };
    assert!(master.handle_line(&answer, ms(30)).is_some());
    assert_eq!(sent(&mut master, ms(30)), [], "the drive still drives the line");
    assert_eq!(master.poll_at(), Some(ms(30) + turnaround));
    assert_eq!(sent(&mut master, ms(30) + turnaround), [packet_to(2, Shutdown.encode())]);
}
