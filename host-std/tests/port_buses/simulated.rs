//! Simulated buses, opened by the same string as real ones. Which motors they have, `scan` tells in
//! `tests/program/motors.rs`.

use myactuator_host_std::open::{AnyMaster, BusAddress};
use myactuator_protocol_core::command::{ReadMultiTurnAngle, ReadStatus1};
use myactuator_protocol_core::io::{CallError, Runner};
use myactuator_protocol_core::master::Failure;

use crate::drive::motor;

#[test]
fn simulated_buses_answer_in_virtual_time_by_their_configuration() {
    for bus in ["sim:2", "sim:2,rs485"] {
        let address: BusAddress = bus.parse().unwrap();
        let mut arm = AnyMaster::<4>::open_with(&address, address.config()).unwrap();
        // On RS485 this finds out whether there is an echo. An angle of 0 that is the first reply of its motor is asked for
        // again.
        arm.ask(motor(1), ReadMultiTurnAngle).unwrap();
        arm.ask(motor(2), ReadStatus1).unwrap();
        let before = arm.now();
        let reading = arm.ask(motor(2), ReadMultiTurnAngle).unwrap();
        assert_eq!(reading.angle.degrees(), 0.0, "{bus}");
        // A drive takes 0.7 ms to 0.9 ms; 26 bytes at 115200 bit/s take 2.3 ms more.
        let took_us = (arm.now() - before).as_micros();
        let expected_us = if bus == "sim:2" { 700..1_500 } else { 2_900..4_000 };
        assert!(expected_us.contains(&took_us), "{bus}: {took_us} µs");
        let silent = arm.ask(motor(3), ReadStatus1).unwrap_err();
        assert!(
            matches!(silent, CallError::Failed { failure: Failure::NoReply, .. }),
            "{bus}: {silent}"
        );
    }
}
