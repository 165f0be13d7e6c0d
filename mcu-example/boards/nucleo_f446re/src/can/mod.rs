//! CAN1 on PB9 (TX) and PB8 (RX), at 1 Mbit/s.
//!
//! | module | what it is |
//! |---|---|
//! | `receive` | what comes, by interrupt |
//! | `mailboxes` | what goes, in the order in which it was asked for |
//! | `port` | both as `embedded_can::nb::Can` |
//! | `run` | the application on it, and its end |

mod mailboxes;
mod port;
mod receive;
mod run;

pub use port::{CanError, CanPort};
pub(crate) use receive::{can_usage, take_can_errors};
pub use run::{end_on_can, run_can};

use board_stm32f4::TimeBase;
use bxcan::{Fifo, Interrupt, filter::Mask32};
use stm32f4xx_hal::can::CanExt as _;
use stm32f4xx_hal::gpio::{PB8, PB9};
use stm32f4xx_hal::pac::CAN1;
use stm32f4xx_hal::rcc::Rcc;

use self::mailboxes::Mailboxes;

/// 45 MHz / 3 / (1 + 12 + 2) = 1 Mbit/s, sampled after 13 of 15 parts of a bit.
const BIT_TIMING: u32 = bit_timing(3, 12, 2);

/// The bit timing register holds each of these less one. It synchronises by up to one part of a bit.
const fn bit_timing(divider: u32, before: u32, after: u32) -> u32 {
    (divider - 1) | (before - 1) << 16 | (after - 1) << 20
}

/// Opens the controller. It does not wait for a bus that is missing or busy: the controller joins as soon as it can,
/// also after bus-off.
pub fn open_can(can: CAN1, pins: (PB9, PB8), rcc: &mut Rcc, time: TimeBase) -> CanPort {
    let builder = bxcan::Can::builder(can.can(pins, rcc)).set_bit_timing(BIT_TIMING);
    let mut can = builder.leave_disabled();
    can.modify_filters().enable_bank(0, Fifo::Fifo0, Mask32::accept_all());
    can.enable_interrupt(Interrupt::Fifo0MessagePending);
    // Not an error: it reports that the controller has not joined yet.
    let _ = can.enable_non_blocking();
    let (tx, rx, _) = can.split();
    receive::begin(rx);
    CanPort::new(Mailboxes::new(tx), time)
}
