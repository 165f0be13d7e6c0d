//! When planned faults strike, and what they do to a bus and its drives.

use std::sync::{Arc, Mutex};

use myactuator_protocol_core::command::ErrorFlags;
use myactuator_protocol_core::time::{Duration, Instant};

use super::bus::faults::{Babble, Direction};
use super::bus::{Kernel, Medium, StationId, lock};
use super::planned_fault::Chance;
use super::seat::Seat;
use super::{BusFleet, DriveHandle, FaultKind, PlannedFault};

/// How often conditions are checked.
const LOOK_EVERY: Duration = Duration::from_millis(1);
/// Both directions, for a fault that names none.
const DIRECTIONS: [Direction; 2] = [Direction::ToNodes, Direction::ToPorts];

impl<B: Medium> BusFleet<B> {
    /// Plans a fault of these drives; its time counts from now. A fault that is due at once strikes as soon as
    /// time goes on. If no drive has started with the id that it names, it strikes nothing.
    pub fn plan(&self, fault: PlannedFault) {
        let is_named = |it: &&DriveHandle| fault.motor.is_none_or(|motor| motor == it.motor());
        let named = self.drives.iter().filter(is_named);
        let named: Vec<_> = named.map(|it| (it.station(), Arc::clone(&it.seat))).collect();
        let add = |drives| {
            let strike = Strike { fault, drives };
            self.world.plan(fault.after, move |kernel, now| strike.look(kernel, now));
        };
        if fault.condition.is_some() {
            // Drives that share an id meet the condition separately.
            named.into_iter().for_each(|drive| add(vec![drive]));
        } else {
            add(named);
        }
    }
}

/// A fault that waits.
struct Strike {
    fault: PlannedFault,
    /// The drives that it strikes. No handles: these hold the world, which holds this.
    drives: Vec<(StationId, Arc<Mutex<Seat>>)>,
}

impl Strike {
    /// Strikes, or returns the time until the next check.
    fn look<B: Medium>(&self, kernel: &mut Kernel<B>, now: Instant) -> Option<Duration> {
        if self.waits(now) {
            return Some(LOOK_EVERY);
        }
        self.strike(kernel, now);
        None
    }

    /// Whether its condition is not met yet.
    fn waits(&self, now: Instant) -> bool {
        let Some(condition) = self.fault.condition else { return false };
        self.drives.iter().any(|(_, seat)| {
            let mut seat = lock(seat);
            seat.catch_up(now);
            !condition.is_met(&seat.drive)
        })
    }

    fn strike<B: Medium>(&self, kernel: &mut Kernel<B>, now: Instant) {
        if let FaultKind::Chance(chance) = self.fault.kind {
            return self.change_chance(kernel, chance);
        }
        for (station, seat) in &self.drives {
            let station = station.index();
            match self.fault.kind {
                FaultKind::Chance(_) => {}
                FaultKind::Babble(interval) => {
                    kernel.babble(station, Some(Babble { interval, frame: None }));
                }
                FaultKind::Slow(by) => kernel.slow_down(station, by),
                FaultKind::Cut => kernel.cut(station, true),
                FaultKind::Mend => {
                    kernel.cut(station, false);
                    kernel.slow_down(station, Duration::ZERO);
                    kernel.babble(station, None);
                }
                FaultKind::Reset => kernel.reset(station),
                FaultKind::Error(_) | FaultKind::Clear => {
                    let mut seat = lock(seat);
                    seat.catch_up(now);
                    if let FaultKind::Error(errors) = self.fault.kind {
                        seat.drive.raise_fault(errors);
                    } else {
                        seat.drive.clear_fault(ErrorFlags::all());
                    }
                    kernel.wake(station);
                }
            }
        }
    }

    /// Adds to what chance does, and keeps the rest.
    fn change_chance<B: Medium>(&self, kernel: &mut Kernel<B>, chance: Chance) {
        let PlannedFault { motor, direction, .. } = self.fault;
        let ways = direction.as_ref().map_or(&DIRECTIONS[..], std::slice::from_ref);
        for &way in ways {
            let mut change = |station| {
                kernel.around.injector.change(station, way, |plan| chance.add_to(plan));
            };
            match motor {
                None => change(None),
                Some(_) => self.drives.iter().for_each(|(it, _)| change(Some(it.index()))),
            }
        }
    }
}

#[cfg(test)]
mod tests;
