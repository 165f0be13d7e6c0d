//! Adapters that hand over what they received now and then only, and how masters get on with them.

use std::collections::VecDeque;

use embedded_can::nb::Can;
use embedded_io::{ErrorType, Read, ReadReady, Write};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{ReadMultiTurnAngle, ReadStatus1, SetCurrentPositionZero};
use myactuator_protocol_core::io::{CanMaster, Clock, Runner, SerialMaster};
use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::time::{Duration, Instant};

use super::BusAddress;
use crate::sim::Fleet;
use crate::sim::bus::rs485::TransceiverConfig;
use crate::sim::bus::{Medium, World};

/// A port behind an adapter that hands over what it received at every multiple of some milliseconds.
pub(super) struct Bursty<P, B: Medium, T> {
    port: P,
    world: World<B>,
    every_ms: u64,
    /// How many bursts there were.
    bursts: u64,
    handed_over: VecDeque<T>,
    /// So many of the next bytes or frames never come.
    pub(super) to_lose: usize,
}

impl<P, B: Medium, T> Bursty<P, B, T> {
    pub(super) fn new(port: P, world: &World<B>, every_ms: u64) -> Self {
        let (world, handed_over) = (world.clone(), VecDeque::new());
        Self { port, world, every_ms, bursts: 0, handed_over, to_lose: 0 }
    }

    pub(super) fn clock(&self) -> Steps<B> {
        Steps(self.world.clone())
    }

    /// Takes what has come if the time is there.
    fn hand_over(&mut self, mut receive: impl FnMut(&mut P) -> Option<T>) {
        let bursts = self.world.now().as_micros() / (1_000 * self.every_ms);
        if bursts == self.bursts {
            return;
        }
        self.bursts = bursts;
        let port = &mut self.port;
        let mut come: VecDeque<T> = std::iter::from_fn(|| receive(port)).collect();
        let lost = self.to_lose.min(come.len());
        self.to_lose -= lost;
        self.handed_over.extend(come.drain(lost..));
    }
}

impl<P: ErrorType, B: Medium> ErrorType for Bursty<P, B, u8> {
    type Error = P::Error;
}

impl<P: Read + ReadReady, B: Medium> ReadReady for Bursty<P, B, u8> {
    fn read_ready(&mut self) -> Result<bool, P::Error> {
        self.hand_over(|port| {
            let mut byte = [0];
            let has_come = port.read_ready().ok()? && port.read(&mut byte).ok()? > 0;
            has_come.then_some(byte[0])
        });
        Ok(!self.handed_over.is_empty())
    }
}

impl<P: Read + ReadReady, B: Medium> Read for Bursty<P, B, u8> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, P::Error> {
        let count = buffer.len().min(self.handed_over.len());
        for (place, byte) in buffer.iter_mut().zip(self.handed_over.drain(..count)) {
            *place = byte;
        }
        Ok(count)
    }
}

impl<P: Write, B: Medium> Write for Bursty<P, B, u8> {
    fn write(&mut self, buffer: &[u8]) -> Result<usize, P::Error> {
        self.port.write(buffer)
    }

    fn flush(&mut self) -> Result<(), P::Error> {
        self.port.flush()
    }
}

impl<P: Can, B: Medium> Can for Bursty<P, B, P::Frame> {
    type Frame = P::Frame;
    type Error = P::Error;

    fn transmit(&mut self, frame: &P::Frame) -> nb::Result<Option<P::Frame>, P::Error> {
        self.port.transmit(frame)
    }

    fn receive(&mut self) -> nb::Result<P::Frame, P::Error> {
        self.hand_over(|port| port.receive().ok());
        self.handed_over.pop_front().ok_or(nb::Error::WouldBlock)
    }
}

/// A clock that goes on by a millisecond at a time: nothing else tells when an adapter hands over.
pub(super) struct Steps<B: Medium>(World<B>);

impl<B: Medium> Clock for Steps<B> {
    fn now(&self) -> Instant {
        self.0.now()
    }

    fn idle(&self, until: Instant) {
        self.0.run_until(until.min(self.0.now() + Duration::from_millis(1)));
    }
}

/// What the default of adapters with FTDI chips is.
const BURSTS_MS: u64 = 16;
const MOTORS: u8 = 4;

/// Asks every motor three things in turn; gives how many did not answer. The third is sent once only.
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
        let adapter = Bursty::new(world.port(), &world, BURSTS_MS);
        let clock = adapter.clock();
        let mut master = CanMaster::new(adapter, clock, address.config());
        assert_eq!(unanswered(&mut master), 0, "{rate}");
    }
}

#[test]
fn an_rs485_adapter_with_bursts_works_with_the_configuration_of_its_address() {
    for (bit_rate, echo) in [(115_200, false), (115_200, true), (1_000_000, false)] {
        let word = if echo { "echo" } else { "noecho" };
        let address: BusAddress = format!("rs485:/dev/ttyUSB0@{bit_rate},{word}").parse().unwrap();
        let world = Fleet::new(MOTORS).on_rs485(bit_rate).unwrap().world;
        let transceiver = TransceiverConfig { echo, ..TransceiverConfig::default() };
        let adapter = Bursty::new(world.port_with(transceiver), &world, BURSTS_MS);
        let clock = adapter.clock();
        let mut master = SerialMaster::new(adapter, clock, address.config());
        assert_eq!(unanswered(&mut master), 0, "{address}");
    }
}

#[test]
fn a_fast_line_keeps_its_short_time_outs() {
    let address: BusAddress = "rs485:/dev/ttyUSB0@1000000,noecho".parse().unwrap();
    let world = Fleet::new(MOTORS).on_rs485(1_000_000).unwrap().world;
    let mut master = SerialMaster::<_, _, 4>::new(world.port(), world.clock(), address.config());
    assert_eq!(master.master().patience(1).reply_timeout, Duration::from_millis(40));
    assert_eq!(unanswered(&mut master), 0);
    let of_the_rate = Config::rs485(1_000_000, false).reply_timeout;
    assert_eq!(master.master().patience(1).reply_timeout, of_the_rate);
}
