//! Stops that were not confirmed: they go again and again for as long as they are in force.

use super::*;

/// What goes from then on for as long as a stop rests that was given up, 100 ms, and is waited for, 20.4 ms.
fn goes_again<const N: usize>(master: &mut Master<N>, from: u64) -> Vec<Packet> {
    (from..from + 120).flat_map(|now| sent(master, ms(now))).collect()
}

#[test]
fn unconfirmed_stop_is_repeated_every_100_ms_until_it_is_confirmed() {
    for kind in [StopKind::Hold, StopKind::Off] {
        let mut master = Master::<2>::new(Config::CAN);
        obeys(&mut master, 1);
        master.stop_all(kind, id(1).into()).unwrap();
        let mut now = is_given_up(&mut master, 1, 0);
        let (_, stop) = kind.command();
        for _ in 0..40 {
            assert!(master.poll_at() > Some(ms(now + 98)), "{:?}", master.poll_at());
            assert!(master.poll_at() <= Some(ms(now + 100)), "{:?}", master.poll_at());
            assert_eq!(sent(&mut master, ms(now + 98)), []);
            assert_eq!(sent(&mut master, ms(now + 100)), [packet_to(1, stop)]);
            now += 121;
            assert_eq!(sent(&mut master, ms(now)), []);
            assert_eq!(events(&mut master, ms(now)), [], "it was reported once");
        }
        now += 100;
        assert_eq!(sent(&mut master, ms(now)), [packet_to(1, stop)]);
        assert_eq!(reply(&mut master, 1, stop, ms(now + 1)), confirmed(1));
        assert_eq!(goes_again(&mut master, now + 2), []);
        assert_eq!(master.poll_at(), None);
    }
}

#[test]
fn lifted_unconfirmed_stop_is_not_repeated() {
    for is_one in [true, false] {
        let mut master = Master::<2>::new(Config::CAN);
        master.stop(id(1), StopKind::Off).unwrap();
        let now = is_given_up(&mut master, 1, 0);
        if is_one {
            master.lift_stop_of(id(1));
        } else {
            master.lift_stop();
        }
        assert_eq!(goes_again(&mut master, now), []);
        assert_eq!(master.poll_at(), None);
    }
}

/// The event was not polled yet when the motor is back.
#[test]
fn stop_confirmed_after_all_is_not_reported_as_unconfirmed() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    let mut frames = 0;
    let sixteenth = (0..1_000).find(|&now| {
        frames += sent(&mut master, ms(now)).len();
        frames == 16
    });
    let now = sixteenth.unwrap();
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(now + 1)), confirmed(1));
    assert_eq!(events(&mut master, ms(now + 1)), []);
}

/// The stop is repeated meanwhile. No caller has stopped the motor again.
#[test]
fn requests_to_a_motor_with_an_unconfirmed_stop_fail_as_unanswered() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop_all(StopKind::Hold, id(1).into()).unwrap();
    let from = is_given_up(&mut master, 1, 0);
    let (mut ticket, mut answers) = (None, Vec::new());
    for now in from..from + 2_000 {
        sent(&mut master, ms(now));
        let of_it = |event: &Event| ticket.and_then(|it: Ticket<ReadStatus1>| it.outcome(event));
        let reported = events(&mut master, ms(now)).iter().find_map(of_it);
        if reported.is_some() {
            (ticket, answers) = (None, [answers, reported.into_iter().collect()].concat());
        }
        ticket = ticket.or_else(|| master.request(id(1), ReadStatus1).ok());
    }
    assert!(answers.len() >= 15, "{}", answers.len());
    let is_silent = |it: &_| matches!(it, Err(Failure::NoReply | Failure::StopUnconfirmed));
    assert!(answers.iter().all(is_silent), "{answers:?}");
}

#[test]
fn motor_with_an_unconfirmed_stop_can_be_forgotten() {
    for is_in_flight in [false, true] {
        let mut master = Master::<2>::new(Config::CAN);
        master.stop_all(StopKind::Off, id(1).into()).unwrap();
        let now = is_given_up(&mut master, 1, 0);
        let stops = sent(&mut master, ms(now + if is_in_flight { 100 } else { 50 }));
        assert_eq!(stops.len(), usize::from(is_in_flight));
        assert!(master.forget(id(1)));
        assert!(!master.is_anything_in_flight());
        assert_eq!(goes_again(&mut master, now + 101), []);
    }
}

