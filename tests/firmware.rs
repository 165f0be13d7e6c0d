//! The firmware of the emulated boards, end to end: the image for a board runs in an emulator, with simulated drives on
//! its bus. Both ends are checked: what the firmware reports, and what the drives heard and did.
//!
//! These need QEMU and Rust's target for the boards: `cargo test -p myactuator-tests --features emulator --test
//! firmware`. They run in real time, one after the other.

mod firmware {
    mod adapters;
    mod bus;
    mod drives;
    mod ends;
    mod motion;
    mod running;
}
