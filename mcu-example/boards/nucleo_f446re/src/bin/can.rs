//! The firmware on CAN.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use nucleo_f446re::{Hardware, end_on_can, open_can, run_can, start};

#[entry]
fn main() -> ! {
    let Hardware { mut rcc, time, mut board, cause, can: (can, pins), .. } = start();
    let port = open_can(can, pins, &mut rcc, time);
    run_can(port, time, &mut board, cause)
}

board_shared::on_fresh_stack!(HardFault, DefaultHandler => end_on_can);
