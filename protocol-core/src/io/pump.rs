//! The round that every loop runs, on CAN and on RS485, polled or as a task. It never waits.

use crate::io::clock::Clock;
use crate::io::elapsed::Elapsed;
use crate::master::{Config, Event, Master};
use crate::time::{Duration, Instant};

/// How often in a row a bus that always has something is looked at, before the loop sends all the same.
const LOOKS_IN_A_ROW: u8 = 64;

/// A bus that takes nothing for this long counts as down.
pub(super) const STUCK_AFTER: Duration = Duration::from_millis(20);

/// A longer pause between two offers counts as this.
const LONGEST_PAUSE_BETWEEN_OFFERS: Duration = Duration::from_millis(10);

/// How soon a bus that takes nothing, or has failed, is tried again.
pub(super) const RETRY_AFTER: Duration = Duration::from_millis(1);

/// What a pump receives from and sends to.
pub(super) trait Port<const N: usize> {
    type Error;

    /// Receives up to the first event. Uses one of the pump's looks for each time that it asks the bus.
    fn receive(&mut self, pump: &mut Pump<N>, now: Instant) -> Result<Option<Event>, Self::Error>;

    /// Sends what the bus takes.
    fn transmit(&mut self, pump: &mut Pump<N>, now: Instant) -> Result<(), Self::Error>;

    /// Whether this error of receiving only says that there was no room for a frame, and nothing about the bus.
    fn is_overrun(_: &Self::Error) -> bool {
        false
    }
}

/// A master, and what its loop remembers from round to round.
#[derive(Clone, Debug)]
pub(super) struct Pump<const N: usize> {
    pub(super) master: Master<N>,
    /// How often the bus is still looked at before the loop sends.
    looks: u8,
    pub(super) refusals: Refusals,
    /// The last round has failed, and may have left events of the master's own.
    has_failed: bool,
    /// Since when each look at the bus ends with an error.
    fails_to_receive_since: Option<Instant>,
    /// A task begins no round before this time, shortly after a round has failed, so that other tasks get their turns.
    pub(super) rests_until: Instant,
}

impl<const N: usize> Pump<N> {
    pub(super) fn new(config: Config) -> Self {
        let (master, refusals) = (Master::new(config), Refusals::default());
        Self {
            master,
            looks: LOOKS_IN_A_ROW,
            refusals,
            has_failed: false,
            fails_to_receive_since: None,
            rests_until: Instant::ZERO,
        }
    }

    /// An event that a failed round has left. It goes before the next round, which may fail as well.
    pub(super) fn left_event(&mut self) -> Option<Event> {
        if self.has_failed { self.master.poll_event() } else { None }
    }

    /// Runs one round. Returns the first event of what was received; the master's own events are not among them.
    pub(super) fn round<P: Port<N>>(
        &mut self,
        port: &mut P,
        now: Instant,
    ) -> Result<Option<Event>, P::Error> {
        // Receiving comes first, so that the caller's reaction to it is there when the next command is chosen.
        let failed = match port.receive(self, now) {
            Ok(None) => None,
            Ok(event) => return Ok(event),
            Err(error) if P::is_overrun(&error) => return Ok(Some(Event::Overrun)),
            Err(error) => Some(error),
        };
        (self.looks, self.has_failed) = (LOOKS_IN_A_ROW, failed.is_some());
        self.master.handle_timeout(now);
        if failed.is_some() {
            self.rests_until = now + RETRY_AFTER;
            let since = *self.fails_to_receive_since.get_or_insert(now);
            self.master.bus_may_be_down(since, now);
        } else {
            self.fails_to_receive_since = None;
        }
        // Some controllers report a bad state at each look, though they send, and until they have sent enough.
        let sent = port.transmit(self, now);
        if sent.is_err() {
            self.round_has_failed(now);
        }
        failed.map_or(sent, Err).map(|()| None)
    }

    /// The port reports an error in sending.
    pub(super) fn round_has_failed(&mut self, now: Instant) {
        self.has_failed = true;
        self.rests_until = now + RETRY_AFTER;
        self.bus_is_down(now);
    }

    /// Whether the bus is looked at once more. A bus that babbles delays neither stops nor time-outs.
    pub(super) fn looks_again(&mut self) -> bool {
        let left = self.looks.checked_sub(1);
        self.looks = left.unwrap_or(0);
        left.is_some()
    }

    /// The bus is down. A stop that still waits is soon offered to it again.
    pub(super) fn bus_is_down(&mut self, now: Instant) {
        self.refusals.note(now);
        self.master.handle_bus_down(now);
    }

    /// When there is next something to do, at the latest at `latest`, unless something arrives first. While the bus
    /// refuses what is due, that is when it is offered again: hardly anything else shows when a bus takes frames again.
    pub(super) fn wake_at(&self, latest: Option<Instant>) -> Option<Instant> {
        let due = self.refusals.retry_at().or_else(|| self.master.poll_at());
        [due, latest].into_iter().flatten().min()
    }

    /// Lets the clock of a loop that polls idle until `until`, or until there is something to do.
    pub(super) fn idle(&self, clock: &impl Clock, until: Instant) {
        clock.idle(self.wake_at(Some(until)).unwrap_or(until));
    }
}

/// How long a bus has taken nothing of what it was offered.
#[derive(Clone, Debug, Default)]
pub(super) struct Refusals(Elapsed);

impl Refusals {
    /// The bus takes nothing. Returns whether it counts as down, for which one pause in which nobody looked is not
    /// enough.
    pub(super) fn note(&mut self, now: Instant) -> bool {
        self.0.with_pauses_up_to(LONGEST_PAUSE_BETWEEN_OFFERS, now) >= STUCK_AFTER
    }

    /// It has taken something.
    pub(super) fn end(&mut self) {
        *self = Self::default();
    }

    /// Nothing is offered to it any more.
    pub(super) fn pause(&mut self) {
        self.0.last = None;
    }

    /// When the bus is offered again what it has refused.
    pub(super) fn retry_at(&self) -> Option<Instant> {
        self.0.last.map(|last| last + RETRY_AFTER)
    }
}
