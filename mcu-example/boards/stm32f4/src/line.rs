//! The RS485 line: USART1 on PA9 (TX) and PA10 (RX), and PA8 for the transceiver's direction.

use core::cell::RefCell;
use core::convert::Infallible;
use core::mem;

use cortex_m::interrupt::{Mutex, free};
use cortex_m::peripheral::NVIC;
use embedded_io::{ErrorType, Read, ReadReady, Write};
use heapless::Deque;
use myactuator_mcu_example::Usage;
use myactuator_protocol_core::io::HalfDuplex;
use stm32f4xx_hal::gpio::{Output, PA8, PA9, PA10, Pull};
use stm32f4xx_hal::nb;
use stm32f4xx_hal::pac::{self, USART1, interrupt};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::Rcc;
use stm32f4xx_hal::serial::{Config, Error, Rx, Serial, Tx};

use crate::time::{TimeBase, wake};

/// Room in the queue: the bytes of 19 frames.
const QUEUE: usize = 256;
/// The time between switching the direction pin and the first bit, and between the last bit and switching it back: more
/// than any usual transceiver takes to switch, less than a drive takes to answer.
const SETUP_NS: u32 = 2_000;
const HOLD_NS: u32 = 1_000;

/// The line, with its transceiver's direction.
pub type Line = HalfDuplex<Port, PA8<Output>, TimeBase>;

/// Opens the line at this bit rate, in bit/s. `None` if the USART's clock does not allow it.
pub fn open_line(
    usart: USART1,
    pins: (PA9, PA10, PA8),
    bit_rate: u32,
    rcc: &mut Rcc,
    time: TimeBase,
) -> Option<Line> {
    let (tx, mut rx, direction) = pins;
    // Nothing drives the receiver's output while the transceiver sends.
    rx.set_internal_resistor(Pull::Up);
    let config = Config::default().baudrate(bit_rate.bps());
    let (tx, mut rx) = Serial::new(usart, (tx, rx), config, rcc).ok()?.split();
    rx.listen();
    let receiver =
        Receiver { rx, queue: Deque::new(), errors: LineErrors::default(), most: 0, dropped: 0 };
    free(|cs| RECEIVER.borrow(cs).replace(Some(receiver)));
    // SAFETY: no critical section relies on this interrupt being masked.
    unsafe { NVIC::unmask(pac::Interrupt::USART1) };
    HalfDuplex::new(Port { tx }, direction.into_push_pull_output(), time, SETUP_NS, HOLD_NS).ok()
}

/// Errors of received bytes, which are otherwise ignored: a frame that lacks a byte is lost like any other, and the
/// master asks again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, defmt::Format)]
pub struct LineErrors {
    /// Bytes that came before the previous one was taken from the USART.
    pub overruns: u32,
    /// Bytes without a stop bit: another bit rate, a break, or a line at rest without bias.
    pub framing: u32,
    /// Bytes with a bit that was not clear.
    pub noise: u32,
    /// Bytes that found the queue full.
    pub dropped: u32,
}

impl LineErrors {
    /// Whether there were none.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    fn of(&mut self, error: Error) -> &mut u32 {
        match error {
            Error::Overrun => &mut self.overruns,
            Error::Noise => &mut self.noise,
            _ => &mut self.framing,
        }
    }
}

/// The errors since the last call.
pub fn take_line_errors() -> LineErrors {
    with_receiver(|receiver| mem::take(&mut receiver.errors)).unwrap_or_default()
}

/// The line's part of the board's usage, in bytes. A disturbed byte counts as dropped.
pub fn line_usage() -> Usage {
    let usage = |receiver: &mut Receiver| Usage {
        queued: receiver.most as u32,
        dropped: receiver.dropped,
        ..Usage::default()
    };
    with_receiver(usage).unwrap_or_default()
}

/// What the interrupt works on.
struct Receiver {
    rx: Rx<USART1>,
    queue: Deque<u8, QUEUE>,
    errors: LineErrors,
    /// The most bytes that were queued.
    most: usize,
    /// All errors since the start.
    dropped: u32,
}

static RECEIVER: Mutex<RefCell<Option<Receiver>>> = Mutex::new(RefCell::new(None));

fn with_receiver<T>(work: impl FnOnce(&mut Receiver) -> T) -> Option<T> {
    free(|cs| RECEIVER.borrow(cs).borrow_mut().as_mut().map(work))
}

#[interrupt]
fn USART1() {
    with_receiver(|receiver| {
        loop {
            let counter = match receiver.rx.read() {
                Ok(byte) if receiver.queue.push_back(byte).is_ok() => continue,
                Ok(_) => &mut receiver.errors.dropped,
                // Reading it has cleared it.
                Err(nb::Error::Other(error)) => receiver.errors.of(error),
                Err(nb::Error::WouldBlock) => break,
            };
            *counter = counter.saturating_add(1);
            receiver.dropped = receiver.dropped.saturating_add(1);
        }
    });
    wake();
}

/// The USART as a port of embedded-io 0.7. The HAL's port is one of 0.6, and returns 0 if it would have to wait.
///
/// It reports no errors: the master would take one to mean that the bus is down. Errors of single bytes are
/// [counted](LineErrors).
#[expect(missing_debug_implementations, reason = "the HAL's half of a USART has none")]
pub struct Port {
    tx: Tx<USART1>,
}

impl ErrorType for Port {
    type Error = Infallible;
}

impl Read for Port {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        if buffer.is_empty() {
            return Ok(0);
        }
        loop {
            let mut count = 0;
            with_receiver(|receiver| {
                receiver.most = receiver.most.max(receiver.queue.len());
                for place in buffer.iter_mut() {
                    let Some(byte) = receiver.queue.pop_front() else { break };
                    *place = byte;
                    count += 1;
                }
            });
            if count > 0 {
                return Ok(count);
            }
        }
    }
}

impl ReadReady for Port {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(with_receiver(|receiver| !receiver.queue.is_empty()).unwrap_or(false))
    }
}

impl Write for Port {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        for &byte in bytes {
            // The only error is a full register, which ends on its own.
            while self.tx.write(byte).is_err() {}
        }
        Ok(bytes.len())
    }

    /// Waits until the last bit was sent (flag TC). An empty register is not enough to change the direction.
    fn flush(&mut self) -> Result<(), Infallible> {
        while self.tx.flush().is_err() {}
        Ok(())
    }
}
