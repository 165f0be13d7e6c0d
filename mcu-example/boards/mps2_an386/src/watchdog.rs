//! The watchdog.

use tock_registers::interfaces::Writeable;

use crate::device::{CLOCK_HZ, WatchdogControl, watchdog};

/// It bites after so long: the non-maskable interrupt comes, which ends the firmware. Should even that
/// hang, the same time again is left until the reset.
const BITES_AFTER_MS: u32 = 200;
const UNLOCKED: u32 = 0x1ACC_E551;
const LOCKED: u32 = 0;

/// The running watchdog.
#[derive(Debug)]
pub(crate) struct Watchdog(());

impl Watchdog {
    /// Nothing but a reset stops it again.
    pub(crate) fn start() -> Self {
        let registers = watchdog();
        registers.lock.set(UNLOCKED);
        registers.load.set(CLOCK_HZ / 1_000 * BITES_AFTER_MS);
        registers.control.write(WatchdogControl::INTERRUPT::SET + WatchdogControl::RESET::SET);
        registers.lock.set(LOCKED);
        Self(())
    }

    /// Begins its time again.
    pub(crate) fn feed(&mut self) {
        // Locked at all other times, so that a program that runs wild does not feed it.
        watchdog().lock.set(UNLOCKED);
        watchdog().clear.set(0);
        watchdog().lock.set(LOCKED);
    }
}
