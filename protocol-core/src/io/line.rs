//! From the bytes of a serial port to the master: what the blocking and the async loop share.

use crate::io::echo::{Came, EchoFilter, Probe, can_be_a_reply};
use crate::io::pump::Pump;
use crate::master::{Bus, Config, Event, Master};
use crate::time::Instant;
use crate::wire::rs485::{FRAME_LENGTH, Fed, Frame, Receiver};

/// Bytes read at once.
const CHUNK: usize = 32;

/// The receiving side of a serial port, and the bytes that were read from it and not looked at yet.
#[derive(Debug)]
pub(super) struct Line {
    receiver: Receiver,
    echoes: EchoFilter,
    probe: Probe,
    /// How often bytes came that are no frame.
    pub(super) garbled: u32,
    chunk: [u8; CHUNK],
    /// The bytes of `chunk` that are still to be looked at.
    next: usize,
    end: usize,
}

impl Line {
    pub(super) const fn new(config: &Config) -> Self {
        let echoes = EchoFilter::new(matches!(config.bus, Bus::Rs485 { echo: true, .. }));
        let (receiver, probe) = (Receiver::new(), Probe::new());
        Self { receiver, echoes, probe, garbled: 0, chunk: [0; CHUNK], next: 0, end: 0 }
    }

    /// Takes what the port holds, up to the first event. `read` gives 0 bytes where it holds none.
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
            match read(&mut self.chunk).inspect_err(|_| self.probe.may_be_lost())? {
                0 => {
                    self.found_empty(now);
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
            if self.probe.has_come_back(byte) {
                self.echoes.is_found();
            }
            let frame = match self.receiver.feed(byte) {
                Fed::Frame(frame) => frame,
                Fed::Wanting => continue,
                Fed::Discarded { .. } => {
                    self.garbled = self.garbled.saturating_add(1);
                    continue;
                }
            };
            if self.is_echo(&frame) {
                continue;
            }
            let event = master.handle_line(&frame, now);
            if event.is_some() {
                return event;
            }
        }
        None
    }

    /// Whether this is an echo. What nobody can know for one is, too, where it may be: if it confirms a stop, that is
    /// repeated, and then known.
    fn is_echo(&mut self, frame: &Frame) -> bool {
        let came = self.echoes.take(frame);
        came == Came::Echo || self.probe.something_came() && came == Came::Either
    }

    /// What is to be sent: what the master offers, which offers nothing that RS485 has no frame for. But where
    /// nobody knows whether the adapter echoes, what shows it goes before what its echo may seem to answer.
    pub(super) fn offered<const N: usize>(
        &mut self,
        pump: &mut Pump<N>,
        now: Instant,
    ) -> Option<[u8; FRAME_LENGTH]> {
        pump.refusals.pause();
        let frame = Frame::from_packet(&pump.master.poll_transmit(now)?)?;
        if !self.echoes.is_echoing() && can_be_a_reply(&frame) && self.probe.is_due() {
            pump.master.let_another_go_first(now);
            return Some(Probe::FRAME);
        }
        Some(frame.encode())
    }

    /// The port has taken what was to be sent, but for this rest of it: it may be heard, and come back.
    pub(super) fn was_taken<const N: usize>(
        &mut self,
        master: &mut Master<N>,
        bytes: &[u8; FRAME_LENGTH],
        rest: &[u8],
        now: Instant,
    ) {
        master.handle_transmitted(now);
        // What shows an echo is addressed to nobody, and so decodes to nothing.
        if let Ok(frame) = Frame::decode(bytes) {
            self.echoes.sent(frame, now);
            if can_be_a_reply(&frame) {
                self.probe.was_followed();
            }
        } else if rest.is_empty() {
            self.probe.was_sent();
        }
    }

    /// The port holds nothing now.
    fn found_empty(&mut self, now: Instant) {
        if self.echoes.is_echoing() {
            // If it is lost, because the line is out of order for a while, it is asked for again.
            self.probe = Probe::new();
        }
        self.echoes.found_empty(now);
    }

    /// Where to read to while nothing of [`receive`](Self::receive) is left: what is read there is given to that.
    pub(super) const fn space(&mut self) -> &mut [u8] {
        &mut self.chunk
    }
}
