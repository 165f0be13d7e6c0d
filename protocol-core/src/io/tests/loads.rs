//! Loads that a motor holds when it is to be switched off: whatever its drive says or does not, and whatever is lost,
//! the motor is switched off only behind a brake that holds the load.

use std::cell::RefCell;
use std::rc::Rc;
use std::vec::Vec;

use embedded_can::{Frame as _, nb};

use super::calls::{Saying, Says, says};
use super::id;
use super::world::{Broken, TestCan, TestClock, on_can};
use crate::Data;
use crate::command::BrakeCommand;
use crate::io::bring_up::{self, BRAKE_MOVES, BringUpError};
use crate::io::{CanMaster, Clock, Runner};
use crate::master::{MotorSet, StopKind};
use crate::time::Instant;
use crate::units::CoarseSpeed;
use crate::wire::can::SimpleFrame;

/// Another byte is heard in place of the answer: the question has none.
const NO_ANSWER: u8 = 0xE0;
const RUNS: u8 = 2;
const LOCKED: u8 = 0;
const OPEN: u8 = 1;

/// The commands that act, in the order in which they were sent.
fn commanded(bus: &TestCan) -> Vec<u8> {
    let does = |byte: &u8| [0x64, 0x76, 0x77, 0x78, 0x80, 0x81].contains(byte);
    bus.sent().into_iter().map(|data| data[0]).filter(does).collect()
}

/// Whether the brake slips, and the motor holds again.
fn is_held<T, E>(outcome: &Result<T, BringUpError<E>>) -> bool {
    matches!(outcome, Err(BringUpError::BrakeSlips { holds: Some(true), .. }))
}

/// A motor that runs something and stands, its brake open until it is to lock, unless this says something else.
fn holding(mut or: impl FnMut(&mut Data, bool) + 'static) -> Saying {
    let mut is_locked = false;
    says(move |data| {
        match data[0] {
            0x78 => is_locked = true,
            0x77 => is_locked = false,
            _ => {}
        }
        match data[0] {
            0x70 => data[7] = RUNS,
            0x9A => data[3] = if is_locked { LOCKED } else { OPEN },
            _ => {}
        }
        or(data, is_locked);
    })
}

/// A motor that reports that it runs nothing, and draws no current.
fn resting(mut or: impl FnMut(&mut Data) + 'static) -> Saying {
    holding(move |data, _| {
        match data[0] {
            0x70 => data[7] = 0,
            0x9C => (data[2], data[3]) = (0, 0),
            _ => {}
        }
        or(data);
    })
}

/// The brake of the motor slips, and one answer after that is lost.
fn slips(lost: u8) -> Saying {
    let mut opens = 0;
    holding(move |data, is_locked| {
        opens += u32::from(data[0] == 0x77);
        match data[0] {
            0x9C if is_locked => data[4] = 90,
            byte if byte == lost && opens > 0 => data[0] = NO_ANSWER,
            _ => {}
        }
    })
}

#[test]
fn restart_is_refused_if_the_brake_slips_under_a_held_load() {
    for (lost, holds) in [(NO_ANSWER, Some(true)), (0x81, None), (0x9A, None)] {
        let (bus, mut arm) = slips(lost);
        let refused = bring_up::restart(&mut arm, id(1), id(1));
        assert!(
            matches!(refused, Err(BringUpError::BrakeSlips { holds: found, .. }) if found == holds),
            "{lost:#x}: {refused:?}"
        );
        assert!(
            commanded(&bus).starts_with(&[0x78, 0x77, 0x81]) && !commanded(&bus).contains(&0x76)
        );
    }
}

/// The bus of a motor that holds behind a brake that slips, which fails once, at the end of so many frames.
struct Fails(Says, u32);

impl nb::Can for Fails {
    type Frame = SimpleFrame;
    type Error = Broken;

    fn transmit(&mut self, frame: &SimpleFrame) -> ::nb::Result<Option<SimpleFrame>, Broken> {
        self.1 = self.1.wrapping_sub(1);
        if self.1 == 0 { Err(::nb::Error::Other(Broken)) } else { self.0.transmit(frame) }
    }

    fn receive(&mut self) -> ::nb::Result<SimpleFrame, Broken> {
        self.0.receive()
    }
}

