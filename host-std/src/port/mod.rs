//! Real buses on Linux, for the loops of [`protocol::io`](crate::protocol::io). This module knows nothing of the
//! simulation; [`open`](crate::open) stands above both.
//!
//! | bus | port |
//! |---|---|
//! | CAN interface of Linux | [`SocketCan`] |
//! | USB-CAN adapter that speaks SLCAN | [`Slcan`] |
//! | RS485 adapter on a serial port | [`Rs485`] |
//!
//! Only [`Rs485`] blocks, for up to a second, if a port keeps what it was given. [`HostClock`] waits for a port with
//! `ppoll`, and [`HostWaker`] ends that wait.
//!
//! ```no_run
//! use myactuator_host_std::port::SocketCan;
//! use myactuator_host_std::protocol::MotorId;
//! use myactuator_host_std::protocol::command::ReadMultiTurnAngle;
//! use myactuator_host_std::protocol::io::{CanMaster, Runner};
//! use myactuator_host_std::protocol::master::Config;
//!
//! let can = SocketCan::open("can0")?;
//! let clock = can.clock()?;
//! let mut arm = CanMaster::<_, _, 8>::new(can, clock, Config::CAN);
//! let reading = arm.ask(MotorId::new(1)?, ReadMultiTurnAngle)?;
//! println!("{}", reading.angle.degrees());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod can;
mod clock;
mod drain;
mod error;
mod latency;
mod outage;
mod outbox;
mod serial;
mod slcan;
mod tty;

pub use can::SocketCan;
#[cfg(feature = "sim")]
pub(crate) use clock::since_boot;
pub use clock::{HostClock, HostWaker};
pub use error::PortError;
pub use latency::SlowAdapter;
pub use serial::Rs485;
pub use slcan::Slcan;
