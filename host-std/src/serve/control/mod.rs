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

/// So many programs may be there at once; more wait until one leaves.
const MOST_CLIENTS: usize = 64;

/// The socket, and the programs at it.
#[derive(Debug)]
pub(super) struct Control {
    listener: UnixListener,
    path: PathBuf,
    /// Device and inode of the socket's file.
    file: (u64, u64),
    /// So that two that start at once do not both replace what a killed one has left.
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
    /// A socket at this path, in place of one that a simulation has left there when it was killed.
    ///
    /// # Errors
    /// A sentence; also if another simulation has it.
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
                // Nobody listens: it was left.
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

    /// Whether somebody has asked something already.
    pub(super) fn is_ready(&self) -> bool {
        self.clients.iter().any(|it| it.client.is_ready())
    }

    /// Lets new programs in and sees off those that have left.
    pub(super) fn admit(&mut self) {
        for it in &mut self.clients {
            it.client.flush();
            it.client.look();
        }
        self.clients.retain(|it| !it.client.is_gone());
        while self.clients.len() < MOST_CLIENTS
            && let Ok((stream, _)) = self.listener.accept()
        {
            // One that cannot be read has left.
            if let Ok(client) = Client::new(stream) {
                self.clients.push(Numbered { number: self.next_number, client });
                self.next_number += 1;
            }
        }
    }

    /// What programs ask next, each one thing, with the program's number. All want an
    /// [answer](Self::answer).
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

    /// Reports to those who want to know.
    pub(super) fn report(&mut self, record: &LogRecord) {
        let mut line = None;
        for it in self.clients.iter_mut().filter(|it| it.client.log.is_some()) {
            it.client.report_log(line.get_or_insert_with(|| log_line(record)));
        }
    }
}

impl Drop for Control {
    fn drop(&mut self) {
        // Another may have put its own there.
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
