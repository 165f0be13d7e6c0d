//! Embassy's executor, which sleeps whenever no task has anything to do.

use core::ptr::null_mut;
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::singleton;
use embassy_executor::{Spawner, raw};

/// A task was woken since the last check, by an interrupt, another task or itself.
static IS_WOKEN: AtomicBool = AtomicBool::new(false);

/// Runs tasks. Call it once.
///
/// Embassy's own executor for this processor waits by an instruction (WFE) at which the emulator does not wait, and
/// would keep the emulator busy.
pub fn run(spawn: impl FnOnce(Spawner)) -> ! {
    let executor =
        singleton!(: raw::Executor = raw::Executor::new(null_mut())).expect("called once");
    let executor: &'static raw::Executor = executor;
    spawn(executor.spawner());
    loop {
        // SAFETY: nothing else polls it. Waking a task only sets a flag.
        unsafe { executor.poll() };
        // With interrupts off, so that none falls between the check and the sleep. A pending one still ends the sleep.
        critical_section::with(|_| {
            if !IS_WOKEN.swap(false, Ordering::Relaxed) {
                cortex_m::asm::wfi();
            }
        });
    }
}

/// The executor calls this by its name when a task is woken.
// SAFETY: nothing else has this name: the executor is built without a platform of its own.
#[unsafe(export_name = "__pender")]
fn note_woken(_: *mut ()) {
    IS_WOKEN.store(true, Ordering::Relaxed);
}
