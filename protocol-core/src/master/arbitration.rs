//! CAN: what a reply shows about those that have not come.

use crate::packet::Channel;
use crate::time::Instant;
use crate::wire::can::identifier;

/// The reply that was heard last. It has won the arbitration: no more urgent one was waiting when its frame began.
#[derive(Clone, Copy, Debug)]
pub(super) struct LastReply {
    identifier: u16,
    /// Its frame began no sooner.
    began: Instant,
}

impl LastReply {
    /// Nothing was heard.
    pub(super) const NONE: Self = Self { identifier: 0, began: Instant::ZERO };

    pub(super) fn new(channel: Channel, began: Instant) -> Self {
        Self { identifier: identifier(channel), began }
    }

    /// Whether a reply on this channel, if it had been waiting since then, would have come first.
    pub(super) fn came_instead_of(self, channel: Channel, since: Instant) -> bool {
        identifier(channel) < self.identifier && since <= self.began
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::id::MotorId;

    #[test]
    fn only_what_loses_arbitration_shows_that_nothing_waited() {
        let [first, second] = [1, 2].map(|id| MotorId::new(id).unwrap());
        // 0x242 loses to 0x241 and wins against 0x501.
        let since = Instant::from_micros(5_000);
        let last = LastReply::new(Channel::Reply(second), since);
        assert!(last.came_instead_of(Channel::Reply(first), since));
        assert!(!last.came_instead_of(Channel::Reply(second), since));
        assert!(!last.came_instead_of(Channel::MotionReply(first), since));
        // It may not have been ready yet.
        assert!(!last.came_instead_of(Channel::Reply(first), Instant::from_micros(5_001)));
        assert!(!LastReply::NONE.came_instead_of(Channel::Reply(first), Instant::ZERO));
    }
}
