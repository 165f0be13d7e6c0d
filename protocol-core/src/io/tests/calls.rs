//! What the calls that wait make of answers, and what they do on buses that are not kind.

use core::ops::ControlFlow;
use std::boxed::Box;
use std::string::ToString;
use std::vec::Vec;

use embedded_can::nb;

use super::world::{Broken, TestCan, TestClock, block_on, on_can, on_rs485};
use super::{id, step, torque};
use crate::Data;
use crate::command::{
    AbsolutePosition, ActiveReply, AnyReply, ErrorFlags, ForcePosition, ReadMultiTurnAngle,
    ReadRunTime, ReadStatus1, ReadStatus2, ReadStatus3, ReportedCommand, Reset, Shutdown, Stop,
    Switch, Torque,
};
use crate::error::RequestError;
use crate::firmware::Firmware;
use crate::id::MotorId;
use crate::io::asking::outcome_of_set_point;
use crate::io::bring_up::{
    self, BringUpError, MoveCommand, MoveFailure, MoveLimits, NotArrived, Protection,
};
use crate::io::runner::{LONGEST_STOP, LONGEST_TURN};
use crate::io::{
    AsyncCanMaster, AsyncRunner, AsyncSerialMaster, CallError, CanMaster, Guard, Runner,
    SerialMaster, async_bring_up,
};
use crate::master::{Config, Event, Failure, Master, MotorSet, Patience, StopKind};
use crate::opcode::{LOST_MASTER_BYTE, Opcode};
use crate::packet::{Channel, Packet};
use crate::time::{Duration, Instant};
use crate::units::{Angle, CoarseSpeed, MaxSpeed, MaxTorque, Milliseconds, ReportInterval};
use crate::wire::can::{self, Received, SimpleFrame};

fn arm() -> (TestCan, CanMaster<TestCan, TestClock, 4>) {
    let (bus, _, arm) = on_can(CanMaster::new);
    (bus, arm)
}

/// A bus from which frames come otherwise: once, twice, or not at all.
pub(super) struct Heard(TestCan, Box<dyn FnMut(&Packet) -> usize>, Vec<SimpleFrame>);

impl nb::Can for Heard {
    type Frame = SimpleFrame;
    type Error = Broken;

    fn transmit(&mut self, frame: &SimpleFrame) -> ::nb::Result<Option<SimpleFrame>, Broken> {
        self.0.transmit(frame)
    }

    fn receive(&mut self) -> ::nb::Result<SimpleFrame, Broken> {
        if let Some(frame) = self.2.pop() {
            return Ok(frame);
        }
        let frame = self.0.receive()?;
        if let Received::Packet(packet) = can::decode(&frame) {
            let times = (self.1)(&packet);
            self.2.extend(core::iter::repeat_n(frame, times));
        }
        self.2.pop().ok_or(::nb::Error::WouldBlock)
    }
}

pub(super) fn hearing(
    times: impl FnMut(&Packet) -> usize + 'static,
) -> (TestCan, CanMaster<Heard, TestClock, 4>) {
    let times = Box::new(times);
    let (bus, _, arm) =
        on_can(|bus, clock, config| CanMaster::new(Heard(bus, times, Vec::new()), clock, config));
    (bus, arm)
}

fn is_sent(bus: &TestCan, data: Data) -> bool {
    bus.sent().contains(&data)
}

fn times_sent(bus: &TestCan, data: Data) -> usize {
    bus.sent().iter().filter(|&&sent| sent == data).count()
}

#[test]
fn outcome_of_another_motors_set_point_is_not_that_of_this_one() {
    let master = Master::<4>::new(Config::CAN);
    let outcome = |event| outcome_of_set_point::<Torque, 4>(&master, id(1), &event);
    let data = [0xA1, 50, 100, 0, 0, 0, 7, 0];
    let feedback = Packet { channel: Channel::Reply(id(1)), data };
    let reply = AnyReply::decode(&feedback, Firmware::V4_3).unwrap();
    for motor in [id(1), id(2)] {
        let is_mine = motor == id(1);
        let why = |failure| is_mine.then_some(Err(failure));
        assert_eq!(outcome(Event::SetPointUnanswered { motor }), why(Failure::NoReply));
        let answered = outcome(Event::Feedback { motor, reply });
        assert_eq!(answered.is_some_and(|answer| answer.is_ok()), is_mine);
    }
}

/// The event of the earlier loss was not polled before.
#[test]
fn loss_of_an_earlier_set_point_is_not_that_of_the_one_in_flight() {
    let mut master = Master::<4>::new(Config::CAN);
    for now in [0, 21].map(Instant::from_millis) {
        master.handle_timeout(now);
        master.set_point(id(1), torque(), now).unwrap();
        assert!(master.poll_transmit(now).is_some());
        master.handle_transmitted(now);
    }
    let event = master.poll_event().unwrap();
    assert_eq!(event, Event::SetPointUnanswered { motor: id(1) });
    assert_eq!(outcome_of_set_point::<Torque, 4>(&master, id(1), &event), None);
}

#[test]
fn error_texts_name_the_motor_once() {
    let error = CallError::<Broken>::Failed { motor: id(3), failure: Failure::Stopped };
    assert_eq!(error.to_string(), "motor 3: the motors were stopped first");
    assert_eq!(BringUpError::Call(error).to_string(), error.to_string());
    let why = MoveFailure::Call(error);
    assert_eq!(why.to_string(), error.to_string());
    let text = NotArrived { motor: id(3), why, is_stopped: true }.to_string();
    let expected = "motor 3 has not arrived: the motors were stopped first; it has confirmed the stop, \
                    which stays in force until it is lifted";
    assert_eq!(text, expected);
}

#[test]
fn refused_calls_name_their_motor() {
    let (_, _, mut arm) = on_can(CanMaster::<_, _, 1>::new);
    arm.master().stop(id(1), StopKind::Hold).unwrap();
    let refused =
        [arm.set_point(id(1), torque()), arm.set_point_and_wait(id(1), torque()).map(|_| ())];
    for refused in refused {
        assert_eq!(refused, Err(CallError::refused(id(1))(RequestError::Stopped)));
    }
    let error = arm.ask(id(2), ReadMultiTurnAngle).unwrap_err();
    let why = RequestError::TooManyMotors { capacity: 1 };
    assert_eq!(error, CallError::refused(id(2))(why));
    assert_eq!(error.to_string(), std::format!("motor 2: {why}"));
}

