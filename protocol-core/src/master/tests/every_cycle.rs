//! Stops that are called in every cycle: each motor has its turn.

use super::*;

/// Stops all in every cycle of 1 ms; each motor answers its own stop after 900 us. Returns the motors that have got a
/// stop of their own before `until`.
fn stopped_by(mut master: Master<16>, motors: u8, until: u64) -> MotorSet {
    let all: MotorSet = (1..=motors).map(id).collect();
    let is_line = matches!(master.config().bus, Bus::Rs485 { .. });
    let mut stopped = MotorSet::EMPTY;
    // CAN at 1 Mbit/s: four commands and their answers a millisecond.
    let a_cycle = if is_line { 1 } else { 4 };
    for now in 0..until {
        master.stop_all(StopKind::Off, all).unwrap();
        master.handle_timeout(ms(now));
        for _ in 0..a_cycle {
            let Some(packet) = master.poll_transmit(ms(now)) else { break };
            master.handle_transmitted(ms(now));
            let Channel::Command(Target::Motor(motor)) = packet.channel else { continue };
            stopped.insert(motor);
            let answered = ms(now) + Duration::from_micros(900);
            let frame = Frame { address: Target::Motor(motor), data: packet.data };
            if is_line {
                master.handle_line(&frame, answered);
            } else {
                reply(&mut master, motor.get(), packet.data, answered);
            }
        }
    }
    stopped
}

#[test]
fn on_rs485_cyclic_stop_of_confirmed_motors_delays_no_first_stop() {
    let master = Master::new(Config::rs485(1_000_000, false));
    // One to all and the pause after it, and an exchange with each: 5 ms and 2 ms.
    assert_eq!(stopped_by(master, 2, 20).len(), 2);
}

#[test]
fn on_can_cyclic_stop_of_confirmed_motors_delays_no_first_stop() {
    // Four a millisecond.
    assert_eq!(stopped_by(Master::new(Config::CAN), 16, 4).len(), 16);
}

#[test]
fn confirmed_stop_called_again_has_all_fifteen_attempts() {
    let mut master = Master::<2>::new(Config::CAN);
    for _ in 0..2 {
        master.stop_all(StopKind::Off, id(1).into()).unwrap();
        assert_eq!(sent(&mut master, ms(0)).len(), 1);
        reply(&mut master, 1, Shutdown.encode(), ms(1));
        assert_eq!(events(&mut master, ms(1)), []);
    }
    master.stop_all(StopKind::Off, id(1).into()).unwrap();
    let mut attempts = 0;
    let reported = (1..1_000).find_map(|now| {
        attempts += sent(&mut master, ms(now)).len();
        events(&mut master, ms(now)).pop()
    });
    assert_eq!((attempts, reported), (15, Some(Event::StopUnconfirmed { motor: id(1) })));
}

