//! Watched moves: what ends them, in both kinds of loop, and through a handle to one.

use core::ops::ControlFlow;
use std::string::ToString as _;
use std::vec::Vec;

use embedded_can::{Frame as _, nb};

use super::calls::{Says, hearing, says};
use super::world::{Broken, TestCan, TestClock, awaited, block_on, on_can, pending};
use super::{id, step};
use crate::Data;
use crate::command::{AbsolutePosition, BrakeCommand, Command, ErrorFlags};
use crate::error::RequestError;
use crate::id::MotorId;
use crate::io::async_bring_up::{Calls, is_there, move_to, wait_until_stands};
use crate::io::bring_up::{self, BringUpError, MoveFailure, MoveLimits, MoveProgress, WhenStalled};
use crate::io::{AsyncCanMaster, CallError, CanMaster, Runner};
use crate::master::{Failure, StopKind};
use crate::time::{Duration, Instant};
use crate::units::{Angle, CoarseSpeed, MaxSpeed};
use crate::wire::can::SimpleFrame;

awaited! { [] Says }

fn go_on(_: &MoveProgress) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// A motor with an error holds nothing where it is; its brake may.
#[test]
fn motor_with_an_error_at_its_target_has_not_arrived_and_its_brake_is_locked() {
    let command =
        AbsolutePosition { max_speed: MaxSpeed::from_raw(360), angle: Angle::from_raw(36_000) };
    let limits = MoveLimits::default();
    // With the first look and every fifth errors are looked at in any case.
    for looks in 0_u8..=5 {
        // One angle and one status are read before the move is sent.
        let (mut short, mut well) = (1 + looks, 1 + looks.div_ceil(5));
        let is_one_more = |left: &mut u8| core::mem::replace(left, left.saturating_sub(1)) > 0;
        let says_so = move |data: &mut Data| match data[0] {
            0x92 if is_one_more(&mut short) => data[5] -= 4,
            0x9A if !is_one_more(&mut well) => data[6] = 0x04,
            _ => {}
        };
        let (bus, mut arm) = says(says_so);
        let polled = bring_up::move_to(&mut arm, id(1), command, &limits, go_on);
        let (_, _, mut arm) = on_can(|bus, clock, config| {
            AsyncCanMaster::<_, _, 4>::new(Says::new(bus, says_so), clock, config)
        });
        let awaited = block_on(move_to(&mut arm, id(1), command, &limits, go_on));
        let sent = bus.sent().into_iter().map(|data| data[0]).collect::<Vec<_>>();
        assert!(sent.ends_with(&[0x81, 0x78]), "{sent:02X?}");
        for moved in [polled, awaited] {
            let why = moved.map_err(|it| (it.why, it.is_stopped));
            let fault = MoveFailure::Fault(ErrorFlags::UNDER_VOLTAGE);
            assert_eq!(why, Err((fault, true)), "after {looks} looks");
        }
    }
}

/// It has no error, and was switched off on the way: by its communication-loss protection, or by another caller.
#[test]
fn motor_that_runs_nothing_at_its_target_has_not_arrived() {
    let command =
        AbsolutePosition { max_speed: MaxSpeed::from_raw(360), angle: Angle::from_raw(36_000) };
    for (mode, let_go) in [(0, true), (3, false)] {
        let (_, mut arm) = says(move |data| match data[0] {
            0xB1 => *data = [0xB1, 0, 0, 0, 0x60, 0xEA, 0, 0],
            0x70 => *data = [0x70, 0, 0, 0, 0, 0, 0, mode],
            _ => {}
        });
        let moved = bring_up::move_to(&mut arm, id(1), command, &MoveLimits::default(), go_on);
        let here = MoveFailure::LetGo { at: Angle::from_raw(36_000) };
        assert_eq!(moved.map(drop).map_err(|it| it.why), if let_go { Err(here) } else { Ok(()) });
    }
}

