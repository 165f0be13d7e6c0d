//! The settings of one simulated drive, and the drive that is made from them.

use std::path::{Path, PathBuf};

use myactuator_protocol_core::command::{BaudCode, MotionRanges, VersionDate};
use myactuator_protocol_core::drive::{Bus, Drive, Parameters, Quirks};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::wire::rs485::Receiver;
use myactuator_protocol_core::{Firmware, MotorId};

use super::FleetError;
use super::of_model::parameters_of;
use crate::sim::memory::DriveMemory;
use crate::sim::plant::{Load, MotorParameters, ParameterError, SimulatedMotor};
use crate::sim::seat::Seat;
use crate::sim::shaft::ShaftFile;

/// The settings of one motor of a [`Fleet`](super::Fleet).
#[derive(Clone, Debug, PartialEq)]
pub struct MotorSetup {
    /// The id that it starts with.
    pub id: MotorId,
    /// Its model; `None` for the RMD-X6-P20-60.
    pub model: Option<MotorParameters>,
    /// The revision of the protocol that its drive speaks; `None` for its model's. A revision whose motion mode has
    /// no scales of its own (V4.4) needs [`motion_ranges`](Self::motion_ranges), too.
    pub firmware: Option<Firmware>,
    /// The scales of its motion mode; `None` for those of its model or its firmware.
    pub motion_ranges: Option<MotionRanges>,
    /// The version date that it reports (0xB2); `None` for the one that is known for its firmware.
    pub version_date: Option<VersionDate>,
    /// Its deviations from the manual.
    pub quirks: Quirks,
    /// The shortest and the longest time after which it answers.
    pub response: (Duration, Duration),
    /// Whether it has a brake, which is locked at first.
    pub has_brake: bool,
    /// What its shaft carries at the start.
    pub load: Load,
    /// The angle of its shaft at the start, degrees, turns included, up to ±10⁹. It must not be far beyond an [end
    /// stop](crate::sim::plant::EndStop) of its load. If a [memory folder](super::Fleet::memory_folder) says where an
    /// earlier run has left the shaft, it is there instead.
    pub start_angle_deg: f64,
}

impl MotorSetup {
    /// A motor of the usual kind: an RMD-X6-P20-60 without a brake, at 0°, with a bare shaft, whose drive answers after
    /// 0.7 to 0.9 ms.
    pub fn new(id: MotorId) -> Self {
        Self {
            id,
            model: None,
            firmware: None,
            motion_ranges: None,
            version_date: None,
            quirks: Quirks::default(),
            response: (Duration::from_micros(700), Duration::from_micros(900)),
            has_brake: false,
            load: Load::NONE,
            start_angle_deg: 0.0,
        }
    }

    /// Its model, with the firmware and the scales of these settings.
    pub(super) fn made_model(&self, usual: &MotorParameters) -> MotorParameters {
        let mut model = self.model.as_ref().unwrap_or(usual).clone();
        if let Some(firmware) = self.firmware {
            // The model's scales are those of the model's own firmware.
            (model.firmware, model.motion) = (firmware, None);
        }
        model.motion = self.motion_ranges.or(model.motion);
        model
    }

    /// The drive in its place.
    pub(super) fn seat(&self, around: Surroundings<'_>) -> Result<Seat, FleetError> {
        let Surroundings { bus, bit_rate, usual_model, seed, files } = around;
        let model = self.made_model(usual_model);
        let (memory, shaft) = match files {
            Some(files) => (DriveMemory::File(files.motor), Some(ShaftFile::open(files.shaft)?)),
            None => (DriveMemory::Process(None), None),
        };
        let of_model = parameters_of(&model)?;
        let parameters = Parameters {
            id: self.id,
            bus,
            baud_rate: baud_code(bus, bit_rate).unwrap_or(BaudCode::from_raw(0xFF)),
            version_date: self.version_date.unwrap_or(of_model.version_date),
            response_delay_min: self.response.0,
            response_delay_max: self.response.1,
            quirks: self.quirks,
            has_brake: self.has_brake,
            seed: (seed ^ (seed >> 32)) as u32,
            ..of_model
        };
        let mut plant = SimulatedMotor::new(model)?;
        plant.set_noise_seed(seed);
        let kept = shaft.as_ref().and_then(ShaftFile::kept);
        let placed = match kept {
            Some(place) => plant.put_back(place),
            None => plant.set_output_angle_deg(self.start_angle_deg),
        };
        // The load comes last, since its stops may be on any side of 0°.
        let placed = placed.map_err(ParameterError::from);
        placed.and_then(|()| plant.set_load(self.load)).map_err(|error| match kept {
            Some(place) => FleetError::Left { motor: self.id, angle_deg: place.output_deg, error },
            None => error.into(),
        })?;
        let drive = Drive::new(parameters, plant, memory, Instant::ZERO)?;
        Ok(Seat { drive, receiver: Receiver::new(), shaft, is_led: false, off_until: None })
    }
}

/// The place of a drive.
#[derive(Debug)]
pub(super) struct Surroundings<'a> {
    pub(super) bus: Bus,
    /// Bits per second.
    pub(super) bit_rate: u32,
    /// The model of motors that were given no other.
    pub(super) usual_model: &'a MotorParameters,
    pub(super) seed: u64,
    pub(super) files: Option<MemoryFiles>,
}

/// The files that a drive keeps from one run to the next.
#[derive(Debug)]
pub(super) struct MemoryFiles {
    motor: PathBuf,
    shaft: PathBuf,
}

impl MemoryFiles {
    /// The files of the drive that starts with this id; `namesakes` drives with the same id come before it.
    pub(super) fn of(folder: &Path, motor: MotorId, namesakes: usize) -> Self {
        let which = match namesakes {
            0 => motor.to_string(),
            others => format!("{motor}-{}", others + 1),
        };
        let file = |what| folder.join(format!("{what}-{which}.json"));
        Self { motor: file("motor"), shaft: file("shaft") }
    }
}

/// The code of the bus's bit rate, if the manual has one. With a code that has no meaning a drive keeps the rate of its
/// bus.
fn baud_code(bus: Bus, bit_rate: u32) -> Option<BaudCode> {
    let codes = [BaudCode::CAN_500K_RS485_115200, BaudCode::CAN_1M_RS485_500K, BaudCode::RS485_1M];
    codes.into_iter().find(|&code| bus.bits_per_second(code) == Some(bit_rate))
}