/// Motor 2 did not answer its last request: only that it has got no stop yet brings it forward.
#[test]
fn shutdown_of_all_goes_first_to_the_motor_not_stopped_yet() {
    let mut master = Master::<2>::new(Config::CAN);
    let _read = master.request_with(id(2), ReadModel, once(5)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    assert_eq!(events(&mut master, ms(5)).len(), 1);
    master.stop_all(StopKind::Hold, id(1).into()).unwrap();
    let first = master.poll_transmit(ms(6));
    assert_eq!(first, Some(packet_to(1, Stop.encode())));
    master.handle_transmitted(ms(6));
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    assert_eq!(master.poll_transmit(ms(6)), Some(packet_to(2, Shutdown.encode())));
}

/// What a line carries in 200 ms while `stop` calls for stops every millisecond, and another caller wants to switch
/// motor 7 off and to move motor 8. Drives answer after 900 us; motor 2 is not there. Returns how often each was
/// answered.
fn answered_during(stop: impl Fn(&mut Master<8>)) -> [u32; 8] {
    let mut master = Master::<8>::new(Config::rs485(1_000_000, false));
    let mut answered = [0; 8];
    for now in 0..200 {
        stop(&mut master);
        // Refused while one is under way.
        let _off = master.request(id(7), Shutdown);
        master.set_point(id(8), torque(1.0), ms(now)).unwrap();
        events(&mut master, ms(now));
        let Some(packet) = master.poll_transmit(ms(now)) else { continue };
        master.handle_transmitted(ms(now));
        let motor = match packet.channel {
            Channel::Command(Target::Motor(motor)) if motor != id(2) => motor,
            _ => continue,
        };
        let data = if motor == id(8) { TORQUE_REPLY } else { packet.data };
        let frame = Frame { address: Target::Motor(motor), data };
        if master.handle_line(&frame, ms(now) + Duration::from_micros(900)).is_some() {
            answered[motor.index()] += 1;
        }
    }
    answered
}

#[test]
fn on_rs485_cyclic_stop_leaves_every_second_turn_to_others() {
    let one = answered_during(|master| master.stop(id(1), StopKind::Off).unwrap());
    // A turn a millisecond: the first stop, and then it has half of them.
    assert_eq!([one[0], one[6], one[7]], [101, 50, 49]);
}

#[test]
fn cyclic_stop_does_not_resend_a_finished_broadcast() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    master.broadcast(ReadModel, MotorSet::EMPTY).unwrap();
    let mut to_all = 0;
    for now in 0..100 {
        master.stop(id(1), StopKind::Off).unwrap();
        events(&mut master, ms(now));
        let Some(packet) = master.poll_transmit(ms(now)) else { continue };
        master.handle_transmitted(ms(now));
        to_all += u32::from(packet.channel == Channel::Command(Target::All));
        let frame = Frame { address: Target::Motor(id(1)), data: packet.data };
        master.handle_line(&frame, ms(now) + Duration::from_micros(900));
    }
    assert_eq!(to_all, 1);
}

/// The broadcast is over, no matter which motors answer it, when the stop is called for the next time.
#[test]
fn cyclic_stop_gets_turns_during_cyclic_broadcasts() {
    let both = answered_during(|master| {
        master.stop(id(1), StopKind::Off).unwrap();
        let _active = master.broadcast(ReadModel, MotorSet::EMPTY);
    });
    assert!(both[0] >= 10, "{both:?}");
}

/// Motor 1 may answer each broadcast yet, and does not.
#[test]
fn broadcast_during_a_cyclic_stop_waits_for_answers_to_the_last_one() {
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    let mut to_all = Vec::new();
    for now in 0..300 {
        master.stop(id(1), StopKind::Off).unwrap();
        let _active = master.broadcast(ReadModel, MotorSet::EMPTY);
        events(&mut master, ms(now));
        let Some(packet) = master.poll_transmit(ms(now)) else { continue };
        master.handle_transmitted(ms(now));
        if packet.channel == Channel::Command(Target::All) {
            to_all.push(ms(now));
        } else {
            let frame = Frame { address: Target::Motor(id(1)), data: packet.data };
            master.handle_line(&frame, ms(now) + Duration::from_micros(900));
        }
    }
    let may_come_for = master.config().reply_timeout + master.config().late_window;
    let waits = |pair: &[Instant]| pair[1] - pair[0] >= may_come_for;
    assert!(to_all.len() > 1 && to_all.windows(2).all(waits), "{to_all:?}");
}

/// The first call keeps the line for its fifteen attempts, of 5 ms each; each call after that for one in two turns.
#[test]
fn cyclic_stop_of_an_absent_motor_leaves_turns_to_others() {
    let dead = answered_during(|master| master.stop(id(2), StopKind::Off).unwrap());
    assert!(dead[6] >= 5 && dead[7] >= 5, "{dead:?}");
}

/// Calls `stop` 1,000 times, `period_ms` apart, and loses every `lost`th answer. Motors answer their own stops after
/// 900 us; on a line, answers to a stop to all are not heard. Returns how many stops of each motor were confirmed, and
/// how many were not.
fn of_every_cycle(
    mut master: Master<4>,
    stop: impl Fn(&mut Master<4>),
    period_ms: u64,
    lost: u32,
) -> ([u32; 4], u32) {
    let is_line = matches!(master.config().bus, Bus::Rs485 { .. });
    let (mut answers, mut confirmed, mut unconfirmed) = (0, [0; 4], 0);
    for now in 0..1_000 * period_ms {
        if now % period_ms == 0 {
            stop(&mut master);
        }
        for event in events(&mut master, ms(now)) {
            unconfirmed += u32::from(matches!(event, Event::StopUnconfirmed { .. }));
        }
        let Some(packet) = master.poll_transmit(ms(now)) else { continue };
        master.handle_transmitted(ms(now));
        let Channel::Command(Target::Motor(motor)) = packet.channel else { continue };
        answers += 1;
        if answers % lost == 0 {
            continue;
        }
        let answered = ms(now) + Duration::from_micros(900);
        let event = if is_line {
            let frame = Frame { address: Target::Motor(motor), data: packet.data };
            master.handle_line(&frame, answered)
        } else {
            reply(&mut master, motor.get(), packet.data, answered)
        };
        confirmed[motor.index()] += u32::from(event == Some(Event::StopConfirmed { motor }));
    }
    (confirmed, unconfirmed)
}