#[test]
fn ask_together_names_each_motor_without_an_answer() {
    let (bus, mut arm) = arm();
    let mut ask = || {
        let asked = [2, 9, 3, 1].map(|motor| (id(motor), ReadMultiTurnAngle));
        arm.ask_together(asked).map(Result::err)
    };
    let failed = |motor, failure| Some(CallError::Failed { motor: id(motor), failure });
    assert_eq!(ask(), [None, failed(9, Failure::NoReply), None, None]);
    bus.state().full_until = u64::MAX;
    assert_eq!(ask(), [2, 9, 3, 1].map(|motor| failed(motor, Failure::BusDown)));
}

#[test]
fn scan_without_a_free_place_is_refused() {
    let (_, _, mut arm) = on_can(CanMaster::<_, _, 1>::new);
    arm.ask(id(1), ReadMultiTurnAngle).unwrap();
    let found = bring_up::scan(&mut arm, id(2).into(), |_, _| {});
    assert_eq!(
        found,
        Err(CallError::Refused {
            motor: id(2),
            refusal: RequestError::TooManyMotors { capacity: 1 }
        })
    );
}

#[test]
fn scan_ended_by_a_bus_error_leaves_no_place_to_absent_motors() {
    let nobody: MotorSet = (9..=20).map(id).collect();
    for fails_in_flight in [false, true] {
        let (bus, mut arm) = arm();
        if fails_in_flight {
            // All places are taken by what a scan has sent when the driver fails.
            let mut reported = 0;
            let scan = bring_up::scan(&mut arm, nobody, |_, _| {
                reported += 1;
                bus.state().receive_fails = true;
            });
            assert_eq!(scan, Err(CallError::Bus(Broken)));
            assert_eq!(reported, 1, "of the others nobody knows");
        } else {
            bus.state().transmit_fails = true;
            let scan = bring_up::scan(&mut arm, nobody, |_, _| panic!("nobody was asked"));
            assert_eq!(scan, Err(CallError::Bus(Broken)));
        }
        bus.state().receive_fails = false;
        bus.state().transmit_fails = false;
        assert_eq!(arm.master().motors(), MotorSet::EMPTY);
        let found = bring_up::scan(&mut arm, nobody.with(id(1).into()), |_, _| {});
        assert_eq!(found, Ok(id(1).into()));
    }
}

/// Motor 9 is asked, and may take eight seconds.
#[test]
fn scan_ended_by_a_bus_error_waits_no_longer_than_for_a_turn() {
    let (bus, _, mut arm) = on_can(|bus, clock, config| {
        let reply_timeout = LONGEST_TURN.times(4);
        CanMaster::<_, _, 4>::new(bus, clock, Config { reply_timeout, ..config })
    });
    let scan = bring_up::scan(&mut arm, [1, 9].map(id).into(), |_, _| {
        bus.state().receive_fails = true;
    });
    assert_eq!(scan, Err(CallError::Bus(Broken)));
    let latest = Instant::ZERO + LONGEST_TURN + Duration::from_millis(100);
    assert!(arm.now() < latest, "{:?}", arm.now());
}

/// The question to another motor fails with the line, too.
#[test]
fn scan_ends_after_a_short_failure_of_the_line() {
    let time_of_scan = |fails_at: u64| {
        let (port, clock, mut arm) = on_rs485(AsyncSerialMaster::<_, _, 4>::new);
        for motor in [1, 2, 3].map(id) {
            block_on(arm.ask(motor, ReadStatus1)).unwrap();
        }
        clock.advance(25_000);
        let begun = clock.micros();
        let failure = begun + fails_at..begun + fails_at + 1_500;
        let scan = async {
            let _ = async_bring_up::scan(&mut arm, id(9).into(), |_, _| {}).await;
        };
        let mut scan = core::pin::pin!(scan);
        block_on(core::future::poll_fn(|context| {
            port.state().write_fails = failure.contains(&clock.micros());
            scan.as_mut().poll(context)
        }));
        clock.micros() - begun
    };
    let undisturbed = time_of_scan(1_000_000);
    for fails_at in (0..20_000).step_by(1_000) {
        let time = time_of_scan(fails_at);
        assert!(time <= undisturbed, "{fails_at} us: {time} us, not {undisturbed} us");
    }
}

/// A loop that does this before each round.
struct Before<R, F>(R, F);

/// A loop whose button is pressed at this time.
fn pressed<R: Runner<8>>(bus: R, at: Instant) -> impl Runner<8, Error = R::Error> {
    let mut at = Some(at);
    Before(bus, move |bus: &mut R| {
        let now = bus.now();
        if at.take_if(|at| *at <= now).is_some() {
            bus.master().stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
        }
    })
}

impl<R: Runner<8>, F: FnMut(&mut R)> Runner<8> for Before<R, F> {
    type Error = R::Error;

    fn master(&mut self) -> &mut Master<8> {
        self.0.master()
    }

    fn now(&self) -> Instant {
        self.0.now()
    }

    fn poll(&mut self) -> Result<Option<Event>, R::Error> {
        (self.1)(&mut self.0);
        self.0.poll()
    }

    fn idle(&mut self, until: Instant) {
        self.0.idle(until);
    }
}

