//! A simulated bus with its drives in real time.

use std::fmt::Debug;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::ErrorFlags;
use myactuator_protocol_core::drive::Event;
use myactuator_protocol_core::time::Instant;

use crate::sim::bus::faults::{Babble, Direction, FaultPlan};
use crate::sim::bus::{Medium, World, trace};
use crate::sim::mechanics::MechanicsFailure;
use crate::sim::{BusFleet, DriveHandle, DriveLog, FaultKind, LogRecord, PlannedFault};

use super::Notice;
use super::control::state::{BusState, MotorState, Traffic};

const DIRECTIONS: [Direction; 2] = [Direction::ToNodes, Direction::ToPorts];

/// A bus of either kind that is being served.
pub(super) trait Hosted: Debug {
    /// What the bus is called.
    fn name(&self) -> &str;

    /// Its drives, in the order of their places.
    fn drives(&self) -> &[DriveHandle];

    /// Its time.
    fn now(&self) -> Instant;

    /// When something happens next by itself; `None` for never.
    fn next_event(&self) -> Option<Instant>;

    /// Under virtual time, lets time go on.
    fn run_until(&self, at: Instant);

    /// Counts frames from now on.
    fn count_traffic(&self);

    /// How the bus is, and this motor on it, or all of them.
    fn state(&self, motor: Option<MotorId>) -> BusState;

    /// Cuts or mends a motor's cable, or everybody's.
    fn set_cable(&mut self, motor: Option<MotorId>, is_cut: bool);

    /// Has time go on with the wall clock from now on, whatever has passed.
    fn follow_wall_clock(&self);

    /// How long it still is until something happens by itself; `None` for nothing ever.
    fn until_next_event(&self) -> Option<Duration> {
        Some((self.next_event()? - self.now()).into())
    }

    /// Tells of drives that were set to another bit rate than their bus has.
    fn tell_rates(&self, notify: &mut dyn FnMut(Notice));

    /// Lets something go wrong.
    fn strike(&mut self, fault: &PlannedFault);

    /// Why shafts stand, said once.
    fn poll_mechanics_failure(&mut self) -> Option<String>;

    /// What happened in the drives.
    fn poll_log(&mut self) -> Vec<LogRecord>;

    /// Takes the supply from all drives, which store what they save then. Gives those that could not.
    fn power_off(&self) -> Vec<MotorId>;
}

/// A bus, its drives, and what is wrong with them.
#[derive(Debug)]
pub(super) struct Host<B: Medium> {
    name: String,
    world: World<B>,
    bit_rate: u32,
    drives: Vec<DriveHandle>,
    log: DriveLog,
    /// Why shafts stand, until that was said.
    mechanics_failure: Option<MechanicsFailure>,
    /// The plans of all drives that have none of their own, by direction.
    common: [FaultPlan; 2],
    /// Each drive's own plans.
    own: Vec<[Option<FaultPlan>; 2]>,
    /// Whose cables are cut.
    cut: Vec<bool>,
    traffic: Arc<Mutex<TrafficNs>>,
}

#[derive(Debug, Default)]
struct TrafficNs {
    counted: Traffic,
    busy_ns: u64,
}

impl<B: Medium> Host<B> {
    pub(super) fn new(fleet: &BusFleet<B>) -> Self {
        Self {
            name: fleet.name.clone(),
            world: fleet.world.clone(),
            bit_rate: fleet.bit_rate,
            drives: fleet.drives.clone(),
            log: DriveLog::of(fleet),
            mechanics_failure: Some(fleet.mechanics_failure.clone()),
            common: [FaultPlan::NONE; 2],
            own: vec![[None; 2]; fleet.drives.len()],
            cut: vec![false; fleet.drives.len()],
            traffic: Arc::default(),
        }
    }

    /// Changes what chance does, and leaves what it did so far.
    fn change_plans(&mut self, fault: &PlannedFault, change: impl Fn(&mut FaultPlan)) {
        for (way, &direction) in DIRECTIONS.iter().enumerate() {
            if fault.direction.is_some_and(|only| only != direction) {
                continue;
            }
            let common = &mut self.common[way];
            for (drive, own) in self.drives.iter().zip(&mut self.own) {
                let own = &mut own[way];
                if fault.motor == Some(drive.motor()) {
                    change(own.get_or_insert(*common));
                } else if let (None, Some(own)) = (fault.motor, &mut *own) {
                    change(own);
                }
                self.world.set_node_faults(drive.station(), direction, *own);
            }
            if fault.motor.is_none() {
                change(common);
                self.world.set_faults(direction, *common);
            }
        }
    }
}

