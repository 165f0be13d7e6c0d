//! What the emulated boards share: the log's way out, and patience.
#![no_std]

mod log;

use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::time::Duration;

/// The same, but for time-outs. Emulated time is real time: what emulates board and drives may have
/// something else to do for some milliseconds, and no reply is lost by that.
pub const fn patient(config: Config) -> Config {
    Config {
        reply_timeout: Duration::from_millis(25),
        late_window: Duration::from_millis(50),
        ..config
    }
}
