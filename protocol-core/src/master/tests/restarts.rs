//! Restarts: the pause after one that was requested, and what the angle of a stream shows of others. 180 degrees and
//! 10,000 dps between two replies are no jump.

use super::*;

/// Streams a set-point at this time and hears that angle this long after it. Returns whether that shows a restart.
fn is_restart(master: &mut Master<2>, sent_us: u64, after_us: u64, degrees: i16) -> bool {
    let [at, then] = [sent_us, sent_us + after_us].map(Instant::from_micros);
    master.set_point(id(1), torque(1.0), at).unwrap();
    assert_eq!(sent(master, at).len(), 1);
    let [low, high] = degrees.to_le_bytes();
    let event = reply(master, 1, [0xA1, 0x32, 0x64, 0, 0, 0, low, high], then);
    assert!(matches!(event, Some(Event::Feedback { .. })), "{event:?}");
    let reported = events(master, then);
    assert!(reported.iter().all(|event| matches!(event, Event::Restarted { .. })), "{reported:?}");
    !reported.is_empty()
}

/// Whether that angle, and then this one, each a millisecond after its set-point, shows a restart.
fn is_jump(first: i16, second: i16, between_us: u64) -> bool {
    let mut master = Master::<2>::new(Config::CAN);
    assert!(!is_restart(&mut master, 0, 1_000, first), "there is none before the first");
    is_restart(&mut master, between_us, 1_000, second)
}

#[test]
fn turn_lost_during_a_stream_is_a_restart() {
    let mut master = Master::<2>::new(Config::CAN);
    for cycle in 0..5 {
        assert!(!is_restart(&mut master, 4_000 * cycle, 1_000, 720));
    }
    master.set_point(id(1), torque(1.0), ms(20)).unwrap();
    sent(&mut master, ms(20));
    let moving = master.request(id(1), step()).unwrap();
    master.set_point(id(1), torque(2.0), ms(20)).unwrap();
    reply(&mut master, 1, [0xA1, 0x32, 0x64, 0, 0, 0, 0x68, 1], ms(21)).unwrap();
    let reported = events(&mut master, ms(21));
    assert!(reported.contains(&Event::Restarted { motor: id(1) }), "720 became 360: {reported:?}");
    assert!(reported.contains(&Event::SetPointDropped { motor: id(1) }), "{reported:?}");
    assert!(reported.iter().any(|event| moving.outcome(event) == Some(Err(Failure::Dropped))));
    assert_eq!(sent(&mut master, ms(21)), []);
    let refused = master.set_point(id(1), torque(1.0), ms(21));
    assert_eq!(refused, Err(RequestError::Restarted));
    // Where it is now is where it goes on.
    master.resume(id(1));
    assert!(!is_restart(&mut master, 30_000, 1_000, 361));
}

#[test]
fn angle_that_the_fastest_motor_can_reach_is_no_restart() {
    // 500 dps, for a second; and in steps of a second, of which some replies were lost.
    let mut master = Master::<2>::new(Config::CAN);
    for cycle in 0..100 {
        assert!(!is_restart(&mut master, 10_000 * cycle, 1_000, 5 * cycle as i16));
    }
    assert!(!is_jump(0, 500, 1_000_000));
    // 180 degrees and 10 a millisecond, either way.
    for sign in [1, -1] {
        assert!(!is_jump(0, sign * 220, 4_000));
        assert!(is_jump(0, sign * 221, 4_000));
        assert!(!is_jump(0, sign * 280, 10_000));
        assert!(is_jump(0, sign * 281, 10_000));
    }
    // Where the angle has no more room it may go on at its other end.
    assert!(!is_jump(32_760, -32_760, 4_000));
    assert!(!is_jump(-32_760, 32_760, 4_000));
    assert!(is_jump(-32_768, 0, 4_000));
    assert!(!is_jump(-32_768, 0, 3_600_000_000));
}

