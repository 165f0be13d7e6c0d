//! On CAN a command to all may move motors that were not named: a stop of all then also goes to all at once.

use super::*;

pub(super) const TO_ALL: Channel = Channel::Command(Target::All);

/// All were commanded to move. Motor 1 has a place; any others that have heard it have none.
pub(super) fn all_move() -> Master<2> {
    let mut master = Master::new(Config::CAN);
    obeys(&mut master, 1);
    master.broadcast(torque(1.0), id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    reply(&mut master, 1, TORQUE_REPLY, ms(1));
    events(&mut master, ms(1));
    master
}

/// The same a while later: the command to all has arrived, since the bus carries other answers.
pub(super) fn all_have_moved() -> Master<2> {
    let mut master = all_move();
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(49));
    reply(&mut master, 1, ANGLE_REPLY, ms(50)).unwrap();
    master.handle_timeout(ms(50));
    events(&mut master, ms(95));
    master
}

pub(super) fn channels(packets: &[Packet]) -> Vec<Channel> {
    packets.iter().map(|packet| packet.channel).collect()
}

pub(super) fn to(motor: u8) -> Channel {
    Channel::Command(Target::Motor(id(motor)))
}

#[test]
fn stop_of_all_goes_to_all_after_a_broadcast_that_moved() {
    let mut master = all_move();
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(100));
    assert_eq!(channels(&packets), [TO_ALL, to(1)], "before each motor's own");
    assert!(packets.iter().all(|packet| packet.data == Stop.encode()));
    // A command to all that cannot move them does not call for that.
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(ReadMultiTurnAngle, id(1).into()).unwrap();
    sent(&mut master, ms(0));
    master.stop_all(StopKind::Hold, id(1).into()).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(100))), [to(1)]);
}

#[test]
fn answer_to_a_stop_to_all_confirms_the_motors_own_stop() {
    let mut master = all_move();
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(100)).len(), 2);
    // Whichever of the two it answers, and whether or not the other is lost.
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(101)), confirmed(1));
    assert_eq!(sent(&mut master, ms(101)), []);
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(102)), None, "the other's");
    assert!(master.motors() == id(1).into() && events(&mut master, ms(102)).is_empty());
    assert_eq!(master.health(id(1)).stray, 0);
}

#[test]
fn answer_to_a_stop_to_all_confirms_the_own_stop_before_it_was_sent() {
    let mut master = all_move();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    let packet = master.poll_transmit(ms(100)).unwrap();
    master.handle_transmitted(ms(100));
    assert_eq!(packet.channel, TO_ALL);
    let before = master.health(id(1));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(101)), confirmed(1));
    assert_eq!(sent(&mut master, ms(101)), []);
    // It answers no command of its own.
    let Health { answered, round_trip, .. } = master.health(id(1));
    assert_eq!((answered, round_trip), (before.answered, before.round_trip));
}

#[test]
fn late_answer_to_a_stop_to_all_confirms_no_later_stop() {
    let mut master = all_move();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(100)).len(), 2);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(101)), confirmed(1));
    master.lift_stop();
    master.set_point(id(1), torque(1.0), ms(101)).unwrap();
    assert_eq!(sent(&mut master, ms(101)).len(), 1);
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(102))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(103)), None, "which one's?");
}

#[test]
fn handed_back_stop_to_all_is_sent_again_and_awaited_once() {
    let mut master = all_move();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(100));
    master.handle_pushed_out(&packets[0]);
    // Only the motor's own was on the bus.
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(101)), confirmed(1));
    assert_eq!(channels(&sent(&mut master, ms(101))), [TO_ALL]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(102)), None);
    assert_eq!(master.health(id(1)).stray, 0);
    // Not after the stop was lifted, and not if it would switch on a motor that is to be off.
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
fn stop_to_all_handed_back_before_the_own_stop_owes_no_answer() {
    let mut master = all_move();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    master.handle_timeout(ms(100));
    let to_all = master.poll_transmit(ms(100)).unwrap();
    master.handle_transmitted(ms(100));
    master.handle_pushed_out(&to_all);
    assert_eq!(channels(&sent(&mut master, ms(100))), [TO_ALL, to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(101)), confirmed(1));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(102)), None);
    master.lift_stop();
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(103))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(104)), confirmed(1));
}

