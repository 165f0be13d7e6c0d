//! Simulated drives on either bus, so that one test covers both.

use myactuator_host_std::sim::{BusFleet, DriveHandle};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::drive::{Event, State};

use crate::wire::Wire;

/// A master of these drives.
pub fn master<W: Wire>(bus: &BusFleet<W>) -> W::Runner<8> {
    W::runner(&bus.world, W::CONFIG).0
}

/// Makes a test for each bus of each function.
#[macro_export]
macro_rules! on_both_buses {
    ($($name:ident)+) => {
        mod on_can {
            $(#[test] fn $name() { super::$name::<myactuator_host_std::sim::bus::can::CanBus>(); })+
        }
        mod on_rs485 {
            $(#[test] fn $name() { super::$name::<myactuator_host_std::sim::bus::rs485::Rs485Line>(); })+
        }
    };
}

/// The state of the drive.
pub fn state(drive: &DriveHandle) -> State {
    drive.with(|drive| drive.state())
}

/// Turns its output shaft by hand.
pub fn turn_to(drive: &DriveHandle, degrees: f64) {
    drive.with(|drive| drive.plant_mut().set_output_angle_deg(degrees).expect("a finite angle"));
}

/// The drive's events since the last call.
pub fn happened(drive: &DriveHandle) -> Vec<Event> {
    drive.with(|drive| std::iter::from_fn(|| drive.poll_event()).collect())
}

/// The motors that have cut their outputs since the last call because they heard nothing for too long.
pub fn lost_their_master(drives: &[DriveHandle]) -> Vec<MotorId> {
    let lost = |drive: &&DriveHandle| happened(drive).contains(&Event::ProtectionTripped);
    drives.iter().filter(lost).map(DriveHandle::motor).collect()
}
