//! Where the shafts really were, and when they stood still.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use myactuator_host_std::sim::DriveHandle;
use myactuator_protocol_core::time::Instant;

use super::processor;

/// The interval of the samples.
const INTERVAL: Duration = Duration::from_millis(2);
/// A shaft that turns slower than this stands still, degrees per second. A held shaft oscillates within one step of its
/// encoder.
const STILL_DPS: f32 = 1.0;
/// The time over which a mean speed is taken. It includes several set-points, even where they are few.
const MEAN_OVER: Duration = Duration::from_millis(100);

/// The state of a drive at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// The time.
    pub at: Instant,
    /// True angle of the output shaft, degrees.
    pub angle_deg: f32,
    /// True speed of the motor's side of the gear, in the output's degrees per second. This is what a drive can stop.
    /// The output then still moves for a while within the backlash of the gear.
    pub motor_side_speed_dps: f32,
    /// Whether the drive's output is on.
    pub is_output_on: bool,
}

impl Sample {
    /// The state of a drive now.
    pub fn at(drive: &DriveHandle) -> Self {
        drive.with(|drive| Self {
            at: drive.clock(),
            angle_deg: drive.plant().output_angle_deg() as f32,
            motor_side_speed_dps: drive.plant().motor_side_speed_dps() as f32,
            is_output_on: drive.state().output_on,
        })
    }

    /// Whether the shaft stands still, except for the backlash.
    pub fn is_still(&self) -> bool {
        self.motor_side_speed_dps.abs() < STILL_DPS
    }
}

/// Samples all shafts until it is dropped.
#[derive(Debug)]
pub struct Truth {
    samples: Arc<Mutex<Vec<Vec<Sample>>>>,
    is_over: Arc<AtomicBool>,
    observer: Option<JoinHandle<()>>,
}

impl Truth {
    /// Starts sampling these drives.
    pub fn observe(drives: Vec<DriveHandle>) -> Self {
        let samples = Arc::new(Mutex::new(vec![Vec::new(); drives.len()]));
        let is_over = Arc::<AtomicBool>::default();
        let (all, until) = (Arc::clone(&samples), Arc::clone(&is_over));
        let observer = thread::spawn(move || {
            processor::take();
            while !until.load(Ordering::Relaxed) {
                {
                    let mut all = all.lock().unwrap_or_else(PoisonError::into_inner);
                    for (of_drive, drive) in all.iter_mut().zip(&drives) {
                        let sample = Sample::at(drive);
                        if of_drive.last().is_none_or(|last: &Sample| last.at < sample.at) {
                            of_drive.push(sample);
                        }
                    }
                }
                thread::sleep(INTERVAL);
            }
        });
        Self { samples, is_over, observer: Some(observer) }
    }

    /// The samples of each drive from `since` to `until`.
    pub fn between(&self, since: Instant, until: Instant) -> Vec<Vec<Sample>> {
        let all = self.samples.lock().unwrap_or_else(PoisonError::into_inner);
        let within = |sample: &&Sample| sample.at >= since && sample.at < until;
        all.iter().map(|samples| samples.iter().filter(within).copied().collect()).collect()
    }

    /// How long after `since` the last sample is in which each shaft moved, except for the backlash.
    ///
    /// # Panics
    /// If sampling has ended: then every shaft would seem to stand still.
    pub fn moved_for(&self, since: Instant) -> Vec<Duration> {
        self.check_observed();
        let all = self.between(since, Instant::from_micros(u64::MAX));
        let last = |samples: &Vec<Sample>| {
            let moving = samples.iter().rfind(|sample| !sample.is_still());
            moving.map_or(Duration::ZERO, |sample| (sample.at - since).into())
        };
        all.iter().map(last).collect()
    }

    /// The mean speed of each shaft in the last tenth of a second, degrees per second.
    ///
    /// # Panics
    /// If sampling has ended.
    pub fn mean_dps(&self) -> Vec<f32> {
        self.check_observed();
        let all = self.samples.lock().unwrap_or_else(PoisonError::into_inner);
        let mean = |samples: &Vec<Sample>| {
            let last = samples.last()?;
            let within = |sample: &&Sample| last.at - sample.at <= MEAN_OVER.into();
            let first = samples.iter().rev().take_while(within).last()?;
            let seconds = Duration::from(last.at - first.at).as_secs_f32();
            // One sample has no mean speed.
            (seconds > 0.0).then(|| (last.angle_deg - first.angle_deg) / seconds)
        };
        all.iter().map(|samples| mean(samples).unwrap_or(0.0)).collect()
    }

    fn check_observed(&self) {
        let is_observed = self.observer.as_ref().is_some_and(|observer| !observer.is_finished());
        assert!(is_observed, "the thread that samples the shafts has ended");
    }

    /// The smallest and the largest angle of each shaft from `since` to `until`, degrees.
    pub fn reached_deg(&self, since: Instant, until: Instant) -> Vec<(f32, f32)> {
        let all = self.between(since, until);
        let reached = |samples: &Vec<Sample>| {
            samples.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(least, most), sample| {
                (least.min(sample.angle_deg), most.max(sample.angle_deg))
            })
        };
        all.iter().map(reached).collect()
    }
}

impl Drop for Truth {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        if let Some(observer) = self.observer.take() {
            // A panic there has been reported already.
            let _ = observer.join();
        }
    }
}
