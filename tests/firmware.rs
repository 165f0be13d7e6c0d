//! The firmware of the emulated boards, end to end: the image that a board would run, in an emulator, with
//! simulated drives on its bus. Both ends are looked at: what the firmware reports, and what the drives
//! heard and did.
//!
//! These need QEMU and Rust's target for the boards: `cargo test -p myactuator-tests --features emulator
//! --test firmware`. Each takes the time that it is about, one after the other.

mod firmware {
    mod adapters;
    mod bus;
    mod drives;
    mod ends;
    mod motion;
    mod running;
}
