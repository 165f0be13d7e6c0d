//! The firmware on an emulated STM32F405: QEMU's machine `netduinoplus2`, whose USARTs run the real
//! HAL's code.
//!
//! | wire | what it is |
//! |---|---|
//! | USART1 | the RS485 line |
//! | USART2 | the [`Panel`]: button, light, and ways to break the firmware |
//! | semihosting | the log, by defmt |
//!
//! What the emulator (7.2) has not, or has otherwise than the chip:
//! - Clocks: it lets the firmware write what it likes to the clock controller, and never says that a
//!   PLL is ready. So this runs on the internal oscillator, at 16 MHz as far as the HAL knows; but
//!   TIM2 is clocked with 1 GHz, and SysTick with 168 MHz.
//! - USARTs: a byte takes no time. Transmission is always complete, and nothing is ever overrun or
//!   disturbed, so the waiting and counting for that is not tried here. Nor is the direction pin: there
//!   are no pins.
//! - No watchdog: a firmware that hangs does so for ever, and its motors are stopped by their own
//!   communication-loss protection.
#![no_std]

mod board;
mod panel;

pub use board::{BIT_RATE, Hardware, start};
pub use panel::Panel;