/// The brake slips as soon as it locks, or when the motor is off.
#[test]
fn one_bus_error_while_a_motor_is_switched_off_drops_no_load() {
    for (frames, slips_at, way) in
        (1..130).flat_map(|frames| [(frames, 0x78, 0), (frames, 0x78, 1), (frames, 0x80, 2)])
    {
        let (mut is_locked, mut falls) = (false, false);
        let slips = move |data: &mut Data| {
            match data[0] {
                0x78 => is_locked = true,
                0x77 => is_locked = false,
                0x81 => falls = false,
                _ => {}
            }
            falls |= data[0] == slips_at;
            match data[0] {
                0x70 => data[7] = RUNS,
                0x9A => data[3] = if is_locked { LOCKED } else { OPEN },
                0x9C if falls => data[4] = 90,
                _ => {}
            }
        };
        let (bus, _, mut arm) = on_can(|bus, clock, config| {
            CanMaster::<_, _, 4>::new(Fails(Says::new(bus, slips), frames), clock, config)
        });
        let outcome = match way {
            0 => bring_up::lock_brake(&mut arm, id(1)),
            1 => bring_up::restart(&mut arm, id(1), id(1)),
            _ => bring_up::zero_here(&mut arm, id(1)).map(drop),
        };
        let later = arm.now() + BRAKE_MOVES;
        arm.run_until(later, |_| {}).unwrap();
        let name = std::format!("{frames} {way} {outcome:?} {:x?}", commanded(&bus));
        match commanded(&bus)[..] {
            // It goes on holding, or its brake holds yet.
            [] | [0x78] if commanded(&bus).is_empty() || way == 2 => {
                assert!(matches!(outcome, Err(BringUpError::Call(_))), "{name}")
            }
            // Or it holds again, or a stop has it hold.
            [0x78, .., 0x81] => {
                assert!(matches!(outcome, Err(BringUpError::BrakeSlips { .. })), "{name}");
            }
            _ => panic!("{name}"),
        }
    }
}

/// It may be in motion mode: its brake is open, and it stands.
#[test]
fn motor_that_reports_running_nothing_may_still_hold_a_load() {
    let (bus, mut arm) = holding(|data, is_locked| match data[0] {
        0x70 => data[7] = 0,
        0x9C if is_locked => data[4] = 90,
        _ => {}
    });
    let refused = bring_up::lock_brake(&mut arm, id(1));
    assert!(matches!(refused, Err(BringUpError::BrakeSlips { .. })), "{refused:?}");
    assert_eq!(commanded(&bus), [0x78, 0x77, 0x81]);
}

/// Some drives report an open brake as locked while they obey no command.
#[test]
fn brake_of_a_motor_that_may_run_is_locked_though_reported_locked() {
    for says_what in [true, false] {
        let (bus, mut arm) = holding(move |data, _| match data[0] {
            0x9A => data[3] = LOCKED,
            0x70 if !says_what => data[0] = NO_ANSWER,
            _ => {}
        });
        let _zero = bring_up::zero_here(&mut arm, id(1));
        assert_eq!(commanded(&bus)[..3], [0x78, 0x80, 0x64]);
    }
}

/// A motor that runs nothing, and reports its brake as locked, loses no time.
#[test]
fn resting_motor_with_a_locked_brake_is_switched_off_at_once() {
    let (bus, mut arm) = resting(|data| {
        if data[0] == 0x9A {
            data[3] = LOCKED;
        }
    });
    let _zero = bring_up::zero_here(&mut arm, id(1));
    assert_eq!(commanded(&bus)[..2], [0x80, 0x64]);
}

/// It may be a motor without a brake, with a hand at its shaft.
#[test]
fn resting_motor_is_never_commanded_to_hold() {
    let never_locks = |data: &mut Data| {
        if data[0] == 0x9A {
            data[3] = OPEN;
        }
    };
    let (bus, mut arm) = resting(never_locks);
    let (motor, says) = (id(1), BrakeCommand::RELEASE);
    let refused = bring_up::lock_brake(&mut arm, motor);
    assert_eq!(refused, Err(BringUpError::BrakeNotLocked { motor, says }));
    assert_eq!(commanded(&bus), [0x78]);
    let (bus, mut arm) = resting(never_locks);
    let _zero = bring_up::zero_here(&mut arm, id(1));
    assert_eq!(commanded(&bus)[..3], [0x78, 0x80, 0x64]);
    let mut is_off = false;
    let (bus, mut arm) = resting(move |data| match data[0] {
        0x80 => is_off = true,
        0x9C if is_off => data[4] = 90,
        _ => {}
    });
    let _zero = bring_up::zero_here(&mut arm, id(1));
    assert_eq!(commanded(&bus)[..3], [0x78, 0x80, 0x64], "it is turned by hand");
}

