//! A robot from one file: its buses, and the motors on each.

mod read;
mod table;

use std::fs;
use std::io;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};

use myactuator_protocol_core::time::Duration;
use serde::Deserialize;

use super::bus::Medium;
use super::bus::rs485::TransceiverConfig;
use super::mechanics::Remote;
use super::{BusFleet, CanFleet, Fleet, FleetError, LineFleet};
use crate::BusKind;

/// A process that does not answer for so long is assumed dead.
const MECHANICS_PATIENCE: std::time::Duration = std::time::Duration::from_secs(5);
/// How likely an adapter with noise hears a byte that was never sent, each time it switches.
const ECHO_NOISE: f32 = 0.1;

/// Several buses with their motors, from one TOML file.
///
/// ```
/// use myactuator_host_std::protocol::MotorId;
/// use myactuator_host_std::protocol::command::ReadMultiTurnAngle;
/// use myactuator_host_std::protocol::io::Runner;
/// use myactuator_host_std::sim::Robot;
///
/// let file = r#"
///     [[bus]]
///     name = "arm"
///     kind = "can"
///     bit_rate = 1_000_000
///     faults = ["cut@2+5s"]
///
///     [bus.defaults]
///     model = "RMD-X8-P20-120"
///     brake = true
///
///     [[bus.motor]]
///     ids = "1-2"
///     start_angle_deg = 30
///     load = { inertia_kg_m2 = 0.01, arm = { mass_kg = 0.8, length_m = 0.25, down_deg = 0 } }
///
///     [[bus]]
///     name = "gripper"
///     kind = "rs485"
///     bit_rate = 115_200
///
///     [[bus.motor]]
///     id = 7
///     model = "RMD-X6-P20-60"
/// "#;
/// let robot = Robot::from_toml(file, ".")?;
/// let (arm, gripper) = (robot.can("arm")?, robot.rs485("gripper")?);
/// let told = arm.master::<2>().ask(MotorId::new(2)?, ReadMultiTurnAngle)?;
/// assert!((told.angle.degrees() - 30.0).abs() < 0.1);
/// assert_eq!(gripper.drives.len(), 1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # The file
///
/// | key | what it is | without it |
/// |---|---|---|
/// | `seed` | the seed of everything that happens by chance: a whole number | 1 |
/// | `[[bus]]` | a bus; at least one | |
///
/// A `[[bus]]`:
///
/// | key | what it is | without it |
/// |---|---|---|
/// | `name` | letters, digits, `-` and `_`; no two buses have the same | an error |
/// | `kind` | `"can"` or `"rs485"` | an error |
/// | `bit_rate` | bit/s: 10 000 to 1 000 000 on CAN, 1 200 to 12 000 000 on RS485 | an error |
/// | `adapter` | the adapter of an RS485 line that is served to other programs: `"echo"` or `"echo-noise"`, see [`Adapter`] | `"plain"` |
/// | `bursts_ms` | how often the adapter of a bus that is served to other programs hands over what it hears, ms, as USB adapters do: 16 is usual | at once |
/// | `mechanics` | what moves the shafts of this bus in place of the motors and their loads: `{ socket = "…", period_us = 500 }`, a Unix socket where a process [listens](super::mechanics), and how often it is asked, 100 to 100 000 µs | nothing |
/// | `supply` | the supply that all its motors share, a table with the fields of [`Supply`](super::plant::Supply): `{ voltage_v = 48, resistance_ohm = 0.1, feedback_resistance_ohm = 20, capacitance_f = 0.01 }`; see [`Fleet::supply`] | a battery for each, of the model's voltage |
/// | `interface` | a CAN interface such as `"vcan0"` on which to serve a CAN bus as well | none |
/// | `faults` | what goes wrong with its motors, each as in [`PlannedFault`](super::PlannedFault); times count from when the motors are put on the bus, in simulated time | nothing |
/// | `shared_ids` | whether several motors may have the same id, as from the factory | `false` |
/// | `[bus.defaults]` | the defaults of its motors: all keys of a motor except its id | |
/// | `[[bus.motor]]` | a motor, or several equal ones; at least one | |
///
/// A `[[bus.motor]]`; all keys except the first two may also stand in `[bus.defaults]`:
///
/// | key | what it is | without it |
/// |---|---|---|
/// | `id` | 1 to 32 | `ids` |
/// | `ids` | the ids of several equal motors: `"1-6"` or `[1, 2, 5]` | `id` |
/// | `model` | a name such as `"RMD-X8-P20-120"` or `"X8-120"`, or a file that ends in `.toml`, searched for beside the robot's file | `"RMD-X6-P20-60"` |
/// | `firmware` | `"v4.3"` or `"v4.4"` | its model's |
/// | `motion` | the scales of motion mode, a table as in files of models | the model's or the firmware's |
/// | `version_date` | what 0xB2 returns: a whole number | the firmware's |
/// | `quirks` | a list of names of [`quirk_names`](super::quirk_names) | none |
/// | `response_ms` | the shortest and the longest time after which it answers, ms | `[0.7, 0.9]` |
/// | `brake` | whether it has one | `false` |
/// | `load` | a table with the fields of [`Load`](super::plant::Load) | a bare shaft |
/// | `start_angle_deg` | the angle of its shaft at the start, degrees, turns included; not far beyond an end stop of its load | 0 |
///
/// A key of a motor replaces the same key of the defaults, a table as a whole. Keys that are not
/// listed here are errors.
#[derive(Clone, Debug)]
pub struct Robot {
    /// Its buses, in the order of the file.
    pub buses: Vec<RobotBus>,
}

