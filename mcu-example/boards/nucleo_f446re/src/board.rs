//! Clock and pins, button, light and watchdog.

use board_stm32f4::{TimeBase, TimerClocks, line_usage};
use defmt_rtt as _; // The output of the log.
use myactuator_mcu_example::{Board, Report, RestartCause, Usage};
use panic_probe as _; // Logs a panic, and ends in a fault.
use stm32f4xx_hal::gpio::{Input, Output, PA5, PA8, PA9, PA10, PB8, PB9, PC13};
use stm32f4xx_hal::pac::{self, CAN1, RCC, USART1};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::{Config, Rcc};
use stm32f4xx_hal::watchdog::IndependentWatchdog;

use crate::can::{can_usage, take_can_errors};

/// Bit rate of the RS485 line, bit/s.
pub const BIT_RATE: u32 = 115_200;
/// The watchdog's own oscillator has 17 to 47 kHz, nominally 32 kHz: so this is 136 to 376 ms.
const WATCHDOG_MS: u32 = 200;

/// What a program here works with: one of the buses, and the rest.
#[expect(missing_debug_implementations, reason = "the HAL's clocks have none")]
pub struct Hardware {
    /// The clocks.
    pub rcc: Rcc,
    /// The time.
    pub time: TimeBase,
    /// Button, light and watchdog. The watchdog is already running.
    pub board: Nucleo,
    /// Why the firmware started.
    pub cause: RestartCause,
    /// For RS485: TX, RX and direction.
    pub usart: (USART1, (PA9, PA10, PA8)),
    /// For CAN: TX and RX.
    pub can: (CAN1, (PB9, PB8)),
}

/// Sets everything up except the bus. Call it once.
///
/// # Panics
/// If it is called twice.
pub fn start() -> Hardware {
    let core = cortex_m::Peripherals::take().expect("start is called once");
    let chip = pac::Peripherals::take().expect("start is called once");
    let cause = take_cause(&chip.RCC);

    // The ST-LINK's 8 MHz come from a crystal. The chip's own oscillator is not exact enough for CAN.
    let clocks = Config::hse(8.MHz()).bypass_hse_oscillator();
    let clocks = clocks.sysclk(180.MHz()).pclk1(45.MHz()).pclk2(90.MHz());
    let mut rcc = chip.RCC.freeze(clocks);
    let timers =
        TimerClocks { tim2: rcc.clocks.timclk1().to_MHz(), systick: rcc.clocks.hclk().to_MHz() };
    let time = TimeBase::start(chip.TIM2, core.SYST, &mut rcc, timers);

    let a = chip.GPIOA.split(&mut rcc);
    let b = chip.GPIOB.split(&mut rcc);
    let c = chip.GPIOC.split(&mut rcc);
    // The log is read while the processor sleeps, too.
    chip.DBGMCU.cr().modify(|_, w| w.dbg_sleep().set_bit());
    let mut watchdog = IndependentWatchdog::new(chip.IWDG);
    // Otherwise a breakpoint would end in a reset.
    watchdog.stop_on_debug(&chip.DBGMCU, true);
    watchdog.start(WATCHDOG_MS.millis());
    let board =
        Nucleo { button: c.pc13.into_input(), light: a.pa5.into_push_pull_output(), watchdog };
    let usart = (chip.USART1, (a.pa9, a.pa10, a.pa8));
    let can = (chip.CAN1, (b.pb9, b.pb8));
    Hardware { rcc, time, board, cause, usart, can }
}

/// The cause that the firmware noted before it restarted itself, or that the chip reports. The chip's flags are
/// cleared, or they would be reported again after the next start.
fn take_cause(rcc: &RCC) -> RestartCause {
    let was_watchdog = rcc.csr().read().wdgrstf().bit_is_set();
    rcc.csr().modify(|_, w| w.rmvf().set_bit());
    let of_chip = if was_watchdog { RestartCause::Watchdog } else { RestartCause::Power };
    board_shared::take_note().unwrap_or(of_chip)
}

/// The board's blue button B1, its light LD2 and the independent watchdog.
#[derive(Debug)]
pub struct Nucleo {
    button: PC13<Input>,
    light: PA5<Output>,
    watchdog: IndependentWatchdog,
}

impl Board for Nucleo {
    /// The board pulls the pin up, and the button pulls it down.
    fn is_button_down(&mut self) -> bool {
        self.button.is_low()
    }

    fn set_light(&mut self, on: bool) {
        self.light.set_state(on.into());
    }

    fn feed_watchdog(&mut self) {
        self.watchdog.feed();
    }

    fn log(&mut self, report: &Report) {
        board_stm32f4::log(report);
        if let Report::Second { .. } = report {
            let errors = take_can_errors();
            if !errors.is_empty() {
                defmt::warn!("{}", errors);
            }
        }
    }

    /// Of the bus that is open. The other has nothing to report.
    fn usage(&mut self) -> Usage {
        let (line, can) = (line_usage(), can_usage());
        Usage {
            stack: board_shared::stack_used(),
            queued: line.queued + can.queued,
            dropped: line.dropped + can.dropped,
        }
    }
}
