//! A million requests in a world that is not kind, against an oracle that knows what really happened: no
//! answer is given to the wrong request, none is left without an outcome, nothing moves a motor after its
//! stop, every stop goes before everything, every event is true, and every lost frame is counted once.
//!
//! - `scenarios`: what a run is made of. Each trouble of the injector by itself, at several rates and with
//!   several numbers of motors; then anything together with anything, drawn by a seed.
//! - `hosts`: what runs the master, a loop that polls or an async one; of the drawn runs a quarter is on
//!   async loops in the world's executor, and another on those whose futures are dropped now and then.
//! - `world`: the bus, and how the master's computer treats it. `drives`: the drives and another master.
//! - `doubt`: whether an acknowledgement may pass for an echo.
//! - `callers`: when the master is asked, stopped and left alone. `asks`: what it is asked.
//! - `names`: how frames are told apart. `truth`: what really happened. `stops`: when first stops went.
//!   `to_all`: what all are told at once, and what becomes of that.
//!   `set_points`: what became of each. `turning`: where shafts are, and what shows of turns that are lost.
//!   `restarts`: what else shows that a motor has restarted.
//! - `bounds`: how long anything may take at the most, and what time counts for it. `watch`: that it does.
//! - `oracle`: what must hold of each event by that; `sayings`: of what a motor is told to have said.
//! - `excuses`: what no master can know, each with its name, noted when it happens.
//!
//! Frames carry tokens, so that each reply says which command it was made for. A run that fails says its
//! seed. `MASTER_TRUTH_SEED=N cargo test -p myactuator-tests --test master_truth alone` runs that alone.

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
