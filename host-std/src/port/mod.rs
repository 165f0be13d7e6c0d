//! Real buses on Linux, for the loops of [`protocol::io`](crate::protocol::io). Knows nothing of the
//! simulation; [`open`](crate::open) is above both.
//!
//! | bus | port |
//! |---|---|
//! | CAN interface of Linux | [`SocketCan`] |
//! | USB-CAN adapter that speaks SLCAN | [`Slcan`] |
//! | RS485 adapter on a serial port | [`Rs485`] |
//!
//! None of them blocks, but for [`Rs485`], which waits for up to a second where a port keeps what it is given;
//! [`HostClock`] waits for them by `ppoll`, and [`HostWaker`] ends that.
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
