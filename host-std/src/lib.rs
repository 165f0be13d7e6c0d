//! MyActuator servo motors on a host.
//!
//! | module | for |
//! |---|---|
//! | [`text`] | frames as people and tools write them: `ID#DATA`, candump lines, RS485 bytes |
//! | [`explain`] | what a frame says: name, fields with their units, and a sentence |
//! | [`plant`] | the physics behind a simulated drive |
//! | [`nvm`] | a value in a file, safe against a crash |

mod bus_kind;
pub mod explain;
pub mod nvm;
pub mod plant;
pub mod text;

pub use bus_kind::BusKind;