/// A brake whose lock has no answer may lock all the same, or the command was lost for longer than it is repeated.
#[test]
fn unanswered_brake_lock_gets_its_time_and_is_repeated_if_still_open() {
    for (obeys, locks) in [(true, 1), (false, 2)] {
        let (bus, mut arm) = holding(move |data, _| match data[0] {
            0x78 => data[0] = NO_ANSWER,
            0x9A => data[3] = if obeys { LOCKED } else { OPEN },
            _ => {}
        });
        let begun = arm.now();
        let _zero = bring_up::zero_here(&mut arm, id(1));
        // Each time as often as any question.
        let asked = commanded(&bus).iter().take_while(|byte| **byte == 0x78).count();
        assert_eq!(asked, 3 * locks, "{:x?}", commanded(&bus));
        assert_eq!(commanded(&bus)[asked..][..2], [0x80, 0x64]);
        assert!(arm.now() - begun > BRAKE_MOVES.times(locks as u32));
    }
}

/// A motor that runs something and stands until it is off.
fn falls_when_off() -> Saying {
    let mut is_off = false;
    holding(move |data, _| match data[0] {
        0x80 => is_off = true,
        0x81 => is_off = false,
        0x9C if is_off => data[4] = 90,
        _ => {}
    })
}

/// Some brakes show only then that they slip, and some drives hold behind them until then.
#[test]
fn load_that_falls_when_switched_off_is_held_again_before_any_write() {
    let (zeroed, mut arm) = falls_when_off();
    assert!(is_held(&bring_up::zero_here(&mut arm, id(1))));
    let (restarted, mut arm) = falls_when_off();
    assert!(is_held(&bring_up::restart(&mut arm, id(1), id(1))));
    let (renamed, mut arm) = falls_when_off();
    assert!(is_held(&bring_up::change_id(&mut arm, id(1), id(4))));
    for bus in [zeroed, restarted, renamed] {
        assert_eq!(commanded(&bus), [0x78, 0x80, 0x77, 0x81]);
    }
}

/// Something opens the brake again and switches the motor off; at the first looks its shaft does not turn yet.
#[test]
fn motor_switched_off_while_its_brake_locks_is_held_again() {
    let mut looks = 0;
    let (bus, mut arm) = holding(move |data, is_locked| match data[0] {
        0x70 if is_locked => data[7] = 0,
        0x9A => data[3] = OPEN,
        0x9C if is_locked => {
            looks += 1;
            data[4] = if looks > 5 { 90 } else { 0 };
        }
        _ => {}
    });
    let slips = bring_up::lock_brake(&mut arm, id(1));
    assert!(is_held(&slips), "{slips:?}");
    assert_eq!(commanded(&bus), [0x78, 0x77, 0x81]);
}

/// Its answers are lost, or the motor is; it may hear the restart all the same.
#[test]
fn silent_motor_gets_its_brake_locked_before_a_restart() {
    for (answers_then, expected) in [
        (true, [0x78, 0x78, 0x80, 0x76]),
        // As often as any question is asked.
        (false, [0x78, 0x78, 0x78, 0x76]),
    ] {
        let (bus, mut arm) = holding(move |data, is_locked| {
            if data[0] == 0x9A && !is_locked || !answers_then && [0x9A, 0x78].contains(&data[0]) {
                data[0] = NO_ANSWER;
            }
        });
        let begun = arm.now();
        let _restart = bring_up::restart(&mut arm, id(1), id(1));
        assert_eq!(commanded(&bus)[..4], expected);
        assert!(arm.now() - begun > BRAKE_MOVES);
    }
}

/// A line that is out for less than a brake takes says nothing of the motor.
#[test]
fn motor_silent_for_less_than_its_brake_takes_is_not_given_up() {
    let mut lost = 4;
    let (bus, mut arm) = holding(move |data, _| {
        if data[0] == 0x9A && lost > 0 {
            lost -= 1;
            data[0] = NO_ANSWER;
        }
    });
    let _restart = bring_up::restart(&mut arm, id(1), id(1));
    assert_eq!(commanded(&bus)[..3], [0x78, 0x80, 0x76]);
}

