#![doc = include_str!("protocol.md")]

mod carry_out;
mod client;
mod request;
pub(super) mod state;

use std::fs;
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

use rustix::event::PollFlags;
use serde_json::{Value, json};

use super::claim::Claim;
use crate::sim::LogRecord;

pub(super) use carry_out::Scene;
use client::Client;
pub(super) use request::Request;

/// So many programs may use the socket at the same time; more wait until one leaves.
const MOST_CLIENTS: usize = 64;

/// The socket, and the programs at it.
#[derive(Debug)]
pub(super) struct Control {
    listener: UnixListener,
    path: PathBuf,
    /// Device and inode of the socket's file.
    file: (u64, u64),
    /// Keeps two simulations that start at the same time from both replacing what a killed one has left.
    _claim: Claim,
    clients: Vec<Numbered>,
    next_number: u64,
}

#[derive(Debug)]
struct Numbered {
    number: u64,
    client: Client,
}

impl Control {
    /// Opens a socket at this path. One that a killed simulation has left there is replaced.
    ///
    /// # Errors
    /// A sentence; also if another simulation has the socket.
    pub(super) fn open(path: &Path) -> Result<Self, String> {
        let told = |error: io::Error| {
            format!("the control socket {} cannot be made: {error}", path.display())
        };
        let another = || {
            let path = path.display();
            format!(
                "another simulation has the control socket {path}: end it, or take another path"
            )
        };
        let claim = Claim::on(path).map_err(told)?.ok_or_else(another)?;
        if let Ok(found) = fs::symlink_metadata(path) {
            if !found.file_type().is_socket() {
                return Err(told(io::Error::other("something that is no socket has this name")));
            }
            match UnixStream::connect(path) {
                // Nothing listens: it was left.
                Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {}
                Err(error) => return Err(told(error)),
                Ok(_) => return Err(another()),
            }
            fs::remove_file(path).map_err(told)?;
        }
        let listener = UnixListener::bind(path).map_err(told)?;
        listener.set_nonblocking(true).map_err(told)?;
        let made = fs::symlink_metadata(path).map_err(told)?;
        let file = (made.dev(), made.ino());
        let (path, clients) = (path.to_owned(), Vec::new());
        Ok(Self { listener, path, file, _claim: claim, clients, next_number: 0 })
    }

    /// What to wait for.
    pub(super) fn sources(&self) -> impl Iterator<Item = (BorrowedFd<'_>, PollFlags)> {
        let has_room = self.clients.len() < MOST_CLIENTS;
        let listener = has_room.then_some((self.listener.as_fd(), PollFlags::IN));
        listener.into_iter().chain(self.clients.iter().map(|it| it.client.source()))
    }

    /// Whether a request is there already.
    pub(super) fn is_ready(&self) -> bool {
        self.clients.iter().any(|it| it.client.is_ready())
    }

    /// Lets new programs in, and removes those that have left.
    pub(super) fn admit(&mut self) {
        for it in &mut self.clients {
            it.client.flush();
            it.client.look();
        }
        self.clients.retain(|it| !it.client.is_gone());
        while self.clients.len() < MOST_CLIENTS
            && let Ok((stream, _)) = self.listener.accept()
        {
            // A program that cannot be read from has left.
            if let Ok(client) = Client::new(stream) {
                self.clients.push(Numbered { number: self.next_number, client });
                self.next_number += 1;
            }
        }
    }

    /// The next request of each program, with the program's number. Each needs an [answer](Self::answer).
    pub(super) fn next_requests(&mut self) -> Vec<(u64, Result<Request, String>)> {
        let next = |Numbered { number, client }: &mut Numbered| {
            let line = client.next()?;
            Some((*number, line.and_then(|line| Request::parse(&line))))
        };
        self.clients.iter_mut().filter_map(next).collect()
    }

    /// Whether the program with this number is still there.
    pub(super) fn has(&self, number: u64) -> bool {
        self.clients.iter().any(|it| it.number == number)
    }

    /// Answers the program with this number, if it is still there.
    pub(super) fn answer(&mut self, number: u64, done: Result<Value, String>) {
        let line = match done {
            Ok(answer) => json!({ "ok": answer }),
            Err(sentence) => json!({ "error": sentence }),
        };
        if let Some(client) = self.client(number) {
            client.answer(&line.to_string());
        }
    }

    /// Reports the log to this program from now on.
    pub(super) fn report_log_to(&mut self, number: u64) {
        if let Some(client) = self.client(number) {
            client.log = Some(0);
        }
    }

    fn client(&mut self, number: u64) -> Option<&mut Client> {
        self.clients.iter_mut().find(|it| it.number == number).map(|it| &mut it.client)
    }

    /// Reports a record to the programs that have asked for the log.
    pub(super) fn report(&mut self, record: &LogRecord) {
        let mut line = None;
        for it in self.clients.iter_mut().filter(|it| it.client.log.is_some()) {
            it.client.report_log(line.get_or_insert_with(|| log_line(record)));
        }
    }
}

impl Drop for Control {
    fn drop(&mut self) {
        // Another simulation may have put its own socket there.
        let found = fs::symlink_metadata(&self.path).map(|found| (found.dev(), found.ino()));
        if found.is_ok_and(|found| found == self.file) {
            let _ = fs::remove_file(&self.path);
        }
    }
}

fn log_line(record: &LogRecord) -> String {
    let mut object = json!(record);
    object["text"] = json!(record.to_string());
    json!({ "log": object }).to_string()
}

#[cfg(test)]
mod tests;
