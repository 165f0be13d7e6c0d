//! MyActuator servo motors on a host.
//!
//! | module | for |
//! |---|---|
//! | [`text`] | frames as people and tools write them: `ID#DATA`, candump lines, RS485 bytes |
//! | [`explain`] | what a frame says: name, fields with their units, and a sentence |
//! | [`sim`] | simulated drives on simulated buses |
//! | [`bus`] | the simulated buses: CAN and RS485, in virtual or real time |
//! | [`plant`] | the physics behind a simulated drive |
//! | [`nvm`] | a value in a file, safe against a crash |
//! | [`port`] | real buses on Linux: SocketCAN, SLCAN, RS485, opened from one string |

pub mod bus;
mod bus_kind;
pub mod explain;
pub mod nvm;
pub mod plant;
pub mod port;
pub mod sim;
pub mod text;

pub use bus_kind::BusKind;
