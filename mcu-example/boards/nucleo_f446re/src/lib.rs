//! The firmware on ST's board NUCLEO-F446RE. README.md beside `src/` says what to wire and to type, and
//! what to look at when nothing answers. **It was never run on a real board.**
//!
//! | module | what it is |
//! |---|---|
//! | `board` | [`start`]: clock and pins; [`Nucleo`]: button, light, watchdog, log |
//! | `can` | [`open_can`]: the CAN controller as a port; [`run_can`]: the application on it, and its end |
//!
//! What it has in common with other STM32F4, the RS485 line among it, is in `board_stm32f4`.
#![no_std]

mod board;
mod can;

pub use board::{BIT_RATE, Hardware, Nucleo, start};
pub use can::{CanError, CanPort, end_on_can, open_can, run_can};
