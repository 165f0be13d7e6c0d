//! From a bouncing contact to presses.

use myactuator_protocol_core::time::{Duration, Instant};

/// A contact that has not changed for so long has stopped bouncing.
const SETTLED_AFTER: Duration = Duration::from_millis(20);
/// Held for so long it is a long press.
const LONG: Duration = Duration::from_secs(1);

/// How a button was pressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Press {
    /// The contact has just closed: soon enough for a stop, too soon for anything else.
    Down,
    /// It came up again.
    Short,
    /// It is held.
    Long,
}

#[derive(Clone, Copy, Debug)]
enum Contact {
    /// Open; a press that came before is over.
    Open,
    /// Closed since then.
    Closed { since: Instant },
    /// Still closed, and no more to be reported of it.
    UsedUp,
}

/// Looks at a contact again and again.
#[derive(Debug)]
pub(super) struct Button {
    contact: Contact,
}

impl Button {
    /// A button that is down at the start counts only after it was up: a jammed one starts nothing.
    pub(super) const fn new() -> Self {
        Self { contact: Contact::UsedUp }
    }

    /// Nothing more is reported until the button was up.
    pub(super) fn use_up(&mut self) {
        self.contact = Contact::UsedUp;
    }

    /// What the contact, seen now, adds to what it was before.
    pub(super) fn look(&mut self, is_down: bool, now: Instant) -> Option<Press> {
        let (contact, press) = match (self.contact, is_down) {
            (Contact::Open, true) => (Contact::Closed { since: now }, Some(Press::Down)),
            (Contact::Closed { since }, true) if now - since >= LONG => {
                (Contact::UsedUp, Some(Press::Long))
            }
            (Contact::Closed { since }, false) => {
                let press = (now - since >= SETTLED_AFTER).then_some(Press::Short);
                (Contact::Open, press)
            }
            (_, false) => (Contact::Open, None),
            (contact, true) => (contact, None),
        };
        self.contact = contact;
        press
    }
}