#[test]
fn older_stop_to_all_handed_back_does_not_follow_a_newer_one() {
    let mut master = all_move();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    let older = sent(&mut master, ms(100));
    master.lift_stop();
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(101))), [TO_ALL, to(1)]);
    // It would let go a motor that the newer one holds.
    master.handle_pushed_out(&older[0]);
    assert_eq!(sent(&mut master, ms(102)), []);
}

#[test]
fn waiting_shutdown_to_all_is_not_dropped_for_a_later_hold_of_all() {
    let mut master = all_move();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    // Motors that were not named have heard nothing yet.
    master.stop_all(StopKind::Hold, id(2).into()).unwrap();
    let packets = sent(&mut master, ms(100));
    assert_eq!(channels(&packets), [TO_ALL, to(1), to(2)]);
    assert_eq!(packets[0].data, Shutdown.encode());
}

#[test]
fn handed_back_stop_to_all_is_not_taken_for_an_old_equal_broadcast() {
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
fn shutdown_is_in_doubt_while_an_earlier_hold_to_all_may_arrive() {
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
fn requested_shutdown_is_answered_once_no_hold_to_all_can_arrive() {
    for is_sent_before in [false, true] {
        let mut master = all_move();
        master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
        let packets = sent(&mut master, ms(100));
        master.handle_pushed_out(&packets[0]);
        assert_eq!(reply(&mut master, 1, Stop.encode(), ms(101)), confirmed(1));
        // It goes once more, before the request or besides it.
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
fn hold_of_all_does_not_switch_unknown_motors_on_after_a_shutdown_of_all() {
    // No motor has a place, so none is known to be off.
    let mut master = Master::<2>::new(Config::rs485(1_000_000, false));
    for (kind, now) in [(StopKind::Off, 0), (StopKind::Hold, 100)] {
        master.stop_all(kind, MotorSet::EMPTY).unwrap();
        let packets = sent(&mut master, ms(now));
        assert!(packets.iter().all(|packet| packet.data == Shutdown.encode()), "{packets:?}");
    }
}

#[test]
fn shutdown_waits_until_a_stop_to_all_can_no_longer_be_answered() {
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
fn cyclic_stop_of_all_is_confirmed_by_a_motor_deaf_to_broadcasts() {
    let mut master = all_have_moved();
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
        let reported = events(&mut master, ms(now));
        assert!(!reported.contains(&Event::StopUnconfirmed { motor: id(2) }), "{now}");
    }
    assert_eq!(to_all, 1, "the same stop goes to all once");
    // The answer that it owes to the one to all may be taken for its own to the next: that goes twice.
    assert!(confirmed >= 100, "{confirmed}");
}

#[test]
fn motor_deaf_to_broadcasts_confirms_once_no_move_can_arrive() {
    let mut master = all_have_moved();
    obeys(&mut master, 2);
    master.stop_all(StopKind::Hold, id(2).into()).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(100))), [TO_ALL, to(2), to(1)]);
    // As far as is known, the move of all may still be in a mailbox.
    assert_eq!(reply(&mut master, 2, Stop.encode(), ms(101)), None);
    assert!(channels(&sent(&mut master, ms(170))).contains(&to(2)));
    assert_eq!(reply(&mut master, 2, Stop.encode(), ms(171)), confirmed(2));
}

#[test]
fn quick_answer_to_a_stop_to_all_is_no_stray() {
    let mut master = all_move();
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    master.poll_transmit(ms(100)).unwrap();
    master.handle_transmitted(ms(100));
    let soon = |us| ms(100) + Duration::from_micros(us);
    assert_eq!(channels(&sent(&mut master, soon(400))), [to(1)]);
    // Too soon after its own, but not after the one to all.
    let reported = [500, 1_100].map(|us| reply(&mut master, 1, Stop.encode(), soon(us)));
    assert_eq!(reported, [None, confirmed(1)]);
    assert_eq!(master.health(id(1)).stray, 0);
}

#[test]
fn motor_shut_down_by_a_stop_to_all_is_not_switched_on_by_a_named_hold() {
    let mut master = all_move();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(100));
    // It has had no place, and has heard the one to all.
    master.stop_all(StopKind::Hold, id(2).into()).unwrap();
    let packets = sent(&mut master, ms(110));
    assert!(channels(&packets).contains(&to(2)));
    assert!(packets.iter().all(|packet| packet.data == Shutdown.encode()), "{packets:?}");
    master.lift_stop();
    master.stop(id(2), StopKind::Hold).unwrap();
    assert_eq!(sent(&mut master, ms(120))[0].data, Stop.encode());
}

