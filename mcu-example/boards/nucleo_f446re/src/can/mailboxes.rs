//! Sending: the controller's three mailboxes, by their registers.
//!
//! bxcan is not used for this, since it sends by priority. A stop (0x141) would overtake a set-point of motion mode
//! (0x401), which would then move the motor again. The same command for motors 1, 2 and 3 would wait in the loop, one
//! for the other. Here frames are sent in the order in which they came.

use board_stm32f4::Countdown;
use bxcan::{Frame, Id, Tx};
use stm32f4xx_hal::can::Can;
use stm32f4xx_hal::pac::{CAN1, can1};

/// After this time a frame that is on the wire is over: it takes up to 135 µs at 1 Mbit/s.
const FRAME_MICROS: u32 = 200;

/// The mailboxes, and what the controller reports of the bus.
pub(super) struct Mailboxes {
    registers: &'static can1::RegisterBlock,
}

impl Mailboxes {
    /// The mailboxes of a controller by which nothing else sends.
    pub(super) fn new(_: Tx<Can<CAN1>>) -> Self {
        let mailboxes = Self::of_chip();
        mailboxes.registers.mcr().modify(|_, w| w.txfp().set_bit());
        mailboxes
    }

    /// The mailboxes, taken for good from a firmware that cannot go on.
    pub(super) fn take() -> Self {
        cortex_m::interrupt::disable();
        Self::of_chip()
    }

    fn of_chip() -> Self {
        // SAFETY: the registers are there at all times. Of those that are written here, only the controller's mode is
        // written elsewhere, and earlier: when it is opened. The owner of other `Mailboxes` does not go on.
        Self { registers: unsafe { &*CAN1::ptr() } }
    }

    /// Puts a frame into a free mailbox. Returns `false` if there is none.
    pub(super) fn send(&mut self, frame: &Frame) -> bool {
        let status = self.registers.tsr().read();
        let Some(free) = (0..3).find(|&mailbox| status.tme(mailbox).bit_is_set()) else {
            return false;
        };
        // All frames for motors have eight bytes and standard identifiers.
        let (Id::Standard(id), Some(data)) = (frame.id(), frame.data()) else { return true };
        let Ok(data) = <[u8; 8]>::try_from(&**data) else { return true };
        let data = u64::from_le_bytes(data);
        let mailbox = self.registers.tx(free.into());
        // SAFETY: any value may be written to these fields.
        unsafe {
            mailbox.tdtr().write(|w| w.dlc().bits(8));
            mailbox.tdlr().write(|w| w.bits(data as u32));
            mailbox.tdhr().write(|w| w.bits((data >> 32) as u32));
            mailbox.tir().write(|w| w.stid().bits(id.as_raw()).txrq().set_bit());
        }
        true
    }

    /// Takes back what was not sent yet, and waits until that is done.
    pub(super) fn abort(&mut self) {
        self.registers.tsr().write(|w| w.abrq0().set_bit().abrq1().set_bit().abrq2().set_bit());
        Countdown::of_micros(FRAME_MICROS).wait_unless(|| self.are_empty());
    }

    /// Whether all was sent.
    pub(super) fn are_empty(&self) -> bool {
        self.registers.tsr().read().tme_iter().all(|is_empty| is_empty.bit_is_set())
    }

    /// Whether the controller has left the bus after too many errors.
    pub(super) fn is_bus_off(&self) -> bool {
        self.registers.esr().read().boff().bit_is_set()
    }
}