#[test]
fn motor_with_a_waiting_set_point_is_not_forgotten() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    let now = is_given_up(&mut master, 1, 0);
    assert_eq!(sent(&mut master, ms(now + 100)).len(), 1, "the stop once more");
    master.lift_stop();
    master.set_point(id(1), torque(1.0), ms(now + 100)).unwrap();
    assert!(!master.forget(id(1)), "it would be lost without a word");
}

/// Each of these stops keeps the line for 5.262 ms.
#[test]
fn on_rs485_unconfirmed_stops_take_at_most_a_quarter_of_the_time() {
    for silent in [1, 2, 7, 30] {
        let mut master = Master::<32>::new(Config::rs485(1_000_000, false));
        for motor in 1..=silent {
            master.stop(id(motor), StopKind::Off).unwrap();
        }
        let mut reported = 0;
        let given_up = (0..20_000).find(|&now| {
            sent(&mut master, ms(now));
            reported += events(&mut master, ms(now)).len();
            reported == usize::from(silent)
        });
        let from = given_up.unwrap();
        let stops: usize = (from..from + 10_000).map(|now| sent(&mut master, ms(now)).len()).sum();
        assert!(stops * 5_262 <= 10_000_000 / 4, "{silent}: {stops} stops");
        let each = stops / usize::from(silent);
        assert!(each >= 10_000 / (110 + 30 * usize::from(silent)), "{silent}: {each} stops each");
    }
}

#[test]
fn unconfirmed_hold_is_repeated_as_a_shutdown_once_the_motor_is_off() {
    for is_to_all in [false, true] {
        let mut master = Master::<2>::new(Config::CAN);
        master.stop(id(1), StopKind::Hold).unwrap();
        let now = is_given_up(&mut master, 1, 0);
        if is_to_all {
            master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
        } else {
            let _ = master.request(id(1), Shutdown).unwrap();
        }
        // That is not heard either.
        let (off, all) = (packet_to(1, Shutdown.encode()), packet_to_all(Shutdown.encode()));
        for now in now..now + 1_000 {
            let packets = sent(&mut master, ms(now));
            assert!(packets.iter().all(|packet| *packet == off || *packet == all), "{packets:?}");
            events(&mut master, ms(now));
        }
        assert_eq!(goes_again(&mut master, now + 1_000), [off], "{is_to_all}");
    }
}

#[test]
fn answered_shutdown_ends_an_unconfirmed_stop() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Hold).unwrap();
    // Its answer could not come any more.
    let now = is_given_up(&mut master, 1, 0) + 50;
    master.handle_timeout(ms(now));
    let patience = Patience { reply_timeout: Duration::from_millis(500), attempts: 1 };
    let off = master.request_with(id(1), Shutdown, patience).unwrap();
    // Nothing takes its place.
    assert_eq!(goes_again(&mut master, now), [packet_to(1, Shutdown.encode())]);
    let reported = reply(&mut master, 1, Shutdown.encode(), ms(now + 120)).unwrap();
    assert!(off.outcome(&reported).is_some());
    assert_eq!(goes_again(&mut master, now + 120), []);
}

#[test]
fn hold_changed_by_a_shutdown_to_all_is_repeated_as_a_shutdown() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.broadcast(Shutdown, id(1).into()).unwrap();
    let over = (1..2_000).find(|&now| {
        sent(&mut master, ms(now));
        events(&mut master, ms(now)).contains(&Event::StopUnconfirmed { motor: id(1) })
    });
    // After that the command to all goes, which it does not hear either.
    let now = over.unwrap();
    for now in now..now + 200 {
        sent(&mut master, ms(now));
        events(&mut master, ms(now));
    }
    assert_eq!(goes_again(&mut master, now + 200), [packet_to(1, Shutdown.encode())]);
}

#[test]
fn old_hold_of_a_forgotten_motor_is_not_repeated_under_a_shutdown() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Hold).unwrap();
    let now = is_given_up(&mut master, 1, 0) + 100;
    events(&mut master, ms(now));
    master.lift_stop();
    assert!(master.forget(id(1)));
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(now));
    reply(&mut master, 1, ANGLE_REPLY, ms(now + 1)).unwrap();
    assert_eq!(goes_again(&mut master, now + 1), []);
}

