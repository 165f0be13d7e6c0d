//! On CAN a command to all may move motors that nobody has named: a stop of all goes to all at once, too.

use super::*;

const TO_ALL: Channel = Channel::Command(Target::All);

/// All were told to move; motor 1 has a place, and whoever else has heard it has none.
fn all_move() -> Master<2> {
    let mut master = Master::new(Config::CAN);
    master.broadcast(torque(1.0), id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    reply(&mut master, 1, [0xA1, 30, 0, 0, 0, 0, 7, 0], ms(1));
    events(&mut master, ms(1));
    master
}

fn channels(packets: &[Packet]) -> Vec<Channel> {
    packets.iter().map(|packet| packet.channel).collect()
}

fn to(motor: u8) -> Channel {
    Channel::Command(Target::Motor(id(motor)))
}

fn confirmed(motor: u8) -> Option<Event> {
    Some(Event::StopConfirmed { motor: id(motor) })
}

#[test]
fn a_stop_of_all_reaches_whom_a_command_to_all_has_moved() {
    let mut master = all_move();
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(100));
    assert_eq!(channels(&packets), [TO_ALL, to(1)], "before each motor's own");
    assert!(packets.iter().all(|packet| packet.data == Stop.encode()));
    // What all are told that cannot move them asks for no such thing.
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    sent(&mut master, ms(0));
    master.stop_all(StopKind::Hold, id(1).into()).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(100))), [to(1)]);
}

#[test]
fn its_answer_confirms_no_stop_of_one_motor() {
    let stopped = || {
        let mut master = all_move();
        master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
        assert_eq!(sent(&mut master, ms(100)).len(), 2);
        master
    };
    let mut master = stopped();
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(101)), None, "to one of the two");
    assert_eq!(sent(&mut master, ms(101)), [], "the other answer is on its way");
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(102)), confirmed(1));
    assert!(master.motors() == id(1).into() && events(&mut master, ms(102)).is_empty());

    // One of the two commands, or of the answers, is lost.
    let mut master = stopped();
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(101)), None);
    assert_eq!(channels(&sent(&mut master, ms(121))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(122)), confirmed(1));
}

#[test]
fn an_answer_that_comes_before_ones_own_stop_was_sent_is_none_to_it() {
    let mut master = all_move();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    let packet = master.poll_transmit(ms(100)).unwrap();
    master.handle_transmitted(ms(100));
    assert_eq!(packet.channel, TO_ALL);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(101)), None);
    assert_eq!(channels(&sent(&mut master, ms(101))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(102)), confirmed(1));
}

#[test]
fn handed_back_it_goes_once_more_and_its_answer_is_awaited_once() {
    let mut master = all_move();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(100));
    master.handle_pushed_out(&packets[0]);
    // Only the motor's own was on the bus.
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(101)), confirmed(1));
    assert_eq!(channels(&sent(&mut master, ms(101))), [TO_ALL]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(102)), None);
    // Not after the stop was lifted, and not where it would switch on who is to be off.
    master.lift_stop();
    master.handle_pushed_out(&packets[0]);
    assert_eq!(sent(&mut master, ms(103)), []);
    let mut master = all_move();
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(100));
    master.stop(id(1), StopKind::Off).unwrap();
    master.handle_pushed_out(&packets[0]);
    assert_eq!(channels(&sent(&mut master, ms(101))), [to(1)]);
}

#[test]
fn an_older_one_that_is_handed_back_does_not_follow_a_newer_stop() {
    let mut master = all_move();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    let older = sent(&mut master, ms(100));
    master.lift_stop();
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(101))), [TO_ALL, to(1)]);
    // It would let go whom the newer one holds.
    master.handle_pushed_out(&older[0]);
    assert_eq!(sent(&mut master, ms(102)), []);
}

#[test]
fn one_that_waits_is_not_given_up_for_another_that_may_not_go() {
    let mut master = all_move();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    // Whom nobody has named has heard nothing yet.
    master.stop_all(StopKind::Hold, id(2).into()).unwrap();
    let packets = sent(&mut master, ms(100));
    assert_eq!(channels(&packets), [TO_ALL, to(1), to(2)]);
    assert_eq!(packets[0].data, Shutdown.encode());
}

