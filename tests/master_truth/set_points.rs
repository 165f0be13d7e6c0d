//! What became of a stream's newest set-point: it is sent, replaced, or reported as dropped, and then not sent.

use myactuator_protocol_core::time::{Duration, Instant};

/// A set-point that a caller has put and the bus has not taken.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    number: u32,
    /// In the master's time.
    since: Instant,
    /// It was stopped, the bus took nothing, or the like: it may be dropped before its time is up.
    may_be_dropped: bool,
}

/// The set-points of one motor.
#[derive(Clone, Debug, Default)]
pub(crate) struct SetPoints {
    waiting: Option<Waiting>,
    /// The newest that the bus took, which a controller may hand back.
    taken: Option<Waiting>,
    /// One may have been dropped, and that not reported yet, before the one that waits was put.
    is_one_untold: bool,
    told_dropped: u32,
    /// It was dropped then, and only a restart that is reported later can be the reason.
    owes_restart: Option<Instant>,
    /// When the newest was put, by the count of moments.
    pub(crate) put_at: u64,
    /// How many were taken by the bus, and not handed back.
    pub(crate) sent: u64,
    /// How many of these were answered within the shortest time after which one counts as lost.
    pub(crate) answered_soon: u64,
    /// How many of these were reported as unanswered.
    pub(crate) told_unanswered: u64,
    /// The last of them.
    last_unanswered: Option<u32>,
    /// When the newest was taken, by the master's clock.
    taken_at: Instant,
    /// How many had been in the controller when they were handed back: their time may have been up, and that not
    /// reported yet. And how many seemed to be handed back by a drive that ignored them, and may still be answered.
    untold: u64,
}

impl Waiting {
    fn is_droppable(self, now: Instant, max_age: Duration) -> bool {
        self.may_be_dropped || now - self.since >= max_age
    }
}

impl SetPoints {
    pub(crate) fn put(&mut self, number: u32, now: Instant, max_age: Duration) {
        let since = now;
        let new = Waiting { number, since, may_be_dropped: false };
        let before = self.waiting.replace(new);
        self.is_one_untold |= before.is_some_and(|before| before.is_droppable(now, max_age));
    }

    /// Something has happened that drops what waits.
    pub(crate) fn may_be_dropped(&mut self) {
        for waiting in [&mut self.waiting, &mut self.taken].into_iter().flatten() {
            waiting.may_be_dropped = true;
        }
    }

    /// The bus has taken it. Returns what is wrong with that.
    pub(crate) fn taken(&mut self, number: u32, now: Instant) -> Option<&'static str> {
        self.sent += 1;
        self.taken_at = now;
        if let Some(waiting) = self.waiting.take_if(|waiting| waiting.number == number) {
            self.taken = Some(waiting);
        }
        (number <= self.told_dropped).then_some("was told as dropped")
    }

    /// The controller has handed it back: it waits again if it is the newest.
    pub(crate) fn handed_back(&mut self, number: u32, now: Instant) {
        self.sent -= 1;
        // It was reported while it was in the controller.
        let was_told = self.last_unanswered.take_if(|told| *told == number).is_some();
        self.told_unanswered -= u64::from(was_told);
        self.untold += u64::from(!was_told && now > self.taken_at);
        if let Some(taken) = self.taken.take_if(|taken| taken.number == number) {
            // Another that was put meanwhile has replaced it.
            self.waiting.get_or_insert(taken);
        }
    }

    /// It is reported that one was dropped. Returns whether that can be true.
    pub(crate) fn dropped(&mut self, now: Instant, max_age: Duration) -> bool {
        if std::mem::take(&mut self.is_one_untold) {
            return true;
        }
        let Some(waiting) = self.waiting.take() else { return false };
        self.told_dropped = waiting.number;
        if !waiting.is_droppable(now, max_age) {
            // Then it has restarted, and that is reported next.
            self.owes_restart.get_or_insert(now);
        }
        true
    }

    /// It is reported that the motor has restarted.
    pub(crate) fn restarted(&mut self) {
        self.owes_restart = None;
        self.may_be_dropped();
    }

    /// Whether one was dropped without a reason: because of a restart that has not been reported for this long.
    pub(crate) fn is_dropped_for_nothing(&self, now: Instant, within: Duration) -> bool {
        self.owes_restart.is_some_and(|since| now - since > within)
    }

    /// An echo of one has passed for what a drive hands back.
    pub(crate) fn seemed_ignored(&mut self) {
        self.untold += 1;
    }

    /// It is reported that one was not answered. Returns whether that can be true.
    pub(crate) fn unanswered(&mut self) -> bool {
        self.told_unanswered += 1;
        self.last_unanswered = self.taken.map(|taken| taken.number);
        self.told_unanswered + self.answered_soon <= self.sent + self.untold
    }
}
