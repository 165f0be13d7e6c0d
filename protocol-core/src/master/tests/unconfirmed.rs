//! Stops that were not confirmed: they go again when the motor is heard.

use super::*;

/// Motor 1 was stopped so and has confirmed none of the attempts from then on. Gives when that was told.
fn is_given_up(master: &mut Master<2>, from: u64) -> u64 {
    let unconfirmed = [Event::StopUnconfirmed { motor: id(1) }];
    let mut times = from..from + 1_000;
    let told = times.find(|&now| {
        sent(master, ms(now));
        events(master, ms(now)) == unconfirmed
    });
    told.expect("after fifteen attempts")
}

#[test]
fn a_motor_that_has_not_confirmed_its_stop_is_stopped_when_it_is_heard_again() {
    for kind in [StopKind::Hold, StopKind::Off] {
        let mut master = Master::<2>::new(Config::CAN);
        master.stop(id(1), kind).unwrap();
        let mut now = is_given_up(&mut master, 0);
        // The motor that is there says nothing of the other.
        let _ = ask(&mut master, 2, ReadMultiTurnAngle, ms(now));
        reply(&mut master, 2, ANGLE_REPLY, ms(now + 1)).unwrap();
        assert_eq!(sent(&mut master, ms(now + 1)), []);
        // Whatever it says; and again if that is not confirmed, either.
        for _ in 0..2 {
            now += 100;
            let angle = ask(&mut master, 1, ReadMultiTurnAngle, ms(now));
            let told = reply(&mut master, 1, ANGLE_REPLY, ms(now + 1)).unwrap();
            assert!(angle.outcome(&told).is_some());
            let packets = sent(&mut master, ms(now + 1));
            let (_, stop) = kind.command();
            assert_eq!(packets.iter().map(|it| it.data).collect::<Vec<_>>(), [stop]);
            now = is_given_up(&mut master, now + 2);
        }
        // Not once that is lifted.
        master.lift_stop();
        now += 100;
        let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(now));
        reply(&mut master, 1, ANGLE_REPLY, ms(now + 1)).unwrap();
        assert_eq!(sent(&mut master, ms(now + 1)), []);
    }
}

/// Asks motor 1 for its angle and gives what goes out when that is answered.
fn heard(master: &mut Master<2>, now: u64) -> Vec<[u8; 8]> {
    events(master, ms(now));
    let angle = ask(master, 1, ReadMultiTurnAngle, ms(now));
    let told = reply(master, 1, ANGLE_REPLY, ms(now + 1)).unwrap();
    assert!(angle.outcome(&told).is_some());
    sent(master, ms(now + 1)).iter().map(|packet| packet.data).collect()
}

#[test]
fn a_hold_that_was_not_confirmed_does_not_switch_on_what_is_switched_off_since() {
    for is_to_all in [false, true] {
        let mut master = Master::<2>::new(Config::CAN);
        master.stop(id(1), StopKind::Hold).unwrap();
        let now = is_given_up(&mut master, 0) + 100;
        events(&mut master, ms(now));
        if is_to_all {
            master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
        } else {
            let _ = master.request(id(1), Shutdown).unwrap();
        }
        // Nobody hears that, either.
        for now in now..now + 1_000 {
            sent(&mut master, ms(now));
            events(&mut master, ms(now));
        }
        assert_eq!(heard(&mut master, now + 1_000), [Shutdown.encode()], "{is_to_all}");
    }
}

#[test]
fn what_ends_its_motion_takes_an_unconfirmed_stop_back_when_it_is_answered() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Hold).unwrap();
    let now = is_given_up(&mut master, 0) + 100;
    events(&mut master, ms(now));
    let off = ask(&mut master, 1, Shutdown, ms(now));
    // What is heard before says nothing of it, and nothing goes over it.
    let motor = Packet { channel: Channel::Reply(id(1)), data: ANGLE_REPLY };
    master.handle_frame(&Received::Packet(motor), ms(now + 1));
    assert_eq!(sent(&mut master, ms(now + 1)), []);
    let told = reply(&mut master, 1, Shutdown.encode(), ms(now + 2)).unwrap();
    assert!(off.outcome(&told).is_some());
    assert_eq!(sent(&mut master, ms(now + 2)), []);
    assert_eq!(heard(&mut master, now + 100), [[0; 8]; 0]);
}

#[test]
fn a_hold_that_became_a_shutdown_with_all_is_a_shutdown_when_the_motor_is_heard_again() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.broadcast(Shutdown, id(1).into()).unwrap();
    let over = (1..2_000).find(|&now| {
        sent(&mut master, ms(now));
        events(&mut master, ms(now)).contains(&Event::StopUnconfirmed { motor: id(1) })
    });
    // Behind that the command to all goes, which it does not hear, either.
    let now = over.unwrap();
    for now in now..now + 200 {
        sent(&mut master, ms(now));
        events(&mut master, ms(now));
    }
    assert_eq!(heard(&mut master, now + 200), [Shutdown.encode()]);
}