#[test]
fn angle_of_unknown_time_shows_no_restart() {
    // The reply that waited for 18 ms on its way is as old as its set-point.
    for (waited_us, is_reported) in [(18_000, true), (18_100, false)] {
        let mut master = Master::<2>::new(Config::CAN);
        is_restart(&mut master, 0, waited_us, 0);
        assert_eq!(is_restart(&mut master, 20_000, 1_000, 360), is_reported, "{waited_us}");
    }
    // One that is late.
    let mut master = Master::<2>::new(Config::CAN);
    assert!(!is_restart(&mut master, 90_000, 1_000, 0));
    master.set_point(id(1), torque(1.0), ms(100)).unwrap();
    sent(&mut master, ms(100));
    events(&mut master, ms(121));
    reply(&mut master, 1, [0xA1, 0x32, 0x64, 0, 0, 0, 0, 0], ms(130)).unwrap();
    assert!(!is_restart(&mut master, 131_000, 1_000, 360));
}

/// While the stream does not rest, each reply may be that to the set-point before.
#[test]
fn lost_reply_hides_no_restart() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    sent(&mut master, ms(0));
    assert_eq!(events(&mut master, ms(21)), [Event::SetPointUnanswered { motor: id(1) }]);
    for cycle in 0..100 {
        assert!(!is_restart(&mut master, 21_000 + 2_000 * cycle, 1_000, 720));
    }
    assert!(is_restart(&mut master, 221_000, 1_000, 360));
}

/// The reply comes after its time-out, or takes long: where the motor was before is known.
#[test]
fn reply_of_unknown_time_hides_no_restart() {
    for (lost_at, answered_us) in [(None, 19_000), (Some(ms(25)), 22_000)] {
        let mut master = Master::<2>::new(Config::CAN);
        assert!(!is_restart(&mut master, 0, 1_000, 720));
        master.set_point(id(1), torque(1.0), ms(4)).unwrap();
        assert_eq!(sent(&mut master, ms(4)).len(), 1);
        if let Some(lost_at) = lost_at {
            assert_eq!(events(&mut master, lost_at), [Event::SetPointUnanswered { motor: id(1) }]);
        }
        let answered = ms(4) + Duration::from_micros(answered_us);
        let slow = reply(&mut master, 1, [0xA1, 0x32, 0x64, 0, 0, 0, 0xD0, 2], answered);
        assert!(matches!(slow, Some(Event::Feedback { .. })), "{slow:?}");
        // Two turns and more within 28 ms: half a turn and 280 degrees are possible.
        assert!(is_restart(&mut master, 28_000, 1_000, 0), "{answered_us}");
    }
}

#[test]
fn echo_of_a_set_point_shows_no_restart() {
    // The message of a drive that has lost its master was lost, and an echo that is all 0 counts as feedback.
    let mut master = Master::<2>::new(Config::CAN);
    for (cycle, data) in
        [[0xA1, 0x32, 0, 0, 0, 0, 0, 2], torque(0.0).encode(), [0xA1, 0x32, 0, 0, 0, 0, 1, 2]]
            .iter()
            .enumerate()
    {
        let now = ms(4 * cycle as u64);
        master.set_point(id(1), torque(0.0), now).unwrap();
        sent(&mut master, now);
        let event = reply(&mut master, 1, *data, now + Duration::from_millis(1));
        assert!(matches!(event, Some(Event::Feedback { .. })), "{event:?}");
        assert_eq!(events(&mut master, now + Duration::from_millis(1)), []);
    }
}

#[test]
fn angles_of_two_scales_are_not_compared() {
    // Motion mode clips at ±12.5 rad, or at what its firmware has for that.
    let mut master = Master::<2>::new(Config::CAN);
    for cycle in 0..4 {
        let at = 8_000 * cycle;
        assert!(!is_restart(&mut master, at, 1_000, 3_000 * cycle as i16));
        let now = Instant::from_micros(at + 4_000);
        master.set_point(id(1), motion(), now).unwrap();
        sent(&mut master, now);
        motion_feedback(&mut master, now + Duration::from_millis(1)).unwrap();
        assert_eq!(events(&mut master, now + Duration::from_millis(1)), []);
    }
}