/// That says nothing about the motors. Ids without a motor are soon forgotten: else each stop would wait for them.
#[test]
fn a_search_that_a_stop_ends_returns_that_and_keeps_no_place_without_a_motor() {
    let there: MotorSet = (1..=3).map(id).collect();
    let is_stop = |error: CallError<Broken>| {
        matches!(
            error,
            CallError::Failed { failure: Failure::Stopped | Failure::StopUnconfirmed, .. }
        )
    };
    let mut ended = 0;
    for pressed_after in (0..120_000).step_by(700) {
        let (_, _, arm) = on_can(CanMaster::<_, _, 8>::new);
        let pressed_at = arm.now() + Duration::from_micros(pressed_after);
        let mut arm = pressed(arm, pressed_at);
        match bring_up::scan(&mut arm, MotorSet::ALL, |_, _| {}) {
            Ok(found) => assert_eq!(found, there, "{pressed_after}"),
            Err(error) => {
                assert!(is_stop(error), "{pressed_after}");
                ended += 1;
            }
        }
        assert!(arm.master().motors().without(there).is_empty(), "{pressed_after}");
        assert!(arm.stop_all(StopKind::Hold, MotorSet::EMPTY).is_empty());
        assert_eq!(bring_up::scan(&mut arm, MotorSet::ALL, |_, _| {}), Ok(there));
    }
    assert!(ended > 50, "{ended}");
    for (motor, is_there) in [(1, true), (9, false)] {
        for pressed_after in (0..50_000).step_by(100) {
            let (_, _, arm) = on_can(CanMaster::<_, _, 8>::new);
            let pressed_at = arm.now() + Duration::from_micros(pressed_after);
            let mut arm = pressed(arm, pressed_at);
            match bring_up::is_there(&mut arm, id(motor)) {
                Ok(answer) => assert_eq!(answer, is_there, "{pressed_after}"),
                // A stop of all has to reach it.
                Err(error) => {
                    assert!(is_stop(error), "{pressed_after}");
                    assert_eq!(arm.master().motors().contains(id(motor)), is_there);
                }
            }
            assert!(arm.master().motors().without(there).is_empty(), "{pressed_after}");
        }
    }
}

/// Its stop is sent again and again, and takes the place of the question.
#[test]
fn a_search_that_an_unconfirmed_stop_ends_says_nothing_about_the_motor() {
    let (_, _, mut arm) = on_can(CanMaster::<_, _, 8>::new);
    assert!(!arm.stop(id(9), StopKind::Hold));
    let answers = [(); 50].map(|()| bring_up::is_there(&mut arm, id(9)));
    let failed = Err(CallError::Failed { motor: id(9), failure: Failure::StopUnconfirmed });
    assert!(answers.contains(&failed), "{answers:?}");
    assert!(answers.iter().all(|answer| *answer == Ok(false) || *answer == failed), "{answers:?}");
}

/// It was stopped, and its drive is dead.
#[test]
fn the_wait_for_a_motor_ends_in_time_though_its_stop_is_sent_again() {
    for millis in (100..600).step_by(10) {
        let (_, _, mut arm) = on_can(CanMaster::<_, _, 8>::new);
        assert!(!arm.stop(id(9), StopKind::Hold));
        let (begun, limit) = (arm.now(), Duration::from_millis(millis));
        let gone = bring_up::wait_until_there(&mut arm, id(9), limit);
        assert_eq!(gone, Err(BringUpError::NotThere(id(9))), "{millis}");
        let took = arm.now() - begun;
        assert!(took >= limit && took < limit + Duration::from_millis(150), "{took:?}");
    }
}

#[test]
fn a_search_on_a_bus_that_takes_nothing_ends_although_a_stop_waits() {
    let (bus, _, arm) = on_can(CanMaster::<_, _, 8>::new);
    bus.state().full_until = u64::MAX;
    let begun = arm.now();
    let mut arm = pressed(arm, begun + Duration::from_millis(10));
    assert!(bring_up::is_there(&mut arm, id(1)).is_err());
    let took = arm.now() - begun;
    assert!(took <= LONGEST_TURN + LONGEST_STOP, "{took:?}");
}

/// It is called under a stop, and goes on under another.
#[test]
fn a_stop_does_not_end_the_wait_for_a_motor() {
    for pressed_after in (0..3_000).step_by(50) {
        let (_, _, arm) = on_can(CanMaster::<_, _, 8>::new);
        let pressed_at = arm.now() + Duration::from_micros(pressed_after);
        let mut arm = pressed(arm, pressed_at);
        let limit = Duration::from_millis(500);
        assert_eq!(bring_up::wait_until_there(&mut arm, id(1), limit), Ok(()), "{pressed_after}");
    }
}

/// Somebody leans on it, so that each question gives way to a stop.
#[test]
fn the_wait_for_a_motor_ends_in_time_though_it_is_stopped_again_and_again() {
    let (_, _, arm) = on_can(CanMaster::<_, _, 8>::new);
    let mut arm = Before(arm, |arm: &mut CanMaster<_, _, 8>| {
        arm.master().stop(id(9), StopKind::Off).unwrap();
    });
    let (begun, limit) = (arm.now(), Duration::from_millis(300));
    let gone = bring_up::wait_until_there(&mut arm, id(9), limit);
    assert!(gone.is_err(), "{gone:?}");
    let took = arm.now() - begun;
    assert!(took >= limit && took < limit + LONGEST_TURN, "{took:?}");
}

/// So a stop of all and a guard reach them, if they turn because somebody else moved them.
#[test]
fn motors_found_by_a_scan_keep_places_if_there_is_one_for_each() {
    let there: MotorSet = (1..=3).map(id).collect();
    let (bus, _, mut arm) = on_can(CanMaster::<_, _, 3>::new);
    assert_eq!(bring_up::scan(&mut arm, MotorSet::ALL, |_, _| {}), Ok(there));
    assert_eq!(arm.stop_all(StopKind::Hold, MotorSet::EMPTY), MotorSet::EMPTY);
    assert_eq!(times_sent(&bus, Stop.encode()), 3 * 3, "three answers of each");

    let (bus, _, mut arm) = on_can(CanMaster::<_, _, 2>::new);
    arm.ask(id(2), ReadMultiTurnAngle).unwrap();
    assert_eq!(bring_up::scan(&mut arm, MotorSet::ALL, |_, _| {}), Ok(there));
    assert_eq!(arm.master().motors(), id(2).into());
    assert_eq!(arm.stop_all(StopKind::Hold, MotorSet::EMPTY), MotorSet::EMPTY);
    let stops = times_sent(&bus, Stop.encode());
    assert_eq!(stops, 2, "one of them to all");

    let (bus, _, mut arm) = on_can(CanMaster::<_, _, 4>::new);
    let scan = bring_up::scan(&mut arm, MotorSet::ALL, |motor, _| {
        bus.state().receive_fails = motor == id(3);
    });
    assert_eq!(scan, Err(CallError::Bus(Broken)));
    assert_eq!(arm.master().motors(), there);

    let (_, _, mut arm) = on_can(CanMaster::<_, _, 4>::new);
    let panics = || bring_up::scan(&mut arm, MotorSet::ALL, |motor, _| assert!(motor != id(3)));
    assert!(std::panic::catch_unwind(core::panic::AssertUnwindSafe(panics)).is_err());
    // Ids that are still being asked have the places.
    arm.master().stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert!(arm.master().is_stop_to_all_waiting());
}

