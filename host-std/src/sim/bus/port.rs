//! A master's place on a bus.

use super::kernel::Kernel;
use super::medium::Medium;
use super::waiting::Awaited;
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

    /// Tries now, and again whenever its station has what it waits for, until there is a result.
    pub(super) async fn until_done<T>(
        &self,
        is_so: fn(&Kernel<B>, usize) -> bool,
        mut attempt: impl FnMut(&mut Kernel<B>) -> Option<T>,
    ) -> T {
        loop {
            if let Some(result) = self.world.with(&mut attempt) {
                return result;
            }
            self.world.come(Awaited::Station(self.station.0, is_so)).await;
        }
    }
}
