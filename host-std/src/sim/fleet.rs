//! Several simulated drives on one bus.

mod of_model;
mod on_bus;
mod setup;

use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use myactuator_protocol_core::command::{MotionRanges, VersionDate};
use myactuator_protocol_core::drive::{Bus, Drive, Quirks};
use myactuator_protocol_core::master::MotorSet;
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::{Firmware, MotorId};

use crate::BusKind;
use crate::sim::PlannedFault;
use crate::sim::bus::can::{CanBus, ControllerConfig};
use crate::sim::bus::rs485::{Rs485Line, TransceiverConfig};
use crate::sim::bus::{Medium, Node, World};
use crate::sim::memory::{DriveMemory, StoreError};
use crate::sim::plant::{Load, MotorParameters, ParameterError, SimulatedMotor, Supply};
use crate::sim::seat::Seat;

pub use on_bus::{BusFleet, CanFleet, DriveHandle, LineFleet};
pub use setup::MotorSetup;

use on_bus::Serving;
use setup::{MemoryFiles, Surroundings};

/// A drive with its physics and its memory.
pub type SimulatedDrive = Drive<SimulatedMotor, DriveMemory>;

/// The model of motors that were given no other.
const USUAL_MODEL: &str = "RMD-X6-P20-60";

/// Why drives cannot be simulated as asked.
#[derive(Debug, thiserror::Error)]
pub enum FleetError {
    /// The figures of a model make no motor, or a load or a start angle is impossible.
    #[error("{0}")]
    Model(#[from] ParameterError),
    /// A former run has left the shaft of a motor where its load does not allow it.
    #[error(
        "motor {motor}, which the run before has left at {angle_deg} deg: {error}; take another memory folder \
         or another load"
    )]
    Left {
        /// The id that it starts with.
        motor: MotorId,
        /// Where its shaft was left, degrees.
        angle_deg: f64,
        /// What is impossible.
        error: ParameterError,
    },
    /// A motor was set up, or is to have a fault, that the fleet does not have.
    #[error("there is no motor {motor}: the fleet's motors are {motors}")]
    NoSuchMotor {
        /// The id that no motor has.
        motor: MotorId,
        /// The fleet's ids.
        motors: MotorSet,
    },
    /// The file of a drive's memory cannot be read.
    #[error("{0}")]
    Memory(#[from] StoreError),
}

/// The drives that are to be simulated. Build a fleet up, then put it on a bus.
///
/// A setting of motors applies to all motors of the fleet, or with [`motor`](Self::motor) to one. The last setting
/// counts.
#[derive(Clone, Debug)]
pub struct Fleet {
    name: Option<String>,
    motors: Vec<MotorSetup>,
    /// A motor that was set up but is not in the fleet, and the fleet's motors then.
    missing: Option<(MotorId, MotorSet)>,
    pub(super) faults: Vec<PlannedFault>,
    supply: Option<Supply>,
    seed: u64,
    memory_folder: Option<PathBuf>,
}

impl Fleet {
    /// A fleet of `count` motors of the [usual kind](MotorSetup::new), with ids from 1; at most 32.
    pub fn new(count: u8) -> Self {
        Self::of(MotorId::all().take(count.into()).map(MotorSetup::new))
    }

    /// A fleet of these motors. Several may have the same id, as motors from the factory all have 1.
    pub fn of(motors: impl IntoIterator<Item = MotorSetup>) -> Self {
        let motors = motors.into_iter().collect();
        Self {
            name: None,
            motors,
            missing: None,
            faults: Vec::new(),
            supply: None,
            seed: 1,
            memory_folder: None,
        }
    }

    /// Sets the name of the bus. The default is "can" or "rs485".
    #[must_use]
    pub fn name(mut self, name: impl Into<String>) -> Self {
        self.name = Some(name.into());
        self
    }

    /// The name of its bus, if it was given one.
    pub fn bus_name(&self) -> Option<&str> {
        self.name.as_deref()
    }

    /// The motors.
    pub fn motors(&self) -> &[MotorSetup] {
        &self.motors
    }

    /// Their ids.
    pub fn ids(&self) -> MotorSet {
        self.motors.iter().map(|motor| motor.id).collect()
    }

    fn all(mut self, change: impl FnMut(&mut MotorSetup)) -> Self {
        self.motors.iter_mut().for_each(change);
        self
    }

    /// Changes the motor with this id, or those that share it.
    #[must_use]
    pub fn motor(mut self, id: MotorId, change: impl FnMut(&mut MotorSetup)) -> Self {
        let ids = self.ids();
        if !ids.contains(id) {
            self.missing.get_or_insert((id, ids));
        }
        self.motors.iter_mut().filter(|motor| motor.id == id).for_each(change);
        self
    }

