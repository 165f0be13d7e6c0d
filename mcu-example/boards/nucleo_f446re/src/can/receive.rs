//! Receiving: an interrupt moves frames from the controller's three places into a queue.

use core::cell::RefCell;
use core::mem;

use board_stm32f4::wake;
use bxcan::{Frame, Rx0};
use cortex_m::interrupt::{Mutex, free};
use cortex_m::peripheral::NVIC;
use heapless::Deque;
use myactuator_mcu_example::Usage;
use stm32f4xx_hal::can::Can;
use stm32f4xx_hal::pac::{self, CAN1, interrupt};

/// Room in the queue: what a full bus brings in 4 ms.
const QUEUE: usize = 32;

/// Frames that were lost since the last call. To the master each is a reply that did not come, and does not mean that
/// the bus is down.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, defmt::Format)]
pub(crate) struct CanErrors {
    /// How often the controller had no place free.
    overruns: u32,
    /// How many found the queue full, or have a length code above eight.
    dropped: u32,
}

impl CanErrors {
    /// Whether there were none.
    pub(crate) fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

struct Receiver {
    fifo: Rx0<Can<CAN1>>,
    queue: Deque<Frame, QUEUE>,
    errors: CanErrors,
    /// The most frames that were queued.
    most: usize,
    /// All frames that were ever lost.
    dropped: u32,
}

static RECEIVER: Mutex<RefCell<Option<Receiver>>> = Mutex::new(RefCell::new(None));

fn with_receiver<T>(work: impl FnOnce(&mut Receiver) -> T) -> Option<T> {
    free(|cs| RECEIVER.borrow(cs).borrow_mut().as_mut().map(work))
}

/// Begins to receive frames.
pub(super) fn begin(fifo: Rx0<Can<CAN1>>) {
    let receiver =
        Receiver { fifo, queue: Deque::new(), errors: CanErrors::default(), most: 0, dropped: 0 };
    free(|cs| RECEIVER.borrow(cs).replace(Some(receiver)));
    // SAFETY: no critical section relies on this interrupt being masked.
    unsafe { NVIC::unmask(pac::Interrupt::CAN1_RX0) };
}

/// The next frame.
pub(super) fn take() -> Option<Frame> {
    with_receiver(|receiver| {
        receiver.most = receiver.most.max(receiver.queue.len());
        receiver.queue.pop_front()
    })
    .flatten()
}

/// What was lost since the last call.
pub(crate) fn take_can_errors() -> CanErrors {
    with_receiver(|receiver| mem::take(&mut receiver.errors)).unwrap_or_default()
}

/// The controller's part of the board's usage, in frames.
pub(crate) fn can_usage() -> Usage {
    let usage = |receiver: &mut Receiver| Usage {
        queued: receiver.most as u32,
        dropped: receiver.dropped,
        ..Usage::default()
    };
    with_receiver(usage).unwrap_or_default()
}

/// Drops the controller's first frame if its length code is above eight, and returns whether it was. Such a frame has
/// eight bytes, but no drive and no master sends it, and `Frame` panics when it is asked for its data.
fn drop_too_long() -> bool {
    // SAFETY: the registers are there at all times. The one that is written here is otherwise written by this interrupt
    // alone.
    let registers = unsafe { &*CAN1::ptr() };
    let is_any = registers.rf0r().read().fmp().bits() > 0;
    let is_too_long = is_any && registers.rx(0).rdtr().read().dlc().bits() > 8;
    if is_too_long {
        registers.rf0r().write(|w| w.rfom().set_bit());
    }
    is_too_long
}

#[interrupt]
fn CAN1_RX0() {
    with_receiver(|receiver| {
        loop {
            let counter = if drop_too_long() {
                &mut receiver.errors.dropped
            } else {
                match receiver.fifo.receive() {
                    Ok(frame) => match receiver.queue.push_back(frame) {
                        Ok(()) => continue,
                        Err(_) => &mut receiver.errors.dropped,
                    },
                    // Reading it has cleared it.
                    Err(nb::Error::Other(_)) => &mut receiver.errors.overruns,
                    Err(nb::Error::WouldBlock) => break,
                }
            };
            *counter = counter.saturating_add(1);
            receiver.dropped = receiver.dropped.saturating_add(1);
        }
    });
    wake();
}
