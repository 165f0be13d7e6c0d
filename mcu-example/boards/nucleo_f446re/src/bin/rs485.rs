//! The firmware on RS485.
#![no_std]
#![no_main]

use board_stm32f4::{end_on_rs485, open_line, run_rs485, setup};
use cortex_m_rt::entry;
use myactuator_protocol_core::master::Config;
use nucleo_f446re::{BIT_RATE, Hardware, start};

#[entry]
fn main() -> ! {
    let Hardware { mut rcc, time, mut board, cause, usart: (usart, pins), .. } = start();
    let line = open_line(usart, pins, BIT_RATE, &mut rcc, time).expect("90 MHz carry the bit rate");
    let config = Config::rs485(BIT_RATE, false);
    run_rs485(line, config, setup(&config), time, &mut board, cause)
}

board_shared::on_fresh_stack!(HardFault, DefaultHandler => end_on_rs485);
