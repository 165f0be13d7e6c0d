//! The async loop over RS485.

use core::future::poll_fn;
use core::pin::pin;
use core::task::{Context, Poll};

use embassy_futures::select::{Either, select};
use embedded_io_async::{ErrorType, Read, Write};

use crate::io::async_runner::AsyncRunner;
use crate::io::clock::AsyncClock;
use crate::io::line::Line;
use crate::io::on_drop::OnDrop;
use crate::io::pump::{Port, Pump, STUCK_AFTER};
use crate::io::rest::rest;
use crate::io::runner::LONGEST_IDLE;
use crate::master::{Config, Event, Master};
use crate::time::Instant;
use crate::wire::rs485::Frame;

/// Runs a [`Master`] on an async serial port with an RS485 transceiver. If the port does not switch the transceiver's
/// direction on its own, wrap it in [`HalfDuplex`](crate::io::HalfDuplex).
///
/// The port's `read` must be cancel-safe: dropping its future must lose no byte. Ports with a buffer of their own are
/// (embassy's `BufferedUart`, its `RingBufferedUartRx`). Ports that read by DMA straight to the caller's memory are
/// not.
///
/// The port's `flush` must wait until the last byte has left. Its `read` reports no error of single bytes, as with
/// [`SerialMaster`](crate::io::SerialMaster).
#[derive(Debug)]
pub struct AsyncSerialMaster<S: ErrorType, K, const N: usize> {
    serial: S,
    clock: K,
    pump: Pump<N>,
    line: Line,
    /// What was read to the line's space while the task waited.
    read: Option<Result<usize, S::Error>>,
    /// A transmission was cut short: the port must be flushed, so that it turns to receiving.
    unflushed: bool,
}

impl<S: Read + Write, K: AsyncClock, const N: usize> AsyncSerialMaster<S, K, N> {
    /// A loop on this port, timed by this clock; see [`Config::rs485`].
    pub fn new(serial: S, clock: K, config: Config) -> Self {
        let config = config.on_line();
        let (pump, line) = (Pump::new(config), Line::new(&config));
        Self { serial, clock, pump, line, read: None, unflushed: false }
    }

    /// How often bytes came that are no frame: noise, or answers that collide, such as those of two motors with one id.
    pub const fn garbled(&self) -> u32 {
        self.pump.master.garbled()
    }

    /// Returns the port and the clock.
    pub fn release(self) -> (S, K) {
        (self.serial, self.clock)
    }

    /// Runs one round of the pump, and sends what it has to send.
    async fn round(&mut self) -> Result<Option<Event>, S::Error> {
        let Self { serial, clock, pump, line, read, .. } = self;
        let (now, mut outgoing) = (clock.now(), None);
        let event = poll_fn(|context| {
            let mut port = PolledOnce { serial, line, read, outgoing: &mut outgoing, context };
            Poll::Ready(pump.round(&mut port, now))
        });
        let event = event.await;
        match outgoing {
            Some(frame) => event.and(self.send(frame).await.map(|()| None)),
            None => event,
        }
    }

    async fn send(&mut self, frame: Frame) -> Result<(), S::Error> {
        let bytes = frame.encode();
        self.unflushed = true;
        let Self { serial, clock, pump, line, .. } = self;
        let until = clock.now() + STUCK_AFTER;
        // Even if this future is dropped the frame counts as sent: part of it may have left, and nothing is sent twice.
        let mut sending = OnDrop::new(
            (&mut pump.master, line, clock, bytes.as_slice()),
            |(master, line, clock, rest): &mut (&mut Master<N>, &mut Line, &mut K, &[u8])| {
                line.was_taken(master, frame, rest.is_empty(), clock.now());
            },
        );
        let (_, _, clock, rest) = &mut sending.it;
        let outcome = select(write(serial, rest), clock.wait_until(until)).await;
        // What the port has taken may be heard and answered, even if writing then fails.
        match rest.len() < bytes.len() {
            true => drop(sending),
            false => sending.end(),
        }
        let is_taken = match outcome {
            Either::First(taken) => taken,
            Either::Second(()) => Ok(false),
        };
        self.unflushed = !matches!(is_taken, Ok(true));
        if is_taken.is_err() {
            self.pump.round_has_failed(self.clock.now());
        } else if self.unflushed {
            self.pump.bus_is_down(self.clock.now());
        }
        is_taken.map(|_| ())
    }

    /// Ends a transmission that was cut short.
    async fn settle(&mut self) -> Result<(), S::Error> {
        if self.unflushed {
            let patience = self.clock.wait_until(self.clock.now() + STUCK_AFTER);
            if let Either::First(flushed) = select(self.serial.flush(), patience).await {
                self.unflushed = false;
                flushed.inspect_err(|_| self.pump.round_has_failed(self.clock.now()))?;
            }
        }
        Ok(())
    }
}

/// Writes all of `rest` and waits until it has left. `false` if the port takes nothing, which embedded-io forbids.
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
        &mut self.pump.master
    }

    fn now(&self) -> Instant {
        self.clock.now()
    }

    async fn run(&mut self, until: Option<Instant>) -> Result<Option<Event>, S::Error> {
        if let Some(event) = self.pump.left_event() {
            return Ok(Some(event));
        }
        self.clock.wait_until(self.pump.rests_until).await;
        loop {
            self.settle().await?;
            let event = self.round().await?.or_else(|| self.pump.master.poll_event());
            let now = self.clock.now();
            if event.is_some() || until.is_some_and(|until| until <= now) {
                return Ok(event);
            }
            let Self { serial, clock, pump, line, read, .. } = self;
            let wake_at = pump.wake_at(until);
            rest(pin!(serial.read(line.space())), read, clock, wake_at, false).await;
            if let Some(Ok(0)) = read {
                // The port is closed, for now or for good.
                let latest = now + LONGEST_IDLE;
                clock.wait_until(wake_at.map_or(latest, |at| at.min(latest))).await;
            }
        }
    }
}

/// Makes an async port one that never waits. What is to be sent is sent after the round: a frame that is dropped
/// halfway would leave in part.
struct PolledOnce<'a, 'b, S: ErrorType> {
    serial: &'a mut S,
    line: &'a mut Line,
    read: &'a mut Option<Result<usize, S::Error>>,
    outgoing: &'a mut Option<Frame>,
    context: &'a mut Context<'b>,
}

impl<S: Read, const N: usize> Port<N> for PolledOnce<'_, '_, S> {
    type Error = S::Error;

    fn receive(&mut self, pump: &mut Pump<N>, now: Instant) -> Result<Option<Event>, S::Error> {
        let Self { serial, line, read, context, .. } = self;
        line.receive(pump, now, |space| match read.take() {
            Some(read) => read,
            None => match pin!(serial.read(space)).poll(context) {
                Poll::Ready(read) => read,
                Poll::Pending => Ok(0),
            },
        })
    }

    fn transmit(&mut self, pump: &mut Pump<N>, now: Instant) -> Result<(), S::Error> {
        *self.outgoing = self.line.offered(pump, now);
        Ok(())
    }
}
