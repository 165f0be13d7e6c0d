//! The firmware on CAN.
#![no_std]
#![no_main]

use core::panic::PanicInfo;

use cortex_m_rt::entry;
use nucleo_f446re::{Hardware, fault_on_can, open_can, panic_on_can, run_can, start};

#[entry]
fn main() -> ! {
    let Hardware { mut rcc, time, mut board, cause, can: (can, pins), .. } = start();
    let port = open_can(can, pins, &mut rcc, time);
    run_can(port, time, &mut board, cause)
}

board_shared::on_fresh_stack!(HardFault => fault_on_can);

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    panic_on_can(info)
}