#[test]
fn a_stop_does_not_shorten_the_pause_of_a_restart() {
    let mut master = Master::<2>::new(Config::CAN);
    let _reset = ask(&mut master, 1, Reset, ms(0));
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    let mut stops = 0;
    let mut read_at = None;
    for now in 100..2_500 {
        for packet in sent(&mut master, ms(now)) {
            match packet.data[0] {
                0x81 => stops += 1,
                _ => read_at = read_at.or(Some(now)),
            }
        }
        let reported = events(&mut master, ms(now));
        if reported.contains(&Event::StopUnconfirmed { motor: id(1) }) {
            master.lift_stop();
            let _read = master.request(id(1), ReadMultiTurnAngle).unwrap();
        }
    }
    assert_eq!(stops, 15, "nobody heard it");
    assert_eq!(read_at, Some(2_000));
}

#[test]
fn stream_is_refused_after_a_reset_until_the_motor_is_resumed() {
    let mut master = Master::<2>::new(Config::CAN);
    let reset = ask(&mut master, 1, Reset, ms(0));
    let reported = events(&mut master, ms(0));
    assert!(reported.iter().any(|event| reset.outcome(event) == Some(Ok(NoReply))), "{reported:?}");
    assert!(
        reported.contains(&Event::Restarted { motor: id(1) }),
        "for whoever streams: {reported:?}"
    );
    for now in [1, 2_000, 3_000] {
        let refused = master.set_point(id(1), torque(1.0), ms(now));
        assert_eq!(refused, Err(RequestError::Restarted), "its turns are lost");
        assert_eq!(sent(&mut master, ms(now)), []);
    }
    master.resume(id(1));
    assert_eq!(master.set_point(id(1), torque(1.0), ms(3_000)), Ok(()));
}

#[test]
fn set_point_that_waits_when_a_reset_is_sent_is_dropped() {
    let mut master = Master::<2>::new(Config::CAN);
    let _reset = master.request(id(1), Reset).unwrap();
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    assert_eq!(sent(&mut master, ms(0)), [Reset.packet(id(1))]);
    assert!(events(&mut master, ms(0)).contains(&Event::SetPointDropped { motor: id(1) }));
}

#[test]
fn stream_is_refused_after_a_reset_to_all() {
    let mut master = Master::<2>::new(Config::CAN);
    assert!(!is_restart(&mut master, 0, 1_000, 0));
    master.broadcast(Reset, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(50)).len(), 1);
    assert!(events(&mut master, ms(50)).contains(&Event::Restarted { motor: id(1) }));
    assert_eq!(master.set_point(id(1), torque(1.0), ms(51)), Err(RequestError::Restarted));
}

#[test]
fn seen_restart_ends_a_waiting_move_to_all() {
    let mut master = Master::<2>::new(Config::CAN);
    assert!(!is_restart(&mut master, 0, 1_000, 720));
    // It waits for the read, whose repetition could be taken for an answer to it.
    let _read = master.request(id(2), ReadMultiTurnAngle).unwrap();
    master.set_point(id(1), torque(1.0), ms(4)).unwrap();
    assert_eq!(sent(&mut master, ms(4)).len(), 2);
    master.broadcast(torque(1.0), [id(1), id(2)].into_iter().collect()).unwrap();
    reply(&mut master, 2, ANGLE_REPLY, ms(5)).unwrap();
    reply(&mut master, 1, [0xA1, 0x32, 0x64, 0, 0, 0, 0x68, 1], ms(5)).unwrap();
    assert_eq!(master.poll_transmit(ms(5)), None, "nobody has looked at the time since");
    let over =
        Event::BroadcastDone { silent: [id(1), id(2)].into_iter().collect(), was_sent: false };
    assert!(events(&mut master, ms(5)).contains(&over));
}

