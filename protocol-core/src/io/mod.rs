//! Thin loops that tie the master to embedded-can and embedded-io.
//!
//! | bus | loop |
//! |---|---|
//! | CAN, `embedded_can::nb` | [`CanMaster`] |
//! | CAN, `embedded_can::blocking` | [`CanMaster`] over [`BlockingCan`] |
//! | RS485, `embedded_io` | [`SerialMaster`] |
//! | RS485 with a direction pin | [`SerialMaster`] over [`HalfDuplex`] |
//!
//! All are [`Runner`]s: what works on one bus works on the other, [`bring_up`] for example.

pub mod bring_up;
mod can;
mod clock;
mod half_duplex;
mod runner;
mod serial;

pub use can::{BlockingCan, CanMaster};
pub use clock::{Clock, FnClock};
pub use half_duplex::{HalfDuplex, HalfDuplexError};
pub use runner::{CallError, Runner};
pub use serial::SerialMaster;
