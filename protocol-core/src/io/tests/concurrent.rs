//! The async loops: they do what the polling ones do, and their futures may be dropped anywhere.

use core::cell::Cell;
use core::future::Future;
use core::pin::pin;
use core::task::{Context, Waker};
use std::format;
use std::rc::Rc;
use std::string::String;
use std::vec::Vec;

use embassy_futures::select::select;
use embassy_futures::yield_now;

use super::world::{Broken, TestCan, TestClock, TestSerial, block_on, on_can, on_rs485, polls};
use super::{id, step, torque};
use crate::command::{PidIndex, ReadMultiTurnAngle, ReadPid, Reset};
use crate::io::{
    AsyncCan, AsyncCanMaster, AsyncRunner, AsyncSerialMaster, CallError, CanMaster, Clock, Runner,
    SerialMaster,
};
use crate::master::{Event, Failure, MotorSet, StopKind};
use crate::time::{Duration, Instant};
use crate::wire::can::SimpleFrame;

fn can() -> (TestCan, TestClock, AsyncCanMaster<TestCan, TestClock, 4>) {
    on_can(AsyncCanMaster::new)
}

fn serial() -> (TestSerial, TestClock, AsyncSerialMaster<TestSerial, TestClock, 4>) {
    on_rs485(AsyncSerialMaster::new)
}

/// One of which is known that it does not echo.
fn used_serial() -> (TestSerial, TestClock, AsyncSerialMaster<TestSerial, TestClock, 4>) {
    let (port, clock, mut arm) = serial();
    block_on(arm.ask(id(1), ReadMultiTurnAngle)).unwrap();
    port.forget();
    (port, clock, arm)
}

/// The same calls on any loop, and what each of them gave.
macro_rules! session {
    ($arm:ident $($wait:tt)*) => {{
        let mut log: Vec<String> = Vec::new();
        let mut on_event = Vec::new();
        log.push(format!("{:?}", $arm.ask(id(1), ReadMultiTurnAngle) $($wait)*));
        log.push(format!("{:?}", $arm.ask(id(2), ReadPid { index: PidIndex::SPEED_KP }) $($wait)*));
        log.push(format!("{:?}", $arm.ask(id(3), Reset) $($wait)*));
        log.push(format!("{:?}", $arm.ask(id(9), ReadMultiTurnAngle) $($wait)*));
        log.push(format!("{:?}", $arm.ask(id(9), step()) $($wait)*));
        // That of motor 1 goes first, and is answered first.
        $arm.set_point(id(1), torque()).unwrap();
        let meanwhile = $arm.ask_with(id(2), step(), None, |event| on_event.push(event)) $($wait)*;
        log.push(format!("{meanwhile:?} {on_event:?}"));
        log.push(format!("{:?}", $arm.stop_all(StopKind::Hold, MotorSet::EMPTY) $($wait)*));
        log.push(format!("{:?}", $arm.ask(id(1), step()) $($wait)*));
        log
    }};
}

fn check(log: &[String]) {
    assert_eq!(log.len(), 8);
    assert_eq!(log[0], "Ok(MultiTurnAngle { angle: Angle(360 deg) })");
    assert!(log[1].contains("speed-kp"), "{}", log[1]);
    assert_eq!(log[2], "Ok(NoReply)");
    assert_eq!(log[3], "Err(Failed { motor: MotorId(9), failure: NoReply })");
    assert_eq!(log[4], "Err(Failed { motor: MotorId(9), failure: NoReply })");
    // What is heard meanwhile, but for the answer.
    let (answer, heard) = log[5].split_once(") [").unwrap();
    assert!(answer.starts_with("Ok(Feedback {"), "{answer}");
    assert!(heard.starts_with("Feedback { motor: MotorId(1),"), "{heard}");
    assert_eq!(heard.matches("MotorId").count(), 1, "{heard}");
    assert_eq!(log[6], "MotorSet(9)", "motor 9 has not confirmed");
    assert_eq!(log[7], "Err(Refused { motor: MotorId(1), refusal: Stopped })");
}

#[test]
fn on_can_the_async_loop_does_what_the_polling_one_does() {
    let (polled_bus, _, mut polled) = on_can(CanMaster::<_, _, 4>::new);
    let expected = session!(polled);
    let (bus, _, mut arm) = can();
    let log = block_on(async { session!(arm.await) });
    check(&log);
    assert_eq!(log, expected);
    assert_eq!(bus.sent(), polled_bus.sent());
}