#[test]
fn one_or_two_bus_errors_are_neither_a_restart_nor_silence() {
    let mut master = Master::<2>::new(Config::CAN);
    assert!(!is_restart(&mut master, 0, 1_000, 0));
    // It rested for longer than a restart takes.
    for (errors, presence) in
        [(1, Presence::Present), (2, Presence::Present), (3, Presence::Silent)]
    {
        master.set_point(id(1), torque(1.0), ms(5_000 + errors)).unwrap();
        master.handle_bus_down(ms(5_000 + errors));
        assert_eq!(master.health(id(1)).presence, presence, "{errors}");
        assert_eq!(master.has_restarted(id(1)), errors == 3);
        events(&mut master, ms(5_000 + errors));
    }
}

#[test]
fn stream_is_refused_after_a_second_of_silence_until_resumed() {
    let mut master = Master::<2>::new(Config::CAN);
    let mut now = 0;
    master.set_point(id(1), motion(), ms(0)).unwrap();
    sent(&mut master, ms(0));
    motion_feedback(&mut master, ms(1)).unwrap();
    // Silent for 1 s, as long as a restart takes: the first set-point that it heard then would move it.
    let reported_at = loop {
        now += 5;
        let _is_refused = master.set_point(id(1), motion(), ms(now));
        sent(&mut master, ms(now));
        let reported = events(&mut master, ms(now + 4));
        if reported.contains(&Event::Restarted { motor: id(1) }) {
            break now;
        }
        assert!(now < 2_000, "{reported:?}");
    };
    assert!((1_000..1_030).contains(&reported_at), "{reported_at}");
    let refused = master.set_point(id(1), motion(), ms(now + 5));
    assert_eq!(refused, Err(RequestError::Restarted));
    assert_eq!(sent(&mut master, ms(now + 5)), []);
    // Its answer says so once more: now it can be asked where it is.
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(now + 100));
    reply(&mut master, 1, ANGLE_REPLY, ms(now + 101)).unwrap();
    assert!(events(&mut master, ms(now + 101)).contains(&Event::Restarted { motor: id(1) }));
    let moved = master.request(
        id(1),
        IncrementalPosition { max_speed: MaxSpeed::from_raw(10), angle: Angle::from_raw(100) },
    );
    assert!(matches!(moved, Err(RequestError::Restarted)));
    master.resume(id(1));
    assert!(master.set_point(id(1), motion(), ms(now + 5)).is_ok());
}

/// Motor 1 says at `at` that it has run for this long, a millisecond after it was asked. Returns whether a restart was
/// reported. The caller has then resumed it.
fn has_run(master: &mut Master<2>, run_ms: u32, at: u64) -> bool {
    let _ = ask(master, 1, ReadRunTime, ms(at - 1));
    let [a, b, c, d] = run_ms.to_le_bytes();
    reply(master, 1, [0xB1, 0, 0, 0, a, b, c, d], ms(at)).unwrap();
    let is_reported = events(master, ms(at)).contains(&Event::Restarted { motor: id(1) });
    master.resume(id(1));
    is_reported
}

#[test]
fn run_time_that_goes_back_is_a_restart() {
    let mut master = Master::<2>::new(Config::CAN);
    for (at, run_ms) in [(1, 60_000), (11, 60_010), (21, 300)] {
        assert_eq!(has_run(&mut master, run_ms, at), at == 21, "{at}");
    }
}

/// The power was off while the motor was not asked: it has run for longer than it said then, and for less long than
/// since.
#[test]
fn motor_with_a_run_time_shorter_than_it_is_known_has_restarted() {
    // It was heard at 1 ms, or has said then how long it had run.
    for has_said in [false, true] {
        let mut master = Master::<2>::new(Config::CAN);
        if has_said {
            assert!(!has_run(&mut master, 900, 1));
        } else {
            let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
            reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
        }
        assert!(has_run(&mut master, 1_000, 10_000), "{has_said}");
        assert!(!has_run(&mut master, 2_000, 11_000), "once");
        assert!(!has_run(&mut master, 601_000, 610_000));
        assert!(has_run(&mut master, 3_600_000 - 601_000, 3_600_000), "ten minutes ago");
    }
}

