//! The master against simulated drives. What takes long is a program of its own, `master_truth`.

mod masters {
    mod application;
    mod bring_up;
    mod dead_motors;
    mod losses;
    mod streams;
    mod tasks;
    mod ways;
}
