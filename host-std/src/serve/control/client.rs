//! A program at the control socket: its lines, and what it has not read yet.

use std::collections::VecDeque;
use std::io::{self, Read as _, Write as _};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixStream;

use rustix::event::{PollFd, PollFlags, Timespec, poll};

/// The longest line, bytes.
pub(super) const LONGEST_LINE: usize = 64 * 1024;
/// While a client has more than this to read, bytes, its requests are not read, and the log is left out for it.
const MOST_UNREAD: usize = 256 * 1024;

#[derive(Debug)]
pub(super) struct Client {
    stream: UnixStream,
    received: VecDeque<u8>,
    unread: VecDeque<u8>,
    state: State,
    /// If the log is reported, how many records were left out since the last one.
    pub(super) log: Option<u32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Talking,
    /// Its last request has no answer yet.
    Waiting,
    /// It sends nothing more, and gets the log until it has left.
    Listening,
    /// It sends nothing more, or nothing that makes sense. It still gets its answers.
    Leaving,
    Gone,
}

impl Client {
    pub(super) fn new(stream: UnixStream) -> io::Result<Self> {
        stream.set_nonblocking(true)?;
        let (received, unread) = (VecDeque::new(), VecDeque::new());
        Ok(Self { stream, received, unread, state: State::Talking, log: None })
    }

    pub(super) fn is_gone(&self) -> bool {
        self.state == State::Gone || (self.state == State::Leaving && self.unread.is_empty())
    }

    /// Notices if it has left while nothing is read from it: it waits for its answer, or only listens.
    pub(super) fn look(&mut self) {
        let mut end = [PollFd::new(&self.stream, PollFlags::empty())];
        let is_up = poll(&mut end, Some(&Timespec::default())).is_ok_and(|count| count > 0);
        if matches!(self.state, State::Waiting | State::Listening) && is_up {
            self.state = State::Gone;
        }
    }

    /// What to wait for.
    pub(super) fn source(&self) -> (BorrowedFd<'_>, PollFlags) {
        let mut flags = PollFlags::empty();
        if self.is_heard() && !self.has_line() {
            flags |= PollFlags::IN;
        }
        if !self.unread.is_empty() {
            flags |= PollFlags::OUT;
        }
        (self.stream.as_fd(), flags)
    }

    /// Whether its requests are read now.
    fn is_heard(&self) -> bool {
        self.state == State::Talking && self.unread.len() <= MOST_UNREAD
    }

    fn has_line(&self) -> bool {
        self.received.contains(&b'\n')
    }

    /// Whether [`next`](Self::next) has a line without waiting.
    pub(super) fn is_ready(&self) -> bool {
        self.is_heard() && self.has_line()
    }

    /// The next line, if one is complete. After it no line comes until it is [answered](Self::answer).
    pub(super) fn next(&mut self) -> Option<Result<Vec<u8>, String>> {
        if !self.is_heard() {
            return None;
        }
        if !self.has_line() {
            self.receive();
        }
        let Some(end) = self.received.iter().position(|&byte| byte == b'\n') else {
            if self.received.len() > LONGEST_LINE {
                self.received.clear();
                self.state = State::Leaving;
                return Some(Err(format!(
                    "expected a line of at most {LONGEST_LINE} bytes, found no end of one"
                )));
            }
            return None;
        };
        self.state = State::Waiting;
        let mut line: Vec<u8> = self.received.drain(..=end).collect();
        line.pop();
        Some(Ok(line))
    }

    fn receive(&mut self) {
        let mut chunk = [0; 4096];
        loop {
            match self.stream.read(&mut chunk) {
                Ok(0) => {
                    let is_told = self.log.is_some();
                    return self.state = if is_told { State::Listening } else { State::Leaving };
                }
                Ok(length) => self.received.extend(&chunk[..length]),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return,
                Err(_) => return self.state = State::Gone,
            }
            if self.has_line() || self.received.len() > LONGEST_LINE {
                return;
            }
        }
    }

    /// Answers its last request.
    pub(super) fn answer(&mut self, line: &str) {
        if self.state == State::Waiting {
            self.state = State::Talking;
        }
        self.send(line);
    }

    fn send(&mut self, line: &str) {
        self.unread.extend(line.bytes().chain([b'\n']));
        self.flush();
    }

