//! A motor's stream of set-points: the newest waits, the one before it may be in flight.

use crate::data::Data;
use crate::master::late::Question;
use crate::time::Instant;

/// One set-point.
#[derive(Clone, Copy, Debug)]
pub(super) struct SetPoint {
    pub(super) question: Question,
    pub(super) data: Data,
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Stream {
    /// To be sent.
    waiting: Option<SetPoint>,
    /// Sent, and its feedback is awaited.
    in_flight: Option<SetPoint>,
    /// When the one that waits is too old; or, without one, when the one in flight would be.
    expiry: Instant,
}

impl Stream {
    /// The set-point that is to be sent.
    pub(super) fn waiting(&self) -> Option<&SetPoint> {
        self.waiting.as_ref()
    }

    /// The set-point whose feedback is awaited.
    pub(super) fn in_flight(&self) -> Option<&SetPoint> {
        self.in_flight.as_ref()
    }

    /// When the set-point that waits is dropped.
    pub(super) fn expiry(&self) -> Option<Instant> {
        self.waiting.map(|_| self.expiry)
    }

    /// Puts a newer set-point in the place of the one that waits, which is given.
    pub(super) fn put(&mut self, set_point: SetPoint, expiry: Instant) -> Option<SetPoint> {
        self.expiry = expiry;
        self.waiting.replace(set_point)
    }

    /// The one that waits is not to be sent any more.
    pub(super) fn drop_waiting(&mut self) -> Option<SetPoint> {
        self.waiting.take()
    }

    /// The one that waited was sent.
    pub(super) fn was_sent(&mut self) {
        self.in_flight = self.waiting.take();
    }

    /// The wait for its feedback is over.
    pub(super) fn take_in_flight(&mut self) -> Option<SetPoint> {
        self.in_flight.take()
    }

    /// The one in flight was not sent after all: it waits again, unless a newer one does. Whether it
    /// does.
    pub(super) fn was_pushed_out(&mut self) -> bool {
        let pushed_out = self.in_flight.take();
        let is_newest = self.waiting.is_none();
        if is_newest {
            self.waiting = pushed_out;
        }
        is_newest
    }

    /// Whether feedback of this stream may come that looks like a reply to this question.
    pub(super) fn is_of(&self, question: Question) -> bool {
        let mut all = self.waiting.iter().chain(&self.in_flight);
        all.any(|set_point| set_point.question == question)
    }
}