#[test]
fn scan_finds_a_motor_that_reports_a_lost_master() {
    let (bus, mut arm) = arm();
    let data = [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0];
    bus.hear(&Packet { channel: Channel::Reply(id(9)), data });
    assert_eq!(bring_up::scan(&mut arm, id(9).into(), |_, _| {}), Ok(id(9).into()));
}

/// The motor answers nothing meanwhile, and this master has switched none of its reports on.
#[test]
fn scan_finds_a_motor_by_an_unexpected_frame() {
    let (bus, mut arm) = arm();
    let data = [0x9C, 25, 0, 0, 0, 0, 0, 0];
    bus.hear_at(5_000, &Packet { channel: Channel::Reply(id(9)), data });
    assert_eq!(bring_up::scan(&mut arm, id(9).into(), |_, _| {}), Ok(id(9).into()));
}

#[test]
fn scan_finds_a_motor_by_its_status_reports_and_reports_it_once() {
    let (bus, mut arm) = arm();
    let command = ReportedCommand::of(Opcode::ReadStatus1).unwrap();
    let interval = ReportInterval::from_raw(1);
    arm.ask(id(1), ActiveReply { command, enable: Switch::On, interval }).unwrap();
    // What it says to that, and nothing more.
    arm.run_until(Instant::from_millis(10), |_| {}).unwrap();
    let mut reported = Vec::new();
    let found =
        bring_up::scan(&mut arm, id(1).into(), |motor, there| reported.push((motor, there)));
    assert_eq!((found, reported), (Ok(id(1).into()), Vec::from([(id(1), true)])));
    assert_eq!(bring_up::is_there(&mut arm, id(1)), Ok(true));
    assert!(!is_sent(&bus, ReadStatus1.encode()), "nobody asks what is reported");
}

/// The time-out is twice as long as a request waits for its turn.
#[test]
fn patience_longer_than_the_longest_turn_is_kept() {
    let (bus, mut arm) = arm();
    let patience = Patience { reply_timeout: LONGEST_TURN + LONGEST_TURN, attempts: 1 };
    let data = [0x9A, 50, 30, 1, 0xE5, 0x01, 0, 0];
    bus.hear_at(3_000_000, &Packet { channel: Channel::Reply(id(2)), data });
    let asked = arm.ask_with(id(9), ReadMultiTurnAngle, Some(patience), |_| {});
    assert_eq!(asked, Err(CallError::Failed { motor: id(9), failure: Failure::NoReply }));
}

#[test]
fn a_motor_is_there_or_is_not() {
    let (bus, mut arm) = arm();
    assert_eq!(bring_up::is_there(&mut arm, id(1)), Ok(true));
    assert_eq!(bring_up::is_there(&mut arm, id(9)), Ok(false));
    assert_eq!(bring_up::restart(&mut arm, id(1), id(1)), Ok(()));
    assert!(is_sent(&bus, Reset.encode()));
    assert!(!arm.master().has_restarted(id(1)), "it was meant to");
    let gone = bring_up::restart(&mut arm, id(1), id(9));
    assert_eq!(gone, Err(BringUpError::NotThere(id(9))));
}

/// Another question to it is under way for longer than that.
#[test]
fn wait_until_a_motor_is_there_ends_in_time_though_it_is_busy() {
    let (_, mut arm) = arm();
    let patience = Patience { reply_timeout: Duration::from_secs(20), attempts: 1 };
    let _read = arm.master().request_with(id(9), ReadRunTime, patience).unwrap();
    let start = arm.now();
    let gone = bring_up::wait_until_there(&mut arm, id(9), Duration::from_millis(50));
    let busy = CallError::refused(id(9))(RequestError::Busy);
    assert_eq!(gone, Err(BringUpError::Call(busy)));
    let took = arm.now() - start;
    assert!(took <= LONGEST_TURN + LONGEST_TURN, "{took:?}");
}

/// A command to all that is over keeps nobody from being asked.
#[test]
fn others_on_a_line_are_spoken_to_though_all_were_told_something_before() {
    let (port, _, mut arm) = on_rs485(SerialMaster::<_, _, 4>::new);
    arm.ask(id(1), ReadMultiTurnAngle).unwrap();
    arm.master().broadcast(ReadMultiTurnAngle, MotorSet::EMPTY).unwrap();
    let told = arm.now() + Duration::from_millis(500);
    arm.run_until(told, |_| {}).unwrap();
    // Motor 3 turns for as long as it is looked at.
    let stands = bring_up::wait_until_stands(&mut arm, id(3), Duration::from_millis(200));
    assert!(matches!(stands, Err(BringUpError::Turns { .. })), "{stands:?}");
    let written = port.written();
    let is_asked = |frame: &&[u8]| frame[1] == 1 && frame[3..11] == ReadRunTime.encode();
    let asked = written.chunks(13).filter(is_asked).count();
    assert!(asked >= 5, "{asked}");
}

/// Each further restart would drop a load.
#[test]
fn restart_that_the_new_id_does_not_answer_is_sent_once() {
    for motor in [1, 9] {
        let (bus, mut arm) = arm();
        let gone = bring_up::restart(&mut arm, id(motor), id(9));
        assert_eq!(gone, Err(BringUpError::NotThere(id(9))));
        let resets = times_sent(&bus, Reset.encode());
        assert_eq!(resets, 1, "motor {motor}");
    }
}

