//! From a bouncing contact to presses that count.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::master::MotorSet;
use myactuator_protocol_core::time::{Duration, Instant};

/// A contact that has not changed for this long has stopped bouncing.
const SETTLED_AFTER: Duration = Duration::from_millis(20);
/// A press of this length is a long one.
const LONG: Duration = Duration::from_secs(1);

/// A press this soon after the motors were stopped by something else was meant to stop them.
const MEANT_TO_STOP: Duration = Duration::from_secs(1);
/// A motor that lets go or has an error again keeps no more presses from counting, until none was told to hold again
/// for this long.
const AGAIN: Duration = Duration::from_secs(3);

/// How a button was pressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Press {
    /// The contact has just closed. That is reason enough to stop, but for nothing else.
    Down,
    /// The button came up again, and stays up.
    Short,
    /// It is held.
    Long,
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

/// Debounces a contact, and knows which presses count.
#[derive(Debug)]
pub(super) struct Button {
    contact: Contact,
    /// A short press that begins before this does not count.
    short_from: Instant,
    /// A long press that begins before this does not.
    long_from: Instant,
    /// Motors that were [caught](Self::caught).
    caught: MotorSet,
    /// When the last of them was.
    caught_at: Instant,
}

impl Button {
    /// A button that is down at the start counts only after it was up, so that a jammed button starts nothing.
    pub(super) const fn new(now: Instant) -> Self {
        let contact = Contact::Closed(None);
        let caught = MotorSet::EMPTY;
        Self { contact, short_from: now, long_from: now, caught, caught_at: now }
    }

    /// Something else has stopped the motors. Whoever presses within a second meant to do that, so a short press does
    /// not count. A long one that began before does not either: it was meant for what there was then.
    pub(super) fn stopped(&mut self, now: Instant) {
        self.short_from = now + MEANT_TO_STOP;
        self.long_from = self.long_from.max(now);
    }

    /// A shaft turns. Whoever presses within a second saw that, so a long press does not count either.
    pub(super) fn fell(&mut self, now: Instant) {
        self.short_from = now + MEANT_TO_STOP;
        self.long_from = now + MEANT_TO_STOP;
    }

    /// A motor that had let go, or had an error, is told to hold again: its shaft may have turned. If that happens
    /// to it again and again, it does not take the button away for ever.
    pub(super) fn caught(&mut self, motor: MotorId, now: Instant) {
        if now - self.caught_at >= AGAIN {
            self.caught = MotorSet::EMPTY;
        }
        if !self.caught.contains(motor) {
            self.fell(now);
        }
        self.caught.insert(motor);
        self.caught_at = now;
    }

    /// Reports nothing more until the button was up.
    pub(super) fn use_up(&mut self) {
        if let Contact::Closed(pressed) | Contact::Opening { pressed, .. } = &mut self.contact {
            *pressed = None;
        }
    }

    /// Takes how the contact is now, and returns what that adds to the press, if it counts.
    pub(super) fn look(&mut self, is_down: bool, now: Instant) -> Option<Press> {
        let (contact, press) = match (self.contact, is_down) {
            (Contact::Open, true) => (Contact::Closed(Some(now)), Some(Press::Down)),
            (Contact::Closed(Some(since)), true) if now - since >= LONG => {
                let press = (since >= self.long_from).then_some(Press::Long);
                (Contact::Closed(None), press)
            }
            (Contact::Closed(pressed), false) => (Contact::Opening { since: now, pressed }, None),
            (Contact::Opening { pressed, .. }, true) => (Contact::Closed(pressed), None),
            (Contact::Opening { since, pressed }, false) if now - since >= SETTLED_AFTER => {
                let counts =
                    |down: Instant| since - down >= SETTLED_AFTER && down >= self.short_from;
                (Contact::Open, pressed.is_some_and(counts).then_some(Press::Short))
            }
            (contact, _) => (contact, None),
        };
        self.contact = contact;
        press
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Instant {
        Instant::ZERO + Duration::from_millis(ms)
    }

    /// A button that is up at the start.
    fn button() -> Button {
        let mut button = Button::new(at(0));
        assert_eq!(pressed(&mut button, 0..0), None);
        button
    }

    /// What counts of a press of this time, in milliseconds.
    fn pressed(button: &mut Button, down: core::ops::Range<u64>) -> Option<Press> {
        let looks = down.start..down.end.max(down.start) + 50;
        let all = looks.filter_map(|ms| button.look(down.contains(&ms), at(ms)));
        all.filter(|&press| press != Press::Down).last()
    }

    #[test]
    fn a_motor_that_is_caught_again_within_three_seconds_keeps_no_press_from_counting() {
        let mut button = button();
        let cases = [(1_000, None), (2_500, Some(Press::Short)), (6_000, None)];
        for (caught_ms, counts) in cases {
            button.caught(MotorId::MIN, at(caught_ms));
            let press = pressed(&mut button, caught_ms + 100..caught_ms + 150);
            assert_eq!(press, counts, "{caught_ms} ms");
        }
    }

    #[test]
    fn a_long_press_counts_only_if_it_was_meant_for_what_there_is() {
        let mut button = button();
        button.fell(at(1_000));
        button.stopped(at(1_100));
        assert_eq!(pressed(&mut button, 1_200..2_300), None, "it began soon after a fall");
        assert_eq!(pressed(&mut button, 2_400..3_500), Some(Press::Long));
        assert_eq!(pressed(&mut button, 4_000..4_500), Some(Press::Short));
    }

    #[test]
    fn a_long_press_that_began_before_a_stop_does_not_count() {
        let mut button = button();
        assert_eq!(button.look(true, at(1_000)), Some(Press::Down));
        button.stopped(at(1_500));
        assert_eq!(pressed(&mut button, 1_501..2_100), None);
    }
}
