//! Simulated drives on either bus, so that a test of both is written once.

use myactuator_host_std::sim::bus::World;
use myactuator_host_std::sim::bus::can::CanBus;
use myactuator_host_std::sim::bus::rs485::Rs485Line;
use myactuator_host_std::sim::{CanFleet, DriveHandle, Fleet, FleetError, LineFleet};
use myactuator_protocol_core::drive::{Event, State};

use crate::wire::Wire;

/// A master on one of the buses.
pub type Master<B> = <<B as Bus>::Wire as Wire>::Runner<8>;

/// Drives on one of the buses.
pub trait Bus: Sized {
    /// Which bus.
    type Wire: Wire;

    /// Puts the drives on the bus.
    fn with(fleet: &Fleet) -> Result<Self, FleetError>;

    /// The bus.
    fn world(&self) -> &World<Self::Wire>;

    /// The drives, in the order of their ids.
    fn drives(&self) -> &[DriveHandle];

    /// A master.
    fn master(&self) -> Master<Self> {
        Self::Wire::runner(self.world(), Self::Wire::CONFIG).0
    }
}

impl Bus for CanFleet {
    type Wire = CanBus;

    fn with(fleet: &Fleet) -> Result<Self, FleetError> {
        fleet.on_can(1_000_000)
    }

    fn world(&self) -> &World<CanBus> {
        &self.world
    }

    fn drives(&self) -> &[DriveHandle] {
        &self.drives
    }
}

impl Bus for LineFleet {
    type Wire = Rs485Line;

    fn with(fleet: &Fleet) -> Result<Self, FleetError> {
        fleet.on_rs485(1_000_000)
    }

    fn world(&self) -> &World<Rs485Line> {
        &self.world
    }

    fn drives(&self) -> &[DriveHandle] {
        &self.drives
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

/// Turns its output shaft by hand.
pub fn turn_to(drive: &DriveHandle, degrees: f64) {
    drive.with(|drive| drive.plant_mut().set_output_angle_deg(degrees).expect("a finite angle"));
}

/// What happened in the drive since this was last asked.
pub fn happened(drive: &DriveHandle) -> Vec<Event> {
    drive.with(|drive| std::iter::from_fn(|| drive.poll_event()).collect())
}
