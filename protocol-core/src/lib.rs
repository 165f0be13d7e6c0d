//! The MyActuator Servo Motor Control Protocol V4.3 over CAN and RS485: every frame, the master and
//! the drive. `no_std`, without allocation, without `unsafe`.
//!
//! # The map
//! From the ground up:
//!
//! | layer | what it is for |
//! |---|---|
//! | [`quantity`] | what a value may be, and the error for what it may not |
//! | [`time`], [`units`] | time as an argument; quantities with their unit |
//! | [`id`], [`packet`] | which motor is meant; sender and receiver, free of any wire |
//! | [`firmware`] | which revision of the protocol |
//! | [`opcode`] | **the** table: one row a kind of frame |
//! | [`error`] | what can be wrong with bytes and requests |
//! | [`kind`] | a row of the table, or what is not in it |
//! | [`wire`] | how a data field is framed: CAN identifiers, RS485 bytes |
//! | [`command`] | what a data field means: each command, its reply beside it, both ways |
//! | [`master`] | the master as a state machine |
//! | [`drive`] | the drive as a state machine, and [what it does where the manual is silent](drive::decisions) |
//! | [`io`] | thin loops over embedded-can and embedded-io |
//!
//! Each layer imports only from those above it in this table; `command` knows no frames and `wire` no meanings. State
//! machines own no I/O and read no clock.
//!
//! # Where to start
//! - To run motors: [`io::CanMaster`] or [`io::SerialMaster`], which are [`io::Runner`]s; in tasks
//!   [`io::AsyncCanMaster`] or [`io::AsyncSerialMaster`].
//! - To find motors, change their settings, and move them to an angle: [`io::bring_up`].
//! - To stop the motors however a loop is left: [`io::Guard`], in tasks [`io::guarded`].
//! - To run motors from your own loop, interrupt or executor: [`master::Master`].
//! - To read a bus: [`wire::can::decode`] or [`wire::rs485::Receiver`], then [`AnyCommand`] and [`AnyReply`].
//! - To stand in for a motor: [`drive::Drive`].
//!
//! The programs in `examples/` are made to be copied: `one_frame` by hand, a `bus_monitor`, and
//! `both_ends` in memory.
//!
//! # One frame from end to end
//! ```
//! use myactuator_protocol_core::command::AbsolutePosition;
//! use myactuator_protocol_core::units::{Angle, MaxSpeed};
//! use myactuator_protocol_core::{AnyCommand, Firmware, MotorId, wire::rs485};
//!
//! // Ranges are checked when a value is made, so encoding cannot fail.
//! let go = AbsolutePosition { max_speed: MaxSpeed::from_dps(500.0)?, angle: Angle::from_degrees(360.0)? };
//! assert_eq!(go.encode(), [0xA4, 0x00, 0xF4, 0x01, 0xA0, 0x8C, 0x00, 0x00]);
//!
//! // The same data field on either bus.
//! let packet = go.packet(MotorId::new(1)?);
//! let line = rs485::Frame::from_packet(&packet).unwrap().encode();
//! assert_eq!(line[..3], [0x3E, 0x01, 0x08]);
//!
//! // And back.
//! assert_eq!(AnyCommand::decode(&packet, Firmware::V4_3)?, go.into());
//! assert_eq!(
//!     packet.to_string(),
//!     "command to motor 1: absolute-position (0xA4): max speed 500 dps, angle 360 deg"
//! );
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Features
//! | feature | adds |
//! |---|---|
//! | `defmt` | `defmt::Format` for every value that crosses a bus |
//! | `serde` | `Serialize` and `Deserialize` for them, range checks included |
//! | `fugit` | conversions between [`time`] and `fugit` |
//!
//! Sections in parentheses, such as (2.21.1), are those of the vendor's manual V4.3. Where the manual
//! contradicts itself, the documentation of the field says how it is read and why.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod command;
mod data;
pub mod drive;
pub mod error;
pub mod firmware;
pub mod id;
pub mod io;
pub mod kind;
pub mod master;
pub mod opcode;
pub mod packet;
pub mod quantity;
mod round;
#[cfg(test)]
mod tests;
pub mod time;
pub mod units;
pub mod wire;

pub use command::{AnyCommand, AnyReply, Command, Reply};
pub use data::Data;
pub use error::{DecodeError, RequestError};
pub use firmware::Firmware;
pub use id::{MotorId, Target};
pub use kind::Kind;
pub use opcode::Opcode;
pub use packet::{Channel, Packet};
pub use quantity::OutOfRange;