#[test]
fn shutdown_is_confirmed_once_no_broadcast_hold_can_arrive() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(Stop, MotorSet::EMPTY).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(0))), [TO_ALL]);
    events(&mut master, ms(0));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(0))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(1)), None);
    assert_eq!(channels(&sent(&mut master, ms(300))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(301)), confirmed(1));
}

#[test]
fn duplicate_answer_to_an_earlier_stop_confirms_no_waiting_one() {
    let mut master = all_have_moved();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(100)).len(), 2);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(101)), confirmed(1));
    master.lift_stop();
    let _release = ask(&mut master, 1, ReleaseBrake, ms(101));
    reply(&mut master, 1, ReleaseBrake.encode(), ms(102)).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(102))), [to(1)]);
    // The answer to the other of the first two, twice, before this one goes once more.
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(103)), None);
    let soon = ms(103) + Duration::from_micros(300);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), soon), None);
    assert_eq!(channels(&sent(&mut master, ms(104))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(105)), confirmed(1));
}

#[test]
fn hold_is_confirmed_once_no_earlier_shutdown_can_arrive() {
    // It was sent twice and answered once: the other may be in a mailbox.
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    assert_eq!(sent(&mut master, ms(50)).len(), 1);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(51)), confirmed(1));
    master.lift_stop();
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(52))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(53)), None);
    assert_eq!(channels(&sent(&mut master, ms(180))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(181)), confirmed(1));
}

#[test]
fn shutdown_is_confirmed_once_no_earlier_hold_can_arrive() {
    // A controller that keeps no order among frames of one motor sends the Off first, and the Hold switches it on.
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(1))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(2)), None);
    assert_eq!(sent(&mut master, ms(3)), []);
    assert_eq!(channels(&sent(&mut master, ms(300))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(301)), confirmed(1));
}

#[test]
fn shutdown_after_a_confirmed_hold_is_confirmed_at_once() {
    let mut master = Master::<2>::new(Config::CAN);
    obeys(&mut master, 1);
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(1)), confirmed(1));
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(2))), [to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(3)), confirmed(1));
}

#[test]
fn waiting_stop_to_all_is_dropped_once_lifted_and_replaced() {
    let mut master = all_move();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    master.lift_stop();
    master.stop(id(1), StopKind::Off).unwrap();
    master.stop_all(StopKind::Hold, id(2).into()).unwrap();
    assert!(!channels(&sent(&mut master, ms(100))).contains(&TO_ALL));
}

#[test]
fn answer_to_a_resent_stop_to_all_does_not_answer_a_shutdown_request() {
    let mut master = all_have_moved();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(100));
    assert_eq!(channels(&packets), [TO_ALL, to(1)]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(101)), confirmed(1));
    events(&mut master, ms(101));
    master.handle_pushed_out(&packets[0]);
    let ticket = master.request(id(1), Shutdown).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(102))), [TO_ALL]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(103)), None, "that to the one to all");
    assert_eq!(channels(&sent(&mut master, ms(104))), [to(1)]);
    let event = reply(&mut master, 1, Shutdown.encode(), ms(105)).unwrap();
    assert_eq!(ticket.outcome(&event), Some(Ok(Shutdown)));
}

