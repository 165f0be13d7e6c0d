//! The loops that poll.

use core::cell::Cell;
use core::ops::ControlFlow;
use std::vec::Vec;

use embedded_can::Frame as _;
use embedded_can::nb::Can as _;

use super::world::{Broken, TestCan, TestClock, TestSerial, on_can, on_rs485};
use super::{id, step, torque};
use crate::command::{NoReply, ReadMultiTurnAngle, ReadStatus1, Reset, Shutdown, Stop};
use crate::error::RequestError;
use crate::io::{
    BlockingCan, CallError, CanMaster, Clock, LONGEST_STOP, Runner, SerialMaster, bring_up,
};
use crate::master::{Config, Event, Failure, MotorSet, Patience, StopKind};
use crate::time::{Duration, Instant};
use crate::wire::can::{self, SimpleFrame};
use crate::wire::rs485::Frame;
use crate::{Channel, Packet, Target};

fn can() -> (TestCan, TestClock, CanMaster<TestCan, TestClock, 4>) {
    on_can(CanMaster::new)
}

fn serial() -> (TestSerial, TestClock, SerialMaster<TestSerial, TestClock, 4>) {
    on_rs485(SerialMaster::new)
}

/// One of which is known that it does not echo.
fn used_serial() -> (TestSerial, TestClock, SerialMaster<TestSerial, TestClock, 4>) {
    let (port, clock, mut arm) = serial();
    arm.ask(id(1), ReadMultiTurnAngle).unwrap();
    port.forget();
    (port, clock, arm)
}

/// Runs for so long and gives what happened.
fn run<const N: usize, R: Runner<N, Error = Broken>>(
    arm: &mut R,
    clock: &TestClock,
    micros: u64,
) -> Vec<Event> {
    let end = clock.micros() + micros;
    let mut events = Vec::new();
    while clock.micros() < end {
        match arm.poll().unwrap() {
            Some(event) => events.push(event),
            None => {
                arm.idle(clock.now() + crate::time::Duration::from_micros(end - clock.micros()))
            }
        }
    }
    events
}

#[test]
fn a_frame_that_the_controller_refuses_is_not_counted_as_sent() {
    let (bus, clock, mut arm) = can();
    bus.state().full_until = 5_000;
    let ticket = arm.master().request(id(1), step()).unwrap();
    assert_eq!(run(&mut arm, &clock, 4_900), []);
    assert!(!arm.master().is_anything_in_flight());
    assert!(bus.sent().is_empty());
    // Then it is taken, once, and its time-out runs from there.
    let events = run(&mut arm, &clock, 60_000);
    assert_eq!(bus.sent().len(), 1);
    assert!(ticket.outcome(&events[0]).unwrap().is_ok());
    assert_eq!(events.len(), 1);
}

#[test]
fn a_bus_that_takes_nothing_for_20_ms_is_down() {
    let (bus, clock, mut arm) = can();
    bus.state().full_until = 100_000;
    arm.set_point(id(1), torque()).unwrap();
    let read = arm.master().request(id(3), ReadMultiTurnAngle).unwrap();
    assert_eq!(run(&mut arm, &clock, 20_000), [], "the bus may be merely busy");
    let events = run(&mut arm, &clock, 1_000);
    assert!(events.contains(&Event::SetPointDropped { motor: id(1) }), "{events:?}");
    let outcome = events.iter().find_map(|event| read.outcome(event));
    assert_eq!(outcome, Some(Err(Failure::BusDown)), "nobody waits for ever");
}

#[test]
fn a_bus_that_has_taken_something_meanwhile_is_not_down() {
    let (bus, clock, mut arm) = can();
    bus.state().full_until = 15_000;
    let first = arm.master().request(id(1), ReadMultiTurnAngle).unwrap();
    let events = run(&mut arm, &clock, 18_000);
    assert!(events.iter().any(|event| first.outcome(event).is_some_and(|outcome| outcome.is_ok())));
    bus.state().full_until = 30_000;
    let second = arm.master().request(id(1), ReadMultiTurnAngle).unwrap();
    let events = run(&mut arm, &clock, 15_000);
    assert!(
        events.iter().any(|event| second.outcome(event).is_some_and(|outcome| outcome.is_ok()))
    );
}

