//! Time-outs that follow the measured round trips, within the bounds that the caller sets.

use crate::master::Config;
use crate::time::Duration;

/// Even on a steady bus a reply may be this late, because a host has other things to do.
const GRAIN_US: u32 = 2_000;

/// The mean of the round trips of all motors and the deviation from it, calculated as in TCP (RFC 6298), and the
/// time-outs that follow from them.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RoundTrips {
    mean_us: u32,
    deviation_us: u32,
    /// What is added to the caller's time-outs now.
    pub(super) more: Duration,
}

impl RoundTrips {
    /// Nothing was measured yet: the longest time-outs apply. `None` if the time-outs do not depend on measurements.
    pub(super) fn new(config: &mut Config) -> Option<Self> {
        if config.longest_reply_timeout <= config.reply_timeout {
            return None;
        }
        let mut trips = Self::default();
        trips.set(config.longest_reply_timeout - config.reply_timeout, config);
        Some(trips)
    }

    /// A reply came after its time-out, which is therefore too short.
    pub(super) fn was_too_short(&mut self, config: &mut Config) {
        self.deviation_us = self.deviation_us.saturating_add(micros(config.reply_timeout) / 4);
        self.follow(config);
    }

    /// A reply came after this time.
    #[inline(never)]
    pub(super) fn measured(&mut self, round_trip: Duration, config: &mut Config) {
        let round_trip_us = micros(round_trip);
        if self.mean_us == 0 {
            self.mean_us = round_trip_us;
            self.deviation_us = round_trip_us / 2;
        } else {
            let difference = round_trip_us.abs_diff(self.mean_us);
            self.deviation_us = self.deviation_us - self.deviation_us / 4 + difference / 4;
            self.mean_us = self.mean_us - self.mean_us / 8 + round_trip_us / 8;
        }
        self.follow(config);
    }

    /// Sets the time-outs that follow from what was measured.
    fn follow(&mut self, config: &mut Config) {
        let shortest = config.reply_timeout - self.more;
        let margin = self.deviation_us.saturating_mul(4).max(GRAIN_US);
        let wanted = self.mean_us.saturating_add(margin);
        let wanted = Duration::from_micros(wanted.into()).min(config.longest_reply_timeout);
        self.set(wanted - shortest, config);
    }

    fn set(&mut self, more: Duration, config: &mut Config) {
        let before = core::mem::replace(&mut self.more, more);
        for time in
            [&mut config.reply_timeout, &mut config.late_window, &mut config.longest_response]
        {
            *time = *time - before + more;
        }
    }
}

fn micros(time: Duration) -> u32 {
    u32::try_from(time.as_micros()).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FAST: Duration = Duration::from_millis(5);
    const LONGEST: Duration = Duration::from_millis(40);

    fn config() -> Config {
        Config { reply_timeout: FAST, late_window: Duration::from_millis(10), ..Config::CAN }
    }

    fn measure(trips: &mut RoundTrips, config: &mut Config, round_trip_ms: u64, times: usize) {
        for _ in 0..times {
            trips.measured(Duration::from_millis(round_trip_ms), config);
        }
    }

    #[test]
    fn the_time_outs_follow_what_is_measured() {
        let config = &mut config().adapting_up_to(LONGEST);
        let trips = &mut RoundTrips::new(config).unwrap();
        assert_eq!(config.reply_timeout, LONGEST, "nothing was measured yet");
        assert_eq!(config.late_window, Duration::from_millis(45), "it grows by as much");
        // The mean, and four times the deviation, which is half of the first.
        measure(trips, config, 4, 1);
        assert_eq!(config.reply_timeout, Duration::from_millis(12));
        measure(trips, config, 1, 20);
        assert_eq!(config.reply_timeout, FAST, "no shorter than that");
        assert_eq!(config.late_window, Duration::from_millis(10));
        // An adapter's burst.
        measure(trips, config, 16, 1);
        assert!(config.reply_timeout >= Duration::from_millis(16), "{}", config.reply_timeout);
        measure(trips, config, 16, 100);
        let steady = config.reply_timeout.as_micros();
        assert!((17_500..18_500).contains(&steady), "the mean and the grain: {steady}");
        measure(trips, config, 200, 3);
        assert_eq!(config.reply_timeout, LONGEST, "no longer than that");
    }

    #[test]
    fn a_late_reply_makes_them_longer() {
        let config = &mut config().adapting_up_to(LONGEST);
        let trips = &mut RoundTrips::new(config).unwrap();
        measure(trips, config, 1, 50);
        trips.was_too_short(config);
        let after_one = config.reply_timeout;
        assert!(after_one > FAST, "{after_one}");
        trips.was_too_short(config);
        assert!(config.reply_timeout > after_one);
    }

    #[test]
    fn without_bounds_they_stay() {
        let config = &mut config();
        let before = *config;
        assert!(RoundTrips::new(config).is_none());
        assert_eq!(*config, before);
    }
}
