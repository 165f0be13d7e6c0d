//! A master's place on a bus.

use super::medium::Medium;
use super::{StationId, World};

/// A master's port on a simulated bus: [`CanPort`](super::can::CanPort) or
/// [`SerialPort`](super::rs485::SerialPort). A clone is the same port.
#[derive(Debug)]
pub struct Port<B: Medium> {
    pub(super) world: World<B>,
    pub(super) station: StationId,
}

impl<B: Medium> Clone for Port<B> {
    fn clone(&self) -> Self {
        Self { world: self.world.clone(), station: self.station }
    }
}

impl<B: Medium> Port<B> {
    /// Its place on the bus.
    pub const fn station(&self) -> StationId {
        self.station
    }

    /// The world that it is in.
    pub const fn world(&self) -> &World<B> {
        &self.world
    }
}
