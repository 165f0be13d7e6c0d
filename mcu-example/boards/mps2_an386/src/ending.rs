//! The last words, and the exceptions that lead to them.

use core::cell::Cell;

use board_shared::{cause_of_end, on_fresh_stack, restart};
use critical_section::Mutex;
use myactuator_mcu_example::RestartCause;
use myactuator_protocol_core::Packet;
use myactuator_protocol_core::io::Clock as _;
use myactuator_protocol_core::master::MotorSet;
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::wire::can::SimpleFrame;
use myactuator_protocol_core::wire::rs485;
use tock_registers::interfaces::{Readable, Writeable};

use crate::clock::Clock;
use crate::device::{UartControl, UartId, UartState};
use crate::slcan;

/// The kinds of bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bus {
    /// An RS485 line on UART 0.
    Rs485,
    /// CAN behind an SLCAN adapter on UART 1.
    Slcan,
}

impl Bus {
    /// Its UART.
    pub const fn uart(self) -> UartId {
        match self {
            Self::Rs485 => UartId::Uart0,
            Self::Slcan => UartId::Uart1,
        }
    }

    /// How long to wait after a command for the motor's answer, where both share a line. As long as the master waits.
    const fn pause(self) -> Duration {
        match self {
            Self::Rs485 => Duration::from_millis(5),
            Self::Slcan => Duration::ZERO,
        }
    }
}

#[derive(Clone, Copy)]
struct LastWords {
    bus: Bus,
    motors: MotorSet,
    clock: Clock,
}

static LAST_WORDS: Mutex<Cell<Option<LastWords>>> = Mutex::new(Cell::new(None));

/// From here on, the end of the firmware first stops these motors on this bus, whatever its cause.
pub(crate) fn prepare_last_words(bus: Bus, motors: MotorSet, clock: Clock) {
    let words = LastWords { bus, motors, clock };
    critical_section::with(|cs| LAST_WORDS.borrow(cs).set(Some(words)));
}

fn end(cause: RestartCause) -> ! {
    let words = critical_section::with(|cs| LAST_WORDS.borrow(cs).get());
    let Some(LastWords { bus, motors, clock }) = words else {
        restart(cause, MotorSet::EMPTY, |_| {}, || {});
    };
    let mut voice = Voice::new(bus, clock);
    restart(cause, motors, |packet| voice.say(packet), || {})
}

/// Sends without interrupts.
struct Voice {
    bus: Bus,
    clock: Clock,
    has_begun: bool,
    /// The UART has taken nothing for too long.
    is_stuck: bool,
}

/// A UART that takes no byte for this long is given up: a hundred times what one byte takes.
const LONGEST_BYTE: Duration = Duration::from_millis(1);

impl Voice {
    fn new(bus: Bus, clock: Clock) -> Self {
        Self { bus, clock, has_begun: false, is_stuck: false }
    }

    fn say(&mut self, packet: &Packet) {
        if !core::mem::replace(&mut self.has_begun, true) {
            self.begin();
        }
        match self.bus {
            Bus::Rs485 => {
                if let Some(frame) = rs485::Frame::from_packet(packet) {
                    self.write(&frame.encode());
                }
            }
            Bus::Slcan => self.write(&slcan::line(&SimpleFrame::from_packet(packet))),
        }
        self.clock.wait(self.bus.pause());
    }

    /// What was being sent is cut off in the middle. Drives and adapter have to see its end.
    fn begin(&mut self) {
        self.bus
            .uart()
            .registers()
            .control
            .write(UartControl::TX_ENABLE::SET + UartControl::RX_ENABLE::SET);
        match self.bus {
            Bus::Rs485 => self.clock.wait(self.bus.pause()),
            Bus::Slcan => self.write(b"\r"),
        }
    }

    fn write(&mut self, bytes: &[u8]) {
        let registers = self.bus.uart().registers();
        for &byte in bytes {
            let until = self.clock.now() + LONGEST_BYTE;
            while registers.state.is_set(UartState::TX_FULL) && !self.is_stuck {
                self.is_stuck = self.clock.now() > until;
            }
            if self.is_stuck {
                return;
            }
            registers.data.set(byte.into());
        }
    }
}

/// Runs after a panic, which panic-probe has logged, after a fault, and after an exception without a handler.
extern "C" fn unexpected(at: u32) -> ! {
    end(cause_of_end(at))
}

/// When the watchdog ends the first time, it raises the non-maskable interrupt.
extern "C" fn not_fed(_: u32) -> ! {
    end(RestartCause::Watchdog)
}

on_fresh_stack!(HardFault, DefaultHandler => unexpected);
on_fresh_stack!(NonMaskableInt => not_fed);
