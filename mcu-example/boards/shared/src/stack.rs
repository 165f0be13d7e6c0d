//! How deep the stack was, which the start-up code has painted, and what is below it.

use core::ptr;

use cortex_m::asm::{dsb, isb};
use cortex_m::peripheral::MPU;
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

/// The size of what [`guard_stack`] guards: more than any function puts on the stack at once.
const GUARD: u32 = 32 * 1024;

/// Has the processor fault when something touches the 32 KiB below the stack. For boards where they
/// are not simply missing, so that the bus would report it. The stack has to begin at a multiple of
/// 32 KiB.
pub fn guard_stack(mpu: &mut MPU) {
    const VALID: u32 = 1 << 4;
    const NO_ACCESS: u32 = 0 << 24;
    const NEVER_EXECUTED: u32 = 1 << 28;
    /// Twice two to the power of that is the size.
    const SIZE: u32 = (GUARD.ilog2() - 1) << 1;
    const ENABLED: u32 = 1;
    /// All else is as without the unit.
    const DEFAULT_ELSEWHERE: u32 = 1 << 2;

    let below = (&raw const _stack_end).addr() as u32 - GUARD;
    assert!(below.is_multiple_of(GUARD), "the stack has to begin at a multiple of 32 KiB");
    // SAFETY: the region holds nothing, so that nothing is taken away from anybody.
    unsafe {
        mpu.rbar.write(below | VALID);
        mpu.rasr.write(NO_ACCESS | NEVER_EXECUTED | SIZE | ENABLED);
        mpu.ctrl.write(DEFAULT_ELSEWHERE | ENABLED);
    }
    dsb();
    isb();
}
