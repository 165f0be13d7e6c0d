//! Drives that are on a bus, and a handle of each.

use std::fmt;
use std::sync::{Arc, Mutex};

use myactuator_protocol_core::drive::Event;
use myactuator_protocol_core::io::{AsyncCanMaster, AsyncSerialMaster, CanMaster, SerialMaster};
use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::time::Instant;
use myactuator_protocol_core::{Firmware, MotorId};

use super::SimulatedDrive;
use crate::sim::bus::can::{CanBus, CanPort};
use crate::sim::bus::rs485::{Rs485Line, SerialPort};
use crate::sim::bus::{Medium, SimClock, StationId, World, lock};
use crate::sim::mechanics::MechanicsFailure;
use crate::sim::seat::Seat;
use crate::sim::shared_supply::SharedSupply;

/// A handle of one simulated drive.
#[derive(Clone)]
pub struct DriveHandle {
    motor: MotorId,
    station: StationId,
    pub(in crate::sim) seat: Arc<Mutex<Seat>>,
    /// Where the drive is.
    world: Arc<dyn Serving>,
}

/// A world on any bus.
pub(super) trait Serving: Send + Sync {
    /// Advances a node's own time to now, and sends what it has to send.
    fn serve(&self, node: StationId);
}

impl<B: Medium> Serving for World<B>
where
    B: Send + 'static,
{
    fn serve(&self, node: StationId) {
        World::serve(self, node);
    }
}

impl fmt::Debug for DriveHandle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("DriveHandle").field("motor", &self.motor).finish_non_exhaustive()
    }
}

impl DriveHandle {
    pub(super) fn new(
        motor: MotorId,
        station: StationId,
        seat: Arc<Mutex<Seat>>,
        world: Arc<dyn Serving>,
    ) -> Self {
        Self { motor, station, seat, world }
    }

    /// The id that the drive started with.
    pub const fn motor(&self) -> MotorId {
        self.motor
    }

    /// Its place on the bus, for faults of the wire.
    pub const fn station(&self) -> StationId {
        self.station
    }

    /// Takes what has happened in the drive, with its time, and how many events were lost before. This does not affect
    /// the drive itself.
    pub(in crate::sim) fn take_events(&self) -> (Vec<(Instant, Event)>, u32) {
        let mut seat = lock(&self.seat);
        let drive = &mut seat.drive;
        let events = std::iter::from_fn(|| drive.poll_timed_event()).collect();
        (events, drive.dropped().1)
    }

    /// Works on the drive as it is now: raises an error, pushes the shaft, reads the physics. The effects begin now. Do
    /// not call this while the world runs in this thread.
    pub fn with<T>(&self, work: impl FnOnce(&mut SimulatedDrive) -> T) -> T {
        self.world.serve(self.station);
        let mut seat = lock(&self.seat);
        let result = work(&mut seat.drive);
        seat.drive.measure();
        drop(seat);
        self.world.serve(self.station);
        result
    }
}

/// Drives on a bus. This is a handle: clones are the same drives on the same bus.
#[derive(Debug)]
pub struct BusFleet<B: Medium> {
    /// The name of the bus.
    pub name: String,
    /// The bus and its clock.
    pub world: World<B>,
    /// The drives, in the order in which they were given.
    pub drives: Vec<DriveHandle>,
    /// Bits per second.
    pub bit_rate: u32,
    /// The firmware of the first drive.
    pub(super) firmware: Firmware,
    pub(in crate::sim) mechanics_failure: MechanicsFailure,
    pub(in crate::sim) shared_supply: Option<SharedSupply>,
}

impl<B: Medium> Clone for BusFleet<B> {
    fn clone(&self) -> Self {
        Self {
            name: self.name.clone(),
            world: self.world.clone(),
            drives: self.drives.clone(),
            mechanics_failure: self.mechanics_failure.clone(),
            shared_supply: self.shared_supply.clone(),
            ..*self
        }
    }
}

