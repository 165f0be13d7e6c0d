//! A million requests in a hostile world, checked by an oracle that knows what really happened:
//!
//! - no request gets the answer to another, and each has an outcome;
//! - nothing moves a motor after its stop, and every stop is sent before anything else;
//! - every event is true, and every lost frame is counted once.
//!
//! The modules:
//!
//! - `scenarios`: what a run consists of. Each trouble of the injector alone, at several rates and with several numbers
//!   of motors. Then any combination of troubles, drawn by a seed.
//! - `hosts`: what runs the master: a loop that polls, or an async one. Of the drawn runs a quarter uses async loops in
//!   the world's executor, and another quarter async loops whose futures are dropped now and then.
//! - `world`: the bus, and how the master's computer treats it.
//! - `drives`: the drives and another master.
//! - `doubt`: whether an acknowledgement may pass for an echo.
//! - `callers`: when the master is asked, stopped and left alone.
//! - `asks`: what it is asked.
//! - `names`: how frames are distinguished.
//! - `truth`: what really happened.
//! - `stops`: when first stops were sent.
//! - `to_all`: commands to all motors, and their outcomes.
//! - `set_points`: what became of each set-point.
//! - `turning`: where shafts are, and what shows that turns are lost.
//! - `restarts`: what else shows that a motor has restarted.
//! - `bounds`: how long anything may take, and which time counts for that.
//! - `watch`: checks these bounds.
//! - `oracle`: checks each event against the truth.
//! - `sayings`: checks what a motor is reported to have said.
//! - `excuses`: what no master can know. Each case has a name, and is noted when it happens.
//!
//! Frames carry tokens, so each reply says to which command it belongs. A run that fails prints its seed.
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
