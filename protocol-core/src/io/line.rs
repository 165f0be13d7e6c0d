//! The way from the bytes of a serial port to the master, shared by the blocking and the async loop.

use crate::io::echo::EchoFilter;
use crate::io::pump::Pump;
use crate::master::{Config, Event, Master};
use crate::time::Instant;
use crate::wire::rs485::{Fed, Frame, Receiver};

/// Bytes read at once.
const CHUNK: usize = 32;

/// The receiving side of a serial port, and the bytes that were read from it and not yet looked at.
#[derive(Clone, Debug)]
pub(super) struct Line {
    receiver: Receiver,
    echoes: EchoFilter,
    chunk: [u8; CHUNK],
    /// The bytes of `chunk` that are still to be looked at.
    next: usize,
    end: usize,
}

impl Line {
    pub(super) const fn new(config: &Config) -> Self {
        let echoes = EchoFilter::new(config.echoes());
        Self { receiver: Receiver::new(), echoes, chunk: [0; CHUNK], next: 0, end: 0 }
    }

    /// Takes what the port holds, up to the first event. `read` returns 0 if the port holds nothing.
    pub(super) fn receive<E, const N: usize>(
        &mut self,
        pump: &mut Pump<N>,
        now: Instant,
        mut read: impl FnMut(&mut [u8]) -> Result<usize, E>,
    ) -> Result<Option<Event>, E> {
        loop {
            let event = self.take(&mut pump.master, now);
            if event.is_some() || !pump.looks_again() {
                return Ok(event);
            }
            (self.next, self.end) = (0, 0);
            match read(&mut self.chunk).inspect_err(|_| self.echoes.show_nothing())? {
                0 => {
                    self.echoes.found_empty(now);
                    return Ok(None);
                }
                bytes => self.end = bytes.min(CHUNK),
            }
        }
    }

    /// Hands on the bytes that were read, up to the first event.
    fn take<const N: usize>(&mut self, master: &mut Master<N>, now: Instant) -> Option<Event> {
        while let Some(&byte) = self.chunk.get(..self.end).and_then(|read| read.get(self.next)) {
            self.next += 1;
            let frame = match self.receiver.feed(byte) {
                Fed::Frame(frame) => frame,
                Fed::Wanting => continue,
                Fed::Discarded { .. } => {
                    master.note_garbled();
                    continue;
                }
            };
            if self.echoes.is_echo(&frame) {
                continue;
            }
            let event = master.handle_line(&frame, now);
            if event.is_some() {
                return event;
            }
        }
        None
    }

    /// What is to be sent: what the master offers, which is always something that RS485 has a frame for. But if it is
    /// not known whether the adapter echoes, a command that shows this goes before one whose echo may look like its
    /// answer.
    pub(super) fn offered<const N: usize>(
        &mut self,
        pump: &mut Pump<N>,
        now: Instant,
    ) -> Option<Frame> {
        pump.refusals.pause();
        let frame = Frame::from_packet(&pump.master.poll_transmit(now)?)?;
        let asks = self.echoes.asks_before(&frame, pump.master.offers_first_stop());
        let status = asks.and_then(|motor| pump.master.let_status_go_first(motor));
        Some(status.and_then(|packet| Frame::from_packet(&packet)).unwrap_or(frame))
    }

    /// The port has taken this frame, or part of it. It may be heard, and come back.
    pub(super) fn was_taken<const N: usize>(
        &mut self,
        master: &mut Master<N>,
        frame: Frame,
        is_whole: bool,
        now: Instant,
    ) {
        master.handle_transmitted(now);
        master.note_echo(self.echoes.is_echoing());
        self.echoes.sent(frame, now);
        if !is_whole {
            self.echoes.show_nothing();
        }
    }

    /// Where to read to while [`receive`](Self::receive) has nothing left. What is read there is passed to `receive`.
    pub(super) const fn space(&mut self) -> &mut [u8] {
        &mut self.chunk
    }
}
