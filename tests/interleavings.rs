//! Every interleaving of what callers do and what a bus does to it, with one and with two motors, up to
//! a number of calls, of faults and of steps: what must hold of the master holds in every state.
//!
//! The engine is cloned and tried on, breadth first, against the model of `world`. `state` says what may
//! happen and what must hold. `cargo test -p myactuator-tests --test interleavings -- --nocapture` prints
//! how many states there were; with `--ignored` it goes further, which takes ten minutes. `longer` draws
//! longer runs of the same by chance, and `calls` any calls at all; what fails is shrunk.

mod interleavings {
    mod calls;
    mod canonical;
    mod longer;
    pub(crate) mod search;
    pub(crate) mod state;
    mod world;
}

use interleavings::search::{Bounds, search};
use interleavings::state::Call;

/// One motor: everything.
const ONE: Bounds = Bounds {
    name: "everything",
    calls: &[
        Call::Read(0),
        Call::Move(0),
        Call::Shutdown(0),
        Call::Torque(0),
        Call::Motion(0),
        Call::StopOne(0),
        Call::StopAll,
        Call::Lift,
        Call::Broadcast,
    ],
    most_calls: 2,
    faults: 2,
    depth: 60,
};

/// Two motors: what one may do to the other.
const TWO: Bounds = Bounds {
    name: "reads, motion mode, stops",
    calls: &[
        Call::Read(0),
        Call::Motion(0),
        Call::Motion(1),
        Call::StopOne(0),
        Call::StopOne(1),
        Call::StopAll,
        Call::Lift,
        Call::Broadcast,
    ],
    most_calls: 2,
    faults: 1,
    depth: 60,
};

/// Commands to all, which may move what is stopped, and end what moves.
const ALL: Bounds = Bounds {
    name: "commands to all",
    calls: &[
        Call::Move(0),
        Call::Shutdown(0),
        Call::Torque(0),
        Call::Motion(0),
        Call::StopOne(0),
        Call::StopAll,
        Call::Lift,
        Call::Broadcast,
        Call::TorqueAll,
        Call::ShutdownAll,
    ],
    ..ONE
};

#[test]
fn one_motor() {
    search::<1>(&ONE);
}

#[test]
fn one_motor_and_more_calls() {
    search::<1>(&Bounds { most_calls: 3, faults: 0, ..ONE });
}

#[test]
fn one_motor_and_commands_to_all() {
    search::<1>(&Bounds { faults: 1, ..ALL });
    search::<1>(&Bounds { most_calls: 3, faults: 0, ..ALL });
}

#[test]
fn two_motors() {
    search::<2>(&TWO);
}

#[test]
#[ignore = "takes minutes"]
fn one_motor_for_long() {
    search::<1>(&Bounds { most_calls: 3, faults: 1, ..ONE });
}

#[test]
#[ignore = "takes minutes"]
fn commands_to_all_for_long() {
    search::<1>(&ALL);
}

#[test]
#[ignore = "takes minutes"]
fn two_motors_for_long() {
    search::<2>(&Bounds { most_calls: 3, faults: 0, ..TWO });
}