/// The motor answers reads and no stop, so that it is stopped again each time; the other has its share of the line.
#[test]
fn on_rs485_motor_that_only_answers_reads_leaves_turns_to_others() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    master.stop(id(1), StopKind::Off).unwrap();
    let mut now = 0;
    let (mut answers, mut stops) = ([0; 2], 0);
    let mut due: Option<(u8, u64)> = None;
    while now < 3_000_000 {
        let at = Instant::from_micros(now);
        if let Some((motor, _)) = due.take_if(|(_, at)| *at <= now) {
            let frame = Frame { address: Target::Motor(id(motor)), data: ANGLE_REPLY };
            answers[usize::from(motor) - 1] +=
                usize::from(matches!(master.handle_line(&frame, at), Some(Event::Reply { .. })));
        }
        master.handle_timeout(at);
        while master.poll_event().is_some() {}
        for motor in [1, 2] {
            let _ = master.request(id(motor), ReadMultiTurnAngle);
        }
        if let Some(packet) = master.poll_transmit(at) {
            master.handle_transmitted(at);
            let Channel::Command(Target::Motor(motor)) = packet.channel else { panic!() };
            if packet.data == ReadMultiTurnAngle.encode() {
                due = Some((motor.get(), now + 2_000));
            } else {
                stops += 1;
            }
        }
        now += 500;
    }
    assert!(stops > 30 && answers[1] > 30, "{stops} stops, {answers:?} answers");
    assert!(stops <= 15 + answers[0] + 1, "{stops} stops, {answers:?} answers");
}

#[test]
fn called_stop_has_fifteen_attempts_while_an_unconfirmed_one_repeats() {
    for (is_waiting, is_to_all) in [(false, false), (true, false), (false, true)] {
        let mut master = Master::<2>::new(Config::CAN);
        master.stop_all(StopKind::Off, id(1).into()).unwrap();
        let mut now = is_given_up(&mut master, 1, 0) + 100;
        master.handle_timeout(ms(now));
        let mut frames = if is_waiting { 0 } else { sent(&mut master, ms(now)).len() };
        for _ in 0..2 {
            match is_to_all {
                true => master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap(),
                false => master.stop(id(1), StopKind::Off).unwrap(),
            }
        }
        now += 2;
        for at in now..now + 1_000 {
            frames += sent(&mut master, ms(at)).len();
            // That is reported to a caller that stops in every cycle, too, and there are no more of them.
            if events(&mut master, ms(at)).contains(&Event::StopUnconfirmed { motor: id(1) }) {
                break;
            }
            master.stop(id(1), StopKind::Off).unwrap();
        }
        assert_eq!(frames, 15 + usize::from(!is_waiting), "{is_waiting} {is_to_all}");
    }
}

/// A reply of motor 1, on either bus.
fn answer(master: &mut Master<2>, data: [u8; 8], now: u64) -> Option<Event> {
    if master.config.is_rs485() {
        return master.handle_line(&Frame { address: id(1).into(), data }, ms(now));
    }
    reply(master, 1, data, ms(now))
}

/// The motor answers reads and no stops for long, and then everything.
#[test]
fn long_unconfirmed_stop_is_confirmed_by_its_first_answer() {
    for config in [Config::CAN, Config::rs485(1_000_000, false)] {
        let mut master = Master::<2>::new(config);
        master.stop(id(1), StopKind::Off).unwrap();
        let mut now = is_given_up(&mut master, 1, 0);
        let mut stops = 0;
        while stops < 30 {
            now += 1;
            let packets = sent(&mut master, ms(now));
            stops += packets.iter().filter(|packet| packet.data == Shutdown.encode()).count();
            if packets.iter().any(|packet| packet.data == ReadMultiTurnAngle.encode()) {
                now += 1;
                answer(&mut master, ANGLE_REPLY, now).unwrap();
            }
            events(&mut master, ms(now));
            let _ = master.request(id(1), ReadMultiTurnAngle);
        }
        assert_eq!(answer(&mut master, Shutdown.encode(), now + 1), confirmed(1), "{config:?}");
        let packets = goes_again(&mut master, now + 2);
        assert!(packets.iter().all(|packet| packet.data != Shutdown.encode()), "{packets:?}");
    }
}

