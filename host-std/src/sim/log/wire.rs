//! What happens to drives on their wire, counted until it is polled.

use std::sync::{Arc, Mutex};

use myactuator_protocol_core::time::Instant;

use super::event::{FrameFault, LogEvent};
use crate::sim::bus::trace::{Event, Record};
use crate::sim::bus::{Medium, StationId, lock};
use crate::sim::{BusFleet, DriveHandle};

/// What has happened since it was last taken.
#[derive(Clone, Debug)]
pub(super) struct WireLog(Arc<Mutex<Vec<Wired>>>);

/// A drive on its wire.
#[derive(Debug)]
struct Wired {
    station: StationId,
    is_cut: bool,
    slow_by_us: u64,
    babbles: bool,
    counted: Vec<Counted>,
}

/// Events of one kind. There are few kinds, so nothing is lost, however late they are taken. Events that
/// last are reported one by one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Counted {
    /// When the first of them came.
    pub(super) at: Instant,
    pub(super) event: LogEvent,
    pub(super) count: u32,
}

impl Wired {
    /// Notes an event that lasts; returns whether it changes anything.
    fn changes_by(&mut self, event: LogEvent) -> bool {
        match event {
            LogEvent::CableCut => !std::mem::replace(&mut self.is_cut, true),
            LogEvent::CableMended => std::mem::replace(&mut self.is_cut, false),
            LogEvent::Slowed(by_us) => std::mem::replace(&mut self.slow_by_us, by_us) != by_us,
            LogEvent::Babbles(it) => std::mem::replace(&mut self.babbles, it) != it,
            _ => true,
        }
    }
}

impl WireLog {
    /// Watches a bus from now on, until this is gone.
    pub(super) fn of<B: Medium>(fleet: &BusFleet<B>) -> Self {
        let wired = |drive: &DriveHandle| Wired {
            station: drive.station(),
            is_cut: fleet.world.is_cut(drive.station()),
            slow_by_us: 0,
            babbles: false,
            counted: Vec::new(),
        };
        let drives = Arc::new(Mutex::new(fleet.drives.iter().map(wired).collect::<Vec<_>>()));
        let watched = Arc::downgrade(&drives);
        fleet.world.observe(move |record| {
            if let Some(drives) = watched.upgrade() {
                note(&mut lock(&drives), record);
            }
        });
        Self(drives)
    }

    /// What has come to the drive in this place, by time.
    pub(super) fn take(&self, place: usize) -> Vec<Counted> {
        std::mem::take(&mut lock(&self.0)[place].counted)
    }
}

fn note<F>(drives: &mut [Wired], record: &Record<F>) {
    let place = |station| drives.iter().position(|drive| drive.station == station);
    let (place, event) = match record.event {
        Event::Cut => (place(record.station), LogEvent::CableCut),
        Event::Mended => (place(record.station), LogEvent::CableMended),
        Event::Slowed(by_ns) => (place(record.station), LogEvent::Slowed(by_ns / 1_000)),
        Event::Babbles(babbles) => (place(record.station), LogEvent::Babbles(babbles)),
        Event::Broken { .. } => {
            (place(record.station), LogEvent::FrameFromDrive(FrameFault::Broken))
        }
        Event::Faulted { from, fault } => match (place(from), place(record.station)) {
            // Frames between drives mean nothing.
            (Some(_), Some(_)) => return,
            (Some(sender), None) => (Some(sender), LogEvent::FrameFromDrive(fault.into())),
            (None, receiver) => (receiver, LogEvent::FrameToDrive(fault.into())),
        },
        _ => return,
    };
    let Some(drive) = place.map(|place| &mut drives[place]) else { return };
    if !drive.changes_by(event) {
        return;
    }
    let alike = |counted: &&mut Counted| counted.event == event && !event.is_lasting();
    match drive.counted.iter_mut().find(alike) {
        Some(counted) => counted.count = counted.count.saturating_add(1),
        None => drive.counted.push(Counted { at: record.at(), event, count: 1 }),
    }
}
