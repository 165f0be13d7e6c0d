//! Simulated drives on simulated buses: a robot on a laptop.
//!
//! A [`Fleet`] puts whole drives, each with its physics and memory, on one bus. Masters attach with
//! [`CanFleet::master`] or [`LineFleet::master`] and run unchanged, async ones too. A [`Robot`] is several such
//! buses from one file. A [`PlannedFault`] says what is to go wrong, and when. With [`BusFleet::watch`] a test checks
//! that no load falls, whatever goes wrong.
//!
//! | module | for |
//! |---|---|
//! | [`bus`] | the simulated buses: CAN and RS485, in virtual or real time |
//! | [`plant`] | the physics behind a simulated drive |
//! | [`mechanics`] | other movers of the shafts than the motors alone: coupled joints, physics of your own |
//! | [`memory`] | what a simulated drive remembers while it is off |
//!
//! This module knows nothing of real buses. [`serve`](crate::serve) offers simulated drives to other programs, and
//! [`open`](crate::open) makes them answer to an address such as `sim:4`.
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
//!
//! # Tasks
//! Async masters ([`CanFleet::async_master`], [`LineFleet::async_master`]) run in
//! [`BusFleet::block_on`], as they do under embassy. Time stands still while any task has something to
//! do, and then goes on to the next event that a task waits for:
//!
//! ```
//! use embassy_futures::join::join;
//! use myactuator_host_std::protocol::MotorId;
//! use myactuator_host_std::protocol::command::{ReadMultiTurnAngle, ReadStatus1};
//! use myactuator_host_std::protocol::io::AsyncRunner;
//! use myactuator_host_std::sim::{Fleet, bus};
//!
//! let motor = MotorId::new(1)?;
//! let (arm, hand) = (Fleet::new(6).on_can(1_000_000)?, Fleet::new(2).on_rs485(115_200)?);
//! let (mut arm_bus, mut hand_bus) = (arm.async_master::<8>(), hand.async_master::<2>());
//!
//! let status = arm.block_on(arm_bus.ask(motor, ReadStatus1))?;
//! assert_eq!(status.voltage.volts(), 48.0);
//!
//! // A task on each of two buses.
//! let both = join(arm_bus.ask(motor, ReadMultiTurnAngle), hand_bus.ask(motor, ReadMultiTurnAngle));
//! let (of_arm, of_hand) = bus::block_on(&[&arm.world, &hand.world], both);
//! assert_eq!(of_arm?.angle, of_hand?.angle);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! A blocking master waits only on its own bus; time stands still on the others. To step several buses by hand, bring
//! them to the same time after each round: `hand.world.run_until(arm.world.now())`. To work on two buses at the same
//! time, use two tasks.

pub mod bus;
mod condition;
mod fleet;
mod log;
pub mod mechanics;
pub mod memory;
pub(crate) mod model_file;
mod planned_fault;
pub mod plant;
mod quirk_names;
mod robot;
mod seat;
mod shaft;
mod shared_supply;
mod strike;
#[cfg(test)]
mod tests;
mod watch;

pub use condition::{Condition, ConditionQuantity};
pub use fleet::{
    BusFleet, CanFleet, DriveHandle, Fleet, FleetError, LineFleet, MotorSetup, SimulatedDrive,
};
pub use log::{DriveLog, FrameFault, LogEvent, LogRecord};
pub use model_file::named_model;
pub use planned_fault::{Chance, FaultKind, PlannedFault, parse_time};
pub use quirk_names::{quirk_names, quirks_named};
pub use robot::{Adapter, MechanicsProcess, Robot, RobotBus, RobotError};
pub use shared_supply::SharedSupply;