    /// Gives all motors this id, as motors from the factory all have 1. The default is ids from 1.
    #[must_use]
    pub fn all_with_id(self, id: MotorId) -> Self {
        self.all(|motor| motor.id = id)
    }

    /// Sets the model. The default is the RMD-X6-P20-60; V4.3 is made for its line.
    #[must_use]
    pub fn model(self, model: MotorParameters) -> Self {
        self.all(|motor| motor.model = Some(model.clone()))
    }

    /// Sets the revision of the protocol. The default is the model's. A revision whose motion mode has
    /// no scales of its own (V4.4) needs [`motion_ranges`](Self::motion_ranges), too.
    #[must_use]
    pub fn firmware(self, firmware: Firmware) -> Self {
        self.all(|motor| motor.firmware = Some(firmware))
    }

    /// Sets the scales of motion mode. The default is those of the model or of the firmware.
    #[must_use]
    pub fn motion_ranges(self, ranges: MotionRanges) -> Self {
        self.all(|motor| motor.motion_ranges = Some(ranges))
    }

    /// Sets the version date that drives report (0xB2). The default is the one that is known for their firmware.
    #[must_use]
    pub fn version_date(self, date: VersionDate) -> Self {
        self.all(|motor| motor.version_date = Some(date))
    }

    /// Makes the drives deviate from the manual in these ways.
    #[must_use]
    pub fn quirks(self, quirks: Quirks) -> Self {
        self.all(|motor| motor.quirks = quirks)
    }

    /// Makes the drives answer after `min` to `max`. The default is 0.7 to 0.9 ms.
    #[must_use]
    pub fn response(self, min: Duration, max: Duration) -> Self {
        self.all(|motor| motor.response = (min, max))
    }

    /// Sets the seed of everything that happens by chance. The same seed gives the same run.
    #[must_use]
    pub fn seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// Keeps the memories of the drives in this folder, so that they outlive the process. For each drive there is a
    /// file with its settings and a file with the place of its shaft, named by the id that it starts with.
    /// The folder must exist: a drive that cannot store a setting does not answer the command that writes it.
    #[must_use]
    pub fn memory_folder(mut self, folder: impl Into<PathBuf>) -> Self {
        self.memory_folder = Some(folder.into());
        self
    }

    /// Sets whether the motors have brakes, which are locked at first.
    #[must_use]
    pub fn brakes(self, has_brake: bool) -> Self {
        self.all(|motor| motor.has_brake = has_brake)
    }

    /// Puts this load on each shaft. The default is a bare shaft. To change a load later call
    /// [`SimulatedMotor::set_load`] through [`DriveHandle::with`].
    #[must_use]
    pub fn load(self, load: Load) -> Self {
        self.all(|motor| motor.load = load)
    }

    /// Sets the angle of the shafts at the start, degrees, turns included, up to ±10⁹. The default is 0. If a
    /// [`memory_folder`](Self::memory_folder) knows where a shaft was left, the shaft is there instead.
    #[must_use]
    pub fn start_angle_deg(self, angle_deg: f64) -> Self {
        self.all(|motor| motor.start_angle_deg = angle_deg)
    }

    /// Makes all motors share this supply: the voltage sags for all when one draws current. Its capacitor and brake
    /// resistor are where the motors' cables meet; each motor keeps its own capacitor, and the resistance of its own
    /// cable. By default each motor has a [supply](SimulatedMotor::supply) of its own.
    #[must_use]
    pub fn supply(mut self, supply: Supply) -> Self {
        self.supply = Some(supply);
        self
    }

    /// Plans these faults. The default is none. Their times count from when the drives are put on a bus, by its clock,
    /// virtual or real. To plan more later call [`BusFleet::plan`].
    #[must_use]
    pub fn faults(mut self, faults: impl IntoIterator<Item = PlannedFault>) -> Self {
        self.faults = faults.into_iter().collect();
        self
    }

