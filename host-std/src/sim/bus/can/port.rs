//! A master's port on a CAN bus.

use embedded_can::ErrorKind;
use myactuator_protocol_core::io::AsyncCan;
use myactuator_protocol_core::wire::can::SimpleFrame;

use super::CanBus;
use crate::sim::bus::Port;
use crate::sim::bus::waiting::Awaited;

/// What a port's calls can fail with.
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
/// No time passes in its calls. In virtual time, a loop that does nothing but poll would therefore
/// poll forever: let a [`SimClock`](crate::sim::bus::SimClock) idle between polls. As an [`AsyncCan`] it
/// waits, and [`World::block_on`](crate::sim::bus::World::block_on) lets time go on meanwhile.
pub type CanPort = Port<CanBus>;

impl embedded_can::nb::Can for CanPort {
    type Frame = SimpleFrame;
    type Error = CanError;

    fn transmit(&mut self, frame: &SimpleFrame) -> nb::Result<Option<SimpleFrame>, CanError> {
        let station = self.station.0;
        self.world.with(|kernel| {
            if kernel.bus.controllers[station].is_bus_off() {
                return Err(nb::Error::Other(CanError::BusOff));
            }
            if kernel.submit(station, *frame) {
                return Ok(None);
            }
            let controller = &mut kernel.bus.controllers[station];
            let displaced = controller.displace(frame).ok_or(nb::Error::WouldBlock)?;
            kernel.submit(station, *frame);
            Ok(Some(displaced))
        })
    }

    fn receive(&mut self) -> nb::Result<SimpleFrame, CanError> {
        self.world.with(|kernel| kernel.read(self.station.0)).ok_or(nb::Error::WouldBlock)
    }
}

impl AsyncCan for CanPort {
    type Frame = SimpleFrame;
    type Error = CanError;

    async fn transmit(&mut self, frame: &SimpleFrame) -> Result<Option<SimpleFrame>, CanError> {
        loop {
            match embedded_can::nb::Can::transmit(self, frame) {
                Err(nb::Error::WouldBlock) => {}
                Err(nb::Error::Other(error)) => return Err(error),
                Ok(displaced) => return Ok(displaced),
            }
            self.world.come(Awaited::room_at(self.station)).await;
        }
    }

    async fn receive(&mut self) -> Result<SimpleFrame, CanError> {
        loop {
            match embedded_can::nb::Can::receive(self) {
                Err(nb::Error::WouldBlock) => {}
                Err(nb::Error::Other(error)) => return Err(error),
                Ok(frame) => return Ok(frame),
            }
            self.world.come(Awaited::received_at(self.station)).await;
        }
    }
}
