//! The loop over RS485.

use embedded_io::{Read, ReadReady, Write};

use crate::io::clock::Clock;
use crate::io::line::Line;
use crate::io::pump::{Port, Pump};
use crate::io::runner::Runner;
use crate::master::{Config, Event, Master};
use crate::time::Instant;

/// Runs a [`Master`] on a serial port with an RS485 transceiver. If the port does not switch the transceiver's
/// direction on its own, wrap it in [`HalfDuplex`](crate::io::HalfDuplex).
///
/// The port reports no error of single bytes (noise, framing, overrun): each would end a call that waits, or a control
/// loop. The checksum shows what is wrong. If a HAL reports them, wrap it; see
/// [what a driver reports](crate::io#what-a-driver-reports).
#[derive(Clone, Debug)]
pub struct SerialMaster<S, K, const N: usize> {
    serial: S,
    clock: K,
    pump: Pump<N>,
    line: Line,
}

impl<S: Read + Write + ReadReady, K: Clock, const N: usize> SerialMaster<S, K, N> {
    /// A loop on this port, timed by this clock; see [`Config::rs485`].
    pub fn new(serial: S, clock: K, config: Config) -> Self {
        let config = config.on_line();
        Self { serial, clock, pump: Pump::new(config), line: Line::new(&config) }
    }

    /// How often bytes came that are no frame: noise, or answers that collide, such as those of two motors with one id.
    pub const fn garbled(&self) -> u32 {
        self.pump.master.garbled()
    }

    /// Returns the port and the clock.
    pub fn release(self) -> (S, K) {
        (self.serial, self.clock)
    }
}

impl<S: Read + Write + ReadReady, K: Clock, const N: usize> Runner<N> for SerialMaster<S, K, N> {
    type Error = S::Error;

    fn master(&mut self) -> &mut Master<N> {
        &mut self.pump.master
    }

    fn now(&self) -> Instant {
        self.clock.now()
    }

    fn poll(&mut self) -> Result<Option<Event>, S::Error> {
        let Self { serial, clock, pump, line } = self;
        if let Some(event) = pump.left_event() {
            return Ok(Some(event));
        }
        let now = clock.now();
        let event = pump.round(&mut SerialPort { serial, clock, line }, now)?;
        Ok(event.or_else(|| pump.master.poll_event()))
    }

    fn idle(&mut self, until: Instant) {
        self.pump.idle(&self.clock, until);
    }
}

/// A serial port, as the pump sees it.
struct SerialPort<'a, S, K> {
    serial: &'a mut S,
    clock: &'a K,
    line: &'a mut Line,
}

impl<S: Read + Write + ReadReady, K: Clock, const N: usize> Port<N> for SerialPort<'_, S, K> {
    type Error = S::Error;

    fn receive(&mut self, pump: &mut Pump<N>, now: Instant) -> Result<Option<Event>, S::Error> {
        let Self { serial, line, .. } = self;
        line.receive(
            pump,
            now,
            |space| if serial.read_ready()? { serial.read(space) } else { Ok(0) },
        )
    }

    fn transmit(&mut self, pump: &mut Pump<N>, now: Instant) -> Result<(), S::Error> {
        let Some(frame) = self.line.offered(pump, now) else { return Ok(()) };
        let bytes = frame.encode();
        let mut rest = bytes.as_slice();
        let written = write(self.serial, &mut rest);
        // What the port has taken may be heard and answered, even if writing then fails.
        if rest.len() < bytes.len() {
            self.line.was_taken(&mut pump.master, frame, rest.is_empty(), self.clock.now());
        }
        if !written? {
            pump.bus_is_down(now);
        }
        Ok(())
    }
}

/// Writes all of `rest` and waits until it has left. `false` if the port takes nothing, which embedded-io forbids.
fn write<S: Write>(serial: &mut S, rest: &mut &[u8]) -> Result<bool, S::Error> {
    while !rest.is_empty() {
        match serial.write(rest)? {
            0 => return Ok(false),
            bytes => *rest = rest.get(bytes..).unwrap_or(&[]),
        }
    }
    serial.flush()?;
    Ok(true)
}
