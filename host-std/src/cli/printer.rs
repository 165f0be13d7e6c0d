//! Output is written by threads of its own. A halted terminal (Ctrl-S), or a pipe that nobody reads, never blocks a
//! program that runs a motor.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Write};
use std::os::fd::AsFd;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// How many pieces may wait before progress is dropped.
const ROOM: usize = 16;
/// How often to check whether to stop waiting for the reader.
const LOOK_EVERY: Duration = Duration::from_millis(10);

/// The standard output, and the standard error.
pub(super) static OUT: Printer = Printer::new(|| io::stdout().as_fd().try_clone_to_owned());
pub(super) static ERR: Printer = Printer::new(|| io::stderr().as_fd().try_clone_to_owned());

type Open = fn() -> io::Result<std::os::fd::OwnedFd>;

/// A stream that is written by a thread.
pub(super) struct Printer {
    open: Open,
    state: Mutex<State>,
    changed: Condvar,
}

struct State {
    /// Pieces that are not written yet; the first is being written.
    waiting: VecDeque<Vec<u8>>,
    has_thread: bool,
    /// Why no more can be written.
    failed: Option<(io::ErrorKind, String)>,
}

impl Printer {
    const fn new(open: Open) -> Self {
        let state = State { waiting: VecDeque::new(), has_thread: false, failed: None };
        Self { open, state: Mutex::new(state), changed: Condvar::new() }
    }

    /// Prints this in order, and does not wait for it.
    ///
    /// # Errors
    /// What kept something before it from being written.
    pub(super) fn print(&'static self, text: impl Into<Vec<u8>>) -> io::Result<()> {
        self.offer(text, usize::MAX).map(|_| ())
    }

    /// The same for output that may be dropped if the reader is slow.
    pub(super) fn show(&'static self, text: impl Into<Vec<u8>>) -> io::Result<()> {
        self.offer(text, ROOM).map(|_| ())
    }

    /// Prints this unless `room` pieces wait already. Returns whether it does.
    ///
    /// # Errors
    /// What kept something before it from being written.
    pub(super) fn offer(&'static self, text: impl Into<Vec<u8>>, room: usize) -> io::Result<bool> {
        let mut state = self.state();
        state.check()?;
        if state.waiting.len() >= room {
            return Ok(false);
        }
        if !state.has_thread {
            thread::Builder::new().spawn(|| self.write_all())?;
            state.has_thread = true;
        }
        state.waiting.push_back(text.into());
        self.changed.notify_all();
        Ok(true)
    }

    /// Waits until all is written, or until `gives_up`. Returns whether all is written.
    ///
    /// # Errors
    /// What kept it from being written.
    pub(super) fn wait(&self, gives_up: impl Fn() -> bool) -> io::Result<bool> {
        let mut state = self.state();
        while !state.waiting.is_empty() {
            if gives_up() {
                return Ok(false);
            }
            let waited = self.changed.wait_timeout(state, LOOK_EVERY);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        state.check().map(|()| true)
    }

    /// The same, for at most this time.
    pub(super) fn wait_for(&self, longest: Duration) -> io::Result<bool> {
        let start = Instant::now();
        self.wait(|| start.elapsed() >= longest)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The work of the thread, until something cannot be written.
    fn write_all(&self) {
        let error = self.write_each().unwrap_err();
        let mut state = self.state();
        state.waiting.clear();
        state.failed = Some((error.kind(), error.to_string()));
        self.changed.notify_all();
    }

    fn write_each(&self) -> io::Result<std::convert::Infallible> {
        let mut stream = File::from((self.open)()?);
        let mut state = self.state();
        loop {
            let Some(first) = state.waiting.front().cloned() else {
                state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
                continue;
            };
            drop(state);
            stream.write_all(&first)?;
            state = self.state();
            state.waiting.pop_front();
            self.changed.notify_all();
        }
    }
}

impl State {
    fn check(&self) -> io::Result<()> {
        match &self.failed {
            Some((kind, told)) => Err(io::Error::new(*kind, told.clone())),
            None => Ok(()),
        }
    }
}
