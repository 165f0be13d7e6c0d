//! What the emulated boards share: the output of the log, the report of a panic, time-outs, the cycle, and a fault.
#![no_std]

mod log;

use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::time::Duration;
use panic_probe as _; // Logs a panic, and ends in a fault.

const PATIENCE: Duration = Duration::from_millis(25);

/// The same, except for its time-outs. Emulated time is real time: the emulator and the simulated drives may be delayed
/// by some milliseconds, and no reply may be lost by that.
pub const fn patient(config: Config) -> Config {
    Config {
        reply_timeout: PATIENCE,
        longest_response: PATIENCE,
        late_window: Duration::from_millis(50),
        ..config
    }
}

/// The cycle. Emulating a byte on a wire takes so long that four motors with 100 set-points a second on CAN occupy the
/// emulator. Then it falls behind real time, and their replies are late.
pub const CYCLE: Duration = Duration::from_millis(20);

/// Raises a fault.
pub fn fault() -> ! {
    // SAFETY: it touches nothing, and nothing follows it. Not `udf #0`, in which a panic ends.
    unsafe { core::arch::asm!("udf #1", options(noreturn)) }
}
