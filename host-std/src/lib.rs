//! MyActuator servo motors on a host: buses of Linux, simulated drives, and frames as text.
//!
//! | layer | for | stands on | feature |
//! |---|---|---|---|
//! | [`text`] | frames as people and tools write them: `ID#DATA`, candump lines, RS485 bytes, SLCAN | | |
//! | [`explain`] | what a frame says: name, fields with their units, and a sentence; DBC files | `text` | `explain` |
//! | [`port`] | real buses on Linux: SocketCAN, SLCAN adapters, RS485 | `text` | `port` |
//! | [`sim`] | simulated drives on simulated buses, under a virtual clock or in real time | | `sim` |
//! | [`open`] | a master on whatever bus one string names, real or simulated | `text`, `port`, `sim` | both |
//! | [`share`] | one bus for many threads: a thread runs it, the others have handles | `open` | both |
//! | [`serve`] | simulated drives offered to other programs | `text`, `port`, `sim` | both |
//!
//! A layer uses only the layers that it stands on; `port` and `sim` know nothing of each other.
//! Above all of them is the program `myactuator`, the command line, which is not part of the library.
//!
//! # Features
//!
//! | feature | what it adds | which crates it pulls |
//! |---|---|---|
//! | (none) | [`text`], [`BusKind`] and [`protocol`] | embedded-can, thiserror |
//! | `explain` | [`explain`] | serde_json |
//! | `port` | [`port`] | socketcan, rustix, embedded-io, embassy-futures, nb |
//! | `sim` | [`sim`] | crc, libm, rand_chacha, serde, serde_json, toml, embedded-io and its async traits, nb |
//! | `port` and `sim` | [`open`], [`share`], [`serve`] | |
//! | `cli` (default) | the program `myactuator`, and all of the above | clap, signal-hook |
//! | `can-stack` | nothing: a test that uses its machine's CAN interfaces is built | |
//!
//! A library that only needs simulated drives depends on this crate with `default-features = false` and
//! `features = ["sim"]`.

mod bus_kind;
#[cfg(feature = "explain")]
pub mod explain;
#[cfg(all(feature = "port", feature = "sim"))]
pub mod open;
#[cfg(feature = "port")]
pub mod port;
#[cfg(all(feature = "port", feature = "sim"))]
pub mod serve;
#[cfg(all(feature = "port", feature = "sim"))]
pub mod share;
#[cfg(feature = "sim")]
pub mod sim;
#[cfg(test)]
mod tests;
pub mod text;
mod unexpected;

pub use bus_kind::BusKind;
#[cfg(feature = "sim")]
pub(crate) use bus_kind::LINE_RATES;
/// The protocol itself, [`myactuator_protocol_core`]. A package that depends on this crate needs no dependency
/// on that, and cannot get another version of it.
#[doc(no_inline)]
pub use myactuator_protocol_core as protocol;
pub use unexpected::Unexpected;
