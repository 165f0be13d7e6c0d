//! The end of a firmware that panics, whatever its bus.

use core::panic::PanicInfo;
use core::sync::atomic::{AtomicBool, Ordering};

use board_shared::say_last_words;
use cortex_m::peripheral::SCB;
use myactuator_mcu_example::RestartCause;
use myactuator_protocol_core::Packet;

use crate::motors;
use crate::time::Countdown;

/// What a debugger needs to fetch the message: the restart begins a new log. With the last words before
/// it, still less than what makes a watchdog bite.
const FETCH_MICROS: u32 = 50_000;

/// Stops the motors, tells where it panicked, and restarts. `send` is as [`say_last_words`] wants it.
pub fn panic(info: &PanicInfo<'_>, send: impl FnMut(&Packet)) -> ! {
    static PANICS: AtomicBool = AtomicBool::new(false);
    cortex_m::interrupt::disable();
    // The log panics if it is what panicked; all else is done by then.
    if !PANICS.swap(true, Ordering::Relaxed) {
        say_last_words(RestartCause::Panic, motors(), send);
        defmt::error!("{}", defmt::Display2Format(info));
        Countdown::of_micros(FETCH_MICROS).wait_unless(|| false);
    }
    SCB::sys_reset()
}
