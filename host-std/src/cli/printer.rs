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

#[cfg(test)]
mod tests {
    use std::io::Read as _;

    use super::*;

    /// Longer than a busy machine takes.
    const LONG: Duration = Duration::from_secs(60);

    /// Nobody reads it any more.
    fn broken() -> io::Result<std::os::fd::OwnedFd> {
        let (_reader, writer) = io::pipe()?;
        Ok(writer.into())
    }

    fn missing() -> io::Result<std::os::fd::OwnedFd> {
        Err(io::ErrorKind::NotFound.into())
    }

    /// What waits behind a piece that cannot be written waits for nothing.
    #[test]
    fn stream_that_cannot_be_written_fails_from_then_on() {
        static BROKEN: Printer = Printer::new(broken);
        static MISSING: Printer = Printer::new(missing);
        for (stream, kind) in
            [(&BROKEN, io::ErrorKind::BrokenPipe), (&MISSING, io::ErrorKind::NotFound)]
        {
            let state = stream.state();
            assert_eq!(state.failed, None);
            drop(state);
            stream.print("lost").unwrap();
            // The thread may have failed by now.
            let _ = stream.show("lost, too");
            for _ in 0..2 {
                assert_eq!(stream.wait_for(LONG).unwrap_err().kind(), kind);
                assert_eq!(stream.print("lost").unwrap_err().kind(), kind);
                assert_eq!(stream.show("lost").unwrap_err().kind(), kind);
            }
        }
    }

    /// The reader of what the test below prints.
    static READER: Mutex<Option<io::PipeReader>> = Mutex::new(None);

    fn unread() -> io::Result<std::os::fd::OwnedFd> {
        let (reader, writer) = io::pipe()?;
        *READER.lock().unwrap() = Some(reader);
        Ok(writer.into())
    }

    #[test]
    fn only_progress_is_dropped_while_nobody_reads() {
        static UNREAD: Printer = Printer::new(unread);
        // More than a pipe takes.
        const FIRST: usize = 1 << 20;
        UNREAD.print(vec![b'.'; FIRST]).unwrap();
        let taken = (1..=ROOM).map(|_| UNREAD.offer("p", ROOM).unwrap());
        assert_eq!(taken.filter(|&is_taken| is_taken).count(), ROOM - 1);
        UNREAD.print("result").unwrap();
        assert!(!UNREAD.offer("p", ROOM).unwrap());
        // Nobody waits for ever.
        assert!(!UNREAD.wait_for(Duration::ZERO).unwrap());
        assert!(!UNREAD.wait(|| true).unwrap());
        let reader = || READER.lock().unwrap().take();
        let mut reader = std::iter::repeat_with(reader).find_map(|reader| reader).unwrap();
        let mut told = vec![0; FIRST + ROOM - 1 + "result".len()];
        reader.read_exact(&mut told).unwrap();
        let end = [vec![b'p'; ROOM - 1], b"result".to_vec()].concat();
        assert!(told.ends_with(&end));
        assert!(UNREAD.wait_for(LONG).unwrap());
    }
}
