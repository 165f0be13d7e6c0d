//! The state of a drive, for those who look at it from outside the bus.

use crate::command::{BrakeCommand, ErrorFlags, Mode};
use crate::drive::life::Life;
use crate::drive::{Drive, Indicator, Measurement, Memory, Plant};

/// The state of a drive at its [`clock`](Drive::clock).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct State {
    /// Whether it has its supply.
    pub powered: bool,
    /// Whether it hears commands: it has its supply and is not starting.
    pub running: bool,
    /// Which loop runs, as 0x70 returns it; code 0 in no mode.
    pub mode: Mode,
    /// Whether the output is on.
    pub output_on: bool,
    /// Angle of the output shaft from its zero, degrees, in full resolution.
    pub angle_deg: f64,
    /// The brake's last command.
    pub brake: BrakeCommand,
    /// Everything that is wrong.
    pub errors: ErrorFlags,
    /// What the indicator light shows.
    pub indicator: Indicator,
    /// Whether communication was lost and is not steady yet (0xB3).
    pub communication_lost: bool,
    /// The last measurement.
    pub measurement: Measurement,
}

impl<P: Plant, M: Memory> Drive<P, M> {
    /// The state of the drive.
    pub fn state(&self) -> State {
        State {
            powered: self.is_powered(),
            running: matches!(self.life, Life::Running { .. }),
            mode: self.controller.mode(),
            output_on: !self.controller.is_off(),
            angle_deg: self.encoder.angle_deg(),
            brake: self.brake.command(),
            errors: self.faults.all(),
            indicator: match self.life {
                Life::Off | Life::BrownedOut => Indicator::Dark,
                Life::Booting { .. } | Life::Running { .. } => self.faults.indicator(),
            },
            communication_lost: self.protection.is_tripped(),
            measurement: self.measurement,
        }
    }
}