/// The answer to the first of two stops, of which the first was lifted, comes as late as answers do.
#[test]
fn stop_is_not_confirmed_by_the_answer_to_the_lifted_one() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(100)), [packet_to(1, Shutdown.encode())]);
    master.lift_stop();
    master.stop(id(2), StopKind::Off).unwrap();
    master.stop(id(1), StopKind::Hold).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    // 5.26 ms for the first, 10.26 ms late.
    let mut now = ms(100);
    while now < Instant::from_micros(115_400) {
        now += Duration::from_micros(100);
        master.handle_timeout(now);
        if master.poll_transmit(now).is_some() {
            master.handle_transmitted(now);
        }
    }
    let frame = Frame { address: id(1).into(), data: Shutdown.encode() };
    assert_eq!(master.handle_line(&frame, now), None);
}

#[test]
fn stop_after_a_lifted_one_and_a_move_or_hold_begins_anew() {
    for is_held_first in [false, true] {
        let mut master = Master::<2>::new(Config::CAN);
        master.stop(id(1), StopKind::Off).unwrap();
        let now = is_given_up(&mut master, 1, 0);
        master.lift_stop();
        if is_held_first {
            master.stop(id(1), StopKind::Hold).unwrap();
        } else {
            master.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
            assert_eq!(sent(&mut master, ms(now)).len(), 1);
        }
        master.stop(id(1), StopKind::Off).unwrap();
        let packets = sent(&mut master, ms(now));
        assert_eq!(packets.last(), Some(&packet_to(1, Shutdown.encode())));
        // Of one of the first fifteen.
        assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(now + 1)), None, "{is_held_first}");
    }
}

#[test]
fn shutdown_that_was_never_sent_does_not_change_a_repeated_hold() {
    for is_to_all in [false, true] {
        let mut master = Master::<2>::new(Config::CAN);
        master.stop(id(1), StopKind::Hold).unwrap();
        let now = is_given_up(&mut master, 1, 0) + 50;
        if is_to_all {
            master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
        } else {
            let _ = master.request(id(1), Shutdown).unwrap();
        }
        master.handle_bus_down(ms(now));
        assert_eq!(goes_again(&mut master, now), [packet_to(1, Stop.encode())], "{is_to_all}");
    }
}

#[test]
fn repeated_hold_does_not_undo_a_waiting_shutdown_to_all() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Hold).unwrap();
    let now = is_given_up(&mut master, 1, 0);
    let patient = Patience { reply_timeout: Duration::from_millis(300), attempts: 1 };
    let _ = master.request_with(id(2), ReadModel, patient).unwrap();
    assert_eq!(sent(&mut master, ms(now)).len(), 1);
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    let goes: Vec<Packet> =
        (now + 1..now + 400).flat_map(|now| sent(&mut master, ms(now))).collect();
    assert!(goes.iter().all(|packet| packet.data == Shutdown.encode()), "{goes:?}");
    assert!(goes.contains(&packet_to_all(Shutdown.encode())));
}

#[test]
fn lifted_unconfirmed_stop_is_not_repeated_while_another_is_in_force() {
    let mut master = Master::<2>::new(Config::CAN);
    obeys(&mut master, 1);
    obeys(&mut master, 2);
    master.stop(id(1), StopKind::Hold).unwrap();
    let now = is_given_up(&mut master, 1, 0);
    master.stop(id(2), StopKind::Hold).unwrap();
    sent(&mut master, ms(now));
    assert!(reply(&mut master, 2, Stop.encode(), ms(now + 1)).is_some());
    master.lift_stop_of(id(1));
    let goes: Vec<Packet> =
        (now + 2..now + 400).flat_map(|now| sent(&mut master, ms(now))).collect();
    assert_eq!(goes, []);
    assert_eq!(master.poll_at(), None);
}