/// However long the master itself has run.
#[test]
fn short_run_time_of_a_motor_heard_first_is_no_restart() {
    let mut master = Master::<2>::new(Config::CAN);
    assert!(!has_run(&mut master, 1_500, 60_000));
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(59_000));
    reply(&mut master, 1, ANGLE_REPLY, ms(59_001)).unwrap();
    assert!(!has_run(&mut master, 1_500, 60_000));
}

/// The motor is known for 11 s, and has run for 9 s. A long time-out for an answer that comes at once changes nothing.
#[test]
fn patient_read_of_the_run_time_shows_a_restart_like_any_other() {
    for timeout_ms in [20, 2_000] {
        let mut master = Master::<2>::new(Config::CAN);
        assert!(!has_run(&mut master, 1_000, 1));
        let _read = master.request_with(id(1), ReadRunTime, once(timeout_ms)).unwrap();
        assert_eq!(sent(&mut master, ms(10_000)).len(), 1);
        reply(&mut master, 1, [0xB1, 0, 0, 0, 0x28, 0x23, 0, 0], ms(10_001)).unwrap();
        let reported = events(&mut master, ms(10_001));
        assert_eq!(reported, [Event::Restarted { motor: id(1) }], "{timeout_ms}");
    }
}

#[test]
fn drives_clock_may_differ_by_a_hundredth_and_wrap_after_seven_weeks() {
    let mut master = Master::<2>::new(Config::CAN);
    assert!(!has_run(&mut master, 1_000, 1));
    // By a hundredth slow, and then fast.
    assert!(!has_run(&mut master, 3_565_000, 3_600_000));
    assert!(!has_run(&mut master, 7_300_000, 7_200_000));
    // A motor that is heard for the first time may have run for weeks, and is then known for weeks.
    const A_DAY: u64 = 24 * 3_600_000;
    for days in [1, 8, 30, 45, 49] {
        let mut master = Master::<2>::new(Config::CAN);
        let weeks = (days * A_DAY) as u32;
        assert!(!has_run(&mut master, weeks, 1_000), "{days}");
        let mut master = Master::<2>::new(Config::CAN);
        assert!(!has_run(&mut master, 1_000, 1_000));
        assert_eq!(has_run(&mut master, 10_000, days * A_DAY), days < 48, "{days}");
        let mut master = Master::<2>::new(Config::CAN);
        assert!(!has_run(&mut master, 1_000, 1_000));
        assert!(!has_run(&mut master, weeks, days * A_DAY), "{days}");
    }
    let mut master = Master::<2>::new(Config::CAN);
    assert!(!has_run(&mut master, u32::MAX - 1_000, 1_000));
    assert!(!has_run(&mut master, 8_999, 11_000));
    // The caller has not looked for five seconds after the answer.
    let _ = ask(&mut master, 1, ReadRunTime, ms(20_000));
    reply(&mut master, 1, [0xB1, 0, 0, 0, 0x50, 0x46, 0, 0], ms(25_000));
    assert!(!events(&mut master, ms(25_000)).contains(&Event::Restarted { motor: id(1) }));
}

#[test]
fn reset_is_reported_as_a_restart_once() {
    let mut master = Master::<2>::new(Config::CAN);
    assert!(!has_run(&mut master, 60_000, 1));
    let _reset = ask(&mut master, 1, Reset, ms(2));
    assert!(events(&mut master, ms(2)).contains(&Event::Restarted { motor: id(1) }));
    master.resume(id(1));
    // It was back a second later.
    assert!(!has_run(&mut master, 1_900, 3_000));
}

/// The stop was lifted, and the motor was asked nothing since.
#[test]
fn motor_silent_for_a_second_after_an_unconfirmed_stop_is_not_moved() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    let now = is_given_up(&mut master, 1, 2);
    master.lift_stop();
    assert!(master.clone().set_point(id(1), torque(1.0), ms(now)).is_ok(), "for a short time");
    let now = now + 1_000;
    events(&mut master, ms(now));
    assert_eq!(master.set_point(id(1), torque(1.0), ms(now)), Err(RequestError::Restarted));
    assert_eq!(master.request(id(1), step()).err(), Some(RequestError::Restarted));
    master.resume(id(1));
    assert!(master.clone().set_point(id(1), torque(1.0), ms(now)).is_ok(), "the caller knows");
    events(&mut master, ms(now));
    assert!(master.request(id(1), ReadMultiTurnAngle).is_ok());
}

