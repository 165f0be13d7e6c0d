//! The end of a firmware that panics or faults, on any bus.

use board_shared::{cause_of_end, restart};
use myactuator_protocol_core::Packet;
use stm32f4xx_hal::pac::{IWDG, iwdg};

use crate::motors;
use crate::time::Countdown;

/// The time that a debugger needs to fetch the end of the log: the restart begins a new one. Together with the last
/// words this is less than the watchdog's time-out.
const FETCH_MICROS: u32 = 50_000;

/// The end after a panic, a fault, or an exception without a handler: takes the bus, stops the motors on it, and
/// restarts. `at` is the argument from [`board_shared::on_fresh_stack`]. `take` and `send` only poll registers, since
/// interrupts are off.
pub fn end<B>(at: u32, take: impl FnOnce() -> B, mut send: impl FnMut(&mut B, &Packet)) -> ! {
    cortex_m::interrupt::disable();
    // The time left of the watchdog may be less than the last words take.
    feed_watchdog();
    let mut bus = take();
    restart(
        cause_of_end(at),
        motors(),
        |packet| send(&mut bus, packet),
        || Countdown::of_micros(FETCH_MICROS).wait_unless(|| false),
    )
}

/// Restarts the independent watchdog's time, if it runs.
fn feed_watchdog() {
    // SAFETY: the registers are there at all times, and any other code that feeds it does the same.
    let watchdog: &iwdg::RegisterBlock = unsafe { &*IWDG::ptr() };
    watchdog.kr().write(|w| w.key().feed());
}