#[test]
fn zero_is_not_kept_if_the_angle_reads_otherwise() {
    // The offset is the one that was stored; the angle is 360 degrees.
    let (bus, mut arm) = arm();
    let zero = bring_up::zero_here(&mut arm, id(1));
    assert!(matches!(zero, Err(BringUpError::ZeroNotKept { .. })), "{zero:?}");
    assert!(is_sent(&bus, Shutdown.encode()), "some keep nothing without that");
}

/// It runs nothing, and its brake is locked: a load turns it, or somebody.
#[test]
fn motor_that_turns_and_runs_nothing_gets_neither_a_zero_nor_another_id() {
    let is_refused = |way: fn(&mut Saying) -> Result<(), BringUpError<Broken>>| {
        let mut saying = saying([[0x9A, 50, 30, 0, 0xE5, 0x01, 0, 0], [0x70, 0, 0, 0, 0, 0, 0, 0]]);
        let speed = CoarseSpeed::from_raw(500);
        assert_eq!(way(&mut saying), Err(BringUpError::Turns { motor: id(3), speed }));
        assert!(!is_sent(&saying.0, Shutdown.encode()));
    };
    is_refused(|(_, arm)| bring_up::zero_here(arm, id(3)).map(drop));
    is_refused(|(_, arm)| bring_up::change_id(arm, id(3), id(5)));
}

/// A bus on which something else is said.
pub(super) struct Says(TestCan, Box<dyn FnMut(&mut Data)>);

impl Says {
    pub(super) fn new(bus: TestCan, change: impl FnMut(&mut Data) + 'static) -> Self {
        Self(bus, Box::new(change))
    }
}

impl nb::Can for Says {
    type Frame = SimpleFrame;
    type Error = Broken;

    fn transmit(&mut self, frame: &SimpleFrame) -> ::nb::Result<Option<SimpleFrame>, Broken> {
        self.0.transmit(frame)
    }

    fn receive(&mut self) -> ::nb::Result<SimpleFrame, Broken> {
        let frame = self.0.receive()?;
        let Received::Packet(mut packet) = can::decode(&frame) else { return Ok(frame) };
        (self.1)(&mut packet.data);
        Ok(SimpleFrame::from_packet(&packet))
    }
}

pub(super) type Saying = (TestCan, CanMaster<Says, TestClock, 4>);

/// What is heard is changed so.
pub(super) fn says(change: impl FnMut(&mut Data) + 'static) -> Saying {
    let (bus, _, arm) =
        on_can(|bus, clock, config| CanMaster::new(Says::new(bus, change), clock, config));
    (bus, arm)
}

/// This is said instead of other answers to the same command.
fn saying<const M: usize>(said: [Data; M]) -> Saying {
    says(move |heard| {
        if let Some(data) = said.into_iter().find(|data| data[0] == heard[0]) {
            *heard = data;
        }
    })
}

/// A bus on which each drive has lost its master, says so before every answer, and sends the question back.
struct Ignores(TestCan, Option<SimpleFrame>);

impl nb::Can for Ignores {
    type Frame = SimpleFrame;
    type Error = Broken;

    fn transmit(&mut self, frame: &SimpleFrame) -> ::nb::Result<Option<SimpleFrame>, Broken> {
        self.0.transmit(frame)
    }

    fn receive(&mut self) -> ::nb::Result<SimpleFrame, Broken> {
        if let Some(echo) = self.1.take() {
            return Ok(echo);
        }
        let frame = self.0.receive()?;
        let Received::Packet(packet) = can::decode(&frame) else { return Ok(frame) };
        let saying = |data| SimpleFrame::from_packet(&Packet { data, ..packet });
        self.1 = Some(saying(ReadStatus1.encode()));
        Ok(saying([LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0]))
    }
}

#[test]
fn motor_that_answers_and_executes_nothing_is_found() {
    let (_, _, mut arm): (_, _, CanMaster<_, _, 4>) =
        on_can(|bus, clock, config| CanMaster::new(Ignores(bus, None), clock, config));
    let asked = arm.ask(id(1), ReadStatus1);
    assert_eq!(asked, Err(CallError::Failed { motor: id(1), failure: Failure::NotExecuted }));
    assert_eq!(bring_up::is_there(&mut arm, id(1)), Ok(true));
    assert_eq!(bring_up::scan(&mut arm, id(1).into(), |_, _| {}), Ok(id(1).into()));
}

/// The drive had run for 3 s, and reports 3 s again 2 s after the reset: without a restart it would be 5 s. Its clock
/// need not agree with ours.
#[test]
fn restart_of_a_drive_with_a_fast_clock_is_recognised() {
    let (bus, mut arm) = saying([[0xB1, 0, 0, 0, 0xB8, 0x0B, 0, 0]]);
    assert_eq!(bring_up::restart(&mut arm, id(1), id(1)), Ok(()));
    let resets = times_sent(&bus, Reset.encode());
    assert_eq!(resets, 1);
}

#[test]
fn zero_is_kept_if_the_angle_is_0_and_the_offset_the_stored_one() {
    let angle = [0x92, 0, 0, 0, 0, 0, 0, 0];
    let (_, mut arm) = saying([angle]);
    assert!(bring_up::zero_here(&mut arm, id(1)).is_ok());
    let (_, mut arm) = saying([angle, [0x62, 0, 0, 0, 1, 0, 0, 0]]);
    let zero = bring_up::zero_here(&mut arm, id(1));
    assert!(matches!(zero, Err(BringUpError::ZeroNotKept { .. })), "{zero:?}");
}

#[test]
fn zero_may_be_written_only_after_an_answered_shutdown() {
    let (_, mut arm) = hearing(|packet| usize::from(packet.data[0] != 0x64));
    let why = CallError::Failed { motor: id(1), failure: Failure::NoReply };
    let outcome = bring_up::zero_here(&mut arm, id(1));
    assert_eq!(outcome, Err(BringUpError::MayBeWritten { motor: id(1), why }));
    // Without an answer to the shutdown before it nothing is written.
    let (bus, mut arm) = hearing(|packet| usize::from(packet.data[0] != 0x80));
    let outcome = bring_up::zero_here(&mut arm, id(1));
    assert_eq!(outcome, Err(BringUpError::Call(why)));
    assert!(bus.sent().iter().all(|data| data[0] != 0x64));
}

