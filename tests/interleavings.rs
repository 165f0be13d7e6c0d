//! Searches every interleaving of what callers do and what a bus does, on CAN and on a line, with one and with two
//! motors, up to a number of calls, faults and steps. The properties of the master must hold in every state. Each
//! search has its own set of calls, since all calls together would be too many.
//!
//! The master is cloned and run, breadth first, against the model of `world`:
//!
//! - `callers`: what callers do.
//! - `state`: what may happen.
//! - `oracle`: what must hold.
//! - `echoes`: the same for the loop over RS485, with an adapter.
//! - `longer`: longer random runs of the same steps.
//! - `calls`: random runs of any calls. Those that fail are shrunk.
//!
//! `cargo test -p myactuator-tests --test interleavings -- --nocapture` prints how many states there were. With
//! `--ignored` it searches further, for half an hour.

mod interleavings {
    pub(crate) mod callers;
    mod calls;
    mod canonical;
    mod echoes;
    mod foreign;
    mod longer;
    mod oracle;
    pub(crate) mod search;
    pub(crate) mod state;
    pub(crate) mod world;
}

use interleavings::callers::Call;
use interleavings::state::{Bounds, State};
use interleavings::world::Medium;
use myactuator_protocol_core::master::StopKind::{Hold, Off};

/// One motor: everything.
const ONE: Bounds = Bounds {
    name: "everything",
    medium: Medium::Can,
    calls: &[
        Call::Read(0),
        Call::Move(0),
        Call::Shutdown(0),
        Call::Torque(0),
        Call::Motion(0),
        Call::StopOne(0, Hold),
        Call::StopAll(Off),
        Call::Lift,
        Call::Broadcast,
    ],
    most_calls: 2,
    faults: 2,
    depth: 60,
};

/// Two motors: how one may affect the other.
const TWO: Bounds = Bounds {
    name: "reads, motion mode, stops",
    medium: Medium::Can,
    calls: &[
        Call::Read(0),
        Call::Motion(0),
        Call::Motion(1),
        Call::StopOne(0, Hold),
        Call::StopOne(1, Hold),
        Call::StopAll(Off),
        Call::Lift,
        Call::Broadcast,
    ],
    most_calls: 2,
    faults: 1,
    depth: 60,
};

/// Those of them that may affect the other motor, or both.
const TWO_AT_ONCE: &[Call] = &[
    Call::Motion(0),
    Call::Motion(1),
    Call::StopOne(0, Hold),
    Call::StopAll(Off),
    Call::Lift,
    Call::Broadcast,
];

/// Commands to all: they may end motion, or move a motor that is stopped.
const ALL: Bounds = Bounds {
    name: "commands to all",
    medium: Medium::Can,
    calls: &[
        Call::Move(0),
        Call::Shutdown(0),
        Call::Torque(0),
        Call::Motion(0),
        Call::StopOne(0, Hold),
        Call::StopAll(Off),
        Call::Lift,
        Call::Broadcast,
        Call::TorqueAll,
        Call::ShutdownAll,
    ],
    ..ONE
};

/// Those of them that the search for everything leaves out, with what they may undo.
const TO_ALL: &[Call] = &[
    Call::Move(0),
    Call::Torque(0),
    Call::StopOne(0, Hold),
    Call::StopAll(Off),
    Call::Lift,
    Call::TorqueAll,
    Call::ShutdownAll,
];

/// Both kinds of stops, of one and of all, and the commands to one and to all that do the same.
const KINDS: Bounds = Bounds {
    name: "both kinds of stops",
    medium: Medium::Can,
    calls: &[
        Call::Torque(0),
        Call::Shutdown(0),
        Call::Hold(0),
        Call::StopOne(0, Hold),
        Call::StopOne(0, Off),
        Call::StopAll(Hold),
        Call::StopAll(Off),
        Call::LiftOf(0),
        Call::ShutdownAll,
        Call::ShutdownAllUnheard,
        Call::HoldAll,
    ],
    most_calls: 3,
    faults: 0,
    depth: 60,
};

/// Those of them that name the motor.
const KINDS_FOR_ONE: &[Call] = &[
    Call::Torque(0),
    Call::Shutdown(0),
    Call::Hold(0),
    Call::StopOne(0, Hold),
    Call::StopOne(0, Off),
    Call::LiftOf(0),
];

/// A stop of one motor, and a command to all that stops in the other way.
const ENDS: Bounds = Bounds {
    name: "stops of one and of all",
    calls: &[Call::Torque(0), Call::StopOne(0, Hold), Call::ShutdownAll],
    faults: 1,
    depth: 13,
    ..KINDS
};

