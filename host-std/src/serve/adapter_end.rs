//! The CAN bus behind an SLCAN adapter on a pseudo-terminal.

use std::collections::VecDeque;
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use embedded_can::nb::Can as _;
use myactuator_protocol_core::wire::can::SimpleFrame;

use super::adapter::{Adapter, Outcome};
use super::end::End;
use super::pty::Pty;
use super::{Notice, ServeError};
use crate::sim::bus::can::CanPort;

/// An SLCAN adapter: a serial port at one end, a controller on the simulated bus at the other.
#[derive(Debug)]
pub(super) struct AdapterEnd {
    pty: Pty,
    port: CanPort,
    adapter: Adapter,
    bit_rate: u32,
    /// Written by a program, and not yet looked at.
    unread: VecDeque<u8>,
    /// A frame that the controller has no room for.
    waiting: Option<SimpleFrame>,
}

impl AdapterEnd {
    pub(super) fn new(pty: Pty, port: CanPort, bit_rate: u32) -> Self {
        let adapter = Adapter::new(bit_rate);
        Self { pty, port, adapter, bit_rate, unread: VecDeque::new(), waiting: None }
    }

    /// The next byte from the program.
    fn next(&mut self) -> Result<Option<u8>, ServeError> {
        if self.unread.is_empty() {
            let mut chunk = [0; 256];
            let length = self.pty.read(&mut chunk)?;
            self.unread.extend(chunk.iter().take(length));
        }
        Ok(self.unread.pop_front())
    }
}

impl End for AdapterEnd {
    fn source(&self) -> Option<BorrowedFd<'_>> {
        self.waiting.is_none().then(|| self.pty.as_fd())
    }

    fn pump(&mut self, notify: &mut dyn FnMut(Notice)) -> Result<(), ServeError> {
        self.pty.admit_all()?;
        let mut out = Vec::new();
        loop {
            if let Some(frame) = self.waiting {
                if !self.adapter.send(&frame, &mut self.port, &mut out) {
                    break;
                }
                self.waiting = None;
            }
            let Some(byte) = self.next()? else { break };
            let (world, station) = (self.port.world().clone(), self.port.station());
            let status = || world.controller(station);
            match self.adapter.feed(byte, &mut self.port, status, &mut out) {
                Outcome::Done => {}
                Outcome::Waiting(frame) => self.waiting = Some(frame),
                Outcome::WrongRate(asked) => {
                    notify(Notice::WrongRate { asked, bit_rate: self.bit_rate });
                }
            }
        }
        while let Ok(frame) = self.port.receive() {
            let at_ms = self.port.world().now().as_micros() / 1_000;
            self.adapter.receive(frame, at_ms, &mut out);
        }
        Ok(self.pty.write(&out)?)
    }

    fn patience(&mut self) -> Option<Duration> {
        let status = self.port.world().controller(self.port.station());
        (status.received > 0).then_some(Duration::ZERO)
    }
}