#[test]
fn on_rs485_the_async_loop_does_what_the_polling_one_does() {
    let (polled_port, _, mut polled) = on_rs485(SerialMaster::<_, _, 4>::new);
    let expected = session!(polled);
    for at_most in [0, 2, 5] {
        let (port, _, mut arm) = serial();
        port.state().at_most = at_most;
        let log = block_on(async { session!(arm.await) });
        check(&log);
        assert_eq!(log, expected, "{at_most}");
        // When the others are asked during the stop depends on when a loop looks at the time.
        assert_eq!(port.commands(), polled_port.commands(), "{at_most}");
    }
}

#[test]
fn the_time_of_a_loop_is_that_of_its_clock() {
    let (_, clock, arm) = can();
    clock.advance(5_000);
    assert_eq!(arm.now(), Instant::from_millis(5));
    let (_, clock, arm) = serial();
    clock.advance(5_000);
    assert_eq!(arm.now(), Instant::from_millis(5));
}

#[test]
fn nothing_is_lost_or_sent_twice_when_futures_are_dropped() {
    for most in 1..40 {
        let (bus, clock, mut arm) = can();
        let read = arm.master().request(id(1), ReadMultiTurnAngle).unwrap();
        let _step = arm.master().request(id(2), step()).unwrap();
        bus.state().full_until = 300;
        let mut events = Vec::new();
        while clock.micros() < 60_000 {
            // Each future is polled a few times and dropped, done or not.
            if let Some(event) = polls(arm.next_event(), most) {
                events.push(event.unwrap());
            }
            clock.advance(10);
        }
        assert_eq!(bus.sent().len(), 2, "{most}");
        assert_eq!(events.len(), 2, "{most}");
        assert!(events.iter().any(|event| read.outcome(event).is_some_and(|read| read.is_ok())));
    }
}

/// A controller that takes something again wakes the task.
#[test]
fn refused_frame_is_offered_again_when_the_task_is_woken() {
    let (bus, clock, mut arm) = can();
    bus.state().full_until = u64::MAX;
    arm.master().stop(id(1), StopKind::Hold).unwrap();
    let mut next = pin!(arm.next_event());
    let mut context = Context::from_waker(Waker::noop());
    for _ in 0..4 {
        assert!(next.as_mut().poll(&mut context).is_pending());
    }
    bus.state().full_until = 0;
    for _ in 0..2 {
        assert!(next.as_mut().poll(&mut context).is_pending());
    }
    assert_eq!(bus.sent().len(), 1, "at {} us", clock.micros());
    assert!(clock.micros() < 1_000);
}

/// A controller that counts how often it is asked for a frame.
struct Counts(TestCan, Rc<Cell<usize>>);

impl AsyncCan for Counts {
    type Frame = SimpleFrame;
    type Error = Broken;

    async fn transmit(&mut self, frame: &SimpleFrame) -> Result<Option<SimpleFrame>, Broken> {
        AsyncCan::transmit(&mut self.0, frame).await
    }

    async fn receive(&mut self) -> Result<SimpleFrame, Broken> {
        self.1.set(self.1.get() + 1);
        AsyncCan::receive(&mut self.0).await
    }
}

/// Whatever else runs in its task wakes it all the time.
#[test]
fn waiting_loop_does_not_run_a_round_for_each_wake_of_its_task() {
    let calls = Rc::new(Cell::new(0));
    let (_, _, mut arm) = on_can(|bus, clock, config| {
        AsyncCanMaster::<_, _, 4>::new(Counts(bus, calls.clone()), clock, config)
    });
    assert!(polls(arm.next_event(), 100).is_none());
    assert_eq!(calls.get(), 2, "in the first round, and for as long as it waits");
}

#[test]
fn a_serial_frame_whose_sending_is_dropped_counts_as_sent() {
    for most in 1..40 {
        let (port, _, mut arm) = used_serial();
        port.state().at_most = 1;
        let ticket = arm.master().request(id(1), step()).unwrap();
        assert!(polls(arm.next_event(), most).is_none_or(|event| event.is_ok()), "{most}");
        let cut_off = port.written().len();
        let event = block_on(arm.run(Some(Instant::from_millis(50)))).unwrap();
        assert!(port.is_flushed(), "{most}: the transceiver has been turned round");
        assert!(port.written().len() <= 13, "{most}: nothing is sent again");
        if (1..13).contains(&cut_off) {
            let outcome = event.and_then(|event| ticket.outcome(&event));
            assert_eq!(outcome, Some(Err(Failure::NoReply)), "{most}");
            assert_eq!(port.written().len(), cut_off, "{most}");
        }
    }
}

#[test]
fn serial_frame_dropped_during_a_stalled_write_counts_as_sent() {
    let (port, _, mut arm) = used_serial();
    port.state().stalls = true;
    let ticket = arm.master().request(id(1), step()).unwrap();
    assert_eq!(polls(arm.next_event(), 10), None);
    port.state().stalls = false;
    let event = block_on(arm.run(Some(Instant::from_millis(50)))).unwrap();
    assert_eq!(event.and_then(|event| ticket.outcome(&event)), Some(Err(Failure::NoReply)));
    assert!(port.written().is_empty(), "it may have left");
}