impl<B: Medium> Hosted for Host<B> {
    fn name(&self) -> &str {
        &self.name
    }

    fn drives(&self) -> &[DriveHandle] {
        &self.drives
    }

    fn now(&self) -> Instant {
        self.world.now()
    }

    fn next_event(&self) -> Option<Instant> {
        self.world.next_event()
    }

    fn run_until(&self, at: Instant) {
        self.world.run_until(at);
    }

    fn count_traffic(&self) {
        let traffic = Arc::clone(&self.traffic);
        self.world.observe(move |record| {
            let (started_ns, is_whole) = match record.event {
                trace::Event::Carried { started_ns, .. } => (started_ns, true),
                trace::Event::Broken { started_ns, .. }
                | trace::Event::Unacknowledged { started_ns, .. } => (started_ns, false),
                _ => return,
            };
            let mut traffic = traffic.lock().unwrap_or_else(PoisonError::into_inner);
            traffic.counted.frames += u64::from(is_whole);
            traffic.counted.broken += u64::from(!is_whole);
            traffic.busy_ns += record.at_ns - started_ns;
        });
    }

    fn state(&self, motor: Option<MotorId>) -> BusState {
        let motors = self.drives.iter().zip(&self.cut);
        let motors = motors.filter(|(drive, _)| motor.is_none_or(|motor| motor == drive.motor()));
        let of = |(handle, &cut): (&DriveHandle, &bool)| {
            handle.with(|drive| MotorState::of(handle.motor(), drive, self.bit_rate, cut))
        };
        let motors = motors.map(of).collect();
        let traffic = self.traffic.lock().unwrap_or_else(PoisonError::into_inner);
        let traffic = Traffic { busy_us: traffic.busy_ns / 1_000, ..traffic.counted };
        BusState { bus: self.name.clone(), bit_rate: self.bit_rate, traffic, motors }
    }

    fn set_cable(&mut self, motor: Option<MotorId>, is_cut: bool) {
        for (drive, cut) in self.drives.iter().zip(&mut self.cut) {
            if motor.is_none_or(|motor| motor == drive.motor()) {
                *cut = is_cut;
                let station = drive.station();
                if is_cut { self.world.cut(station) } else { self.world.mend(station) }
            }
        }
    }

    fn follow_wall_clock(&self) {
        self.world.clone().in_real_time();
    }

    fn tell_rates(&self, notify: &mut dyn FnMut(Notice)) {
        let bus_rate = self.bit_rate;
        for drive in &self.drives {
            let own = drive.with(|drive| drive.bit_rate()).filter(|&own| own != bus_rate);
            if let Some(bit_rate) = own {
                let (bus, motor) = (self.name.clone(), drive.motor());
                notify(Notice::OwnRate { bus, motor, bit_rate, bus_rate });
            }
        }
    }

    fn strike(&mut self, fault: &PlannedFault) {
        if let FaultKind::Chance(chance) = fault.kind {
            return self.change_plans(fault, |plan| chance.add_to(plan));
        }
        if let FaultKind::Cut | FaultKind::Mend = fault.kind {
            self.set_cable(fault.motor, fault.kind == FaultKind::Cut);
        }
        let world = &self.world;
        let struck = |drive: &&DriveHandle| fault.motor.is_none_or(|motor| motor == drive.motor());
        for drive in self.drives.iter().filter(struck) {
            let station = drive.station();
            match fault.kind {
                FaultKind::Chance(_) | FaultKind::Cut => {}
                FaultKind::Babble(interval) => {
                    world.babble(station, Some(Babble { interval, frame: None }));
                }
                FaultKind::Slow(by) => world.slow_down(station, by),
                FaultKind::Mend => {
                    world.slow_down(station, Default::default());
                    world.babble(station, None);
                }
                FaultKind::Reset => world.reset(station),
                FaultKind::Error(errors) => drive.with(|drive| drive.raise_fault(errors)),
                FaultKind::Clear => {
                    drive.with(|drive| drive.clear_fault(ErrorFlags::all()));
                }
            }
        }
    }

