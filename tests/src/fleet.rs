//! Simulated drives on either bus, so that a test of both is written once.

use std::fmt::Debug;

use myactuator_host_std::sim::bus::can::{CanBus, CanPort};
use myactuator_host_std::sim::bus::rs485::{Rs485Line, SerialPort};
use myactuator_host_std::sim::bus::{SimClock, StationId};
use myactuator_host_std::sim::{CanFleet, DriveHandle, Fleet, FleetError, LineFleet};
use myactuator_protocol_core::drive::{Event, State};
use myactuator_protocol_core::io::{CanMaster, Runner, SerialMaster};
use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::time::Duration;

/// Drives on one of the buses.
pub trait Bus: Sized {
    /// The loop that runs a master on it.
    type Master: Runner<8, Error: Debug + PartialEq>;

    /// Puts the drives on the bus, at 1 Mbit/s.
    fn with(fleet: &Fleet) -> Result<Self, FleetError>;

    /// The drives, in the order of their ids.
    fn drives(&self) -> &[DriveHandle];

    /// Takes the power from a drive for a moment.
    fn power_cycle(&self, drive: StationId);

    /// A master, with the configuration for the bus changed.
    fn master_with(&self, change: impl FnOnce(Config) -> Config) -> Self::Master;

    /// A master.
    fn master(&self) -> Self::Master {
        self.master_with(|config| config)
    }

    /// A master that does not know that drives take time to restart.
    fn hasty_master(&self) -> Self::Master {
        self.master_with(|config| Config { restart_time: Duration::ZERO, ..config })
    }
}

impl Bus for CanFleet {
    type Master = CanMaster<CanPort, SimClock<CanBus>, 8>;

    fn with(fleet: &Fleet) -> Result<Self, FleetError> {
        fleet.on_can(1_000_000)
    }

    fn drives(&self) -> &[DriveHandle] {
        &self.drives
    }

    fn power_cycle(&self, drive: StationId) {
        self.world.reset(drive);
    }

    fn master_with(&self, change: impl FnOnce(Config) -> Config) -> Self::Master {
        CanMaster::new(self.world.port(), self.world.clock(), change(Config::CAN))
    }
}

impl Bus for LineFleet {
    type Master = SerialMaster<SerialPort, SimClock<Rs485Line>, 8>;

    fn with(fleet: &Fleet) -> Result<Self, FleetError> {
        fleet.on_rs485(1_000_000)
    }

    fn drives(&self) -> &[DriveHandle] {
        &self.drives
    }

    fn power_cycle(&self, drive: StationId) {
        self.world.reset(drive);
    }

    fn master_with(&self, change: impl FnOnce(Config) -> Config) -> Self::Master {
        let config = change(Config::rs485(self.bit_rate(), false));
        SerialMaster::new(self.world.port(), self.world.clock(), config)
    }
}

/// Makes a test for each bus of each function.
#[macro_export]
macro_rules! on_both_buses {
    ($($name:ident)+) => {
        mod on_can {
            $(#[test] fn $name() { super::$name::<myactuator_host_std::sim::CanFleet>(); })+
        }
        mod on_rs485 {
            $(#[test] fn $name() { super::$name::<myactuator_host_std::sim::LineFleet>(); })+
        }
    };
}

/// How the drive does.
pub fn state(drive: &DriveHandle) -> State {
    drive.with(|drive| drive.state())
}

/// Where its output shaft is.
pub fn angle_deg(drive: &DriveHandle) -> f64 {
    drive.with(|drive| drive.plant().output_angle_deg())
}

/// How fast its output shaft turns.
pub fn speed_dps(drive: &DriveHandle) -> f64 {
    drive.with(|drive| drive.plant().output_speed_dps())
}

/// Turns its output shaft by hand.
pub fn turn_to(drive: &DriveHandle, degrees: f64) {
    drive.with(|drive| drive.plant_mut().set_output_angle_deg(degrees).expect("a finite angle"));
}

/// What happened in the drive since this was last asked.
pub fn happened(drive: &DriveHandle) -> Vec<Event> {
    drive.with(|drive| std::iter::from_fn(|| drive.poll_event()).collect())
}
