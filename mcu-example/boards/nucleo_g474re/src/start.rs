//! Clocks, and why the firmware starts.

use board_shared::{guard_stack, take_note};
use embassy_stm32::rcc::{
    Hse, HseMode, Pll, PllMul, PllPreDiv, PllRDiv, PllSource, Sysclk, mux::Fdcansel,
};
use embassy_stm32::time::Hertz;
use embassy_stm32::{Config, Peripherals, pac};
use myactuator_mcu_example::RestartCause;

/// The core's clock.
pub(crate) const CORE_HZ: u32 = 170_000_000;

/// Guards the stack and sets up the clocks. Call it first, and once.
///
/// Waits for ever if the board's crystal does not start.
pub fn start() -> (Peripherals, RestartCause) {
    let cause = restart_cause();
    if let Some(mut core) = cortex_m::Peripherals::take() {
        // Below RAM there is ST's boot loader, which a write does not have to fault on.
        guard_stack(&mut core.MPU);
    }
    let mut config = Config::default();
    config.rcc.hse = Some(Hse { freq: Hertz(24_000_000), mode: HseMode::Oscillator });
    config.rcc.pll = Some(Pll {
        source: PllSource::HSE,
        prediv: PllPreDiv::DIV6,
        mul: PllMul::MUL85,
        divp: None,
        divq: None,
        divr: Some(PllRDiv::DIV2),
    });
    config.rcc.sys = Sysclk::PLL1_R;
    // Needed above 150 MHz.
    config.rcc.boost = true;
    // Straight from the crystal: its 24 MHz divide by 1 Mbit/s, 170 MHz divided by ten quanta do not.
    config.rcc.mux.fdcansel = Fdcansel::HSE;
    (embassy_stm32::init(config), cause)
}

/// What the controller's flags and the note of the firmware before say. Both are used up by it.
fn restart_cause() -> RestartCause {
    let flags = pac::RCC.csr().read();
    pac::RCC.csr().modify(|csr| csr.set_rmvf(true));
    match take_note() {
        Some(cause) => cause,
        None if flags.iwdgrstf() => RestartCause::Watchdog,
        None => RestartCause::Power,
    }
}
