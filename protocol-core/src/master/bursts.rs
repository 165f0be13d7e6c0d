//! CAN: how long nothing comes although the bus carries replies, because an adapter holds them back and delivers them
//! together, or the host looks seldom.

use crate::time::Duration;

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Bursts {
    /// The silence before the last frame that did not come together with another.
    before: Duration,
    /// The longest silence before frames that came together. It fades.
    pause: Duration,
}

impl Bursts {
    /// A frame has come, so long after the last one and after so long a silence of the bus. On the wire no two frames
    /// follow each other within half of the longest one's time.
    #[inline]
    pub(super) fn frame_has_come(
        &mut self,
        after: Duration,
        silence: Duration,
        longest_frame: Duration,
    ) {
        if after + after < longest_frame {
            self.pause = self.pause.max(self.before);
        } else {
            self.before = silence;
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
        let mut comes = |after, silence| {
            bursts.frame_has_come(us(after), us(silence), us(136));
            bursts.pause()
        };
        // One after the other; 111 bits are the shortest.
        assert_eq!(comes(2_000, 1_900), Duration::ZERO);
        assert_eq!(comes(111, 0), Duration::ZERO);
        // A millisecond later two at once.
        assert_eq!(comes(1_000, 900), Duration::ZERO);
        assert_eq!(comes(67, 0), us(900));
        // It fades while they come one by one.
        assert_eq!([comes(68, 0), comes(500, 400)], [us(675), us(507)]);
        assert_eq!(comes(0, 0), us(507), "the silence before was shorter");
    }
}
