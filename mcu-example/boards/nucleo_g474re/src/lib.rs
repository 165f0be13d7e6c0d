//! ST's board NUCLEO-G474RE (STM32G474RE, Cortex-M4F at 170 MHz), with embassy.
//!
//! **It was never run on a real board.** `README.md` next to `src/` says how to wire and run it, and what to check
//! first.
//!
//! | module | what it is |
//! |---|---|
//! | [`start`] | clocks, and why the firmware starts |
//! | [`Nucleo`] | button, light, watchdog and log |
//! | [`FdCan`] | CAN as an [`AsyncCan`](myactuator_protocol_core::io::AsyncCan) |
//! | [`rs485`] | RS485 as a buffered serial port |
//! | `last_words` | what happens when the firmware panics or faults |
#![no_std]

mod board;
mod clock;
mod fdcan;
mod last_words;
mod serial;
mod start;

// The log: over the debug probe.
use defmt_rtt as _;
// Logs a panic, and ends in a fault.
use panic_probe as _;

pub use board::Nucleo;
pub use clock::EmbassyClock;
pub use fdcan::{BIT_RATE as CAN_BIT_RATE, BusDown, FdCan};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::master::MotorSet;
pub use serial::{BIT_RATE as RS485_BIT_RATE, rs485};
pub use start::start;

/// The most motors that there are: ids 1 to this.
pub const MOTORS: usize = 8;

/// The motors that are searched, and that a firmware stops when it ends.
pub fn motors() -> MotorSet {
    MotorId::all().take(MOTORS).collect()
}
