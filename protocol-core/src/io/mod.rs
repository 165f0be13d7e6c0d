//! Thin loops that tie the state machines to embedded-can and embedded-io.

mod clock;

pub use clock::Clock;