#[test]
fn each_unconfirmed_stop_is_repeated_at_its_own_time() {
    let mut master = Master::<2>::new(Config::CAN);
    let mut reported_at = [0; 3];
    let mut last = [0; 3];
    let mut repeats = [0; 3];
    master.stop(id(1), StopKind::Hold).unwrap();
    for now in 0..3_000 {
        if now == 50 {
            master.stop(id(2), StopKind::Hold).unwrap();
        }
        for packet in sent(&mut master, ms(now)) {
            let Channel::Command(Target::Motor(motor)) = packet.channel else { continue };
            let motor = usize::from(motor.get());
            let since = now - last[motor];
            last[motor] = now;
            repeats[motor] += u32::from(reported_at[motor] != 0);
            assert!(
                reported_at[motor] == 0
                    || now == reported_at[motor] + 100
                    || (118..125).contains(&since),
                "{motor} {since}"
            );
        }
        for event in events(&mut master, ms(now)) {
            if let Event::StopUnconfirmed { motor } = event {
                reported_at[usize::from(motor.get())] = now;
            }
        }
    }
    // The first after 100 ms, the others every 118 to 124 ms, until 3 s.
    assert!(repeats[1..].iter().all(|times| (21..=22).contains(times)), "{repeats:?}");
}

/// Each of the fifteen attempts may still be answered; so may the read from before.
#[test]
fn stop_called_again_right_after_it_failed_needs_one_answer() {
    let mut master = Master::<2>::new(Config::CAN);
    let _read = master.request_with(id(1), ReadModel, once(5)).unwrap();
    sent(&mut master, ms(0));
    assert_eq!(events(&mut master, ms(5)).len(), 1);
    master.stop(id(1), StopKind::Off).unwrap();
    let now = is_given_up(&mut master, 1, 6);
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(now)).len(), 1);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(now + 1)), confirmed(1));
    let _read = master.request(id(1), ReadModel).unwrap();
    assert_eq!(sent(&mut master, ms(now + 2)), []);
}

#[test]
fn unconfirmed_stop_called_again_has_fifteen_attempts() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    let now = is_given_up(&mut master, 1, 0);
    master.stop(id(1), StopKind::Off).unwrap();
    let frames: usize = (now..now + 15 * 21).map(|now| sent(&mut master, ms(now)).len()).sum();
    assert_eq!(frames, 15);
}

/// Neither a read to all that waits for another motor's answer, nor one to the motor itself.
#[test]
fn no_read_delays_a_repeated_stop() {
    for is_to_all in [true, false] {
        let mut master = Master::<2>::new(Config::CAN);
        master.stop(id(1), StopKind::Off).unwrap();
        let now = is_given_up(&mut master, 1, 0);
        let patient = Patience { reply_timeout: Duration::from_millis(500), attempts: 1 };
        let _read = master.request_with(id(if is_to_all { 2 } else { 1 }), ReadModel, patient);
        assert_eq!(sent(&mut master, ms(now)).len(), 1);
        if is_to_all {
            master.broadcast(ReadMultiTurnAngle, MotorSet::EMPTY).unwrap();
        }
        let stop = packet_to(1, Shutdown.encode());
        assert_eq!(sent(&mut master, ms(now + 100)), [stop], "{is_to_all}");
    }
}

#[test]
fn unconfirmed_stop_is_reported_though_events_are_polled_late() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    (0..600).for_each(|now| drop(sent(&mut master, ms(now))));
    assert_eq!(events(&mut master, ms(600)), [Event::StopUnconfirmed { motor: id(1) }]);
}

/// The answers that the hold may owe are none to the shutdown.
#[test]
fn shutdown_after_an_unconfirmed_hold_needs_one_answer() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Hold).unwrap();
    let now = is_given_up(&mut master, 1, 0) + 90;
    events(&mut master, ms(now));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(now)).len(), 1);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(now + 1)), confirmed(1));
    let _off = master.request(id(1), Shutdown).unwrap();
    assert_eq!(sent(&mut master, ms(now + 1)).len(), 1, "no other answer may come");
}

/// The answer to the read may be on the line when the stop is due again.
#[test]
fn on_rs485_repeated_stop_waits_for_the_answer_to_a_read() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    master.stop(id(1), StopKind::Off).unwrap();
    let now = is_given_up(&mut master, 1, 0);
    let _read = master.request(id(1), ReadModel).unwrap();
    assert_eq!(sent(&mut master, ms(now + 99)).len(), 1);
    for after in 100..104 {
        assert_eq!(sent(&mut master, ms(now + after)), [], "{after} ms");
    }
    assert_eq!(sent(&mut master, ms(now + 104)), [packet_to(1, Shutdown.encode())]);
}

