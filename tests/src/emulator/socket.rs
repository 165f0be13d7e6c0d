//! A socket that the emulator connects to.

use std::io::ErrorKind;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use super::Failure;

/// How long the emulator may take to start.
const TIMEOUT: Duration = Duration::from_secs(20);

/// A socket that waits for its connection.
#[derive(Debug)]
pub(super) struct Waiting(UnixListener);

impl Waiting {
    pub(super) fn at(path: &Path) -> Result<Self, Failure> {
        let listener = UnixListener::bind(path)?;
        listener.set_nonblocking(true)?;
        Ok(Self(listener))
    }

    /// Waits for the first connection and returns its stream. Gives up if the emulator has ended.
    pub(super) fn connect(self, is_running: impl Fn() -> bool) -> Result<UnixStream, Failure> {
        let start = Instant::now();
        while start.elapsed() < TIMEOUT && is_running() {
            match self.0.accept() {
                Ok((stream, _)) => {
                    stream.set_nonblocking(true)?;
                    return Ok(stream);
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    thread::sleep(Duration::from_millis(1));
                }
                Err(error) => return Err(error.into()),
            }
        }
        Err("the emulator has not connected to its socket".into())
    }
}
