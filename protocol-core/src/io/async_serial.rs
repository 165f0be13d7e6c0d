//! The async loop over RS485.

use core::future::ready;

use embassy_futures::select::{Either, select};
use embassy_futures::yield_now;
use embedded_io_async::{Read, Write};

use crate::io::async_clock::{AsyncClock, wait};
use crate::io::async_runner::{AsyncRunner, earlier};
use crate::io::clock::Clock;
use crate::io::line::{Line, READS_A_ROUND};
use crate::io::runner::{LONGEST_IDLE, STUCK_AFTER};
use crate::master::{Config, Event, Master};
use crate::time::Instant;
use crate::wire::rs485::FRAME_LENGTH;

/// Runs a [`Master`] on an async serial port with an RS485 transceiver. Where the port does not
/// switch the transceiver's direction by itself, wrap it in [`HalfDuplex`](crate::io::HalfDuplex).
///
/// The port's `read` must be cancel-safe: dropping its future may lose no byte. Ports with a buffer
/// of their own are (embassy's `BufferedUart`, its `RingBufferedUartRx`); those that read by DMA
/// straight to the caller's memory are not.
///
/// Its `flush` must wait until the last byte has left.
#[derive(Debug)]
pub struct AsyncSerialMaster<S, K, const N: usize> {
    serial: S,
    clock: K,
    master: Master<N>,
    line: Line,
    /// A sending was cut short: the port is to be flushed, so that it turns to receiving.
    unflushed: bool,
}

/// A frame that leaves. It counts as sent also when the future that sends it is dropped: some of it may have
/// left, and nothing is sent twice.
struct Sending<'a, K: Clock, const N: usize> {
    master: &'a mut Master<N>,
    line: &'a mut Line,
    clock: &'a mut K,
    bytes: &'a [u8; FRAME_LENGTH],
    /// What the port has not taken yet.
    rest: &'a [u8],
    is_refused: bool,
}

impl<K: Clock, const N: usize> Drop for Sending<'_, K, N> {
    fn drop(&mut self) {
        if !self.is_refused {
            self.master.handle_transmitted(self.clock.now());
        }
        if self.rest.is_empty() {
            self.line.was_sent(self.bytes);
        }
    }
}

impl<S: Read + Write, K: AsyncClock, const N: usize> AsyncSerialMaster<S, K, N> {
    /// A loop on this port, timed by this clock; see [`Config::rs485`].
    pub fn new(serial: S, clock: K, config: Config) -> Self {
        Self {
            serial,
            clock,
            master: Master::new(config),
            line: Line::new(&config),
            unflushed: false,
        }
    }

    /// The port and the clock back.
    pub fn release(self) -> (S, K) {
        (self.serial, self.clock)
    }

    /// Takes what the port holds, up to the first event.
    async fn receive(&mut self, now: Instant) -> Result<Option<Event>, S::Error> {
        for _ in 0..READS_A_ROUND {
            let event = self.line.take(&mut self.master, now);
            if event.is_some() {
                return Ok(event);
            }
            match select(self.serial.read(self.line.space()), ready(())).await {
                Either::First(Ok(0)) | Either::Second(()) => {
                    self.line.found_empty(now);
                    return Ok(None);
                }
                Either::First(bytes) => self.line.filled(bytes?),
            }
        }
        yield_now().await;
        Ok(self.line.take(&mut self.master, now))
    }

    async fn transmit(&mut self) -> Result<(), S::Error> {
        let now = self.clock.now();
        let Some(bytes) = self.line.offered(&mut self.master, now) else { return Ok(()) };
        self.unflushed = true;
        let Self { serial, clock, master, line, .. } = self;
        let mut sending =
            Sending { master, line, clock, bytes: &bytes, rest: &bytes, is_refused: false };
        let patience = sending.clock.wait_until(now + STUCK_AFTER);
        let outcome = select(write(serial, &mut sending.rest), patience).await;
        // What the port has taken may be heard, and answered, whatever fails then.
        sending.is_refused = sending.rest.len() == bytes.len();
        drop(sending);
        match outcome {
            Either::First(Ok(true)) => self.unflushed = false,
            Either::First(Ok(false)) | Either::Second(()) => {
                self.master.handle_bus_down(self.clock.now());
            }
            Either::First(Err(error)) => return Err(error),
        }
        Ok(())
    }

    /// Ends a sending that was cut short.
    async fn settle(&mut self) -> Result<(), S::Error> {
        if self.unflushed {
            let patience = self.clock.wait_until(self.clock.now() + STUCK_AFTER);
            if let Either::First(flushed) = select(self.serial.flush(), patience).await {
                self.unflushed = false;
                flushed?;
            }
        }
        Ok(())
    }
}

/// Writes until nothing is left and waits until that has left; `false` with a port that takes nothing,
/// which embedded-io forbids.
async fn write<S: Write>(serial: &mut S, rest: &mut &[u8]) -> Result<bool, S::Error> {
    while !rest.is_empty() {
        match serial.write(rest).await? {
            0 => return Ok(false),
            bytes => *rest = rest.get(bytes..).unwrap_or(&[]),
        }
    }
    serial.flush().await?;
    Ok(true)
}

impl<S: Read + Write, K: AsyncClock, const N: usize> AsyncRunner<N> for AsyncSerialMaster<S, K, N> {
    type Error = S::Error;

    fn master(&mut self) -> &mut Master<N> {
        &mut self.master
    }

    fn now(&self) -> Instant {
        self.clock.now()
    }

    async fn run(&mut self, until: Option<Instant>) -> Result<Option<Event>, S::Error> {
        let outcome = self.run_port(until).await;
        if outcome.is_err() {
            self.master.handle_bus_down(self.clock.now());
        }
        outcome
    }
}

impl<S: Read + Write, K: AsyncClock, const N: usize> AsyncSerialMaster<S, K, N> {
    async fn run_port(&mut self, until: Option<Instant>) -> Result<Option<Event>, S::Error> {
        loop {
            self.settle().await?;
            let now = self.clock.now();
            match self.receive(now).await {
                Ok(None) => {}
                Ok(event) => return Ok(event),
                Err(error) => {
                    self.master.handle_timeout(now);
                    self.master.handle_bus_down(now);
                    // On a noisy line there is an error with each look: no stop waits for its end.
                    let _ = self.transmit().await;
                    return Err(error);
                }
            }
            self.master.handle_timeout(now);
            self.transmit().await?;
            let event = self.master.poll_event();
            let now = self.clock.now();
            if event.is_some() || until.is_some_and(|until| until <= now) {
                return Ok(event);
            }
            let wake_at = earlier(self.master.poll_at(), until);
            let timer = wait(&mut self.clock, wake_at);
            match select(self.serial.read(self.line.space()), timer).await {
                // The port is closed, for now or for good.
                Either::First(Ok(0)) => {
                    let again_at = earlier(wake_at, Some(now + LONGEST_IDLE));
                    wait(&mut self.clock, again_at).await;
                }
                Either::First(bytes) => self.line.filled(bytes?),
                Either::Second(()) => {}
            }
        }
    }
}
