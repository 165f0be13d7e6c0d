//! Buses on Linux, real and simulated, for the loops of `myactuator_protocol_core::io`.
//!
//! [`AnyMaster::open`] opens whatever a [`BusAddress`] names, a [`BusAddress`] being read from one
//! string: `sim:4`, `can0`, `slcan:/dev/ttyACM0@1000000`, `rs485:/dev/ttyUSB0@115200,echo`.
//!
//! | bus | port |
//! |---|---|
//! | CAN interface of Linux | [`SocketCan`] |
//! | USB-CAN adapter that speaks SLCAN | [`Slcan`](slcan::Slcan) |
//! | RS485 adapter on a serial port | [`Rs485`] |
//!
//! None of them blocks; [`HostClock`] waits for them by `ppoll`.
//!
//! ```no_run
//! use myactuator_host_std::port::{AnyMaster, BusAddress};
//! use myactuator_protocol_core::MotorId;
//! use myactuator_protocol_core::command::ReadMultiTurnAngle;
//! use myactuator_protocol_core::io::Runner;
//!
//! let bus: BusAddress = "can0".parse()?;
//! let mut arm = AnyMaster::<8>::open(&bus)?;
//! let reading = arm.ask(MotorId::new(1)?, ReadMultiTurnAngle)?;
//! println!("{}", reading.angle.degrees());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod address;
mod any_master;
mod can;
mod clock;
mod error;
mod outage;
mod serial;
pub mod slcan;
mod tty;

pub use address::{BusAddress, NotAnAddress};
pub use any_master::AnyMaster;
pub use can::SocketCan;
pub use clock::HostClock;
pub use error::BusError;
pub use serial::Rs485;