#[test]
fn handed_back_stop_to_all_does_not_delay_a_shutdown_requests_answer() {
    let mut master = all_have_moved();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(100));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(101)), confirmed(1));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(102)), None);
    events(&mut master, ms(102));
    let ticket = ask(&mut master, 1, Shutdown, ms(103));
    master.handle_pushed_out(&packets[0]);
    // The one to all goes before its second, and is answered, too.
    assert_eq!(channels(&sent(&mut master, ms(104))), [TO_ALL]);
    let event = reply(&mut master, 1, Shutdown.encode(), ms(105)).unwrap();
    assert_eq!(ticket.outcome(&event), Some(Ok(Shutdown)));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(106)), None, "expected, and no stray");
}

#[test]
fn handed_back_stop_to_all_is_not_taken_for_an_unsent_broadcast() {
    let mut master = Master::<2>::new(Config::CAN);
    // In a mailbox.
    master.broadcast(torque(1.0), id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.stop_all(StopKind::Off, id(1).into()).unwrap();
    let packets = sent(&mut master, ms(1));
    assert_eq!(packets[0], packet_to_all(Shutdown.encode()));
    events(&mut master, ms(1));
    // One that waits after that, and is cancelled.
    master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    master.handle_pushed_out(&packets[0]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(3)), None, "the torque may come yet");
    assert!(sent(&mut master, ms(3)).contains(&packets[0]), "whom nobody knows is to hear it");
}

#[test]
fn handed_back_hold_to_all_leaves_a_later_shutdown_to_all_pending() {
    for is_reported in [false, true] {
        let mut master = Master::<2>::new(Config::CAN);
        master.broadcast(Stop, MotorSet::EMPTY).unwrap();
        let hold_in_mailbox = sent(&mut master, ms(0))[0];
        events(&mut master, ms(0));
        // Also in a mailbox, and goes last.
        master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
        assert_eq!(sent(&mut master, ms(1)).len(), 1);
        events(&mut master, ms(1));
        // Looks like the first, and was not sent.
        master.broadcast(Stop, MotorSet::EMPTY).unwrap();
        if is_reported {
            master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
            assert_eq!(events(&mut master, ms(1)).len(), 1, "it never is");
            master.lift_stop();
        }
        master.handle_pushed_out(&hold_in_mailbox);
        master.stop(id(1), StopKind::Hold).unwrap();
        assert!(!sent(&mut master, ms(2)).is_empty());
        assert_eq!(reply(&mut master, 1, Stop.encode(), ms(3)), None, "its load may fall yet");
    }
}

#[test]
fn handed_back_shutdown_to_all_is_resent_after_a_hold_without_effect() {
    let mut master = all_move();
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(100));
    assert_eq!(channels(&packets), [TO_ALL, to(1)]);
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    master.handle_pushed_out(&packets[0]);
    assert!(sent(&mut master, ms(101)).contains(&packets[0]));
}

#[test]
fn stop_of_all_after_that_of_one_motor_still_goes_to_all() {
    let to_all = |packets: &[Packet]| packets.contains(&packet_to_all(Shutdown.encode()));
    let mut line = Master::<2>::new(Config::rs485(1_000_000, false));
    line.stop(id(1), StopKind::Off).unwrap();
    line.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    assert!(to_all(&sent(&mut line, ms(0))));
    line.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    assert!(!to_all(&sent(&mut line, ms(1))), "it goes on");

    let mut can = Master::<2>::new(Config::CAN);
    can.broadcast(torque(1.0), MotorSet::EMPTY).unwrap();
    sent(&mut can, ms(0));
    events(&mut can, ms(100));
    can.stop(id(1), StopKind::Off).unwrap();
    can.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    assert!(to_all(&sent(&mut can, ms(100))));
}

