//! What a board supplies.

use crate::report::Report;

/// What a board supplies besides its bus and its clock, which are those of the
/// [`Runner`](myactuator_protocol_core::io::Runner).
///
/// None of these functions may wait: the cycle calls them.
pub trait Board {
    /// Whether the button is down now. It need not be debounced: the application does that.
    fn is_button_down(&mut self) -> bool;

    /// Switches the light.
    fn set_light(&mut self, on: bool);

    /// Feeds the watchdog once. The application does this only in a cycle that began in time and in which no running
    /// motor was missing. The watchdog's time-out has to be 100 ms or more.
    fn feed_watchdog(&mut self);

    /// Logs a report.
    fn log(&mut self, report: &Report);

    /// What the board has measured of itself since the start.
    fn usage(&mut self) -> Usage;
}

/// What a board has measured of itself since the start. What it cannot measure is 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// The deepest use of the stack, in bytes.
    pub stack: u32,
    /// The most that was queued for the loop at one time: bytes of a serial port, frames of a CAN controller.
    pub queued: u32,
    /// What came from the bus and was lost before the loop took it, in bytes or frames: the queue was full, or it was
    /// received with errors.
    pub dropped: u32,
}

/// Why the firmware started.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum RestartCause {
    /// The board was switched on or reset.
    Power,
    /// The watchdog was not fed.
    Watchdog,
    /// The firmware panicked, and restarted itself.
    Panic,
    /// The processor raised a fault, for example because the stack overflowed.
    Fault,
}
