//! The firmware on RS485.
#![no_std]
#![no_main]

use board_emulated::{CYCLE, patient};
use board_stm32f4::{end_on_rs485, run_rs485, setup};
use cortex_m_rt::entry;
use myactuator_mcu_example::Setup;
use myactuator_protocol_core::master::Config;
use netduinoplus2::{BIT_RATE, Hardware, start};

#[entry]
fn main() -> ! {
    let Hardware { line, time, mut panel, cause } = start();
    let config = patient(Config::rs485(BIT_RATE, false));
    let setup = Setup { cycle: CYCLE, ..setup(&config) };
    run_rs485(line, config, setup, time, &mut panel, cause)
}

board_shared::on_fresh_stack!(HardFault, DefaultHandler => end_on_rs485);