#[test]
fn a_motor_with_an_error_is_not_moved() {
    let (bus, mut arm) = saying([[0x9A, 50, 30, 1, 0xE5, 0x01, 2, 0]]);
    let target = AbsolutePosition { max_speed: MaxSpeed::from_raw(100), angle: Angle::from_raw(0) };
    let go_on = |_: &_| ControlFlow::Continue(());
    let moved = bring_up::move_to(&mut arm, id(1), target, &MoveLimits::default(), go_on);
    assert!(matches!(moved.expect_err("a fault").why, MoveFailure::Fault(_)));
    assert!(!is_sent(&bus, target.encode()));
}

#[test]
fn known_motor_keeps_its_place_though_it_is_absent() {
    let (_, mut arm) = arm();
    arm.ask(id(9), ReadMultiTurnAngle).unwrap_err();
    assert_eq!(bring_up::is_there(&mut arm, id(9)), Ok(false));
    assert_eq!(bring_up::scan(&mut arm, id(9).into(), |_, _| {}), Ok(MotorSet::EMPTY));
    assert_eq!(arm.master().motors(), id(9).into());
}

#[test]
fn a_protection_that_is_answered_with_another_time_is_acknowledged_only() {
    let (_, mut arm) = arm();
    let protection = bring_up::protect(&mut arm, id(1), Milliseconds::from_raw(100));
    assert!(matches!(protection, Ok(Protection::AcknowledgedOnly(_))), "{protection:?}");
}

#[test]
fn two_motors_that_differ_in_any_one_answer_share_an_id() {
    // A second answer with errors and voltage (0x9A) is taken for an error report.
    for command in [
        ReadStatus2.encode(),
        ReadRunTime.encode(),
        ReadStatus3.encode(),
        ReadMultiTurnAngle.encode(),
    ] {
        let (_, mut arm) = hearing(move |packet| 1 + usize::from(packet.data[0] == command[0]));
        assert_eq!(bring_up::is_shared(&mut arm, id(1)), Ok(true), "{:#04x}", command[0]);
    }
}

#[test]
fn frames_of_others_and_error_reports_are_no_second_answers() {
    let status = [0x9A, 50, 30, 1, 0xE5, 0x01, 0, 0];
    let angle = [0x92, 0, 0, 0, 0xA0, 0x8C, 0, 0];
    let feedback = [0x9C, 50, 100, 0, 0, 0, 45, 0];
    for (motor, data) in [(1, status), (2, status), (2, angle), (9, feedback)] {
        let (bus, mut arm) = arm();
        // Motor 2 has a place, too.
        arm.ask(id(2), ReadRunTime).unwrap();
        let start = arm.now();
        // The first question is answered after 0.8 ms, and heard out until 25.8 ms.
        let said = Packet { channel: Channel::Reply(id(motor)), data };
        bus.hear_at(start.as_micros() + 100, &said);
        assert_eq!(bring_up::is_shared(&mut arm, id(1)), Ok(false), "{motor}: {:#04x}", data[0]);
    }
}

#[test]
fn id_change_that_no_motor_took_restarts_none() {
    // The answers of these drives to function 5 are none.
    let (bus, mut arm) = arm();
    let changed = bring_up::change_id(&mut arm, id(1), id(5));
    let refused = BringUpError::IdNotTaken { from: id(1), to: id(5), is_alone: false };
    assert_eq!(changed, Err(refused));
    assert!(is_sent(&bus, Shutdown.encode()), "some keep nothing without that");
    assert!(!is_sent(&bus, Reset.encode()));

    // Alone on the bus it is given its id by 0x79, too.
    let (bus, mut arm) = hearing(|packet| usize::from(packet.channel == Channel::Reply(id(1))));
    let changed = bring_up::change_id(&mut arm, id(1), id(5));
    let refused = BringUpError::IdNotTaken { from: id(1), to: id(5), is_alone: true };
    assert_eq!(changed, Err(refused));
    assert!(bus.sent().iter().any(|data| data[0] == 0x79));
    assert!(!is_sent(&bus, Reset.encode()));
}

/// The last place is enough to ask who is there, but not to speak to the motor under both ids.
#[test]
fn without_places_for_both_ids_nothing_is_written() {
    let (bus, mut arm) = arm();
    // Each takes a place, whoever answers.
    for other in [2, 3, 4] {
        let _answer = arm.ask(id(other), ReadRunTime);
    }
    let changed = bring_up::change_id(&mut arm, id(1), id(5));
    let refused = CallError::refused(id(5))(RequestError::TooManyMotors { capacity: 4 });
    assert_eq!(changed, Err(BringUpError::Call(refused)));
    assert!(bus.sent().iter().all(|data| matches!(data[0], 0x9A | 0xB1)));
    // Not even for the question who is there: the id that has no place is the new one, and no other that is asked.
    arm.ask(id(1), ReadRunTime).unwrap();
    let changed = bring_up::change_id(&mut arm, id(1), id(9));
    let refused = CallError::refused(id(9))(RequestError::TooManyMotors { capacity: 4 });
    assert_eq!(changed, Err(BringUpError::Call(refused)));
    // The motor is stopped: that comes first.
    arm.master().stop(id(1), StopKind::Hold).unwrap();
    let changed = bring_up::change_id(&mut arm, id(1), id(9));
    let refused = CallError::refused(id(1))(RequestError::Stopped);
    assert_eq!(changed, Err(BringUpError::Call(refused)));
}

/// A bus on which this motor hands function 5 back, so often.
struct Acknowledges(TestCan, MotorId, usize);

impl nb::Can for Acknowledges {
    type Frame = SimpleFrame;
    type Error = Broken;

    fn transmit(&mut self, frame: &SimpleFrame) -> ::nb::Result<Option<SimpleFrame>, Broken> {
        if let Received::Packet(Packet { data: data @ [0x20, ..], .. }) = can::decode(frame) {
            for _ in 0..self.2 {
                self.0.hear(&Packet { channel: Channel::Reply(self.1), data });
            }
        }
        self.0.transmit(frame)
    }

    fn receive(&mut self) -> ::nb::Result<SimpleFrame, Broken> {
        self.0.receive()
    }
}

