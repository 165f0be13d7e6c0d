//! Button, light, watchdog and log.

use core::fmt;

use embassy_stm32::Peri;
use embassy_stm32::gpio::{Input, Level, Output, Pull, Speed};
use embassy_stm32::peripherals::{IWDG, PA5, PC13};
use embassy_stm32::wdg::IndependentWatchdog;
use myactuator_mcu_example::{Board, Report, Usage};

use crate::{fdcan, serial};

/// The watchdog's time-out. Its oscillator is off by up to 5 %.
const WATCHDOG_MICROS: u32 = 200_000;

/// What the board has besides its bus.
pub struct Nucleo {
    button: Input<'static>,
    light: Output<'static>,
    watchdog: IndependentWatchdog<'static, IWDG>,
}

impl Nucleo {
    /// The blue button B1, the green light LD2, and the watchdog, which runs from now on.
    pub fn new(
        button: Peri<'static, PC13>,
        light: Peri<'static, PA5>,
        watchdog: Peri<'static, IWDG>,
    ) -> Self {
        let mut watchdog = IndependentWatchdog::new(watchdog, WATCHDOG_MICROS);
        watchdog.unleash();
        Self {
            // On this board a pressed button connects the pin to the supply.
            button: Input::new(button, Pull::Down),
            light: Output::new(light, Level::Low, Speed::Low),
            watchdog,
        }
    }
}

impl fmt::Debug for Nucleo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Nucleo").finish_non_exhaustive()
    }
}

impl Board for Nucleo {
    fn is_button_down(&mut self) -> bool {
        self.button.is_high()
    }

    fn set_light(&mut self, on: bool) {
        self.light.set_level(on.into());
    }

    fn feed_watchdog(&mut self) {
        self.watchdog.pet();
    }

    fn log(&mut self, report: &Report) {
        defmt::info!("{}", report);
    }

    /// Of the bus that is open. The other has nothing to report.
    fn usage(&mut self) -> Usage {
        let can = fdcan::usage();
        Usage {
            stack: board_shared::stack_used(),
            queued: can.queued,
            dropped: can.dropped + serial::dropped(),
        }
    }
}