#[test]
fn handed_back_it_is_not_taken_for_a_command_to_all_of_long_ago() {
    let mut master = all_move();
    sent(&mut master, ms(200));
    master.broadcast(Stop, id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(300)).len(), 1);
    reply(&mut master, 1, Stop.encode(), ms(301));
    events(&mut master, ms(301));
    events(&mut master, ms(900));
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(1_000));
    assert_eq!(channels(&packets), [TO_ALL, to(1)]);
    master.handle_pushed_out(&packets[0]);
    assert_eq!(channels(&sent(&mut master, ms(1_000))), [TO_ALL], "at once");
}

#[test]
fn off_is_confirmed_once_no_hold_of_all_can_come_behind_it() {
    // In a controller that sends by priority 0x141 overtakes 0x280, whichever was put first.
    for is_sent_before in [false, true] {
        let mut master = all_move();
        master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
        if is_sent_before {
            sent(&mut master, ms(100));
        }
        master.stop(id(1), StopKind::Off).unwrap();
        sent(&mut master, ms(100));
        assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(101)), None, "{is_sent_before}");
    }
}

#[test]
fn a_shutdown_that_is_asked_for_is_answered_once_no_hold_of_all_can_come_behind_it() {
    for is_sent_before in [false, true] {
        let mut master = all_move();
        master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
        let packets = sent(&mut master, ms(100));
        master.handle_pushed_out(&packets[0]);
        assert_eq!(reply(&mut master, 1, Stop.encode(), ms(101)), confirmed(1));
        // It goes once more, before or beside the request.
        if is_sent_before {
            assert_eq!(channels(&sent(&mut master, ms(101))), [TO_ALL]);
        }
        let ticket = master.request(id(1), Shutdown).unwrap();
        sent(&mut master, ms(102));
        assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(103)), None, "{is_sent_before}");
        assert_eq!(channels(&sent(&mut master, ms(300))), [to(1)]);
        let event = reply(&mut master, 1, Shutdown.encode(), ms(301)).unwrap();
        assert_eq!(ticket.outcome(&event), Some(Ok(Shutdown)));
    }
}

#[test]
fn who_was_switched_off_with_all_is_switched_on_by_no_hold_of_all() {
    // Nobody has a place, so that nobody is known to be off.
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    for (kind, now) in [(StopKind::Off, 0), (StopKind::Hold, 100)] {
        master.stop_all(kind, MotorSet::EMPTY).unwrap();
        let packets = sent(&mut master, ms(now));
        assert!(packets.iter().all(|packet| packet.data == Shutdown.encode()), "{packets:?}");
    }
}

#[test]
fn what_waits_for_a_lost_answer_to_it_goes_when_that_can_come_no_more() {
    let mut master = all_move();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(100));
    master.handle_pushed_out(&packets[0]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(101)), confirmed(1));
    master.handle_timeout(ms(101));
    assert_eq!(channels(&sent(&mut master, ms(200))), [TO_ALL]);
    // The time-out and the late window later, 61.2 ms.
    let _ = master.request(id(1), Shutdown).unwrap();
    assert_eq!(sent(&mut master, ms(261)), []);
    assert_eq!(channels(&sent(&mut master, ms(262))), [to(1)]);
}

#[test]
fn who_stops_all_in_every_cycle_hears_of_a_motor_that_hears_no_command_to_all() {
    let mut master = all_move();
    let (mut to_all, mut confirmed) = (0, 0);
    for now in 100..300 {
        master.stop_all(StopKind::Hold, id(2).into()).unwrap();
        let channels = channels(&sent(&mut master, ms(now)));
        to_all += channels.iter().filter(|&&channel| channel == TO_ALL).count();
        // Its id filter is on (function 2).
        for _ in channels.iter().filter(|&&channel| channel == to(2)) {
            let event = reply(&mut master, 2, Stop.encode(), ms(now) + Duration::from_micros(700));
            confirmed += usize::from(event == Some(Event::StopConfirmed { motor: id(2) }));
        }
        let told = events(&mut master, ms(now));
        assert!(!told.contains(&Event::StopUnconfirmed { motor: id(2) }), "{now}");
    }
    assert_eq!(to_all, 1, "the same stop goes to all once");
    assert!(confirmed > 50, "{confirmed}");
}

#[test]
fn one_that_waits_goes_no_more_once_it_was_lifted_and_another_stop_is_in_force() {
    let mut master = all_move();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    master.lift_stop();
    master.stop(id(1), StopKind::Off).unwrap();
    master.stop_all(StopKind::Hold, id(2).into()).unwrap();
    assert!(!channels(&sent(&mut master, ms(100))).contains(&TO_ALL));
}