/// The motor was resumed before it was asked for the last time, and did not answer that for a second.
#[test]
fn motor_resumed_before_an_unanswered_request_is_not_moved() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    for at in [500, 700] {
        let _read = master.request_with(id(1), ReadModel, once(20)).unwrap();
        assert_eq!(sent(&mut master, ms(at)).len(), 1);
        assert_eq!(events(&mut master, ms(at + 20)).len(), 1);
        if at == 500 {
            master.resume(id(1));
        }
    }
    events(&mut master, ms(2_000));
    assert_eq!(master.set_point(id(1), torque(1.0), ms(2_000)), Err(RequestError::Restarted));
}

#[test]
fn move_to_all_is_refused_while_a_motor_was_silent_for_a_second() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    let _ = master.request_with(id(1), ReadModel, once(5)).unwrap();
    assert_eq!(sent(&mut master, ms(2)).len(), 1);
    assert_eq!(events(&mut master, ms(7)).len(), 1);
    events(&mut master, ms(1_100));
    let moved = master.broadcast(torque(1.0), MotorSet::EMPTY);
    assert_eq!(moved, Err(RequestError::Restarted));
    assert_eq!(events(&mut master, ms(1_100)), [Event::Restarted { motor: id(1) }]);
}

#[test]
fn motor_that_was_not_asked_for_long_has_not_restarted() {
    let mut master = Master::<2>::new(Config::CAN);
    for at in [0, 2_000] {
        let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(at));
        reply(&mut master, 1, ANGLE_REPLY, ms(at + 1)).unwrap();
        assert_eq!(events(&mut master, ms(at + 1)), []);
    }
}

#[test]
fn move_that_waits_when_a_restart_is_seen_is_dropped() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    sent(&mut master, ms(0));
    reply(&mut master, 1, TORQUE_REPLY, ms(1)).unwrap();
    for now in [10, 40, 70] {
        master.set_point(id(1), torque(1.0), ms(now)).unwrap();
        sent(&mut master, ms(now));
        events(&mut master, ms(now + 25));
    }
    master.set_point(id(1), torque(1.0), ms(1_000)).unwrap();
    sent(&mut master, ms(1_000));
    let moving = master.request(id(1), step()).unwrap();
    reply(&mut master, 1, TORQUE_REPLY, ms(1_002)).unwrap();
    assert_eq!(sent(&mut master, ms(1_002)), []);
    let reported = events(&mut master, ms(1_002));
    assert!(reported.contains(&Event::Restarted { motor: id(1) }), "{reported:?}");
    assert!(reported.iter().any(|event| moving.outcome(event) == Some(Err(Failure::Dropped))));
}

#[test]
fn restart_noted_by_the_caller_drops_and_refuses_set_points() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    master.set_point(id(1), motion(), ms(2)).unwrap();
    master.note_restart(id(1));
    assert!(master.has_restarted(id(1)) && !master.has_restarted(id(2)));
    assert_eq!(sent(&mut master, ms(2)), []);
    let reported = events(&mut master, ms(2));
    assert_eq!(
        reported,
        [Event::SetPointDropped { motor: id(1) }, Event::Restarted { motor: id(1) }]
    );
    assert_eq!(master.set_point(id(1), motion(), ms(3)), Err(RequestError::Restarted));
}

