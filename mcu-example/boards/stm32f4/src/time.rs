//! Time, from timer TIM2: 32 bits of microseconds, which wrap after 71 minutes. SysTick wakes the processor at the end
//! of a pause.

use core::cell::{Cell, RefCell};
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::asm::wfi;
use cortex_m::interrupt::{Mutex, free};
use cortex_m::peripheral::{SYST, syst::SystClkSource};
use cortex_m_rt::exception;
use embedded_hal::delay::DelayNs;
use myactuator_protocol_core::io::Clock;
use myactuator_protocol_core::time::{Duration, Instant};
use stm32f4xx_hal::pac::{TIM2, tim2};
use stm32f4xx_hal::rcc::{Enable as _, Rcc, Reset as _};

/// The time when it was last read. It has to be read at least every 71 minutes; the loop always does.
static LAST_MICROS: Mutex<Cell<u64>> = Mutex::new(Cell::new(0));

/// Set when something has arrived that the loop has not processed.
static HAS_WORK: AtomicBool = AtomicBool::new(false);

/// What wakes the processor, once the time base has started.
static ALARM: Mutex<RefCell<Option<Alarm>>> = Mutex::new(RefCell::new(None));

struct Alarm {
    timer: SYST,
    ticks_a_microsecond: u32,
}

/// For a shorter pause, sleeping is not worth it.
const SHORTEST_SLEEP: Duration = Duration::from_micros(10);
/// SysTick counts 24 bits: 93 ms at 180 MHz.
const LONGEST_SLEEP: Duration = Duration::from_millis(50);

/// The clocks of the timers, in MHz.
#[derive(Clone, Copy, Debug)]
pub struct TimerClocks {
    /// TIM2.
    pub tim2: u32,
    /// SysTick, up to 300.
    pub systick: u32,
}

/// The time since the start: the loops' clock, and a blocking delay.
#[derive(Clone, Copy, Debug)]
pub struct TimeBase(());

impl TimeBase {
    /// Starts the timers.
    pub fn start(timer: TIM2, mut alarm: SYST, rcc: &mut Rcc, clocks: TimerClocks) -> Self {
        alarm.set_clock_source(SystClkSource::Core);
        alarm.enable_interrupt();
        let alarm = Alarm { timer: alarm, ticks_a_microsecond: clocks.systick };
        free(|cs| ALARM.borrow(cs).replace(Some(alarm)));

        TIM2::enable(rcc);
        TIM2::reset(rcc);
        timer.psc().write(|w| w.psc().set((clocks.tim2 - 1) as u16));
        timer.arr().write(|w| w.arr().set(u32::MAX));
        // The prescaler acts from the next update on.
        timer.egr().write(|w| w.ug().update());
        timer.cr1().write(|w| w.cen().enabled());
        Self(())
    }

    /// The time base. It stands still until it is started.
    pub(crate) const fn read() -> Self {
        Self(())
    }
}

impl Clock for TimeBase {
    fn now(&self) -> Instant {
        let micros = free(|cs| {
            let last = LAST_MICROS.borrow(cs);
            let passed = counter().wrapping_sub(last.get() as u32);
            last.set(last.get() + u64::from(passed));
            last.get()
        });
        Instant::from_micros(micros)
    }

    /// Sleeps until then, or until an interrupt.
    fn idle(&self, until: Instant) {
        let pause = until - self.now();
        if pause < SHORTEST_SLEEP {
            return;
        }
        let micros = pause.min(LONGEST_SLEEP).as_micros() as u32;
        // With interrupts off: otherwise one that comes before the processor sleeps would not wake it. While it sleeps
        // they still wake it, and run after this.
        free(|cs| {
            if HAS_WORK.swap(false, Ordering::Relaxed) {
                return;
            }
            if let Some(alarm) = ALARM.borrow(cs).borrow_mut().as_mut() {
                alarm.timer.set_reload(micros * alarm.ticks_a_microsecond);
                alarm.timer.clear_current();
                alarm.timer.enable_counter();
                wfi();
                alarm.timer.disable_counter();
            }
        });
    }
}

/// Nothing is left to do: the interrupt has woken the processor.
#[exception]
fn SysTick() {}

/// Something has arrived. An interrupt calls this, so that the loop checks before it sleeps.
pub fn wake() {
    HAS_WORK.store(true, Ordering::Relaxed);
}

impl DelayNs for TimeBase {
    fn delay_ns(&mut self, ns: u32) {
        Countdown::of_micros(ns.div_ceil(1_000)).wait_unless(|| false);
    }
}

/// A time that has to pass. It needs no interrupt, so a firmware that ends can use it, too.
#[derive(Clone, Copy, Debug)]
pub struct Countdown {
    since: u32,
    micros: u32,
}

impl Countdown {
    /// At least this many microseconds from now on.
    pub fn of_micros(micros: u32) -> Self {
        Self { since: counter(), micros }
    }

    /// Whether it has passed. It has if the time base was never started.
    pub fn is_over(self) -> bool {
        counter().wrapping_sub(self.since) > self.micros || !is_running()
    }

    /// Waits until it has passed or `is_done` returns true.
    pub fn wait_unless(self, is_done: impl Fn() -> bool) {
        while !is_done() && !self.is_over() {}
    }
}

fn counter() -> u32 {
    timer().cnt().read().cnt().bits()
}

/// A timer without a clock reads as zero.
fn is_running() -> bool {
    timer().cr1().read().cen().is_enabled()
}

fn timer() -> &'static tim2::RegisterBlock {
    // SAFETY: the registers are there at all times. Once the timer has started, only these two are read, which changes
    // nothing.
    unsafe { &*TIM2::ptr() }
}