/// The answer to 0x80 may be lost and the motor be off.
#[test]
fn unanswered_shutdown_is_still_checked_for_a_falling_load() {
    let mut is_off = false;
    let (bus, mut arm) = holding(move |data, _| match data[0] {
        0x80 => (is_off, data[0]) = (true, NO_ANSWER),
        0x81 => is_off = false,
        0x9C if is_off => data[4] = 90,
        _ => {}
    });
    let slips = bring_up::zero_here(&mut arm, id(1));
    assert!(is_held(&slips), "{slips:?}");
    assert!(commanded(&bus).starts_with(&[0x78, 0x80, 0x80, 0x80, 0x77, 0x81]));
}

/// The brake may not have locked.
#[test]
fn motor_is_not_switched_off_if_its_brake_state_is_unknown() {
    let (bus, mut arm) = holding(|data, is_locked| {
        if data[0] == 0x9A && is_locked {
            data[0] = NO_ANSWER;
        }
    });
    let refused = bring_up::zero_here(&mut arm, id(1));
    assert!(matches!(refused, Err(BringUpError::Call(_))), "{refused:?}");
    assert_eq!(commanded(&bus), [0x78]);
}

/// The load fell before: no motor is made to hold what it did not hold.
#[test]
fn slipping_brake_of_a_motor_that_held_nothing_is_not_reopened() {
    let (bus, mut arm) = resting(|data| match data[0] {
        0x9A => data[3] = LOCKED,
        0x9C => data[4] = 90,
        _ => {}
    });
    let slips = bring_up::lock_brake(&mut arm, id(1));
    assert!(matches!(slips, Err(BringUpError::BrakeSlips { holds: Some(false), .. })), "{slips:?}");
    assert_eq!(commanded(&bus), [0x78]);
    // A restart makes that no worse.
    let _restart = bring_up::restart(&mut arm, id(1), id(1));
    assert_eq!(commanded(&bus)[1..3], [0x80, 0x76]);
}

/// The motor holds while its brake opens, and its shaft turns on: its load is too heavy.
#[test]
fn brake_is_locked_if_the_load_is_not_at_rest_within_half_a_second() {
    for says_what in [false, true] {
        let (bus, mut arm) = holding(move |data, is_locked| match data[0] {
            0x70 if !says_what => data[0] = NO_ANSWER,
            0x9C if !is_locked => data[4] = 90,
            _ => {}
        });
        let begun = arm.now();
        let turns = Err(BringUpError::NotHeld { motor: id(1), speed: CoarseSpeed::from_raw(90) });
        assert_eq!(bring_up::release_brake(&mut arm, id(1)), turns);
        let took = arm.now() - begun - BRAKE_MOVES;
        assert!((500..600).contains(&took.as_millis()), "{took}");
        assert_eq!(commanded(&bus), [0x77, 0x81, 0x78]);
    }
}

/// The motor does not report what it runs. One that draws a current may swing a little.
#[test]
fn brake_is_locked_at_once_if_the_motor_turns_and_draws_no_current() {
    let (bus, mut arm) = holding(|data, is_locked| match data[0] {
        0x70 => data[0] = NO_ANSWER,
        0x9C if !is_locked => (data[2], data[3], data[4]) = (0, 0, 90),
        _ => {}
    });
    let begun = arm.now();
    let turns = Err(BringUpError::NotHeld { motor: id(1), speed: CoarseSpeed::from_raw(90) });
    assert_eq!(bring_up::release_brake(&mut arm, id(1)), turns);
    assert!((arm.now() - begun - BRAKE_MOVES).as_millis() < 50);
    assert_eq!(commanded(&bus), [0x77, 0x81, 0x78]);
}

/// The motor brakes a load that began to fall while its brake opened.
#[test]
fn release_returns_only_once_the_load_is_at_rest() {
    let mut looks = 0;
    let (bus, mut arm) = holding(move |data, _| {
        if data[0] == 0x9C {
            data[4] = *[90, 40, 1, 1].get(looks).unwrap_or(&0);
            looks += 1;
        }
    });
    assert_eq!(bring_up::release_brake(&mut arm, id(1)), Ok(()));
    assert_eq!(bus.sent().iter().filter(|data| data[0] == 0x9C).count(), 5);
}

/// The encoder is noisy, or somebody turns the shaft.
#[test]
fn release_waits_half_a_second_at_most_for_a_trembling_shaft() {
    let (_, mut arm) = holding(|data, _| {
        if data[0] == 0x9C {
            data[4] = 1;
        }
    });
    let begun = arm.now();
    assert_eq!(bring_up::release_brake(&mut arm, id(1)), Ok(()));
    let took = arm.now() - begun - BRAKE_MOVES;
    assert!((500..600).contains(&took.as_millis()), "{took}");
}

