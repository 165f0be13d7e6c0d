//! Where the loops get their time from.

use crate::time::Instant;

/// A clock for the loops of [`io`](crate::io): it never runs backwards.
///
/// ```
/// use myactuator_protocol_core::io::Clock;
/// use myactuator_protocol_core::time::Instant;
///
/// # fn timer() -> u64 { 1_500 }
/// struct Timer;
///
/// impl Clock for Timer {
///     fn now(&self) -> Instant {
///         // Microseconds, from a hardware timer.
///         Instant::from_micros(timer())
///     }
/// }
/// ```
pub trait Clock {
    /// The time now.
    fn now(&self) -> Instant;

    /// Called when there is nothing to do before `until` unless something arrives first. May sleep
    /// until either happens; may just as well return at once, which makes the loop poll. A simulated
    /// clock advances here.
    fn idle(&self, until: Instant) {
        let _ = until;
    }
}

impl<C: Clock + ?Sized> Clock for &C {
    fn now(&self) -> Instant {
        (**self).now()
    }

    fn idle(&self, until: Instant) {
        (**self).idle(until);
    }
}
