//! One processor for emulator and simulation, and how long the machine kept it from them.
//!
//! They hand over to each other at each byte, and have to answer each other within a millisecond. A virtual machine
//! takes up to milliseconds to wake a processor that sleeps, so both share one, which a thread without any priority
//! keeps awake. The simulation needs microseconds at a time, and goes before the emulator.

use std::cell::Cell;
use std::collections::VecDeque;
use std::hint;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use rustix::thread::{CpuSet, gettid, sched_getaffinity, sched_setaffinity};

/// A thread that wakes this late was kept waiting by the machine.
const LATE: Duration = Duration::from_millis(1);
/// A thread that wakes this late may have cost a reply.
const TOO_LATE: Duration = Duration::from_millis(15);
/// Waits this close together add up: after this time without a motor's reply the application reports it as silent.
const TOGETHER: Duration = Duration::from_millis(100);
/// The waits that the firmware tolerates: the emulated boards report their bus as down if a port sends nothing for
/// longer.
const TOLERATED: Duration = Duration::from_millis(20);
/// A master repeats a command after this time without a reply. So a wait costs one reply for each of these time-outs,
/// and one for the rest.
pub(super) const REPLY_TIMEOUT: Duration = Duration::from_millis(25);

thread_local! {
    /// The longest wait in any [`Stalls`] that this thread has dropped.
    static LONGEST: Cell<Duration> = const { Cell::new(Duration::ZERO) };
}

/// Whether a test that failed has shown nothing about the firmware, because the machine kept threads waiting for up to
/// `longest` of a tenth of a second while it ran.
pub fn excuses_failure(longest: Duration) -> bool {
    longest > TOLERATED
}

/// The longest waits while this thread had firmware running, as [`Stalls::longest`]. Each test has a thread of its own.
pub fn longest_in_this_test() -> Duration {
    LONGEST.get()
}

/// The processor that emulator and simulation share.
pub(super) fn shared() -> usize {
    let ours = sched_getaffinity(None).unwrap_or_default();
    // Many systems handle interrupts on the first.
    (0..CpuSet::MAX_CPU).rfind(|&processor| ours.is_set(processor)).unwrap_or(0)
}

/// Moves this thread to the shared processor, with priority over all ordinary ones there, if the system allows it.
pub(super) fn take() {
    move_to_shared();
    // If it is not allowed, or `chrt` is missing, the tests need a machine that does nothing else.
    let _ = schedule(&["--reset-on-fork", "--rr"], "1");
}

fn move_to_shared() {
    let mut alone = CpuSet::new();
    alone.set(shared());
    // If this is not allowed, the thread runs anywhere.
    let _ = sched_setaffinity(None, &alone);
}

/// Whether `chrt` could set how this thread is scheduled.
fn schedule(policy: &[&str], priority: &str) -> bool {
    let set = Command::new("chrt")
        .args(policy)
        .args(["--pid", priority])
        .arg(gettid().as_raw_nonzero().to_string())
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status();
    set.is_ok_and(|status| status.success())
}

/// Keeps the shared processor awake, and measures how long the machine kept threads there waiting. Ends when it is
/// dropped.
#[derive(Debug)]
pub struct Stalls {
    found: Arc<Found>,
    threads: Vec<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Found {
    excused: AtomicUsize,
    longest_us: AtomicU64,
    is_over: AtomicBool,
}

impl Stalls {
    /// Starts measuring.
    pub(super) fn count() -> Self {
        let found = Arc::<Found>::default();
        let threads = [Found::observe, Found::keep_awake].map(|run| {
            let found = Arc::clone(&found);
            thread::spawn(move || run(&found))
        });
        Self { found, threads: threads.into() }
    }

    /// How many replies may have been late so far because of such waits.
    pub fn excused(&self) -> usize {
        self.found.excused.load(Ordering::Relaxed)
    }

    /// The longest waits within any tenth of a second so far.
    pub fn longest(&self) -> Duration {
        Duration::from_micros(self.found.longest_us.load(Ordering::Relaxed))
    }
}

impl Found {
    fn keep_awake(&self) {
        move_to_shared();
        // With any priority it would take time from those that it is there for.
        if !schedule(&["--idle"], "0") {
            return;
        }
        while !self.is_over.load(Ordering::Relaxed) {
            hint::spin_loop();
        }
    }

    fn observe(&self) {
        take();
        let pause = Duration::from_millis(1);
        let mut recent = Recent::default();
        while !self.is_over.load(Ordering::Relaxed) {
            let asleep = Instant::now();
            thread::sleep(pause);
            let late = asleep.elapsed().saturating_sub(pause);
            if late >= TOO_LATE {
                let replies = late.as_millis() / REPLY_TIMEOUT.as_millis() + 1;
                self.excused.fetch_add(replies as usize, Ordering::Relaxed);
            }
            if late >= LATE {
                let together = recent.add(Instant::now(), late);
                self.longest_us.fetch_max(together.as_micros() as u64, Ordering::Relaxed);
            }
        }
    }
}

/// The waits of the last tenth of a second, and when each was over.
#[derive(Debug, Default)]
struct Recent(VecDeque<(Instant, Duration)>);

impl Recent {
    /// Takes a wait that is over now. Returns how long all of them were.
    fn add(&mut self, now: Instant, wait: Duration) -> Duration {
        self.0.push_back((now, wait));
        while self.0.front().is_some_and(|&(over, _)| now - over > TOGETHER) {
            self.0.pop_front();
        }
        self.0.iter().map(|&(_, wait)| wait).sum()
    }
}

impl Drop for Stalls {
    fn drop(&mut self) {
        self.found.is_over.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // A panic there has been reported already.
            let _ = thread.join();
        }
        LONGEST.set(LONGEST.get().max(self.longest()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_within_a_tenth_of_a_second_add_up() {
        let (mut recent, start) = (Recent::default(), Instant::now());
        let waits = [(0, 8, 8), (16, 8, 16), (100, 3, 19), (101, 2, 13), (500, 15, 15)];
        for (over_ms, wait_ms, together_ms) in waits {
            let over = start + Duration::from_millis(over_ms);
            let together = recent.add(over, Duration::from_millis(wait_ms));
            assert_eq!(together, Duration::from_millis(together_ms), "{over_ms} ms");
        }
    }

    #[test]
    fn a_failure_counts_unless_the_machine_was_slower_than_the_firmware_tolerates() {
        for (longest_ms, is_excused) in [(0, false), (20, false), (21, true), (100, true)] {
            assert_eq!(
                excuses_failure(Duration::from_millis(longest_ms)),
                is_excused,
                "{longest_ms}"
            );
        }
    }
}
