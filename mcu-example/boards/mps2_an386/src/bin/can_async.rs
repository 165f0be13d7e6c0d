//! As `can`, as a task of embassy's executor.
#![no_std]
#![no_main]

use board_emulated::{CYCLE, patient};
use cortex_m_rt::entry;
use mps2_an386::{Bus, Parts, SLCAN_LINE_RATE, Slcan, run, start};
use myactuator_mcu_example::{Movement, Setup, run_async};
use myactuator_protocol_core::command::MotionRanges;
use myactuator_protocol_core::io::AsyncCanMaster;
use myactuator_protocol_core::master::Config;

#[entry]
fn main() -> ! {
    run(|spawner| spawner.spawn(application().expect("spawned once")))
}

#[embassy_executor::task]
async fn application() -> ! {
    // Gentle: a motor that is 5 degrees off turns back with less than 2 N·m.
    let movement = Movement::Motion { ranges: MotionRanges::V4_3, kp: 50.0, kd: 2.0 };
    let setup = Setup { cycle: CYCLE, ..Setup::new(movement) };
    let Parts { cause, clock, uart, mut board } = start(Bus::Slcan, SLCAN_LINE_RATE, &setup);
    let can = Slcan::open(uart, clock);
    let mut bus = AsyncCanMaster::<_, _, 8>::new(can, clock, patient(Config::CAN));
    run_async(&mut bus, &mut board, setup, cause).await
}