/// It may have been held from the start, and its angle flicker.
#[test]
fn motor_that_came_nearer_by_no_more_than_the_tolerance_has_met_nothing() {
    let command =
        AbsolutePosition { max_speed: MaxSpeed::from_raw(360), angle: Angle::from_raw(0) };
    let limits = MoveLimits { when_stalled: WhenStalled::Press, ..MoveLimits::default() };
    let tolerance = limits.tolerance.raw();
    for (nearer, has_met) in [(tolerance, false), (tolerance + 1, true)] {
        let mut is_first = true;
        let (_, mut arm) = says(move |data| match data[0] {
            0x92 if core::mem::take(&mut is_first) => {}
            0x92 => data[4..].copy_from_slice(&(36_000 - nearer).to_le_bytes()),
            0xB1 => *data = [0xB1, 0, 0, 0, 0x60, 0xEA, 0, 0],
            0x70 => data[7] = 3,
            _ => {}
        });
        let moved = bring_up::move_to(&mut arm, id(1), command, &limits, go_on);
        match moved.map_err(|it| it.why) {
            Ok(_) => assert!(has_met, "{nearer}"),
            Err(why) => assert!(!has_met && matches!(why, MoveFailure::Stalled { .. }), "{why:?}"),
        }
    }
}

/// The release may be obeyed and its answer lost: the brake would open, and nothing hold behind it.
#[test]
fn unanswered_brake_release_is_followed_by_holds_each_time() {
    let (bus, mut arm) = hearing(|packet| usize::from(packet.data[0] != 0x77));
    let outcome = bring_up::release_brake(&mut arm, id(1));
    let (motor, failure) = (id(1), Failure::NoReply);
    assert_eq!(outcome, Err(CallError::Failed { motor, failure }.into()));
    let sent = bus.sent().into_iter().map(|data| data[0]).filter(|byte| *byte < 0x90);
    // Once more, when what was not answered must have come.
    let each = [0x77, 0x81, 0x81];
    let expected = [&[each; 3].concat()[..], &[0x81]].concat();
    assert_eq!(sent.collect::<Vec<_>>(), expected);
    assert!(arm.master().is_stopped(id(1)));
    // Where it is refused, nothing is sent.
    assert!(bring_up::release_brake(&mut arm, id(1)).is_err());
    assert!(!bus.sent()[..].ends_with(&[[0x77, 0, 0, 0, 0, 0, 0, 0]]));
}

/// A bus that fails when this command is sent.
struct FailsAt<B> {
    bus: B,
    command: u8,
    then: Fails,
    now: Fails,
}

