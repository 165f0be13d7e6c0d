//! Opens a bus by one string, and reads how the motors on it do.
//!
//! `cargo run -p myactuator-host-std --example open_and_read -- can0` or another address, such as
//! `rs485:/dev/ttyUSB0@115200`; without one, two simulated motors answer.

use std::env;
use std::error::Error;

use myactuator_host_std::open::{AnyMaster, BusAddress};
use myactuator_host_std::protocol::command::{ReadMultiTurnAngle, ReadStatus1};
use myactuator_host_std::protocol::io::{Runner, bring_up};
use myactuator_host_std::protocol::master::MotorSet;

fn main() -> Result<(), Box<dyn Error>> {
    let address: BusAddress = env::args().nth(1).as_deref().unwrap_or("sim:2").parse()?;
    let mut bus = AnyMaster::<32>::open(&address)?;
    let motors = bring_up::scan(&mut bus, MotorSet::ALL, |_, _| {})?;
    println!("{address}: {} motors", motors.len());
    for motor in motors.iter() {
        let angle = bus.ask(motor, ReadMultiTurnAngle)?.angle;
        let status = bus.ask(motor, ReadStatus1)?;
        println!("motor {motor}: {angle}, {}, {}", status.voltage, status.errors);
    }
    Ok(())
}