#[test]
fn a_driver_that_fails_drops_motion_and_can_be_called_again() {
    let (bus, clock, mut arm) = can();
    bus.state().transmit_fails = true;
    assert_eq!(arm.ask(id(1), step()), Err(CallError::Bus(Broken)));
    bus.state().transmit_fails = false;
    assert_eq!(run(&mut arm, &clock, 50_000), []);
    assert!(bus.sent().is_empty());

    bus.state().receive_fails = true;
    assert_eq!(arm.ask(id(1), ReadMultiTurnAngle), Err(CallError::Bus(Broken)));
    bus.state().receive_fails = false;
    run(&mut arm, &clock, 50_000);
    assert_eq!(arm.ask(id(1), ReadMultiTurnAngle).unwrap().angle.degrees(), 360.0);
}

/// A blocking controller of which every answer is given.
struct Scripted(Result<(), u8>);

#[derive(Clone, Copy, Debug, PartialEq)]
struct Code(u8);

impl embedded_can::Error for Code {
    fn kind(&self) -> embedded_can::ErrorKind {
        embedded_can::ErrorKind::Other
    }
}

impl embedded_can::blocking::Can for Scripted {
    type Frame = SimpleFrame;
    type Error = Code;

    fn transmit(&mut self, _: &SimpleFrame) -> Result<(), Code> {
        self.0.map_err(Code)
    }

    fn receive(&mut self) -> Result<SimpleFrame, Code> {
        self.0.map(|()| frame()).map_err(Code)
    }
}

fn frame() -> SimpleFrame {
    can::encode(&Packet { channel: Channel::Command(id(1).into()), data: Stop.encode() }).unwrap()
}

#[test]
fn a_time_out_of_a_blocking_controller_is_would_block() {
    let is_timeout = |error: &Code| error.0 == 7;
    let mut good = BlockingCan::new(Scripted(Ok(())), is_timeout);
    assert_eq!(good.transmit(&frame()), Ok(None));
    assert_eq!(good.receive(), Ok(frame()));
    let mut late = BlockingCan::new(Scripted(Err(7)), is_timeout);
    assert_eq!(late.transmit(&frame()), Err(nb::Error::WouldBlock));
    assert_eq!(late.receive(), Err(nb::Error::WouldBlock));
    let mut bad = BlockingCan::new(Scripted(Err(8)), is_timeout);
    assert_eq!(bad.transmit(&frame()), Err(nb::Error::Other(Code(8))));
    assert_eq!(bad.receive(), Err(nb::Error::Other(Code(8))));
}

