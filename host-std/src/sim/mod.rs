//! Simulated drives on simulated buses: a robot on a laptop.
//!
//! A [`Fleet`] puts whole drives, each with its physics and memory, on one bus. Masters attach with
//! [`CanFleet::master`] or [`LineFleet::master`] and run unchanged.
//!
//! | module | for |
//! |---|---|
//! | [`bus`] | the simulated buses: CAN and RS485, in virtual or real time |
//! | [`plant`] | the physics behind a simulated drive |
//! | [`memory`] | what a simulated drive remembers over power-off |
//!
//! Knows nothing of real buses: what offers simulated drives to other programs is
//! [`serve`](crate::serve), and what makes them answer to an address such as `sim:4` is
//! [`open`](crate::open).
//!
//! ```
//! use myactuator_host_std::sim::Fleet;
//! use myactuator_host_std::protocol::MotorId;
//! use myactuator_host_std::protocol::command::ReadMultiTurnAngle;
//! use myactuator_host_std::protocol::io::Runner;
//!
//! let fleet = Fleet::new(4).on_can(1_000_000)?;
//! let mut master = fleet.master::<8>();
//! let reading = master.ask(MotorId::new(3)?, ReadMultiTurnAngle)?;
//! assert_eq!(reading.angle.degrees(), 0.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod bus;
mod fleet;
pub mod memory;
pub mod plant;
mod seat;

pub use fleet::{BusFleet, CanFleet, DriveHandle, Fleet, FleetError, LineFleet, SimulatedDrive};
