//! The time, and sleeping until a given time.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m_rt::interrupt;
use myactuator_protocol_core::io;
use myactuator_protocol_core::time::{Duration, Instant};
use tock_registers::interfaces::{Readable, Writeable};

use crate::device::{
    CLOCK_HZ, Interrupt, TimerControl, TimerInterrupt, interrupt, timer0, timer1, unmask,
};
use crate::tasks;

const TICKS_A_MICRO: u32 = CLOCK_HZ / 1_000_000;
/// Timer 0 wraps after 2^27 microseconds, or 134 seconds: the most whole microseconds that fit its 32 bits, so that
/// reading the time takes no 64-bit division.
const WRAP_BITS: u32 = 27;
const RELOAD: u32 = (TICKS_A_MICRO << WRAP_BITS) - 1;

/// The shortest sleep, used if the time has come already. Then what is to be sent waits for a bus that takes nothing,
/// and an interrupt ends that. If the processor polled instead, the emulator would not serve the UART.
const SHORTEST_SLEEP: Duration = Duration::from_micros(50);
/// The longest sleep. Its ticks fit 32 bits.
const LONGEST_SLEEP: Duration = Duration::from_millis(100);

/// How often timer 0 has wrapped.
static WRAPS: AtomicU32 = AtomicU32::new(0);
/// Something has happened since the last check, so there may be something to do.
static HAS_HAPPENED: AtomicBool = AtomicBool::new(false);

defmt::timestamp!("{=u64:us}", io::Clock::now(&Clock(())).as_micros());

/// Microseconds since the start, from timer 0; timer 1 ends the sleep in [`idle`](io::Clock::idle).
///
/// It never goes back. It would lose 134 seconds if interrupts were off for that long, but the watchdog bites long
/// before.
#[derive(Clone, Copy, Debug)]
pub struct Clock(());

impl Clock {
    /// Starts the timers. Call it once.
    pub(crate) fn start() -> Self {
        let control = TimerControl::ENABLE::SET + TimerControl::INTERRUPT::SET;
        timer0().reload.set(RELOAD);
        timer0().value.set(RELOAD);
        timer0().control.write(control);
        // Timer 1 runs once for each value. The first has no use.
        timer1().reload.set(0);
        timer1().value.set(RELOAD);
        timer1().control.write(control);
        unmask(&[Interrupt::TIMER0, Interrupt::TIMER1]);
        Self(())
    }

    /// Has timer 1 wake the waiting task at this time at the latest.
    pub(crate) fn wake_by(self, until: Instant) {
        let span = (until - io::Clock::now(&self)).min(LONGEST_SLEEP);
        let ticks = (span.as_micros() as u32 * TICKS_A_MICRO).max(1);
        critical_section::with(|_| {
            let left = timer1().value.get();
            if left == 0 || left > ticks {
                timer1().value.set(ticks);
            }
        });
    }

    /// Waits without sleeping. Needs no interrupt.
    pub(crate) fn wait(self, span: Duration) {
        let until = io::Clock::now(&self) + span;
        while io::Clock::now(&self) < until {}
    }
}

impl io::Clock for Clock {
    fn now(&self) -> Instant {
        let (wraps, ticks_left) = critical_section::with(|_| {
            let ticks_left = timer0().value.get();
            let wraps = WRAPS.load(Ordering::Relaxed);
            if timer0().interrupt.is_set(TimerInterrupt::PENDING) {
                // It has wrapped, before or after it was read, and that was not counted yet.
                (wraps + 1, timer0().value.get())
            } else {
                (wraps, ticks_left)
            }
        });
        let micros = (RELOAD - ticks_left) / TICKS_A_MICRO;
        Instant::from_micros((u64::from(wraps) << WRAP_BITS) + u64::from(micros))
    }

    /// Sleeps until then, or until a byte comes or leaves. Sleeps for a moment even if the time has come already.
    fn idle(&self, until: Instant) {
        let span = (until - self.now()).clamp(SHORTEST_SLEEP, LONGEST_SLEEP);
        let ticks = span.as_micros() as u32 * TICKS_A_MICRO;
        // With interrupts off, so that none falls between the check and the sleep. A pending one still ends the sleep.
        critical_section::with(|_| {
            if !HAS_HAPPENED.swap(false, Ordering::Relaxed) {
                timer1().value.set(ticks);
                cortex_m::asm::wfi();
            }
        });
    }
}

/// Has the sleeping loop or task check again. For interrupts.
pub(crate) fn something_has_happened() {
    HAS_HAPPENED.store(true, Ordering::Relaxed);
    tasks::wake();
}

/// A byte was taken from a UART. QEMU offers the next one only when something wakes the thread that serves its devices.
/// A busy processor does not do that, but setting a timer does.
pub(crate) fn wake_emulator() {
    timer1().value.set(TICKS_A_MICRO);
}

#[interrupt]
fn TIMER0() {
    WRAPS.fetch_add(1, Ordering::Relaxed);
    timer0().interrupt.write(TimerInterrupt::PENDING::SET);
}

#[interrupt]
fn TIMER1() {
    timer1().interrupt.write(TimerInterrupt::PENDING::SET);
    tasks::wake();
}
