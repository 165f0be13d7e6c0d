//! What became of a stream's newest set-point: it is sent, or replaced, or reported as dropped and then not sent.

use myactuator_protocol_core::time::{Duration, Instant};

/// A set-point that a caller has put and the bus has not taken.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    number: u32,
    /// In the master's time.
    since: Instant,
    /// It may be dropped before its time is up, because of a stop, a failed bus, or the like.
    may_be_dropped: bool,
}

/// The set-points of one motor.
#[derive(Clone, Debug, Default)]
pub(crate) struct SetPoints {
    waiting: Option<Waiting>,
    /// The newest that the bus has taken. A controller may hand it back.
    taken: Option<Waiting>,
    /// One may have been dropped before the pending one was put, which was not reported yet.
    is_one_untold: bool,
    told_dropped: u32,
    /// When one was dropped for which only a restart, still to be reported, can be the reason.
    owes_restart: Option<Instant>,
    /// When the newest was put, in counted moments.
    pub(crate) put_at: u64,
    /// How many the bus has taken and not handed back.
    pub(crate) sent: u64,
    /// How many of these were answered within the shortest time after which one counts as lost.
    pub(crate) answered_soon: u64,
    /// How many of these were reported as unanswered.
    pub(crate) told_unanswered: u64,
    /// The last one that was reported as unanswered.
    last_unanswered: Option<u32>,
    /// When the newest was taken, by the master's clock.
    taken_at: Instant,
    /// How many may be reported as unanswered besides those sent: a controller handed them back when their time may
    /// have been up, which was not reported yet; or they seemed ignored by their drive, and may still be answered.
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

    /// Something has happened that may drop pending set-points.
    pub(crate) fn may_be_dropped(&mut self) {
        for waiting in [&mut self.waiting, &mut self.taken].into_iter().flatten() {
            waiting.may_be_dropped = true;
        }
    }

    /// The bus has taken it. Returns what is wrong with that, if anything.
    pub(crate) fn taken(&mut self, number: u32, now: Instant) -> Option<&'static str> {
        self.sent += 1;
        self.taken_at = now;
        if let Some(waiting) = self.waiting.take_if(|waiting| waiting.number == number) {
            self.taken = Some(waiting);
        }
        (number <= self.told_dropped).then_some("was reported as dropped")
    }

    /// The controller has handed it back. If it is the newest, it is pending again.
    pub(crate) fn handed_back(&mut self, number: u32, now: Instant) {
        self.sent -= 1;
        // It was reported as unanswered while it was in the controller.
        let was_told = self.last_unanswered.take_if(|told| *told == number).is_some();
        self.told_unanswered -= u64::from(was_told);
        self.untold += u64::from(!was_told && now > self.taken_at);
        if let Some(taken) = self.taken.take_if(|taken| taken.number == number) {
            // A set-point that was put meanwhile replaces it.
            self.waiting.get_or_insert(taken);
        }
    }

    /// A drop is reported. Returns whether that can be true.
    pub(crate) fn dropped(&mut self, now: Instant, max_age: Duration) -> bool {
        if std::mem::take(&mut self.is_one_untold) {
            return true;
        }
        let Some(waiting) = self.waiting.take() else { return false };
        self.told_dropped = waiting.number;
        if !waiting.is_droppable(now, max_age) {
            // Then the motor has restarted, which is reported next.
            self.owes_restart.get_or_insert(now);
        }
        true
    }

    /// A restart of the motor is reported.
    pub(crate) fn restarted(&mut self) {
        self.owes_restart = None;
        self.may_be_dropped();
    }

    /// Whether one was dropped without a reason: the restart that would explain it was not reported in this time.
    pub(crate) fn is_dropped_for_nothing(&self, now: Instant, within: Duration) -> bool {
        self.owes_restart.is_some_and(|since| now - since > within)
    }

    /// An echo of one has passed for a command that a drive hands back.
    pub(crate) fn seemed_ignored(&mut self) {
        self.untold += 1;
    }

    /// An unanswered set-point is reported. Returns whether that can be true.
    pub(crate) fn unanswered(&mut self) -> bool {
        self.told_unanswered += 1;
        self.last_unanswered = self.taken.map(|taken| taken.number);
        self.told_unanswered + self.answered_soon <= self.sent + self.untold
    }
}
