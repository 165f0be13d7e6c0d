//! SLCAN: CAN frames as lines of text over a serial port. This is the ASCII protocol of Lawicel's adapters, which most
//! USB-CAN adapters speak, on every operating system and without a driver.
//!
//! [`AdapterCommand`] goes to an adapter, [`Answer`] comes from it. Both are encoded and decoded here, so that
//! [`Codec`], the computer's end, and [`AdapterCodec`], the adapter's, agree.
//!
//! | line | meaning |
//! |---|---|
//! | `S6`, `S8` … | bit rate of the CAN bus ([`Rate`]) |
//! | `O`, `L`, `C` | open, open for listening only, close |
//! | `t1418` and 16 digits | standard data frame: identifier, length, bytes; `T` with 8 digits of identifier |
//! | `r1418` | standard remote frame; `R` with 8 digits of identifier |
//! | `V`, `N`, `F`, `Z1` | version, serial number, status, time stamps |
//!
//! Lines end with a carriage return. An adapter answers with an empty line (or `z`, `Z` after a frame) if it has done
//! what it was told, and with the character BEL if not.

mod codec;
mod line;
mod rate;

pub use codec::{AdapterCodec, AdapterCommand, Answer, Codec};
pub use rate::Rate;
