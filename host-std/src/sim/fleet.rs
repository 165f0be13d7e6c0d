//! Several simulated drives on one bus.

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use myactuator_protocol_core::command::{BaudCode, ModelName, MotionRanges, VersionDate};
use myactuator_protocol_core::drive::{Bus, Drive, Event, FaultLimits, Gains, Parameters, Quirks};
use myactuator_protocol_core::io::{AsyncCanMaster, AsyncSerialMaster, CanMaster, SerialMaster};
use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::wire::rs485::Receiver;
use myactuator_protocol_core::{Firmware, MotorId};

use crate::sim::bus::can::{CanBus, CanPort, ControllerConfig};
use crate::sim::bus::rs485::{Rs485Line, SerialPort, TransceiverConfig};
use crate::sim::bus::{Medium, Node, SimClock, StationId, World};
use crate::sim::memory::{DriveMemory, StoreError};
use crate::sim::plant::{Load, MotorParameters, ParameterError, SimulatedMotor};
use crate::sim::seat::Seat;
use crate::sim::shaft::ShaftFile;

/// A drive with its physics and its memory.
pub type SimulatedDrive = Drive<SimulatedMotor, DriveMemory>;

/// The default model.
const DEFAULT_MODEL: &str = "RMD-X8-PRO";

/// The speed loop's bandwidth that factory gains aim at, rad/s.
const BANDWIDTH_RAD_S: f32 = 1_000.0;

