//! What was asked for by a future that is dropped, or before a suspension.

use core::pin::pin;

use super::world::{TestCan, TestClock, block_on, on_can, polls};
use super::{id, step, torque};
use crate::command::{AbsolutePosition, ReadMultiTurnAngle, Shutdown};
use crate::error::RequestError;
use crate::io::{AsyncCanMaster, AsyncRunner, CallError, Clock};
use crate::master::{Event, Failure, Patience};
use crate::packet::{Channel, Packet};
use crate::time::Duration;
use crate::units::{Angle, MaxSpeed};

type Arm = AsyncCanMaster<TestCan, TestClock, 4>;

/// A controller that takes nothing for 5 ms.
fn on_busy_can() -> (TestCan, TestClock, Arm) {
    let (bus, clock, arm) = on_can(Arm::new);
    bus.state().full_until = 5_000;
    (bus, clock, arm)
}

/// Runs the bus an hour later, and gives what happens then.
fn an_hour_later(clock: &TestClock, arm: &mut Arm) -> std::vec::Vec<Event> {
    clock.advance(3_600_000_000);
    let mut events = std::vec::Vec::new();
    let until = clock.now() + Duration::from_millis(100);
    block_on(arm.run_until(until, |event| events.push(event))).unwrap();
    events
}

#[test]
fn move_of_a_dropped_future_is_not_sent_later() {
    let (bus, clock, mut arm) = on_busy_can();
    assert!(polls(arm.ask(id(1), step()), 10).is_none());
    let events = an_hour_later(&clock, &mut arm);
    assert!(matches!(events[..], [Event::Failed { failure: Failure::Dropped, .. }]), "{events:?}");
    assert!(bus.sent().is_empty(), "{:?}", bus.sent());
    assert!(block_on(arm.ask(id(1), step())).is_ok());
}

/// Runs the bus for 200 ms without a pause, and gives what happens then.
fn at_once(clock: &TestClock, arm: &mut Arm) -> std::vec::Vec<Event> {
    let mut events = std::vec::Vec::new();
    let until = clock.now() + Duration::from_millis(200);
    block_on(arm.run_until(until, |event| events.push(event))).unwrap();
    events
}

/// The loop goes on at once: no suspension makes the move too old.
#[test]
fn move_of_a_dropped_future_is_not_sent_when_the_bus_has_room() {
    let (bus, clock, mut arm) = on_busy_can();
    assert!(polls(arm.ask(id(1), step()), 10).is_none());
    let events = at_once(&clock, &mut arm);
    assert!(matches!(events[..], [Event::Failed { failure: Failure::Dropped, .. }]), "{events:?}");
    assert!(bus.sent().is_empty(), "{:?}", bus.sent());
}

/// The same if it was sent once, and nobody answers.
#[test]
fn move_of_a_dropped_future_is_not_retried_when_its_answer_is_due() {
    let (bus, clock, mut arm) = on_can(Arm::new);
    let there = AbsolutePosition { max_speed: MaxSpeed::from_raw(90), angle: Angle::from_raw(1) };
    let patience = Patience { reply_timeout: Duration::from_millis(20), attempts: 3 };
    assert!(polls(arm.ask_with(id(9), there, Some(patience), |_| {}), 10).is_none());
    assert_eq!(bus.sent(), [there.encode()]);
    let events = at_once(&clock, &mut arm);
    assert!(matches!(events[..], [Event::Failed { failure: Failure::NoReply, .. }]), "{events:?}");
    assert_eq!(bus.sent().len(), 1);
}

/// The computer is suspended while the command waits.
#[test]
fn move_that_waits_through_a_suspension_is_not_sent() {
    let (bus, clock, mut arm) = on_busy_can();
    let mut moving = pin!(arm.ask(id(1), step()));
    assert!(polls(moving.as_mut(), 10).is_none());
    clock.advance(3_600_000_000);
    let failed = CallError::Failed { motor: id(1), failure: Failure::Dropped };
    assert_eq!(block_on(moving), Err(failed));
    assert!(bus.sent().is_empty(), "{:?}", bus.sent());
}

