//! The firmware on ST's board NUCLEO-F446RE. README.md next to `src/` says how to wire and run it, and what to check
//! when nothing answers. **It was never run on a real board.**
//!
//! | module | what it is |
//! |---|---|
//! | `board` | [`start`]: clock and pins; [`Nucleo`]: button, light, watchdog, log |
//! | `can` | [`open_can`]: the CAN controller as a port; [`run_can`]: the application on it, and its end |
//!
//! What it shares with other boards with an STM32F4, such as the RS485 line, is in `board_stm32f4`.
#![no_std]

mod board;
mod can;

pub use board::{BIT_RATE, Hardware, Nucleo, start};
pub use can::{CanError, CanPort, end_on_can, open_can, run_can};
