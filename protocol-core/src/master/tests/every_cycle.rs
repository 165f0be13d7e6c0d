//! Stops that are called in every cycle: each motor has its turn.

use super::*;

/// Stops all in every cycle of 1 ms; each motor answers its own stop after 900 us. Gives who has got a stop of its
/// own before `until`.
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
fn who_has_confirmed_a_stop_of_every_cycle_keeps_no_other_motors_first_stop_back_on_a_line() {
    let master = Master::new(Config::rs485(1_000_000, false));
    // One to all and the pause behind it, and an exchange with each: 5 ms and 2 ms.
    assert_eq!(stopped_by(master, 2, 20).len(), 2);
}

#[test]
fn who_has_confirmed_a_stop_of_every_cycle_keeps_no_other_motors_first_stop_back() {
    // Four a millisecond.
    assert_eq!(stopped_by(Master::new(Config::CAN), 16, 4).len(), 16);
}

#[test]
fn a_stop_that_was_confirmed_once_is_tried_fourteen_times_when_it_is_called_again() {
    let mut master = Master::<2>::new(Config::CAN);
    for _ in 0..2 {
        master.stop_all(StopKind::Off, id(1).into()).unwrap();
        assert_eq!(sent(&mut master, ms(0)).len(), 1);
        reply(&mut master, 1, Shutdown.encode(), ms(1));
        assert_eq!(events(&mut master, ms(1)), []);
    }
    master.stop_all(StopKind::Off, id(1).into()).unwrap();
    let mut attempts = 0;
    let told = (1..1_000).find_map(|now| {
        attempts += sent(&mut master, ms(now)).len();
        events(&mut master, ms(now)).pop()
    });
    assert_eq!((attempts, told), (14, Some(Event::StopUnconfirmed { motor: id(1) })));
}

/// Motor 2 did not answer its last question, so that nothing but having been told nothing yet brings it forward.
#[test]
fn who_was_told_and_is_let_go_with_all_goes_behind_who_was_told_nothing_yet() {
    let mut master = Master::<2>::new(Config::CAN);
    let once = Patience { reply_timeout: Duration::from_millis(5), attempts: 1 };
    let _read = master.request_with(id(2), ReadModel, once).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    assert_eq!(events(&mut master, ms(5)).len(), 1);
    master.stop_all(StopKind::Hold, id(1).into()).unwrap();
    let first = master.poll_transmit(ms(6));
    assert_eq!(first, Some(packet_to(1, Stop.encode())));
    master.handle_transmitted(ms(6));
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    assert_eq!(master.poll_transmit(ms(6)), Some(packet_to(2, Shutdown.encode())));
}

/// What a line carries in 200 ms while `stop` calls for stops every millisecond, and somebody else wants to switch
/// motor 7 off and to move motor 8. Drives answer after 900 us; motor 2 is not there. Gives how often each was
/// answered.
fn answered_beside(stop: impl Fn(&mut Master<8>)) -> [u32; 8] {
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
fn a_stop_of_every_cycle_leaves_every_second_turn_on_a_line_to_others() {
    let one = answered_beside(|master| master.stop(id(1), StopKind::Off).unwrap());
    // A turn a millisecond: the first stop, and then it has half of them.
    assert_eq!([one[0], one[6], one[7]], [101, 50, 49]);
}

/// The broadcast is over, whoever answers it, when the stop is called for the next time.
#[test]
fn a_stop_of_every_cycle_has_its_turn_beside_broadcasts_of_every_cycle() {
    let both = answered_beside(|master| {
        master.stop(id(1), StopKind::Off).unwrap();
        let _active = master.broadcast(ReadModel, MotorSet::EMPTY);
    });
    assert!(both[0] >= 10, "{both:?}");
}

/// The first call keeps the line for its fifteen attempts, of 5 ms each; each call after that for one in two turns.
#[test]
fn a_stop_of_every_cycle_of_a_motor_that_is_not_there_leaves_others_their_turn() {
    let dead = answered_beside(|master| master.stop(id(2), StopKind::Off).unwrap());
    assert!(dead[6] >= 5 && dead[7] >= 5, "{dead:?}");
}
