//! The ports and the clock for async tasks. They have the same manner, but await.

use std::future::pending;

use embassy_futures::select::{Either, select};
use embedded_io::ReadReady as _;
use myactuator_host_std::sim::bus::{Medium, World};
use myactuator_protocol_core::io::{AsyncCan, AsyncClock};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::wire::can::SimpleFrame;
use myactuator_protocol_core::wire::rs485::FRAME_LENGTH;
use myactuator_tests::wire::Wire;

use super::{Book, Manner, RoughCan, RoughClock, RoughError, RoughSerial, Shared, with};
use crate::master_truth::truth::STUCK_AFTER;

/// A serial port that has taken a part of a frame takes the rest within this.
const LONGEST_GAP_US: u64 = 500;

/// The loops take a port that holds a frame for 20 ms for a failed one. This allows for less.
const LONG: Duration = Duration::from_millis(15);

/// Waits until this time of the world. `None` waits forever.
async fn sleep<M: Medium>(world: &World<M>, until: Option<Instant>) {
    match until {
        Some(until) => world.clock().wait_until(until).await,
        None => pending().await,
    }
}

/// A port that holds a frame and has not taken it yet. Nothing else can be offered to it meanwhile.
struct Holds<M: Medium> {
    world: World<M>,
    book: Book,
    since: Instant,
    has_taken: bool,
}

impl<M: Medium> Holds<M> {
    fn new(world: &World<M>, book: &Book) -> Self {
        let (since, has_taken) = (world.now(), false);
        Self { world: world.clone(), book: book.clone(), since, has_taken }
    }
}

impl<M: Medium> Drop for Holds<M> {
    fn drop(&mut self) {
        let (mut truth, now) = (self.book.open(), self.world.now());
        truth.tick(now);
        truth.no_offer_was_possible();
        if now - self.since > STUCK_AFTER {
            truth.bus_has_failed();
        }
        // A caller that has waited for this long may give up before the frame was sent.
        if !self.has_taken || now - self.since > LONG {
            truth.port_has_failed();
        }
    }
}

/// Waits for as long as the port refuses.
async fn wait_for_a_place<M: Medium>(world: &World<M>, manner: &Shared) {
    while with(manner, |manner| manner.refuses(world.now())) {
        let until = with(manner, |manner| manner.refused_until);
        sleep(world, Some(until)).await;
    }
}

impl<W: Wire> AsyncClock for RoughClock<W> {
    async fn wait_until(&mut self, until: Instant) {
        let until = self.book.open().world_time(until);
        self.clock.wait_until(until).await;
    }
}

impl AsyncCan for RoughCan {
    type Frame = SimpleFrame;
    type Error = RoughError;

    async fn transmit(&mut self, frame: &SimpleFrame) -> Result<Option<SimpleFrame>, RoughError> {
        self.note_offered(frame);
        let mut holds = Holds::new(self.port.world(), &self.book);
        wait_for_a_place(self.port.world(), &self.manner).await;
        if let Some(error) = with(&self.manner, Manner::fails) {
            self.book.open().bus_has_failed();
            return Err(error);
        }
        let back = AsyncCan::transmit(&mut self.port, frame).await.map_err(RoughError::Can)?;
        holds.has_taken = true;
        drop(holds);
        self.note_taken(frame, back.as_ref());
        Ok(back)
    }

    async fn receive(&mut self) -> Result<SimpleFrame, RoughError> {
        loop {
            match embedded_can::nb::Can::receive(self) {
                Ok(frame) => return Ok(frame),
                Err(nb::Error::Other(error)) => return Err(error),
                Err(nb::Error::WouldBlock) => {}
            }
            let world = self.port.world().clone();
            let delivery = sleep(&world, self.arrived.front().map(|(at, _)| *at));
            let arrival = select(AsyncCan::receive(&mut self.port), delivery).await;
            if let Either::First(Ok(frame)) = arrival {
                let at = with(&self.manner, |manner| manner.delivery(world.now()));
                self.arrived.push_back((at, frame));
            }
        }
    }
}

impl embedded_io_async::Read for RoughSerial {
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, RoughError> {
        loop {
            if self.read_ready()? {
                return embedded_io::Read::read(self, buf);
            }
            let delivery = sleep(&self.world, self.arrived.front().map(|(at, _)| *at));
            let mut bytes = [0; 64];
            let arrival = embedded_io_async::Read::read(&mut self.port, &mut bytes);
            if let Either::First(Ok(count)) = select(arrival, delivery).await {
                let at = with(&self.manner, |manner| manner.delivery(self.world.now()));
                self.arrived.extend(bytes[..count].iter().map(|&byte| (at, byte)));
            }
        }
    }
}

impl embedded_io_async::Write for RoughSerial {
    async fn write(&mut self, buf: &[u8]) -> Result<usize, RoughError> {
        self.note_offered(buf);
        let mut holds = Holds::new(&self.world, &self.book);
        // A frame that is dropped before its first byte still counts as sent, because no loop knows how much of it a
        // port has taken. So if futures are dropped, only the rest of a frame has to wait.
        if buf.len() < FRAME_LENGTH {
            let wait = with(&self.manner, |manner| manner.dice.below(LONGEST_GAP_US));
            sleep(&self.world, Some(self.world.now() + Duration::from_micros(wait))).await;
        } else if !self.is_dropped {
            wait_for_a_place(&self.world, &self.manner).await;
        }
        let part = self.part_of(buf)?;
        let written = embedded_io_async::Write::write(&mut self.port, part).await;
        let count = written.map_err(RoughError::Serial)?;
        holds.has_taken = true;
        self.note_taken(buf);
        Ok(count)
    }

    async fn flush(&mut self) -> Result<(), RoughError> {
        let flushed = embedded_io_async::Write::flush(&mut self.port).await;
        flushed.map_err(RoughError::Serial)?;
        self.fails()
    }
}
