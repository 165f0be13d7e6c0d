//! A master's port on a CAN bus.

use embedded_can::ErrorKind;
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::wire::can::SimpleFrame;

use super::CanBus;
use crate::sim::bus::kernel::Kernel;
use crate::sim::bus::nanos::{Nanos, from_duration};
use crate::sim::bus::{StationId, World};

/// How long blocking calls wait unless told otherwise.
const GIVE_UP: Duration = Duration::from_secs(1);

/// What a port's calls can fail with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CanError {
    /// The controller counted too many errors and takes no frames until it has recovered.
    #[error(
        "the CAN controller is bus-off: expected a working bus, found more than 255 transmit errors; \
         mend the bus and wait for the controller to recover, or reset it"
    )]
    BusOff,
    /// A blocking call waited as long as it may.
    #[error(
        "no frame went through within {after}: check that somebody on the bus answers, or wait longer"
    )]
    TimedOut {
        /// How long that was.
        after: Duration,
    },
}

impl embedded_can::Error for CanError {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

/// A master's port on a simulated CAN bus, with a controller of its own.
///
/// As [`embedded_can::nb::Can`] no time passes in its calls. In virtual time, a loop that does
/// nothing but poll would therefore poll forever: either let a [`SimClock`](crate::sim::bus::SimClock)
/// idle between polls, or give each fruitless poll a [duration](Self::set_poll_time).
///
/// As [`embedded_can::blocking::Can`] its calls let time go on until they have what they want, but
/// not longer than [a limit](Self::set_give_up), 1 s unless set.
///
/// A clone is the same port.
#[derive(Clone, Debug)]
pub struct CanPort {
    world: World<CanBus>,
    station: StationId,
    give_up: Duration,
    poll_time: Duration,
}

impl CanPort {
    pub(super) const fn new(world: World<CanBus>, station: StationId) -> Self {
        Self { world, station, give_up: GIVE_UP, poll_time: Duration::ZERO }
    }

    /// Its place on the bus.
    pub const fn station(&self) -> StationId {
        self.station
    }

    /// The world that it is in.
    pub const fn world(&self) -> &World<CanBus> {
        &self.world
    }

    /// How long blocking calls wait at most.
    pub fn set_give_up(&mut self, after: Duration) {
        self.give_up = after;
    }

    /// How much virtual time passes in each poll that ends in
    /// [`WouldBlock`](nb::Error::WouldBlock): the cost of a polling loop's round. None unless set; in
    /// real time without effect.
    pub fn set_poll_time(&mut self, span: Duration) {
        self.poll_time = span;
    }

    fn would_block<T>(&self) -> nb::Result<T, CanError> {
        if self.poll_time != Duration::ZERO {
            self.world.pass(self.poll_time);
        }
        Err(nb::Error::WouldBlock)
    }

    fn wait<T>(&self, done: impl FnMut(&mut Kernel<CanBus>) -> Option<T>) -> Result<T, CanError> {
        let until: Nanos = self.world.now_ns().saturating_add(from_duration(self.give_up));
        self.world.wait(until, done).ok_or(CanError::TimedOut { after: self.give_up })
    }
}

impl embedded_can::nb::Can for CanPort {
    type Frame = SimpleFrame;
    type Error = CanError;

    fn transmit(&mut self, frame: &SimpleFrame) -> nb::Result<Option<SimpleFrame>, CanError> {
        let station = self.station.0;
        let taken = self.world.with(|kernel| {
            if kernel.bus.is_bus_off(station) {
                return Err(CanError::BusOff);
            }
            if kernel.submit(station, *frame) {
                return Ok(Some(None));
            }
            let displaced = kernel.bus.displace(station, frame);
            if displaced.is_some() {
                kernel.submit(station, *frame);
            }
            Ok(displaced.map(Some))
        });
        match taken {
            Ok(Some(displaced)) => Ok(displaced),
            Ok(None) => self.would_block(),
            Err(error) => Err(nb::Error::Other(error)),
        }
    }

    fn receive(&mut self) -> nb::Result<SimpleFrame, CanError> {
        match self.world.with(|kernel| kernel.read(self.station.0)) {
            Some(frame) => Ok(frame),
            None => self.would_block(),
        }
    }
}

impl embedded_can::blocking::Can for CanPort {
    type Frame = SimpleFrame;
    type Error = CanError;

    fn transmit(&mut self, frame: &SimpleFrame) -> Result<(), CanError> {
        let station = self.station.0;
        self.wait(|kernel| {
            if kernel.bus.is_bus_off(station) {
                return Some(Err(CanError::BusOff));
            }
            kernel.submit(station, *frame).then_some(Ok(()))
        })?
    }

    fn receive(&mut self) -> Result<SimpleFrame, CanError> {
        self.wait(|kernel| kernel.read(self.station.0))
    }
}