#[test]
fn lost_answer_does_not_keep_a_cyclic_stop_unconfirmed() {
    let stop = |master: &mut Master<4>| master.stop(id(1), StopKind::Off).unwrap();
    let lift_and_stop = |master: &mut Master<4>| {
        master.lift_stop();
        stop(master);
    };
    for config in [Config::CAN, Config::rs485(1_000_000, false)] {
        for period_ms in [2, 10, 50] {
            let (confirmed, unconfirmed) = of_every_cycle(Master::new(config), stop, period_ms, 25);
            assert_eq!(unconfirmed, 0, "{period_ms} ms");
            assert!(confirmed[0] > 300, "{period_ms} ms: {confirmed:?}");
            let lifted = of_every_cycle(Master::new(config), lift_and_stop, period_ms, 25);
            assert_eq!(lifted, (confirmed, unconfirmed), "{period_ms} ms, lifted each time");
        }
    }
}

#[test]
fn on_rs485_cyclic_stop_of_all_is_confirmed() {
    let all: MotorSet = (1..=4).map(id).collect();
    let stop = |master: &mut Master<4>| master.stop_all(StopKind::Off, all).unwrap();
    let line = Config::rs485(1_000_000, false);
    let slow = Config {
        reply_timeout: Duration::from_millis(60),
        late_window: Duration::from_millis(120),
        ..line
    };
    for (config, period_ms, at_least) in [
        (line, 1, 170),
        (line, 2, 350),
        (line, 5, 750),
        (line, 10, 750),
        (line, 50, 1_000),
        (slow, 1, 5),
        (slow, 10, 50),
    ] {
        let (confirmed, unconfirmed) =
            of_every_cycle(Master::new(config), stop, period_ms, u32::MAX);
        assert_eq!(unconfirmed, 0, "{period_ms} ms");
        assert!(confirmed.iter().all(|&it| it >= at_least), "{period_ms} ms: {confirmed:?}");
    }
}

/// Nothing moves the motors between two calls, so it is as if their stops were not lifted. One stop to all goes every
/// 100 ms, and its answers, which may come, are waited for.
#[test]
fn on_rs485_stops_lifted_and_called_again_are_confirmed() {
    let all: MotorSet = (1..=3).map(id).collect();
    let lift_and_stop = |master: &mut Master<4>| {
        master.lift_stop();
        master.stop_all(StopKind::Off, all).unwrap();
    };
    for (period_ms, at_least) in [(1, 150), (2, 300), (5, 700), (20, 800), (25, 800)] {
        let line = Master::new(Config::rs485(1_000_000, false));
        let (confirmed, unconfirmed) = of_every_cycle(line, lift_and_stop, period_ms, u32::MAX);
        assert_eq!(unconfirmed, 0, "every {period_ms} ms");
        assert!(confirmed[..3].iter().all(|&it| it >= at_least), "{period_ms} ms: {confirmed:?}");
    }
}

/// One thread reads a motor's status while another stops it.
#[test]
fn request_dropped_by_a_cyclic_stop_takes_no_turn_of_others() {
    let both = answered_during(|master| {
        let _dropped = master.request(id(1), ReadMultiTurnAngle);
        master.stop(id(1), StopKind::Off).unwrap();
    });
    assert_eq!([both[0], both[6], both[7]], [101, 50, 49]);
}

/// This motor is stopped, gets its stop at this time, and confirms it 900 us later.
fn is_stopped_by_line(master: &mut Master<8>, motor: u8, kind: StopKind, at: Instant) {
    master.stop(id(motor), kind).unwrap();
    let (_, data) = kind.command();
    assert_eq!(sent(master, at), [packet_to(motor, data)]);
    assert_eq!(says(master, motor, data, at + Duration::from_micros(900)), confirmed(motor));
}

