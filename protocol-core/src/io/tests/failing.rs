//! Controllers that overrun, that have few places, and that fail for good; and two motors that say the same.

use core::cell::RefCell;
use core::future::Future;
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use std::collections::VecDeque;
use std::rc::Rc;
use std::vec::Vec;

use embedded_can::{ErrorKind, nb};

use super::world::{TestClock, TestSerial, awaited, block_on, on_rs485, pending, polls};
use super::{id, step, torque};
use crate::command::{ReadMultiTurnAngle, Stop};
use crate::id::Target;
use crate::io::{
    AsyncCanMaster, AsyncRunner, AsyncSerialMaster, CallError, CanMaster, Runner, SerialMaster,
    bring_up,
};
use crate::master::{Config, Event, Failure, MotorSet, StopKind};
use crate::opcode::Opcode;
use crate::packet::{Channel, Packet};
use crate::time::{Duration, Instant};
use crate::wire::can::{self, Received, SimpleFrame};

/// How long a drive takes to answer, in microseconds.
const RESPONSE: u64 = 800;
/// How long a frame takes.
const FRAME: u64 = 136;

/// What a controller reports.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Reported(ErrorKind);

impl embedded_can::Error for Reported {
    fn kind(&self) -> ErrorKind {
        self.0
    }
}

#[derive(Debug, Default)]
struct State {
    on_the_wire: VecDeque<(u64, SimpleFrame)>,
    received: VecDeque<SimpleFrame>,
    /// Frames that found no place.
    lost: u32,
    taken: usize,
    /// It takes so many frames, and then none until that time.
    refuses: Option<(usize, u64)>,
    /// What the next look for a frame gives.
    receive_error: Option<ErrorKind>,
    /// What each look for a frame gives that finds none.
    complains_of: Option<ErrorKind>,
    /// Every call gives an error.
    is_broken: bool,
    /// No drive answers.
    is_deaf: bool,
    /// Kinds that two motors of the id answer differently.
    twins_differ_in: Vec<u8>,
    /// How often it was looked at since somebody counted.
    looks: usize,
}

/// A controller with three places for received frames, on a bus of drives that answer everything.
#[derive(Clone, Debug)]
struct Odd(Rc<RefCell<State>>, TestClock);

impl Odd {
    fn look(&self) -> Result<(), Reported> {
        let mut state = self.0.borrow_mut();
        state.looks += 1;
        if !state.is_broken {
            return Ok(());
        }
        assert!(state.looks < 1_000, "it leaves nobody else a turn");
        Err(Reported(ErrorKind::Other))
    }
}

impl nb::Can for Odd {
    type Frame = SimpleFrame;
    type Error = Reported;

    fn transmit(&mut self, frame: &SimpleFrame) -> ::nb::Result<Option<SimpleFrame>, Reported> {
        self.look()?;
        let now = self.1.micros();
        let mut state = self.0.borrow_mut();
        if state.refuses.is_some_and(|(after, until)| state.taken >= after && now < until) {
            return Err(::nb::Error::WouldBlock);
        }
        state.taken += 1;
        if state.is_deaf {
            return Ok(None);
        }
        if let Received::Packet(Packet { channel: Channel::Command(Target::Motor(motor)), data }) =
            can::decode(frame)
        {
            let mut at = now + RESPONSE;
            let twins = if state.twins_differ_in.contains(&data[0]) { 2 } else { 1 };
            for twin in 0..twins {
                let last = state.on_the_wire.back().map_or(0, |(at, _)| at + FRAME);
                at = at.max(last);
                let data = [data[0], 30 + twin, 0, 0, 0xE5, 0x01, 0, 0];
                let answer = Packet { channel: Channel::Reply(motor), data };
                state.on_the_wire.push_back((at, can::encode(&answer).unwrap()));
            }
        }
        Ok(None)
    }

    fn receive(&mut self) -> ::nb::Result<SimpleFrame, Reported> {
        self.look()?;
        let now = self.1.micros();
        let mut state = self.0.borrow_mut();
        while let Some((_, frame)) = state.on_the_wire.pop_front_if(|(at, _)| *at <= now) {
            if state.received.len() < 3 {
                state.received.push_back(frame);
            } else {
                state.lost += 1;
            }
        }
        if let Some(kind) = state.receive_error.take() {
            return Err(::nb::Error::Other(Reported(kind)));
        }
        let nothing = match state.complains_of {
            Some(kind) => ::nb::Error::Other(Reported(kind)),
            None => ::nb::Error::WouldBlock,
        };
        state.received.pop_front().ok_or(nothing)
    }
}

