//! The searches: adapters, the motors that are there, calls and faults.

use super::super::search::{Searched as _, search};
use super::Call::{Angle, Lift, Lock, Status, Stop, StopAll};
use super::Fault::{
    CutShort, Deaf, Double, Halt, HaltAndHold, Harm, Late, Lose, LoseMaster, ReadFails,
};
use super::Step::{self, Arrive, Poll, Wait};
use super::{Adapter, Fault, State};

const ANY_FAULT: &[Fault] =
    &[Deaf, CutShort, Lose, Harm, Double, Late, ReadFails, Halt, HaltAndHold, LoseMaster(0)];

/// Motor 1 is there and motor 2 is not. The adapter echoes, but the loop was not configured for that.
const UNTOLD: Adapter = Adapter {
    name: "an echo that nobody told of",
    echoes: true,
    is_told: false,
    is_there: [true, false],
    calls: &[
        Angle(0),
        Angle(1),
        Status(0),
        Status(1),
        Lock(0),
        Lock(1),
        Stop(0),
        Stop(1),
        StopAll,
        Lift,
    ],
    most_calls: 2,
    faults: ANY_FAULT,
    most_faults: 1,
    depth: 20,
};

/// Nobody is there: whatever comes back is an echo.
const NOBODY: Adapter = Adapter {
    name: "an echo that nobody told of, and no motor",
    is_there: [false, false],
    calls: &[Angle(0), Status(0), Status(1), Stop(1)],
    faults: &[Deaf, CutShort, Lose, Harm, Late, ReadFails, Halt, HaltAndHold],
    ..UNTOLD
};

const TOLD: Adapter = Adapter { name: "an echo that was told of", is_told: true, ..UNTOLD };

const QUIET: Adapter = Adapter {
    name: "no echo",
    echoes: false,
    calls: &[Lock(0), Stop(0), Stop(1), StopAll],
    ..UNTOLD
};

/// Noise that must not hide an echo. (Four answers in a row without an echo show that there is none.)
const NOISE: Adapter = Adapter {
    name: "an echo that is lost",
    calls: &[Lock(0), Stop(0), Stop(1)],
    faults: &[Lose, Late],
    most_faults: 3,
    ..UNTOLD
};

/// Only echoes come, although a motor is there: it hears no commands.
const DEAF: Adapter =
    Adapter { name: "a motor that is deaf", faults: &[Lose, Deaf], most_faults: 3, ..NOISE };

/// The port fails so often that it would be enough, if losing received bytes showed that there is no echo.
const FAILS: Adapter = Adapter {
    name: "a port that fails",
    calls: &[Status(0), Stop(1)],
    most_calls: 5,
    faults: &[ReadFails],
    most_faults: 4,
    depth: 26,
    ..UNTOLD
};

/// The motor hands commands back, as an echo would.
const LOSES_MASTER: Adapter = Adapter {
    name: "a motor that loses its master",
    calls: &[Status(0), Stop(0)],
    most_calls: 3,
    faults: &[LoseMaster(0), Lose],
    most_faults: 2,
    ..QUIET
};

fn run(adapter: &'static Adapter) {
    let &Adapter { name, most_calls, most_faults, depth, .. } = adapter;
    search(
        &format!("{name}: {most_calls} calls, {most_faults} faults"),
        State::new(adapter),
        depth,
    );
}

#[test]
fn an_echo_passes_for_no_answer_and_no_answer_for_an_echo() {
    run(&UNTOLD);
    run(&NOBODY);
    run(&TOLD);
    run(&QUIET);
    run(&NOISE);
    run(&DEAF);
    run(&FAILS);
    run(&LOSES_MASTER);
}

/// What the search for long has found, the first answer of a motor: it came behind the second question, where the echo
/// of that is looked for.
#[test]
fn a_late_answer_that_passes_for_an_echo_uses_up_no_attempts() {
    let mut state = State::new(&Adapter { most_faults: 2, ..UNTOLD });
    let mut steps = vec![Step::Call(Angle(1))];
    steps.extend([Poll, Arrive, Poll, Wait].repeat(4));
    steps.extend([Poll, Arrive, Step::Call(Angle(0))]);
    steps.extend([Poll, Wait, Poll, Arrive, Poll, Wait, Poll, Wait, Poll, Arrive]);
    for step in steps {
        assert_eq!(state.step(step), Ok(true), "{step:?}");
    }
    assert_eq!(state.check_end(), Ok(()));
}

#[test]
#[ignore = "takes minutes"]
fn an_echo_passes_for_no_answer_and_no_answer_for_an_echo_for_long() {
    const FOR_LONG: Adapter = Adapter { most_faults: 2, depth: 30, ..UNTOLD };
    run(&FOR_LONG);
    const TOLD_FOR_LONG: Adapter = Adapter { most_faults: 2, depth: 40, ..TOLD };
    run(&TOLD_FOR_LONG);
    const QUIET_FOR_LONG: Adapter = Adapter { most_faults: 2, depth: 30, ..QUIET };
    run(&QUIET_FOR_LONG);
    const BOTH: Adapter = Adapter {
        is_there: [true, true],
        calls: &[Lock(0), Stop(1), StopAll, Lift],
        most_calls: 3,
        depth: 30,
        ..UNTOLD
    };
    const BOTH_QUIET: Adapter = Adapter { name: QUIET.name, echoes: false, ..BOTH };
    run(&BOTH);
    run(&BOTH_QUIET);
    const NOISE_FOR_LONG: Adapter = Adapter { faults: ANY_FAULT, depth: 22, ..NOISE };
    run(&NOISE_FOR_LONG);
    const MORE_CALLS: Adapter = Adapter {
        calls: &[Lock(0), Lock(1), Stop(1), Lift],
        most_calls: 4,
        faults: &[Lose],
        depth: 40,
        ..NOISE
    };
    run(&MORE_CALLS);
}
