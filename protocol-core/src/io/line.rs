//! From the bytes of a serial port to the master: what the blocking and the async loop share.

use crate::master::{Event, Master};
use crate::time::Instant;
use crate::wire::rs485::{FRAME_LENGTH, Frame, Receiver};

/// Bytes read at once.
const CHUNK: usize = 32;

/// The receiving side of a serial port, and the bytes that were read from it and not looked at yet.
#[derive(Debug)]
pub(super) struct Line {
    receiver: Receiver,
    chunk: [u8; CHUNK],
    /// The bytes of `chunk` that are still to be looked at.
    next: usize,
    end: usize,
}

impl Line {
    pub(super) const fn new() -> Self {
        Self { receiver: Receiver::new(), chunk: [0; CHUNK], next: 0, end: 0 }
    }

    /// Hands on the bytes that were read, up to the first event.
    pub(super) fn take<const N: usize>(
        &mut self,
        master: &mut Master<N>,
        now: Instant,
    ) -> Option<Event> {
        while let Some(&byte) = self.chunk.get(..self.end).and_then(|read| read.get(self.next)) {
            self.next += 1;
            let fed = self.receiver.feed(byte);
            let event = master.handle_line(&fed, now);
            if event.is_some() {
                return event;
            }
        }
        None
    }

    /// Where to read to, once [`take`](Self::take) has given its last event.
    pub(super) fn space(&mut self) -> &mut [u8] {
        self.next = 0;
        self.end = 0;
        &mut self.chunk
    }

    /// So many bytes were read to [`space`](Self::space).
    pub(super) fn filled(&mut self, bytes: usize) {
        self.end = bytes.min(CHUNK);
    }
}

/// The bytes of what the master offers; it offers nothing that RS485 has no frame for.
pub(super) fn offered<const N: usize>(
    master: &mut Master<N>,
    now: Instant,
) -> Option<[u8; FRAME_LENGTH]> {
    let packet = master.poll_transmit(now)?;
    Frame::from_packet(&packet).map(|frame| frame.encode())
}
