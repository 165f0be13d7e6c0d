//! Where a drive's shaft is, in a file beside the drive's memory: the next process finds the joint where this one
//! has left it.

use std::path::PathBuf;

use myactuator_protocol_core::time::{Duration, Instant};

use super::memory::{self, StoreError};

/// How often a shaft that turns is noted, for a process that is killed.
const INTERVAL: Duration = Duration::from_secs(1);

/// The file, and what it holds.
#[derive(Debug)]
pub(super) struct ShaftFile {
    path: PathBuf,
    kept_deg: Option<f64>,
    next: Instant,
}

impl ShaftFile {
    pub(super) fn open(path: PathBuf) -> Result<Self, StoreError> {
        let kept_deg = memory::load(&path)?;
        Ok(Self { path, kept_deg, next: Instant::ZERO })
    }

    /// The angle of the output shaft in this file; none before the first run.
    pub(super) fn kept_deg(&self) -> Option<f64> {
        self.kept_deg
    }

    /// Notes the angle now and then.
    pub(super) fn follow(&mut self, angle_deg: f64, now: Instant) {
        if now >= self.next {
            self.next = now + INTERVAL;
            self.keep(angle_deg);
        }
    }

    /// Notes the angle. Who cannot write it here could not keep a drive's settings either, which is told.
    pub(super) fn keep(&mut self, angle_deg: f64) {
        if Some(angle_deg) != self.kept_deg
            && memory::store_unflushed(&self.path, &angle_deg).is_ok()
        {
            self.kept_deg = Some(angle_deg);
        }
    }
}
