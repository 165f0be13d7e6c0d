//! A serial port, a direction pin and a clock that can be cloned with their loop. While the loop runs, [`End`] is lent
//! to them.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;

use embedded_io::{ErrorKind, ErrorType, Read, ReadReady, Write};
use myactuator_protocol_core::io::Clock;
use myactuator_protocol_core::time::Instant;

/// This end of the line.
#[derive(Clone, Debug, Default)]
pub(super) struct End {
    pub(super) now: Instant,
    /// Bytes that the adapter has handed over.
    pub(super) arrived: VecDeque<u8>,
    /// Bytes that have left.
    pub(super) written: Vec<u8>,
    /// The port takes this many bytes and then fails.
    pub(super) fails_behind: Option<usize>,
    /// The bytes that have arrived are lost, and the port reports that.
    pub(super) read_fails: bool,
    /// The transceiver sends.
    pub(super) sends: bool,
    /// Bytes have left while the transceiver did not send.
    pub(super) has_sent_into_nothing: bool,
    /// The time until which the loop last wanted to idle.
    pub(super) idle_until: Instant,
}

thread_local! {
    static LENT: RefCell<End> = RefCell::default();
}

impl End {
    /// Lends this end to the port, the pin and the clock of this thread while `run` runs.
    pub(super) fn lend<T>(&mut self, run: impl FnOnce() -> T) -> T {
        let swap = |end: &mut Self| LENT.with_borrow_mut(|lent| std::mem::swap(lent, end));
        swap(self);
        let result = run();
        swap(self);
        result
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Port;

impl ErrorType for Port {
    type Error = ErrorKind;
}

impl ReadReady for Port {
    fn read_ready(&mut self) -> Result<bool, ErrorKind> {
        LENT.with_borrow_mut(|end| {
            if std::mem::take(&mut end.read_fails) {
                end.arrived.clear();
                return Err(ErrorKind::Other);
            }
            Ok(!end.arrived.is_empty())
        })
    }
}

impl Read for Port {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, ErrorKind> {
        LENT.with_borrow_mut(|end| {
            let bytes = buf.len().min(end.arrived.len());
            buf.iter_mut().zip(end.arrived.drain(..bytes)).for_each(|(to, byte)| *to = byte);
            Ok(bytes)
        })
    }
}

impl Write for Port {
    fn write(&mut self, buf: &[u8]) -> Result<usize, ErrorKind> {
        LENT.with_borrow_mut(|end| {
            end.has_sent_into_nothing |= !end.sends;
            let taken = match &mut end.fails_behind {
                Some(0) => {
                    end.fails_behind = None;
                    return Err(ErrorKind::Other);
                }
                Some(left) => {
                    let taken = buf.len().min(*left);
                    *left -= taken;
                    taken
                }
                None => buf.len(),
            };
            end.written.extend(&buf[..taken]);
            Ok(taken)
        })
    }

    fn flush(&mut self) -> Result<(), ErrorKind> {
        Ok(())
    }
}

/// High while the transceiver sends.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pin;

impl embedded_hal::digital::ErrorType for Pin {
    type Error = Infallible;
}

impl embedded_hal::digital::OutputPin for Pin {
    fn set_low(&mut self) -> Result<(), Infallible> {
        LENT.with_borrow_mut(|end| end.sends = false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        LENT.with_borrow_mut(|end| end.sends = true);
        Ok(())
    }
}

/// The pin needs no time.
#[derive(Clone, Copy, Debug)]
pub(super) struct NoDelay;

impl embedded_hal::delay::DelayNs for NoDelay {
    fn delay_ns(&mut self, _: u32) {}
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Lent;

impl Clock for Lent {
    fn now(&self) -> Instant {
        LENT.with_borrow(|end| end.now)
    }

    fn idle(&self, until: Instant) {
        LENT.with_borrow_mut(|end| end.idle_until = until);
    }
}