/// A line on which motor 1 is stopped like this, and called again, and motor 8 follows a stream.
fn called_again(kind: StopKind) -> Master<8> {
    let mut master = Master::<8>::new(Config::rs485(1_000_000, false));
    obeys(&mut master, 1);
    is_stopped_by_line(&mut master, 1, kind, ms(0));
    is_stopped_by_line(&mut master, 1, kind, ms(1));
    master.set_point(id(8), torque(1.0), ms(2)).unwrap();
    master
}

#[test]
fn first_stop_is_sent_right_after_a_repeated_stop_of_another_motor() {
    let mut master = called_again(StopKind::Off);
    is_stopped_by_line(&mut master, 2, StopKind::Off, ms(2));
}

#[test]
fn shutdown_in_place_of_a_repeated_hold_is_sent_before_a_set_point() {
    let mut master = called_again(StopKind::Hold);
    is_stopped_by_line(&mut master, 1, StopKind::Off, ms(2));
}

/// The hold was given up before the shutdown.
#[test]
fn shutdown_in_place_of_an_unconfirmed_hold_is_no_repeated_stop() {
    let mut master = called_again(StopKind::Hold);
    master.stop(id(2), StopKind::Hold).unwrap();
    let now = is_given_up(&mut master, 2, 2);
    is_stopped_by_line(&mut master, 1, StopKind::Hold, ms(now));
    master.set_point(id(8), torque(1.0), ms(now + 1)).unwrap();
    master.stop(id(2), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(now + 1)), [packet_to(2, Shutdown.encode())]);
}

/// The motor is held once more, though it has confirmed a hold before.
#[test]
fn hold_after_a_shutdown_to_all_is_no_repeated_stop() {
    let mut master = called_again(StopKind::Hold);
    assert_eq!(sent(&mut master, ms(2)).len(), 1);
    says(&mut master, 8, TORQUE_REPLY, Instant::from_micros(2_900)).unwrap();
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(3)), [packet_to_all(Shutdown.encode())]);
    events(&mut master, ms(30));
    obeys(&mut master, 3);
    is_stopped_by_line(&mut master, 3, StopKind::Hold, ms(30));
    is_stopped_by_line(&mut master, 3, StopKind::Hold, ms(31));
    master.set_point(id(8), torque(1.0), ms(32)).unwrap();
    is_stopped_by_line(&mut master, 1, StopKind::Hold, ms(32));
}

/// The motor was off before, and neither broadcast changes that.
#[test]
fn stop_after_a_shutdown_or_read_to_all_is_a_repeated_stop() {
    fn follows_a_set_point_after<C: Command>(to_all: C) {
        let mut master = called_again(StopKind::Off);
        assert_eq!(sent(&mut master, ms(2)).len(), 1);
        says(&mut master, 8, TORQUE_REPLY, Instant::from_micros(2_900)).unwrap();
        let data = to_all.encode();
        master.broadcast(to_all, MotorSet::EMPTY).unwrap();
        assert_eq!(sent(&mut master, ms(3)), [packet_to_all(data)]);
        events(&mut master, ms(30));
        is_stopped_by_line(&mut master, 1, StopKind::Off, ms(30));
        master.set_point(id(8), torque(1.0), ms(31)).unwrap();
        master.stop(id(1), StopKind::Off).unwrap();
        assert_eq!(sent(&mut master, ms(31)), [packet_to(8, torque(1.0).encode())], "{data:?}");
    }
    follows_a_set_point_after(Shutdown);
    follows_a_set_point_after(ReadModel);
}

/// Motors 2 and 4 are off, and stopped again; motor 1 is held, and was asked something since motor 2 was.
#[test]
fn new_stop_gives_no_turn_away_after_repeated_stops() {
    let mut master = called_again(StopKind::Hold);
    for at in [2, 3] {
        master.set_point(id(8), torque(1.0), ms(at)).unwrap();
        assert_eq!(sent(&mut master, ms(at)).len(), 1);
        says(&mut master, 8, TORQUE_REPLY, ms(at) + Duration::from_micros(900)).unwrap();
    }
    for at in [4, 5] {
        is_stopped_by_line(&mut master, 2, StopKind::Off, ms(at));
    }
    let _read = ask(&mut master, 1, ReadMultiTurnAngle, ms(6));
    says(&mut master, 1, ANGLE_REPLY, Instant::from_micros(6_900)).unwrap();
    for at in [7, 8] {
        is_stopped_by_line(&mut master, 4, StopKind::Off, ms(at));
    }
    master.set_point(id(8), torque(1.0), ms(9)).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    is_stopped_by_line(&mut master, 2, StopKind::Off, ms(9));
    assert_eq!(sent(&mut master, ms(10)), [packet_to(1, Shutdown.encode())]);
}

