//! Where the loops get their time from.

use crate::time::Instant;

/// A clock for the loops of [`io`](crate::io). It must never run backwards or start again. A 32-bit timer of
/// microseconds does after little more than an hour: count its overflows, or loops wait for ever and motors go on.
///
/// If it goes on in steps of more than some ten microseconds, such as a tick of 1 ms, the configuration of a CAN bus has
/// to say so: [`Config::for_clock_step`](crate::master::Config::for_clock_step). Otherwise some answers, or all, seem to
/// come sooner than any drive sends them: they are strays, and motors seem not to answer or to share an id.
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

    /// Called when there is nothing to do before `until` unless something arrives first. May sleep until either
    /// happens, or return at once, which makes the loop poll. A simulated clock advances here.
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

/// A clock that can wake a task, for the async loops of [`io`](crate::io). As with every [`Clock`], the configuration
/// has to say if its steps are coarse.
///
/// With embassy, `Timer::at` is all that is needed:
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
#[allow(async_fn_in_trait, reason = "one task runs one bus, so nothing asks for Send")]
pub trait AsyncClock: Clock {
    /// Waits until the clock shows `until`, or a little longer; not at all if it already does. The loops drop this
    /// future whenever something arrives first.
    async fn wait_until(&mut self, until: Instant);
}