#[test]
fn release_accepts_an_idle_motor_that_swings_at_one_look_only() {
    let mut looks = 0;
    let (_, mut arm) = resting(move |data| {
        if data[0] == 0x9C {
            data[4] = if looks == 0 { 90 } else { 0 };
            looks += 1;
        }
    });
    assert_eq!(bring_up::release_brake(&mut arm, id(1)), Ok(()));
}

/// When it is first asked, the motor still runs.
#[test]
fn release_fails_if_the_motor_cuts_its_output_under_its_load() {
    let mut asked = 0;
    let (bus, mut arm) = holding(move |data, _| match data[0] {
        0x9C => data[4] = 90,
        0x70 => {
            asked += 1;
            data[7] = if asked > 1 { 0 } else { RUNS };
        }
        _ => {}
    });
    let turns = Err(BringUpError::NotHeld { motor: id(1), speed: CoarseSpeed::from_raw(90) });
    assert_eq!(bring_up::release_brake(&mut arm, id(1)), turns);
    assert_eq!(commanded(&bus), [0x77, 0x81, 0x78]);
}

/// A hold that was not acknowledged may not be obeyed: the stop in force repeats it.
#[test]
fn motor_that_does_not_acknowledge_its_hold_stays_stopped() {
    let (_, mut arm) = holding(|data, _| {
        if data[0] == 0x81 {
            data[0] = NO_ANSWER;
        }
    });
    assert!(bring_up::release_brake(&mut arm, id(1)).is_err());
    assert!(arm.master().is_stopped(id(1)));
}

/// It is not switched off for a restart or a zero that is refused then.
#[test]
fn stopped_motor_is_refused_before_its_brake_is_locked() {
    let (bus, mut arm) = holding(|_, _| {});
    assert_eq!(arm.stop_all(StopKind::Hold, id(1).into()), MotorSet::EMPTY);
    let before = commanded(&bus).len();
    assert!(bring_up::restart(&mut arm, id(1), id(1)).is_err());
    assert!(bring_up::zero_here(&mut arm, id(1)).is_err());
    assert_eq!(commanded(&bus).len(), before);
}

/// The motor has no brake, and knows none of these commands.
#[test]
fn no_stop_stays_in_force_if_brake_commands_are_not_answered() {
    let (bus, mut arm) = holding(|data, _| {
        if [0x70, 0x77, 0x78].contains(&data[0]) {
            data[0] = NO_ANSWER;
        }
    });
    let _zero = bring_up::zero_here(&mut arm, id(1));
    assert!(!arm.master().is_stopped(id(1)));
    assert!(commanded(&bus).contains(&0x64) && !commanded(&bus).contains(&0x77));
}

/// A drive with an error holds nothing, whatever it reports to run: only the brake can catch a load that turns it.
#[test]
fn falling_load_of_a_motor_with_an_error_gets_the_brake_locked() {
    let (bus, mut arm) = holding(|data, is_locked| match data[0] {
        0x9A => data[6] = 2,
        0x9C if !is_locked => data[4] = 90,
        _ => {}
    });
    assert_eq!(bring_up::lock_brake(&mut arm, id(1)), Ok(()));
    assert_eq!(commanded(&bus), [0x78]);
}

/// With its brake open it may be moved; with a locked one its load falls, and no motor has held it.
#[test]
fn turning_motor_of_unknown_mode_gets_no_lock_while_its_brake_is_open() {
    for (brake, expected) in [(OPEN, &[][..]), (LOCKED, &[0x78][..])] {
        let (bus, mut arm) = holding(move |data, _| match data[0] {
            0x70 => data[0] = NO_ANSWER,
            0x9A => data[3] = brake,
            0x9C => (data[2], data[4]) = (1, 90),
            _ => {}
        });
        let refused = bring_up::lock_brake(&mut arm, id(1));
        let is_right = match brake {
            OPEN => matches!(refused, Err(BringUpError::Turns { .. })),
            _ => matches!(refused, Err(BringUpError::BrakeSlips { holds: Some(false), .. })),
        };
        assert!(is_right, "{refused:?}");
        assert_eq!(commanded(&bus), expected);
    }
}