#[test]
fn repeated_stop_gives_no_turn_to_a_restarting_motor() {
    let mut master = Master::<8>::new(Config::rs485(1_000_000, false));
    let _reset = ask(&mut master, 8, Reset, ms(0));
    events(&mut master, ms(0));
    for at in [10, 11] {
        is_stopped_by_line(&mut master, 1, StopKind::Off, ms(at));
    }
    let _read = master.request(id(8), ReadModel).unwrap();
    is_stopped_by_line(&mut master, 1, StopKind::Off, ms(12));
}

#[test]
fn repeated_stop_gives_its_turn_to_a_broadcast() {
    let mut master = called_again(StopKind::Off);
    master.broadcast(ReadModel, MotorSet::EMPTY).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(2)), [packet_to_all(ReadModel.encode())]);
}

/// A cable is out, and nothing is answered: neither what moves the motor `before` a stop, nor that stop, nor what moves
/// it `behind` it, after it was lifted. Then each stop is answered after a millisecond, with nothing else on the bus.
/// Returns after how many ms each stop is sent until one is confirmed.
fn sent_after_a_cut(
    before: impl Fn(&mut Master<2>, Instant),
    behind: impl Fn(&mut Master<2>, Instant),
) -> Vec<u64> {
    let mut master = Master::<2>::new(Config::CAN);
    before(&mut master, ms(0));
    sent(&mut master, ms(0));
    events(&mut master, ms(100));
    master.stop_all(StopKind::Off, id(1).into()).unwrap();
    let now = is_given_up(&mut master, 1, 100);
    master.lift_stop();
    behind(&mut master, ms(now));
    sent(&mut master, ms(now));
    master.stop(id(1), StopKind::Off).unwrap();
    let mut sendings = Vec::new();
    for after in 1..1_000 {
        let now = ms(now + after);
        if sendings.last() == Some(&(after - 1))
            && reply(&mut master, 1, Shutdown.encode(), now) == confirmed(1)
        {
            return sendings;
        }
        assert!(!events(&mut master, now).contains(&Event::StopUnconfirmed { motor: id(1) }));
        if sent(&mut master, now).contains(&packet_to(1, Shutdown.encode())) {
            sendings.push(after);
        }
    }
    panic!("no stop is confirmed: {sendings:?}");
}

/// If the motor was moved since the last stop, half of the attempts go at once, and one 61 ms after the last of these.
/// If something may be in a mailbox, the answer to that one shows that it leaves now, and the last goes 41 ms later.
#[test]
fn stop_after_a_cut_is_confirmed_without_other_traffic_on_the_bus() {
    let set_point = |master: &mut Master<2>, now| {
        master.set_point(id(1), torque(1.0), now).unwrap();
    };
    let all = |master: &mut Master<2>, _| {
        master.broadcast(torque(1.0), id(1).into()).unwrap();
    };
    let nothing = |_: &mut Master<2>, _| {};
    let at_once_and = |then: &[u64]| [&[1, 2, 3, 4, 5, 6, 7, 8], then].concat();
    // Nothing could undo that stop: it goes on.
    assert_eq!(sent_after_a_cut(nothing, nothing), [1]);
    assert_eq!(sent_after_a_cut(all, nothing), [1, 63]);
    assert_eq!(sent_after_a_cut(nothing, set_point), at_once_and(&[70, 112]));
    assert_eq!(sent_after_a_cut(nothing, all), at_once_and(&[70, 112]));
}

