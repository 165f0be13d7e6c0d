//! The time of the host, and waiting for a bus.

use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use myactuator_protocol_core::io::Clock;
use myactuator_protocol_core::time::{Duration, Instant};
use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::time::{ClockId, clock_gettime};

/// The time since the machine started, including the time in which it was suspended. `std::time::Instant` leaves
/// that out, so that a command from before a suspension would count as fresh.
pub(crate) fn since_boot() -> std::time::Duration {
    // No time is negative here.
    clock_gettime(ClockId::Boottime).try_into().unwrap_or_default()
}

/// How long a wait for a port that has gone takes at least.
const REST: std::time::Duration = std::time::Duration::from_millis(1);

/// The host's monotonic clock, in microseconds since this value was made. It runs on while the machine is suspended.
///
/// It idles until something arrives at its port, by `ppoll` with a time-out in nanoseconds. (A socket's own receive
/// time-out is rounded to the kernel's ticks, which turns 1 ms into 4 ms.) It keeps the port open, so drop it with the
/// port.
#[derive(Debug)]
pub struct HostClock {
    /// Since the machine started.
    start: std::time::Duration,
    port: OwnedFd,
    backlog: Backlog,
    waker: Option<Arc<OwnedFd>>,
}

/// Ends the idling of a [`HostClock`] from any thread.
#[derive(Clone, Debug)]
pub struct HostWaker(Arc<OwnedFd>);

impl HostWaker {
    /// Ends the clock's idling. If it does not idle now, its next idling ends at once.
    pub fn wake(&self) {
        // It fails only after 2^64 calls.
        let _ = rustix::io::write(&self.0, &1_u64.to_ne_bytes());
    }
}

/// Whether a port has something to send for which there was no room. Port and clock share this, so
/// that the clock also wakes when the port can go on.
#[derive(Clone, Debug, Default)]
pub(super) struct Backlog(Arc<AtomicBool>);

impl Backlog {
    pub(super) fn set(&self, is_blocked: bool) {
        self.0.store(is_blocked, Ordering::Relaxed);
    }

    fn is_blocked(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

impl HostClock {
    /// A clock that idles until this socket or serial port can be read.
    ///
    /// # Errors
    /// What the operating system reports when it cannot duplicate the file descriptor.
    pub fn for_port(port: &impl AsFd) -> io::Result<Self> {
        Self::with_backlog(port, Backlog::default())
    }

    /// As [`for_port`](Self::for_port). While there is a backlog it also idles only until the port can be written.
    pub(super) fn with_backlog(port: &impl AsFd, backlog: Backlog) -> io::Result<Self> {
        let port = port.as_fd().try_clone_to_owned()?;
        Ok(Self { start: since_boot(), port, backlog, waker: None })
    }

    /// A handle that ends this clock's idling from another thread.
    ///
    /// # Errors
    /// What the operating system reports if it has no file descriptor left.
    pub fn waker(&mut self) -> io::Result<HostWaker> {
        if let Some(waker) = &self.waker {
            return Ok(HostWaker(Arc::clone(waker)));
        }
        let waker = Arc::new(eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?);
        self.waker = Some(Arc::clone(&waker));
        Ok(HostWaker(waker))
    }

    /// Waits for the port, and for the waker if there is one, for up to `span`.
    fn wait(&self, span: Duration) {
        let span = std::time::Duration::from(span);
        let Ok(timeout) = Timespec::try_from(span) else { return };
        let out = if self.backlog.is_blocked() { PollFlags::OUT } else { PollFlags::empty() };
        // Without a waker the port stands here twice.
        let waker = self.waker.as_deref().unwrap_or(&self.port);
        let mut fds =
            [PollFd::new(&self.port, PollFlags::IN | out), PollFd::new(waker, PollFlags::IN)];
        // A signal ends the wait early, so that a program soon sees what its handler noted. Any other
        // error is returned by the next use of the port.
        let _ = poll(&mut fds, Some(&timeout));
        let [port, woken] = fds.map(|fd| fd.revents());
        if let Some(waker) = &self.waker
            && !woken.is_empty()
        {
            let _ = rustix::io::read(waker, &mut [0; 8]);
        }
        // A port that has gone, or that has an error which was not read yet, ends each wait at once. Without a rest a
        // loop that goes on trying would take the whole processor.
        if port.intersects(PollFlags::HUP | PollFlags::ERR) {
            std::thread::sleep(span.min(REST));
        }
    }
}

impl Clock for HostClock {
    fn now(&self) -> Instant {
        Instant::ZERO + Duration::from(since_boot().saturating_sub(self.start))
    }

    fn idle(&self, until: Instant) {
        let left = until - self.now();
        if left > Duration::ZERO {
            self.wait(left);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use std::os::unix::net::UnixStream;

    const SOON: Duration = Duration::from_millis(2);
    /// Far longer than a test may take.
    const NEVER: Duration = Duration::from_secs(24 * 3600);

    #[test]
    fn clock_runs_on_and_idles_until_the_given_time() {
        let (end, _other) = UnixStream::pair().unwrap();
        let clock = HostClock::for_port(&end).unwrap();
        let until = clock.now() + SOON;
        // A signal may end one wait early.
        while clock.now() < until {
            clock.idle(until);
        }
        clock.idle(Instant::ZERO);
        assert!(clock.now() >= until);
    }

    #[test]
    fn idles_only_until_something_arrives() {
        let (end, mut other) = UnixStream::pair().unwrap();
        let clock = HostClock::for_port(&end).unwrap();
        other.write_all(&[1]).unwrap();
        for until in [clock.now() + NEVER, Instant::from_micros(u64::MAX)] {
            clock.idle(until);
        }
    }

    #[test]
    fn idles_only_until_it_is_woken() {
        let (end, _other) = UnixStream::pair().unwrap();
        let mut clock = HostClock::for_port(&end).unwrap();
        let waker = clock.waker().unwrap();
        // Before it idles, and from another thread.
        waker.wake();
        clock.idle(clock.now() + NEVER);
        let waking = std::thread::spawn({
            let waker = clock.waker().unwrap();
            move || waker.wake()
        });
        clock.idle(clock.now() + NEVER);
        waking.join().unwrap();
        // Once is once.
        let until = clock.now() + SOON;
        while clock.now() < until {
            clock.idle(until);
        }
        assert!(
            poll(&mut [PollFd::new(&waker.0, PollFlags::IN)], Some(&Timespec::default())) == Ok(0)
        );
    }

    #[test]
    fn idle_clock_of_a_port_that_is_gone_does_not_spin() {
        let (end, other) = UnixStream::pair().unwrap();
        drop(other);
        let mut clock = HostClock::for_port(&end).unwrap();
        for has_waker in [false, true] {
            let start = clock.now();
            for _ in 0..5 {
                clock.idle(start + NEVER);
            }
            assert!(clock.now() - start >= Duration::from_millis(5), "{has_waker}");
            clock.waker().unwrap();
        }
    }

    #[test]
    fn idle_clock_wakes_up_when_a_backlog_can_be_sent() {
        let (end, _other) = UnixStream::pair().unwrap();
        let backlog = Backlog::default();
        let clock = HostClock::with_backlog(&end, backlog.clone()).unwrap();
        backlog.set(true);
        clock.idle(clock.now() + NEVER);
    }
}
