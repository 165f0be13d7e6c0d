//! Where the loops get their time from.

use crate::time::Instant;

/// A clock for the loops of [`io`](crate::io): it never runs backwards.
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

/// A clock from a function that returns the time, such as a timer's counter.
///
/// ```
/// use myactuator_protocol_core::io::{Clock, FnClock};
/// use myactuator_protocol_core::time::Instant;
///
/// let timer = || 1_500; // microseconds, from a hardware timer
/// let clock = FnClock(|| Instant::from_micros(timer()));
/// assert_eq!(clock.now(), Instant::from_micros(1_500));
/// ```
#[derive(Clone, Copy, Debug)]
pub struct FnClock<F>(pub F);

impl<F: Fn() -> Instant> Clock for FnClock<F> {
    fn now(&self) -> Instant {
        (self.0)()
    }
}
