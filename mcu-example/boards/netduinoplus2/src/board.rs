//! Clock, line and panel.

use board_stm32f4::{Line, TimeBase, TimerClocks, line_usage, open_line};
use myactuator_mcu_example::{Board, Report, RestartCause, Usage};
use stm32f4xx_hal::pac;
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::Config;

use crate::panel::Panel;

/// Bit rate of the line, bit/s.
pub const BIT_RATE: u32 = 1_000_000;
/// The clock of the emulator's timers, whatever the clock controller is set to.
const TIMER_CLOCKS: TimerClocks = TimerClocks { tim2: 1_000, systick: 168 };

/// What a program here works with.
#[expect(missing_debug_implementations, reason = "the HAL's half of a USART has none")]
pub struct Hardware {
    /// The RS485 line.
    pub line: Line,
    /// The time.
    pub time: TimeBase,
    /// Button and light.
    pub panel: Panel,
    /// Why the firmware started.
    pub cause: RestartCause,
}

/// Sets everything up. Call it once.
///
/// # Panics
/// If it is called twice.
pub fn start() -> Hardware {
    let cause = board_shared::take_note().unwrap_or(RestartCause::Power);
    let core = cortex_m::Peripherals::take().expect("start is called once");
    let chip = pac::Peripherals::take().expect("start is called once");
    let mut rcc = chip.RCC.freeze(Config::hsi());
    let time = TimeBase::start(chip.TIM2, core.SYST, &mut rcc, TIMER_CLOCKS);
    let pins = chip.GPIOA.split(&mut rcc);
    let line = open_line(chip.USART1, (pins.pa9, pins.pa10, pins.pa8), BIT_RATE, &mut rcc, time)
        .expect("16 MHz carry 1 Mbit/s");
    let panel = Panel::open(chip.USART2, (pins.pa2, pins.pa3), &mut rcc)
        .expect("16 MHz carry 115200 bit/s");
    Hardware { line, time, panel, cause }
}

impl Board for Panel {
    fn is_button_down(&mut self) -> bool {
        self.look()
    }

    fn set_light(&mut self, on: bool) {
        self.show(on);
    }

    /// There is no watchdog.
    fn feed_watchdog(&mut self) {}

    fn log(&mut self, report: &Report) {
        board_stm32f4::log(report);
    }

    fn usage(&mut self) -> Usage {
        Usage { stack: board_shared::stack_used(), ..line_usage() }
    }
}
