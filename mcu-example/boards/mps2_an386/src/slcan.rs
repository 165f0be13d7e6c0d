//! CAN behind an SLCAN adapter on a UART.

mod text;

use core::fmt;

use embedded_can::ErrorKind;
use embedded_can::nb::Can;
use embedded_io::Write as _;
use myactuator_protocol_core::io::Clock as _;
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::wire::can::SimpleFrame;

pub(crate) use self::text::line;
use self::text::{Answer, LONGEST_LINE, Reader};
use crate::clock::Clock;
use crate::uart::Uart;

/// How many frames an adapter may hold that it has not answered yet. What it holds when the bus is cut is sent when the
/// bus is back, so these are few.
const MOST_UNANSWERED: u8 = 8;
/// An adapter that refuses a frame is given none for this long: its queue is full, or its bus carries nothing.
const REFUSED_PAUSE: Duration = Duration::from_millis(1);
/// How long an adapter may take to answer while it is opened. Four times this is less than the watchdog's time-out. An
/// answer that comes later does no harm.
const ANSWER_TIME: Duration = Duration::from_millis(25);
/// After this long what is unanswered stays so: the answers were lost, or the adapter is gone.
const FORGIVEN_AFTER: Duration = Duration::from_millis(100);
/// A UART that takes nothing for this long holds stale frames.
const LONGEST_STALL: Duration = Duration::from_millis(20);

/// A CAN bus behind an SLCAN adapter.
///
/// If the adapter's or the UART's queue is full, this is [`WouldBlock`](nb::Error::WouldBlock); no call waits. The
/// adapter has to answer each frame, as Lawicel's do. One that answers nothing takes eight frames in 100 ms.
#[derive(Debug)]
pub struct Slcan {
    uart: Uart,
    clock: Clock,
    reader: Reader,
    /// Frames that the adapter has neither accepted nor refused yet.
    unanswered: u8,
    /// When it last got or answered a frame.
    last_sign: Instant,
    not_before: Instant,
    stalled_since: Option<Instant>,
}

/// The UART to the adapter takes nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stalled;

impl fmt::Display for Stalled {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the line to the adapter takes nothing")
    }
}

impl core::error::Error for Stalled {}

impl embedded_can::Error for Stalled {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

impl Slcan {
    /// Puts the adapter on the bus, at 1 Mbit/s. Takes 0.1 s if nothing answers.
    ///
    /// Its answers are not checked, since nothing more could be done: motors behind an adapter that is not there do not
    /// answer.
    pub fn open(uart: Uart, clock: Clock) -> Self {
        let now = clock.now();
        let mut slcan = Self {
            uart,
            clock,
            reader: Reader::new(),
            unanswered: 0,
            last_sign: now,
            not_before: now,
            stalled_since: None,
        };
        // The first two end what an earlier firmware left: a line that had begun, and a channel that is open. An
        // adapter that is closed refuses to be closed.
        for command in [b"\r".as_slice(), b"C\r", b"S8\r", b"O\r"] {
            slcan.set_up(command);
        }
        slcan
    }

    pub(crate) const fn clock(&self) -> Clock {
        self.clock
    }

    fn set_up(&mut self, command: &[u8]) {
        if self.uart.write_all(command).is_err() {
            return;
        }
        let until = self.clock.now() + ANSWER_TIME;
        while self.clock.now() < until {
            match self.next_answer() {
                Some(Answer::Done | Answer::Refused) => return,
                // A frame from the bus, or the answer to an earlier firmware's frame.
                Some(_) => {}
                None => self.clock.idle(until),
            }
        }
    }

    fn next_answer(&mut self) -> Option<Answer> {
        loop {
            let byte = self.uart.try_read()?;
            let answer = self.reader.feed(byte);
            if answer.is_some() {
                return answer;
            }
        }
    }

    /// Whether the adapter can take a frame now.
    fn is_ready(&mut self, now: Instant) -> bool {
        if now - self.last_sign > FORGIVEN_AFTER {
            self.unanswered = 0;
        }
        now >= self.not_before && self.unanswered < MOST_UNANSWERED
    }
}

impl Can for Slcan {
    type Frame = SimpleFrame;
    type Error = Stalled;

    fn transmit(&mut self, frame: &SimpleFrame) -> nb::Result<Option<SimpleFrame>, Stalled> {
        let now = self.clock.now();
        if self.uart.room() < LONGEST_LINE {
            let since = *self.stalled_since.get_or_insert(now);
            if now - since <= LONGEST_STALL {
                return Err(nb::Error::WouldBlock);
            }
            self.uart.discard_unsent();
            // The adapter may hold the beginning of a line.
            self.uart.try_write(b"\r");
            self.stalled_since = None;
            return Err(nb::Error::Other(Stalled));
        }
        self.stalled_since = None;
        if !self.is_ready(now) {
            return Err(nb::Error::WouldBlock);
        }
        self.uart.try_write(&line(frame));
        self.unanswered += 1;
        self.last_sign = now;
        Ok(None)
    }

    fn receive(&mut self) -> nb::Result<SimpleFrame, Stalled> {
        while let Some(answer) = self.next_answer() {
            match answer {
                Answer::Frame(frame) => return Ok(frame),
                Answer::Done => {
                    self.unanswered = self.unanswered.saturating_sub(1);
                    self.last_sign = self.clock.now();
                }
                Answer::Refused => {
                    self.unanswered = self.unanswered.saturating_sub(1);
                    self.last_sign = self.clock.now();
                    self.not_before = self.last_sign + REFUSED_PAUSE;
                }
                Answer::Junk => {}
            }
        }
        Err(nb::Error::WouldBlock)
    }
}
