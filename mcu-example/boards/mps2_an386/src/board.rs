//! Button, light, watchdog and log.

use core::hint::black_box;

use cortex_m::peripheral::SCB;
use myactuator_mcu_example::{Board, Report, Usage};

use crate::device::UartId;
use crate::uart::{Uart, received_on};
use crate::watchdog::Watchdog;

/// The board without its bus. Button and light are a panel on UART 2, with one byte for each change: `B` the button
/// goes down, `b` it comes up; `L` the light is on, `l` it is off.
///
/// Other bytes break the firmware: `p` panics, `f` faults, `h` hangs with interrupts off, `o` overflows the stack, `x`
/// raises an exception that has no handler.
#[derive(Debug)]
pub struct Mps2 {
    panel: Uart,
    bus: UartId,
    watchdog: Watchdog,
    is_button_down: bool,
    is_light_on: bool,
}

impl Mps2 {
    pub(crate) const fn new(panel: Uart, bus: UartId, watchdog: Watchdog) -> Self {
        Self { panel, bus, watchdog, is_button_down: false, is_light_on: false }
    }
}

impl Board for Mps2 {
    fn is_button_down(&mut self) -> bool {
        // One byte for each call, so that no press is missed that is over already.
        match self.panel.try_read() {
            Some(b'B') => self.is_button_down = true,
            Some(b'b') => self.is_button_down = false,
            Some(b'p') => panic!("the panel asked for it"),
            Some(b'f') => board_emulated::fault(),
            Some(b'h') => cortex_m::interrupt::free(|_| {
                loop {
                    cortex_m::asm::nop();
                }
            }),
            Some(b'o') => {
                overflow(0);
            }
            Some(b'x') => SCB::set_pendsv(),
            _ => {}
        }
        self.is_button_down
    }

    fn set_light(&mut self, on: bool) {
        // If the panel takes nothing now, it is told next time.
        if on != self.is_light_on && self.panel.try_write(if on { b"L" } else { b"l" }) == 1 {
            self.is_light_on = on;
        }
    }

    fn feed_watchdog(&mut self) {
        self.watchdog.feed();
    }

    fn log(&mut self, report: &Report) {
        defmt::info!("{}", report);
    }

    fn usage(&mut self) -> Usage {
        let (queued, dropped) = received_on(self.bus);
        Usage { stack: board_shared::stack_used(), queued, dropped }
    }
}

#[allow(unconditional_recursion, reason = "that is what it is for")]
#[inline(never)]
fn overflow(depth: u32) -> u32 {
    let frame = black_box([depth; 16]);
    overflow(depth + 1) + black_box(frame)[0]
}