#[test]
fn requested_shutdown_does_not_spoil_the_answer_to_a_repeated_stop() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    let now = is_given_up(&mut master, 1, 0);
    let _off = master.request(id(1), Shutdown).unwrap();
    assert_eq!(sent(&mut master, ms(now + 50)), [packet_to(1, Shutdown.encode())]);
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(now + 51)).len(), 1);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(now + 52)), confirmed(1));
}

/// An adapter hands over every 16 ms what it received, and a program lifts its stop and stops again in every cycle. Of
/// the answers that come together only one is counted, so that ever more seem pending; and each sending of the stop
/// prolongs how long they are expected. The motor answers every stop, and yet it is not confirmed for seconds.
#[test]
fn answers_that_come_together_do_not_keep_a_stop_unconfirmed_for_seconds() {
    let master = &mut Master::<2>::new(Config::CAN);
    let mut owed = 0;
    for at in 0..2_000 {
        if at % 16 == 0 {
            for _ in 0..core::mem::take(&mut owed) {
                let _ = reply(master, 1, [0x81, 0, 0, 0, 0, 0, 0, 0], ms(at));
            }
        }
        if at % 4 == 0 {
            master.lift_stop();
            master.stop_all(StopKind::Hold, id(1).into()).unwrap();
        }
        owed += sent(master, ms(at)).len();
        events(master, ms(at));
    }
    // The program calls nothing any more: 500 ms are more than any time-out of this master.
    let mut confirmed = None;
    for at in 2_000..12_000 {
        if at % 16 == 0 {
            for _ in 0..core::mem::take(&mut owed) {
                let event = reply(master, 1, [0x81, 0, 0, 0, 0, 0, 0, 0], ms(at));
                if matches!(event, Some(Event::StopConfirmed { .. })) {
                    confirmed.get_or_insert(at);
                }
            }
        }
        owed += sent(master, ms(at)).len();
        events(master, ms(at));
    }
    assert!(confirmed.is_some_and(|at| at < 2_500), "{confirmed:?}");
}

/// The stop is repeated automatically when the caller stops the motor again.
#[test]
fn failure_of_an_unconfirmed_stop_is_not_reported_for_the_next() {
    let master = &mut Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Hold).unwrap();
    // No events are polled, and no motor answers.
    let mut at = 0;
    while master.motor(id(1)).unwrap().unconfirmed_stop().is_none() {
        sent(master, ms(at));
        at += 1;
    }
    // It is sent once more automatically.
    while !master.motor(id(1)).unwrap().is_in_flight() {
        sent(master, ms(at));
        at += 1;
    }
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(master.poll_event(), None, "the new stop has just begun");
}

/// On a cable that is mended it would turn on. A read that a stop cuts off has no answer, so the stop goes between two.
#[test]
fn motor_heard_again_is_stopped_at_once_without_cutting_off_a_read() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    let now = is_given_up(&mut master, 1, 0);
    let read = ask(&mut master, 1, ReadMultiTurnAngle, ms(now + 21));
    // Something else that it says ends no read.
    assert!(matches!(
        reply(&mut master, 1, [0x9C, 25, 0, 0, 0, 0, 0, 0], ms(now + 21)),
        Some(Event::Stray { .. })
    ));
    assert_eq!(sent(&mut master, ms(now + 21)), []);
    let event = reply(&mut master, 1, ANGLE_REPLY, ms(now + 22)).unwrap();
    assert!(read.outcome(&event).unwrap().is_ok());
    assert_eq!(master.request(id(1), ReadMultiTurnAngle).err(), Some(RequestError::Busy));
    assert_eq!(sent(&mut master, ms(now + 22)), [packet_to(1, Shutdown.encode())]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(now + 23)), confirmed(1));
    let read = ask(&mut master, 1, ReadMultiTurnAngle, ms(now + 23));
    let event = reply(&mut master, 1, ANGLE_REPLY, ms(now + 24)).unwrap();
    assert!(read.outcome(&event).unwrap().is_ok());
    assert_eq!(sent(&mut master, ms(now + 24)), []);
}

/// The motor answers reads and no stop: others have half of the time at least.
#[test]
fn motor_heard_2_ms_after_its_stop_failed_is_not_stopped_at_once() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    let now = is_given_up(&mut master, 1, 0);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(now + 1));
    assert!(reply(&mut master, 1, ANGLE_REPLY, ms(now + 2)).is_some());
    assert_eq!(sent(&mut master, ms(now + 2)), [], "it was given up 2 ms ago");
}

