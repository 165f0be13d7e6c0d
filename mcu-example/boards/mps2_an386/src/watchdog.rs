//! The watchdog.

use tock_registers::interfaces::Writeable;

use crate::device::{CLOCK_HZ, WatchdogControl, watchdog};

/// After this time the watchdog raises the non-maskable interrupt, which ends the firmware. If even that hangs, a reset
/// follows after the same time again.
const BITES_AFTER_MS: u32 = 200;
const UNLOCKED: u32 = 0x1ACC_E551;
const LOCKED: u32 = 0;

/// The running watchdog.
#[derive(Debug)]
pub(crate) struct Watchdog(());

impl Watchdog {
    /// Starts it. Only a reset stops it again.
    pub(crate) fn start() -> Self {
        let registers = watchdog();
        registers.lock.set(UNLOCKED);
        registers.load.set(CLOCK_HZ / 1_000 * BITES_AFTER_MS);
        registers.control.write(WatchdogControl::INTERRUPT::SET + WatchdogControl::RESET::SET);
        registers.lock.set(LOCKED);
        Self(())
    }

    /// Restarts its time.
    pub(crate) fn feed(&mut self) {
        // It is locked at all other times, so that a program out of control does not feed it.
        watchdog().lock.set(UNLOCKED);
        watchdog().clear.set(0);
        watchdog().lock.set(LOCKED);
    }
}
