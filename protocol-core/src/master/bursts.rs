//! CAN: how long nothing comes although the bus carries replies, because an adapter holds them back and delivers them
//! together, the host looks seldom, or the clock goes on in steps.

use crate::master::Config;
use crate::time::Duration;

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Bursts {
    /// The pause before the last frame that did not come together with another.
    before: Duration,
    /// The longest pause before frames that came together. It fades.
    pause: Duration,
}

impl Bursts {
    /// A frame has come, so long after the last one. On the wire no two frames follow each other within half of the
    /// longest one's time.
    #[inline]
    pub(super) fn frame_has_come(&mut self, after: Duration, config: &Config) {
        if after + after < config.frame_time {
            self.pause = self.pause.max(self.before);
        } else {
            // After that nothing is expected, or the configuration allows for an adapter that holds frames for longer.
            self.before = after.min(config.longest_response);
            self.pause = Duration::from_micros(self.pause.as_micros() - self.pause.as_micros() / 4);
        }
    }

    /// A silence of this length shows nothing: frames may be held back.
    pub(super) fn pause(self) -> Duration {
        self.pause
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn us(micros: u64) -> Duration {
        Duration::from_micros(micros)
    }

    #[test]
    fn frames_that_come_together_show_that_they_were_held_back() {
        let mut bursts = Bursts::default();
        let mut comes = |after| {
            bursts.frame_has_come(us(after), &Config::CAN);
            bursts.pause()
        };
        // One after the other; 111 bits are the shortest.
        assert_eq!(comes(1_900), Duration::ZERO);
        assert_eq!(comes(111), Duration::ZERO);
        // A millisecond later two at once.
        assert_eq!(comes(1_000), Duration::ZERO);
        assert_eq!(comes(67), us(1_000));
        // It fades while they come one by one.
        assert_eq!([comes(68), comes(500)], [us(750), us(563)]);
        assert_eq!(comes(0), us(563), "the pause before was shorter");
        // No drive takes that long to answer: nothing was asked.
        assert_eq!([comes(10_000), comes(0)], [us(423), Config::CAN.longest_response]);
    }
}