#[test]
fn handed_back_hold_to_all_is_resent_if_the_shutdown_came_before_it() {
    let mut master = all_have_moved();
    let _off = master.request(id(1), Shutdown).unwrap();
    assert_eq!(sent(&mut master, ms(100)).len(), 1);
    assert!(reply(&mut master, 1, Shutdown.encode(), ms(101)).is_some());
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    let packets = sent(&mut master, ms(102));
    assert_eq!(channels(&packets), [TO_ALL, to(1)]);
    master.handle_pushed_out(&packets[0]);
    assert_eq!(sent(&mut master, ms(103)), [packets[0]]);
}

#[test]
fn answer_to_a_hold_to_all_is_no_stray_during_the_own_shutdown() {
    let mut master = all_have_moved();
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(100))), [TO_ALL, to(1)]);
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(101)), None, "it is no stray");
}

/// A stop of all is in force already when another motor is named.
#[test]
fn stop_of_more_motors_than_places_goes_to_all_though_one_is_in_force() {
    let mut master = Master::<1>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(0));
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(1)), [packet_to(1, Shutdown.encode())]);
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(2)), confirmed(1));
    let mut at = Vec::new();
    // In every cycle.
    for now in 3..300 {
        assert!(master.stop_all(StopKind::Off, id(2).into()).is_err());
        for packet in sent(&mut master, ms(now)) {
            if packet == packet_to_all(Shutdown.encode()) {
                at.push(now);
            } else {
                reply(&mut master, 1, packet.data, ms(now));
            }
        }
    }
    assert_eq!(at.first(), Some(&3));
    assert!(at.len() > 1 && at.windows(2).all(|at| at[1] - at[0] >= 100), "{at:?}");
}

/// The motor has no place, and has got no stop, although all were stopped.
#[test]
fn motor_found_during_a_stop_of_all_is_stopped_when_it_is_called_again() {
    let mut master = Master::<1>::new(Config::CAN);
    obeys(&mut master, 1);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(0));
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(1)), [packet_to(1, Stop.encode())]);
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(2)), confirmed(1));
    master.note_found([id(1), id(2)].into());
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(3))[0], packet_to_all(Stop.encode()));
    // Once.
    master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert!(!sent(&mut master, ms(4)).contains(&packet_to_all(Stop.encode())));
}

/// The motor has no place, and was not there when the last stop went to all.
#[test]
fn motor_found_after_a_stop_to_all_gets_the_next_one() {
    let mut master = Master::<1>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(0));
    for (found, at) in [(2, 1), (3, 300)] {
        master.note_found([id(1), id(found)].into());
        master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
        assert_eq!(sent(&mut master, ms(at))[0], packet_to_all(Stop.encode()));
        reply(&mut master, 1, Stop.encode(), ms(at + 1));
    }
}

#[test]
fn stop_of_all_goes_to_all_while_no_motor_is_known() {
    for config in [Config::CAN, Config::rs485(1_000_000, false)] {
        let mut master = Master::<2>::new(config);
        master.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
        assert_eq!(sent(&mut master, ms(0)), [packet_to_all(Stop.encode())]);
    }
}

/// All were commanded to move, stopped like this, which motor 1 has confirmed, and the stop was lifted.
fn stopped_and_lifted(kind: StopKind) -> (Master<2>, u64) {
    let mut master = all_move();
    master.stop_all(kind, MotorSet::EMPTY).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(2)))[0], TO_ALL);
    let (_, data) = kind.command();
    let confirms = |now: &u64| {
        let is_confirmed = reply(&mut master, 1, data, ms(*now)) == confirmed(1);
        sent(&mut master, ms(*now));
        is_confirmed
    };
    let now = (3..200).find(confirms).expect("an answer that confirms it") + 200;
    events(&mut master, ms(now));
    assert_eq!(sent(&mut master, ms(now)), []);
    master.lift_stop();
    (master, now)
}

fn command_all<C: Command>(master: &mut Master<2>, command: C, answer: Data, now: u64) {
    master.broadcast(command, id(1).into()).unwrap();
    assert_eq!(channels(&sent(master, ms(now))), [TO_ALL]);
    reply(master, 1, answer, ms(now + 1)).unwrap();
    events(master, ms(now + 1));
}

