//! What every Cortex-M board here shares: how a firmware ends that cannot go on, what it leaves to the
//! next start, and how deep its stack was.
//!
//! A board's `memory.x` puts the stack below everything else in RAM, so that one that overflows runs
//! into memory that is not there, and faults, instead of into the variables:
//!
//! ```text
//! MEMORY
//! {
//!   FLASH : ORIGIN = 0x08000000, LENGTH = 512K
//!   STACK : ORIGIN = 0x20000000, LENGTH = 12K
//!   RAM   : ORIGIN = 0x20003000, LENGTH = 116K
//! }
//! _stack_start = ORIGIN(STACK) + LENGTH(STACK);
//! _stack_end = ORIGIN(STACK);
//! ```
//!
//! Where there is something below RAM all the same, [`guard_stack`] makes it fault. The binaries do the
//! rest in three lines:
//!
//! ```ignore
//! board_shared::on_fresh_stack!(HardFault, DefaultHandler => end);
//! extern "C" fn end(at: u32) -> ! { board_shared::restart(cause_of_end(at), motors, send, linger) }
//! let cause = board_shared::take_note().unwrap_or(RestartCause::Power);
//! ```
#![no_std]

mod cause;
mod fresh_stack;
mod note;
mod restart;
mod stack;

pub use cause::cause_of_end;
pub use note::take_note;
pub use restart::restart;
pub use stack::{guard_stack, stack_size, stack_used};
