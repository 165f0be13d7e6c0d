//! What can go wrong with a bus that was named by an address.

use std::fmt;

use crate::port::PortError;
use crate::sim::FleetError;
use crate::sim::bus::{can::CanError, rs485::SerialError};

/// A bus, real or simulated, that cannot be opened, or that fails while in use.
///
/// `Debug` prints the same sentence as `Display`, as [`PortError`] does.
pub enum BusError {
    /// A real bus.
    Port(PortError),
    /// The drives of a simulated bus cannot be made.
    Fleet(FleetError),
    /// A simulated CAN bus that faults keep from working.
    SimulatedCan(CanError),
    /// A simulated RS485 line that faults keep from working.
    SimulatedRs485(SerialError),
}

impl BusError {
    /// Whether the bus itself carries nothing, as opposed to a computer that cannot reach it.
    pub const fn is_outage(&self) -> bool {
        matches!(self, Self::Port(error) if error.is_outage())
    }
}

impl fmt::Display for BusError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Port(error) => error.fmt(f),
            Self::Fleet(error) => write!(f, "the drives cannot be simulated: {error}"),
            Self::SimulatedCan(error) => write!(f, "the simulated CAN bus fails: {error}"),
            Self::SimulatedRs485(error) => write!(f, "the simulated RS485 line fails: {error}"),
        }
    }
}

impl fmt::Debug for BusError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl std::error::Error for BusError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Port(error) => Some(error),
            Self::Fleet(error) => Some(error),
            Self::SimulatedCan(error) => Some(error),
            Self::SimulatedRs485(error) => Some(error),
        }
    }
}

impl From<PortError> for BusError {
    fn from(error: PortError) -> Self {
        Self::Port(error)
    }
}

impl From<FleetError> for BusError {
    fn from(error: FleetError) -> Self {
        Self::Fleet(error)
    }
}
