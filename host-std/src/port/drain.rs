//! Waiting until all bytes have left a port, with a time-out.

use std::io;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

use rustix::io::Errno;

/// A thread that waits until the last byte has left a port. That system call has no time-out: if an adapter takes
/// nothing more, and its driver does not throw away what it holds, it never returns.
#[derive(Debug)]
pub(super) struct Drain<P> {
    ports: SyncSender<P>,
    outcomes: Receiver<Result<(), Errno>>,
    /// The thread waits, or its outcome was not taken yet.
    is_under_way: bool,
}

impl<P: Send + 'static> Drain<P> {
    /// A thread that waits with this function. It has the scheduling of the thread that calls this.
    pub(super) fn new(wait: impl Fn(&P) -> Result<(), Errno> + Send + 'static) -> io::Result<Self> {
        let (ports, asked) = sync_channel::<P>(1);
        let (answer, outcomes) = sync_channel(1);
        thread::Builder::new().name("myactuator-drain".to_owned()).spawn(move || {
            for port in asked {
                let outcome = wait(&port);
                // After the outcome the caller may close the port for good.
                drop(port);
                let _ = answer.send(outcome);
            }
        })?;
        Ok(Self { ports, outcomes, is_under_way: false })
    }

    /// Whether everything has left this port within `longest`. If not, the thread goes on waiting.
    pub(super) fn wait(&mut self, port: P, longest: Duration) -> Result<bool, Errno> {
        if self.is_over() {
            self.is_under_way = self.ports.send(port).is_ok();
        }
        let Ok(outcome) = self.outcomes.recv_timeout(longest) else { return Ok(false) };
        self.is_under_way = false;
        outcome.map(|()| true)
    }

    /// Whether the thread waits for nothing. After a wait that was given up it may still wait.
    pub(super) fn is_over(&mut self) -> bool {
        self.is_under_way = self.is_under_way && self.outcomes.try_recv().is_err();
        !self.is_under_way
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOON: Duration = Duration::from_millis(5);
    /// Long enough for any machine.
    const LONG: Duration = Duration::from_secs(10);

    /// Ends when what is waited for is dropped or sent.
    fn drain() -> Drain<Receiver<Result<(), Errno>>> {
        Drain::new(|left: &Receiver<_>| left.recv().unwrap_or(Ok(()))).unwrap()
    }

    /// What has left already.
    fn gone() -> Receiver<Result<(), Errno>> {
        let (_, left) = sync_channel(1);
        left
    }

    #[test]
    fn wait_after_one_that_was_given_up_is_for_the_same_bytes() {
        let mut drain = drain();
        assert!(drain.is_over());
        let (leave, left) = sync_channel(1);
        assert_eq!(drain.wait(left, SOON), Ok(false));
        assert!(!drain.is_over());
        // This one would end at once.
        assert_eq!(drain.wait(gone(), SOON), Ok(false));
        drop(leave);
        assert_eq!(drain.wait(gone(), LONG), Ok(true));
        assert!(drain.is_over());
        let (_leave, left) = sync_channel(1);
        assert_eq!(drain.wait(left, SOON), Ok(false), "one outcome a wait");
    }

    #[test]
    fn failure_of_the_port_ends_a_wait_with_its_error() {
        let (leave, left) = sync_channel(1);
        leave.send(Err(Errno::IO)).unwrap();
        let mut drain = drain();
        assert_eq!(drain.wait(left, LONG), Err(Errno::IO));
        assert_eq!(drain.wait(gone(), LONG), Ok(true));
    }
}
