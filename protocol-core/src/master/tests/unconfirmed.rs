//! Stops that were not confirmed: they go again and again for as long as they are in force.

use super::*;

/// What goes from then on for as long as a stop rests that was given up, 100 ms, and is waited for, 20.4 ms.
fn goes_again<const N: usize>(master: &mut Master<N>, from: u64) -> Vec<Packet> {
    (from..from + 120).flat_map(|now| sent(master, ms(now))).collect()
}

#[test]
fn a_motor_that_has_not_confirmed_its_stop_gets_it_every_100_ms_until_it_does() {
    for kind in [StopKind::Hold, StopKind::Off] {
        let mut master = Master::<2>::new(Config::CAN);
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
            assert_eq!(events(&mut master, ms(now)), [], "it was told once");
        }
        now += 100;
        assert_eq!(sent(&mut master, ms(now)), [packet_to(1, stop)]);
        assert_eq!(reply(&mut master, 1, stop, ms(now + 1)), confirmed(1));
        assert_eq!(goes_again(&mut master, now + 2), []);
        assert_eq!(master.poll_at(), None);
    }
}

#[test]
fn a_stop_that_was_lifted_goes_no_more() {
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

/// What became of the stop was not polled yet when the motor is back.
#[test]
fn a_motor_that_has_confirmed_its_stop_after_all_is_not_told_to_have_not() {
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

/// Its stop goes again meanwhile. No caller has stopped it again.
#[test]
fn who_asks_a_motor_that_has_not_confirmed_its_stop_is_told_that_it_is_silent() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop_all(StopKind::Hold, id(1).into()).unwrap();
    let from = is_given_up(&mut master, 1, 0);
    let (mut ticket, mut answers) = (None, Vec::new());
    for now in from..from + 2_000 {
        sent(&mut master, ms(now));
        let of_it = |event: &Event| ticket.and_then(|it: Ticket<ReadStatus1>| it.outcome(event));
        let told = events(&mut master, ms(now)).iter().find_map(of_it);
        if told.is_some() {
            (ticket, answers) = (None, [answers, told.into_iter().collect()].concat());
        }
        ticket = ticket.or_else(|| master.request(id(1), ReadStatus1).ok());
    }
    assert!(answers.len() >= 15, "{}", answers.len());
    let is_silent = |it: &_| matches!(it, Err(Failure::NoReply | Failure::StopUnconfirmed));
    assert!(answers.iter().all(is_silent), "{answers:?}");
}

#[test]
fn who_confirms_no_stop_is_forgotten_all_the_same() {
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
fn who_confirms_no_stop_is_not_forgotten_with_a_set_point_that_waits() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    let now = is_given_up(&mut master, 1, 0);
    assert_eq!(sent(&mut master, ms(now + 100)).len(), 1, "the stop once more");
    master.lift_stop();
    master.set_point(id(1), torque(1.0), ms(now + 100)).unwrap();
    assert!(!master.forget(id(1)), "it would be lost without a word");
}

/// Each of their stops keeps the line for 5.262 ms.
#[test]
fn who_confirms_no_stop_leaves_three_quarters_of_a_line_to_the_others() {
    for silent in [1, 2, 7, 30] {
        let mut master = Master::<32>::new(Config::rs485(1_000_000, false));
        for motor in 1..=silent {
            master.stop(id(motor), StopKind::Off).unwrap();
        }
        let mut told = 0;
        let given_up = (0..20_000).find(|&now| {
            sent(&mut master, ms(now));
            told += events(&mut master, ms(now)).len();
            told == usize::from(silent)
        });
        let from = given_up.unwrap();
        let stops: usize = (from..from + 10_000).map(|now| sent(&mut master, ms(now)).len()).sum();
        assert!(stops * 5_262 <= 10_000_000 / 4, "{silent}: {stops} stops");
        let each = stops / usize::from(silent);
        assert!(each >= 10_000 / (110 + 30 * usize::from(silent)), "{silent}: {each} stops each");
    }
}

#[test]
fn a_hold_that_was_not_confirmed_does_not_switch_on_what_is_switched_off_since() {
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
fn what_ends_its_motion_takes_an_unconfirmed_stop_back_when_it_is_answered() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Hold).unwrap();
    // Its answer could not come any more.
    let now = is_given_up(&mut master, 1, 0) + 50;
    master.handle_timeout(ms(now));
    let patience = Patience { reply_timeout: Duration::from_millis(500), attempts: 1 };
    let off = master.request_with(id(1), Shutdown, patience).unwrap();
    // Nothing takes its place.
    assert_eq!(goes_again(&mut master, now), [packet_to(1, Shutdown.encode())]);
    let told = reply(&mut master, 1, Shutdown.encode(), ms(now + 120)).unwrap();
    assert!(off.outcome(&told).is_some());
    assert_eq!(goes_again(&mut master, now + 120), []);
}

