//! Masters work with adapters that hand over what they have received in bursts.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{ReadMultiTurnAngle, ReadStatus1, SetCurrentPositionZero};
use myactuator_protocol_core::io::{CanMaster, Runner, SerialMaster};
use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::time::Duration;

use super::BusAddress;
use crate::sim::Fleet;
use crate::sim::bus::rs485::TransceiverConfig;

/// The default of adapters with FTDI chips.
const BURSTS: Duration = Duration::from_millis(16);
const MOTORS: u8 = 4;

/// Asks every motor three things in turn; returns how many did not answer. The third is sent only once.
fn unanswered<R: Runner<{ MOTORS as usize }>>(master: &mut R) -> usize {
    let motors = MotorId::all().take(MOTORS.into());
    let rounds = motors.cycle().take(100);
    rounds
        .filter(|&motor| {
            let angle = master.ask(motor, ReadMultiTurnAngle);
            let status = master.ask(motor, ReadStatus1);
            let zero = master.ask(motor, SetCurrentPositionZero);
            let is_still = angle.is_ok_and(|reading| reading.angle.raw() == 0);
            !(is_still && status.is_ok() && zero.is_ok())
        })
        .count()
}

#[test]
fn a_can_adapter_with_bursts_works_with_the_configuration_of_its_address() {
    for rate in [1_000_000, 500_000] {
        let address: BusAddress = format!("slcan:/dev/ttyUSB0@{rate}").parse().unwrap();
        let world = Fleet::new(MOTORS).on_can(rate).unwrap().world;
        let port = world.port();
        world.hand_over_every(port.station(), BURSTS);
        let mut master = CanMaster::new(port, world.clock(), address.config());
        assert_eq!(unanswered(&mut master), 0, "{rate}");
    }
}

#[test]
fn an_rs485_adapter_with_bursts_works_with_the_configuration_of_its_address() {
    for (bit_rate, echo) in [(115_200, false), (115_200, true), (1_000_000, false)] {
        let word = if echo { ",echo" } else { "" };
        let address: BusAddress = format!("rs485:/dev/ttyUSB0@{bit_rate}{word}").parse().unwrap();
        let world = Fleet::new(MOTORS).on_rs485(bit_rate).unwrap().world;
        let transceiver = TransceiverConfig { echo, ..TransceiverConfig::default() };
        let port = world.port_with(transceiver);
        world.hand_over_every(port.station(), BURSTS);
        let mut master = SerialMaster::new(port, world.clock(), address.config());
        assert_eq!(unanswered(&mut master), 0, "{address}");
    }
}

#[test]
fn a_fast_line_keeps_its_short_time_outs() {
    let address: BusAddress = "rs485:/dev/ttyUSB0@1000000".parse().unwrap();
    let world = Fleet::new(MOTORS).on_rs485(1_000_000).unwrap().world;
    let mut master = SerialMaster::<_, _, 4>::new(world.port(), world.clock(), address.config());
    assert_eq!(master.master().patience(1).reply_timeout, Duration::from_millis(40));
    assert_eq!(unanswered(&mut master), 0);
    let of_the_rate = Config::rs485(1_000_000, false).reply_timeout;
    assert_eq!(master.master().patience(1).reply_timeout, of_the_rate);
}
