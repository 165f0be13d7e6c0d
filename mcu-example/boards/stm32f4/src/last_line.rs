//! The RS485 line of a firmware that cannot go on, by the USART's registers alone.

use myactuator_protocol_core::Packet;
use myactuator_protocol_core::wire::rs485::Frame;
use stm32f4xx_hal::pac::{GPIOA, USART1, gpioa, usart1};

use crate::time::Countdown;

/// A byte at 115200 bit/s takes 87 µs.
const BYTE_MICROS: u32 = 200;
/// The time that a drive needs to answer: 0.9 ms and, at 115200 bit/s, another 1.1 ms for the frame.
const ANSWER_MICROS: u32 = 3_000;

/// The line, taken from its owner.
pub(crate) struct LastLine {
    usart: &'static usart1::RegisterBlock,
    port: &'static gpioa::RegisterBlock,
}

impl LastLine {
    /// Takes the line for good, and waits until what was being sent is over.
    pub(crate) fn take() -> Self {
        cortex_m::interrupt::disable();
        // SAFETY: the registers are there at all times. Interrupts are off, and the firmware does not go on where it
        // used them, so nothing else does.
        let line = unsafe { Self { usart: &*USART1::ptr(), port: &*GPIOA::ptr() } };
        if line.is_open() {
            line.wait_for(is_done);
            line.direct(false);
            line.leave_time();
        }
        line
    }

    /// Sends a packet, and leaves the drive time to answer. Gives up on a USART that does not send.
    pub(crate) fn send(&mut self, packet: &Packet) {
        let Some(frame) = Frame::from_packet(packet) else { return };
        if !self.is_open() {
            return;
        }
        self.direct(true);
        for byte in frame.encode() {
            self.wait_for(|usart| usart.sr().read().txe().bit_is_set());
            self.usart.dr().write(|w| w.dr().set(byte.into()));
        }
        self.wait_for(is_done);
        self.direct(false);
        self.leave_time();
    }

    /// A USART without a clock reads as zero.
    fn is_open(&self) -> bool {
        self.usart.cr1().read().ue().bit_is_set()
    }

    /// The transceiver's direction.
    fn direct(&self, is_sending: bool) {
        if is_sending {
            self.port.bsrr().write(|w| w.bs8().set_bit());
        } else {
            self.port.bsrr().write(|w| w.br8().set_bit());
        }
    }

    /// For a drive to answer.
    fn leave_time(&self) {
        Countdown::of_micros(ANSWER_MICROS).wait_unless(|| false);
    }

    fn wait_for(&self, is_so: impl Fn(&usart1::RegisterBlock) -> bool) {
        Countdown::of_micros(BYTE_MICROS).wait_unless(|| is_so(self.usart));
    }
}

fn is_done(usart: &usart1::RegisterBlock) -> bool {
    usart.sr().read().tc().bit_is_set()
}
