//! Several simulated drives on one bus.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{BaudCode, ModelName};
use myactuator_protocol_core::drive::{Bus, Drive, FaultLimits, Gains, Parameters, Quirks};
use myactuator_protocol_core::io::{CanMaster, SerialMaster};
use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::time::{Duration, Instant};

use crate::sim::Seat;
use crate::sim::bus::can::{CanBus, CanConfig, CanPort, ControllerConfig};
use crate::sim::bus::rs485::{LineConfig, Rs485Line, SerialPort, TransceiverConfig};
use crate::sim::bus::{Medium, Node, SimClock, StationId, World};
use crate::sim::memory::{DriveMemory, StoreError};
use crate::sim::plant::{MotorParameters, ParameterError, SimulatedMotor};

/// A drive with its physics and its memory.
pub type SimulatedDrive = Drive<SimulatedMotor, DriveMemory>;

/// The default model.
const DEFAULT_MODEL: &str = "RMD-X8-PRO";

/// The speed loop's bandwidth that factory gains aim at, rad/s.
const BANDWIDTH_RAD_S: f32 = 200.0;

/// Why drives cannot be simulated as asked.
#[derive(Debug, thiserror::Error)]
pub enum FleetError {
    /// The model's figures make no motor.
    #[error("{0}")]
    Model(#[from] ParameterError),
    /// The file of a drive's memory cannot be read.
    #[error("{0}")]
    Memory(#[from] StoreError),
}

/// What is to be simulated. Build it up, then put it on a bus.
#[derive(Clone, Debug)]
pub struct Fleet {
    count: u8,
    model: Option<MotorParameters>,
    quirks: Quirks,
    response: (Duration, Duration),
    seed: u64,
    memory_folder: Option<PathBuf>,
    has_brake: bool,
}

impl Fleet {
    /// So many motors, with ids from 1; at most 32.
    pub fn new(count: u8) -> Self {
        Self {
            count: count.min(MotorId::COUNT as u8),
            model: None,
            quirks: Quirks::default(),
            response: (Duration::from_micros(700), Duration::from_micros(900)),
            seed: 1,
            memory_folder: None,
            has_brake: false,
        }
    }

    /// With motors of this model; else of the RMD-X8-PRO.
    #[must_use]
    pub fn model(mut self, model: MotorParameters) -> Self {
        self.model = Some(model);
        self
    }

    /// With drives that behave so beside the manual.
    #[must_use]
    pub fn quirks(mut self, quirks: Quirks) -> Self {
        self.quirks = quirks;
        self
    }

    /// With drives that answer after between `min` and `max`; else after 0.7 to 0.9 ms.
    #[must_use]
    pub fn response(mut self, min: Duration, max: Duration) -> Self {
        self.response = (min, max);
        self
    }

    /// With this seed for everything that happens by chance. The same seed gives the same run.
    #[must_use]
    pub fn seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// With memories that outlive the process, one file a drive in this folder.
    #[must_use]
    pub fn memory_folder(mut self, folder: impl Into<PathBuf>) -> Self {
        self.memory_folder = Some(folder.into());
        self
    }

    /// With brakes, locked at first.
    #[must_use]
    pub fn brakes(mut self, has_brake: bool) -> Self {
        self.has_brake = has_brake;
        self
    }

    /// Puts the drives on a CAN bus in virtual time.
    ///
    /// # Errors
    /// [`FleetError`]: the model's figures make no motor, or a memory file cannot be read.
    pub fn on_can(&self, bit_rate: u32) -> Result<CanFleet, FleetError> {
        let world = World::<CanBus>::new(CanConfig { bit_rate }, self.seed);
        self.put_on(world, ControllerConfig::MAILBOXES, Bus::Can, bit_rate)
    }

    /// Puts the drives on an RS485 line in virtual time.
    ///
    /// # Errors
    /// As [`on_can`](Self::on_can).
    pub fn on_rs485(&self, bit_rate: u32) -> Result<LineFleet, FleetError> {
        let world = World::<Rs485Line>::new(LineConfig { bit_rate }, self.seed);
        self.put_on(world, TransceiverConfig::default(), Bus::Rs485, bit_rate)
    }

    fn put_on<B: Medium<Attachment: Copy>>(
        &self,
        world: World<B>,
        attachment: B::Attachment,
        bus: Bus,
        bit_rate: u32,
    ) -> Result<BusFleet<B>, FleetError>
    where
        Seat<SimulatedMotor, DriveMemory>: Node<B::Frame>,
    {
        let mut drives = Vec::new();
        for motor in MotorId::all().take(self.count.into()) {
            let seat = Arc::new(Mutex::new(self.seat(motor, bus)?));
            let station = world.attach_with(Arc::clone(&seat), attachment);
            drives.push(DriveHandle { motor, station, seat });
        }
        Ok(BusFleet { world, drives, bit_rate })
    }

    fn seat(
        &self,
        motor: MotorId,
        bus: Bus,
    ) -> Result<Seat<SimulatedMotor, DriveMemory>, FleetError> {
        let model = match &self.model {
            Some(model) => model.clone(),
            None => MotorParameters::named(DEFAULT_MODEL)?,
        };
        let memory = match &self.memory_folder {
            Some(folder) => DriveMemory::in_file(folder.join(format!("motor-{motor}.json"))),
            None => DriveMemory::Process(None),
        };
        // A stream of chance of its own for each drive.
        let seed =
            self.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(u64::from(motor.get()));
        let parameters = Parameters {
            id: motor,
            bus,
            response_delay_min: self.response.0,
            response_delay_max: self.response.1,
            quirks: self.quirks,
            has_brake: self.has_brake,
            seed: (seed ^ (seed >> 32)) as u32,
            ..parameters_of(&model)
        };
        let plant = SimulatedMotor::new(model)?;
        Ok(Seat::new(Drive::new(parameters, plant, memory, Instant::ZERO)?))
    }
}

/// A drive's parameters for a motor of this model: its limits, scales and factory gains.
pub fn parameters_of(model: &MotorParameters) -> Parameters {
    let rating = &model.rating;
    let peak_a = rating.peak_current_a as f32;
    let no_load_dps = (rating.no_load_speed_rpm * 6.0) as f32;
    let supply_a = (rating.peak_torque_nm * rating.speed_rpm * std::f64::consts::TAU
        / 60.0
        / rating.voltage_v) as f32;
    Parameters {
        model: model_name(&model.name),
        baud_rate: BaudCode::CAN_1M_RS485_500K,
        encoder_bits: model.encoder.bits,
        gear_ratio: model.gear.ratio as f32,
        torque_constant_nm_per_a: rating.torque_constant_nm_per_a as f32,
        rated_current_a: rating.current_a as f32,
        stall_current_a: peak_a,
        max_speed_dps: no_load_dps,
        limits: FaultLimits {
            under_voltage_v: rating.min_voltage_v as f32 * 0.9,
            over_voltage_v: rating.max_voltage_v as f32,
            // Headroom over the peak current's phase amplitude.
            over_current_a: peak_a * model.motor.current_scale.amplitude_per_ampere() as f32 * 1.5,
            supply_current_a: supply_a.max(5.0) * 2.0,
            over_speed_dps: no_load_dps * 1.5,
            ..FaultLimits::default()
        },
        factory_gains: Gains::tuned(
            model.inertia_kg_m2() as f32,
            rating.torque_constant_nm_per_a as f32,
            BANDWIDTH_RAD_S,
        ),
        ..Parameters::default()
    }
}

/// Up to seven characters of the model's name, without the maker's "RMD-".
fn model_name(name: &str) -> ModelName {
    let short = name.strip_prefix("RMD-").unwrap_or(name);
    let mut bytes = [0; 7];
    for (byte, character) in bytes.iter_mut().zip(short.bytes().filter(u8::is_ascii_graphic)) {
        *byte = character;
    }
    ModelName::from_bytes(bytes)
}

/// A hand on one simulated drive.
#[derive(Clone, Debug)]
pub struct DriveHandle {
    motor: MotorId,
    station: StationId,
    seat: Arc<Mutex<Seat<SimulatedMotor, DriveMemory>>>,
}

impl DriveHandle {
    /// The id that the drive started with.
    pub const fn motor(&self) -> MotorId {
        self.motor
    }

    /// Its place on the bus, for faults of the wire.
    pub const fn station(&self) -> StationId {
        self.station
    }

    /// Works on the drive: raise an error, push the shaft, look at the physics. Not while the world
    /// runs in this thread.
    pub fn with<T>(&self, work: impl FnOnce(&mut SimulatedDrive) -> T) -> T {
        work(&mut self.lock().drive)
    }

    fn lock(&self) -> MutexGuard<'_, Seat<SimulatedMotor, DriveMemory>> {
        self.seat.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Drives on a bus.
#[derive(Debug)]
pub struct BusFleet<B: Medium> {
    /// The bus and its clock.
    pub world: World<B>,
    /// The drives, in the order of their ids.
    pub drives: Vec<DriveHandle>,
    bit_rate: u32,
}

/// Drives on a CAN bus.
pub type CanFleet = BusFleet<CanBus>;

/// Drives on an RS485 line.
pub type LineFleet = BusFleet<Rs485Line>;

impl<B: Medium> BusFleet<B> {
    /// Bits per second.
    pub const fn bit_rate(&self) -> u32 {
        self.bit_rate
    }
}

impl CanFleet {
    /// A master on this bus.
    pub fn master<const N: usize>(&self) -> CanMaster<CanPort, SimClock<CanBus>, N> {
        CanMaster::new(self.world.port(), self.world.clock(), Config::can(self.bit_rate))
    }
}

impl LineFleet {
    /// A master on this line.
    pub fn master<const N: usize>(&self) -> SerialMaster<SerialPort, SimClock<Rs485Line>, N> {
        self.master_with(TransceiverConfig::default())
    }

    /// A master on this line, by an adapter with these properties.
    pub fn master_with<const N: usize>(
        &self,
        transceiver: TransceiverConfig,
    ) -> SerialMaster<SerialPort, SimClock<Rs485Line>, N> {
        let config = Config::rs485(self.bit_rate, transceiver.echo);
        SerialMaster::new(self.world.port_with(transceiver), self.world.clock(), config)
    }
}