/// A bus of a [`Robot`].
#[derive(Clone, Debug)]
pub struct RobotBus {
    /// Its motors, and their planned faults. Other settings, such as a
    /// [memory folder](Fleet::memory_folder), can be added before the motors are put on a bus.
    pub fleet: Fleet,
    /// Which of the two buses it is.
    pub kind: BusKind,
    /// Bits per second.
    pub bit_rate: u32,
    /// The adapter by which other programs use an RS485 line.
    pub adapter: Adapter,
    /// How often adapters hand over to other programs what they hear; zero for at once.
    pub bursts: Duration,
    /// The process that moves the shafts in place of the motors, if there is one.
    pub mechanics: Option<MechanicsProcess>,
    /// The CAN interface on which to serve a CAN bus as well.
    pub interface: Option<String>,
}

/// A process that moves shafts; see [`mechanics`](super::mechanics).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MechanicsProcess {
    /// The Unix socket where it listens.
    pub socket: PathBuf,
    /// How often it is asked.
    pub period: Duration,
}

/// The side effects of an RS485 adapter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Adapter {
    /// None.
    #[default]
    Plain,
    /// It hands back what is sent.
    Echo,
    /// It hands back what is sent, and in one of ten switches of direction, by chance, it also hears a random byte.
    EchoNoise,
}

impl Adapter {
    /// Its transceiver.
    pub fn transceiver(self) -> TransceiverConfig {
        TransceiverConfig {
            echo: self != Self::Plain,
            switch_noise: if self == Self::EchoNoise { ECHO_NOISE } else { 0.0 },
            ..TransceiverConfig::default()
        }
    }
}

/// Why a robot cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum RobotError {
    /// The file cannot be read.
    #[error("the robot's file \"{}\" cannot be read: {error}", file.display())]
    Unreadable {
        /// Its path.
        file: PathBuf,
        /// What the operating system reports.
        error: io::Error,
    },
    /// Something in the file is not what it must be.
    #[error("{}line {line}: {what}", of(file.as_deref()))]
    Wrong {
        /// Its path, if it is a file's text.
        file: Option<PathBuf>,
        /// The line, from 1.
        line: usize,
        /// What was expected, and what was found.
        what: String,
    },
    /// No bus has this name.
    #[error("there is no bus \"{name}\", only {}", buses.join(", "))]
    NoSuchBus {
        /// The name.
        name: String,
        /// The names of the buses.
        buses: Vec<String>,
    },
    /// The bus is of the other kind.
    #[error("the bus \"{name}\" is of the kind {kind}: take its fleet by that one's function")]
    OtherKind {
        /// The bus.
        name: String,
        /// Its kind.
        kind: BusKind,
    },
    /// The process that moves its shafts cannot be reached.
    #[error(
        "bus \"{name}\": nobody moves the shafts at \"{}\": start the process that listens there first: \
         {error}",
        socket.display()
    )]
    NoMechanics {
        /// The bus.
        name: String,
        /// Where the process was to listen.
        socket: PathBuf,
        /// What the operating system reports.
        error: io::Error,
    },
    /// The drives cannot be put on the bus.
    #[error("bus \"{name}\": {error}")]
    Fleet {
        /// The bus.
        name: String,
        /// Why.
        error: FleetError,
    },
}

fn of(file: Option<&Path>) -> String {
    file.map_or(String::new(), |file| format!("{}, ", file.display()))
}

impl Robot {
    /// Makes the robot of this text. Files that it names are searched for in `folder`.
    ///
    /// # Errors
    /// [`RobotError::Wrong`]: the line, what was expected, and what was found.
    pub fn from_toml(text: &str, folder: impl AsRef<Path>) -> Result<Self, RobotError> {
        let wrong = |(line, what)| RobotError::Wrong { file: None, line, what };
        read::robot(text, folder.as_ref()).map_err(wrong)
    }