#[test]
fn a_hold_that_became_a_shutdown_with_all_goes_again_as_a_shutdown() {
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
fn a_hold_of_long_ago_does_not_switch_on_who_has_no_place_under_a_stop_of_all() {
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

/// It answers reads and no stop, so that it is stopped again each time; the other has its share of the line.
#[test]
fn who_talks_and_confirms_no_stop_leaves_the_line_to_the_others() {
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
fn a_stop_that_is_called_for_has_all_its_attempts_also_while_one_goes_again() {
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
            // A caller that stops in every cycle is told all the same, and gets no more of them.
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

/// A motor that answers reads and no stops for long, and then everything.
#[test]
fn who_has_confirmed_no_stop_for_long_confirms_it_with_its_first_answer() {
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

/// The answer to the first of two stops, of which a lifting is in between, comes as late as answers do.
#[test]
fn a_stop_is_not_confirmed_by_the_answer_to_the_one_it_replaced() {
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
fn a_stop_that_was_lifted_does_not_go_on() {
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
fn a_shutdown_that_was_never_sent_does_not_change_a_hold_that_goes_again() {
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
fn what_all_are_about_to_be_told_is_not_undone_by_a_hold_that_goes_again() {
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
fn a_stop_that_was_lifted_does_not_go_again_because_another_is_in_force() {
    let mut master = Master::<2>::new(Config::CAN);
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
fn each_unconfirmed_stop_goes_when_it_is_time_for_it() {
    let mut master = Master::<2>::new(Config::CAN);
    let mut told = [0; 3];
    let mut last = [0; 3];
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
            assert!(
                told[motor] == 0 || now == told[motor] + 100 || (118..125).contains(&since),
                "{motor} {since}"
            );
        }
        for event in events(&mut master, ms(now)) {
            if let Event::StopUnconfirmed { motor } = event {
                told[usize::from(motor.get())] = now;
            }
        }
    }
}

/// Each of the fifteen that went may still be answered; so may the read from before.
#[test]
fn a_stop_that_is_called_for_as_soon_as_it_was_given_up_is_confirmed_by_its_first_answer() {
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

/// Its first goes after those of others, as its second would.
#[test]
fn a_stop_that_is_called_for_again_and_was_never_confirmed_has_all_its_attempts() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    let now = is_given_up(&mut master, 1, 0);
    master.stop(id(1), StopKind::Off).unwrap();
    let frames: usize = (now..now + 15 * 21).map(|now| sent(&mut master, ms(now)).len()).sum();
    assert_eq!(frames, 15);
}

/// Neither a question to all that waits for another motor's answer, nor one to the motor itself.
#[test]
fn no_question_keeps_a_stop_back_that_goes_again() {
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
fn that_a_stop_is_not_confirmed_is_told_however_late_somebody_asks() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    (0..600).for_each(|now| drop(sent(&mut master, ms(now))));
    assert_eq!(events(&mut master, ms(600)), [Event::StopUnconfirmed { motor: id(1) }]);
}

/// Those of the hold that was not confirmed are none of the shutdown's.
#[test]
fn a_shutdown_after_a_hold_that_was_not_confirmed_is_answered_once() {
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

/// The motor answers what it is asked, which is on the line when the stop is due again.
#[test]
fn a_stop_that_goes_again_does_not_meet_an_answer_on_a_line() {
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
fn the_callers_own_shutdown_leaves_a_shutdown_that_goes_on_its_answers() {
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

/// What became of an earlier stop says nothing of the one that goes on as the caller's own.
#[test]
fn an_earlier_stop_that_was_given_up_is_not_told_of_the_next_one() {
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

/// On a cable that is mended it would turn on. A read that a stop cuts off has no answer, so it goes between two.
#[test]
fn who_is_heard_again_is_stopped_at_once_and_no_read_is_cut_off_by_that() {
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

/// It answers reads and no stop: others have half of the time at least.
#[test]
fn who_is_heard_again_and_confirms_nothing_is_not_stopped_again_at_once() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    let now = is_given_up(&mut master, 1, 0);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(now + 1));
    assert!(reply(&mut master, 1, ANGLE_REPLY, ms(now + 2)).is_some());
    assert_eq!(sent(&mut master, ms(now + 2)), [], "it was given up 2 ms ago");
}

#[test]
fn a_stop_that_goes_again_when_it_is_called_for_goes_behind_who_was_told_nothing_yet() {
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

/// A hold that was not confirmed goes once more as what all were told since. That alone does not keep the motor off.
#[test]
fn a_stop_that_goes_again_keeps_nobody_off_whom_no_stop_has_switched_off() {
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

/// A motor was told to be off since its hold was given up. The answer to the hold is late, and from before the next
/// stop.
#[test]
fn the_sendings_of_a_hold_are_none_of_the_off_that_it_was_told_since() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Hold).unwrap();
    let now = is_given_up(&mut master, 1, 0);
    let off = master.request_with(id(1), Shutdown, once(20)).unwrap();
    assert_eq!(sent(&mut master, ms(now)).len(), 1);
    let told = events(&mut master, ms(now + 21));
    assert_eq!(told, [Event::Failed { ticket: off.id(), failure: Failure::NoReply }]);
    master.stop(id(1), StopKind::Off).unwrap();
    let late = reply(&mut master, 1, Shutdown.encode(), ms(now + 22));
    assert!(matches!(late, Some(Event::Stray { .. })), "{late:?}");
}

#[test]
fn the_lock_of_a_brake_that_may_not_be_there_ends_no_stop() {
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

/// The outcome of the last one would be reported for the ticket of the next.
#[test]
fn no_request_is_taken_before_it_was_told_that_a_stop_went_again_in_place_of_the_last() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop_all(StopKind::Hold, id(1).into()).unwrap();
    let from = is_given_up(&mut master, 1, 0);
    let read = ask(&mut master, 1, ReadStatus1, ms(from + 95));
    assert_eq!(sent(&mut master, ms(from + 100)), [packet_to(1, Stop.encode())]);
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(from + 101)), confirmed(1));
    assert_eq!(master.request(id(1), ReadStatus1).err(), Some(RequestError::Busy));
    let told = events(&mut master, ms(from + 101));
    assert_eq!(told.iter().find_map(|it| read.outcome(it)), Some(Err(Failure::StopUnconfirmed)));
    assert!(master.request(id(1), ReadStatus1).is_ok());
}
