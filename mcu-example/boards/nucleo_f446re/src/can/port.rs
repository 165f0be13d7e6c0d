//! The controller as a port of embedded-can.

use board_stm32f4::TimeBase;
use bxcan::Frame;
use embedded_can::{Error, ErrorKind, nb::Can};
use myactuator_protocol_core::io::Clock as _;
use myactuator_protocol_core::time::{Duration, Instant};

use super::mailboxes::Mailboxes;
use super::receive;

/// If a controller has held three frames for this long, the bus does not take them. It would even on a bus full of more
/// urgent frames, within a few of them.
const STUCK_AFTER: Duration = Duration::from_millis(10);

/// Why the bus is down.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub enum CanError {
    /// The controller has left the bus after too many errors. It comes back on its own, after 128 times 11 quiet bits.
    BusOff,
    /// Nothing acknowledges what is sent, or the bus is never free.
    Stuck,
}

impl Error for CanError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::BusOff => ErrorKind::Other,
            Self::Stuck => ErrorKind::Acknowledge,
        }
    }
}

/// The CAN controller.
///
/// When the bus is down, what was in the mailboxes is dropped. Otherwise a set-point that is sent when the cable is
/// plugged in again would move a motor that was stopped meanwhile.
#[expect(missing_debug_implementations, reason = "registers say nothing")]
pub struct CanPort {
    mailboxes: Mailboxes,
    time: TimeBase,
    full_since: Option<Instant>,
    was_off: bool,
}

impl CanPort {
    pub(super) const fn new(mailboxes: Mailboxes, time: TimeBase) -> Self {
        Self { mailboxes, time, full_since: None, was_off: false }
    }
}

impl Can for CanPort {
    type Frame = Frame;
    type Error = CanError;

    /// Never hands a frame back in place of this one: a stop must not be followed by what came before it.
    fn transmit(&mut self, frame: &Frame) -> nb::Result<Option<Frame>, CanError> {
        if self.mailboxes.is_bus_off() {
            return Err(nb::Error::WouldBlock);
        }
        if self.mailboxes.send(frame) {
            self.full_since = None;
            return Ok(None);
        }
        let now = self.time.now();
        if now - *self.full_since.get_or_insert(now) < STUCK_AFTER {
            return Err(nb::Error::WouldBlock);
        }
        self.full_since = None;
        self.mailboxes.abort();
        Err(nb::Error::Other(CanError::Stuck))
    }

    /// The next frame. Reports once that the controller has left the bus.
    fn receive(&mut self) -> nb::Result<Frame, CanError> {
        let is_off = self.mailboxes.is_bus_off();
        if is_off && !core::mem::replace(&mut self.was_off, is_off) {
            self.mailboxes.abort();
            return Err(nb::Error::Other(CanError::BusOff));
        }
        self.was_off = is_off;
        receive::take().ok_or(nb::Error::WouldBlock)
    }
}
