//! MyActuator servo motors on a host.
//!
//! | module | for |
//! |---|---|
//! | [`text`] | frames as people and tools write them: `ID#DATA`, candump lines, RS485 bytes |
//! | [`explain`] | what a frame says: name, fields with their units, and a sentence |
//! | [`port`] | real buses on Linux: SocketCAN, SLCAN, RS485, opened from one string |

mod bus_kind;
pub mod explain;
pub mod port;
pub mod text;

pub use bus_kind::BusKind;
