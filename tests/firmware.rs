//! End-to-end tests of the firmware of the emulated boards: a board's image runs in an emulator, with simulated drives
//! on its bus. They check both ends: what the firmware reports, and what the drives received and did.
//!
//! They need QEMU and Rust's target for the boards: `cargo test -p myactuator-tests --features emulator --test
//! firmware`. They run in real time, one after the other.

mod firmware {
    mod adapters;
    mod bus;
    mod drives;
    mod ends;
    mod motion;
    mod running;
}
