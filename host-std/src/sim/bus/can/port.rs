//! A master's port on a CAN bus.

use embedded_can::ErrorKind;
use myactuator_protocol_core::io::AsyncCan;
use myactuator_protocol_core::wire::can::SimpleFrame;

use super::CanBus;
use crate::sim::bus::Port;
use crate::sim::bus::kernel::Kernel;

/// The errors of a port's calls.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CanError {
    /// The controller counted too many errors and takes no frames until it has recovered.
    #[error(
        "the CAN controller is bus-off: expected a working bus, found more than 255 transmit errors; \
         mend the bus and wait for the controller to recover, or reset it"
    )]
    BusOff,
}

impl embedded_can::Error for CanError {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

/// A master's port on a simulated CAN bus, with a controller of its own.
///
/// No time passes in its calls. So in virtual time a loop that only polls would
/// poll for ever: let a [`SimClock`](crate::sim::bus::SimClock) idle between polls. As an [`AsyncCan`] it
/// waits, and [`World::block_on`](crate::sim::bus::World::block_on) lets time go on meanwhile.
pub type CanPort = Port<CanBus>;

/// Queues a frame, unless there is no room.
fn transmit(
    kernel: &mut Kernel<CanBus>,
    station: usize,
    frame: &SimpleFrame,
) -> Option<Result<Option<SimpleFrame>, CanError>> {
    if kernel.bus.controllers[station].is_bus_off() {
        return Some(Err(CanError::BusOff));
    }
    if kernel.submit(station, *frame) {
        return Some(Ok(None));
    }
    let displaced = kernel.bus.controllers[station].displace(frame)?;
    kernel.submit(station, *frame);
    Some(Ok(Some(displaced)))
}

impl embedded_can::nb::Can for CanPort {
    type Frame = SimpleFrame;
    type Error = CanError;

    fn transmit(&mut self, frame: &SimpleFrame) -> nb::Result<Option<SimpleFrame>, CanError> {
        let done = self.world.with(|kernel| transmit(kernel, self.station.0, frame));
        done.ok_or(nb::Error::WouldBlock)?.map_err(nb::Error::Other)
    }

    fn receive(&mut self) -> nb::Result<SimpleFrame, CanError> {
        self.world.with(|kernel| kernel.read(self.station.0)).ok_or(nb::Error::WouldBlock)
    }
}

impl AsyncCan for CanPort {
    type Frame = SimpleFrame;
    type Error = CanError;

    async fn transmit(&mut self, frame: &SimpleFrame) -> Result<Option<SimpleFrame>, CanError> {
        let attempt = |kernel: &mut _| transmit(kernel, self.station.0, frame);
        self.until_done(Kernel::has_room, attempt).await
    }

    async fn receive(&mut self) -> Result<SimpleFrame, CanError> {
        let attempt = |kernel: &mut Kernel<_>| kernel.read(self.station.0);
        Ok(self.until_done(Kernel::has_received, attempt).await)
    }
}
