//! The drive as a state machine: the same frames, seen from the other end.

mod plant;

pub use plant::{Actuation, Measurement, Plant};
