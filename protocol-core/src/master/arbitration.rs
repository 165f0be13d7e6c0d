//! CAN: what a reply shows about those that have not come.

use crate::packet::Channel;
use crate::time::{Duration, Instant};
use crate::wire::can::identifier;

/// The reply that was heard last. It has won the arbitration: no more urgent one was waiting when its frame began.
#[derive(Clone, Copy, Debug)]
pub(super) struct LastReply {
    identifier: u16,
    heard: Instant,
}

impl LastReply {
    /// Nothing was heard.
    pub(super) const NONE: Self = Self { identifier: 0, heard: Instant::ZERO };

    pub(super) fn new(channel: Channel, heard: Instant) -> Self {
        Self { identifier: identifier(channel), heard }
    }

    /// Whether a reply on this channel, if it had been waiting since then, would have come first. The frame that was
    /// heard began no longer than `takes` before.
    pub(super) fn came_instead_of(self, channel: Channel, since: Instant, takes: Duration) -> bool {
        identifier(channel) < self.identifier && since + takes <= self.heard
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::id::MotorId;

    #[test]
    fn only_what_loses_arbitration_shows_that_nothing_waited() {
        let [first, second] = [1, 2].map(|id| MotorId::new(id).unwrap());
        let takes = Duration::from_micros(136);
        let came_instead = |last: LastReply, channel, since| {
            last.came_instead_of(channel, Instant::from_micros(since), takes)
        };
        // 0x242 loses to 0x241 and wins against 0x501.
        let last = LastReply::new(Channel::Reply(second), Instant::from_micros(5_136));
        assert!(came_instead(last, Channel::Reply(first), 5_000));
        assert!(!came_instead(last, Channel::Reply(second), 5_000));
        assert!(!came_instead(last, Channel::MotionReply(first), 5_000));
        // It may not have been ready yet.
        assert!(!came_instead(last, Channel::Reply(first), 5_001));
        assert!(!came_instead(LastReply::NONE, Channel::Reply(first), 0));
    }
}
