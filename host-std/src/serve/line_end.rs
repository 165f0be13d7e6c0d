//! The RS485 line on a pseudo-terminal.

use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use embedded_io::{Read as _, ReadReady as _, Write as _, WriteReady as _};

use super::pty::Pty;
use super::{End, Notice, ServeError};
use crate::sim::bus::rs485::SerialPort;

/// An RS485 adapter: a serial port at one end, a transceiver on the simulated line at the other.
#[derive(Debug)]
pub(super) struct LineEnd {
    pub(super) pty: Pty,
    pub(super) port: SerialPort,
    /// Written by a program, and not yet taken by the transceiver.
    pub(super) waiting: Vec<u8>,
}

impl End for LineEnd {
    fn source(&self) -> Option<BorrowedFd<'_>> {
        self.waiting.is_empty().then(|| self.pty.as_fd())
    }

    fn pump(&mut self, _: &mut dyn FnMut(Notice)) -> Result<(), ServeError> {
        let mut chunk = [0; 256];
        self.pty.admit_all()?;
        loop {
            while !self.waiting.is_empty() && self.port.write_ready()? {
                let taken = self.port.write(&self.waiting)?;
                self.waiting.drain(..taken.min(self.waiting.len()));
            }
            if !self.waiting.is_empty() {
                break;
            }
            let length = self.pty.read(&mut chunk)?;
            if length == 0 {
                break;
            }
            self.waiting.extend(chunk.iter().take(length));
        }
        while self.port.read_ready()? {
            let length = self.port.read(&mut chunk)?;
            self.pty.write(chunk.get(..length).unwrap_or_default())?;
        }
        Ok(())
    }

    fn patience(&mut self) -> Option<Duration> {
        self.port.read_ready().unwrap_or(true).then_some(Duration::ZERO)
    }
}
