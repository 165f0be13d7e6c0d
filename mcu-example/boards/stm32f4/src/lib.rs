//! What the boards with an STM32F4 share. Their own sources differ only by pins and clocks.
//!
//! | module | what it is |
//! |---|---|
//! | `time` | [`TimeBase`]: the clock of the loops, from timer TIM2 |
//! | `line` | [`open_line`]: the RS485 line, received by interrupt |
//! | `rs485` | [`run_rs485`]: the application on it; [`setup`]: its settings; [`end_on_rs485`]: its end |
//! | `last_line` | the line of a firmware that cannot go on |
//! | `end` | [`end`](end()), for any bus |
//! | `log` | [`log`](log()): the log |
#![no_std]

mod end;
mod last_line;
mod line;
mod log;
mod rs485;
mod time;

pub use end::end;
pub use line::{Line, LineErrors, Port, line_usage, open_line, take_line_errors};
pub use log::log;
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::master::MotorSet;
pub use rs485::{end_on_rs485, run_rs485, setup};
pub use time::{Countdown, TimeBase, TimerClocks, wake};

/// The most motors on the bus, with ids from 1.
pub const MOTORS: usize = 8;

/// The motors that are searched, and that a firmware stops when it ends.
pub fn motors() -> MotorSet {
    MotorId::all().take(MOTORS).collect()
}