#[test]
fn repeated_stop_is_sent_after_the_first_stop_of_another_motor() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    let now = is_given_up(&mut master, 1, 0);
    let _ = ask(&mut master, 2, ReadMultiTurnAngle, ms(now + 20));
    assert!(reply(&mut master, 2, ANGLE_REPLY, ms(now + 21)).is_some());
    // It is heard again, so that its stop is to go once more.
    assert!(reply(&mut master, 1, ANGLE_REPLY, ms(now + 30)).is_some());
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(now + 30)), [packet_to(2, Shutdown.encode())]);
    assert!(reply(&mut master, 2, Shutdown.encode(), ms(now + 31)).is_some());
    assert_eq!(sent(&mut master, ms(now + 31)), [packet_to(1, Shutdown.encode())]);
}

/// A hold that was not confirmed is repeated as the later shutdown to all. That alone does not keep the motor off.
#[test]
fn repeated_stop_does_not_keep_a_motor_off_that_no_stop_switched_off() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Hold).unwrap();
    let now = is_given_up(&mut master, 1, 0);
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(now)), [packet_to_all(Shutdown.encode())]);
    let again = (now..now + 200).find_map(|now| sent(&mut master, ms(now)).pop());
    assert_eq!(again, Some(packet_to(1, Shutdown.encode())));
    events(&mut master, ms(now + 300));
    assert!(master.request(id(1), Stop).is_ok());
}

/// The hold of the motor was given up, and it was sent a shutdown since. The answer to that comes before the next stop
/// is sent.
#[test]
fn late_answer_to_a_requested_shutdown_does_not_confirm_an_unsent_one() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Hold).unwrap();
    let now = is_given_up(&mut master, 1, 0);
    let off = master.request_with(id(1), Shutdown, once(20)).unwrap();
    assert_eq!(sent(&mut master, ms(now)).len(), 1);
    let reported = events(&mut master, ms(now + 21));
    assert_eq!(reported, [Event::Failed { ticket: off.id(), failure: Failure::NoReply }]);
    master.stop(id(1), StopKind::Off).unwrap();
    let late = reply(&mut master, 1, Shutdown.encode(), ms(now + 22));
    assert!(matches!(late, Some(Event::Stray { .. })), "{late:?}");
}

/// A drive without a brake answers the lock, too.
#[test]
fn answered_brake_lock_does_not_end_an_unconfirmed_stop() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    let given_up = is_given_up(&mut master, 1, 0);
    let lock = master.request(id(1), LockBrake).unwrap();
    let (mut is_locked, mut stops) = (false, 0);
    for now in given_up..given_up + 500 {
        for packet in sent(&mut master, ms(now)) {
            if packet.data == LockBrake.encode() {
                let answered = ms(now) + Duration::from_micros(800);
                let answer = reply(&mut master, 1, packet.data, answered);
                is_locked |= answer.is_some_and(|event| lock.outcome(&event).is_some());
            } else if is_locked {
                assert_eq!(packet, packet_to(1, Shutdown.encode()));
                stops += 1;
            }
        }
    }
    assert!(is_locked && stops > 0, "{is_locked} {stops}");
}

/// Otherwise its outcome would be reported for the ticket of the next request.
#[test]
fn request_is_refused_until_the_one_a_repeated_stop_ended_is_reported() {
    let mut master = Master::<2>::new(Config::CAN);
    obeys(&mut master, 1);
    master.stop_all(StopKind::Hold, id(1).into()).unwrap();
    let from = is_given_up(&mut master, 1, 0);
    let read = ask(&mut master, 1, ReadStatus1, ms(from + 95));
    assert_eq!(sent(&mut master, ms(from + 100)), [packet_to(1, Stop.encode())]);
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(from + 101)), confirmed(1));
    assert_eq!(master.request(id(1), ReadStatus1).err(), Some(RequestError::Busy));
    let reported = events(&mut master, ms(from + 101));
    assert_eq!(
        reported.iter().find_map(|it| read.outcome(it)),
        Some(Err(Failure::StopUnconfirmed))
    );
    assert!(master.request(id(1), ReadStatus1).is_ok());
}