/// Its gear may hold most of the load.
#[test]
fn running_motor_without_current_may_still_hold_a_load() {
    let (bus, mut arm) = holding(|data, is_locked| {
        if data[0] == 0x9C {
            (data[2], data[3], data[4]) = (0, 0, if is_locked { 90 } else { 0 });
        }
    });
    let slips = bring_up::lock_brake(&mut arm, id(1));
    assert!(is_held(&slips), "{slips:?}");
    assert_eq!(commanded(&bus), [0x78, 0x77, 0x81]);
}

/// The answer about its errors is lost, and its load falls meanwhile.
#[test]
fn falling_load_is_held_again_if_the_error_state_is_unknown() {
    let mut falls = false;
    let (bus, mut arm) = holding(move |data, is_locked| match data[0] {
        0x9C if is_locked => (falls, data[4]) = (true, 90),
        0x9A if is_locked && falls => data[0] = NO_ANSWER,
        _ => {}
    });
    let slips = bring_up::lock_brake(&mut arm, id(1));
    assert!(is_held(&slips), "{slips:?}");
    // It was silent, and may obey the third command only. The brake's release was the first.
    assert_eq!(commanded(&bus), [0x78, 0x77, 0x81, 0x81]);
}

/// The load is caught, and stands at every second look.
#[test]
fn load_that_swings_behind_a_locked_brake_does_not_slip() {
    let mut looks = 0;
    let (bus, mut arm) = holding(move |data, is_locked| {
        if data[0] == 0x9C && is_locked {
            looks += 1;
            data[4] = if looks % 2 == 1 { 90 } else { 0 };
        }
    });
    assert_eq!(bring_up::lock_brake(&mut arm, id(1)), Ok(()));
    assert_eq!(commanded(&bus), [0x78]);
}

/// The load was not held before, so that a restart makes that no worse.
#[test]
fn motor_that_held_nothing_restarts_though_its_brake_slips() {
    let (bus, mut arm) = resting(|data| {
        if data[0] == 0x9C {
            data[4] = 90;
        }
    });
    let _restart = bring_up::restart(&mut arm, id(1), id(1));
    assert_eq!(commanded(&bus)[..2], [0x78, 0x76]);
}

/// Notes when each frame is sent.
struct Noted<C>(C, TestClock, Rc<RefCell<Vec<(u8, Instant)>>>);

impl<C: nb::Can<Frame = SimpleFrame>> nb::Can for Noted<C> {
    type Frame = SimpleFrame;
    type Error = C::Error;

    fn transmit(&mut self, frame: &SimpleFrame) -> ::nb::Result<Option<SimpleFrame>, C::Error> {
        self.2.borrow_mut().push((frame.data()[0], self.1.now()));
        self.0.transmit(frame)
    }

    fn receive(&mut self) -> ::nb::Result<SimpleFrame, C::Error> {
        self.0.receive()
    }
}

/// The motor may hear the lock, and hold its load until then.
#[test]
fn silent_motor_gets_the_time_to_lock_its_brake_before_a_restart() {
    let times = Rc::new(RefCell::new(Vec::new()));
    let sent = Rc::clone(&times);
    let (_bus, _, mut arm) = on_can(move |bus, clock, config| {
        let silent = |data: &mut Data| {
            if [0x9A, 0x78].contains(&data[0]) {
                data[0] = NO_ANSWER;
            }
        };
        CanMaster::<_, _, 4>::new(Noted(Says::new(bus, silent), clock.clone(), sent), clock, config)
    });
    let _restart = bring_up::restart(&mut arm, id(1), id(1));
    let times = times.borrow();
    let last = times.iter().rfind(|(byte, _)| *byte == 0x78).unwrap().1;
    let next = times.iter().find(|(byte, at)| *byte == 0x76 && *at > last).unwrap().1;
    assert!(next - last >= BRAKE_MOVES, "{:?}", next - last);
}

/// Its drive says that it is open until then.
#[test]
fn brake_has_its_time_to_lock() {
    let mut looks = None;
    let (bus, mut arm) = holding(move |data, _| match (data[0], &mut looks) {
        (0x78, _) => looks = Some(0),
        (0x9A, Some(looks)) => {
            data[3] = if *looks < 5 { OPEN } else { LOCKED };
            *looks += 1;
        }
        _ => {}
    });
    assert_eq!(bring_up::lock_brake(&mut arm, id(1)), Ok(()));
    assert_eq!(commanded(&bus), [0x78]);
}
