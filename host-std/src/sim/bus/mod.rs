//! Simulated buses: CAN and RS485 as they behave on the wire, with ports of masters and drives on them.
//!
//! This is the lowest part of [`sim`](super): it carries frames for every [`Node`], and knows nothing of drives and
//! physics.
//!
//! A [`World`] owns a clock, one bus and everything that is on it. It is a chain of discrete events:
//! between two of them nothing happens, so a second of bus traffic is simulated in milliseconds, and
//! the same seed gives the same run, bit for bit.
//!
//! - [`can`]: arbitration, frame lengths by content, queues, error counters, bus-off.
//! - [`rs485`]: a half-duplex line with byte times, direction switches, collisions and echo.
//! - Bit rates: a station has the rate of the bus until it is [given another](World::set_bit_rate) or its node
//!   [takes one](Node::bit_rate). Stations at different rates do not understand each other: on CAN they
//!   break each other's frames, on RS485 they read noise.
//! - [`faults`]: seeded loss, corruption, duplicates, delay, reordering, babble; wires cut and
//!   mended, participants reset and slowed down.
//! - [`trace`]: what was on the wire and what became of it, for tests.
//!
//! Drives take part as [`Node`]s. Masters get ports, [`can::CanPort`] and [`rs485::SerialPort`],
//! that implement the traits of embedded-can and embedded-io, blocking and async, and a [`SimClock`].
//! The same world runs against the wall clock after [`World::in_real_time`]. Async code runs in
//! [`World::block_on`], on several buses at once in [`block_on`].
//!
//! ```
//! use embedded_can::{Frame, StandardId, nb::Can};
//! use myactuator_host_std::sim::bus::{Node, can::CanWorld};
//! use myactuator_host_std::protocol::time::{Duration, Instant};
//! use myactuator_host_std::protocol::wire::can::SimpleFrame;
//!
//! /// Sends back whatever it hears.
//! struct Mirror(Option<SimpleFrame>);
//!
//! impl Node<SimpleFrame> for Mirror {
//!     fn handle_frame(&mut self, frame: &SimpleFrame, _: Instant) {
//!         self.0 = Some(*frame);
//!     }
//!     fn poll_transmit(&mut self, _: Instant) -> Option<SimpleFrame> {
//!         self.0.take()
//!     }
//!     fn poll_at(&self) -> Option<Instant> {
//!         None
//!     }
//! }
//!
//! let world = CanWorld::new(1_000_000, 1);
//! world.attach(Mirror(None));
//! let mut port = world.port();
//! let frame = SimpleFrame::new(StandardId::new(0x141).unwrap(), &[0x55; 8]).unwrap();
//! port.transmit(&frame).unwrap();
//! world.run_for(Duration::from_millis(1));
//! assert_eq!(port.receive(), Ok(frame));
//! ```

pub mod can;
mod executor;
pub mod faults;
mod kernel;
mod medium;
mod nanos;
mod node;
mod port;
mod random;
pub mod rs485;
pub mod trace;
mod waiting;
mod world;

pub use executor::{Timeline, block_on};
pub(in crate::sim) use kernel::Kernel;
pub use medium::Medium;
pub(in crate::sim) use node::lock;
pub use node::{Node, StationId};
pub use port::Port;
pub use world::{SimClock, World};
