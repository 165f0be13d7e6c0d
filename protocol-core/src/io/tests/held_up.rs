//! A caller that is held up while an answer is on its way: its program is suspended, or its thread does not run. What
//! the answer says is from before that.

use core::ops::ControlFlow;
use std::vec::Vec;

use super::calls::Says;
use super::world::{Broken, TestCan, TestClock, on_can};
use super::{id, step};
use crate::Data;
use crate::command::{BrakeCommand, ReadStatus2};
use crate::error::RequestError;
use crate::io::bring_up::{self, BringUpError, MoveFailure, MoveLimits};
use crate::io::{CallError, CanMaster, Runner};
use crate::packet::{Channel, Packet};
use crate::time::Duration;

/// An arm whose answers are changed on their way. Whoever changes them may hold the caller up by setting the clock
/// forward.
fn arm(
    mut says: impl FnMut(&mut Data, &TestClock) + 'static,
) -> (TestCan, CanMaster<Says, TestClock, 4>) {
    let (bus, _, arm) = on_can(|bus, clock, config| {
        let its_clock = clock.clone();
        CanMaster::new(Says::new(bus, move |data| says(data, &its_clock)), clock, config)
    });
    (bus, arm)
}

/// The commands that were sent, of these.
fn sent<const M: usize>(bus: &TestCan, of: [u8; M]) -> Vec<u8> {
    bus.sent().into_iter().map(|data| data[0]).filter(|byte| of.contains(byte)).collect()
}

/// True at the call of this number, counted from 0.
fn nth(number: u32) -> impl FnMut() -> bool {
    let mut calls = 0;
    move || {
        calls += 1;
        calls == number + 1
    }
}

/// Has a drive say that it has run for so long.
fn say_run_time(data: &mut Data, runs_ms: u64) {
    data[4..].copy_from_slice(&u32::try_from(runs_ms).unwrap().to_le_bytes());
}

/// How a move ends, and after how many looks, if its caller is held up for ten seconds during this look (the first is
/// 0). The motor stays where it is, and turns for so many looks.
fn moved(look: u32, turns_for: u32, limits: &MoveLimits) -> (MoveFailure<Broken>, u32) {
    let (mut is_held_up, mut turns) = (nth(look), turns_for);
    let (_, mut arm) = arm(move |data, clock| match data[0] {
        // It runs something.
        0x70 => data[7] = 3,
        0x9C => {
            data[4] = if turns > 0 { 100 } else { 0 };
            turns = turns.saturating_sub(1);
            if is_held_up() {
                clock.advance(10_000_000);
            }
        }
        _ => {}
    });
    let mut looks = 0;
    let outcome = bring_up::move_to(&mut arm, id(1), step(), limits, |_| {
        looks += 1;
        ControlFlow::Continue(())
    });
    (outcome.unwrap_err().why, looks)
}

/// The next look shows it: ten seconds lie between them.
#[test]
fn move_has_not_failed_because_its_caller_was_held_up() {
    let minute = Duration::from_secs(60);
    let stalls = MoveLimits { time: Some(minute), ..MoveLimits::default() };
    let (why, looks) = moved(2, 0, &stalls);
    assert!(matches!(why, MoveFailure::Stalled { .. }), "{why}");
    assert_eq!(looks, 4);
    let times_out = MoveLimits { stalled_after: minute, ..MoveLimits::default() };
    let (why, looks) = moved(2, 0, &times_out);
    assert!(matches!(why, MoveFailure::TimedOut { .. }), "{why}");
    assert_eq!(looks, 4);
}

/// A look every 20 ms, and a second without progress ends the move. If the motor turned until the look before that, it
/// may still be turning, whichever of the two looks the caller was held up in.
#[test]
fn motor_that_turned_a_moment_ago_may_be_turning() {
    let stalls = MoveLimits { time: Some(Duration::from_secs(60)), ..MoveLimits::default() };
    for held_up in [50, 51] {
        let (why, looks) = moved(held_up, 51, &stalls);
        assert!(matches!(why, MoveFailure::Turning { .. }), "{held_up}: {why}");
        assert_eq!(looks, 52);
    }
}

/// The drive goes on running, since 300 ms before. The first run time is read before the restart.
#[test]
fn drive_has_not_restarted_because_the_caller_was_held_up() {
    for late in [1, 3] {
        let mut reads = 0;
        let (_, mut arm) = arm(move |data, clock| {
            if data[0] == 0xB1 {
                say_run_time(data, clock.micros() / 1_000 + 300);
                reads += 1;
                if (2..2 + late).contains(&reads) {
                    clock.advance(10_000_000);
                }
            }
        });
        let outcome = bring_up::restart(&mut arm, id(1), id(1));
        assert_eq!(outcome, Err(BringUpError::NotRestarted(id(1))), "{late} late");
    }
}

