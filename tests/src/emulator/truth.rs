//! Where the shafts really were, and when they stood still.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use myactuator_host_std::sim::DriveHandle;
use myactuator_protocol_core::time::Instant;

use super::urgency;

/// How often the shafts are looked at.
const INTERVAL: Duration = Duration::from_millis(2);
/// A shaft that turns slower than this stands still, degrees per second: a held shaft trembles within
/// the last step of its encoder.
const STILL_DPS: f32 = 1.0;
/// The span of a mean speed: some set-points, even where they are few.
const MEAN_OVER: Duration = Duration::from_millis(100);

/// A drive at a moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// When.
    pub at: Instant,
    /// True angle of the output shaft, degrees.
    pub angle_deg: f32,
    /// True speed of the motor's side of the gear, in the output's degrees per second: what a drive can stop. After
    /// that the output still crosses the gear's play for a while.
    pub motor_side_speed_dps: f32,
    /// Whether the drive's output is on.
    pub is_output_on: bool,
}

impl Look {
    /// At a drive, now.
    pub fn at(drive: &DriveHandle) -> Self {
        drive.with(|drive| Self {
            at: drive.clock(),
            angle_deg: drive.plant().output_angle_deg() as f32,
            motor_side_speed_dps: drive.plant().motor_side_speed_dps() as f32,
            is_output_on: drive.state().output_on,
        })
    }

    /// Whether the shaft stands still, except for the gear's play.
    pub fn is_still(&self) -> bool {
        self.motor_side_speed_dps.abs() < STILL_DPS
    }
}

/// Watches all shafts until it is dropped.
#[derive(Debug)]
pub struct Truth {
    looks: Arc<Mutex<Vec<Vec<Look>>>>,
    is_over: Arc<AtomicBool>,
    observer: Option<JoinHandle<()>>,
}

impl Truth {
    /// Begins.
    pub fn observe(drives: Vec<DriveHandle>) -> Self {
        let looks = Arc::new(Mutex::new(vec![Vec::new(); drives.len()]));
        let is_over = Arc::<AtomicBool>::default();
        let (all, until) = (Arc::clone(&looks), Arc::clone(&is_over));
        let observer = thread::spawn(move || {
            urgency::take();
            while !until.load(Ordering::Relaxed) {
                {
                    let mut all = all.lock().unwrap_or_else(PoisonError::into_inner);
                    for (of_drive, drive) in all.iter_mut().zip(&drives) {
                        let look = Look::at(drive);
                        if of_drive.last().is_none_or(|last: &Look| last.at < look.at) {
                            of_drive.push(look);
                        }
                    }
                }
                thread::sleep(INTERVAL);
            }
        });
        Self { looks, is_over, observer: Some(observer) }
    }

    /// What was seen of each drive from `since` to `until`.
    pub fn between(&self, since: Instant, until: Instant) -> Vec<Vec<Look>> {
        let all = self.looks.lock().unwrap_or_else(PoisonError::into_inner);
        let within = |look: &&Look| look.at >= since && look.at < until;
        all.iter().map(|looks| looks.iter().filter(within).copied().collect()).collect()
    }

    /// How long after `since` each shaft still moved, except for the gear's play, as far as seen.
    ///
    /// # Panics
    /// If the watching has ended: then nothing would ever have moved.
    pub fn moved_for(&self, since: Instant) -> Vec<Duration> {
        self.check_observed();
        let all = self.between(since, Instant::from_micros(u64::MAX));
        let last = |looks: &Vec<Look>| {
            let moving = looks.iter().rfind(|look| !look.is_still());
            moving.map_or(Duration::ZERO, |look| (look.at - since).into())
        };
        all.iter().map(last).collect()
    }

    /// How fast each shaft was in the last tenth of a second, degrees per second, as a mean.
    ///
    /// # Panics
    /// If the watching has ended.
    pub fn mean_dps(&self) -> Vec<f32> {
        self.check_observed();
        let all = self.looks.lock().unwrap_or_else(PoisonError::into_inner);
        let mean = |looks: &Vec<Look>| {
            let last = looks.last()?;
            let within = |look: &&Look| last.at - look.at <= MEAN_OVER.into();
            let first = looks.iter().rev().take_while(within).last()?;
            let seconds = Duration::from(last.at - first.at).as_secs_f32();
            // Nothing yet if there was only one look.
            (seconds > 0.0).then(|| (last.angle_deg - first.angle_deg) / seconds)
        };
        all.iter().map(|looks| mean(looks).unwrap_or(0.0)).collect()
    }

    fn check_observed(&self) {
        let is_observed = self.observer.as_ref().is_some_and(|observer| !observer.is_finished());
        assert!(is_observed, "nobody looks at the shafts any more");
    }

    /// The smallest and the largest angle of each shaft from `since` to `until`, degrees.
    pub fn reached_deg(&self, since: Instant, until: Instant) -> Vec<(f32, f32)> {
        let all = self.between(since, until);
        let reached = |looks: &Vec<Look>| {
            looks.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(least, most), look| {
                (least.min(look.angle_deg), most.max(look.angle_deg))
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
