//! How deep the stack was, which shows because the start-up code paints it, and a guard below it.

use core::ptr;

use cortex_m::asm::{dsb, isb};
use cortex_m::peripheral::MPU;
use cortex_m_rt::STACK_PAINT_VALUE;

unsafe extern "C" {
    /// The stack's lowest word; see `memory.x`.
    static _stack_end: u32;
    /// The word above its highest word.
    static _stack_start: u32;
}

/// The stack's size in bytes.
pub fn stack_size() -> u32 {
    ((&raw const _stack_start).addr() - (&raw const _stack_end).addr()) as u32
}

/// The deepest use of the stack since the start, in bytes.
///
/// Takes a few instructions for each word that was never used.
pub fn stack_used() -> u32 {
    let mut word = &raw const _stack_end;
    let top = &raw const _stack_start;
    // SAFETY: from `_stack_end` up to `_stack_start` there is RAM, which may be read at any time. Volatile, since it
    // changes with every call.
    while !ptr::eq(word, top) && unsafe { word.read_volatile() } == STACK_PAINT_VALUE {
        word = word.wrapping_add(1);
    }
    (top.addr() - word.addr()) as u32
}

/// The size of the guarded area: more than any function puts on the stack at once.
const GUARD: u32 = 32 * 1024;

/// Makes any access to the 32 KiB below the stack fault. For boards that have something there: where nothing is, the
/// bus reports the access anyway. The stack has to begin at a multiple of 32 KiB.
pub fn guard_stack(mpu: &mut MPU) {
    const VALID: u32 = 1 << 4;
    const NO_ACCESS: u32 = 0 << 24;
    const NEVER_EXECUTED: u32 = 1 << 28;
    /// The size is 2 to the power of (this field + 1).
    const SIZE: u32 = (GUARD.ilog2() - 1) << 1;
    const ENABLED: u32 = 1;
    /// All other memory is as without the MPU.
    const DEFAULT_ELSEWHERE: u32 = 1 << 2;

    let below = (&raw const _stack_end).addr() as u32 - GUARD;
    assert!(below.is_multiple_of(GUARD), "the stack has to begin at a multiple of 32 KiB");
    // SAFETY: the region holds nothing that is in use.
    unsafe {
        mpu.rbar.write(below | VALID);
        mpu.rasr.write(NO_ACCESS | NEVER_EXECUTED | SIZE | ENABLED);
        mpu.ctrl.write(DEFAULT_ELSEWHERE | ENABLED);
    }
    dsb();
    isb();
}
