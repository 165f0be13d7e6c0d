//! The application on CAN: motion mode, 1000 set-points a second.
#![no_std]
#![no_main]

use embassy_executor::Spawner;
use myactuator_mcu_example::{Movement, Setup, run_async};
use myactuator_protocol_core::command::MotionRanges;
use myactuator_protocol_core::io::AsyncCanMaster;
use myactuator_protocol_core::master::Config;
use nucleo_g474re::{CAN_BIT_RATE, EmbassyClock, FdCan, MOTORS, Nucleo, motors, start};

#[embassy_executor::main]
async fn main(_spawner: Spawner) -> ! {
    let (p, cause) = start();
    let mut board = Nucleo::new(p.PC13, p.PA5, p.IWDG);
    let can = FdCan::new(p.FDCAN1, p.PA11, p.PA12);
    let mut bus = AsyncCanMaster::<_, _, MOTORS>::new(can, EmbassyClock, Config::can(CAN_BIT_RATE));
    let movement = Movement::Motion { ranges: MotionRanges::V4_3, kp: 50.0, kd: 2.0 };
    let setup = Setup { search: motors(), ..Setup::new(movement) };
    run_async(&mut bus, &mut board, setup, cause).await
}