/// The question reaches the drive late: it has run for longer by then than when it was asked.
#[test]
fn drive_has_restarted_though_the_question_was_held_up() {
    let mut told_at = None;
    let mut is_held_up = nth(1);
    let (bus, mut arm) = arm(move |data, clock| {
        if data[0] == 0xB1 {
            if is_held_up() {
                clock.advance(10_000_000);
            }
            say_run_time(data, told_at.map_or(300, |told_at| (clock.micros() - told_at) / 1_000));
            told_at.get_or_insert(clock.micros());
        }
    });
    assert_eq!(bring_up::restart(&mut arm, id(1), id(1)), Ok(()));
    assert_eq!(sent(&bus, [0x76]), [0x76], "once");
}

/// It turns for 30 ms, which the caller hears of two seconds later.
#[test]
fn motor_that_has_come_to_rest_meanwhile_stands() {
    let (_, mut arm) = arm(|data, clock| {
        if data[0] == 0x9C && clock.micros() < 30_000 {
            data[4] = 90;
            clock.advance(2_000_000);
        }
    });
    let second = Duration::from_secs(1);
    assert_eq!(bring_up::wait_until_stands(&mut arm, id(1), second), Ok(()));
}

/// It answers nothing in the first 60 ms. The caller hears of that 250 ms later, and allows 200.
#[test]
fn motor_that_answers_again_by_then_is_there() {
    let mut is_held_up = nth(1);
    let (_, mut arm) = arm(move |data, clock| {
        if clock.micros() < 60_000 {
            // Nobody asks this.
            data[0] = 0xE0;
            if is_held_up() {
                clock.advance(250_000);
            }
        }
    });
    let time = Duration::from_millis(200);
    assert_eq!(bring_up::wait_until_there(&mut arm, id(1), time), Ok(()));
}

/// The load begins to turn the shaft 30 ms after the first look, during which the caller is held up.
#[test]
fn brake_does_not_hold_because_nothing_fell_before_the_caller_was_held_up() {
    let mut first = None;
    let (_, mut arm) = arm(move |data, clock| {
        if data[0] == 0x9C {
            let looked = *first.get_or_insert(clock.micros());
            if looked == clock.micros() {
                clock.advance(250_000);
            } else {
                data[4] = 90;
            }
        }
    });
    let slips = bring_up::check_brake(&mut arm, id(1));
    assert!(matches!(slips, Err(BringUpError::BrakeSlips { .. })), "{slips:?}");
}

/// The brake reports that it is locked, and slips from 15 ms after the motor was switched off.
#[test]
fn motor_is_not_restarted_because_nothing_fell_before_the_caller_was_held_up() {
    let (mut off, mut is_locked, mut is_held_up) = (None, false, nth(0));
    let (bus, mut arm) = arm(move |data, clock| match data[0] {
        0x78 => is_locked = true,
        0x77 => is_locked = false,
        0x80 => off = Some(clock.micros()),
        0x81 => off = None,
        0x70 => data[7] = if off.is_some() { 0 } else { 2 },
        0x9A => data[3] = u8::from(!is_locked),
        0x9C => {
            if let Some(off) = off {
                data[4] = if clock.micros() - off > 15_000 { 90 } else { 0 };
                if is_held_up() {
                    clock.advance(250_000);
                }
            }
        }
        _ => {}
    });
    let slips = bring_up::restart(&mut arm, id(1), id(1));
    assert!(matches!(slips, Err(BringUpError::BrakeSlips { holds: Some(true), .. })), "{slips:?}");
    assert_eq!(sent(&bus, [0x76, 0x77, 0x78, 0x80, 0x81]), [0x78, 0x80, 0x77, 0x81]);
}

/// The motor needs 100 ms to catch its load, and the caller hears of the second look half a second later.
#[test]
fn brake_is_not_locked_under_a_load_that_was_caught_meanwhile() {
    let (mut first, mut is_held_up) = (None, nth(1));
    let (bus, mut arm) = arm(move |data, clock| match data[0] {
        0x70 => data[7] = 2,
        0x9A => data[3] = 1,
        0x9C => {
            let first = *first.get_or_insert(clock.micros());
            data[4] = if clock.micros() - first < 100_000 { 90 } else { 0 };
            if is_held_up() {
                clock.advance(600_000);
            }
        }
        _ => {}
    });
    assert_eq!(bring_up::release_brake(&mut arm, id(1)), Ok(()));
    assert_eq!(sent(&bus, [0x78]), []);
}

/// It takes 60 ms to move. The caller hears 250 ms later what the brake said at first: of the command to open it after
/// two answers, and of that to lock it after one.
#[test]
fn brake_has_moved_though_its_caller_was_held_up() {
    for (command, held_up, says) in
        [(0x77, 2, BrakeCommand::RELEASE), (0x78, 1, BrakeCommand::LOCK)]
    {
        let (mut told, mut is_held_up) = (None, nth(held_up));
        let (_, mut arm) = arm(move |data, clock| match data[0] {
            0x70 => data[7] = 2,
            0x9A => {
                let is_there = told.is_some_and(|told| clock.micros() - told > 60_000);
                data[3] = u8::from(is_there == (says == BrakeCommand::RELEASE));
                if is_held_up() {
                    clock.advance(250_000);
                }
            }
            byte if byte == command => told = Some(clock.micros()),
            _ => {}
        });
        let outcome = match command {
            0x77 => bring_up::release_brake(&mut arm, id(1)),
            _ => bring_up::lock_brake(&mut arm, id(1)),
        };
        assert_eq!(outcome, Ok(()), "{command:#x}");
    }
}

