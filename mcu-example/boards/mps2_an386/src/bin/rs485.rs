//! Motors on an RS485 line at 1 Mbit/s, moved by positions.
#![no_std]
#![no_main]

use board_emulated::{CYCLE, patient};
use cortex_m_rt::entry;
use mps2_an386::{Bus, Parts, start};
use myactuator_mcu_example::{Movement, Setup, run};
use myactuator_protocol_core::io::SerialMaster;
use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::units::MaxSpeed;

const BIT_RATE: u32 = 1_000_000;

#[entry]
fn main() -> ! {
    // Twice the highest speed of the movement.
    let movement = Movement::Position { max_speed: MaxSpeed::from_raw(60) };
    let setup = Setup { cycle: CYCLE, ..Setup::new(movement) };
    let Parts { cause, clock, uart, mut board } = start(Bus::Rs485, BIT_RATE, &setup);
    let mut bus =
        SerialMaster::<_, _, 8>::new(uart, clock, patient(Config::rs485(BIT_RATE, false)));
    run(&mut bus, &mut board, setup, cause)
}
