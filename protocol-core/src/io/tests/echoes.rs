//! No echo passes for the confirmation of a stop, whatever the port, the adapter and the line do meanwhile.

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
