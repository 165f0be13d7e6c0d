//! What the RS485 line's receive interrupt costs, in instructions, from the processor's entry to its exit: once with
//! room for the byte, and once without, which is its longest path. `.ci/cycles` runs it, with bytes that arrive on UART
//! 0 and with time that counts instructions: one takes 64 ns, and SysTick counts 40 ns.
#![no_std]
#![no_main]

use cortex_m::asm::isb;
use cortex_m::interrupt;
use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hprintln};
use embedded_io::{Read as _, ReadReady as _};
use mps2_an386::{Bus, Parts, Uart, start};
use myactuator_mcu_example::{Movement, Setup};
use myactuator_protocol_core::units::MaxSpeed;

/// Bytes measured of each kind.
const BYTES: u32 = 100;
/// What one interrupt may cost: 82, and one more because a tick of SysTick is no whole number of instructions.
const CEILING: u32 = 83;

#[entry]
fn main() -> ! {
    let setup = Setup::new(Movement::Position { max_speed: MaxSpeed::from_raw(60) });
    let Parts { mut uart, .. } = start(Bus::Rs485, 1_000_000, &setup);
    // SAFETY: nothing else here uses the timer.
    let mut syst = unsafe { cortex_m::Peripherals::steal() }.SYST;
    syst.set_clock_source(SystClkSource::Core);
    syst.set_reload(0x00FF_FFFF);
    syst.clear_current();
    syst.enable_counter();

    let with_room = cheapest(&mut uart, |uart| {
        let is_one = uart.read_ready() == Ok(true);
        drain(uart);
        is_one
    });
    // Nothing reads any more, so the queue fills and bytes are lost.
    let mut lost = uart.lost();
    let without = cheapest(&mut uart, |uart| {
        let before = core::mem::replace(&mut lost, uart.lost());
        lost != before
    });
    hprintln!("{:<40} {:>6} {:>6} {:>6}", "receive interrupt, with room", with_room, "", CEILING);
    hprintln!("{:<40} {:>6} {:>6} {:>6}", "receive interrupt, byte lost", without, "", CEILING);
    debug::exit(if with_room.max(without) > CEILING {
        debug::EXIT_FAILURE
    } else {
        debug::EXIT_SUCCESS
    });
    unreachable!("the emulator has ended")
}

fn drain(uart: &mut Uart) {
    let mut chunk = [0; 64];
    while uart.read_ready() == Ok(true) {
        let _ = uart.read(&mut chunk);
    }
}

/// The cheapest of those that took a byte: in the others a timer's interrupt ran, too.
fn cheapest(uart: &mut Uart, mut has_taken: impl FnMut(&mut Uart) -> bool) -> u32 {
    let mut cheapest = u32::MAX;
    let mut taken = 0;
    while taken < BYTES {
        let spent = pass();
        if has_taken(uart) {
            cheapest = cheapest.min(spent);
            taken += 1;
        }
    }
    cheapest
}

/// Waits for interrupts and lets them run; returns how long that took.
#[inline(never)]
fn pass() -> u32 {
    interrupt::disable();
    cortex_m::asm::wfi();
    let start = SYST::get_current();
    // SAFETY: no critical section is open here.
    unsafe { interrupt::enable() };
    isb();
    let ticks = start.wrapping_sub(SYST::get_current()) & 0x00FF_FFFF; // it counts down, 24 bits
    ticks * 5 / 8
}
