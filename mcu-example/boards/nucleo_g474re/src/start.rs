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
/// Waits forever if the board's crystal does not start.
pub fn start() -> (Peripherals, RestartCause) {
    let cause = restart_cause();
    if let Some(mut core) = cortex_m::Peripherals::take() {
        // Below RAM is ST's boot loader, where a write need not fault.
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
    // Straight from the crystal: its 24 MHz can be divided to 1 Mbit/s, but 170 MHz cannot be divided to it with ten
    // quanta.
    config.rcc.mux.fdcansel = Fdcansel::HSE;
    (embassy_stm32::init(config), cause)
}

/// What the controller's flags and the last firmware's note say. Reading them clears both.
fn restart_cause() -> RestartCause {
    let flags = pac::RCC.csr().read();
    pac::RCC.csr().modify(|csr| csr.set_rmvf(true));
    match take_note() {
        Some(cause) => cause,
        None if flags.iwdgrstf() => RestartCause::Watchdog,
        None => RestartCause::Power,
    }
}