#[test]
fn a_serial_port_may_move_one_byte_at_a_time() {
    let (port, clock, mut arm) = used_serial();
    port.state().at_most = 1;
    port.hear(&[0x00, 0x3E, 0x01]); // what is left of somebody's frame
    assert_eq!(arm.ask(id(1), ReadMultiTurnAngle).unwrap().angle.degrees(), 360.0);
    // 3E 01 08 92 00.. with its CRC: the manual's frame (6, example of 0x92).
    let written = port.written();
    assert_eq!(written[..11], [0x3E, 1, 8, 0x92, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(written.len(), 13);
    assert!(port.is_flushed());
    assert!(clock.micros() >= 800);
}

#[test]
fn a_serial_port_that_fails_or_takes_nothing_drops_motion() {
    let (port, clock, mut arm) = serial();
    port.state().write_fails = true;
    assert_eq!(arm.ask(id(1), step()), Err(CallError::Bus(Broken)));
    port.state().write_fails = false;
    assert_eq!(run(&mut arm, &clock, 20_000), []);
    port.state().takes_nothing = true;
    assert_eq!(
        arm.ask(id(1), step()),
        Err(CallError::Failed { motor: id(1), failure: Failure::BusDown })
    );
    port.state().takes_nothing = false;
    run(&mut arm, &clock, 20_000);
    assert!(port.written().is_empty());
}

#[test]
fn frame_taken_by_a_serial_port_counts_as_sent_though_its_flush_fails() {
    let (port, clock, mut arm) = used_serial();
    port.state().flush_fails = true;
    assert!(arm.ask(id(1), step()).is_ok(), "the drive has heard it");
    port.state().flush_fails = false;
    assert_eq!(run(&mut arm, &clock, 20_000), []);
}

#[test]
fn a_closed_port_is_a_silent_one() {
    let (port, _, mut arm) = serial();
    port.state().closed = true;
    assert_eq!(
        arm.ask(id(9), ReadMultiTurnAngle),
        Err(CallError::Failed { motor: id(9), failure: Failure::NoReply })
    );
}

#[test]
fn a_command_without_reply_is_over_once_it_has_left() {
    let (port, _, mut arm) = used_serial();
    assert_eq!(arm.ask(id(1), Reset), Ok(NoReply));
    assert!(port.is_flushed() && port.written().len() == 13);
}

#[test]
fn request_waits_for_one_that_a_bus_error_left_in_flight() {
    let (bus, _, mut arm) = can();
    bus.state().receive_fails = true;
    assert_eq!(arm.ask(id(1), ReadMultiTurnAngle), Err(CallError::Bus(Broken)));
    bus.state().receive_fails = false;
    for _ in 0..10 {
        assert!(arm.ask(id(1), ReadMultiTurnAngle).is_ok());
    }
}

/// The request that keeps the motor busy may be answered for 5 s.
#[test]
fn request_waits_for_its_turn_for_two_seconds() {
    for is_together in [false, true] {
        let (_, clock, mut arm) = can();
        let patience = Patience { reply_timeout: Duration::from_secs(5), attempts: 1 };
        let _first = arm.master().request_with(id(9), ReadStatus1, patience).unwrap();
        let refused = Err(CallError::Refused { motor: id(9), refusal: RequestError::Busy });
        let outcome = if is_together {
            let [outcome] = arm.ask_together([(id(9), ReadMultiTurnAngle)]);
            outcome
        } else {
            arm.ask(id(9), ReadMultiTurnAngle)
        };
        assert_eq!(outcome, refused);
        assert!((2_000_000..2_011_000).contains(&clock.micros()), "{}", clock.micros());
    }
}

#[test]
fn scan_reports_only_the_ids_it_asks() {
    let (_, _, mut arm) = can();
    let _earlier = arm.master().request(id(3), ReadMultiTurnAngle).unwrap();
    let mut reported = Vec::new();
    let found =
        bring_up::scan(&mut arm, id(1).into(), |motor, there| reported.push((motor, there)));
    assert!(found.unwrap().contains(id(1)));
    assert_eq!(reported, [(id(1), true)]);
}

#[test]
fn a_scan_finds_none_but_its_candidates() {
    let (bus, _, mut arm) = can();
    let of_another = Packet { channel: Channel::Reply(id(7)), data: [0xF1, 0, 0, 0, 0, 0, 0, 0] };
    bus.hear(&of_another);
    assert_eq!(bring_up::scan(&mut arm, id(1).into(), |_, _| {}), Ok(id(1).into()));
}

#[test]
fn id_of_a_motor_that_answers_once_is_not_shared() {
    let (_, _, mut arm) = can();
    assert_eq!(bring_up::is_shared(&mut arm, id(1)), Ok(false));
}

#[test]
fn unconfirmed_stop_call_returns_after_15_attempts() {
    let (_, clock, mut arm) = can();
    assert!(!arm.stop(id(9), StopKind::Hold));
    // 15 times 20.4 ms.
    assert!((306_000..320_000).contains(&clock.micros()), "{}", clock.micros());
}

#[test]
fn borrowed_clock_idles_too() {
    fn idle(clock: impl Clock) {
        clock.idle(clock.now() + crate::time::Duration::from_micros(20));
    }
    let clock = TestClock::default();
    idle(&clock);
    assert_eq!(clock.micros(), 20);
}

#[test]
fn the_echo_of_a_stop_confirms_nothing_however_late_it_is_read() {
    let clock = TestClock::default();
    let port = TestSerial::new(&clock);
    port.state().echoes = true;
    let config = Config::rs485(115_200, true);
    let mut arm = SerialMaster::<_, _, 4>::new(port, clock.clone(), config);
    run(&mut arm, &clock, 1_000);
    // Nobody is there.
    arm.master().stop(id(9), StopKind::Hold).unwrap();
    assert_eq!(arm.poll(), Ok(None));
    // The program is halted for a while, and its echo waits in the port.
    clock.advance(150_000);
    assert_eq!(run(&mut arm, &clock, 500_000), [Event::StopUnconfirmed { motor: id(9) }]);
}

#[test]
fn first_stop_on_an_adapter_is_not_confirmed_by_an_unconfigured_echo() {
    for echoes in [false, true] {
        let (port, _, mut arm) = serial();
        port.state().echoes = echoes;
        assert!(!arm.stop(id(9), StopKind::Hold), "nobody is there; echoes: {echoes}");
        let (port, clock, mut arm) = serial();
        port.state().echoes = echoes;
        assert!(arm.stop(id(1), StopKind::Hold), "echoes: {echoes}");
        // One attempt and two reads go before that which is believed.
        assert!(clock.micros() < 18_000, "{} us", clock.micros());
        assert_eq!(port.written()[3], 0x81, "it waits for nothing");
    }
    // A stop of all shows it by itself.
    let (port, _, mut arm) = serial();
    let _ = arm.stop_all(StopKind::Hold, id(1).into());
    assert_eq!(port.written()[..4], [0x3E, 0xCD, 8, 0x81]);
}

#[test]
fn echo_that_was_lost_for_a_while_confirms_no_stop() {
    let (port, clock, mut arm) = serial();
    for _ in 0..3 {
        port.state().echoes = true;
        arm.master().lift_stop();
        assert!(!arm.stop(id(9), StopKind::Hold), "nobody is there");
        // A short circuit on the line, behind which the adapter hears not even itself.
        port.state().echoes = false;
        for _ in 0..4 {
            assert!(arm.ask(id(9), ReadStatus1).is_err());
        }
        run(&mut arm, &clock, 200_000);
    }
}

#[test]
fn no_echo_confirms_a_stop_after_a_port_has_failed() {
    let (port, clock, mut arm) = serial();
    port.state().echoes = true;
    port.state().write_fails = true;
    arm.master().stop(id(9), StopKind::Hold).unwrap();
    for _ in 0..4 {
        assert_eq!(arm.poll(), Err(Broken));
        clock.advance(2_000);
    }
    port.state().write_fails = false;
    assert_eq!(run(&mut arm, &clock, 500_000), [Event::StopUnconfirmed { motor: id(9) }]);
}

#[test]
fn another_masters_status_read_is_not_taken_for_an_echo() {
    let (port, _, mut arm) = serial();
    let other: [u8; 13] = [0x3E, 33, 8, 0x9A, 0, 0, 0, 0, 0, 0, 0, 0x73, 0x70];
    port.hear(&other);
    assert!(arm.stop(id(1), StopKind::Hold), "its answer is none of this one's echoes");
}

#[test]
fn stop_is_sent_while_each_receive_fails() {
    let (bus, _, mut arm) = can();
    bus.state().receive_fails = true;
    let read = arm.master().request(id(3), ReadMultiTurnAngle);
    assert!(read.is_ok());
    assert!(!arm.stop(id(1), StopKind::Hold));
    let stops = bus.sent().into_iter().filter(|data| *data == Stop.encode());
    assert_eq!((bus.sent()[0], stops.count()), (Stop.encode(), 15));

    let (port, _, mut arm) = serial();
    port.state().read_fails = true;
    assert!(!arm.stop(id(1), StopKind::Hold));
    assert!(port.written().len() > 13, "and again");
}

/// A clock that only notes until when it was to idle.
#[derive(Default)]
struct NotesIdle(Cell<Option<Instant>>);

impl Clock for NotesIdle {
    fn now(&self) -> Instant {
        Instant::ZERO
    }

    fn idle(&self, until: Instant) {
        self.0.set(Some(until));
    }
}

#[test]
fn refused_frame_is_offered_again_within_a_millisecond() {
    let clock = NotesIdle::default();
    let bus = TestCan::new(&TestClock::default());
    bus.state().full_until = u64::MAX;
    let mut arm = CanMaster::<_, _, 4>::new(bus.clone(), &clock, Config::CAN);
    arm.master().stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(arm.poll(), Ok(None));
    arm.idle(Instant::from_micros(u64::MAX));
    assert_eq!(clock.0.get(), Some(Instant::from_millis(1)));
    // Nothing else keeps it from idling for long.
    bus.state().full_until = 0;
    assert_eq!(arm.poll(), Ok(None));
    arm.idle(Instant::from_micros(u64::MAX));
    assert!(clock.0.get() > Some(Instant::from_millis(1)));
}

#[test]
fn loop_idles_until_the_given_time_or_the_next_deadline() {
    let far = Instant::from_millis(1_000);
    let clock = NotesIdle::default();
    let mut of_can =
        CanMaster::<_, _, 4>::new(TestCan::new(&TestClock::default()), &clock, Config::CAN);
    idles(&mut of_can, &clock, far);
    let port = TestSerial::new(&TestClock::default());
    let mut of_line = SerialMaster::<_, _, 4>::new(port, &clock, Config::rs485(115_200, true));
    idles(&mut of_line, &clock, far);
}

/// A clock that sleeps for as long as it may.
struct Sleeps(TestClock);

impl Clock for Sleeps {
    fn now(&self) -> Instant {
        self.0.now()
    }

    fn idle(&self, until: Instant) {
        self.0.advance((until - self.now()).as_micros());
    }
}

#[test]
fn a_call_that_waits_looks_at_the_bus_every_10_ms_and_ends_in_time() {
    let (bus, clock, mut arm) =
        on_can(|bus, clock, config| CanMaster::<_, _, 4>::new(bus, Sleeps(clock), config));
    let data = [0x9A, 50, 30, 1, 0xE5, 0x01, 2, 0];
    bus.hear_at(301_000, &Packet { channel: Channel::Reply(id(1)), data });
    let mut heard = Vec::new();
    arm.run_until(Instant::from_millis(995), |_| heard.push(clock.micros())).unwrap();
    assert!(matches!(heard[..], [301_000..=311_000]), "{heard:?}");
    assert_eq!(clock.micros(), 995_000);
}

fn idles(arm: &mut impl Runner<4>, clock: &NotesIdle, far: Instant) {
    arm.idle(far);
    assert_eq!(clock.0.get(), Some(far), "nothing is due");
    let _read = arm.master().request(id(1), ReadMultiTurnAngle).unwrap();
    assert!(arm.poll().is_ok());
    arm.idle(far);
    assert!(clock.0.get() < Some(Instant::from_millis(50)), "its time-out: {:?}", clock.0.get());
}

#[test]
fn scan_waits_two_seconds_for_a_stop_that_a_dead_bus_keeps() {
    let (bus, clock, mut arm) = can();
    bus.state().full_until = u64::MAX;
    arm.master().stop(id(1), StopKind::Hold).unwrap();
    let found = bring_up::scan(&mut arm, id(1).into(), |_, _| {});
    assert_eq!(found, Err(CallError::Refused { motor: id(1), refusal: RequestError::Busy }));
    assert!((2_000_000..2_100_000).contains(&clock.micros()), "{}", clock.micros());
}

#[test]
fn drop_of_an_earlier_set_point_is_not_reported_for_the_next() {
    let (bus, _, mut arm) = can();
    bus.state().transmit_fails = true;
    arm.set_point(id(1), torque()).unwrap();
    assert_eq!(arm.poll(), Err(Broken));
    // It was dropped, which was not reported yet.
    bus.state().transmit_fails = false;
    assert!(arm.set_point_and_wait(id(1), torque()).is_ok());
    assert_eq!(bus.sent().len(), 1);
}

#[test]
fn dropped_set_point_is_not_answered_by_the_feedback_of_an_earlier_one() {
    let clock = TestClock::default();
    let bus = TestCan::new(&clock);
    // At this rate an answer is waited for up to 72 ms, and a set-point lives for 50 ms.
    let mut arm = CanMaster::<_, _, 4>::new(bus.clone(), clock, Config::can(250_000));
    arm.set_point(id(9), torque()).unwrap();
    arm.poll().unwrap();
    let data = [0xA1, 50, 100, 0, 0, 0, 0, 0];
    bus.hear_at(60_000, &Packet { channel: Channel::Reply(id(9)), data });
    let answer = arm.set_point_and_wait(id(9), torque());
    assert_eq!(answer, Err(CallError::Failed { motor: id(9), failure: Failure::Dropped }));
    assert_eq!(bus.sent().len(), 1);
}

#[test]
fn motor_without_a_place_is_returned_as_unconfirmed() {
    let (_, clock, mut arm) = on_can(CanMaster::<_, _, 1>::new);
    let both = [1, 2].map(id).into_iter().collect();
    assert_eq!(arm.stop_all(StopKind::Hold, both), id(2).into());
    assert!(clock.micros() < 10_000, "nor is it waited for: {}", clock.micros());
}

/// A bus that fails once, with the third look.
struct FailsOnce(TestCan, u8);

impl embedded_can::nb::Can for FailsOnce {
    type Frame = SimpleFrame;
    type Error = Broken;

    fn transmit(&mut self, frame: &SimpleFrame) -> nb::Result<Option<SimpleFrame>, Broken> {
        self.0.transmit(frame)
    }

    fn receive(&mut self) -> nb::Result<SimpleFrame, Broken> {
        self.1 += 1;
        if self.1 == 3 { Err(nb::Error::Other(Broken)) } else { self.0.receive() }
    }
}

#[test]
fn moves_sent_before_a_bus_error_are_not_reported_as_dropped() {
    let clock = TestClock::default();
    let bus = TestCan::new(&clock);
    let mut arm = CanMaster::<_, _, 4>::new(FailsOnce(bus.clone(), 0), clock, Config::CAN);
    let outcomes = arm.ask_together([1, 2, 3].map(|motor| (id(motor), step())));
    assert_eq!(bus.sent().len(), 3);
    assert!(outcomes.iter().all(Result::is_ok), "{outcomes:?}");
}

/// A bus on which answers to moves are lost.
struct WithoutAnswersToMoves(TestCan);

impl embedded_can::nb::Can for WithoutAnswersToMoves {
    type Frame = SimpleFrame;
    type Error = Broken;

    fn transmit(&mut self, frame: &SimpleFrame) -> nb::Result<Option<SimpleFrame>, Broken> {
        self.0.transmit(frame)
    }

    fn receive(&mut self) -> nb::Result<SimpleFrame, Broken> {
        let frame = self.0.receive()?;
        if frame.data()[0] == 0xA8 { Err(nb::Error::WouldBlock) } else { Ok(frame) }
    }
}

#[test]
fn unanswered_relative_move_is_sent_once() {
    let (bus, _, mut arm) = on_can(|bus, clock, config| {
        CanMaster::<_, _, 4>::new(WithoutAnswersToMoves(bus), clock, config)
    });
    let go_on = |_: &_| ControlFlow::Continue(());
    let moved = bring_up::move_to(&mut arm, id(1), step(), &Default::default(), go_on);
    assert!(moved.is_err_and(|why| why.is_stopped));
    let moves = bus.sent().iter().filter(|data| data[0] == 0xA8).count();
    assert_eq!(moves, 1);
}

#[test]
fn frame_read_after_one_without_an_event_is_not_lost() {
    let (port, clock, mut arm) = used_serial();
    let nothing = Frame { address: Target::All, data: Stop.encode() };
    let report = Frame { address: id(1).into(), data: [0x9A, 50, 30, 1, 0xE5, 0x01, 0, 0] };
    port.hear(&[nothing.encode(), report.encode()].concat());
    assert!(matches!(run(&mut arm, &clock, 1_000)[..], [Event::Report { .. }]));
}

/// It holds since an earlier one, and this one has taken another's place before it was called.
#[test]
fn no_stop_counts_as_confirmed_that_was_not_sent() {
    type Before = fn(&mut CanMaster<TestCan, TestClock, 4>);
    let stories: [Before; 2] = [
        |arm| {
            let _ = arm.master().request(id(1), Stop).unwrap();
            arm.master().broadcast(Shutdown, MotorSet::EMPTY).unwrap();
        },
        |arm| {
            arm.master().broadcast(Shutdown, MotorSet::EMPTY).unwrap();
            arm.master().stop(id(2), StopKind::Hold).unwrap();
        },
    ];
    for story in stories {
        for is_dead in [false, true] {
            let (bus, _, mut arm) = can();
            let both = MotorSet::from([id(1), id(2)]);
            assert!(arm.stop_all(StopKind::Hold, both).is_empty());
            arm.master().lift_stop();
            if is_dead {
                bus.state().full_until = u64::MAX;
            }
            story(&mut arm);
            let before = bus.sent().len();
            let unconfirmed = arm.stop_all(StopKind::Off, MotorSet::EMPTY);
            let off =
                bus.sent()[before..].iter().filter(|data| **data == Shutdown.encode()).count();
            assert_eq!(unconfirmed, if is_dead { both } else { MotorSet::EMPTY });
            assert!(is_dead || off >= 2, "{off}");
        }
    }
}

/// The motor is heard once. It reports something on its own, and may hear nothing.
#[test]
fn stop_on_a_bus_that_takes_nothing_ends_after_a_second_although_a_motor_is_heard() {
    let (bus, _, mut arm) = can();
    arm.ask(id(1), ReadStatus1).unwrap();
    bus.state().full_until = u64::MAX;
    let report = Packet { channel: Channel::Reply(id(1)), data: [0x92, 0, 0, 0, 0xA0, 0x8C, 0, 0] };
    bus.hear_at(arm.now().as_micros() + 500_000, &report);
    let begun = arm.now();
    assert_eq!(arm.stop_all(StopKind::Hold, MotorSet::EMPTY), id(1).into());
    let took = arm.now() - begun;
    assert!(took < LONGEST_STOP + Duration::from_millis(100), "{took:?}");
}
