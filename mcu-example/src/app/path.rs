//! The movement: there and back, without a jerk.

use myactuator_protocol_core::time::Duration;

/// Where a motor is to be, as a part of the amplitude, and how fast that changes, in amplitudes per second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    pub(super) part: f32,
    pub(super) per_second: f32,
}

/// The place at `since` after the start. It goes there and back once in each `period`, and is at rest at both ends.
pub(super) fn place(since: Duration, period: Duration) -> Place {
    let period_us = period.as_micros().max(2);
    let half_us = period_us / 2;
    // Reduced in whole microseconds, so that an hour of motion is as exact as its first second.
    let within_us = since.as_micros() % period_us;
    let (passed_us, sign) =
        if within_us < half_us { (within_us, 1.0) } else { (period_us - within_us, -1.0) };
    let x = (passed_us as f32 / half_us as f32).min(1.0);
    // 3x² - 2x³ and its derivative.
    let part = x * x * (3.0 - 2.0 * x);
    let per_second = sign * 6.0 * x * (1.0 - x) * 1e6 / half_us as f32;
    Place { part, per_second }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_at_rest_at_both_ends_and_fastest_between() {
        let period = Duration::from_secs(2);
        let at = |ms| place(Duration::from_millis(ms), period);
        assert_eq!(at(0), Place { part: 0.0, per_second: 0.0 });
        assert_eq!(at(500), Place { part: 0.5, per_second: 1.5 });
        assert_eq!(at(1_000).part, 1.0);
        assert_eq!(at(1_000).per_second, 0.0);
        assert_eq!(at(1_500), Place { part: 0.5, per_second: -1.5 });
        assert_eq!(at(2_000), at(0));
        assert_eq!(at(3_600_000), at(0));
    }

    #[test]
    fn a_period_of_nothing_is_no_division_by_zero() {
        assert!(place(Duration::from_secs(1), Duration::ZERO).part.is_finite());
    }
}
