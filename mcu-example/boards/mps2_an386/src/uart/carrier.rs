//! What a UART's interrupts do.

use core::cell::RefCell;
use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m_rt::interrupt;
use critical_section::Mutex;
use heapless::spsc::{Consumer, Producer};
use tock_registers::interfaces::{Readable, Writeable};

use super::{RECEIVED, UNSENT};
use crate::clock::{something_has_happened, wake_emulator};
use crate::device::{UartId, UartInterrupts, UartState, interrupt};

/// The interrupts' ends of the queues.
pub(super) struct Carrier {
    received: Producer<'static, u8, RECEIVED>,
    unsent: Consumer<'static, u8, UNSENT>,
}

struct Port {
    carrier: Mutex<RefCell<Option<Carrier>>>,
    /// Received bytes that were not taken in time.
    lost: AtomicU32,
}

static PORTS: [Port; 3] =
    [const { Port { carrier: Mutex::new(RefCell::new(None)), lost: AtomicU32::new(0) } }; 3];

/// The most received bytes that were queued on each port. The interrupts do not touch this.
static MOST: [AtomicU32; 3] = [const { AtomicU32::new(0) }; 3];

const fn port(id: UartId) -> &'static Port {
    &PORTS[id as usize]
}

impl Carrier {
    pub(super) fn put_in_place(
        id: UartId,
        received: Producer<'static, u8, RECEIVED>,
        unsent: Consumer<'static, u8, UNSENT>,
    ) {
        critical_section::with(|cs| port(id).carrier.replace(cs, Some(Self { received, unsent })));
    }

    fn receive(&mut self, id: UartId) {
        let registers = id.registers();
        // Before the byte is taken, so that the next one's interrupt is not cleared with it.
        registers.interrupts.write(UartInterrupts::RX::SET);
        if registers.state.is_set(UartState::RX_FULL) {
            let is_taken = self.received.enqueue(registers.data.get() as u8).is_ok();
            count_lost(id, !is_taken);
        }
        if registers.state.is_set(UartState::RX_OVERRUN) {
            registers.state.write(UartState::RX_OVERRUN::SET);
            count_lost(id, true);
        }
    }

    fn send(&mut self, id: UartId) {
        let registers = id.registers();
        registers.interrupts.write(UartInterrupts::TX::SET);
        while !registers.state.is_set(UartState::TX_FULL) {
            let Some(byte) = self.unsent.dequeue() else { break };
            registers.data.set(byte.into());
        }
    }
}

fn count_lost(id: UartId, is_lost: bool) {
    port(id).lost.fetch_add(is_lost.into(), Ordering::Relaxed);
}

fn with(id: UartId, act: impl FnOnce(&mut Carrier)) {
    critical_section::with(|cs| {
        if let Some(carrier) = port(id).carrier.borrow_ref_mut(cs).as_mut() {
            act(carrier);
        }
    });
}

/// Notes how many received bytes are queued. The reader calls it before it takes bytes, so that it costs the interrupt
/// nothing.
pub(super) fn note_waiting(id: UartId, count: usize) {
    MOST[id as usize].fetch_max(count as u32, Ordering::Relaxed);
}

/// The most received bytes that were queued.
pub(super) fn most_waiting(id: UartId) -> u32 {
    MOST[id as usize].load(Ordering::Relaxed)
}

/// How many received bytes were lost.
pub(super) fn lost(id: UartId) -> u32 {
    port(id).lost.load(Ordering::Relaxed)
}

/// Gives the UART as many of the unsent bytes as it takes. The interrupts send the rest.
pub(super) fn carry(id: UartId) {
    with(id, |carrier| carrier.send(id));
}

/// Drops the unsent bytes.
pub(super) fn discard_unsent(id: UartId) {
    with(id, |carrier| while carrier.unsent.dequeue().is_some() {});
}

fn received(id: UartId) {
    with(id, |carrier| carrier.receive(id));
    something_has_happened();
    wake_emulator();
}

fn sent(id: UartId) {
    with(id, |carrier| carrier.send(id));
    something_has_happened();
}

#[interrupt]
fn UART0RX() {
    received(UartId::Uart0);
}

#[interrupt]
fn UART0TX() {
    sent(UartId::Uart0);
}

#[interrupt]
fn UART1RX() {
    received(UartId::Uart1);
}

#[interrupt]
fn UART1TX() {
    sent(UartId::Uart1);
}

#[interrupt]
fn UART2RX() {
    received(UartId::Uart2);
}

#[interrupt]
fn UART2TX() {
    sent(UartId::Uart2);
}
