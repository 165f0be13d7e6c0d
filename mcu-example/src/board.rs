//! What a board supplies.

use crate::report::Report;

/// What a board supplies beside its bus and clock, which are those of the
/// [`Runner`](myactuator_protocol_core::io::Runner).
///
/// None of these functions may wait: they are called within the cycle.
pub trait Board {
    /// Whether the button is down just now. The application takes care of bouncing.
    fn is_button_down(&mut self) -> bool;

    /// Switches the light.
    fn set_light(&mut self, on: bool);

    /// Puts off the watchdog's reset for once. The application calls it only from a cycle that was in
    /// time and in which no running motor was missing. The watchdog has to bite after 100 ms or more.
    fn feed_watchdog(&mut self);

    /// Tells whoever listens.
    fn log(&mut self, report: &Report);

    /// The deepest that the stack has been since the start, in bytes, where the board can tell.
    fn stack_used(&mut self) -> Option<u32>;
}

/// Why the firmware started.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum RestartCause {
    /// Power came, or somebody reset the board.
    Power,
    /// The watchdog was not fed.
    Watchdog,
    /// The firmware panicked, and restarted itself.
    Panic,
    /// The processor reported a fault, a stack that was used up among them.
    Fault,
}
