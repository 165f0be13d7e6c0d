//! A master on the bus that an address names.

use std::io;
use std::sync::Arc;

use myactuator_protocol_core::io::{CanMaster, Runner, SerialMaster};
use myactuator_protocol_core::master::{Config, Event, Master};
use myactuator_protocol_core::time::Instant;

use super::{BusAddress, BusError};
use crate::BusKind;
use crate::port::{HostClock, PortError, Rs485, Slcan, SocketCan};
use crate::sim::Fleet;
use crate::sim::bus::can::{CanBus, CanPort};
use crate::sim::bus::rs485::{Rs485Line, SerialPort};
use crate::sim::bus::{Medium, SimClock, World};

/// A master of up to `N` motors, real or simulated: the same [`Runner`] on every bus.
#[derive(Debug)]
pub enum AnyMaster<const N: usize> {
    /// On a simulated CAN bus, in virtual time: waiting takes no time.
    SimulatedCan(CanMaster<CanPort, SimClock<CanBus>, N>),
    /// On a simulated RS485 line, in virtual time.
    SimulatedRs485(SerialMaster<SerialPort, SimClock<Rs485Line>, N>),
    /// On a CAN interface of Linux.
    SocketCan(CanMaster<SocketCan, HostClock, N>),
    /// On an SLCAN adapter.
    Slcan(CanMaster<Slcan, HostClock, N>),
    /// On an RS485 adapter.
    Rs485(SerialMaster<Rs485, HostClock, N>),
}

impl<const N: usize> AnyMaster<N> {
    /// Opens this bus, or makes it if it is simulated, with the [configuration](BusAddress::config) that suits it.
    ///
    /// # Errors
    /// [`BusError`] says why it cannot be opened, and what to do.
    pub fn open(address: &BusAddress) -> Result<Self, BusError> {
        Self::open_with(address, address.config())
    }

    /// Opens this bus with a configuration of your own, made from
    /// [that of the address](BusAddress::config).
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_with(address: &BusAddress, config: Config) -> Result<Self, BusError> {
        Ok(Self::open_as(address, config, Use::Alone)?.0)
    }

    /// How often bytes arrived that are no frame, on RS485; see [`SerialMaster::garbled`]. 0 on CAN.
    #[must_use]
    pub const fn garbled(&self) -> u32 {
        match self {
            Self::SimulatedRs485(master) => master.garbled(),
            Self::Rs485(master) => master.garbled(),
            Self::SimulatedCan(_) | Self::SocketCan(_) | Self::Slcan(_) => 0,
        }
    }

    /// Opens this bus for a thread of its own, with a function that ends its [`idle`](Runner::idle) from other threads.
    /// A simulated bus runs in real time.
    pub(crate) fn open_shared(address: &BusAddress) -> Result<(Self, Wake), BusError> {
        Self::open_as(address, address.config(), Use::Shared)
    }

    fn open_as(address: &BusAddress, config: Config, used: Use) -> Result<(Self, Wake), BusError> {
        let host = |clock: HostClock| {
            used.of_host(clock).map_err(|error| PortError::os(&address.to_string(), error))
        };
        Ok(match address {
            BusAddress::Simulated { motors, kind } => {
                // Its handles keep the simulated world alive. The motors have brakes, so that code which forgets
                // to release them fails here, and not first on a robot.
                let fleet = Fleet::new(*motors).brakes(true);
                let rate = address.bit_rate().unwrap_or_default();
                match kind {
                    BusKind::Can => {
                        let (world, wake) = used.of_simulated(fleet.on_can(rate)?.world);
                        let master = CanMaster::new(world.port(), world.clock(), config);
                        (Self::SimulatedCan(master), wake)
                    }
                    BusKind::Rs485 => {
                        let (world, wake) = used.of_simulated(fleet.on_rs485(rate)?.world);
                        let master = SerialMaster::new(world.port(), world.clock(), config);
                        (Self::SimulatedRs485(master), wake)
                    }
                }
            }
            BusAddress::SocketCan { interface } => {
                let can = SocketCan::open(interface)?;
                let (clock, wake) = host(can.clock()?)?;
                (Self::SocketCan(CanMaster::new(can, clock, config)), wake)
            }
            BusAddress::Slcan { path, rate } => {
                let can = Slcan::open(path, *rate)?;
                let (clock, wake) = host(can.clock()?)?;
                (Self::Slcan(CanMaster::new(can, clock, config)), wake)
            }
            BusAddress::Rs485 { path, bit_rate, .. } => {
                let serial = Rs485::open(path, *bit_rate)?;
                let (clock, wake) = host(serial.clock()?)?;
                (Self::Rs485(SerialMaster::new(serial, clock, config)), wake)
            }
        })
    }
}

/// Ends the idling of a bus's clock from any thread.
pub(crate) type Wake = Arc<dyn Fn() + Send + Sync>;

/// What is going to run a bus.
#[derive(Clone, Copy)]
enum Use {
    /// Its caller.
    Alone,
    /// A thread of its own, which other threads wake.
    Shared,
}

impl Use {
    fn of_simulated<B: Medium>(self, world: World<B>) -> (World<B>, Wake) {
        match self {
            Self::Alone => (world, Arc::new(|| {})),
            Self::Shared => {
                let world = world.in_real_time();
                (world.clone(), Arc::new(move || world.wake()))
            }
        }
    }

    fn of_host(self, mut clock: HostClock) -> io::Result<(HostClock, Wake)> {
        match self {
            Self::Alone => Ok((clock, Arc::new(|| {}))),
            Self::Shared => {
                let waker = clock.waker()?;
                Ok((clock, Arc::new(move || waker.wake())))
            }
        }
    }
}

/// Makes the same call on each bus.
macro_rules! on_each {
    ($master:expr, $runner:ident => $call:expr) => {
        match $master {
            Self::SimulatedCan($runner) => $call,
            Self::SimulatedRs485($runner) => $call,
            Self::SocketCan($runner) => $call,
            Self::Slcan($runner) => $call,
            Self::Rs485($runner) => $call,
        }
    };
}

impl<const N: usize> Runner<N> for AnyMaster<N> {
    type Error = BusError;

    fn master(&mut self) -> &mut Master<N> {
        on_each!(self, runner => runner.master())
    }

    fn now(&self) -> Instant {
        on_each!(self, runner => runner.now())
    }

    fn poll(&mut self) -> Result<Option<Event>, BusError> {
        on_each!(self, runner => runner.poll().map_err(BusError::from))
    }

    fn idle(&mut self, until: Instant) {
        on_each!(self, runner => runner.idle(until))
    }
}