    /// Reports a record of the log, unless it reads too slowly.
    pub(super) fn report_log(&mut self, line: &str) {
        let Some(left_out) = &mut self.log else { return };
        if self.unread.len() > MOST_UNREAD {
            *left_out = left_out.saturating_add(1);
            return;
        }
        self.send(line);
    }

    /// Says how many records were left out as soon as the client reads again: the next record may take long.
    fn report_left_out(&mut self) {
        if self.unread.len() <= MOST_UNREAD
            && let Some(left_out) = self.log.as_mut().map(std::mem::take).filter(|&it| it > 0)
        {
            self.send(&format!("{{\"left_out\":{left_out}}}"));
        }
    }

    /// Sends what there is room for.
    pub(super) fn flush(&mut self) {
        while !self.unread.is_empty() && self.state != State::Gone {
            match self.stream.write(self.unread.as_slices().0) {
                Ok(sent) => drop(self.unread.drain(..sent)),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => break,
                Err(_) => self.state = State::Gone,
            }
        }
        self.report_left_out();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair() -> (UnixStream, Client) {
        let (program, end) = UnixStream::pair().unwrap();
        (program, Client::new(end).unwrap())
    }

    #[test]
    fn client_lines_are_taken_one_by_one_after_each_answer() {
        let (mut program, mut client) = pair();
        program.write_all(b"one\ntwo\nthr").unwrap();
        assert_eq!(client.next(), Some(Ok(b"one".to_vec())));
        assert_eq!(client.next(), None);
        client.answer("1");
        assert!(client.is_ready());
        assert_eq!(client.next(), Some(Ok(b"two".to_vec())));
        client.answer("2");
        assert_eq!(client.next(), None);
        program.write_all(b"ee\n").unwrap();
        assert_eq!(client.next(), Some(Ok(b"three".to_vec())));
        client.answer("3");
        drop(program);
        assert_eq!((client.next(), client.is_gone()), (None, true));
    }

    #[test]
    fn client_that_only_listens_stays_until_it_disconnects() {
        let (program, mut client) = pair();
        client.log = Some(0);
        program.shutdown(std::net::Shutdown::Write).unwrap();
        assert_eq!((client.next(), client.is_gone()), (None, false));
        client.look();
        assert!(!client.is_gone());
        // Nothing is to be read from it, so that nobody is woken all the time.
        assert_eq!(client.source().1, PollFlags::empty());
        drop(program);
        client.look();
        assert!(client.is_gone());
    }

    #[test]
    fn a_line_without_end_is_the_last() {
        let (mut program, mut client) = pair();
        let writing = std::thread::spawn(move || {
            let _ = program.write_all(&[b' '; LONGEST_LINE + 4096]);
            program
        });
        let message = loop {
            if let Some(message) = client.next() {
                break message.unwrap_err();
            }
        };
        assert!(message.starts_with("expected a line of at most 65536 bytes"), "{message}");
        client.answer(&message);
        assert!(client.is_gone());
        drop(client);
        drop(writing.join().unwrap());
    }

    #[test]
    fn client_that_does_not_read_is_not_served_and_misses_the_log() {
        let (mut program, mut client) = pair();
        client.log = Some(0);
        let line = "x".repeat(1000);
        for _ in 0..2000 {
            client.report_log(&line);
        }
        let left_out = client.log.unwrap();
        assert!(left_out > 1000, "{left_out}");
        program.write_all(b"one\n").unwrap();
        assert_eq!((client.next(), client.is_ready()), (None, false));
        assert!((MOST_UNREAD..MOST_UNREAD + 2_000).contains(&client.unread.len()));
        let (mut read, mut got) = (vec![0; 1 << 20], Vec::new());
        while client.next().is_none() {
            let length = program.read(&mut read).unwrap();
            got.extend_from_slice(&read[..length]);
            client.flush();
        }
        client.answer("done");
        client.report_log("last");
        while !client.unread.is_empty() {
            let length = program.read(&mut read).unwrap();
            got.extend_from_slice(&read[..length]);
            client.flush();
        }
        drop(client);
        program.read_to_end(&mut got).unwrap();
        // Told although nothing else was to be told.
        let ends = format!("{line}\n{{\"left_out\":{left_out}}}\ndone\nlast\n");
        assert!(got.ends_with(ends.as_bytes()));
    }
}
