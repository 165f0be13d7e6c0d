//! What can go wrong with a bus that was named by an address.

use std::fmt;

use crate::port::PortError;
use crate::sim::FleetError;
use crate::sim::bus::{can::CanError, rs485::SerialError};

/// A bus, real or simulated, that cannot be opened, or that fails while in use.
///
/// `Debug` prints the same sentence as `Display`, as [`PortError`] does.
#[derive(thiserror::Error)]
pub enum BusError {
    /// A real bus.
    #[error("{0}")]
    Port(#[from] PortError),
    /// The drives of a simulated bus cannot be made.
    #[error("the drives cannot be simulated: {0}")]
    Fleet(#[from] FleetError),
    /// Faults keep a simulated CAN bus from working.
    #[error("the simulated CAN bus fails: {0}")]
    SimulatedCan(#[from] CanError),
    /// Faults keep a simulated RS485 line from working.
    #[error("the simulated RS485 line fails: {0}")]
    SimulatedRs485(#[from] SerialError),
}

impl BusError {
    /// Whether the bus itself carries nothing, as opposed to a computer that cannot access it.
    pub const fn is_outage(&self) -> bool {
        matches!(self, Self::Port(error) if error.is_outage())
    }
}

impl fmt::Debug for BusError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}