/// Why drives cannot be simulated as asked.
#[derive(Debug, thiserror::Error)]
pub enum FleetError {
    /// The model's figures make no motor, or the load or the start angle cannot be.
    #[error("{0}")]
    Model(#[from] ParameterError),
    /// A load is for a motor that is not there.
    #[error("there is a load for motor {motor}, but the ids of the fleet are 1 to {count}")]
    NoSuchMotor {
        /// The motor that the load is for.
        motor: MotorId,
        /// How many motors there are.
        count: u8,
    },
    /// The file of a drive's memory cannot be read.
    #[error("{0}")]
    Memory(#[from] StoreError),
}

/// What is to be simulated. Build it up, then put it on a bus.
#[derive(Clone, Debug)]
pub struct Fleet {
    name: Option<String>,
    count: u8,
    /// The id of all, if they share one.
    shared_id: Option<MotorId>,
    model: Option<MotorParameters>,
    firmware: Option<Firmware>,
    motion_ranges: Option<MotionRanges>,
    version_date: Option<VersionDate>,
    quirks: Quirks,
    response: (Duration, Duration),
    seed: u64,
    memory_folder: Option<PathBuf>,
    has_brake: bool,
    load: Load,
    loads_of: BTreeMap<MotorId, Load>,
    start_angle_deg: f64,
}

impl Fleet {
    /// So many motors, with ids from 1; at most 32.
    pub fn new(count: u8) -> Self {
        Self {
            name: None,
            count: count.min(MotorId::COUNT as u8),
            shared_id: None,
            model: None,
            firmware: None,
            motion_ranges: None,
            version_date: None,
            quirks: Quirks::default(),
            response: (Duration::from_micros(700), Duration::from_micros(900)),
            seed: 1,
            memory_folder: None,
            has_brake: false,
            load: Load::NONE,
            loads_of: BTreeMap::new(),
            start_angle_deg: 0.0,
        }
    }

    /// On a bus of this name; else of "can" or "rs485".
    #[must_use]
    pub fn name(mut self, name: impl Into<String>) -> Self {
        self.name = Some(name.into());
        self
    }

    /// All with this id, as motors come from the factory with 1, instead of one after the other.
    #[must_use]
    pub fn all_with_id(mut self, id: MotorId) -> Self {
        self.shared_id = Some(id);
        self
    }

    /// With motors of this model; else of the RMD-X8-PRO.
    #[must_use]
    pub fn model(mut self, model: MotorParameters) -> Self {
        self.model = Some(model);
        self
    }

    /// With drives that speak this revision of the protocol; else their model's. One whose motion mode has
    /// no scales of its own (V4.4) needs [`motion_ranges`](Self::motion_ranges) too.
    #[must_use]
    pub fn firmware(mut self, firmware: Firmware) -> Self {
        self.firmware = Some(firmware);
        self
    }

    /// With these scales of motion mode; else those of the model or of the firmware.
    #[must_use]
    pub fn motion_ranges(mut self, ranges: MotionRanges) -> Self {
        self.motion_ranges = Some(ranges);
        self
    }

    /// With drives that report this version date (0xB2); else the one that is known of their firmware.
    #[must_use]
    pub fn version_date(mut self, date: VersionDate) -> Self {
        self.version_date = Some(date);
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

    /// With memories that outlive the process, in this folder: a file each of a drive's settings and of where
    /// its shaft is.
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

    /// With this load on each shaft; else with bare ones. A load can be changed later:
    /// [`SimulatedMotor::set_load`] through [`DriveHandle::with`].
    #[must_use]
    pub fn load(mut self, load: Load) -> Self {
        self.load = load;
        self
    }

    /// With this load on one motor's shaft, instead of the others'. Where all [share an id](Self::all_with_id) it
    /// is named by its place, from 1.
    #[must_use]
    pub fn load_of(mut self, motor: MotorId, load: Load) -> Self {
        self.loads_of.insert(motor, load);
        self
    }

    /// With shafts that are at this angle at the start, degrees, turns included, up to ±10⁹; else at 0. Where
    /// a [`memory_folder`](Self::memory_folder) knows where a shaft was left, it is there instead.
    #[must_use]
    pub fn start_angle_deg(mut self, angle_deg: f64) -> Self {
        self.start_angle_deg = angle_deg;
        self
    }

    /// Puts the drives on a CAN bus in virtual time.
    ///
    /// # Errors
    /// [`FleetError`]: the model's figures make no motor, a load or the start angle cannot be, a load is for a
    /// motor that is not there, or a memory file cannot be read.
    pub fn on_can(&self, bit_rate: u32) -> Result<CanFleet, FleetError> {
        let world = World::<CanBus>::new(bit_rate, self.seed);
        self.put_on(world, ControllerConfig::MAILBOXES, Bus::Can, bit_rate)
    }

    /// Puts the drives on an RS485 line in virtual time.
    ///
    /// # Errors
    /// As [`on_can`](Self::on_can).
    pub fn on_rs485(&self, bit_rate: u32) -> Result<LineFleet, FleetError> {
        let world = World::<Rs485Line>::new(bit_rate, self.seed);
        self.put_on(world, TransceiverConfig::default(), Bus::Rs485, bit_rate)
    }

    fn put_on<B: Medium>(
        &self,
        world: World<B>,
        attachment: B::Attachment,
        bus: Bus,
        bit_rate: u32,
    ) -> Result<BusFleet<B>, FleetError>
    where
        Seat: Node<B::Frame>,
    {
        let model = self.made_model()?;
        let count = self.count;
        if let Some(&motor) = self.loads_of.keys().find(|motor| motor.get() > count) {
            return Err(FleetError::NoSuchMotor { motor, count });
        }
        let mut drives = Vec::new();
        let serving: Arc<dyn Serving> = Arc::new(world.clone());
        for place in MotorId::all().take(self.count.into()) {
            let motor = self.shared_id.unwrap_or(place);
            let seat = self.seat(&model, place, motor, (bus, bit_rate))?;
            let seat = Arc::new(Mutex::new(seat));
            let station = world.attach_with(Arc::clone(&seat), attachment);
            drives.push(DriveHandle { motor, station, seat, world: Arc::clone(&serving) });
        }
        let kind = match bus {
            Bus::Can => "can",
            Bus::Rs485 => "rs485",
        };
        let name = self.name.clone().unwrap_or_else(|| kind.to_owned());
        Ok(BusFleet { name, world, drives, firmware: model.firmware, bit_rate })
    }

    /// The model, with the firmware and the scales that were asked for.
    fn made_model(&self) -> Result<MotorParameters, ParameterError> {
        let mut model = match &self.model {
            Some(model) => model.clone(),
            None => MotorParameters::named(DEFAULT_MODEL)?,
        };
        if let Some(firmware) = self.firmware {
            // The model's scales are those of its own.
            (model.firmware, model.motion) = (firmware, None);
        }
        model.motion = self.motion_ranges.or(model.motion);
        Ok(model)
    }

    /// The drive at this place among the others, which may share its id.
    fn seat(
        &self,
        model: &MotorParameters,
        place: MotorId,
        motor: MotorId,
        (bus, bit_rate): (Bus, u32),
    ) -> Result<Seat, FleetError> {
        let file =
            |what| self.memory_folder.as_ref().map(|it| it.join(format!("{what}-{place}.json")));
        let memory = file("motor").map_or(DriveMemory::Process(None), DriveMemory::File);
        let shaft = file("shaft").map(ShaftFile::open).transpose()?;
        // A stream of chance of its own for each drive.
        let seed =
            self.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(u64::from(place.get()));
        let of_model = parameters_of(model)?;
        let parameters = Parameters {
            id: motor,
            bus,
            baud_rate: baud_code(bus, bit_rate).unwrap_or(of_model.baud_rate),
            version_date: self.version_date.unwrap_or(of_model.version_date),
            response_delay_min: self.response.0,
            response_delay_max: self.response.1,
            quirks: self.quirks,
            has_brake: self.has_brake,
            seed: (seed ^ (seed >> 32)) as u32,
            ..of_model
        };
        let mut plant = SimulatedMotor::new(model.clone())?;
        plant.set_load(*self.loads_of.get(&place).unwrap_or(&self.load))?;
        let kept_deg = shaft.as_ref().and_then(ShaftFile::kept_deg);
        let angle_deg = kept_deg.unwrap_or(self.start_angle_deg);
        plant.set_output_angle_deg(angle_deg).map_err(ParameterError::from)?;
        let drive = Drive::new(parameters, plant, memory, Instant::ZERO)?;
        Ok(Seat { drive, receiver: Receiver::new(), shaft })
    }
}

/// The code of the bit rate that a bus has, if the manual gives it one.
fn baud_code(bus: Bus, bit_rate: u32) -> Option<BaudCode> {
    let codes = [BaudCode::CAN_500K_RS485_115200, BaudCode::CAN_1M_RS485_500K, BaudCode::RS485_1M];
    codes.into_iter().find(|&code| bus.bits_per_second(code) == Some(bit_rate))
}

/// A drive's parameters for a motor of this model: its firmware, limits, scales and factory gains.
fn parameters_of(model: &MotorParameters) -> Result<Parameters, ParameterError> {
    let rating = &model.rating;
    let peak_a = rating.peak_current_a as f32;
    let no_load_dps = (rating.no_load_speed_rpm * 6.0) as f32;
    let supply_a = (rating.peak_torque_nm * rating.speed_rpm * std::f64::consts::TAU
        / 60.0
        / rating.voltage_v) as f32;
    // A date that leads to no firmware where none is known of the model's.
    let dates = model.firmware.version_dates();
    let version_date = dates.first().copied().unwrap_or(VersionDate::from_raw(0));
    Ok(Parameters {
        model: model_name(&model.name),
        firmware: model.firmware,
        version_date,
        motion_ranges: model.motion_ranges()?,
        baud_rate: BaudCode::CAN_1M_RS485_500K,
        encoder_bits: model.encoder.bits,
        gear_ratio: model.gear.ratio,
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
    })
}

/// Up to seven characters of the model's name, without the maker's "RMD-"; of a long one the ends, as the maker's
/// catalogue has "X8-120" for the RMD-X8-P20-120.
fn model_name(name: &str) -> ModelName {
    let name = name.strip_prefix("RMD-").unwrap_or(name);
    let mut bytes = [0; 7];
    let ends = name.split_once('-').zip(name.rsplit_once('-'));
    let short = match ends {
        Some(((first, _), (_, last))) if name.len() > bytes.len() => format!("{first}-{last}"),
        _ => name.to_owned(),
    };
    for (byte, character) in bytes.iter_mut().zip(short.bytes().filter(u8::is_ascii_graphic)) {
        *byte = character;
    }
    ModelName::from_bytes(bytes)
}

/// A hand on one simulated drive.
#[derive(Clone)]
pub struct DriveHandle {
    motor: MotorId,
    station: StationId,
    pub(super) seat: Arc<Mutex<Seat>>,
    /// Where the drive is.
    world: Arc<dyn Serving>,
}

/// A world, whatever its bus.
trait Serving: Send + Sync {
    /// Brings a node's own time up to now, and sends what it has to send.
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
    /// The id that the drive started with.
    pub const fn motor(&self) -> MotorId {
        self.motor
    }

    /// Its place on the bus, for faults of the wire.
    pub const fn station(&self) -> StationId {
        self.station
    }

    /// What has happened in the drive and when, and how many events were lost before; the drive itself is left
    /// alone.
    pub(super) fn take_events(&self) -> (Vec<(Instant, Event)>, u32) {
        let mut seat = self.seat.lock().unwrap_or_else(PoisonError::into_inner);
        let drive = &mut seat.drive;
        let events = std::iter::from_fn(|| drive.poll_timed_event()).collect();
        (events, drive.dropped().1)
    }

    /// Works on the drive as it is now: raise an error, push the shaft, look at the physics. What that leads
    /// to begins now. Not while the world runs in this thread.
    pub fn with<T>(&self, work: impl FnOnce(&mut SimulatedDrive) -> T) -> T {
        self.world.serve(self.station);
        let mut seat = self.seat.lock().unwrap_or_else(PoisonError::into_inner);
        let result = work(&mut seat.drive);
        seat.drive.measure();
        drop(seat);
        self.world.serve(self.station);
        result
    }
}

/// Drives on a bus.
#[derive(Debug)]
pub struct BusFleet<B: Medium> {
    /// What the bus is called.
    pub name: String,
    /// The bus and its clock.
    pub world: World<B>,
    /// The drives, in the order of their ids.
    pub drives: Vec<DriveHandle>,
    /// Bits per second.
    pub bit_rate: u32,
    firmware: Firmware,
}

/// Drives on a CAN bus.
pub type CanFleet = BusFleet<CanBus>;

/// Drives on an RS485 line.
pub type LineFleet = BusFleet<Rs485Line>;

impl<B: Medium> BusFleet<B> {
    /// Runs async code on this bus; see [`World::block_on`].
    pub fn block_on<F: Future>(&self, future: F) -> F::Output {
        self.world.block_on(future)
    }
}

impl CanFleet {
    /// A master on this bus.
    pub fn master<const N: usize>(&self) -> CanMaster<CanPort, SimClock<CanBus>, N> {
        CanMaster::new(self.world.port(), self.world.clock(), self.config())
    }

    /// An async master on this bus, to be run within [`block_on`](Self::block_on).
    pub fn async_master<const N: usize>(&self) -> AsyncCanMaster<CanPort, SimClock<CanBus>, N> {
        AsyncCanMaster::new(self.world.port(), self.world.clock(), self.config())
    }

    fn config(&self) -> Config {
        Config { firmware: self.firmware, ..Config::can(self.bit_rate) }
    }
}

impl LineFleet {
    /// A master on this line.
    pub fn master<const N: usize>(&self) -> SerialMaster<SerialPort, SimClock<Rs485Line>, N> {
        SerialMaster::new(self.world.port(), self.world.clock(), self.config())
    }

    /// An async master on this line, to be run within [`block_on`](Self::block_on).
    pub fn async_master<const N: usize>(
        &self,
    ) -> AsyncSerialMaster<SerialPort, SimClock<Rs485Line>, N> {
        AsyncSerialMaster::new(self.world.port(), self.world.clock(), self.config())
    }

    fn config(&self) -> Config {
        Config { firmware: self.firmware, ..Config::rs485(self.bit_rate, false) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use myactuator_protocol_core::command::{
        ErrorFlags, FunctionControl, MotionLimits, ReadMultiTurnAngle, ReadSingleTurnAngle,
        ReadSingleTurnAngleV4_4, ReadVersionDate, Reset, SetCurrentPositionZero, Switch,
    };
    use myactuator_protocol_core::io::Runner;
    use myactuator_protocol_core::master::Event;

    /// Turns the first shaft of a fleet by -90 degrees.
    fn turned(fleet: Fleet) -> BusFleet<CanBus> {
        let fleet = fleet.on_can(1_000_000).unwrap();
        fleet.drives[0].with(|drive| drive.plant_mut().set_output_angle_deg(-90.0)).unwrap();
        fleet
    }

    #[test]
    fn a_v4_4_says_that_it_is_one_and_answers_0x94_in_its_own_way() {
        let limits = MotionLimits { torque_nm: 60.0, ..MotionRanges::V4_3.limits() };
        let ranges = MotionRanges::new(limits).unwrap();
        let v4_4 = turned(Fleet::new(1).firmware(Firmware::V4_4).motion_ranges(ranges));
        let mut master = v4_4.master::<1>();
        let date = master.ask(MotorId::MIN, ReadVersionDate).unwrap().version_date;
        assert_eq!(date.raw(), 2_026_042_402);
        let angle = master.ask(MotorId::MIN, ReadSingleTurnAngleV4_4).unwrap().angle;
        assert!((angle.degrees() + 90.0).abs() < 0.1, "{angle}");
        v4_4.drives[0].with(|drive| assert_eq!(drive.parameters().motion_ranges, ranges));

        let mut master = turned(Fleet::new(1)).master::<1>();
        let angle = master.ask(MotorId::MIN, ReadSingleTurnAngle).unwrap().angle;
        assert!((angle.degrees() - 270.0).abs() < 0.1, "{angle}");
    }

    #[test]
    fn a_shaft_is_where_the_last_run_has_left_it() {
        let folder = tempfile::tempdir().unwrap();
        let fleet = || Fleet::new(1).memory_folder(folder.path());
        let angle_deg = |fleet: &BusFleet<CanBus>| {
            let mut master = fleet.master::<1>();
            master.ask(MotorId::MIN, ReadMultiTurnAngle).unwrap().angle.degrees()
        };
        let first = turned(fleet());
        let mut master = first.master::<1>();
        master.ask(MotorId::MIN, SetCurrentPositionZero).unwrap();
        master.ask(MotorId::MIN, Reset).unwrap();
        first.world.run_for(Duration::from_secs(3));
        assert_eq!(angle_deg(&first), 0.0, "its zero is here");
        drop((first, master));

        let second = fleet().on_can(1_000_000).unwrap();
        assert_eq!(angle_deg(&second), 0.0, "it was there before");
        let turns = FunctionControl::SaveMultiTurn(Switch::On);
        let mut master = second.master::<1>();
        master.ask(MotorId::MIN, turns).unwrap();
        master.ask(MotorId::MIN, Reset).unwrap();
        second.world.run_for(Duration::from_secs(3));
        second.drives[0].with(|drive| drive.plant_mut().set_output_angle_deg(640.0)).unwrap();
        second.world.run_for(Duration::from_millis(1_500));
        assert!((angle_deg(&second) - 730.0).abs() < 0.1);
        // The run ends just now.
        second.drives[0].with(|drive| drive.plant_mut().set_output_angle_deg(650.0)).unwrap();
        drop((second, master));

        let third = fleet().on_can(1_000_000).unwrap();
        assert!((angle_deg(&third) - 740.0).abs() < 0.1, "its turns are kept");
    }

    #[test]
    fn shafts_start_where_it_is_said_unless_they_were_left_elsewhere() {
        let folder = tempfile::tempdir().unwrap();
        let kept =
            |start_deg| Fleet::new(1).memory_folder(folder.path()).start_angle_deg(start_deg);
        let angles_deg = |fleet: Fleet| {
            let fleet = fleet.on_can(1_000_000).unwrap();
            let mut master = fleet.master::<1>();
            let told = master.ask(MotorId::MIN, ReadMultiTurnAngle).unwrap().angle.degrees();
            (told, fleet.drives[0].with(|drive| drive.plant().output_angle_deg()))
        };
        let is_at = |fleet, expected: f64| {
            let (told, angle) = angles_deg(fleet);
            assert!((angle - expected).abs() < 1e-9, "{angle}");
            assert!((f64::from(told) - expected).abs() <= 0.01, "{told}");
        };
        is_at(Fleet::new(1).start_angle_deg(-35.5), -35.5);
        is_at(kept(90.0), 90.0);
        is_at(kept(-10.0), 90.0);
        assert!(Fleet::new(1).start_angle_deg(f64::NAN).on_can(1_000_000).is_err());
    }

    #[test]
    fn each_motor_has_its_load_and_none_is_for_a_motor_that_is_not_there() {
        let inertia = |inertia_kg_m2| Load { inertia_kg_m2, ..Load::NONE };
        let id = |number| MotorId::new(number).unwrap();
        let loaded = |motor| Fleet::new(3).load(inertia(1.0)).load_of(id(motor), inertia(2.0));
        let fleet = loaded(2).on_rs485(115_200).unwrap();
        let found =
            fleet.drives.iter().map(|it| it.with(|drive| drive.plant().load().inertia_kg_m2));
        assert_eq!(found.collect::<Vec<_>>(), [1.0, 2.0, 1.0]);
        let shared = loaded(2).all_with_id(id(9)).on_can(1_000_000).unwrap();
        let found =
            shared.drives.iter().map(|it| it.with(|drive| drive.plant().load().inertia_kg_m2));
        assert_eq!(found.collect::<Vec<_>>(), [1.0, 2.0, 1.0], "by their places");
        let error = loaded(4).on_can(1_000_000).unwrap_err().to_string();
        assert_eq!(error, "there is a load for motor 4, but the ids of the fleet are 1 to 3");
        let error = Fleet::new(1).load(inertia(-1.0)).on_can(1_000_000).unwrap_err().to_string();
        assert!(error.starts_with("load inertia must be 0 to"), "{error}");
    }

    #[test]
    fn a_handle_works_on_the_drive_as_it_is_now() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let mut master = fleet.master::<1>();
        master.ask(MotorId::MIN, FunctionControl::ErrorReporting(Switch::On)).unwrap();
        for millis in [3, 14, 9, 1] {
            fleet.world.run_for(Duration::from_millis(millis));
            let behind = fleet.drives[0].with(|drive| fleet.world.now() - drive.clock());
            assert!(behind <= Duration::from_millis(1), "{behind}");
        }
        // What comes of it does not wait either.
        let raised = fleet.world.now();
        fleet.drives[0].with(|drive| drive.raise_fault(ErrorFlags::MOTOR_OVER_TEMPERATURE));
        let until = raised + Duration::from_millis(2);
        let mut reported = None;
        master.run_until(until, |event| reported = reported.or(Some(event))).unwrap();
        assert!(matches!(reported, Some(Event::Report { .. })), "{reported:?}");
    }

    #[test]
    fn a_models_name_is_the_catalogues() {
        let names = [
            ("RMD-X8-PRO", "X8-PRO"),
            ("RMD-X8-P20-120", "X8-120"),
            ("RMD-X6-P20-60", "X6-60"),
            ("RMD-X4", "X4"),
            ("a name of my own", "anameof"),
        ];
        for (name, short) in names {
            assert_eq!(model_name(name).as_str(), Some(short));
        }
    }

    #[test]
    fn scales_are_never_made_up() {
        let v4_4 = || Fleet::new(1).firmware(Firmware::V4_4);
        let error = v4_4().on_can(1_000_000).unwrap_err().to_string();
        assert!(error.contains("v4.4's motion mode depend on the motor"), "{error}");
        assert!(v4_4().on_rs485(115_200).is_err());
        // Those of a model are of its own firmware.
        let mut model = MotorParameters::named(DEFAULT_MODEL).unwrap();
        model.motion = Some(MotionRanges::V4_3);
        assert!(v4_4().model(model).on_can(1_000_000).is_err());
    }
}