/// Whether a stop of all like this goes to all, too.
fn reaches_all(master: &mut Master<2>, kind: StopKind, now: u64) -> bool {
    master.stop_all(kind, MotorSet::EMPTY).unwrap();
    channels(&sent(master, ms(now))).contains(&TO_ALL)
}

#[test]
fn stop_of_all_goes_to_all_again_once_all_were_moved_or_shut_down() {
    let (mut master, now) = stopped_and_lifted(StopKind::Off);
    assert!(!reaches_all(&mut master, StopKind::Off, now), "nothing has moved anybody");
    // Nor does a question.
    let (mut master, now) = stopped_and_lifted(StopKind::Off);
    command_all(&mut master, ReadMultiTurnAngle, ANGLE_REPLY, now);
    assert!(!reaches_all(&mut master, StopKind::Off, now + 2));
    // Motor 1 was stopped individually since, and the others were not.
    let (mut master, now) = stopped_and_lifted(StopKind::Off);
    command_all(&mut master, torque(1.0), TORQUE_REPLY, now);
    master.stop(id(1), StopKind::Off).unwrap();
    assert_eq!(channels(&sent(&mut master, ms(now + 2))), [to(1)]);
    assert!(reaches_all(&mut master, StopKind::Off, now + 3));
    // It was called twice before it could go.
    let (mut master, now) = stopped_and_lifted(StopKind::Off);
    command_all(&mut master, torque(1.0), TORQUE_REPLY, now);
    master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
    master.lift_stop();
    assert!(reaches_all(&mut master, StopKind::Off, now + 2));
    // They were held, and are off now.
    let (mut master, now) = stopped_and_lifted(StopKind::Hold);
    command_all(&mut master, Shutdown, Shutdown.encode(), now);
    assert!(reaches_all(&mut master, StopKind::Hold, now + 2));
}

/// One motor is off since, or all, whatever others were sent after that.
#[test]
fn handed_back_hold_to_all_is_not_resent_once_a_motor_is_off() {
    fn goes_again(command: impl FnOnce(&mut Master<2>)) -> bool {
        let mut master = Master::<2>::new(Config::CAN);
        obeys(&mut master, 1);
        obeys(&mut master, 2);
        let more: MotorSet = [id(1), id(2), id(3)].into();
        assert!(master.stop_all(StopKind::Hold, more).is_err(), "there are two places");
        let hold = packet_to_all(Stop.encode());
        assert_eq!(sent(&mut master, ms(0))[0], hold);
        for motor in [1, 2] {
            assert_eq!(reply(&mut master, motor, Stop.encode(), ms(1)), confirmed(motor));
        }
        command(&mut master);
        master.handle_pushed_out(&hold);
        sent(&mut master, ms(10)).contains(&hold)
    }
    assert!(goes_again(|_| {}));
    assert!(!goes_again(|master| {
        let _off = ask(master, 1, Shutdown, ms(2));
    }));
    assert!(!goes_again(|master| {
        let _off = ask(master, 1, Shutdown, ms(2));
        let _hold = ask(master, 2, Stop, ms(3));
    }));
    assert!(!goes_again(|master| {
        master.broadcast(Shutdown, MotorSet::EMPTY).unwrap();
        assert_eq!(channels(&sent(master, ms(2))), [TO_ALL]);
        for motor in [1, 2] {
            reply(master, motor, Shutdown.encode(), ms(3));
        }
        events(master, ms(3));
        master.broadcast(LockBrake, MotorSet::EMPTY).unwrap();
        assert_eq!(channels(&sent(master, ms(4))), [TO_ALL]);
    }));
}

/// It was lifted before that, and nothing has moved any motor since; but no motor without a place has heard it.
#[test]
fn handed_back_stop_to_all_is_resent_when_called_again_after_a_lift() {
    let (mut master, now) = stopped_and_lifted(StopKind::Off);
    master.handle_pushed_out(&packet_to_all(Shutdown.encode()));
    assert_eq!(sent(&mut master, ms(now)), []);
    assert!(reaches_all(&mut master, StopKind::Off, now + 1));
}
