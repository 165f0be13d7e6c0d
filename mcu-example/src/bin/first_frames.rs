//! The first frames: one command to a motor, in CAN's frame and in RS485's, and the reply to it.
#![no_std]
#![no_main]

use core::fmt::Error;

use cortex_m_rt::entry;
use cortex_m_semihosting::hprintln;
use myactuator_mcu_example::finish;

#[entry]
fn main() -> ! {
    finish(run())
}

fn run() -> Result<(), Error> {
    hprintln!("first frames");
    Ok(())
}
