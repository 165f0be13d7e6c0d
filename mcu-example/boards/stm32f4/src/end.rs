//! The end of a firmware that panics or faults, whatever its bus.

use board_shared::{cause_of_end, restart};
use myactuator_protocol_core::Packet;
use stm32f4xx_hal::pac::{IWDG, iwdg};

use crate::motors;
use crate::time::Countdown;

/// What a debugger needs to fetch the end of the log: the restart begins a new one. With the last words
/// before it, still less than what makes a watchdog bite.
const FETCH_MICROS: u32 = 50_000;

/// What is to be done on a panic, a fault and whatever else nobody has expected: takes the bus, stops the
/// motors on it, and restarts. `at` is what [`board_shared::on_fresh_stack`] gives; `take` and `send` look
/// at registers only, for there are no interrupts any more.
pub fn end<B>(at: u32, take: impl FnOnce() -> B, mut send: impl FnMut(&mut B, &Packet)) -> ! {
    cortex_m::interrupt::disable();
    // What is left of its time may be less than the last words take.
    feed_watchdog();
    let mut bus = take();
    restart(
        cause_of_end(at),
        motors(),
        |packet| send(&mut bus, packet),
        || Countdown::of_micros(FETCH_MICROS).wait_unless(|| false),
    )
}

/// Begins the independent watchdog's time again, if it runs.
fn feed_watchdog() {
    // SAFETY: the registers are there at all times, and who else feeds it does the same.
    let watchdog: &iwdg::RegisterBlock = unsafe { &*IWDG::ptr() };
    watchdog.kr().write(|w| w.key().feed());
}