impl<B> FailsAt<B> {
    fn new(bus: B, command: u8, then: Fails) -> Self {
        Self { bus, command, then, now: Fails::Never }
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Fails {
    Never,
    /// The command is refused.
    Refused,
    /// The command is carried, and the next look at the bus fails.
    NextLook,
    /// The command is carried, and every look at the bus fails from then on.
    EachLook,
}

impl<B: nb::Can<Frame = SimpleFrame, Error = Broken>> nb::Can for FailsAt<B> {
    type Frame = SimpleFrame;
    type Error = Broken;

    fn transmit(&mut self, frame: &SimpleFrame) -> ::nb::Result<Option<SimpleFrame>, Broken> {
        if frame.data()[0] == self.command && self.then != Fails::Never {
            self.now = core::mem::replace(&mut self.then, Fails::Never);
            if self.now == Fails::Refused {
                return Err(::nb::Error::Other(Broken));
            }
        }
        self.bus.transmit(frame)
    }

    fn receive(&mut self) -> ::nb::Result<SimpleFrame, Broken> {
        match self.now {
            Fails::Never | Fails::Refused => return self.bus.receive(),
            Fails::NextLook => self.now = Fails::Never,
            Fails::EachLook => {}
        }
        Err(::nb::Error::Other(Broken))
    }
}

/// What a bus has carried that has failed is not known: the motor is told to hold, before anything returns.
#[test]
fn brake_release_on_a_bus_that_fails_is_followed_by_a_hold() {
    for (fails, expected) in [
        (Fails::Refused, &[0x81, 0x77, 0x81][..]),
        (Fails::NextLook, &[0x77, 0x81]),
        (Fails::EachLook, &[0x77, 0x81]),
    ] {
        let (bus, _, mut arm) = on_can(|bus, clock, config| {
            CanMaster::<_, _, 4>::new(FailsAt::new(bus, 0x77, fails), clock, config)
        });
        let outcome = bring_up::release_brake(&mut arm, id(1));
        let sent = bus.sent().into_iter().map(|data| data[0]).filter(|byte| *byte < 0x90);
        let sent = sent.collect::<Vec<_>>();
        assert!(sent.starts_with(expected), "{sent:02X?}");
        let is_held = fails != Fails::EachLook;
        assert_eq!(outcome, if is_held { Ok(()) } else { Err(CallError::Bus(Broken).into()) });
        assert_eq!(arm.master().is_stopped(id(1)), !is_held);
    }
}

/// Only the brake can hold then.
#[test]
fn error_while_a_brake_opens_gets_it_locked_at_once() {
    let mut left = 4;
    let (bus, mut arm) = says(move |data| {
        if data[0] == 0x9A {
            left -= i32::from(left > 0);
            data[6] = if left > 0 { 0 } else { 0x04 };
        }
    });
    let (motor, errors) = (id(1), ErrorFlags::UNDER_VOLTAGE);
    assert_eq!(
        bring_up::release_brake(&mut arm, motor),
        Err(BringUpError::Fault { motor, errors })
    );
    assert_eq!(bus.sent().last().map(|data| data[0]), Some(0x78));
    assert!(arm.now() < Instant::from_millis(100), "at once: its load falls");
}

/// The same, and the bus refuses that once.
#[test]
fn brake_is_locked_although_the_bus_fails_once() {
    for errors_from in [1, 4] {
        let mut looks = 0;
        let says = move |data: &mut Data| {
            if data[0] == 0x9A {
                looks += 1;
                data[3] = 1;
                data[6] = if looks >= errors_from { 0x04 } else { 0 };
            }
        };
        let (bus, _, mut arm) = on_can(|bus, clock, config| {
            let bus = FailsAt::new(Says::new(bus, says), 0x78, Fails::Refused);
            CanMaster::<_, _, 4>::new(bus, clock, config)
        });
        let failed = bring_up::release_brake(&mut arm, id(1));
        assert!(matches!(failed, Err(BringUpError::Fault { .. })), "{failed:?}");
        assert_eq!(bus.sent().last().map(|data| data[0]), Some(0x78), "{errors_from}");
    }
}

#[test]
fn brake_of_a_moved_motor_is_locked_although_the_bus_fails_once() {
    let mut looks = 0;
    let says = move |data: &mut Data| {
        if data[0] == 0x9A {
            looks += 1;
            data[6] = if looks > 1 { 0x04 } else { 0 };
        }
    };
    let (bus, _, mut arm) = on_can(|bus, clock, config| {
        let bus = FailsAt::new(Says::new(bus, says), 0x78, Fails::Refused);
        CanMaster::<_, _, 4>::new(bus, clock, config)
    });
    let command =
        AbsolutePosition { max_speed: MaxSpeed::from_raw(360), angle: Angle::from_raw(36_000) };
    let failed = bring_up::move_to(&mut arm, id(1), command, &MoveLimits::default(), go_on);
    let why = failed.map_err(|it| it.why);
    assert_eq!(why, Err(MoveFailure::Fault(ErrorFlags::UNDER_VOLTAGE)));
    assert_eq!(bus.sent().last().map(|data| data[0]), Some(0x78));
}

/// The error comes before the release: an open brake is locked, and a locked one left as it is.
#[test]
fn release_for_a_motor_with_an_error_locks_an_open_brake() {
    for (brake, locks) in [(0, 0), (1, 1)] {
        let (bus, mut arm) = says(move |data| {
            if data[0] == 0x9A {
                (data[3], data[6]) = (brake, 0x04);
            }
        });
        let (motor, errors) = (id(1), ErrorFlags::UNDER_VOLTAGE);
        let refused = bring_up::release_brake(&mut arm, motor);
        assert_eq!(refused, Err(BringUpError::Fault { motor, errors }));
        let reads = [0xB1, 0x9A];
        let sent = bus.sent().into_iter().map(|data| data[0]).filter(|byte| !reads.contains(byte));
        assert_eq!(sent.collect::<Vec<_>>(), [0x78][..locks], "{brake}");
    }
}

/// No brake is open behind which the motor would have to hold.
#[test]
fn refused_brake_release_sends_no_stop() {
    let (bus, _, mut arm) = on_can(CanMaster::<_, _, 4>::new);
    assert!(arm.stop(id(1), StopKind::Hold));
    let before = bus.sent().len();
    let refused = bring_up::release_brake(&mut arm, id(1));
    assert_eq!(refused, Err(CallError::refused(id(1))(RequestError::Stopped).into()));
    let later = arm.now() + Duration::from_millis(500);
    arm.run_until(later, |_| {}).unwrap();
    assert!(bus.sent()[before..].iter().all(|data| data[0] != 0x81));
}

/// The motor holds until its brake is locked, which slips; then the drive reports whether it has an error.
#[test]
fn slipping_brake_is_reopened_unless_its_drive_has_an_error() {
    for has_error in [false, true] {
        let mut was_locked = false;
        let (bus, mut arm) = says(move |data| match data[0] {
            0x70 => data[7] = 2,
            0x78 => was_locked = true,
            0x9A => (data[3], data[6]) = (0, if was_locked && has_error { 0x04 } else { 0 }),
            0x9C if was_locked => data[4] = 90,
            _ => {}
        });
        let outcome = bring_up::lock_brake(&mut arm, id(1));
        assert!(matches!(outcome, Err(BringUpError::BrakeSlips { .. })), "{outcome:?}");
        let opened = bus.sent().iter().any(|data| data[0] == 0x77);
        assert_eq!(opened, !has_error);
    }
}

/// Something opens the brake again after the lock: this is no motor without a brake.
#[test]
fn zero_is_not_written_if_a_load_falls_behind_a_reopened_brake() {
    for falls in [false, true] {
        let mut is_locked = false;
        let (bus, mut arm) = says(move |data| match data[0] {
            0x70 => data[7] = 2,
            0x77 => is_locked = false,
            0x78 => is_locked = true,
            0x9A => data[3] = 1,
            0x9C if is_locked && falls => data[4] = 90,
            _ => {}
        });
        let outcome = bring_up::zero_here(&mut arm, id(1));
        let is_refused = matches!(outcome, Err(BringUpError::BrakeSlips { holds: Some(true), .. }));
        let is_off = bus.sent().iter().any(|data| data[0] == 0x80);
        assert_eq!((is_refused, is_off), (falls, !falls), "{outcome:?}");
    }
}

/// Another thread switches the motor off.
#[test]
fn motor_switched_off_while_its_brake_opened_gets_it_locked_again() {
    for (mode, dps, is_let_go) in [(0, 90, true), (2, 0, false), (0, 0, false)] {
        let (bus, mut arm) = says(move |data| match data[0] {
            0x70 => data[7] = mode,
            0x9A => data[3] = 1,
            0x9C => data[4] = dps,
            _ => {}
        });
        let outcome = bring_up::release_brake(&mut arm, id(1));
        let (motor, speed) = (id(1), CoarseSpeed::from_raw(dps.into()));
        assert_eq!(
            outcome,
            if is_let_go { Err(BringUpError::NotHeld { motor, speed }) } else { Ok(()) }
        );
        assert_eq!(bus.sent().iter().any(|data| data[0] == 0x78), is_let_go);
    }
}

/// The brake is worn, and under a load; the shaft stood before.
#[test]
fn locked_brake_slips_if_the_shaft_turns_at_3_dps_or_more() {
    for (dps, slips) in [(2, false), (3, true)] {
        let mut looks = 0;
        let (_, mut arm) = says(move |data| match data[0] {
            0x9A => data[3] = 0,
            0x9C => {
                looks += 1;
                (data[2], data[3]) = (0, 0);
                data[4] = if looks > 1 { dps } else { 0 };
            }
            _ => {}
        });
        let (motor, speed) = (id(1), CoarseSpeed::from_raw(dps.into()));
        let slipping = Err(BringUpError::BrakeSlips { motor, speed, holds: Some(false) });
        assert_eq!(bring_up::lock_brake(&mut arm, motor), if slips { slipping } else { Ok(()) });
    }
}

#[test]
fn brake_still_reported_locked_after_a_release_is_an_error() {
    let (_, mut arm) = says(|data| {
        if data[0] == 0x9A {
            data[3] = 0;
        }
    });
    let (motor, says) = (id(1), BrakeCommand::LOCK);
    let outcome = bring_up::release_brake(&mut arm, motor);
    assert_eq!(outcome, Err(BringUpError::BrakeNotReleased { motor, says }));
    assert!(outcome.unwrap_err().to_string().contains("motor 1"));
}

/// A handle to a loop that another thread runs: no restart is reported with the answer that shows it.
struct Handle {
    arm: AsyncCanMaster<TestCan, TestClock, 4>,
    has_restarted: bool,
    /// Up to then somebody stops the motor again and again, which drops every question.
    stopped_until: Instant,
}

impl Handle {
    fn new() -> Self {
        let (_, _, arm) = on_can(AsyncCanMaster::new);
        Self { arm, has_restarted: false, stopped_until: Instant::ZERO }
    }
}

impl Calls<4> for Handle {
    type Error = Broken;

    fn now(&mut self) -> Instant {
        Calls::now(&mut self.arm)
    }

    async fn wait_until(&mut self, until: Instant) -> Result<(), CallError<Broken>> {
        self.arm.wait_until(until).await
    }

    async fn ask_often<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
        attempts: Option<u8>,
    ) -> Result<C::Reply, CallError<Broken>> {
        if Calls::now(&mut self.arm) < self.stopped_until {
            return Err(CallError::Failed { motor, failure: Failure::Stopped });
        }
        self.arm.ask_often(motor, command, attempts).await
    }

    async fn stop(&mut self, motor: MotorId, kind: StopKind) -> bool {
        Calls::stop(&mut self.arm, motor, kind).await
    }

    fn begin_stop(&mut self, motor: MotorId, kind: StopKind) {
        self.arm.begin_stop(motor, kind);
    }

    fn may_move(&mut self, _: MotorId) -> Result<(), RequestError> {
        if self.has_restarted { Err(RequestError::Restarted) } else { Ok(()) }
    }

    fn resume(&mut self, _: MotorId) {}

    fn note_restart(&mut self, _: MotorId) {
        self.has_restarted = true;
    }
}

/// The motor stands and runs nothing, and has run for no longer than when the move began.
#[test]
fn move_through_a_handle_finds_a_restart_by_the_run_time() {
    let mut handle = Handle::new();
    let moved = block_on(move_to(&mut handle, id(1), step(), &MoveLimits::default(), go_on));
    let restarted = CallError::refused(id(1))(RequestError::Restarted);
    assert_eq!(moved.map_err(|it| it.why), Err(restarted.into()));
}

#[test]
fn stop_that_comes_meanwhile_does_not_end_the_wait_until_a_motor_stands() {
    let mut handle = Handle::new();
    handle.stopped_until = Instant::from_millis(50);
    let stands = block_on(wait_until_stands(&mut handle, id(1), Duration::from_millis(200)));
    assert_eq!(stands, Ok(()));
    // But it has no more time for that.
    let mut handle = Handle::new();
    handle.stopped_until = Instant::from_millis(1_000);
    let stands = block_on(wait_until_stands(&mut handle, id(1), Duration::from_millis(200)));
    let stopped = CallError::Failed { motor: id(1), failure: Failure::Stopped };
    assert_eq!(stands, Err(BringUpError::Call(stopped)));
    let now = Calls::now(&mut handle);
    assert!(now <= Instant::from_millis(220), "{now:?}");
}

#[test]
fn motor_is_asked_through_a_handle_whether_it_is_there() {
    let mut handle = Handle::new();
    assert_eq!(block_on(is_there(&mut handle, id(1))), Ok(true));
    assert_eq!(block_on(is_there(&mut handle, id(9))), Ok(false));
}