#[test]
fn an_id_is_acknowledged_under_the_old_one_or_the_new_one() {
    // What comes twice is as good as what comes once.
    for (motor, times, is_taken) in [(1, 1, true), (1, 2, true), (5, 1, true), (2, 1, false)] {
        let (bus, _, mut arm) = on_can(|bus, clock, config| {
            CanMaster::<_, _, 4>::new(Acknowledges(bus, id(motor), times), clock, config)
        });
        let changed = bring_up::change_id(&mut arm, id(1), id(5));
        // It is restarted, after which nobody is there with the new one.
        assert!(changed.is_err());
        assert_eq!(is_sent(&bus, Reset.encode()), is_taken, "by motor {motor}: {changed:?}");
    }
}

/// A bus on which motor 1 becomes motor 5 by function 5, at once and without a word.
struct Renames(TestCan, bool);

impl nb::Can for Renames {
    type Frame = SimpleFrame;
    type Error = Broken;

    fn transmit(&mut self, frame: &SimpleFrame) -> ::nb::Result<Option<SimpleFrame>, Broken> {
        let Received::Packet(mut packet) = can::decode(frame) else { panic!("{frame:?}") };
        if packet.data[0] == 0x20 {
            self.1 = true;
            return Ok(None);
        }
        let to = |motor| Channel::Command(id(motor).into());
        packet.channel = match packet.channel {
            channel if self.1 && channel == to(1) => to(9),
            channel if self.1 && channel == to(5) => to(1),
            channel => channel,
        };
        self.0.transmit(&SimpleFrame::from_packet(&packet))
    }

    fn receive(&mut self) -> ::nb::Result<SimpleFrame, Broken> {
        let frame = self.0.receive()?;
        let Received::Packet(mut packet) = can::decode(&frame) else { return Ok(frame) };
        if self.1 && packet.channel == Channel::Reply(id(1)) {
            packet.channel = Channel::Reply(id(5));
        }
        Ok(SimpleFrame::from_packet(&packet))
    }
}

/// The motor is not alone on the bus, so that nothing but function 5 could give it its id.
#[test]
fn motor_that_answers_under_its_new_id_has_taken_it() {
    let (bus, _, mut arm) =
        on_can(|bus, clock, config| CanMaster::<_, _, 4>::new(Renames(bus, false), clock, config));
    assert_eq!(bring_up::change_id(&mut arm, id(1), id(5)), Ok(()));
    assert!(!is_sent(&bus, Reset.encode()), "it answers without that");
}

#[test]
fn motor_that_turns_at_its_target_and_runs_nothing_has_not_arrived() {
    // Motor 3 is at 360 degrees, turns at 500 dps and runs nothing, says every answer; it has run for a minute.
    let (bus, mut arm) = saying([[0xB1, 0, 0, 0, 0x60, 0xEA, 0, 0]]);
    let (max_speed, angle) = (MaxSpeed::from_raw(100), Angle::from_raw(36_000));
    let go_on = |_: &_| ControlFlow::Continue(());
    let target = AbsolutePosition { max_speed, angle };
    let moved = bring_up::move_to(&mut arm, id(3), target, &MoveLimits::default(), go_on);
    let why = moved.expect_err("it turns").why;
    assert_eq!(why, MoveFailure::LetGo { at: angle });
    // It was looked at for a second, every 20 ms, and at its errors with every fifth look.
    let count = |byte| bus.sent().iter().filter(|data| data[0] == byte).count();
    let (looks, of_errors) = (count(0x92), count(0x9A));
    assert!((50..=54).contains(&looks), "{looks}");
    assert!((11..=13).contains(&of_errors), "{of_errors}");
}

/// The motor that runs nothing comes no nearer for a second, and has an error with one of its last answers.
#[test]
fn stalled_move_of_a_motor_with_an_error_fails_with_that_error() {
    // From its answer of this number to where it is on.
    for answer in 48..=53 {
        let mut answers = 0;
        let (_, mut arm) = says(move |data| match data {
            [0x92, ..] => answers += 1,
            [0xB1, ..] => *data = [0xB1, 0, 0, 0, 0x60, 0xEA, 0, 0],
            // Stalled (2.14.3).
            [0x9A, ..] if answers >= answer => data[6] = 0x02,
            _ => {}
        });
        let (max_speed, angle) = (MaxSpeed::from_raw(100), Angle::from_raw(0));
        let target = AbsolutePosition { max_speed, angle };
        let go_on = |_: &_| ControlFlow::Continue(());
        let moved = bring_up::move_to(&mut arm, id(3), target, &MoveLimits::default(), go_on);
        let why = moved.expect_err("it does not move").why;
        assert_eq!(why, MoveFailure::Fault(ErrorFlags::STALL), "{answer}");
    }
}

/// The motor turns at 500 dps, and within 20 ms its angle is 5,000 degrees further: its turns were lost. No answer is
/// missing, and its run time is not asked.
#[test]
fn angle_jump_between_two_looks_at_a_move_is_a_restart() {
    for jumps_at in [2, 3, 20] {
        let mut looks = 0;
        let (bus, mut arm) = says(move |data| {
            if data[0] == 0x92 {
                looks += 1;
                // 5,360 degrees.
                if looks >= jumps_at {
                    *data = [0x92, 0, 0, 0, 0xC0, 0x2D, 0x08, 0];
                }
            }
        });
        let (max_speed, angle) = (MaxSpeed::from_raw(100), Angle::from_raw(0));
        let target = AbsolutePosition { max_speed, angle };
        let go_on = |_: &_| ControlFlow::Continue(());
        let moved = bring_up::move_to(&mut arm, id(3), target, &MoveLimits::default(), go_on);
        let restarted = CallError::refused(id(3))(RequestError::Restarted);
        assert_eq!(moved.map_err(|it| it.why), Err(restarted.into()), "{jumps_at}");
        assert_eq!(times_sent(&bus, ReadRunTime.encode()), 1, "before it began");
    }
}

