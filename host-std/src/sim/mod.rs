//! Simulated drives on simulated buses: a robot on a laptop.
//!
//! A [`Fleet`] puts whole drives, each with its physics and memory, on one bus. Masters attach with
//! [`CanFleet::master`] or [`LineFleet::master`] and run unchanged. Other programs come in by a
//! [`serve::Server`].
//!
//! ```
//! use myactuator_host_std::sim::Fleet;
//! use myactuator_protocol_core::MotorId;
//! use myactuator_protocol_core::command::ReadMultiTurnAngle;
//! use myactuator_protocol_core::io::Runner;
//!
//! let fleet = Fleet::new(4).on_can(1_000_000)?;
//! let mut master = fleet.master::<8>();
//! let reading = master.ask(MotorId::new(3)?, ReadMultiTurnAngle)?;
//! assert_eq!(reading.angle.degrees(), 0.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod fleet;
mod memory;
mod planned_fault;
mod seat;
pub mod serve;

pub use fleet::{
    CanFleet, DriveHandle, Fleet, FleetError, LineFleet, SimulatedDrive, parameters_of,
};
pub use memory::{DriveMemory, MemoryError};
pub use planned_fault::{Chance, FaultKind, NotAFault, PlannedFault};
pub use seat::Seat;
