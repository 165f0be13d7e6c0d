//! Clocks that a task can wait for.

use embedded_hal_async::delay::DelayNs;

use crate::io::clock::Clock;
use crate::time::{Duration, Instant};

/// A clock that can wake a task, for the async loops of [`io`](crate::io).
///
/// With embassy, `Timer::at` is all there is to it:
///
/// ```
/// # mod embassy_time {
/// #     pub struct Instant;
/// #     impl Instant {
/// #         pub fn now() -> Self { Self }
/// #         pub fn from_micros(_: u64) -> Self { Self }
/// #         pub fn as_micros(&self) -> u64 { 0 }
/// #     }
/// #     pub struct Timer;
/// #     impl Timer { pub async fn at(_: Instant) {} }
/// # }
/// use myactuator_protocol_core::io::{AsyncClock, Clock};
/// use myactuator_protocol_core::time::Instant;
///
/// struct EmbassyClock;
///
/// impl Clock for EmbassyClock {
///     fn now(&self) -> Instant {
///         Instant::from_micros(embassy_time::Instant::now().as_micros())
///     }
/// }
///
/// impl AsyncClock for EmbassyClock {
///     async fn wait_until(&mut self, until: Instant) {
///         embassy_time::Timer::at(embassy_time::Instant::from_micros(until.as_micros())).await;
///     }
/// }
/// ```
///
/// Where there is only a delay of embedded-hal-async, take [`DelayClock`].
///
/// The futures need not be `Send`: one task runs one bus.
#[allow(async_fn_in_trait, reason = "one task runs one bus, so nothing asks for Send")]
pub trait AsyncClock: Clock {
    /// Waits until the clock shows `until`, or a little later; not at all if it already does. The
    /// loops drop this future whenever something arrives first.
    async fn wait_until(&mut self, until: Instant);
}

/// A clock that waits by a delay of embedded-hal-async.
#[derive(Clone, Copy, Debug)]
pub struct DelayClock<K, D> {
    clock: K,
    delay: D,
}

/// The longest single delay.
const LONGEST_DELAY: Duration = Duration::from_secs(1);

impl<K: Clock, D: DelayNs> DelayClock<K, D> {
    /// This clock gives the time, this delay waits.
    pub const fn new(clock: K, delay: D) -> Self {
        Self { clock, delay }
    }

    /// The clock and the delay back.
    pub fn release(self) -> (K, D) {
        (self.clock, self.delay)
    }
}

impl<K: Clock, D> Clock for DelayClock<K, D> {
    fn now(&self) -> Instant {
        self.clock.now()
    }

    fn idle(&self, until: Instant) {
        self.clock.idle(until);
    }
}

impl<K: Clock, D: DelayNs> AsyncClock for DelayClock<K, D> {
    async fn wait_until(&mut self, until: Instant) {
        loop {
            let left = until - self.clock.now();
            if left == Duration::ZERO {
                return;
            }
            self.delay.delay_us(left.min(LONGEST_DELAY).as_micros() as u32).await;
        }
    }
}
