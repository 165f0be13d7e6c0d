//! Controllers that overrun, that have few places, and that fail for good; and two motors that say the same.

use core::cell::RefCell;
use core::future::Future;
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use std::collections::VecDeque;
use std::rc::Rc;
use std::vec;
use std::vec::Vec;

use embedded_can::{ErrorKind, nb};

use super::world::{TestClock, TestSerial, awaited, block_on, on_rs485, pending, polls};
use super::{id, step, torque};
use crate::command::{ReadMultiTurnAngle, Shutdown, Stop};
use crate::id::Target;
use crate::io::{
    AsyncCanMaster, AsyncRunner, AsyncSerialMaster, CallError, CanMaster, Runner, SerialMaster,
    bring_up,
};
use crate::master::{Config, Event, Failure, MotorSet, Patience, StopKind};
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
    /// The errors that the next looks for a frame give; with `None` they look.
    errors: VecDeque<Option<ErrorKind>>,
    /// What each look for a frame gives that finds none.
    complains_of: Option<ErrorKind>,
    /// Of that, one millisecond is free after so many.
    complains_for_ms: Option<u64>,
    /// Each look for a frame gives an error, and leaves what has come.
    fails_to_receive: bool,
    /// Every call gives an error.
    is_broken: bool,
    /// These do not answer.
    deaf: MotorSet,
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
        if let Received::Packet(Packet { channel: Channel::Command(Target::Motor(motor)), data }) =
            can::decode(frame)
        {
            if state.deaf.contains(motor) {
                return Ok(None);
            }
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
        if state.fails_to_receive {
            return Err(::nb::Error::Other(Reported(ErrorKind::Other)));
        }
        if let Some(kind) = state.errors.pop_front().flatten() {
            return Err(::nb::Error::Other(Reported(kind)));
        }
        let is_content = state.complains_for_ms.is_some_and(|ms| now / 1_000 % (ms + 1) == ms);
        let nothing = match state.complains_of {
            Some(kind) if !is_content => ::nb::Error::Other(Reported(kind)),
            _ => ::nb::Error::WouldBlock,
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
        state.borrow_mut().errors.push_back(Some($kind));
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

/// A driver may have a queue of them.
#[test]
fn disturbed_frames_are_passed_over_until_there_are_too_many() {
    let crc = Some(ErrorKind::Crc);
    let too_many = Err(CallError::Bus(Reported(ErrorKind::Crc)));
    for (errors, expected) in [(vec![crc; 8], Ok(())), (vec![crc; 9], too_many)] {
        let ((state, clock), mut arm) = polling();
        let _read = arm.master().request(id(1), ReadMultiTurnAngle).unwrap();
        arm.poll().unwrap();
        clock.advance(RESPONSE);
        state.borrow_mut().errors.extend(&errors);
        let soon = arm.now() + Duration::from_millis(5);
        assert_eq!(arm.run_until(soon, |_| {}), expected, "{errors:?}");
    }
}

/// Its motor is busy. Whoever gets the error may think that nothing was sent.
#[test]
fn a_move_that_waits_for_its_turn_is_dropped_by_an_error() {
    let ((state, _), mut arm) = polling();
    let _read = arm.master().request(id(1), ReadMultiTurnAngle).unwrap();
    arm.poll().unwrap();
    state.borrow_mut().errors.push_back(Some(ErrorKind::Other));
    let reported = Err(CallError::Bus(Reported(ErrorKind::Other)));
    assert_eq!(arm.ask(id(1), step()), reported);
    arm.run_until(arm.now() + Duration::from_millis(5), |_| {}).unwrap();
    assert_eq!(state.borrow().taken, 1);

    // What ends motion goes on waiting.
    let _read = arm.master().request(id(1), ReadMultiTurnAngle).unwrap();
    arm.poll().unwrap();
    state.borrow_mut().errors.push_back(Some(ErrorKind::Other));
    assert!(arm.ask(id(1), Shutdown).is_ok());
}

#[test]
fn a_question_under_a_stop_that_cannot_be_sent_returns_the_error_at_once() {
    let ((state, clock), mut arm) = polling();
    arm.ask(id(1), ReadMultiTurnAngle).unwrap();
    state.borrow_mut().is_broken = true;
    arm.master().stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    let before = clock.micros();
    let outcome = arm.ask(id(1), ReadMultiTurnAngle);
    assert_eq!(outcome, Err(CallError::Bus(Reported(ErrorKind::Other))));
    assert!(clock.micros() - before < 10_000, "{}", clock.micros() - before);
}

/// Whether a move was sent decides what its caller may do.
#[test]
fn an_error_hides_no_move_that_was_sent_and_not_answered() {
    let often = Patience { attempts: 3, reply_timeout: Duration::from_millis(20) };
    for patience in [None, Some(often)] {
        let ((state, _), mut arm) = polling();
        state.borrow_mut().deaf = MotorSet::ALL;
        // Sent at the first look, and the errors come at the next.
        state.borrow_mut().errors.push_back(None);
        state.borrow_mut().errors.extend([Some(ErrorKind::Other); 10_000]);
        let failure = Failure::NoReply;
        let outcome = arm.ask_with(id(1), step(), patience, |_| {});
        assert_eq!(outcome, Err(CallError::Failed { motor: id(1), failure }), "{patience:?}");
        assert_eq!(state.borrow().taken, 1);
    }
}

#[test]
fn a_move_of_all_that_waits_is_dropped_by_an_error() {
    let ((state, _), mut arm) = polling();
    arm.ask(id(1), ReadMultiTurnAngle).unwrap();
    arm.master().broadcast(step(), MotorSet::EMPTY).unwrap();
    state.borrow_mut().errors.push_back(Some(ErrorKind::Other));
    let mut events = Vec::new();
    let end = arm.now() + Duration::from_millis(5);
    assert!(arm.run_until(end, |event| events.push(event)).is_err());
    arm.run_until(end, |event| events.push(event)).unwrap();
    let dropped = Event::BroadcastDone { silent: MotorSet::EMPTY, was_sent: false };
    assert_eq!((events, state.borrow().taken), (vec![dropped], 1));
}

/// A loop that polls and goes on after errors gets the events of its master, too.
#[test]
fn errors_at_each_look_keep_no_event_back() {
    for is_task in [false, true] {
        let mut events = Vec::new();
        if is_task {
            let ((state, _), mut arm) = tasks();
            state.borrow_mut().complains_of = Some(ErrorKind::Other);
            arm.master().stop(id(9), StopKind::Hold).unwrap();
            state.borrow_mut().deaf = MotorSet::ALL;
            let end = Instant::from_millis(500);
            block_on(async {
                while arm.now() < end {
                    events.extend(arm.run(Some(end)).await.ok().flatten());
                }
            });
        } else {
            let ((state, clock), mut arm) = polling();
            state.borrow_mut().complains_of = Some(ErrorKind::Other);
            arm.master().stop(id(9), StopKind::Hold).unwrap();
            state.borrow_mut().deaf = MotorSet::ALL;
            while clock.micros() < 500_000 {
                events.extend(arm.poll().ok().flatten());
                clock.advance(100);
            }
        }
        assert_eq!(events, [Event::StopUnconfirmed { motor: id(9) }], "{is_task}");
    }
}

/// Its driver fails, and keeps what has come.
#[test]
fn an_answer_kept_back_while_receiving_failed_is_not_taken_for_a_newer_one() {
    for idle in [0, 1_000_000] {
        an_answer_kept_back_is_not_taken_for_a_newer_one(idle);
    }
}

/// Nothing is said for this many microseconds before.
fn an_answer_kept_back_is_not_taken_for_a_newer_one(idle: u64) {
    let ((state, clock), mut arm) = polling();
    arm.ask(id(1), ReadMultiTurnAngle).unwrap();
    // An error that is over says nothing of the next.
    state.borrow_mut().errors.push_back(Some(ErrorKind::Other));
    arm.poll().unwrap_err();
    arm.poll().unwrap();
    clock.advance(idle);
    arm.poll().unwrap();
    let fails_until = |until: u64, arm: &mut CanMaster<Odd, TestClock, 16>| {
        state.borrow_mut().fails_to_receive = true;
        let end = Instant::from_micros(until);
        while arm.now() < end {
            let _ = arm.run_until(end, |_| {});
        }
        state.borrow_mut().fails_to_receive = false;
    };
    let _early = arm
        .master()
        .request_with(
            id(1),
            ReadMultiTurnAngle,
            Patience { attempts: 1, reply_timeout: Duration::from_millis(20) },
        )
        .unwrap();
    fails_until(idle + 80_000, &mut arm);
    let late = arm.master().request(id(1), ReadMultiTurnAngle).unwrap();
    fails_until(idle + 85_000, &mut arm);
    let mut answered_at = None;
    let end = Instant::from_micros(idle + 300_000);
    arm.run_until(end, |event| {
        if late.outcome(&event).is_some_and(|outcome| outcome.is_ok()) {
            answered_at = Some(clock.micros());
        }
    })
    .unwrap();
    // Not by what has waited until 85 ms.
    assert_eq!(answered_at, Some(idle + 85_000 + RESPONSE));
}

/// A motor that answered nothing for long is asked again.
#[test]
fn a_controller_that_complains_does_not_keep_a_silent_motor_from_being_asked() {
    let ((state, _), mut arm) = polling();
    arm.ask(id(1), ReadMultiTurnAngle).unwrap();
    (state.borrow_mut().complains_of, state.borrow_mut().deaf) =
        (Some(ErrorKind::Other), MotorSet::ALL);
    while arm.now() < Instant::from_millis(1_000) {
        assert!(arm.ask(id(1), ReadMultiTurnAngle).is_err());
    }
    state.borrow_mut().deaf = MotorSet::EMPTY;
    assert!(arm.ask(id(1), ReadMultiTurnAngle).is_ok());
}

/// Others are heard, so nothing is kept back.
#[test]
fn a_lost_answer_keeps_its_motor_from_being_asked_for_a_while_only() {
    for pause in [0, 50_000, 150_000] {
        a_lost_answer_is_asked_for_again(pause, true);
    }
    a_lost_answer_is_asked_for_again(0, false);
}

/// Another motor is heard at intervals of this many microseconds. Each look gives an error, or each second.
fn a_lost_answer_is_asked_for_again(pause: u64, each: bool) {
    let ((state, clock), mut arm) = polling();
    for motor in [1, 2] {
        arm.ask(id(motor), ReadMultiTurnAngle).unwrap();
    }
    if each {
        state.borrow_mut().complains_of = Some(ErrorKind::Other);
    } else {
        state.borrow_mut().errors.extend([Some(ErrorKind::Other), None].repeat(20_000));
    }
    state.borrow_mut().deaf = id(1).into();
    let once = Patience { attempts: 1, reply_timeout: Duration::from_millis(20) };
    assert!(arm.ask_with(id(1), ReadMultiTurnAngle, Some(once), |_| {}).is_err());
    state.borrow_mut().deaf = MotorSet::EMPTY;
    let asked_at = clock.micros();
    let again = arm.master().request(id(1), ReadMultiTurnAngle).unwrap();
    let mut is_answered = false;
    while !is_answered {
        let note = |event| is_answered |= again.outcome(&event).is_some();
        arm.ask_with(id(2), ReadMultiTurnAngle, None, note).unwrap();
        assert!(clock.micros() < asked_at + 250_000);
        clock.advance(pause);
    }
}

/// Its driver complains, is content for one look, and complains again.
#[test]
fn complaints_that_pause_do_not_keep_a_lost_answer_from_being_asked_for_again() {
    for complains_for_ms in [1, 20, 25, 50, 99, 150, 1_000] {
        let ((state, clock), mut arm) = polling();
        arm.ask(id(1), ReadMultiTurnAngle).unwrap();
        state.borrow_mut().complains_of = Some(ErrorKind::Other);
        state.borrow_mut().complains_for_ms = Some(complains_for_ms);
        state.borrow_mut().deaf = MotorSet::ALL;
        // The answer to the first is lost. The second waits until it can no longer come.
        arm.master().stop(id(1), StopKind::Hold).unwrap();
        let mut confirmed = 0;
        for until in [10, 30, 400].map(Instant::from_millis) {
            while arm.now() < until {
                let note = |event| {
                    confirmed += usize::from(event == Event::StopConfirmed { motor: id(1) })
                };
                let _ = arm.run_until(arm.now() + Duration::from_millis(1), note);
            }
            if state.borrow().deaf.is_empty() {
                arm.master().stop(id(1), StopKind::Hold).unwrap();
            }
            state.borrow_mut().deaf = MotorSet::EMPTY;
        }
        assert_eq!(confirmed, 2, "{complains_for_ms} {:?}", clock.micros());
    }
}

/// Its answers may be kept back, and yet it has to be spoken to: it may hold a load.
#[test]
fn a_motor_that_is_asked_again_and_again_is_not_left_alone_while_receiving_fails() {
    for fails_for_ms in [20, 50, 100, 150, 1_000] {
        let ((state, clock), mut arm) = polling();
        arm.ask(id(1), ReadMultiTurnAngle).unwrap();
        state.borrow_mut().fails_to_receive = true;
        let (mut taken, mut sent_at) = (1, clock.micros());
        while clock.micros() < 1_200_000 {
            state.borrow_mut().fails_to_receive = clock.micros() < fails_for_ms * 1_000;
            // It waits for the answer to the one before.
            let _ = arm.master().request(id(1), ReadMultiTurnAngle);
            let _ = arm.poll();
            if state.borrow().taken > taken {
                (taken, sent_at) = (state.borrow().taken, clock.micros());
            }
            assert!(clock.micros() < sent_at + 110_000, "{fails_for_ms} ms");
            clock.advance(500);
        }
    }
}

#[test]
fn an_error_of_the_bus_is_the_outcome_of_a_question_without_answer() {
    let ((state, _), mut arm) = polling();
    state.borrow_mut().complains_of = Some(ErrorKind::Other);
    // It does not answer.
    state.borrow_mut().deaf = MotorSet::ALL;
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
    let (outcomes, _) = patiently(&looked, arm.ask_together(questions));
    assert!(outcomes.iter().all(Result::is_err), "{outcomes:?}");
    // Whoever asks again and again leaves turns.
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
