//! Real-time scheduling, where the system grants it, and what happens where others want the processor.
//!
//! Emulator and simulation have to answer each other within a millisecond, and both are threads among
//! others.

use std::process::{self, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// A thread that wakes so late was kept waiting.
const LATE: Duration = Duration::from_millis(2);

/// Puts all threads of this process before all ordinary ones, if that is allowed. What it starts from
/// now on is ordinary.
pub(super) fn take() {
    let changed = Command::new("chrt")
        .args(["--all-tasks", "--reset-on-fork", "--rr", "--pid", "1"])
        .arg(process::id().to_string())
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status();
    // Not allowed, or no such program: then the tests need a machine that does nothing else.
    drop(changed);
}

/// Counts how often a thread of ordinary priority was kept waiting. Ends when it is dropped.
#[derive(Debug)]
pub struct Stalls {
    found: Arc<Found>,
    observer: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Found {
    count: AtomicUsize,
    longest: Mutex<Duration>,
    is_over: AtomicBool,
}

impl Stalls {
    /// Begins.
    pub(super) fn count() -> Self {
        let found = Arc::<Found>::default();
        let shared = Arc::clone(&found);
        let observer = thread::spawn(move || {
            let pause = Duration::from_millis(1);
            while !shared.is_over.load(Ordering::Relaxed) {
                let asleep = Instant::now();
                thread::sleep(pause);
                let late = asleep.elapsed().saturating_sub(pause);
                if late >= LATE {
                    shared.count.fetch_add(1, Ordering::Relaxed);
                    let mut longest = shared.longest.lock().unwrap_or_else(PoisonError::into_inner);
                    *longest = late.max(*longest);
                }
            }
        });
        Self { found, observer: Some(observer) }
    }

    /// How often so far.
    pub fn so_far(&self) -> usize {
        self.found.count.load(Ordering::Relaxed)
    }

    /// How long at the most.
    pub fn longest(&self) -> Duration {
        *self.found.longest.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Stalls {
    fn drop(&mut self) {
        self.found.is_over.store(true, Ordering::Relaxed);
        if let Some(observer) = self.observer.take() {
            // A panic there has been told already.
            let _ = observer.join();
        }
    }
}
