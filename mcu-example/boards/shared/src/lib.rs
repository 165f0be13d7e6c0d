//! What all Cortex-M boards here share: how a firmware that cannot go on ends, what it leaves to the next start, and
//! how deep its stack was.
//!
//! A board's `memory.x` puts the stack below everything else in RAM. So a stack that overflows runs into memory that
//! does not exist, and faults, instead of overwriting variables:
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
//! If something is below RAM, [`guard_stack`] makes access to it fault. The programs do the rest in three lines:
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