/// A motor without a place may have missed the first one.
#[test]
fn on_rs485_cyclic_stop_to_all_is_sent_every_100_ms() {
    let mut master = Master::<8>::new(Config::rs485(1_000_000, false));
    let mut to_all = Vec::new();
    for now in 0..250 {
        events(&mut master, ms(now));
        master.stop_all(StopKind::Off, id(1).into()).unwrap();
        let Some(packet) = master.poll_transmit(ms(now)) else { continue };
        master.handle_transmitted(ms(now));
        if packet == packet_to_all(Shutdown.encode()) {
            to_all.push(now);
        } else {
            says(&mut master, 1, packet.data, ms(now) + Duration::from_micros(900));
        }
    }
    assert_eq!(to_all.len(), 3, "{to_all:?}");
    assert!(to_all.windows(2).all(|two| two[1] - two[0] >= 100), "{to_all:?}");
}

#[test]
fn stop_to_all_gives_no_turn_away() {
    let mut master = Master::<8>::new(Config::rs485(1_000_000, false));
    is_stopped_by_line(&mut master, 1, StopKind::Off, ms(0));
    is_stopped_by_line(&mut master, 1, StopKind::Off, ms(1));
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    master.broadcast(ReadModel, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(2)), [packet_to_all(Shutdown.encode())]);
}

/// After a restart the motor holds nothing.
#[test]
fn hold_after_a_restart_is_no_repeated_stop() {
    let mut master = called_again(StopKind::Hold);
    master.note_restart(id(1));
    is_stopped_by_line(&mut master, 1, StopKind::Hold, ms(2));
}

/// Each answer comes with the next call, so that a stop is always in flight.
#[test]
fn broadcast_and_requests_are_sent_during_a_cyclic_stop() {
    let mut master = Master::<4>::new(Config::CAN);
    let (mut is_broadcast, mut is_asked) = (false, false);
    for now in 0..100 {
        master.stop(id(1), StopKind::Off).unwrap();
        if now == 20 {
            master.broadcast(ReadStatus1, MotorSet::EMPTY).unwrap();
            let _model = master.request(id(3), ReadModel).unwrap();
        }
        for packet in sent(&mut master, ms(now)) {
            is_broadcast |= packet == packet_to_all(ReadStatus1.encode());
            is_asked |= packet == packet_to(3, ReadModel.encode());
            if packet == packet_to(1, Shutdown.encode()) {
                reply(&mut master, 1, packet.data, ms(now + 1));
            }
        }
        events(&mut master, ms(now + 1));
    }
    assert!(is_broadcast && is_asked);
}

/// All are asked again and again, and one of them never answers, or none is expected to. Motor 1 streams, answers after
/// 900 us, and is asked for something once.
#[test]
fn request_gets_its_turn_during_cyclic_broadcasts() {
    for expected in [[1, 2].map(id).into_iter().collect(), id(1).into(), MotorSet::EMPTY] {
        let mut master = Master::<2>::new(Config::CAN);
        let _unheard = master.request(id(2), ReadModel).unwrap();
        let (mut answers, mut asked_at) = (Vec::new(), None);
        for slot in 0..4_000 {
            let now = Instant::from_micros(125 * slot);
            if let Some(at) = answers.iter().position(|&(due, _)| due <= slot) {
                let (_, data) = answers.remove(at);
                reply(&mut master, 1, data, now);
            }
            master.set_point(id(1), torque(1.0), now).unwrap();
            let _active = master.broadcast(ReadMultiTurnAngle, expected);
            if slot == 2_000 {
                let _read = master.request(id(1), ReadRunTime).unwrap();
            }
            events(&mut master, now);
            while let Some(packet) = master.poll_transmit(now) {
                master.handle_transmitted(now);
                match packet.data[0] {
                    0xA1 => answers.push((slot + 7, TORQUE_REPLY)),
                    0x92 => answers.push((slot + 7, ANGLE_REPLY)),
                    0xB1 => asked_at = asked_at.or(Some(slot)),
                    _ => {}
                }
            }
        }
        // Until a broadcast that was put before it is over, and can no longer be answered late: 62 ms.
        assert!(asked_at.is_some_and(|slot| slot - 2_000 <= 8 * 63), "{asked_at:?}");
    }
}