awaited! { [] Odd }

type Looked = (Rc<RefCell<State>>, TestClock);

fn polling() -> (Looked, CanMaster<Odd, TestClock, 16>) {
    let (state, clock) = Looked::default();
    let can = Odd(state.clone(), clock.clone());
    ((state, clock.clone()), CanMaster::new(can, clock, Config::CAN))
}

fn tasks() -> (Looked, AsyncCanMaster<Odd, TestClock, 16>) {
    let (state, clock) = Looked::default();
    let can = Odd(state.clone(), clock.clone());
    ((state, clock.clone()), AsyncCanMaster::new(can, clock, Config::CAN))
}

/// What becomes of a question and a set-point that wait when the controller reports that: what the call gives, whether
/// there is an event of it, and whether each of both is answered.
macro_rules! waiting {
    ($kind:expr, $looked_and_arm:expr, $($wait:tt)*) => {{
        let ((state, _), mut arm) = $looked_and_arm;
        let mut events = Vec::new();
        let _ticket = arm.master().request(id(1), ReadMultiTurnAngle).unwrap();
        arm.set_point(id(2), torque()).unwrap();
        state.borrow_mut().refuses = Some((0, 5_000));
        state.borrow_mut().receive_error = Some($kind);
        let end = arm.now() + Duration::from_millis(15);
        let outcome = arm.run_until(end, |event| events.push(event)) $($wait)*;
        arm.run_until(end, |event| events.push(event)) $($wait)* .unwrap();
        let is_any = |is_one: fn(&Event) -> bool| events.iter().any(is_one);
        let is_answered = is_any(|event| matches!(event, Event::Reply { .. }));
        let is_obeyed = is_any(|event| matches!(event, Event::Feedback { .. }));
        assert_eq!(is_any(|event| matches!(event, Event::SetPointDropped { .. })), !is_obeyed);
        (outcome, events.contains(&Event::Overrun), is_answered, is_obeyed)
    }};
}

#[test]
fn an_overrun_is_an_event_and_drops_nothing_that_waits() {
    let overrun = (Ok(()), true, true, true);
    assert_eq!(waiting!(ErrorKind::Overrun, polling(),), overrun);
    assert_eq!(block_on(async { waiting!(ErrorKind::Overrun, tasks(), .await) }), overrun);
}

/// Whoever has sent such a frame sends it again.
#[test]
fn a_disturbed_frame_is_no_error_of_the_bus() {
    for kind in
        [ErrorKind::Bit, ErrorKind::Stuff, ErrorKind::Crc, ErrorKind::Form, ErrorKind::Acknowledge]
    {
        let nothing = (Ok(()), false, true, true);
        assert_eq!(waiting!(kind, polling(),), nothing);
        assert_eq!(block_on(async { waiting!(kind, tasks(), .await) }), nothing);
    }
}

#[test]
fn an_error_in_receiving_drops_what_moves_and_sends_what_asks() {
    let other = (Err(CallError::Bus(Reported(ErrorKind::Other))), false, true, false);
    assert_eq!(waiting!(ErrorKind::Other, polling(),), other);
    assert_eq!(block_on(async { waiting!(ErrorKind::Other, tasks(), .await) }), other);
}

/// Its error counter falls only when frames are sent, and motors that hold have to be spoken to.
#[test]
fn a_controller_that_complains_at_each_look_is_spoken_through() {
    for kind in [ErrorKind::Other, ErrorKind::Stuff] {
        let complaining = || {
            let looked_and_arm = polling();
            looked_and_arm.0.0.borrow_mut().complains_of = Some(kind);
            looked_and_arm
        };
        let ((state, _), mut arm) = complaining();
        for _ in 0..3 {
            assert!(arm.ask(id(1), ReadMultiTurnAngle).is_ok());
            let questions = [2, 3].map(|motor| (id(motor), ReadMultiTurnAngle));
            assert!(arm.ask_together(questions).iter().all(Result::is_ok));
        }
        assert_eq!(state.borrow().taken, 9);
        assert!(arm.stop(id(1), StopKind::Hold));

        let ((state, _), mut arm) = tasks();
        state.borrow_mut().complains_of = Some(kind);
        for _ in 0..3 {
            assert!(block_on(arm.ask(id(1), ReadMultiTurnAngle)).is_ok());
        }
        assert_eq!(state.borrow().taken, 3);
        assert!(block_on(arm.stop(id(1), StopKind::Hold)));
    }
}

