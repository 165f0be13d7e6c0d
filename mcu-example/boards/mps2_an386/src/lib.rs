//! The firmware on an emulated board: QEMU's machine mps2-an386, a Cortex-M4F with Arm's Cortex-M System
//! Design Kit around it.
//!
//! `cargo emulate mps2_an386 --bin rs485` runs it, as do `can`, `rs485_async` and `can_async`. Its UARTs stand for
//! wires:
//!
//! | UART | what is on it |
//! |---|---|
//! | 0 | the RS485 line |
//! | 1 | an SLCAN adapter, and CAN behind it |
//! | 2 | the panel: see [`Mps2`] |
//!
//! The log is defmt's, rzcobs-encoded, by semihosting.
#![no_std]

mod board;
mod clock;
mod device;
mod ending;
mod executor;
mod slcan;
mod tasks;
mod uart;
mod watchdog;

use cortex_m::singleton;
use myactuator_mcu_example::{RestartCause, Setup};

pub use board::Mps2;
pub use clock::Clock;
pub use device::UartId;
pub use ending::Bus;
pub use executor::run;
pub use slcan::Slcan;
pub use uart::{Queues, Stalled, Uart};

use watchdog::Watchdog;

/// The bit rate to an SLCAN adapter: the highest that this UART has.
pub const SLCAN_LINE_RATE: u32 = 1_562_500;
const PANEL_RATE: u32 = 115_200;

/// What a program gets at its start.
#[derive(Debug)]
pub struct Parts {
    /// Why the firmware starts.
    pub cause: RestartCause,
    /// The time.
    pub clock: Clock,
    /// The UART of its bus.
    pub uart: Uart,
    /// Button, light, watchdog and log.
    pub board: Mps2,
}

/// Starts what every program here needs. Call it first, and once.
///
/// From here on the watchdog runs, and the end of the program stops this setup's motors on this bus, whatever its
/// cause.
pub fn start(bus: Bus, bit_rate: u32, setup: &Setup) -> Parts {
    let cause = board_shared::take_note().unwrap_or(RestartCause::Power);
    if let Some(mut core) = cortex_m::Peripherals::take() {
        // Below RAM there is a device that accepts any access and does nothing.
        board_shared::guard_stack(&mut core.MPU);
    }
    let clock = Clock::start();
    let queues = singleton!(: Queues = Queues::new()).expect("called once");
    let uart = Uart::start(bus.uart(), bit_rate, clock, queues);
    let queues = singleton!(: Queues = Queues::new()).expect("called once");
    let panel = Uart::start(UartId::Uart2, PANEL_RATE, clock, queues);
    ending::prepare_last_words(bus, setup.search, clock);
    Parts { cause, clock, uart, board: Mps2::new(panel, bus.uart(), Watchdog::start()) }
}
