//! A driver for the CMSDK UART: interrupts carry the bytes between it and two queues.

mod carrier;
mod tasks;

use core::fmt;

use embedded_io::{ErrorKind, ErrorType, Read, ReadReady, Write};
use heapless::spsc::{Consumer, Producer, Queue};
use myactuator_protocol_core::io::Clock as _;
use myactuator_protocol_core::time::{Duration, Instant};
use tock_registers::interfaces::{Readable, Writeable};

use self::carrier::Carrier;
use crate::clock::Clock;
use crate::device::{CLOCK_HZ, UartControl, UartId, UartState, unmask};

/// Room for received bytes: a millisecond and a half at 1.5 Mbit/s.
const RECEIVED: usize = 256;
/// Room for bytes to send: two lines of SLCAN, or four frames of RS485.
const UNSENT: usize = 64;
/// A UART that sends nothing for this long never will.
const LONGEST_STALL: Duration = Duration::from_millis(20);
const BITS_A_BYTE: u32 = 10;

/// The queues of a UART. `cortex_m::singleton!` makes them.
#[derive(Debug, Default)]
pub struct Queues {
    received: Queue<u8, RECEIVED>,
    unsent: Queue<u8, UNSENT>,
}

impl Queues {
    /// Empty ones.
    pub const fn new() -> Self {
        Self { received: Queue::new(), unsent: Queue::new() }
    }
}

/// A UART, 8N1.
///
/// Bytes that are lost because they were not taken in time, by the hardware or here, are counted and otherwise ignored:
/// reading never reports an error. A lost byte costs the frame that it belonged to. That frame's checksum shows it, and
/// the master asks again. An error, on the other hand, means to the master that the bus is down, and it would give up
/// what is in flight with every motor. This UART detects no other errors of the line; disturbed bytes are found by the
/// checksum as well.
pub struct Uart {
    id: UartId,
    clock: Clock,
    byte_time: Duration,
    received: Consumer<'static, u8, RECEIVED>,
    unsent: Producer<'static, u8, UNSENT>,
}

/// The bytes that were written were not sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stalled;

impl fmt::Display for Stalled {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the UART does not send")
    }
}

impl core::error::Error for Stalled {}

impl embedded_io::Error for Stalled {
    fn kind(&self) -> ErrorKind {
        ErrorKind::TimedOut
    }
}

impl Uart {
    /// Sets a UART up, with the bit rate as close as its clock allows. Call it once for each.
    pub fn start(id: UartId, bit_rate: u32, clock: Clock, queues: &'static mut Queues) -> Self {
        let (into_received, received) = queues.received.split();
        let (unsent, from_unsent) = queues.unsent.split();
        Carrier::put_in_place(id, into_received, from_unsent);

        // The smallest that the hardware accepts.
        let divisor = (CLOCK_HZ / bit_rate.max(1)).max(16);
        let byte_micros = (BITS_A_BYTE * divisor).div_ceil(CLOCK_HZ / 1_000_000);
        let registers = id.registers();
        registers.bit_divisor.set(divisor);
        registers.control.write(
            UartControl::TX_ENABLE::SET
                + UartControl::RX_ENABLE::SET
                + UartControl::TX_INTERRUPT::SET
                + UartControl::RX_INTERRUPT::SET,
        );
        unmask(&id.interrupts());
        let byte_time = Duration::from_micros(byte_micros.into());
        Self { id, clock, byte_time, received, unsent }
    }

    /// How many received bytes were lost since the start.
    pub fn lost(&self) -> u32 {
        carrier::lost(self.id)
    }

    /// How many bytes can be written without waiting.
    pub fn room(&self) -> usize {
        self.unsent.capacity() - self.unsent.len()
    }

    /// Writes as much as there is room for, without waiting.
    pub fn try_write(&mut self, bytes: &[u8]) -> usize {
        let taken = bytes.iter().take_while(|&&byte| self.unsent.enqueue(byte).is_ok()).count();
        // The interrupt for sending comes only after a byte was sent.
        carrier::carry(self.id);
        taken
    }

    /// The next received byte, without waiting.
    pub fn try_read(&mut self) -> Option<u8> {
        carrier::note_waiting(self.id, self.received.len());
        self.received.dequeue()
    }

    /// Drops what was written and not sent yet.
    pub fn discard_unsent(&mut self) {
        carrier::discard_unsent(self.id);
    }

    /// Reads as many received bytes as fit, without waiting.
    fn take_received(&mut self, buf: &mut [u8]) -> usize {
        carrier::note_waiting(self.id, self.received.len());
        let bytes = core::iter::from_fn(|| self.received.dequeue());
        buf.iter_mut().zip(bytes).map(|(place, byte)| *place = byte).count()
    }

    fn has_sent(&self) -> bool {
        self.unsent.len() == 0 && !self.id.registers().state.is_set(UartState::TX_FULL)
    }

    /// Waits until bytes are sent, but not forever. After that the rest is dropped, since it is stale.
    fn wait_until(&mut self, is_over: impl Fn(&Self) -> bool) -> Result<(), Stalled> {
        let (mut left, mut since) = (self.unsent.len(), self.clock.now());
        while !is_over(self) {
            let now = self.clock.now();
            if self.unsent.len() != left {
                (left, since) = (self.unsent.len(), now);
            } else if now - since > LONGEST_STALL {
                self.discard_unsent();
                return Err(Stalled);
            }
        }
        Ok(())
    }
}

/// The most received bytes that were queued, and how many were lost.
pub(crate) fn received_on(id: UartId) -> (u32, u32) {
    (carrier::most_waiting(id), carrier::lost(id))
}

impl fmt::Debug for Uart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Uart").field("id", &self.id).finish_non_exhaustive()
    }
}

impl ErrorType for Uart {
    type Error = Stalled;
}

impl Read for Uart {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, Stalled> {
        if buf.is_empty() {
            return Ok(0);
        }
        while !self.received.ready() {
            self.clock.idle(Instant::from_micros(u64::MAX));
        }
        Ok(self.take_received(buf))
    }
}

impl ReadReady for Uart {
    fn read_ready(&mut self) -> Result<bool, Stalled> {
        Ok(self.received.ready())
    }
}

impl Write for Uart {
    fn write(&mut self, buf: &[u8]) -> Result<usize, Stalled> {
        if buf.is_empty() {
            return Ok(0);
        }
        self.wait_until(|uart| uart.room() > 0)?;
        Ok(self.try_write(buf))
    }

    /// Waits until the last byte was sent.
    fn flush(&mut self) -> Result<(), Stalled> {
        self.wait_until(Self::has_sent)?;
        // The UART's buffer is empty as soon as it begins to send its last byte.
        self.clock.wait(self.byte_time);
        Ok(())
    }
}
