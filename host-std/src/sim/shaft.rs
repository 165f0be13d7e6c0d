//! The place of a drive's shaft, in a file beside the drive's memory: the next process finds the joint where this one
//! has left it.

use std::path::PathBuf;

use myactuator_protocol_core::time::{Duration, Instant};

use super::memory::{self, StoreError};
use super::plant::ShaftPlace;

/// How often the place of a turning shaft is noted, in case the process is killed.
const INTERVAL: Duration = Duration::from_secs(1);

/// The file, and what it holds.
#[derive(Debug)]
pub(super) struct ShaftFile {
    path: PathBuf,
    kept: Option<ShaftPlace>,
    next: Instant,
}

impl ShaftFile {
    pub(super) fn open(path: PathBuf) -> Result<Self, StoreError> {
        let kept = memory::load(&path)?;
        Ok(Self { path, kept, next: Instant::ZERO })
    }

    /// Where the shaft was left; none before the first run.
    pub(super) fn kept(&self) -> Option<ShaftPlace> {
        self.kept
    }

    /// Notes the place of the shaft, but not too often.
    pub(super) fn follow(&mut self, place: ShaftPlace, now: Instant) {
        if now >= self.next {
            self.next = now + INTERVAL;
            self.keep(place);
        }
    }

    /// Notes the place of the shaft. If it cannot be written here, the settings of a drive could not be stored either,
    /// which is reported.
    pub(super) fn keep(&mut self, place: ShaftPlace) {
        if Some(place) != self.kept && memory::store_unflushed(&self.path, &place).is_ok() {
            self.kept = Some(place);
        }
    }
}
