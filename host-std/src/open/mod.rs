//! A master on the bus that one string names, real or simulated; the code after that is the same.
//!
//! This module stands above [`port`](crate::port) and [`sim`](crate::sim), which know nothing of each other.
//! [`AnyMaster::open`] opens what a [`BusAddress`] names: `sim:4`, `can0`,
//! `slcan:/dev/ttyACM0@1000000`, `rs485:/dev/ttyUSB0@115200,echo`.
//!
//! ```
//! use myactuator_host_std::open::{AnyMaster, BusAddress};
//! use myactuator_host_std::protocol::MotorId;
//! use myactuator_host_std::protocol::command::ReadMultiTurnAngle;
//! use myactuator_host_std::protocol::io::Runner;
//!
//! let bus: BusAddress = "sim:4".parse()?;
//! let mut arm = AnyMaster::<8>::open(&bus)?;
//! let reading = arm.ask(MotorId::new(1)?, ReadMultiTurnAngle)?;
//! assert_eq!(reading.angle.degrees(), 0.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod address;
mod any_master;
#[cfg(test)]
mod bursts;
mod error;

/// With this `share` measures how long something has waited.
pub(crate) use crate::port::since_boot;
pub use address::BusAddress;
pub use any_master::AnyMaster;
pub(crate) use any_master::Wake;
pub use error::BusError;
