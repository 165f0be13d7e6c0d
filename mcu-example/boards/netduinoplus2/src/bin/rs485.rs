//! The firmware on RS485.
#![no_std]
#![no_main]

use board_emulated::patient;
use board_stm32f4::{end_on_rs485, run_rs485};
use cortex_m_rt::entry;
use myactuator_protocol_core::master::Config;
use netduinoplus2::{BIT_RATE, Hardware, start};

#[entry]
fn main() -> ! {
    let Hardware { line, time, mut panel, cause } = start();
    run_rs485(line, patient(Config::rs485(BIT_RATE, false)), time, &mut panel, cause)
}

board_shared::on_fresh_stack!(HardFault, DefaultHandler => end_on_rs485);