/// The same while it waits for its motor's turn.
#[test]
fn move_whose_turn_comes_after_a_suspension_is_not_put() {
    let (bus, clock, mut arm) = on_busy_can();
    assert!(polls(arm.ask(id(1), ReadMultiTurnAngle), 1).is_none());
    // The event is that answer.
    let moved = block_on(arm.ask_with(id(1), step(), None, |_| clock.advance(3_600_000_000)));
    let refusal = RequestError::Busy;
    assert_eq!(moved, Err(CallError::Refused { motor: id(1), refusal }));
    assert!(bus.sent().iter().all(|data| data[0] == 0x92), "{:?}", bus.sent());
}

#[test]
fn what_ends_motion_is_put_however_late() {
    let (bus, clock, mut arm) = on_busy_can();
    assert!(polls(arm.ask(id(1), ReadMultiTurnAngle), 1).is_none());
    let off = block_on(arm.ask_with(id(1), Shutdown, None, |_| clock.advance(3_600_000_000)));
    assert!(off.is_ok());
    assert!(bus.sent().contains(&Shutdown.encode()));
}

#[test]
fn moves_of_a_dropped_future_are_not_sent_later() {
    let (bus, clock, mut arm) = on_busy_can();
    assert!(polls(arm.ask_together([(id(1), step()), (id(2), step())]), 10).is_none());
    assert_eq!(an_hour_later(&clock, &mut arm).len(), 2);
    assert!(bus.sent().is_empty(), "{:?}", bus.sent());
}

/// Not even at once, while the set-point is not too old.
#[test]
fn set_point_of_a_dropped_future_is_not_sent() {
    let (bus, clock, mut arm) = on_busy_can();
    assert!(polls(arm.set_point_and_wait(id(1), torque()), 1).is_none());
    let mut events = std::vec::Vec::new();
    let until = clock.now() + Duration::from_millis(20);
    block_on(arm.run_until(until, |event| events.push(event))).unwrap();
    assert_eq!(events, [Event::SetPointDropped { motor: id(1) }]);
    assert!(bus.sent().is_empty(), "{:?}", bus.sent());
    assert!(block_on(arm.set_point_and_wait(id(1), torque())).is_ok());
}

#[test]
fn move_of_a_dropped_future_is_not_retried() {
    let (bus, clock, mut arm) = on_can(Arm::new);
    let there = AbsolutePosition { max_speed: MaxSpeed::from_raw(90), angle: Angle::from_raw(1) };
    let patience = Patience { reply_timeout: Duration::from_millis(20), attempts: 3 };
    let asked = arm.ask_with(id(9), there, Some(patience), |_| {});
    assert!(polls(asked, 10).is_none());
    assert_eq!(bus.sent(), [there.encode()]);
    let events = an_hour_later(&clock, &mut arm);
    assert!(matches!(events[..], [Event::Failed { failure: Failure::NoReply, .. }]), "{events:?}");
    assert_eq!(bus.sent().len(), 1);
}

/// A read of motor 1 is more urgent, and the controller hands the step back for it.
#[test]
fn move_of_a_dropped_future_is_not_sent_again_when_handed_back() {
    let (bus, clock, mut arm) = on_can(Arm::new);
    assert!(polls(arm.ask(id(9), step()), 10).is_none());
    assert_eq!(bus.sent(), [step().encode()]);
    let handed_back = Packet { channel: Channel::Command(id(9).into()), data: step().encode() };
    arm.master().handle_pushed_out(&handed_back);
    let events = an_hour_later(&clock, &mut arm);
    assert!(matches!(events[..], [Event::Failed { failure: Failure::Dropped, .. }]), "{events:?}");
    assert_eq!(bus.sent().len(), 1);
}

#[test]
fn shutdown_and_read_of_a_dropped_future_are_still_sent() {
    let (bus, clock, mut arm) = on_busy_can();
    assert!(polls(arm.ask(id(1), Shutdown), 10).is_none());
    assert!(polls(arm.ask(id(2), ReadMultiTurnAngle), 10).is_none());
    assert_eq!(an_hour_later(&clock, &mut arm).len(), 2);
    assert_eq!(bus.sent(), [Shutdown.encode(), ReadMultiTurnAngle.encode()]);
}
