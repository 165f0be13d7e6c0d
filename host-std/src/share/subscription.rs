//! Events for any thread that wants them.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};

use myactuator_protocol_core::master::Event;

/// The events of a bus, in their order: of all motors, including answers to the questions of other threads.
///
/// As an iterator it waits for the next event, and ends with the bus. It holds as many events as it was
/// [made for](super::SharedBus::subscribe). Events that come while it is full are lost, and counted, so that no
/// subscriber holds the bus up.
#[derive(Debug)]
pub struct Subscription {
    events: Receiver<Event>,
    lost: Arc<AtomicU64>,
}

impl Subscription {
    /// The next event, if there is one already.
    pub fn try_next(&self) -> Option<Event> {
        self.events.try_recv().ok()
    }

    /// How many events were lost so far.
    pub fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }
}

impl Iterator for Subscription {
    type Item = Event;

    fn next(&mut self) -> Option<Event> {
        self.events.recv().ok()
    }
}

/// The other end of a [`Subscription`].
#[derive(Debug)]
pub(super) struct Subscriber {
    events: SyncSender<Event>,
    lost: Arc<AtomicU64>,
}

impl Subscriber {
    /// Both ends of a subscription with room for so many events, at least one.
    pub(super) fn new(room: usize) -> (Self, Subscription) {
        let (sender, receiver) = sync_channel(room.max(1));
        let lost = Arc::new(AtomicU64::new(0));
        let subscription = Subscription { events: receiver, lost: Arc::clone(&lost) };
        (Self { events: sender, lost }, subscription)
    }

    /// Delivers an event, if there is room. False if the subscription was dropped.
    pub(super) fn deliver(&self, event: &Event) -> bool {
        match self.events.try_send(*event) {
            Ok(()) => true,
            Err(TrySendError::Full(_)) => {
                self.lost.fetch_add(1, Ordering::Relaxed);
                true
            }
            Err(TrySendError::Disconnected(_)) => false,
        }
    }
}
