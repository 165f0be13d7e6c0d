//! From a bouncing contact to presses.

use myactuator_protocol_core::time::{Duration, Instant};

/// A contact that has not changed for this long has stopped bouncing.
const SETTLED_AFTER: Duration = Duration::from_millis(20);
/// A press of this length is a long one.
const LONG: Duration = Duration::from_secs(1);

/// How a button was pressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Press {
    /// The contact has just closed. That is reason enough to stop, but for nothing else.
    Down,
    /// The button came up again, and stays up.
    Short {
        /// When it went down.
        since: Instant,
    },
    /// It is held.
    Long {
        /// When it went down.
        since: Instant,
    },
}

/// Since when the button is pressed; `None` if nothing more is to be reported of this press.
type Pressed = Option<Instant>;

#[derive(Clone, Copy, Debug)]
enum Contact {
    /// Open, and settled.
    Open,
    /// Closed.
    Closed(Pressed),
    /// Open since `since`. The press is over unless the contact bounces.
    Opening { since: Instant, pressed: Pressed },
}

/// Debounces a contact.
#[derive(Debug)]
pub(super) struct Button {
    contact: Contact,
}

impl Button {
    /// A button that is down at the start counts only after it was up, so that a jammed button starts nothing.
    pub(super) const fn new() -> Self {
        Self { contact: Contact::Closed(None) }
    }

    /// Reports nothing more until the button was up.
    pub(super) fn use_up(&mut self) {
        if let Contact::Closed(pressed) | Contact::Opening { pressed, .. } = &mut self.contact {
            *pressed = None;
        }
    }

    /// Takes how the contact is now, and returns what that adds to the press.
    pub(super) fn look(&mut self, is_down: bool, now: Instant) -> Option<Press> {
        let (contact, press) = match (self.contact, is_down) {
            (Contact::Open, true) => (Contact::Closed(Some(now)), Some(Press::Down)),
            (Contact::Closed(Some(since)), true) if now - since >= LONG => {
                (Contact::Closed(None), Some(Press::Long { since }))
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
