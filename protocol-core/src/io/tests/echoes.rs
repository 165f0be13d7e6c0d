//! No echo passes for the confirmation of a stop, whatever the port, the adapter and the line do meanwhile.

use std::vec::Vec;

use super::id;
use super::world::{TestClock, TestSerial};
use crate::command::{ReadMultiTurnAngle, ReadStatus1};
use crate::io::{Runner, SerialMaster};
use crate::master::{Config, Event, StopKind};
use crate::time::Duration;

type Arm = SerialMaster<TestSerial, TestClock, 8>;

/// A line on which motors 1 to 3 answer, by an adapter that echoes, which the loop was told or not.
fn echoing(is_told: bool) -> (TestSerial, Arm) {
    let clock = TestClock::default();
    let port = TestSerial::new(&clock);
    port.state().echoes = true;
    (port.clone(), SerialMaster::new(port, clock, Config::rs485(115_200, is_told)))
}

/// Runs for so long, whatever fails, and gives how many stops were confirmed.
fn confirmations(arm: &mut Arm, micros: u64) -> usize {
    let end = arm.now() + Duration::from_micros(micros);
    let mut confirmed = 0;
    while arm.now() < end {
        let note = |event| confirmed += usize::from(matches!(event, Event::StopConfirmed { .. }));
        let _ = arm.run_until(end, note);
    }
    confirmed
}

#[test]
fn what_the_port_refuses_makes_no_earlier_echo_pass_for_a_confirmation() {
    for fails in [false, true] {
        let (port, mut arm) = echoing(true);
        port.state().hands_over_every = 16_000;
        // Nobody is there.
        arm.master().stop(id(8), StopKind::Hold).unwrap();
        arm.master().stop(id(9), StopKind::Hold).unwrap();
        // A stop is taken; then the port takes nothing until shortly before its echo comes.
        let mut confirmed = confirmations(&mut arm, 5_000);
        (port.state().takes_nothing, port.state().write_fails) = (!fails, fails);
        confirmed += confirmations(&mut arm, 10_900);
        (port.state().takes_nothing, port.state().write_fails) = (false, false);
        assert_eq!(confirmed + confirmations(&mut arm, 500_000), 0, "fails: {fails}");
    }
}

#[test]
fn what_the_port_refuses_makes_no_confirmation_pass_for_its_echo() {
    let (port, mut arm) = echoing(true);
    port.state().takes_nothing = true;
    arm.master().stop(id(1), StopKind::Hold).unwrap();
    confirmations(&mut arm, 8_000);
    port.state().takes_nothing = false;
    assert_eq!(confirmations(&mut arm, 5_000), 1, "by the first that it takes");
}

#[test]
fn echoes_that_a_cut_takes_do_not_show_that_there_are_none() {
    let (port, mut arm) = echoing(false);
    arm.ask(id(1), ReadMultiTurnAngle).unwrap();
    port.state().is_cut = true;
    for _ in 0..5 {
        assert!(arm.ask(id(1), ReadStatus1).is_err());
        confirmations(&mut arm, 150_000);
    }
    assert!(arm.ask(id(1), ReadMultiTurnAngle).is_err());
    port.state().is_cut = false;
    assert!(!arm.stop(id(9), StopKind::Hold), "nobody is there");
}

#[test]
fn a_line_that_was_dead_when_it_was_opened_is_asked_again() {
    for cut_for in (0..60_000).step_by(700) {
        let (port, mut arm) = echoing(false);
        port.state().is_cut = true;
        assert!(arm.ask(id(9), ReadMultiTurnAngle).is_err());
        arm.master().stop(id(9), StopKind::Hold).unwrap();
        confirmations(&mut arm, cut_for);
        port.state().is_cut = false;
        assert_eq!(confirmations(&mut arm, 500_000), 0, "cut for {cut_for} us");
    }
}

#[test]
fn what_is_lost_while_reading_fails_shows_nothing() {
    for fails_at in [0, 1, 25, 30] {
        for fails_for in 1..100 {
            let (port, mut arm) = echoing(false);
            arm.master().stop(id(9), StopKind::Hold).unwrap();
            let mut confirmed = 0;
            for tenth in 0..300 {
                port.state().read_fails = (fails_at..fails_at + fails_for).contains(&tenth);
                if port.state().read_fails {
                    port.lose();
                }
                confirmed += confirmations(&mut arm, 100);
            }
            assert_eq!(confirmed, 0, "{fails_for} from {fails_at} on: nobody is there");
        }
    }
}

#[test]
fn a_stop_leaves_while_reading_fails_behind_one_frame_each() {
    let (port, mut arm) = echoing(false);
    port.state().read_fails = true;
    arm.master().stop(id(9), StopKind::Hold).unwrap();
    confirmations(&mut arm, 100_000);
    let sent: Vec<_> = port.written().chunks(13).map(|frame| frame[1]).collect();
    assert!(sent.len() > 4);
    assert_eq!(sent[..3], [33, 33, 9]);
    assert!(sent[3..].chunks_exact(2).all(|pair| pair == [33, 9]), "{sent:?}");
}

/// How many frames have been sent that show an echo.
fn probes(port: &TestSerial) -> usize {
    port.written().chunks(13).filter(|frame| frame[1] == 33).count()
}

#[test]
fn a_line_on_which_motors_answer_is_asked_no_more_until_a_look_at_it_fails() {
    let (port, mut arm) = echoing(false);
    port.state().echoes = false;
    for _ in 0..5 {
        arm.ask(id(1), ReadMultiTurnAngle).unwrap();
        assert!(arm.stop(id(1), StopKind::Hold));
        arm.master().lift_stop();
    }
    assert_eq!(probes(&port), 2);
    port.state().read_fails = true;
    confirmations(&mut arm, 1_000);
    port.state().read_fails = false;
    for _ in 0..5 {
        arm.ask(id(1), ReadMultiTurnAngle).unwrap();
    }
    // Once more when something was heard behind the first.
    assert_eq!(probes(&port), 4);
}

#[test]
fn stops_are_confirmed_on_a_line_on_which_nothing_else_was_heard() {
    let (port, mut arm) = echoing(false);
    port.state().echoes = false;
    // Motors 1 to 3 get their power late.
    port.state().is_cut = true;
    (1..=3).for_each(|motor| arm.master().stop(id(motor), StopKind::Hold).unwrap());
    assert_eq!(confirmations(&mut arm, 60_000), 0);
    port.state().is_cut = false;
    assert_eq!(confirmations(&mut arm, 60_000), 3);
}

#[test]
fn echoes_that_pile_up_while_reading_fails_confirm_nothing() {
    for is_told in [false, true] {
        for motors in 1..=4 {
            for fails_for in [20, 50, 100, 150, 200, 300, 400] {
                let (port, mut arm) = echoing(is_told);
                // Nobody is there.
                (6..6 + motors).for_each(|it| arm.master().stop(id(it), StopKind::Hold).unwrap());
                port.state().read_fails = true;
                let mut confirmed = confirmations(&mut arm, fails_for * 1_000);
                port.state().read_fails = false;
                confirmed += confirmations(&mut arm, 500_000);
                assert_eq!(confirmed, 0, "{is_told}, {motors} motors, {fails_for} ms");
            }
        }
    }
}
