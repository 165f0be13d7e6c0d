//! The last frames of a firmware that cannot go on. They are sent by polling registers: no interrupt, no lock, no heap,
//! and in a bounded time.

use core::sync::atomic::Ordering;

use board_shared::{cause_of_end, on_fresh_stack, restart};
use cortex_m::asm;
use embassy_stm32::pac;
use embedded_can::{Frame as _, Id};
use myactuator_protocol_core::Packet;
use myactuator_protocol_core::wire::{can, rs485};

use crate::start::CORE_HZ;
use crate::{fdcan, motors, serial};

/// The time that a debugger needs to fetch the end of the log: the restart begins a new one.
const FETCH_MICROS: u32 = 50_000;

// panic-probe logs a panic, and ends in a fault. Two errors in one word of the flash raise the non-maskable interrupt,
// which has no handler.
on_fresh_stack!(HardFault, DefaultHandler => end);

extern "C" fn end(at: u32) -> ! {
    let mut mouth = Mouth::Closed;
    restart(cause_of_end(at), motors(), |packet| mouth.say(packet), || pause(FETCH_MICROS))
}

/// Where the last words are sent.
enum Mouth {
    /// Nothing was sent yet.
    Closed,
    Can,
    Rs485,
    /// No bus was set up, or it takes nothing.
    Mute,
}

impl Mouth {
    fn say(&mut self, packet: &Packet) {
        if matches!(self, Self::Closed) {
            *self = Self::open();
        }
        let is_said = match self {
            Self::Can => say_on_can(packet),
            Self::Rs485 => say_on_rs485(packet),
            Self::Closed | Self::Mute => false,
        };
        if !is_said {
            *self = Self::Mute;
        }
    }

    fn open() -> Self {
        // Everything takes less than the watchdog's time-out, counted from here.
        pac::IWDG.kr().write(|w| w.set_key(pac::iwdg::vals::Key::RESET));
        if fdcan::TAKES_PART.load(Ordering::Relaxed) {
            // Pending frames may still be sent, but not later than this. A controller that is off is let back onto the
            // bus.
            if fdcan::is_off() || !wait_for(2_000, is_queue_empty) {
                fdcan::discard_pending();
            }
            Self::Can
        } else if serial::IS_SET_UP.load(Ordering::Relaxed) {
            // Waits for the rest of a command, and for its answer.
            wait_for(2_000, is_all_sent);
            pause(ANSWER_MICROS);
            Self::Rs485
        } else {
            Self::Mute
        }
    }
}

/// Sends a packet through the first free place of the transmit queue, and waits until it was sent.
fn say_on_can(packet: &Packet) -> bool {
    /// Words for each place of the queue.
    const PLACE: usize = 18;
    const LAST_PLACE: u8 = 2;

    let Some(frame) = can::encode::<can::SimpleFrame>(packet) else { return false };
    let Id::Standard(id) = frame.id() else { return false };
    let [a, b, c, d, e, f, g, h] = packet.data;
    let words = [
        u32::from(id.as_raw()) << 18,
        8 << 16,
        u32::from_le_bytes([a, b, c, d]),
        u32::from_le_bytes([e, f, g, h]),
    ];
    let place = usize::from(pac::FDCAN1.txfqs().read().tfqpi().min(LAST_PLACE));
    for (i, word) in words.into_iter().enumerate() {
        pac::FDCANRAM1.txbuf(place * PLACE + i).write_value(word);
    }
    pac::FDCAN1.txbar().write(|w| w.set_ar(place, true));
    wait_for(5_000, is_queue_empty)
}

fn is_queue_empty() -> bool {
    pac::FDCAN1.txbrp().read().0 == 0
}

/// A drive's answer: 0.8 ms until it comes, 1.2 ms for its bytes, and a margin.
const ANSWER_MICROS: u32 = 3_000;

/// Sends a packet, and leaves the drive time to answer.
fn say_on_rs485(packet: &Packet) -> bool {
    let Some(frame) = rs485::Frame::from_packet(packet) else { return false };
    let is_sent = frame.encode().into_iter().all(|byte| {
        let has_place = wait_for(1_000, || pac::USART1.isr().read().txe());
        pac::USART1.tdr().write(|w| w.set_dr(byte.into()));
        has_place
    });
    // A byte that was written was not sent yet, and its flag may take a moment to show that.
    pause(10);
    let is_sent = is_sent && wait_for(2_000, is_all_sent);
    pause(ANSWER_MICROS);
    is_sent
}

fn is_all_sent() -> bool {
    pac::USART1.isr().read().tc()
}

/// Polls for this long, by the clock that [`start`](crate::start()) sets up; longer if the clock is slow.
fn wait_for(micros: u32, mut is_so: impl FnMut() -> bool) -> bool {
    (0..micros).any(|_| {
        let is_so = is_so();
        if !is_so {
            pause(1);
        }
        is_so
    })
}

fn pause(micros: u32) {
    asm::delay(micros * (CORE_HZ / 1_000_000));
}