    fn poll_mechanics_failure(&mut self) -> Option<String> {
        let reason = self.mechanics_failure.as_ref()?.reason()?;
        self.mechanics_failure = None;
        Some(reason)
    }

    fn poll_log(&mut self) -> Vec<LogRecord> {
        self.log.poll(self.world.now())
    }

    fn power_off(&self) -> Vec<MotorId> {
        let now = self.world.now();
        let fails = |drive: &&DriveHandle| {
            drive.with(|drive| {
                while drive.poll_event().is_some() {}
                drive.power_off(now);
                let mut events = std::iter::from_fn(|| drive.poll_event());
                events.any(|event| event == Event::MemoryFailed)
            })
        };
        self.drives.iter().filter(fails).map(DriveHandle::motor).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::Fleet;
    use crate::sim::mechanics::{Failure, Mechanics, Shaft};
    use myactuator_protocol_core::command::{ReadMultiTurnAngle, ReadStatus1};
    use myactuator_protocol_core::io::{CanMaster, Runner};
    use myactuator_protocol_core::master::Config;
    use myactuator_protocol_core::time;

    /// Two drives under virtual time, what hosts them, and whether each of them answers.
    fn answers(faults: &[&str]) -> [bool; 2] {
        let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
        let mut host = Host::new(&fleet);
        for fault in faults {
            host.strike(&fault.parse().unwrap());
        }
        let config = Config { attempts: 1, ..Config::CAN };
        let mut master = CanMaster::<_, _, 2>::new(fleet.world.port(), fleet.world.clock(), config);
        [1, 2].map(|id| master.ask(MotorId::new(id).unwrap(), ReadMultiTurnAngle).is_ok())
    }

    #[test]
    fn faults_strike_whom_they_name() {
        assert_eq!(answers(&[]), [true, true]);
        assert_eq!(answers(&["lose=1"]), [false, false]);
        assert_eq!(answers(&["lose=1@2"]), [true, false]);
        assert_eq!(answers(&["lose=1@2,from-drives"]), [true, false]);
        assert_eq!(answers(&["cut@1"]), [false, true]);
        assert_eq!(answers(&["slow=1s@2"]), [true, false]);
    }

    #[test]
    fn later_faults_add_to_earlier_ones() {
        assert_eq!(answers(&["lose=1@2", "duplicate=0.5"]), [true, false]);
        assert_eq!(answers(&["lose=1", "duplicate=0.5@2"]), [false, false]);
        assert_eq!(answers(&["lose=1@2", "lose=0"]), [true, true]);
        assert_eq!(answers(&["lose=1", "lose=0@2"]), [false, true]);
        assert_eq!(answers(&["cut", "slow=1s", "babble@1", "mend"]), [true, true]);
    }

    #[test]
    fn a_failure_of_the_mechanics_is_said_once() {
        struct Failing;
        impl Mechanics for Failing {
            fn step(&mut self, _: time::Duration, _: &mut [Shaft]) -> Result<(), Failure> {
                Err("the engine has crashed".into())
            }
        }
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let mut host = Host::new(&fleet);
        fleet.lead(&fleet.drives, time::Duration::from_millis(1), Failing).unwrap();
        assert_eq!(host.poll_mechanics_failure(), None);
        fleet.world.run_for(time::Duration::from_millis(2));
        let said = [(); 2].map(|()| host.poll_mechanics_failure());
        assert_eq!(said, [Some("the engine has crashed".to_owned()), None]);
    }

    #[test]
    fn errors_come_and_go() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let mut host = Host::new(&fleet);
        let mut master = fleet.master::<1>();
        let mut named = |fault: &str| {
            host.strike(&fault.parse().unwrap());
            let errors = master.ask(MotorId::MIN, ReadStatus1).unwrap().errors;
            errors.each().filter_map(|error| error.name()).collect::<Vec<_>>()
        };
        assert_eq!(named("over-speed"), ["over-speed"]);
        assert_eq!(named("stall@1"), ["stall", "over-speed"]);
        // Stall is of level one, which only a restart ends (8.2).
        assert_eq!(named("clear"), ["stall"]);
        assert_eq!(named("stall@2"), ["stall"]);
    }
}
