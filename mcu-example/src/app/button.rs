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
    /// It came up again, and stays open.
    Short {
        /// When it went down.
        since: Instant,
    },
    /// It is held.
    Long,
}

/// A press under way: since when, or no more to be reported of it.
type Pressed = Option<Instant>;

#[derive(Clone, Copy, Debug)]
enum Contact {
    /// Open, and settled.
    Open,
    /// Closed.
    Closed(Pressed),
    /// Open since then: the press is over unless the contact bounces.
    Opening { since: Instant, pressed: Pressed },
}

/// Looks at a contact again and again.
#[derive(Debug)]
pub(super) struct Button {
    contact: Contact,
}

impl Button {
    /// A button that is down at the start counts only after it was up: a jammed one starts nothing.
    pub(super) const fn new() -> Self {
        Self { contact: Contact::Closed(None) }
    }

    /// Nothing more is reported until the button was up.
    pub(super) fn use_up(&mut self) {
        if let Contact::Closed(pressed) | Contact::Opening { pressed, .. } = &mut self.contact {
            *pressed = None;
        }
    }

    /// What the contact, seen now, adds to what it was before.
    pub(super) fn look(&mut self, is_down: bool, now: Instant) -> Option<Press> {
        let (contact, press) = match (self.contact, is_down) {
            (Contact::Open, true) => (Contact::Closed(Some(now)), Some(Press::Down)),
            (Contact::Closed(Some(since)), true) if now - since >= LONG => {
                (Contact::Closed(None), Some(Press::Long))
            }
            (Contact::Closed(pressed), false) => (Contact::Opening { since: now, pressed }, None),
            (Contact::Opening { pressed, .. }, true) => (Contact::Closed(pressed), None),
            (Contact::Opening { since, pressed }, false) if now - since >= SETTLED_AFTER => {
                let pressed = pressed.filter(|&pressed| since - pressed >= SETTLED_AFTER);
                (Contact::Open, pressed.map(|since| Press::Short { since }))
            }
            (contact, _) => (contact, None),
        };
        self.contact = contact;
        press
    }
}