/// Stops that are lifted and called again, with and without motion between them.
const LIFTS: Bounds = Bounds {
    name: "stops that are lifted",
    calls: &[Call::Torque(0), Call::StopOne(0, Hold), Call::Lift],
    most_calls: 4,
    faults: 1,
    ..KINDS
};

/// Frames in mailboxes while the bus is cut.
const CUT: Bounds = Bounds {
    name: "a bus that is cut",
    medium: Medium::CanThatIsCut,
    calls: &[Call::Torque(0), Call::StopOne(0, Hold), Call::BusDown],
    most_calls: 2,
    faults: 1,
    depth: 60,
};

const CUT_FOR_LONG: Bounds = Bounds {
    calls: &[
        Call::Torque(0),
        Call::Move(0),
        Call::TorqueAll,
        Call::StopOne(0, Hold),
        Call::StopAll(Off),
        Call::ShutdownAll,
        Call::BusDown,
    ],
    ..CUT
};

/// A line: one exchange at a time.
const LINE: Bounds = Bounds {
    name: "a line",
    medium: Medium::Line,
    calls: &[
        Call::Read(0),
        Call::Move(0),
        Call::Shutdown(0),
        Call::Torque(0),
        Call::StopOne(0, Hold),
        Call::StopOne(0, Off),
        Call::StopAll(Hold),
        Call::StopAll(Off),
        Call::Lift,
        Call::Broadcast,
        Call::TorqueAll,
        Call::ShutdownAll,
        Call::ShutdownAllUnheard,
        Call::HoldAll,
    ],
    most_calls: 3,
    faults: 1,
    depth: 60,
};

/// Two motors on a line.
const LINE_OF_TWO: Bounds = Bounds {
    name: "a line of two",
    calls: &[
        Call::Read(0),
        Call::Torque(0),
        Call::Torque(1),
        Call::StopOne(0, Hold),
        Call::StopOne(1, Off),
        Call::StopAll(Off),
        Call::LiftOf(1),
        Call::ShutdownAllUnheard,
    ],
    ..LINE
};

fn search<const N: usize>(bounds: &Bounds) {
    let &Bounds { name, most_calls, faults, depth, .. } = bounds;
    let name = format!("{name}: {N} motor(s), {most_calls} calls, {faults} faults");
    interleavings::search::search(&name, State::<N>::new(bounds), depth);
}

#[test]
fn one_motor() {
    search::<1>(&Bounds { faults: 1, ..ONE });
}

#[test]
fn one_motor_and_commands_to_all() {
    search::<1>(&Bounds { faults: 1, calls: TO_ALL, ..ALL });
}

#[test]
fn two_motors() {
    search::<2>(&Bounds { calls: TWO_AT_ONCE, ..TWO });
}

#[test]
fn both_kinds_of_stops() {
    search::<1>(&Bounds { calls: KINDS_FOR_ONE, most_calls: 2, faults: 1, ..KINDS });
    search::<1>(&Bounds { depth: 12, ..ENDS });
}

#[test]
fn stops_that_are_lifted() {
    search::<1>(&Bounds { most_calls: 3, ..LIFTS });
}

#[test]
fn a_cut_bus() {
    search::<1>(&CUT);
}

#[test]
fn a_line() {
    search::<1>(&Bounds { most_calls: 2, ..LINE });
    search::<2>(&Bounds { most_calls: 2, ..LINE_OF_TWO });
}

#[test]
#[ignore = "takes minutes"]
fn one_motor_for_long() {
    search::<1>(&ONE);
    search::<1>(&Bounds { most_calls: 3, faults: 0, ..ONE });
    search::<1>(&Bounds { most_calls: 3, faults: 1, ..ONE });
}

#[test]
#[ignore = "takes minutes"]
fn commands_to_all_for_long() {
    search::<1>(&ALL);
    search::<1>(&Bounds { most_calls: 3, faults: 0, ..ALL });
}

#[test]
#[ignore = "takes minutes"]
fn two_motors_for_long() {
    search::<2>(&TWO);
    search::<2>(&Bounds { most_calls: 3, faults: 0, ..TWO });
}

#[test]
#[ignore = "takes minutes"]
fn stops_for_long() {
    search::<1>(&LIFTS);
    search::<1>(&Bounds { most_calls: 2, faults: 1, ..KINDS });
    search::<1>(&KINDS);
    search::<1>(&ENDS);
}

#[test]
#[ignore = "takes minutes"]
fn a_cut_bus_for_long() {
    search::<1>(&CUT_FOR_LONG);
}

#[test]
#[ignore = "takes minutes"]
fn a_line_for_long() {
    search::<1>(&LINE);
    search::<2>(&LINE_OF_TWO);
}
