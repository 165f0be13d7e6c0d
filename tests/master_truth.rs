//! A million requests in a hostile world, checked by an oracle that knows what really happened:
//!
//! - No request gets the answer to another, and each has an outcome.
//! - Nothing moves a motor after its stop, and every stop is sent before anything else.
//! - Every event is true, and every lost frame is counted once.
//!
//! The modules:
//!
//! - `scenarios`: the runs. First each trouble of the injector alone, at several rates and with several numbers of
//!   motors. Then any combination of troubles, drawn by a seed.
//! - `hosts`: the loop that runs the master, polled or async. A quarter of the drawn runs uses async loops in the
//!   world's executor, and another quarter async loops whose futures are dropped now and then.
//! - `world`: the bus, and how the master's computer treats it.
//! - `drives`: the drives and another master.
//! - `doubt`: whether an acknowledgement may pass for an echo.
//! - `callers`: when callers ask, stop and leave the master alone.
//! - `asks`: what callers ask.
//! - `names`: how frames are distinguished.
//! - `truth`: what really happened.
//! - `stops`: when first stops were sent.
//! - `to_all`: commands to all motors, and their outcomes.
//! - `set_points`: what became of each set-point.
//! - `turning`: the angles of shafts, and what shows that turns are lost.
//! - `restarts`: what else shows that a motor has restarted.
//! - `bounds`: how long anything may take, and which time counts for that.
//! - `watch`: checks these bounds.
//! - `oracle`: checks each event against the truth.
//! - `sayings`: checks what the master reports that a motor has said.
//! - `excuses`: cases that no master can know. Each has a name and is noted when it happens.
//!
//! Frames carry tokens, so each reply shows to which command it belongs. A run that fails prints its seed.
//! `MASTER_TRUTH_SEED=N cargo test -p myactuator-tests --test master_truth alone` runs only that one.

mod master_truth {
    mod asks;
    mod bounds;
    mod callers;
    mod doubt;
    mod drives;
    mod excuses;
    mod frames;
    mod hosts;
    mod names;
    mod oracle;
    mod restarts;
    mod runs;
    mod sayings;
    mod scenarios;
    mod set_points;
    mod stops;
    mod to_all;
    mod truth;
    mod turning;
    mod watch;
    mod world;
}