/// What floats while nobody drives the line looks like bytes to some ports. A stop need not be confirmed then: what
/// was not read may have been its echo.
#[test]
fn a_line_that_complains_at_each_look_is_spoken_through() {
    let (port, _, mut arm): (TestSerial, TestClock, SerialMaster<_, _, 4>) =
        on_rs485(SerialMaster::new);
    port.state().complains = true;
    for motor in [1, 2, 3] {
        assert!(arm.ask(id(motor), ReadMultiTurnAngle).is_ok());
    }
    let _may_be_confirmed = arm.stop(id(1), StopKind::Hold);
    assert!(port.commands().contains(&Stop.encode()));

    let (port, _, mut arm): (TestSerial, TestClock, AsyncSerialMaster<_, _, 4>) =
        on_rs485(AsyncSerialMaster::new);
    port.state().complains = true;
    for motor in [1, 2, 3] {
        assert!(block_on(arm.ask(id(motor), ReadMultiTurnAngle)).is_ok());
    }
    let _may_be_confirmed = block_on(arm.stop(id(1), StopKind::Hold));
    assert!(port.commands().contains(&Stop.encode()));
}

#[test]
fn an_error_of_the_bus_is_the_outcome_of_a_question_without_answer() {
    let ((state, _), mut arm) = polling();
    state.borrow_mut().complains_of = Some(ErrorKind::Other);
    // It does not answer.
    state.borrow_mut().is_deaf = true;
    let outcome = arm.ask(id(1), ReadMultiTurnAngle);
    assert_eq!(outcome, Err(CallError::Bus(Reported(ErrorKind::Other))));
    // A move is not sent at all.
    let taken = state.borrow().taken;
    let outcome = arm.ask(id(1), step());
    assert_eq!(outcome, Err(CallError::Bus(Reported(ErrorKind::Other))));
    assert_eq!(state.borrow().taken, taken);
}

#[test]
fn a_controller_with_three_places_loses_no_answer_while_it_takes_nothing() {
    // It has taken eight questions, and is offered the ninth while the answers come.
    let ((state, clock), mut arm) = polling();
    state.borrow_mut().refuses = Some((8, 5_000));
    let ask = |motor| (id(motor), ReadMultiTurnAngle);
    let questions = [1, 2, 3, 4, 5, 6, 7, 8, 9].map(ask);
    assert!(arm.ask_together(questions).iter().all(Result::is_ok));
    assert_eq!((state.borrow().lost, state.borrow().taken), (0, 9));
    assert!(clock.micros() >= 5_000 + RESPONSE);

    let ((state, clock), mut arm) = tasks();
    state.borrow_mut().refuses = Some((8, 5_000));
    assert!(block_on(arm.ask_together(questions)).iter().all(Result::is_ok));
    assert_eq!((state.borrow().lost, state.borrow().taken), (0, 9));
    assert!(clock.micros() >= 5_000 + RESPONSE);
}

/// Polls a future every 0.1 ms until it is done, and gives how long that took. In each poll it may look at the bus
/// a few times.
fn patiently<F: Future>((state, clock): &Looked, future: F) -> (F::Output, u64) {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    let start = clock.micros();
    loop {
        state.borrow_mut().looks = 0;
        let poll = future.as_mut().poll(&mut context);
        let looks = state.borrow().looks;
        assert!(looks <= 8, "{looks} looks at a bus that has failed");
        if let Poll::Ready(output) = poll {
            return (output, clock.micros() - start);
        }
        clock.advance(100);
        assert!(clock.micros() < start + 60_000_000, "it comes to no end");
    }
}

#[test]
fn a_can_bus_that_fails_for_good_leaves_other_tasks_their_turns() {
    let (looked, mut arm) = tasks();
    block_on(arm.ask(id(1), ReadMultiTurnAngle)).unwrap();
    looked.0.borrow_mut().is_broken = true;
    let questions = [1, 2, 3].map(|motor| (id(motor), ReadMultiTurnAngle));
    let (outcomes, took_us) = patiently(&looked, arm.ask_together(questions));
    assert!(outcomes.iter().all(Result::is_err), "{outcomes:?}");
    assert!((100..60_000_000).contains(&took_us), "with a turn for the others: {took_us}");
    let (unconfirmed, took_us) = patiently(&looked, arm.stop_all(StopKind::Hold, id(9).into()));
    assert_eq!(unconfirmed, [1, 2, 3, 9].map(id).into_iter().collect::<MotorSet>());
    assert!(took_us >= 1_000, "it may be well again: {took_us}");
}