/// Drives on a CAN bus.
pub type CanFleet = BusFleet<CanBus>;

/// Drives on an RS485 line.
pub type LineFleet = BusFleet<Rs485Line>;

impl<B: Medium> BusFleet<B> {
    /// The supply that the drives [share](super::Fleet::supply), if they do.
    pub const fn shared_supply(&self) -> Option<&SharedSupply> {
        self.shared_supply.as_ref()
    }

    /// Runs async code on this bus; see [`World::block_on`].
    pub fn block_on<F: Future>(&self, future: F) -> F::Output {
        self.world.block_on(future)
    }
}

impl CanFleet {
    /// A master on this bus, for the firmware of its first drive.
    pub fn master<const N: usize>(&self) -> CanMaster<CanPort, SimClock<CanBus>, N> {
        self.master_at(self.bit_rate)
    }

    /// A master that speaks at this bit rate, whatever the rate of the bus. It finds the drives that were set to that
    /// rate (0xB4).
    ///
    /// ```
    /// use myactuator_host_std::protocol::MotorId;
    /// use myactuator_host_std::protocol::command::{BaudCode, ReadStatus1, Reset, SetBaudRate};
    /// use myactuator_host_std::protocol::io::Runner;
    /// use myactuator_host_std::protocol::time::Duration;
    /// use myactuator_host_std::sim::Fleet;
    ///
    /// let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
    /// let mut master = fleet.master::<1>();
    /// let slower = SetBaudRate { baud_rate: BaudCode::CAN_500K_RS485_115200 };
    /// master.ask(MotorId::MIN, slower).unwrap();
    /// master.ask(MotorId::MIN, Reset).unwrap();
    /// fleet.world.run_for(Duration::from_secs(2));
    ///
    /// let answers_at = |bit_rate| fleet.master_at::<1>(bit_rate).ask(MotorId::MIN, ReadStatus1).is_ok();
    /// assert_eq!([1_000_000, 500_000].map(answers_at), [false, true]);
    /// ```
    pub fn master_at<const N: usize>(
        &self,
        bit_rate: u32,
    ) -> CanMaster<CanPort, SimClock<CanBus>, N> {
        let port = self.world.port();
        self.world.set_bit_rate(port.station(), bit_rate);
        CanMaster::new(port, self.world.clock(), self.config(bit_rate))
    }

    /// An async master on this bus, to be run within [`block_on`](Self::block_on).
    pub fn async_master<const N: usize>(&self) -> AsyncCanMaster<CanPort, SimClock<CanBus>, N> {
        AsyncCanMaster::new(self.world.port(), self.world.clock(), self.config(self.bit_rate))
    }

    fn config(&self, bit_rate: u32) -> Config {
        Config { firmware: self.firmware, ..Config::can(bit_rate) }
    }
}

impl LineFleet {
    /// A master on this line, for the firmware of its first drive.
    pub fn master<const N: usize>(&self) -> SerialMaster<SerialPort, SimClock<Rs485Line>, N> {
        self.master_at(self.bit_rate)
    }

    /// A master that speaks at this bit rate, as [`CanFleet::master_at`].
    pub fn master_at<const N: usize>(
        &self,
        bit_rate: u32,
    ) -> SerialMaster<SerialPort, SimClock<Rs485Line>, N> {
        let port = self.world.port();
        self.world.set_bit_rate(port.station(), bit_rate);
        SerialMaster::new(port, self.world.clock(), self.config(bit_rate))
    }

    /// An async master on this line, to be run within [`block_on`](Self::block_on).
    pub fn async_master<const N: usize>(
        &self,
    ) -> AsyncSerialMaster<SerialPort, SimClock<Rs485Line>, N> {
        AsyncSerialMaster::new(self.world.port(), self.world.clock(), self.config(self.bit_rate))
    }

    fn config(&self, bit_rate: u32) -> Config {
        Config { firmware: self.firmware, ..Config::rs485(bit_rate, false) }
    }
}