#[test]
fn a_hold_of_long_ago_does_not_switch_on_who_has_no_place_under_a_stop_of_all() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Hold).unwrap();
    let now = is_given_up(&mut master, 0) + 100;
    events(&mut master, ms(now));
    master.lift_stop();
    assert!(master.forget(id(1)));
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    assert_eq!(heard(&mut master, now), [[0; 8]; 0]);
}

#[test]
fn whatever_is_heard_of_a_motor_that_has_confirmed_no_stop_stops_it() {
    let lost = [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0];
    let address = [0x79, 0, 1, 0, 0, 0, 0x41, 0x02];
    let reply = Channel::Reply(id(1));
    let packets = [
        Received::Packet(Packet { channel: reply, data: ANGLE_REPLY }),
        Received::Packet(Packet { channel: Channel::MotionReply(id(1)), data: [1; 8] }),
        Received::Packet(Packet { channel: reply, data: lost }),
        Received::Packet(Packet { channel: Channel::BusId, data: address }),
        Received::WrongLength { channel: reply, length: 1, first: Some(LOST_MASTER_BYTE) },
        Received::WrongLength { channel: reply, length: 7, first: Some(0x92) },
    ];
    for heard in packets {
        let mut master = Master::<2>::new(Config::CAN);
        master.stop(id(1), StopKind::Off).unwrap();
        let now = is_given_up(&mut master, 0) + 100;
        master.handle_frame(&heard, ms(now));
        assert_eq!(master.now, ms(now), "as old as that frame: {heard:?}");
        assert_eq!(sent(&mut master, ms(now)).len(), 1, "{heard:?}");
    }
    // Also before anybody has looked what became of the stop.
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    for now in 0..1_000 {
        sent(&mut master, ms(now));
        master.handle_timeout(ms(now));
    }
    master.handle_frame(&packets[0], ms(1_000));
    assert_eq!(sent(&mut master, ms(1_000)).len(), 1);
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

/// A controller that gives a frame back only after the stop was given up: it was never on the bus.
#[test]
fn a_stop_that_is_handed_back_after_it_was_given_up_goes_again() {
    for attempts in [0, 1] {
        let mut master = Master::<2>::new(Config::CAN);
        master.stop(id(1), StopKind::Off).unwrap();
        let mut now = is_given_up(&mut master, 0) + 100;
        for _ in 0..attempts {
            assert_eq!(heard(&mut master, now), [Shutdown.encode()]);
            now = is_given_up(&mut master, now + 2) + 100;
        }
        let off = packet_to(1, Shutdown.encode());
        master.handle_pushed_out(&off);
        assert_eq!(sent(&mut master, ms(now)), [off], "{attempts}");
        // The other kind, or a read, tells nothing of it; nor does it go once it is lifted.
        now = is_given_up(&mut master, now + 1) + 100;
        master.handle_pushed_out(&packet_to(1, ReadMultiTurnAngle.encode()));
        master.handle_pushed_out(&Packet { channel: Channel::Motion(id(1)), data: off.data });
        assert_eq!(sent(&mut master, ms(now)), [], "{attempts}");
        master.lift_stop();
        master.handle_pushed_out(&off);
        assert_eq!(sent(&mut master, ms(now)), [], "{attempts}");
    }
}

#[test]
fn a_stop_that_is_called_for_has_all_its_attempts_also_while_one_goes_to_who_was_heard() {
    for (is_waiting, is_to_all) in [(false, false), (true, false), (false, true)] {
        let mut master = Master::<2>::new(Config::CAN);
        master.stop_all(StopKind::Off, id(1).into()).unwrap();
        let mut now = is_given_up(&mut master, 0) + 100;
        let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(now));
        reply(&mut master, 1, ANGLE_REPLY, ms(now + 1)).unwrap();
        let mut frames = if is_waiting { 0 } else { sent(&mut master, ms(now + 1)).len() };
        for _ in 0..2 {
            match is_to_all {
                true => master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap(),
                false => master.stop(id(1), StopKind::Off).unwrap(),
            }
        }
        now += 2;
        for at in now..now + 1_000 {
            frames += sent(&mut master, ms(at)).len();
            // Who stops in every cycle is told all the same, and has no more of them.
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
        let mut now = is_given_up(&mut master, 0);
        for times in 0..30 {
            now += 5;
            let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(now));
            answer(&mut master, ANGLE_REPLY, now + 1).unwrap();
            assert_eq!(sent(&mut master, ms(now + 2)), [packet_to(1, Shutdown.encode())]);
            if times < 29 {
                now = is_given_up(&mut master, now + 3);
            }
        }
        assert_eq!(answer(&mut master, Shutdown.encode(), now + 4), confirmed(1), "{config:?}");
        assert_eq!(sent(&mut master, ms(now + 5)), []);
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
        let now = is_given_up(&mut master, 0);
        master.lift_stop();
        // It may be moved here.
        if is_held_first {
            master.stop(id(1), StopKind::Hold).unwrap();
        }
        master.stop(id(1), StopKind::Off).unwrap();
        assert_eq!(sent(&mut master, ms(now)), [packet_to(1, Shutdown.encode())]);
        // Of one of the first fifteen.
        assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(now + 1)), None, "{is_held_first}");
    }
}
