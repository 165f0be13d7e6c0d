//! MyActuator Servo Motor Control Protocol V4.3.
#![no_std]
#![forbid(unsafe_code)]

pub mod channel;
pub mod command;
pub mod drive;
pub mod error;
mod field;
pub mod id;
pub mod io;
pub mod master;
pub mod opcode;
pub mod range;
pub mod time;
pub mod units;
pub mod wire;

pub use channel::{Channel, Packet};
pub use command::{AnyCommand, AnyReply, Command, Reply};
pub use error::{DecodeError, OutOfRange, RequestError};
pub use field::Data;
pub use id::{MotorId, Target};
pub use opcode::Opcode;