/// Such a move may be obeyed twice. The drive does not report what it runs, either: that is not taken for nothing.
#[test]
fn unanswered_move_to_an_absolute_angle_is_sent_again() {
    let mut lost = 0;
    let (bus, mut arm) = hearing(move |packet| {
        let is_lost = packet.data[0] == 0xA4 && lost < 2;
        lost += u8::from(is_lost);
        usize::from(!is_lost && packet.data[0] != 0x70)
    });
    let (max_speed, angle) = (MaxSpeed::from_raw(100), Angle::from_raw(36_000));
    let target = AbsolutePosition { max_speed, angle };
    let go_on = |_: &_| ControlFlow::Continue(());
    let moved = bring_up::move_to(&mut arm, id(1), target, &MoveLimits::default(), go_on);
    assert!(moved.is_ok(), "{moved:?}");
    assert_eq!(times_sent(&bus, target.encode()), 3);
}

/// The motor runs nothing, and the sixth look is the last. Its answers are that before the move and one with each look.
#[test]
fn move_out_of_time_fails_with_the_error_or_mode_of_its_drive() {
    for (answer, is_fault) in [(8, true), (9, false)] {
        let mut answers = 0;
        let (_, mut arm) = says(move |data| match data {
            [0x92, ..] => answers += 1,
            [0xB1, ..] => *data = [0xB1, 0, 0, 0, 0x60, 0xEA, 0, 0],
            [0x9A, ..] if answers >= answer => data[6] = 0x02,
            [0x70, ..] => *data = [0x70, 0, 0, 0, 0, 0, 0, 0],
            _ => {}
        });
        let (max_speed, angle) = (MaxSpeed::from_raw(100), Angle::from_raw(0));
        let target = AbsolutePosition { max_speed, angle };
        let limits = MoveLimits { time: Some(Duration::from_millis(110)), ..MoveLimits::default() };
        let go_on = |_: &_| ControlFlow::Continue(());
        let moved = bring_up::move_to(&mut arm, id(3), target, &limits, go_on);
        let why = moved.expect_err("it does not move").why;
        let here = MoveFailure::LetGo { at: Angle::from_raw(36_000) };
        let fault = MoveFailure::Fault(ErrorFlags::STALL);
        assert_eq!(why, if is_fault { fault } else { here }, "{answer}");
    }
}

#[test]
fn a_move_with_limited_force_ends_at_its_angle() {
    let angle = Angle::from_raw(-4_500);
    let (max_torque, max_speed) = (MaxTorque::from_raw(100), MaxSpeed::from_raw(100));
    let command = ForcePosition { max_torque, max_speed, angle };
    assert_eq!(command.target(Angle::from_raw(9_000)), Some(angle));
}

#[test]
fn move_with_a_torque_limit_of_zero_is_not_sent() {
    let (bus, mut arm) = arm();
    let (max_torque, max_speed) = (MaxTorque::NO_LIMIT, MaxSpeed::from_raw(100));
    let grip = ForcePosition { max_torque, max_speed, angle: Angle::from_raw(0) };
    let go_on = |_: &_| ControlFlow::Continue(());
    let refused = bring_up::move_to(&mut arm, id(1), grip, &MoveLimits::default(), go_on);
    assert_eq!(refused.map_err(|it| it.why), Err(MoveFailure::NoTorque));
    // It is stopped as after any failure, and hears nothing else.
    assert!(bus.sent().iter().all(|data| data[0] == 0x81), "{:x?}", bus.sent());
}

#[test]
fn finished_guard_returns_the_unconfirmed_motors() {
    let (_, mut arm) = arm();
    let mut bus = Guard::new(&mut arm, StopKind::Off);
    bus.ask(id(1), ReadMultiTurnAngle).unwrap();
    bus.set_point(id(9), torque()).unwrap();
    assert_eq!(bus.finish(), id(9).into());
}

/// A controller with one mailbox: what lies in it makes way for what comes next, once.
struct OneMailbox(TestCan, Option<SimpleFrame>, bool);

impl nb::Can for OneMailbox {
    type Frame = SimpleFrame;
    type Error = Broken;

    fn transmit(&mut self, frame: &SimpleFrame) -> ::nb::Result<Option<SimpleFrame>, Broken> {
        if !self.2 && self.1.is_none() {
            self.1 = Some(*frame);
            return Ok(None);
        }
        self.2 = true;
        self.0.transmit(frame)?;
        Ok(self.1.take())
    }

    fn receive(&mut self) -> ::nb::Result<SimpleFrame, Broken> {
        self.0.receive()
    }
}

#[test]
fn frame_handed_back_by_the_controller_is_sent_again() {
    let (bus, _, mut arm) = on_can(|bus, clock, config| {
        CanMaster::<_, _, 4>::new(OneMailbox(bus, None, false), clock, config)
    });
    let moved = arm.ask_together([1, 2].map(|motor| (id(motor), step())));
    assert!(moved.iter().all(|outcome| outcome.is_ok()), "{moved:?}");
    let moves = times_sent(&bus, step().encode());
    assert_eq!(moves, 2, "each once");
    assert_eq!(arm.master().motors(), [1, 2].map(id).into_iter().collect::<MotorSet>());
}

/// Three motors report on their own, and the loop comes too late each time.
#[test]
fn late_call_reports_all_received_frames_and_still_sends() {
    let data = [0x9C, 25, 0, 0, 0, 0, 0, 0];
    let report = |motor| Packet { channel: Channel::Reply(id(motor)), data };

    let (bus, _, mut arm) = on_can(CanMaster::<_, _, 4>::new);
    [2, 3, 4].into_iter().for_each(|motor| bus.hear(&report(motor)));
    arm.set_point(id(1), torque()).unwrap();
    let mut reported = 0;
    arm.run_until(Instant::ZERO, |_| reported += 1).unwrap();
    assert_eq!((reported, bus.sent()), (3, Vec::from([torque().encode()])));

    let (bus, _, mut arm) = on_can(AsyncCanMaster::<_, _, 4>::new);
    [2, 3, 4].into_iter().for_each(|motor| bus.hear(&report(motor)));
    arm.set_point(id(1), torque()).unwrap();
    block_on(arm.run_until(Instant::ZERO, |_| reported += 1)).unwrap();
    assert_eq!((reported, bus.sent()), (6, Vec::from([torque().encode()])));
}