/// The first six answers are not understood, and the caller is held up after the third: it has insisted for a moment
/// only.
#[test]
fn question_on_which_a_load_depends_is_insisted_on_though_the_caller_was_held_up() {
    let mut reads = 0;
    let (_, mut arm) = arm(move |data, clock| match data[0] {
        0x70 => data[7] = 2,
        0x9A => {
            data[3] = 1;
            reads += 1;
            if reads <= 6 {
                data[0] = 0xE0;
            }
            if reads == 3 {
                clock.advance(400_000);
            }
        }
        _ => {}
    });
    let outcome = bring_up::release_brake(&mut arm, id(1));
    assert_eq!(outcome, Ok(()));
}

/// The answer to what was asked before is the second one to the first question.
#[test]
fn late_answer_to_an_earlier_question_is_no_second_motor() {
    let (bus, _, mut arm) = on_can(|bus, clock, config| {
        let (its_bus, mut is_late) = (bus.clone(), nth(0));
        let change = move |data: &mut Data| {
            if data[0] == 0x9C && is_late() {
                let answer = Packet { channel: Channel::Reply(id(1)), data: *data };
                its_bus.hear_at(30_000, &answer);
                // Nobody asks this.
                data[0] = 0xE0;
            }
        };
        CanMaster::<_, _, 4>::new(Says::new(bus, change), clock, config)
    });
    let once = arm.master().patience(1);
    assert!(arm.ask_with(id(1), ReadStatus2, Some(once), |_| {}).is_err());
    assert_eq!(bring_up::is_shared(&mut arm, id(1)), Ok(false), "{:02X?}", sent(&bus, [0x9C]));
}

/// The drive has restarted, but each answer to the question for its run time took ten seconds, and it is not known how
/// long it had run before: nothing speaks against a restart.
#[test]
fn drive_that_runs_for_no_longer_than_since_it_was_told_has_restarted() {
    let (mut reads, mut told) = (0, 0);
    let (bus, mut arm) = arm(move |data, clock| {
        if data[0] == 0xB1 {
            reads += 1;
            if reads <= 3 {
                // Nobody asks this. The drive is told to restart when the last time-out is over.
                data[0] = 0xE0;
                told = clock.micros() + 30_000;
                return;
            }
            clock.advance(10_000_000);
            say_run_time(data, (clock.micros() - told) / 1_000);
        }
    });
    assert_eq!(bring_up::restart(&mut arm, id(1), id(1)), Ok(()));
    assert_eq!(sent(&bus, [0x76]), [0x76], "once");
}

/// It runs nothing any more, and may have restarted: each answer to the question for its run time took ten seconds.
#[test]
fn move_of_a_drive_that_may_have_restarted_is_not_gone_on_with() {
    let mut reads = 0;
    let (_, mut arm) = arm(move |data, clock| match data[0] {
        0x70 => data[7] = 0,
        0xB1 => {
            reads += 1;
            if reads == 1 {
                return say_run_time(data, 300);
            }
            clock.advance(10_000_000);
            say_run_time(data, clock.micros() / 1_000 - 9_000);
        }
        _ => {}
    });
    let limits = MoveLimits { stalled_after: Duration::from_millis(100), ..MoveLimits::default() };
    let go_on = |_: &_| ControlFlow::Continue(());
    let why = bring_up::move_to(&mut arm, id(1), step(), &limits, go_on).unwrap_err().why;
    let restarted = CallError::refused(id(1))(RequestError::Restarted);
    assert_eq!(why, restarted.into());
}

/// Motor 9 is not there. Each question takes three time-outs of 20 ms.
#[test]
fn waits_for_a_motor_that_is_not_there_end_soon_after_their_time() {
    let took_ms = |wait: &dyn Fn(&mut CanMaster<Says, TestClock, 4>)| {
        let (_, mut arm) = arm(|_, _| {});
        wait(&mut arm);
        arm.now().as_micros() / 1_000
    };
    let there = took_ms(&|arm| {
        bring_up::wait_until_there(arm, id(9), Duration::from_millis(200)).unwrap_err();
    });
    assert!((200..300).contains(&there), "{there}");
    // It is asked for its run time. A load may depend on what its brake says: that is insisted on for 300 ms.
    let brake = took_ms(&|arm| {
        bring_up::release_brake(arm, id(9)).unwrap_err();
    });
    assert!((360..560).contains(&brake), "{brake}");
}