#[test]
fn move_handed_back_after_a_noted_restart_is_not_sent_again() {
    for is_stream in [true, false] {
        let mut master = Master::<2>::new(Config::CAN);
        if is_stream {
            master.set_point(id(1), torque(1.0), ms(0)).unwrap();
        } else {
            let _ = master.request(id(1), step()).unwrap();
        }
        let packets = sent(&mut master, ms(0));
        master.note_restart(id(1));
        events(&mut master, ms(1));
        master.resume(id(1));
        master.handle_pushed_out(&packets[0]);
        assert_eq!(sent(&mut master, ms(2)), [], "{is_stream}");
    }
}

/// On the scale of V4.3 a turn of 2 pi rad is 65,535 / 25 rad * 6.2832 rad = 16,471 steps.
#[test]
fn turn_lost_in_motion_mode_is_a_restart() {
    let is_jump = |first: u16, second: u16, between_us: u64| {
        let mut master = Master::<2>::new(Config::CAN);
        let mut now = ms(1);
        for position in [first, second] {
            master.set_point(id(1), motion(), now).unwrap();
            sent(&mut master, now);
            let [high, low] = position.to_be_bytes();
            let data = [1, high, low, 0x80, 0x08, 0, 0, 0];
            let packet = Packet { channel: Channel::MotionReply(id(1)), data };
            let answered = now + Duration::from_micros(800);
            master.handle_frame(&Received::Packet(packet), answered).unwrap();
            now += Duration::from_micros(between_us);
        }
        events(&mut master, now).contains(&Event::Restarted { motor: id(1) })
    };
    for between_us in [1_000, 2_000, 10_000, 16_000] {
        assert!(is_jump(40_000, 40_000 - 16_471, between_us), "{between_us}");
        assert!(is_jump(20_000, 20_000 + 16_471, between_us), "{between_us}");
    }
    // 45 rad/s, the most that V4.3 can report: 118 steps in a millisecond.
    for between_us in [1_000, 2_000, 10_000, 16_000] {
        let turned = (118 * between_us / 1_000) as u16;
        assert!(!is_jump(40_000, 40_000 - turned, between_us), "{between_us}");
    }
    // An eighth, and in 2 ms at 2 us each: 8,192 and 1,000 steps.
    assert!(!is_jump(30_000, 39_192, 2_000));
    assert!(is_jump(30_000, 39_193, 2_000));
}

#[test]
fn poll_at_is_right_for_a_move_after_a_noted_restart() {
    let mut master = Master::<2>::new(Config::CAN);
    let patient = Patience { reply_timeout: Duration::from_millis(20), attempts: 2 };
    let _ = master.request_with(id(1), step(), patient).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.handle_timeout(ms(20));
    master.note_restart(id(1));
    while master.poll_event().is_some() {}
    master.resume(id(1));
    let _ = master.request_with(id(1), step(), patient).unwrap();
    let at = master.poll_at().unwrap();
    assert_eq!(sent(&mut master, at).len(), 1, "{at:?}");
}

#[test]
fn restart_of_a_motor_that_stays_silent_is_reported_once() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    let mut reported = 0;
    for now in (1_100..1_500).step_by(10) {
        let _ = master.request(id(1), ReadMultiTurnAngle);
        sent(&mut master, ms(now));
        let restarted = Event::Restarted { motor: id(1) };
        reported += events(&mut master, ms(now)).iter().filter(|&&it| it == restarted).count();
    }
    assert_eq!(reported, 1);
}

/// Motor 1 gets a set-point, and says in its feedback that it is there. Returns what comes of that.
fn streams(master: &mut Master<2>, degrees: i16, at: u64) -> Vec<Event> {
    master.set_point(id(1), torque(1.0), ms(at)).unwrap();
    assert_eq!(sent(master, ms(at)).len(), 1);
    let [low, high] = degrees.to_le_bytes();
    reply(master, 1, [0xA1, 30, 0, 0, 0, 0, low, high], ms(at + 1)).unwrap();
    events(master, ms(at + 1))
}

/// The angle of the stream before the restart is no place to measure a jump from.
#[test]
fn first_feedback_after_a_noted_restart_shows_no_other_restart() {
    let mut master = Master::<2>::new(Config::CAN);
    assert_eq!(streams(&mut master, 2_000, 0), []);
    assert_eq!(streams(&mut master, 2_000, 2), []);
    master.note_restart(id(1));
    assert_eq!(events(&mut master, ms(3)), [Event::Restarted { motor: id(1) }]);
    master.resume(id(1));
    assert_eq!(streams(&mut master, 0, 4), []);
}

