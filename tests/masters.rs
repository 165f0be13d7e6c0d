//! The master with simulated drives. The program `master_truth` has the long runs.

mod masters {
    mod application;
    mod bring_up;
    mod dead_motors;
    mod keep_alive;
    mod losses;
    mod streams;
    mod tasks;
    mod ways;
}
