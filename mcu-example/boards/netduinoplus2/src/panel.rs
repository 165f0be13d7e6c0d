//! The panel on USART2: one byte in each direction for each event.

use core::hint::black_box;

use cortex_m::peripheral::SCB;
use stm32f4xx_hal::gpio::{PA2, PA3};
use stm32f4xx_hal::pac::USART2;
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::Rcc;
use stm32f4xx_hal::serial::{Config, Serial};

/// A button, a light, and ways to break the firmware.
///
/// Input: `B` the button goes down, `b` it comes up; `p` panic, `f` fault, `h` hang with interrupts off, `o` overflow
/// the stack, `x` an exception that has no handler. Output: `L` the light goes on, `l` it goes off.
#[expect(missing_debug_implementations, reason = "the HAL's USART has none")]
pub struct Panel {
    serial: Serial<USART2>,
    is_down: bool,
    is_on: bool,
}

impl Panel {
    /// Opens it, with the button up and the light off. `None` if the USART's clock does not allow its bit rate.
    pub fn open(usart: USART2, pins: (PA2, PA3), rcc: &mut Rcc) -> Option<Self> {
        let config = Config::default().baudrate(115_200.bps());
        let serial = Serial::new(usart, pins, config, rcc).ok()?;
        Some(Self { serial, is_down: false, is_on: false })
    }

    /// Carries out what came in, and returns whether the button is down.
    pub(crate) fn look(&mut self) -> bool {
        while let Ok(byte) = self.serial.read() {
            match byte {
                b'B' => self.is_down = true,
                b'b' => self.is_down = false,
                b'p' => panic!("the panel asked for it"),
                b'f' => board_emulated::fault(),
                b'h' => hang(),
                b'o' => overflow(0),
                b'x' => SCB::set_pendsv(),
                _ => {}
            }
        }
        self.is_down
    }

    /// Reports the light if it changes.
    pub(crate) fn show(&mut self, on: bool) {
        // If the register is full, which does not happen here, the light is reported in the next cycle.
        if on != self.is_on && self.serial.write(if on { b'L' } else { b'l' }).is_ok() {
            self.is_on = on;
        }
    }
}

fn hang() -> ! {
    cortex_m::interrupt::disable();
    loop {
        core::hint::spin_loop();
    }
}

#[inline(never)]
#[expect(unconditional_recursion, reason = "until the stack is used up")]
fn overflow(depth: u32) {
    let frame = black_box([depth; 16]);
    overflow(frame[0].wrapping_add(1));
    black_box(frame);
}