#[test]
fn each_call_with_a_time_sets_the_time() {
    let calls: [fn(&mut Master<2>, Instant); 4] = [
        |master, now| assert!(reply(master, 2, ANGLE_REPLY, now).is_some()),
        |master, now| assert!(master.poll_transmit(now).is_none()),
        |master, now| master.handle_transmitted(now),
        |master, now| master.handle_bus_down(now),
    ];
    for (of, call) in calls.into_iter().enumerate() {
        let mut master = Master::<2>::new(Config::CAN);
        call(&mut master, ms(60));
        assert_eq!(master.now, ms(60), "{of}");
    }
}

/// The answer to a broadcast is taken for feedback: where the motor was then is not known.
#[test]
fn feedback_that_may_answer_a_broadcast_shows_no_restart() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    events(&mut master, ms(0));
    assert_eq!(streams(&mut master, 0, 30), []);
    assert_eq!(streams(&mut master, 400, 32), []);
}

#[test]
fn restart_noted_and_resumed_at_once_drops_an_older_move_to_all() {
    let mut master = Master::<2>::new(Config::CAN);
    let _read = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    master.broadcast(torque(1.0), id(1).into()).unwrap();
    master.note_restart(id(1));
    master.resume(id(1));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    assert_eq!(sent(&mut master, ms(2)), []);
    let dropped = Event::BroadcastDone { silent: id(1).into(), was_sent: false };
    assert!(events(&mut master, ms(2)).contains(&dropped));
}

#[test]
fn restart_noted_of_a_motor_without_a_place_refuses_moves() {
    let mut master = Master::<2>::new(Config::CAN);
    master.note_restart(id(1));
    assert_eq!(master.request(id(1), step()).err(), Some(RequestError::Restarted));
}

/// The frame may be what another master says to the motor on a line; it comes at once, or a while later.
#[test]
fn motor_first_heard_during_its_restart_has_restarted_once() {
    for heard in [13, 83] {
        let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
        let _ = master.request(id(1), Reset).unwrap();
        assert_eq!(sent(&mut master, ms(13)).len(), 1);
        events(&mut master, ms(13));
        let of = |data| Frame { address: id(1).into(), data };
        master.handle_line(&of([0xA8, 0, 0, 0, 8, 0, 0, 0]), ms(heard));
        events(&mut master, ms(heard));
        master.resume(id(1));
        let _ = master.request(id(1), ReadRunTime).unwrap();
        assert_eq!(sent(&mut master, ms(3_143)).len(), 1);
        // 2,030 ms: since 1,114 ms.
        master.handle_line(&of([0xB1, 0, 0, 0, 0xEE, 7, 0, 0]), ms(3_144));
        assert!(!master.has_restarted(id(1)), "first heard at {heard} ms");
    }
}

/// 1,010 ms is the run time of the first sending, at 1,000 ms.
#[test]
fn run_time_that_answers_an_earlier_sending_shows_no_restart() {
    let mut master = Master::<2>::new(Config::CAN);
    for now in [0, 900] {
        let _read = ask(&mut master, 1, ReadMultiTurnAngle, ms(now));
        reply(&mut master, 1, ANGLE_REPLY, ms(now + 1)).unwrap();
    }
    let patience = Patience { attempts: 3, reply_timeout: Duration::from_millis(300) };
    let _read = master.request_with(id(1), ReadRunTime, patience).unwrap();
    assert_eq!(sent(&mut master, ms(1_000)).len(), 1);
    assert_eq!(sent(&mut master, ms(1_300)).len(), 1);
    reply(&mut master, 1, [0xB1, 0, 0, 0, 0xF2, 3, 0, 0], ms(1_301)).unwrap();
    assert!(!master.has_restarted(id(1)));
}
