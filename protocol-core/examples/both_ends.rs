//! A master and a drive in one program, with no bus between them and a clock that only jumps.
//!
//! `cargo run -p myactuator-protocol-core --example both_ends`

use std::error::Error;

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{AbsolutePosition, Command, ReadMultiTurnAngle};
use myactuator_protocol_core::drive::{Drive, IdealPlant, Parameters, RamMemory};
use myactuator_protocol_core::master::{Config, Event, Master};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::{Angle, MaxSpeed};
use myactuator_protocol_core::wire::can::Received;

struct World {
    now: Instant,
    master: Master<1>,
    drive: Drive<IdealPlant, RamMemory>,
}

impl World {
    fn new() -> Self {
        let now = Instant::ZERO;
        let Ok(drive) =
            Drive::new(Parameters::default(), IdealPlant::default(), RamMemory::default(), now);
        Self { now, master: Master::new(Config::CAN), drive }
    }

    /// Lets both ends do what they have to do now, up to the first event of the master.
    fn poll(&mut self) -> Option<Event> {
        let now = self.now;
        self.master.handle_timeout(now);
        while let Some(command) = self.master.poll_transmit(now) {
            println!("{:8} us  {command}", now.as_micros());
            self.drive.handle_packet(&command, now);
            self.master.handle_transmitted(now);
        }
        while let Some(reply) = self.drive.poll_transmit(now) {
            println!("{:8} us  {reply}", now.as_micros());
            let event = self.master.handle_frame(&Received::Packet(reply), now);
            if event.is_some() {
                return event;
            }
        }
        self.master.poll_event()
    }

    /// Jumps to when either end has something to do, but not beyond `end`.
    fn jump(&mut self, end: Instant) {
        let next = [self.master.poll_at(), self.drive.poll_at(), Some(end)];
        self.now = next.into_iter().flatten().min().unwrap_or(end).max(self.now);
    }

    /// Sends the motor a command and waits for its reply.
    fn ask<C: Command>(&mut self, command: C) -> Result<C::Reply, Box<dyn Error>> {
        let ticket = self.master.request(MotorId::MIN, command)?;
        loop {
            match self.poll().and_then(|event| ticket.outcome(&event)) {
                Some(outcome) => return Ok(outcome?),
                None => self.jump(self.now + Duration::from_secs(1)),
            }
        }
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut world = World::new();
    let (max_speed, angle) = (MaxSpeed::from_dps(500.0)?, Angle::from_degrees(360.0)?);
    world.ask(AbsolutePosition { max_speed, angle })?;

    // The motor turns while time passes.
    let there = world.now + Duration::from_secs(1);
    while world.now < there {
        world.poll();
        world.jump(there);
    }
    println!("It has come to {}.", world.ask(ReadMultiTurnAngle)?.angle);
    Ok(())
}
