//! What the emulated boards share: the log's way out, a panic's way there, patience, and a fault.
#![no_std]

mod log;

use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::time::Duration;
use panic_probe as _; // Tells a panic by the log, and ends in a fault.

const PATIENCE: Duration = Duration::from_millis(25);

/// The same, but for time-outs. Emulated time is real time: what emulates board and drives may have
/// something else to do for some milliseconds, and no reply is lost by that.
pub const fn patient(config: Config) -> Config {
    Config {
        reply_timeout: PATIENCE,
        longest_response: PATIENCE,
        late_window: Duration::from_millis(50),
        ..config
    }
}

/// Does what the processor forbids.
pub fn fault() -> ! {
    // SAFETY: nothing is touched, and nothing comes after it. Not 0, by which a panic ends.
    unsafe { core::arch::asm!("udf #1", options(noreturn)) }
}
