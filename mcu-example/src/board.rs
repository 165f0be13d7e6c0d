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

    /// How the board itself has done since the start.
    fn usage(&mut self) -> Usage;
}

/// How a board has done since the start. What it cannot tell is 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// The deepest that the stack has been, in bytes.
    pub stack: u32,
    /// The most that has waited at once for the loop to take it: bytes of a serial port, frames of a CAN
    /// controller.
    pub queued: u32,
    /// What came from the bus and was lost before the loop could take it, in bytes or frames: it found no
    /// place, or was disturbed on its way.
    pub dropped: u32,
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
