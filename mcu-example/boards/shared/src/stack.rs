//! How deep the stack was: the start-up code has painted it.

use core::ptr;

use cortex_m_rt::STACK_PAINT_VALUE;

unsafe extern "C" {
    /// The stack's lowest word; see `memory.x`.
    static _stack_end: u32;
    /// The word above its highest.
    static _stack_start: u32;
}

/// The stack's size in bytes.
pub fn stack_size() -> u32 {
    ((&raw const _stack_start).addr() - (&raw const _stack_end).addr()) as u32
}

/// The deepest that the stack has been since the start, in bytes.
///
/// Takes a few instructions for each word that was never used.
pub fn stack_used() -> u32 {
    let mut word = &raw const _stack_end;
    let top = &raw const _stack_start;
    // SAFETY: from `_stack_end` up to `_stack_start` there is RAM, which may be read at any time;
    // volatile, for it is not ours: it changes with every call.
    while !ptr::eq(word, top) && unsafe { word.read_volatile() } == STACK_PAINT_VALUE {
        word = word.wrapping_add(1);
    }
    (top.addr() - word.addr()) as u32
}
