//! What is still to go wrong, and when.

use myactuator_protocol_core::time::Duration;

use super::hosted::Hosted;
use crate::sim::PlannedFault;

/// How often conditions are looked at.
const LOOK_EVERY: Duration = Duration::from_millis(1);

/// Faults that wait for their time, or for a motor to come to something.
#[derive(Debug, Default)]
pub(super) struct Schedule {
    /// By time, and then as they were planned.
    waiting: Vec<Planned>,
}

#[derive(Debug)]
struct Planned {
    /// Time since serving began.
    at: Duration,
    /// On this bus only.
    bus: Option<String>,
    fault: PlannedFault,
}

impl Schedule {
    /// Plans a fault, its time counted from `now`, on this bus or on all.
    pub(super) fn add(&mut self, now: Duration, bus: Option<String>, fault: PlannedFault) {
        self.waiting.push(Planned { at: now + fault.after, bus, fault });
        self.waiting.sort_by_key(|planned| planned.at);
    }

    /// Lets go wrong what is due.
    pub(super) fn strike(&mut self, now: Duration, hosts: &mut [Box<dyn Hosted>]) {
        let due = self.waiting.partition_point(|planned| planned.at <= now);
        let waits = |planned: &Planned| !planned.strike(hosts);
        let still: Vec<_> = self.waiting.drain(..due).filter(waits).collect();
        self.waiting.splice(..0, still);
    }

    /// How long it still is until the next one.
    pub(super) fn until_next(&self, now: Duration) -> Option<Duration> {
        let until = |planned: &Planned| {
            let wait = planned.at - now;
            if planned.fault.condition.is_some() { wait.max(LOOK_EVERY) } else { wait }
        };
        self.waiting.iter().map(until).min()
    }
}

impl Planned {
    /// Lets it go wrong where its condition is met; whether there was such a place.
    fn strike(&self, hosts: &mut [Box<dyn Hosted>]) -> bool {
        let mut has_struck = self.fault.condition.is_none();
        for host in hosts.iter_mut() {
            let is_meant = self.bus.as_deref().is_none_or(|bus| bus == host.name());
            if is_meant && self.is_met(&**host) {
                host.strike(&self.fault);
                has_struck = true;
            }
        }
        has_struck
    }

    fn is_met(&self, host: &dyn Hosted) -> bool {
        let Some(condition) = self.fault.condition else { return true };
        let motor = self.fault.motor;
        let mut drives = host.drives().iter().filter(|drive| Some(drive.motor()) == motor);
        drives.any(|drive| drive.with(|drive| condition.is_met(drive)))
    }
}
