//! The loop over RS485.

use embedded_io::{Read, ReadReady, Write};

use crate::io::clock::Clock;
use crate::io::line::{Line, READS_A_ROUND};
use crate::io::runner::Runner;
use crate::master::{Config, Event, Master};
use crate::time::Instant;

/// Runs a [`Master`] on a serial port with an RS485 transceiver. Where the port does not switch the
/// transceiver's direction by itself, wrap it in [`HalfDuplex`](crate::io::HalfDuplex).
#[derive(Debug)]
pub struct SerialMaster<S, K, const N: usize> {
    serial: S,
    clock: K,
    master: Master<N>,
    line: Line,
}

impl<S: Read + Write + ReadReady, K: Clock, const N: usize> SerialMaster<S, K, N> {
    /// A loop on this port, timed by this clock; see [`Config::rs485`].
    pub fn new(serial: S, clock: K, config: Config) -> Self {
        Self { serial, clock, master: Master::new(config), line: Line::new(&config) }
    }

    /// How often bytes came that are no frame: noise, or answers that collide, as those of two motors with one id.
    pub const fn garbled(&self) -> u32 {
        self.line.garbled
    }

    /// The port and the clock back.
    pub fn release(self) -> (S, K) {
        (self.serial, self.clock)
    }

    fn receive(&mut self, now: Instant) -> Result<Option<Event>, S::Error> {
        for _ in 0..READS_A_ROUND {
            let event = self.line.take(&mut self.master, now);
            if event.is_some() {
                return Ok(event);
            }
            if !self.serial.read_ready()? {
                self.line.found_empty(now);
                return Ok(None);
            }
            match self.serial.read(self.line.space())? {
                0 => return Ok(None),
                bytes => self.line.filled(bytes),
            }
        }
        Ok(self.line.take(&mut self.master, now))
    }

    fn transmit(&mut self, now: Instant) -> Result<(), S::Error> {
        let Some(bytes) = self.line.offered(&mut self.master, now) else { return Ok(()) };
        let mut rest = bytes.as_slice();
        let written = self.write(&mut rest);
        // What the port has taken may be heard, and answered, whatever fails then.
        if rest.len() < bytes.len() {
            self.master.handle_transmitted(self.clock.now());
        }
        if rest.is_empty() {
            self.line.was_sent(&bytes);
        }
        if let Ok(false) = written {
            self.master.handle_bus_down(now);
        }
        written.map(|_| ())
    }

    /// Writes until nothing is left and waits until that has left; `false` with a port that takes nothing,
    /// which embedded-io forbids.
    fn write(&mut self, rest: &mut &[u8]) -> Result<bool, S::Error> {
        while !rest.is_empty() {
            match self.serial.write(rest)? {
                0 => return Ok(false),
                bytes => *rest = rest.get(bytes..).unwrap_or(&[]),
            }
        }
        self.serial.flush()?;
        Ok(true)
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
        match self.receive(now) {
            Ok(None) => {}
            Ok(event) => return Ok(event),
            Err(error) => {
                self.master.handle_timeout(now);
                self.master.handle_bus_down(now);
                // On a noisy line there is an error with each look: no stop waits for its end.
                let _ = self.transmit(now);
                return Err(error);
            }
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