/// Not even where a controller has handed the broadcast back once.
#[test]
fn repeated_stop_gives_no_turn_to_a_finished_broadcast() {
    for is_handed_back in [false, true] {
        let mut master = Master::<2>::new(Config::CAN);
        master.broadcast(ReadModel, MotorSet::EMPTY).unwrap();
        let to_all = [packet_to_all(ReadModel.encode())];
        assert_eq!(sent(&mut master, ms(0)), to_all);
        if is_handed_back {
            master.handle_pushed_out(&to_all[0]);
            assert_eq!(sent(&mut master, ms(1)), to_all);
        }
        let over = Event::BroadcastDone { silent: MotorSet::EMPTY, was_sent: true };
        assert_eq!(events(&mut master, ms(1)), [over]);
        // Answers to it cannot come any more: 20.4 ms and 40.8 ms.
        for now in [100, 102] {
            master.stop(id(1), StopKind::Off).unwrap();
            assert_eq!(sent(&mut master, ms(now)), [packet_to(1, Shutdown.encode())]);
            assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(now + 1)), confirmed(1));
        }
    }
}

/// The broadcast waits for a read that was given up, of which the answer may still come.
#[test]
fn repeated_stop_gives_no_turn_to_a_broadcast_that_must_wait() {
    let mut master = Master::<2>::new(Config::CAN);
    let _read = master.request_with(id(2), ReadModel, once(5)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    assert_eq!(events(&mut master, ms(5)).len(), 1);
    master.broadcast(ReadModel, MotorSet::EMPTY).unwrap();
    for now in [6, 8] {
        master.stop(id(1), StopKind::Off).unwrap();
        assert_eq!(sent(&mut master, ms(now)), [packet_to(1, Shutdown.encode())]);
        assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(now + 1)), confirmed(1));
    }
}

/// The absent motor was sent nothing while the other had 2,000 turns.
#[test]
fn stream_goes_on_while_an_absent_motor_is_stopped_anew_in_every_cycle() {
    let mut master = Master::<2>::new(Config::CAN);
    let mut shares = [0; 2];
    for now in 0..3_000 {
        master.set_point(id(1), torque(1.0), ms(now)).unwrap();
        if now >= 2_000 {
            master.lift_stop_of(id(2));
            master.stop(id(2), StopKind::Off).unwrap();
        }
        for packet in sent(&mut master, ms(now)) {
            if packet.channel == Channel::Command(id(1).into()) {
                shares[usize::from(now >= 2_000)] += 1;
                reply(&mut master, 1, TORQUE_REPLY, ms(now) + Duration::from_micros(900));
            }
        }
        events(&mut master, ms(now) + Duration::from_micros(950));
    }
    assert!(shares[0] > 1_900, "{shares:?}");
    assert!(shares[1] > 200, "{shares:?}");
}

/// The later stop is reported as unconfirmed only after an attempt of its own. If it is called in every cycle, there
/// are as many attempts again and no more.
#[test]
fn stop_called_after_the_last_attempt_of_an_earlier_one_is_sent() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    let attempts = (0..).scan(0, |count, now| {
        *count += sent(&mut master, ms(now)).len();
        events(&mut master, ms(now));
        Some((*count, now))
    });
    let now = attempts.skip_while(|&(count, _)| count < 15).map(|(_, now)| now).next().unwrap();
    master.lift_stop();
    master.stop(id(1), StopKind::Off).unwrap();
    let sent_at = (now..).find(|&now| !sent(&mut master, ms(now)).is_empty()).unwrap();
    assert!(sent_at - now <= 25, "{sent_at} {now}");
    let mut count = 16;
    let reported = (sent_at..sent_at + 2_000).find(|&now| {
        master.stop(id(1), StopKind::Off).unwrap();
        let reported = events(&mut master, ms(now));
        count += sent(&mut master, ms(now)).len();
        reported.contains(&Event::StopUnconfirmed { motor: id(1) })
    });
    assert!(reported.is_some());
    assert_eq!(count, 30);
}

/// The caller need not look at the time more often than `poll_at` says.
#[test]
fn poll_at_returns_when_a_stop_that_waits_for_a_broadcast_may_go() {
    let mut master = Master::<2>::new(Config::CAN);
    let stop = [packet_to(1, Shutdown.encode())];
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(99)), stop);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(100)), confirmed(1));
    master.broadcast(ReadModel, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(100)).len(), 1);
    events(&mut master, ms(100));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(100)), []);
    let quiet = master.poll_at().unwrap();
    assert!(quiet < ms(101), "{quiet:?}");
    assert_eq!(sent(&mut master, quiet), stop);
}