#[test]
fn port_that_is_not_flushed_within_20_ms_is_still_read() {
    let (port, clock, mut arm) = used_serial();
    let start = clock.micros();
    port.state().flush_stalls = true;
    assert!(block_on(arm.ask(id(1), step())).is_ok(), "the drive has heard it");
    // While it is sent, and once more.
    assert!((40_000..42_000).contains(&(clock.micros() - start)), "{}", clock.micros() - start);
}

#[test]
fn a_serial_port_that_stalls_counts_as_a_bus_that_is_down() {
    let (port, clock, mut arm) = used_serial();
    let start = clock.micros();
    port.state().stalls = true;
    let failed = block_on(arm.ask(id(1), step()));
    assert_eq!(failed, Err(CallError::Failed { motor: id(1), failure: Failure::BusDown }));
    assert!((20_000..21_000).contains(&(clock.micros() - start)), "{}", clock.micros() - start);
    port.state().stalls = false;
    assert!(block_on(arm.ask(id(1), ReadMultiTurnAngle)).is_ok());
    assert_eq!(port.written().len(), 13);
}

#[test]
fn no_echo_confirms_a_stop_after_a_port_has_failed() {
    let (port, clock, mut arm) = serial();
    port.state().echoes = true;
    port.state().write_fails = true;
    arm.master().stop(id(9), StopKind::Hold).unwrap();
    for _ in 0..4 {
        assert_eq!(block_on(arm.next_event()), Err(Broken));
        clock.advance(2_000);
    }
    port.state().write_fails = false;
    let reported = block_on(arm.next_event());
    assert_eq!(reported, Ok(Event::StopUnconfirmed { motor: id(9) }), "nobody is there");
}

#[test]
fn no_echo_confirms_a_stop_whenever_futures_are_dropped() {
    for most in 1..40 {
        let (port, clock, mut arm) = serial();
        port.state().echoes = true;
        port.state().at_most = 1;
        arm.master().stop(id(9), StopKind::Hold).unwrap();
        // The first futures are dropped early.
        for _ in 0..4 {
            assert_eq!(polls(arm.next_event(), most), None, "{most}");
            clock.advance(2_000);
        }
        let reported = block_on(arm.next_event());
        assert_eq!(
            reported,
            Ok(Event::StopUnconfirmed { motor: id(9) }),
            "{most}: nobody is there"
        );
    }
}

#[test]
fn futures_dropped_while_a_frame_leaves_delay_no_stop() {
    let (port, clock, mut arm) = serial();
    arm.master().stop(id(9), StopKind::Hold).unwrap();
    // Each sees its frame taken, and is dropped before all of it has left.
    for most in [2, 3, 3] {
        assert_eq!(polls(arm.run(None), most), None);
        assert!(!port.is_flushed());
        clock.advance(8_000);
    }
    let sent: Vec<_> = port.written().chunks(13).map(|frame| frame[3]).collect();
    assert_eq!(sent, [0x81, 0x9A, 0x81], "the second attempt behind what shows an echo");
}

#[test]
fn frame_taken_by_a_serial_port_counts_as_sent_though_its_flush_fails() {
    let (port, _, mut arm) = used_serial();
    port.state().flush_fails = true;
    assert!(block_on(arm.ask(id(1), step())).is_ok(), "the drive has heard it");
    port.state().flush_fails = false;
    assert_eq!(polls(arm.next_event(), 1_000), None);
}

#[test]
fn waiting_commands_fail_after_20_ms_on_a_bus_that_takes_nothing() {
    // Polled to the end, or dropped every few polls: the bus is down after the same time.
    for most in [3, usize::MAX] {
        let (bus, clock, mut arm) = can();
        bus.state().full_until = 100_000;
        arm.set_point(id(1), torque()).unwrap();
        let read = arm.master().request(id(3), ReadMultiTurnAngle).unwrap();
        let mut dropped_at = None;
        while let Some(left) = 101_000u64.checked_sub(clock.micros()).filter(|&left| left > 0) {
            let until = clock.now() + Duration::from_micros(left);
            match polls(arm.run(Some(until)), most).map(Result::unwrap) {
                Some(Some(Event::SetPointDropped { motor })) if motor == id(1) => {
                    dropped_at = Some(clock.micros());
                }
                Some(Some(event)) => {
                    assert_eq!(read.outcome(&event), Some(Err(Failure::BusDown)), "{event:?}");
                }
                Some(None) | None => {}
            }
        }
        let dropped_at = dropped_at.expect("it is too old");
        assert!((20_000..=21_100).contains(&dropped_at), "{most}: {dropped_at}");
        assert!(bus.sent().is_empty());
    }
}

