//! The simulation's own clock: nanoseconds, because a bit of RS485 is not a whole number of
//! microseconds.

use myactuator_protocol_core::time::{Duration, Instant};

/// Nanoseconds since the start of the world.
pub(crate) type Nanos = u64;

/// No such time will come.
pub(crate) const NEVER: Nanos = u64::MAX;

/// The time as participants see it: the first whole microsecond that is not before `at`.
pub(crate) const fn to_instant(at: Nanos) -> Instant {
    Instant::from_micros(at.div_ceil(1_000))
}

pub(crate) const fn from_instant(at: Instant) -> Nanos {
    at.as_micros().saturating_mul(1_000)
}

pub(crate) const fn from_duration(span: Duration) -> Nanos {
    span.as_micros().saturating_mul(1_000)
}

/// How long this many bits last, rounded up. A rate of 0 counts as 1.
pub(crate) const fn bits(count: u64, bit_rate: u32) -> Nanos {
    let rate = if bit_rate == 0 { 1 } else { bit_rate as u64 };
    match count.checked_mul(1_000_000_000) {
        Some(scaled) => scaled.div_ceil(rate),
        None => NEVER,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_and_whole_microseconds_are_rounded_up() {
        assert_eq!(bits(111, 500_000), 222_000);
        // 13 bytes: 130 bits / 115200 bit/s = 1128472.2 ns.
        assert_eq!(bits(130, 115_200), 1_128_473);
        assert_eq!(to_instant(1_128_473), Instant::from_micros(1_129));
        assert_eq!(to_instant(1_129_000), Instant::from_micros(1_129));
    }
}