#[test]
fn a_line_that_fails_for_good_leaves_other_tasks_their_turns() {
    let (port, clock, mut arm): (TestSerial, TestClock, AsyncSerialMaster<_, _, 4>) =
        on_rs485(AsyncSerialMaster::new);
    block_on(arm.ask(id(1), ReadMultiTurnAngle)).unwrap();
    (port.state().read_fails, port.state().write_fails) = (true, true);
    let questions = [1, 2, 3].map(|motor| (id(motor), ReadMultiTurnAngle));
    assert!(polls(arm.ask_together(questions), 1).is_none());
    assert!(polls(arm.stop_all(StopKind::Hold, MotorSet::EMPTY), 100).is_none());
    assert!(clock.micros() < 60_000_000);
}

#[test]
fn a_line_that_fails_for_good_lets_the_clock_idle() {
    for takes_nothing in [false, true] {
        let (port, clock, mut arm): (TestSerial, TestClock, SerialMaster<_, _, 4>) =
            on_rs485(SerialMaster::new);
        (port.state().write_fails, port.state().takes_nothing) = (!takes_nothing, takes_nothing);
        let unconfirmed = arm.stop_all(StopKind::Hold, id(1).into());
        assert_eq!(unconfirmed, id(1).into());
        assert_eq!(clock.micros(), 1_000_000);
    }
}

#[test]
fn a_move_of_which_a_part_was_taken_is_not_sent_again() {
    let (port, clock, mut arm): (TestSerial, TestClock, SerialMaster<_, _, 4>) =
        on_rs485(SerialMaster::new);
    arm.ask(id(1), ReadMultiTurnAngle).unwrap();
    clock.advance(10_000);
    port.forget();
    (port.state().at_most, port.state().fails_after) = (5, Some(5));
    let step = arm.master().request(id(1), step()).unwrap();
    let outcome = arm.run_until(arm.now() + Duration::from_millis(1), |_| {});
    assert!(matches!(outcome, Err(CallError::Bus(_))), "{outcome:?}");
    port.state().fails_after = None;
    let mut ended = None;
    let end = arm.now() + Duration::from_millis(100);
    arm.run_until(end, |event| ended = ended.or(step.outcome(&event))).unwrap();
    assert_eq!(ended, Some(Err(Failure::NoReply)));
    assert_eq!(port.written().len(), 5);
}

#[test]
fn port_is_flushed_again_after_a_failed_flush() {
    let (port, _, mut arm): (TestSerial, TestClock, AsyncSerialMaster<_, _, 4>) =
        on_rs485(AsyncSerialMaster::new);
    port.state().flush_fails = true;
    let outcome = block_on(arm.ask(id(1), ReadMultiTurnAngle));
    assert!(matches!(outcome, Err(CallError::Bus(_))), "{outcome:?}");
    assert!(!port.is_flushed());
    port.state().flush_fails = false;
    let soon = arm.now() + Duration::from_millis(2);
    block_on(arm.run_until(soon, |_| {})).unwrap();
    assert!(port.is_flushed(), "its transceiver is turned round");
}

#[test]
fn two_motors_of_one_id_are_found_by_any_different_answer() {
    for kind in [
        Opcode::ReadStatus1,
        Opcode::ReadStatus2,
        Opcode::ReadStatus3,
        Opcode::ReadRunTime,
        Opcode::ReadMultiTurnAngle,
    ] {
        let ((state, _), mut arm) = polling();
        assert_eq!(bring_up::is_shared(&mut arm, id(1)), Ok(false));
        state.borrow_mut().twins_differ_in = kind.byte().into_iter().collect();
        assert_eq!(bring_up::is_shared(&mut arm, id(1)), Ok(true), "{kind:?}");
    }
}

#[test]
fn a_control_loop_that_goes_on_after_each_error_leaves_other_tasks_their_turns() {
    let (looked, mut arm) = tasks();
    looked.0.borrow_mut().is_broken = true;
    let (failed, took_us) = patiently(&looked, async {
        let mut failed = 0;
        while arm.now() < Instant::from_millis(10) {
            let tick = arm.now() + Duration::from_millis(2);
            failed += usize::from(arm.run_until(tick, |_| {}).await.is_err());
        }
        failed
    });
    assert!(failed > 0 && took_us < 20_000, "{failed} {took_us}");
}
