//! The RS485 line on a pseudo-terminal.

use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use embedded_io::{Read as _, ReadReady as _, Write as _, WriteReady as _};

use super::pty::Pty;
use super::{End, Notice, ServeError};
use crate::sim::LineFleet;
use crate::sim::bus::rs485::SerialPort;

/// So many chunks hold everything that a port keeps.
const MOST_CHUNKS: usize = 64;

/// An RS485 adapter: a serial port at one end, a transceiver on the simulated line at the other.
#[derive(Debug)]
pub(super) struct LineEnd {
    pty: Pty,
    port: SerialPort,
    /// The line's name.
    bus: String,
    /// The bit rate of the line, in bit/s.
    line_rate: u32,
    /// The bit rate of the transceiver.
    bit_rate: u32,
    /// Written by a program, and not yet taken by the transceiver.
    waiting: Vec<u8>,
}

impl LineEnd {
    pub(super) fn new(pty: Pty, port: SerialPort, fleet: &LineFleet) -> Self {
        let line_rate = fleet.bit_rate;
        let bus = fleet.name.clone();
        Self { pty, port, bus, line_rate, bit_rate: line_rate, waiting: Vec::new() }
    }

    /// Sets the transceiver to the rate that the program has set. Each change is reported once.
    fn follow_rate(&mut self, notify: &mut dyn FnMut(Notice)) -> Result<(), ServeError> {
        let Some(asked) = self.pty.bit_rate()?.filter(|&rate| rate != self.bit_rate) else {
            return Ok(());
        };
        self.bit_rate = asked;
        self.port.world().set_bit_rate(self.port.station(), asked);
        if asked != self.line_rate {
            let (bus, bit_rate) = (self.bus.clone(), self.line_rate);
            notify(Notice::WrongRate { bus, asked, bit_rate });
        }
        Ok(())
    }
}

impl End for LineEnd {
    fn source(&self) -> Option<BorrowedFd<'_>> {
        self.waiting.is_empty().then(|| self.pty.as_fd())
    }

    fn hold(&mut self) {
        self.pty.hold();
    }

    fn take_in(&mut self) -> Result<(), ServeError> {
        Ok(self.pty.take_in()?)
    }

    fn pump(&mut self, notify: &mut dyn FnMut(Notice)) -> Result<(), ServeError> {
        let mut chunk = [0; 256];
        self.pty.admit_all()?;
        self.follow_rate(notify)?;
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
        // What comes meanwhile waits for the next call: on a slow computer there would be no end of it.
        for _ in 0..MOST_CHUNKS {
            if !self.port.read_ready()? {
                break;
            }
            let length = self.port.read(&mut chunk)?;
            self.pty.write(chunk.get(..length).unwrap_or_default())?;
        }
        Ok(())
    }

    fn patience(&mut self) -> Option<Duration> {
        self.port.read_ready().unwrap_or(true).then_some(Duration::ZERO)
    }
}