    /// Makes the robot of this file. Files that it names are searched for beside it.
    ///
    /// # Errors
    /// [`RobotError::Unreadable`], or [`RobotError::Wrong`] as [`from_toml`](Self::from_toml).
    pub fn from_file(path: impl AsRef<Path>) -> Result<Self, RobotError> {
        let path = path.as_ref();
        let text = fs::read_to_string(path)
            .map_err(|error| RobotError::Unreadable { file: path.to_owned(), error })?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let wrong = |(line, what)| RobotError::Wrong { file: Some(path.to_owned()), line, what };
        read::robot(&text, folder).map_err(wrong)
    }

    /// Replaces the file's seed of everything that happens by chance. The same seed gives the same
    /// run; each bus of a robot has its own random numbers.
    #[must_use]
    pub fn seed(mut self, seed: u64) -> Self {
        for (bus, place) in self.buses.iter_mut().zip(0_u64..) {
            bus.fleet = bus.fleet.clone().seed(seed.wrapping_add(place << 32));
        }
        self
    }

    /// The bus of this name.
    ///
    /// # Errors
    /// [`RobotError::NoSuchBus`], which lists the buses.
    pub fn bus(&self, name: &str) -> Result<&RobotBus, RobotError> {
        self.buses.iter().find(|bus| bus.name() == name).ok_or_else(|| RobotError::NoSuchBus {
            name: name.to_owned(),
            buses: self.buses.iter().map(|bus| bus.name().to_owned()).collect(),
        })
    }

    /// Puts the motors of the CAN bus of this name on that bus, at the file's bit rate, in virtual time. Each call
    /// makes new motors.
    ///
    /// # Errors
    /// [`RobotError::NoSuchBus`], or as [`RobotBus::on_can`].
    pub fn can(&self, name: &str) -> Result<CanFleet, RobotError> {
        self.bus(name)?.on_can()
    }

    /// Puts the motors of the RS485 line of this name on that line, at the file's bit rate, in virtual time. Each call
    /// makes new motors.
    ///
    /// # Errors
    /// [`RobotError::NoSuchBus`], or as [`RobotBus::on_rs485`].
    pub fn rs485(&self, name: &str) -> Result<LineFleet, RobotError> {
        self.bus(name)?.on_rs485()
    }
}

impl RobotBus {
    /// Its name, which is that of its [fleet](Self::fleet).
    pub fn name(&self) -> &str {
        self.fleet.bus_name().unwrap_or(self.kind.name())
    }

    /// Puts its motors on a CAN bus, at its bit rate, in virtual time.
    ///
    /// # Errors
    /// [`RobotError::OtherKind`], [`RobotError::Fleet`] or [`RobotError::NoMechanics`].
    pub fn on_can(&self) -> Result<CanFleet, RobotError> {
        self.check_kind(BusKind::Can)?;
        let fleet = self.fleet.on_can(self.bit_rate).map_err(|error| self.failed(error))?;
        self.put_into_mechanics(fleet)
    }

    /// Puts its motors on an RS485 line, at its bit rate, in virtual time.
    ///
    /// # Errors
    /// As [`on_can`](Self::on_can).
    pub fn on_rs485(&self) -> Result<LineFleet, RobotError> {
        self.check_kind(BusKind::Rs485)?;
        let fleet = self.fleet.on_rs485(self.bit_rate).map_err(|error| self.failed(error))?;
        self.put_into_mechanics(fleet)
    }

    /// Lets the process move the shafts, if there is one.
    fn put_into_mechanics<B: Medium>(&self, fleet: BusFleet<B>) -> Result<BusFleet<B>, RobotError> {
        let Some(MechanicsProcess { socket, period }) = &self.mechanics else { return Ok(fleet) };
        let connected = UnixStream::connect(socket).and_then(|stream| {
            stream.set_read_timeout(Some(MECHANICS_PATIENCE))?;
            stream.set_write_timeout(Some(MECHANICS_PATIENCE))?;
            Ok(stream)
        });
        let stream = connected.map_err(|error| RobotError::NoMechanics {
            name: self.name().to_owned(),
            socket: socket.clone(),
            error,
        })?;
        // New drives are not led yet.
        let _ = fleet.lead(&fleet.drives, *period, Remote::new(stream));
        Ok(fleet)
    }

    fn check_kind(&self, wanted: BusKind) -> Result<(), RobotError> {
        if self.kind == wanted {
            return Ok(());
        }
        Err(RobotError::OtherKind { name: self.name().to_owned(), kind: self.kind })
    }

    fn failed(&self, error: FleetError) -> RobotError {
        RobotError::Fleet { name: self.name().to_owned(), error }
    }
}

#[cfg(test)]
mod tests;
