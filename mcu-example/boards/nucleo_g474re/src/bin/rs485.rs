//! The application on RS485: positions, as many as the line carries.
#![no_std]
#![no_main]

use embassy_executor::Spawner;
use myactuator_mcu_example::{Movement, Setup, run_async};
use myactuator_protocol_core::io::AsyncSerialMaster;
use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::MaxSpeed;
use nucleo_g474re::{EmbassyClock, MOTORS, Nucleo, RS485_BIT_RATE, motors, rs485, start};

/// Whether the transceiver echoes what is sent. It does not if its RE is wired to its DE.
const ECHO: bool = false;

#[embassy_executor::main]
async fn main(_spawner: Spawner) -> ! {
    let (p, cause) = start();
    let mut board = Nucleo::new(p.PC13, p.PA5, p.IWDG);
    let port = rs485(p.USART1, p.PA10, p.PA9, p.PA12).expect("170 MHz make any bit rate");
    let config = Config::rs485(RS485_BIT_RATE, ECHO);
    let mut bus = AsyncSerialMaster::<_, _, MOTORS>::new(port, EmbassyClock, config);
    let movement = Movement::Position { max_speed: MaxSpeed::from_raw(200) };
    // A frame takes 1.1 ms. A cycle that begins meanwhile begins late.
    let cycle = Duration::from_millis(4);
    let setup = Setup { search: motors(), cycle, ..Setup::new(movement) };
    run_async(&mut bus, &mut board, setup, cause).await
}