#[test]
fn a_bus_that_was_offered_nothing_meanwhile_is_not_down() {
    let (bus, clock, mut arm) = can();
    // What takes its frames is a task, too, and has its turn after the others.
    bus.state().full_until = 32_000;
    let read = arm.master().request(id(1), ReadMultiTurnAngle).unwrap();
    assert!(polls(arm.next_event(), 1).is_none());
    // Something else keeps all tasks busy.
    clock.advance(30_000);
    let event = block_on(arm.next_event()).unwrap();
    assert!(read.outcome(&event).is_some_and(|read| read.is_ok()), "{event:?}");
}

#[test]
fn a_bus_that_was_down_is_offered_what_is_asked_next() {
    let (bus, clock, mut arm) = can();
    bus.state().full_until = 30_000;
    let asked = block_on(arm.ask(id(1), ReadMultiTurnAngle));
    assert_eq!(asked, Err(CallError::Failed { motor: id(1), failure: Failure::BusDown }));
    let asked = block_on(arm.ask(id(1), ReadMultiTurnAngle));
    assert_eq!(
        asked,
        Err(CallError::Failed { motor: id(1), failure: Failure::BusDown }),
        "it is down yet"
    );
    clock.advance(10_000);
    assert!(block_on(arm.ask(id(1), ReadMultiTurnAngle)).is_ok());
}

#[test]
fn a_driver_that_fails_drops_motion_and_can_be_called_again() {
    let (bus, _, mut arm) = can();
    bus.state().transmit_fails = true;
    assert_eq!(block_on(arm.ask(id(1), step())), Err(CallError::Bus(Broken)));
    bus.state().transmit_fails = false;
    assert_eq!(polls(arm.next_event(), 1_000), None);
    assert!(bus.sent().is_empty());

    bus.state().receive_fails = true;
    assert_eq!(block_on(arm.ask(id(1), ReadMultiTurnAngle)), Err(CallError::Bus(Broken)));

    let (port, _, mut arm) = used_serial();
    port.state().write_fails = true;
    assert_eq!(block_on(arm.ask(id(1), step())), Err(CallError::Bus(Broken)));
    port.state().write_fails = false;
    assert_eq!(polls(arm.next_event(), 1_000), None);
    assert!(block_on(arm.ask(id(2), ReadMultiTurnAngle)).is_ok());
    assert_eq!(port.written().len(), 13);
}

#[test]
fn a_run_ends_in_time() {
    let (_, clock, mut arm) = can();
    assert_eq!(block_on(arm.run(Some(Instant::from_micros(1_010)))), Ok(None));
    assert_eq!(clock.micros(), 1_010);
    let (port, clock, mut arm) = serial();
    port.state().closed = true;
    assert_eq!(block_on(arm.run(Some(Instant::from_micros(1_010)))), Ok(None));
    assert_eq!(clock.micros(), 1_010);
}

#[test]
fn request_waits_for_one_whose_future_was_dropped() {
    let (_, _, mut arm) = can();
    assert!(polls(arm.ask(id(1), ReadMultiTurnAngle), 2).is_none());
    assert!(block_on(arm.ask(id(1), ReadMultiTurnAngle)).is_ok());
}

#[test]
fn stop_is_sent_while_each_receive_fails() {
    let (bus, clock, mut arm) = can();
    bus.state().receive_fails = true;
    arm.master().stop_all(StopKind::Hold, [id(1), id(2)].into_iter().collect()).unwrap();
    for _ in 0..100 {
        assert!(block_on(arm.run(None)).is_err());
        clock.advance(1_000);
    }
    // Each first one, and then again every 20.4 ms.
    assert!((8..=10).contains(&bus.sent().len()), "{:?}", bus.sent());

    let (port, clock, mut arm) = serial();
    port.state().read_fails = true;
    arm.master().stop(id(1), StopKind::Hold).unwrap();
    for _ in 0..100 {
        assert!(block_on(arm.run(None)).is_err());
        clock.advance(1_000);
    }
    assert!(port.written().len() > 13, "and again");
}

#[test]
fn a_control_loop_that_is_always_late_leaves_other_tasks_their_turns() {
    let (_, clock, mut arm) = can();
    clock.advance(1_000);
    let late = async {
        for _ in 0..100 {
            arm.run_until(Instant::ZERO, |_| {}).await.unwrap();
        }
    };
    let mut turns = 0;
    let other = async {
        loop {
            turns += 1;
            yield_now().await;
        }
    };
    block_on(select(pin!(late), pin!(other)));
    assert!(turns >= 100, "{turns}");
}
