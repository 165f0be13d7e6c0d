//! A simulated bus with its drives in real time.

use std::fmt::Debug;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::drive::Event;
use myactuator_protocol_core::time::Instant;

use crate::sim::bus::{Medium, trace};
use crate::sim::{BusFleet, DriveHandle, DriveLog, LogRecord, PlannedFault, SharedSupply};

use super::Notice;
use super::control::state::{BusState, MotorState, Traffic};

/// A bus of either kind that is being served.
pub(super) trait Hosted: Debug {
    /// The name of the bus.
    fn name(&self) -> &str;

    /// Its drives, in the order of their places.
    fn drives(&self) -> &[DriveHandle];

    /// The supply that its drives share, if they do.
    fn shared_supply(&self) -> Option<&SharedSupply>;

    /// Its time.
    fn now(&self) -> Instant;

    /// When something happens next on its own; `None` for never.
    fn next_event(&self) -> Option<Instant>;

    /// Under virtual time, lets time go on.
    fn run_until(&self, at: Instant);

    /// Counts frames from now on.
    fn count_traffic(&self);

    /// The state of the bus, and of this motor on it, or of all.
    fn state(&self, motor: Option<MotorId>) -> BusState;

    /// Cuts or mends the cable of a motor, or of all.
    fn set_cable(&self, motor: Option<MotorId>, is_cut: bool);

    /// Makes time go on with the wall clock from now on, however much has passed.
    fn follow_wall_clock(&self);

    /// How long it takes until something happens on its own; `None` for never.
    fn until_next_event(&self) -> Option<Duration> {
        Some((self.next_event()? - self.now()).into())
    }

    /// Reports drives that were set to another bit rate than their bus's.
    fn report_rates(&self, notify: &mut dyn FnMut(Notice));

    /// Plans a fault, whose time counts from now.
    fn plan(&self, fault: PlannedFault);

    /// How many faults wait for their time or condition.
    fn planned(&self) -> usize;

    /// Why shafts stand; returned once.
    fn poll_mechanics_failure(&mut self) -> Option<String>;

    /// What happened in the drives.
    fn poll_log(&mut self) -> Vec<LogRecord>;

    /// Switches the supply of all drives off, which then store what they keep. Returns those that could not.
    fn power_off(&self) -> Vec<MotorId>;
}

/// A bus and its drives.
#[derive(Debug)]
pub(super) struct Host<B: Medium> {
    fleet: BusFleet<B>,
    log: DriveLog,
    /// The reason why shafts stand was returned.
    is_failure_told: bool,
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
            fleet: fleet.clone(),
            log: DriveLog::of(fleet),
            is_failure_told: false,
            traffic: Arc::default(),
        }
    }

    /// The drives with this id, or all.
    fn named(&self, motor: Option<MotorId>) -> impl Iterator<Item = &DriveHandle> {
        self.fleet.drives.iter().filter(move |it| motor.is_none_or(|motor| motor == it.motor()))
    }
}

impl<B: Medium> Hosted for Host<B> {
    fn name(&self) -> &str {
        &self.fleet.name
    }

    fn drives(&self) -> &[DriveHandle] {
        &self.fleet.drives
    }

    fn shared_supply(&self) -> Option<&SharedSupply> {
        self.fleet.shared_supply()
    }

    fn now(&self) -> Instant {
        self.fleet.world.now()
    }

    fn next_event(&self) -> Option<Instant> {
        self.fleet.world.next_event()
    }

    fn run_until(&self, at: Instant) {
        self.fleet.world.run_until(at);
    }

    fn count_traffic(&self) {
        let traffic = Arc::clone(&self.traffic);
        self.fleet.world.observe(move |record| {
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
        let of = |handle: &DriveHandle| {
            let is_cut = self.fleet.world.is_cut(handle.station());
            handle.with(|drive| MotorState::of(handle.motor(), drive, self.fleet.bit_rate, is_cut))
        };
        let motors = self.named(motor).map(of).collect();
        let traffic = self.traffic.lock().unwrap_or_else(PoisonError::into_inner);
        let traffic = Traffic { busy_us: traffic.busy_ns / 1_000, ..traffic.counted };
        let shared = self.fleet.shared_supply();
        let (supply, supply_voltage_v) =
            (shared.map(SharedSupply::supply), shared.map(SharedSupply::voltage_v));
        let (bus, bit_rate) = (self.fleet.name.clone(), self.fleet.bit_rate);
        let mechanics_failure = self.fleet.mechanics_failure();
        BusState { bus, bit_rate, traffic, supply, supply_voltage_v, mechanics_failure, motors }
    }

    fn set_cable(&self, motor: Option<MotorId>, is_cut: bool) {
        for drive in self.named(motor) {
            let station = drive.station();
            if is_cut { self.fleet.world.cut(station) } else { self.fleet.world.mend(station) }
        }
    }

    fn follow_wall_clock(&self) {
        self.fleet.world.clone().in_real_time();
    }

    fn report_rates(&self, notify: &mut dyn FnMut(Notice)) {
        let bus_rate = self.fleet.bit_rate;
        for drive in &self.fleet.drives {
            let own = drive.with(|drive| drive.bit_rate()).filter(|&own| own != bus_rate);
            if let Some(bit_rate) = own {
                let (bus, motor) = (self.fleet.name.clone(), drive.motor());
                notify(Notice::OwnRate { bus, motor, bit_rate, bus_rate });
            }
        }
    }

    fn plan(&self, fault: PlannedFault) {
        self.fleet.plan(fault);
        // What is due now does not wait until time goes on.
        self.fleet.world.run_until(self.fleet.world.now());
    }

    fn planned(&self) -> usize {
        self.fleet.world.planned()
    }

    fn poll_mechanics_failure(&mut self) -> Option<String> {
        if self.is_failure_told {
            return None;
        }
        let reason = self.fleet.mechanics_failure()?;
        self.is_failure_told = true;
        Some(reason)
    }

    fn poll_log(&mut self) -> Vec<LogRecord> {
        self.log.poll(self.fleet.world.now())
    }

    fn power_off(&self) -> Vec<MotorId> {
        let now = self.fleet.world.now();
        let fails = |drive: &&DriveHandle| {
            drive.with(|drive| {
                while drive.poll_event().is_some() {}
                drive.power_off(now);
                let mut events = std::iter::from_fn(|| drive.poll_event());
                events.any(|event| event == Event::MemoryFailed)
            })
        };
        self.fleet.drives.iter().filter(fails).map(DriveHandle::motor).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::Fleet;
    use crate::sim::mechanics::{Failure, Mechanics, Shaft};
    use myactuator_protocol_core::time;

    #[test]
    fn failure_of_the_mechanics_is_reported_once() {
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
        assert_eq!(host.state(None).mechanics_failure, None);
        fleet.world.run_for(time::Duration::from_millis(2));
        let said = [(); 2].map(|()| host.poll_mechanics_failure());
        assert_eq!(said, [Some("the engine has crashed".to_owned()), None]);
        let reported = [(); 2].map(|()| host.state(None).mechanics_failure);
        assert!(
            reported.iter().all(|it| it.as_deref() == Some("the engine has crashed")),
            "{reported:?}"
        );
    }
}
