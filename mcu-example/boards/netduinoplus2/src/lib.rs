//! The firmware on an emulated STM32F405: QEMU's machine `netduinoplus2`, whose USARTs run the code of the real HAL.
//!
//! | wire | what it is |
//! |---|---|
//! | USART1 | the RS485 line |
//! | USART2 | the [`Panel`]: button, light, and ways to break the firmware |
//! | semihosting | the log, by defmt |
//!
//! How the emulator (7.2) differs from the chip:
//! - Clocks: the firmware may write anything to the clock controller, and no PLL is ever reported ready. So this runs
//!   on the internal oscillator, at 16 MHz as far as the HAL knows. But TIM2 is clocked with 1 GHz, and SysTick with
//!   168 MHz.
//! - USARTs: a byte takes no time. Transmission is always complete, and nothing is ever overrun or disturbed. So the
//!   waiting and counting for these is not tested here. Nor is the direction pin: there are no pins.
//! - There is no watchdog. A firmware that hangs does so forever, and its motors stop by their own communication-loss
//!   protection.
#![no_std]

mod board;
mod panel;

pub use board::{BIT_RATE, Hardware, start};
pub use panel::Panel;
