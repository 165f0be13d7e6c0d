//! A master on whatever bus an address names.

use myactuator_protocol_core::io::{CanMaster, Runner, SerialMaster};
use myactuator_protocol_core::master::{Config, Event, Master};
use myactuator_protocol_core::time::Instant;

use crate::port::slcan::Slcan;
use crate::port::{BusAddress, BusError, HostClock, Rs485, SocketCan};

/// A master of up to `N` motors on a real bus: the same [`Runner`] whatever the bus.
#[derive(Debug)]
pub enum AnyMaster<const N: usize> {
    /// On a CAN interface of Linux.
    SocketCan(CanMaster<SocketCan, HostClock, N>),
    /// On an SLCAN adapter.
    Slcan(CanMaster<Slcan, HostClock, N>),
    /// On an RS485 adapter.
    Rs485(SerialMaster<Rs485, HostClock, N>),
}

impl<const N: usize> AnyMaster<N> {
    /// Opens this bus, with the [configuration](BusAddress::config) that suits it.
    ///
    /// # Errors
    /// [`BusError`] tells why it cannot be opened, and what to do.
    pub fn open(address: &BusAddress) -> Result<Self, BusError> {
        Self::open_with(address, address.config())
    }

    /// Opens this bus with a configuration of the caller's, made from
    /// [its own](BusAddress::config).
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_with(address: &BusAddress, config: Config) -> Result<Self, BusError> {
        match address {
            BusAddress::Simulated { .. } => Err(BusError::Simulated(address.to_string())),
            BusAddress::SocketCan { interface } => {
                let can = SocketCan::open(interface)?;
                let clock = can.clock()?;
                Ok(Self::SocketCan(CanMaster::new(can, clock, config)))
            }
            BusAddress::Slcan { path, rate } => {
                let can = Slcan::open(path, *rate)?;
                let clock = can.clock()?;
                Ok(Self::Slcan(CanMaster::new(can, clock, config)))
            }
            BusAddress::Rs485 { path, bit_rate, echo: _ } => {
                let serial = Rs485::open(path, *bit_rate)?;
                let clock = serial.clock()?;
                Ok(Self::Rs485(SerialMaster::new(serial, clock, config)))
            }
        }
    }
}

impl<const N: usize> Runner<N> for AnyMaster<N> {
    type Error = BusError;

    fn master(&mut self) -> &mut Master<N> {
        match self {
            Self::SocketCan(runner) => runner.master(),
            Self::Slcan(runner) => runner.master(),
            Self::Rs485(runner) => runner.master(),
        }
    }

    fn now(&self) -> Instant {
        match self {
            Self::SocketCan(runner) => runner.now(),
            Self::Slcan(runner) => runner.now(),
            Self::Rs485(runner) => runner.now(),
        }
    }

    fn poll(&mut self) -> Result<Option<Event>, BusError> {
        match self {
            Self::SocketCan(runner) => runner.poll(),
            Self::Slcan(runner) => runner.poll(),
            Self::Rs485(runner) => runner.poll(),
        }
    }

    fn idle(&mut self, until: Instant) {
        match self {
            Self::SocketCan(runner) => runner.idle(until),
            Self::Slcan(runner) => runner.idle(until),
            Self::Rs485(runner) => runner.idle(until),
        }
    }
}
