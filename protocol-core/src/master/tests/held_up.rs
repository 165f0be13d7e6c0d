//! A master at which nobody has looked for a while: its computer was suspended, for example.

use super::*;
use crate::command::ReadStatus2;

const AN_HOUR: Instant = Instant::from_millis(3_600_000);

/// On a line, where one waits for the other's answer.
fn two_moves() -> (Master<2>, [Ticket<IncrementalPosition>; 2]) {
    let mut master = Master::new(Config::rs485(115_200, false));
    let moves = [1, 2].map(|motor| master.request(id(motor), step()).unwrap());
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    (master, moves)
}

#[test]
fn move_that_has_waited_through_a_suspension_is_not_sent() {
    let (mut master, [first, second]) = two_moves();
    let (reported, moved) = (events(&mut master, AN_HOUR), sent(&mut master, AN_HOUR));
    assert_eq!(moved, []);
    let failed = |ticket: Ticket<_>| reported.iter().find_map(|event| ticket.outcome(event));
    assert_eq!(failed(first), Some(Err(Failure::NoReply)));
    assert_eq!(failed(second), Some(Err(Failure::Dropped)));
}

/// The loop sleeps for as long as a motor takes to restart, 2 s, and may be a second late.
/// The other motor goes first then. The first may have moved.
#[test]
fn move_that_was_sent_and_waits_to_be_sent_again_is_not_reported_as_never_sent() {
    let mut master = Master::<2>::new(Config::rs485(115_200, false));
    let twice = Patience { attempts: 2, ..once(20) };
    let [first, _] = [1, 2].map(|motor| master.request_with(id(motor), step(), twice).unwrap());
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    assert_eq!(sent(&mut master, ms(20)), [packet_to(2, step().encode())]);
    let reported = events(&mut master, AN_HOUR);
    let failed = reported.iter().find_map(|event| first.outcome(event));
    assert_eq!(failed, Some(Err(Failure::NoReply)));
    assert_eq!(sent(&mut master, AN_HOUR), []);
}

#[test]
fn move_that_has_waited_for_three_seconds_is_sent() {
    let (mut master, _) = two_moves();
    assert_eq!(sent(&mut master, ms(3_000)).len(), 1);
    let (mut master, _) = two_moves();
    assert_eq!(sent(&mut master, ms(3_001)), []);
}

#[test]
fn move_of_all_that_has_waited_through_a_suspension_is_not_sent() {
    let mut master = Master::<2>::new(Config::rs485(115_200, false));
    let _ = ask(&mut master, 1, ReadStatus2, ms(0));
    master.broadcast(step(), MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(1)), []);
    assert_eq!(sent(&mut master, AN_HOUR).len(), 1, "the read, once more");
    reply(&mut master, 1, [0x9C, 50, 0, 0, 0, 0, 0, 0], AN_HOUR);
    let done = Event::BroadcastDone { silent: MotorSet::EMPTY, was_sent: false };
    assert!(events(&mut master, AN_HOUR).contains(&done));
    assert_eq!(sent(&mut master, AN_HOUR + Duration::from_millis(100)), []);
}

#[test]
fn move_in_flight_during_a_suspension_is_not_sent_again() {
    let mut master = Master::<2>::new(Config::CAN);
    let patience = Patience { reply_timeout: Duration::from_millis(20), attempts: 3 };
    let _ = master.request_with(id(1), torque(1.0), patience).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    assert_eq!(sent(&mut master, AN_HOUR), []);
}

/// After a rest, what is asked next is not older than the rest.
#[test]
fn what_is_asked_after_a_rest_is_sent() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadStatus2, ms(0));
    reply(&mut master, 1, [0x9C, 0, 0, 0, 0, 0, 0, 0], ms(1));
    sent(&mut master, ms(1));
    master.broadcast(step(), MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, AN_HOUR).len(), 1);
    let mut master = Master::<2>::new(Config::CAN);
    let _ = master.request(id(2), step()).unwrap();
    assert_eq!(sent(&mut master, AN_HOUR).len(), 1);
}

#[test]
fn reads_and_stops_wait_through_a_suspension() {
    let mut master = Master::<2>::new(Config::rs485(115_200, false));
    let _ = ask(&mut master, 1, ReadStatus2, ms(0));
    let _ = master.request(id(2), Stop).unwrap();
    assert_eq!(sent(&mut master, ms(1)), []);
    reply(&mut master, 1, [0x9C, 0, 0, 0, 0, 0, 0, 0], AN_HOUR);
    assert_eq!(sent(&mut master, AN_HOUR + Duration::from_millis(1)).len(), 1);
}

/// Its caller wants that: a move has one attempt unless a caller gives it more.
#[test]
fn move_of_several_attempts_in_flight_goes_again_though_receiving_has_failed_for_a_moment() {
    let mut master = Master::<2>::new(Config::CAN);
    let twice = Patience { attempts: 2, ..once(20) };
    let _move = master.request_with(id(1), step(), twice).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    master.bus_may_be_down(ms(1), ms(1));
    assert_eq!(sent(&mut master, ms(20)), [packet_to(1, step().encode())]);
}