    /// Puts the drives on a CAN bus in virtual time.
    ///
    /// # Errors
    /// [`FleetError`]: the figures of a model make no motor; a load or a start angle is impossible; a motor was set up,
    /// or is to have a fault, that the fleet does not have; or a memory file cannot be read.
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
        let motors = self.ids();
        let mut with_faults = self.faults.iter().filter_map(|fault| fault.motor);
        let unknown = with_faults.find(|&motor| !motors.contains(motor));
        if let Some((motor, motors)) = self.missing.or(unknown.map(|motor| (motor, motors))) {
            return Err(FleetError::NoSuchMotor { motor, motors });
        }
        let usual_model = MotorParameters::named(USUAL_MODEL)?;
        let mut drives: Vec<DriveHandle> = Vec::new();
        let serving: Arc<dyn Serving> = Arc::new(world.clone());
        for (setup, place) in self.motors.iter().zip(1_u64..) {
            let motor = setup.id;
            let namesakes = drives.iter().filter(|drive| drive.motor() == motor).count();
            let surroundings = Surroundings {
                bus,
                bit_rate,
                usual_model: &usual_model,
                // Each drive has its own stream of random numbers.
                seed: self.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(place),
                files: self
                    .memory_folder
                    .as_ref()
                    .map(|folder| MemoryFiles::of(folder, motor, namesakes)),
            };
            let seat = Arc::new(Mutex::new(setup.seat(surroundings)?));
            let station = world.attach_with(Arc::clone(&seat), attachment);
            drives.push(DriveHandle::new(motor, station, seat, Arc::clone(&serving)));
        }
        let kind = match bus {
            Bus::Can => BusKind::Can,
            Bus::Rs485 => BusKind::Rs485,
        };
        let name = self.name.clone().unwrap_or_else(|| kind.name().to_owned());
        // A master decodes all replies by one firmware.
        let model = self.motors.first().map(|motor| motor.made_model(&usual_model));
        let firmware = model.map_or(usual_model.firmware, |model| model.firmware);
        let mechanics_failure = Default::default();
        let mut fleet = BusFleet {
            name,
            world,
            drives,
            firmware,
            bit_rate,
            mechanics_failure,
            shared_supply: None,
        };
        if let Some(supply) = self.supply {
            fleet.share_supply(supply).map_err(ParameterError::from)?;
        }
        self.faults.iter().for_each(|&fault| fleet.plan(fault));
        Ok(fleet)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::plant::EndStop;
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
    fn v4_4_drive_reports_its_version_date_and_has_its_own_reply_to_0x94() {
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
    fn shaft_starts_where_the_last_run_left_it() {
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
    fn start_angle_counts_unless_a_run_left_the_shaft_elsewhere() {
        let folder = tempfile::tempdir().unwrap();
        let kept =
            |start_deg| Fleet::new(1).memory_folder(folder.path()).start_angle_deg(start_deg);
        let angles_deg = |fleet: Fleet| {
            let fleet = fleet.on_can(1_000_000).unwrap();
            let mut master = fleet.master::<1>();
            let reported = master.ask(MotorId::MIN, ReadMultiTurnAngle).unwrap().angle.degrees();
            (reported, fleet.drives[0].with(|drive| drive.plant().output_angle_deg()))
        };
        let is_at = |fleet, expected: f64| {
            let (reported, angle) = angles_deg(fleet);
            assert!((angle - expected).abs() < 1e-9, "{angle}");
            assert!((f64::from(reported) - expected).abs() <= 0.01, "{reported}");
        };
        is_at(Fleet::new(1).start_angle_deg(-35.5), -35.5);
        is_at(kept(90.0), 90.0);
        is_at(kept(-10.0), 90.0);
        assert!(Fleet::new(1).start_angle_deg(f64::NAN).on_can(1_000_000).is_err());
    }

    /// An X6-60's gear has 10' of play. A shaft once started in its middle, and a load that leaned on one side moved
    /// on by half of the play in each run.
    #[test]
    fn load_keeps_its_side_of_the_gears_play_in_the_next_run() {
        let folder = tempfile::tempdir().unwrap();
        let hanging = Load { torque_nm: -6.0, ..Load::NONE };
        let fleet = Fleet::new(1).brakes(true).load(hanging).memory_folder(folder.path());
        let sides_deg = || {
            let fleet = fleet.on_can(1_000_000).unwrap();
            fleet.world.run_for(Duration::from_millis(100));
            let sides_deg =
                |plant: &SimulatedMotor| [plant.output_angle_deg(), plant.motor_side_angle_deg()];
            fleet.drives[0].with(|drive| sides_deg(drive.plant()))
        };
        let first = sides_deg();
        assert!((first[1] - first[0] - 5.0 / 60.0).abs() < 1e-9, "{first:?}");
        for _ in 0..3 {
            let next = sides_deg();
            assert!(
                first.iter().zip(next).all(|(a, b)| (a - b).abs() < 1e-9),
                "{first:?} {next:?}"
            );
        }
    }

    #[test]
    fn shaft_left_beyond_a_new_end_stop_is_reported_with_its_motor() {
        let folder = tempfile::tempdir().unwrap();
        let fleet = || Fleet::new(1).memory_folder(folder.path());
        let before = fleet().start_angle_deg(140.0).on_can(1_000_000).unwrap();
        before.world.run_for(Duration::from_millis(1));
        drop(before);
        let stop = EndStop { at_deg: 90.0, stiffness_nm_per_rad: 5_000.0, restitution: 0.0 };
        let ended = fleet().load(Load { upper_stop: Some(stop), ..Load::NONE });
        let reported = ended.on_can(1_000_000).unwrap_err().to_string();
        let expected = "motor 1, which the run before has left at 140 deg: angle of the shaft between its end stops";
        assert!(reported.starts_with(expected), "{reported}");
    }

    #[test]
    fn each_motor_has_its_load_and_one_for_an_absent_motor_is_refused() {
        let inertia = |inertia_kg_m2| Load { inertia_kg_m2, ..Load::NONE };
        let id = |number| MotorId::new(number).unwrap();
        let loaded = |motor| {
            Fleet::new(3).load(inertia(1.0)).motor(id(motor), |motor| motor.load = inertia(2.0))
        };
        let fleet = loaded(2).on_rs485(115_200).unwrap();
        let found =
            fleet.drives.iter().map(|it| it.with(|drive| drive.plant().load().inertia_kg_m2));
        assert_eq!(found.collect::<Vec<_>>(), [1.0, 2.0, 1.0]);
        let shared = loaded(2).all_with_id(id(9)).on_can(1_000_000).unwrap();
        let found =
            shared.drives.iter().map(|it| it.with(|drive| drive.plant().load().inertia_kg_m2));
        assert_eq!(found.collect::<Vec<_>>(), [1.0, 2.0, 1.0], "they keep them");
        let error = loaded(4).on_can(1_000_000).unwrap_err().to_string();
        assert_eq!(error, "there is no motor 4: the fleet's motors are 1 2 3");
        let fault = "cut@5".parse().unwrap();
        let error = Fleet::new(3).faults([fault]).on_can(1_000_000).unwrap_err().to_string();
        assert_eq!(error, "there is no motor 5: the fleet's motors are 1 2 3");
        let error = Fleet::new(1).load(inertia(-1.0)).on_can(1_000_000).unwrap_err().to_string();
        assert!(error.starts_with("load inertia must be 0 to"), "{error}");
    }

    #[test]
    fn motors_differ_and_their_ids_need_not_follow_one_another() {
        let id = |number| MotorId::new(number).unwrap();
        let x8 = MotorParameters::named("RMD-X8-P20-120").unwrap();
        let fleet = Fleet::of([7, 3, 7].map(|number| MotorSetup::new(id(number))));
        let fleet = fleet.brakes(true).motor(id(3), |motor| {
            motor.model = Some(x8.clone());
            motor.has_brake = false;
            motor.start_angle_deg = 12.5;
        });
        let fleet = fleet.on_rs485(115_200).unwrap();
        let found = fleet.drives.iter().map(|it| {
            it.with(|drive| {
                let parameters = drive.parameters();
                let model = parameters.model.as_str().map(str::to_owned).unwrap();
                (it.motor().get(), model, parameters.has_brake, drive.plant().output_angle_deg())
            })
        });
        let x6 = (7, "X6-60".to_owned(), true, 0.0);
        let expected = [x6.clone(), (3, "X8-120".to_owned(), false, 12.5), x6];
        assert_eq!(found.collect::<Vec<_>>(), expected);
    }

    #[test]
    fn memories_are_named_by_the_first_id_of_a_drive() {
        let folder = tempfile::tempdir().unwrap();
        let ids = [9, 4, 9].map(|number| MotorSetup::new(MotorId::new(number).unwrap()));
        let fleet = Fleet::of(ids).memory_folder(folder.path()).on_can(1_000_000).unwrap();
        fleet.world.run_for(Duration::from_millis(10));
        for (drive, angle_deg) in fleet.drives.iter().zip([1.0, 2.0, 3.0]) {
            drive.with(|drive| drive.plant_mut().set_output_angle_deg(angle_deg)).unwrap();
        }
        drop(fleet);
        for (name, angle_deg) in [("shaft-9", 1.0), ("shaft-4", 2.0), ("shaft-9-2", 3.0)] {
            let file = folder.path().join(format!("{name}.json"));
            let text = std::fs::read_to_string(&file).unwrap();
            let kept: serde_json::Value =
                serde_json::from_str(text.lines().nth(1).unwrap()).unwrap();
            let kept_deg = kept["output_deg"].as_f64().unwrap();
            assert!((kept_deg - angle_deg).abs() < 1e-9, "{name}: {kept}");
        }
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
    fn scales_are_never_made_up() {
        let v4_4 = || Fleet::new(1).firmware(Firmware::V4_4);
        let error = v4_4().on_can(1_000_000).unwrap_err().to_string();
        assert!(error.contains("v4.4's motion mode depend on the motor"), "{error}");
        assert!(v4_4().on_rs485(115_200).is_err());
        // Those of a model are of its own firmware.
        let mut model = MotorParameters::named(USUAL_MODEL).unwrap();
        model.motion = Some(MotionRanges::V4_3);
        assert!(v4_4().model(model).on_can(1_000_000).is_err());
    }
}
