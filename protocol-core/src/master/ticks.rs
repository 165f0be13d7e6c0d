//! Time in 16 bits, so that a motor's bookkeeping stays small.
//!
//! [`Tick`] counts 16 µs and wraps after 1.05 s, [`CoarseTick`] counts 1.024 ms and wraps after 67 s.
//! Comparisons are right within half of that; the master clears what is older (see
//! [`LONGEST_GAP`]).

use crate::time::{Duration, Instant};

/// The longest time between two calls that leaves ticks comparable. After a longer one (a debugger,
/// a suspended process) whatever was in flight counts as expired.
pub(super) const LONGEST_GAP: Duration = Duration::from_millis(250);

/// The same for coarse ticks.
pub(super) const LONGEST_COARSE_GAP: Duration = Duration::from_secs(30);

/// A point in time, in steps of 16 µs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Tick(u16);

/// A point in time, in steps of 1.024 ms.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct CoarseTick(u16);

/// A span of at most 261 ms, in steps of 1.024 ms.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Span(u8);

impl Span {
    /// The span, rounded up, and at least one step; the longest there is for more.
    #[inline(never)]
    pub(super) fn from_duration(span: Duration) -> Self {
        let steps = (span.as_micros().saturating_add(1023) >> 10).clamp(1, 255);
        Self(steps as u8)
    }

    pub(super) fn duration(self) -> Duration {
        Duration::from_micros(u64::from(self.0) << 10)
    }
}

impl Tick {
    pub(super) fn at(now: Instant) -> Self {
        Self((now.as_micros() >> 4) as u16)
    }

    /// The first tick that is not before `instant`.
    #[inline(never)]
    pub(super) fn not_before(instant: Instant) -> Self {
        Self((instant.as_micros().saturating_add(15) >> 4) as u16)
    }

    pub(super) fn after(now: Instant, span: Span) -> Self {
        Self::not_before(now).plus(span)
    }

    pub(super) fn is_reached(self, now: Instant) -> bool {
        Self::at(now).0.wrapping_sub(self.0) < 0x8000
    }

    /// The instant of this tick, which lies within half a turn of `near`.
    pub(super) fn instant(self, near: Instant) -> Instant {
        instant(self.0, 4, near)
    }

    /// The time from this tick to `now`, zero if it is still to come.
    pub(super) fn elapsed(self, now: Instant) -> Duration {
        let ticks = i32::from(Self::at(now).0.wrapping_sub(self.0) as i16);
        let micros = (ticks << 4) + (now.as_micros() & 15) as i32;
        Duration::from_micros(micros.max(0) as u64)
    }

    pub(super) fn plus(self, span: Span) -> Self {
        Self(self.0.wrapping_add(u16::from(span.0) << 6))
    }

    pub(super) fn minus(self, span: Span) -> Self {
        Self(self.0.wrapping_sub(u16::from(span.0) << 6))
    }

    /// So long ago that every span from it is over.
    pub(super) fn long_before(now: Instant) -> Self {
        Self(Self::at(now).0.wrapping_sub(u16::from(u8::MAX) << 6))
    }
}

impl CoarseTick {
    pub(super) fn at(now: Instant) -> Self {
        Self((now.as_micros() >> 10) as u16)
    }

    #[inline(never)]
    pub(super) fn after(now: Instant, span: Duration) -> Self {
        Self::at(now + span + Duration::from_micros(1023))
    }

    pub(super) fn is_reached(self, now: Instant) -> bool {
        Self::at(now).0.wrapping_sub(self.0) < 0x8000
    }

    pub(super) fn instant(self, near: Instant) -> Instant {
        instant(self.0, 10, near)
    }
}

/// The instant of a count of steps of 2^`shift` µs, which lies within half a turn of `near`.
#[inline(never)]
fn instant(count: u16, shift: u32, near: Instant) -> Instant {
    let base = near.as_micros() >> shift;
    let delta = count.wrapping_sub(base as u16) as i16;
    Instant::from_micros(base.saturating_add_signed(i64::from(delta)) << shift)
}

/// The earliest of several points in time.
#[derive(Debug, Default)]
pub(super) struct Earliest(pub(super) Option<Instant>);

impl Earliest {
    #[inline(never)]
    pub(super) fn take(&mut self, at: Instant) {
        if self.0.is_none_or(|earliest| at < earliest) {
            self.0 = Some(at);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn us(micros: u64) -> Instant {
        Instant::from_micros(micros)
    }

    #[test]
    fn ticks_survive_the_wrap() {
        for start in [0, 1_048_000, 1_048_576, u64::from(u32::MAX), 1 << 40] {
            let now = us(start);
            let deadline = Tick::after(now, Span::from_duration(Duration::from_millis(5)));
            // 5 ms are rounded up to 5 steps of 1024 µs, after rounding the start up to a tick.
            assert!(!deadline.is_reached(us(start + 5_000)), "{start}");
            assert!(deadline.is_reached(us(start + 5 * 1024 + 16)), "{start}");
            assert!(deadline.instant(now) >= us(start + 5 * 1024));
            assert!(deadline.is_reached(deadline.instant(now)));
        }
    }

    #[test]
    fn a_deadline_is_never_early() {
        for start in 0..64 {
            let deadline = Tick::not_before(us(start));
            assert!(deadline.instant(us(start)) >= us(start));
            let coarse = CoarseTick::after(us(start), Duration::from_millis(3));
            assert!(!coarse.is_reached(us(start + 2_999)));
            assert!(coarse.is_reached(us(start + 5_048)));
        }
    }
}
