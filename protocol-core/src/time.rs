//! Points in time and spans of time, in microseconds.
//!
//! The state machines read no clock: their caller passes the time. Any clock will do that counts microseconds from any
//! start and never runs backwards.

use core::fmt::{self, Write as _};
use core::ops::{Add, AddAssign, Sub};

/// A span of time in microseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(transparent))]
pub struct Duration(u64);

/// A point in time: microseconds since a start that the caller's clock chooses.
///
/// ```
/// use myactuator_protocol_core::time::{Duration, Instant};
///
/// let sent = Instant::from_micros(1_000);
/// let deadline = sent + Duration::from_millis(5);
/// assert_eq!(deadline.as_micros(), 6_000);
/// assert_eq!(deadline - sent, Duration::from_micros(5_000));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(transparent))]
pub struct Instant(u64);

impl Duration {
    /// No time at all.
    pub const ZERO: Self = Self(0);

    /// A span of this many microseconds.
    pub const fn from_micros(micros: u64) -> Self {
        Self(micros)
    }

    /// A span of this many milliseconds. Saturates at the longest span.
    pub const fn from_millis(millis: u64) -> Self {
        Self(millis.saturating_mul(1_000))
    }

    /// A span of this many seconds. Saturates at the longest span.
    pub const fn from_secs(secs: u64) -> Self {
        Self(secs.saturating_mul(1_000_000))
    }

    /// The span in microseconds.
    pub const fn as_micros(self) -> u64 {
        self.0
    }

    /// The span in whole milliseconds, rounded down.
    pub const fn as_millis(self) -> u64 {
        self.0 / 1_000
    }

    /// The span in seconds.
    pub const fn as_secs_f32(self) -> f32 {
        self.0 as f32 / 1e6
    }

    /// The span times `factor`. Saturates at the longest span.
    #[must_use]
    pub const fn times(self, factor: u32) -> Self {
        Self(self.0.saturating_mul(factor as u64))
    }
}

impl Instant {
    /// The start of the clock.
    pub const ZERO: Self = Self(0);

    /// The point this many microseconds after the clock's start.
    pub const fn from_micros(micros: u64) -> Self {
        Self(micros)
    }

    /// The point this many milliseconds after the clock's start.
    pub const fn from_millis(millis: u64) -> Self {
        Self(millis.saturating_mul(1_000))
    }

    /// Microseconds since the clock's start.
    pub const fn as_micros(self) -> u64 {
        self.0
    }
}

impl Add for Duration {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }
}

/// Zero if the other is longer.
impl Sub for Duration {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self(self.0.saturating_sub(other.0))
    }
}

impl Add<Duration> for Instant {
    type Output = Self;
    fn add(self, span: Duration) -> Self {
        Self(self.0.saturating_add(span.0))
    }
}

/// The start of the clock if the span is longer than the time since.
impl Sub<Duration> for Instant {
    type Output = Self;
    fn sub(self, span: Duration) -> Self {
        Self(self.0.saturating_sub(span.0))
    }
}

impl AddAssign<Duration> for Instant {
    fn add_assign(&mut self, span: Duration) {
        *self = *self + span;
    }
}

/// The span from the other point to this one; zero if the other is later.
impl Sub for Instant {
    type Output = Duration;
    fn sub(self, earlier: Self) -> Duration {
        Duration(self.0.saturating_sub(earlier.0))
    }
}

/// Saturates at the longest span, 64 bits of microseconds (584,000 years).
impl From<core::time::Duration> for Duration {
    fn from(span: core::time::Duration) -> Self {
        Self(u64::try_from(span.as_micros()).unwrap_or(u64::MAX))
    }
}

impl From<Duration> for core::time::Duration {
    fn from(span: Duration) -> Self {
        core::time::Duration::from_micros(span.0)
    }
}

#[cfg(feature = "fugit")]
mod with_fugit {
    use super::{Duration, Instant};

    impl From<fugit::MicrosDurationU64> for Duration {
        fn from(span: fugit::MicrosDurationU64) -> Self {
            Self(span.as_ticks())
        }
    }

    impl From<Duration> for fugit::MicrosDurationU64 {
        fn from(span: Duration) -> Self {
            Self::from_ticks(span.0)
        }
    }

    // Wrapping instants have no total order, so only monotonic ones can be converted.
    impl From<fugit::MonotonicTimerInstantU64<1_000_000>> for Instant {
        fn from(point: fugit::MonotonicTimerInstantU64<1_000_000>) -> Self {
            Self(point.as_ticks())
        }
    }
}

impl fmt::Display for Duration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (millis, micros) = (self.0 / 1_000, self.0 % 1_000);
        let mut text = heapless::String::<32>::new();
        if micros == 0 {
            write!(text, "{millis} ms")?
        } else {
            write!(text, "{millis}.{micros:03} ms")?
        }
        f.pad(&text)
    }
}

/// As the time since the clock's start.
impl fmt::Display for Instant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        (*self - Self::ZERO).fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use std::format;

    use super::*;

    #[test]
    fn a_duration_fills_its_column() {
        assert_eq!(format!("[{:>8}]", Duration::from_millis(3)), "[    3 ms]");
        assert_eq!(format!("[{:<10}]", Duration::from_micros(1_020)), "[1.020 ms  ]");
    }
    use std::string::ToString;

    #[test]
    fn arithmetic_saturates() {
        let last = Instant::from_micros(u64::MAX);
        assert_eq!(last + Duration::from_secs(1), last);
        assert_eq!(Instant::ZERO - last, Duration::ZERO);
        assert_eq!(Duration::from_millis(u64::MAX).as_micros(), u64::MAX);
        assert_eq!(Duration::from(core::time::Duration::MAX).as_micros(), u64::MAX);
    }

    #[test]
    fn prints_milliseconds() {
        assert_eq!(Duration::from_micros(5_000).to_string(), "5 ms");
        assert_eq!(Duration::from_micros(1_050).to_string(), "1.050 ms");
        assert_eq!(format!("[{:>9}]", Instant::from_micros(1_050)), "[ 1.050 ms]");
    }
}
