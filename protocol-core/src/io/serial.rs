//! The loop over RS485.

use embedded_io::{Read, ReadReady, Write};

use crate::io::clock::Clock;
use crate::io::runner::Runner;
use crate::master::{Config, Event, Master};
use crate::time::Instant;
use crate::wire::rs485::{Frame, Receiver};

/// Bytes read at once.
const CHUNK: usize = 32;

/// Runs a [`Master`] on a serial port with an RS485 transceiver. Where the port does not switch the
/// transceiver's direction by itself, wrap it in [`HalfDuplex`](crate::io::HalfDuplex).
#[derive(Debug)]
pub struct SerialMaster<S, K, const N: usize> {
    serial: S,
    clock: K,
    master: Master<N>,
    receiver: Receiver,
    chunk: [u8; CHUNK],
    /// The bytes of `chunk` that are still to be looked at.
    next: usize,
    end: usize,
}

impl<S: Read + Write + ReadReady, K: Clock, const N: usize> SerialMaster<S, K, N> {
    /// A loop on this port, timed by this clock; see [`Config::rs485`].
    pub fn new(serial: S, clock: K, config: Config) -> Self {
        let receiver = Receiver::new();
        Self {
            serial,
            clock,
            master: Master::new(config),
            receiver,
            chunk: [0; CHUNK],
            next: 0,
            end: 0,
        }
    }

    /// The port and the clock back.
    pub fn release(self) -> (S, K) {
        (self.serial, self.clock)
    }

    fn next_byte(&mut self) -> Result<Option<u8>, S::Error> {
        if self.next >= self.end {
            if !self.serial.read_ready()? {
                return Ok(None);
            }
            self.next = 0;
            self.end = self.serial.read(&mut self.chunk)?;
        }
        let byte = self.chunk.get(..self.end).and_then(|read| read.get(self.next)).copied();
        self.next += 1;
        Ok(byte)
    }

    fn receive(&mut self, now: Instant) -> Result<Option<Event>, S::Error> {
        while let Some(byte) = self.next_byte()? {
            let fed = self.receiver.feed(byte);
            let event = self.master.handle_line(&fed, now);
            if event.is_some() {
                return Ok(event);
            }
        }
        Ok(None)
    }

    fn transmit(&mut self, now: Instant) -> Result<(), S::Error> {
        // The master offers nothing that RS485 has no frame for.
        if let Some(frame) = self.master.poll_transmit(now).as_ref().and_then(Frame::from_packet) {
            self.serial.write_all(&frame.encode())?;
            self.serial.flush()?;
            self.master.handle_transmitted(self.clock.now());
        }
        Ok(())
    }
}

impl<S: Read + Write + ReadReady, K: Clock, const N: usize> Runner<N> for SerialMaster<S, K, N> {
    type Error = S::Error;

    fn master(&mut self) -> &mut Master<N> {
        &mut self.master
    }

    fn now(&self) -> Instant {
        self.clock.now()
    }

    fn poll(&mut self) -> Result<Option<Event>, S::Error> {
        let now = self.clock.now();
        // What was received comes first, so that the caller's answer to it is there when the next
        // command is chosen.
        if let Some(event) = self.receive(now)? {
            return Ok(Some(event));
        }
        self.master.handle_timeout(now);
        if let Err(error) = self.transmit(now) {
            self.master.handle_bus_down(now);
            return Err(error);
        }
        Ok(self.master.poll_event())
    }

    fn idle(&mut self, until: Instant) {
        let deadline = self.master.poll_at().map_or(until, |at| at.min(until));
        self.clock.idle(deadline);
    }
}
