//! The clock of the async loops.

use embassy_time::Timer;
use myactuator_protocol_core::io::{AsyncClock, Clock};
use myactuator_protocol_core::time::Instant;

/// embassy's clock, which counts microseconds.
#[derive(Clone, Copy, Debug)]
pub struct EmbassyClock;

impl Clock for EmbassyClock {
    fn now(&self) -> Instant {
        Instant::from_micros(embassy_time::Instant::now().as_micros())
    }
}

impl AsyncClock for EmbassyClock {
    async fn wait_until(&mut self, until: Instant) {
        Timer::at(embassy_time::Instant::from_micros(until.as_micros())).await;
    }
}
