//! A drive with an ideal motor on a test bench. Commands go in, replies come out, and time is virtual.

use myactuator_protocol_core::command::{
    Command, ErrorFlags, Feedback, ReadMultiTurnAngle, ReadStatus2,
};
use myactuator_protocol_core::drive::{
    Bus, Drive, Event, IdealPlant, NotRunReason, Parameters, RamMemory, State,
};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::{AnyCommand, Channel, Data, MotorId, Opcode, Packet, Target};

use crate::values::millis;

/// A drive, its motor, and everything that came out of it.
#[derive(Debug)]
pub struct Bench {
    /// The drive.
    pub drive: Drive<IdealPlant, RamMemory>,
    /// The time.
    pub now: Instant,
    /// The packets that the drive sent, and when.
    pub sent: Vec<(Instant, Packet)>,
    /// The events that the drive reported to its program.
    pub events: Vec<Event>,
}

/// The drive's id.
pub const ID: MotorId = MotorId::MIN;

impl Default for Bench {
    fn default() -> Self {
        Self::new(Parameters::default())
    }
}

impl Bench {
    /// A drive on CAN with an ideal motor.
    pub fn new(parameters: Parameters) -> Self {
        let plant = IdealPlant::default();
        let now = Instant::from_millis(1_000);
        let drive = Drive::new(parameters, plant, RamMemory::default(), now).unwrap();
        let mut bench = Self { drive, now, sent: Vec::new(), events: Vec::new() };
        bench.collect();
        bench
    }

    /// A drive that has a holding brake.
    pub fn with_brake() -> Self {
        Self::new(Parameters { has_brake: true, ..Parameters::default() })
    }

    /// A drive on RS485.
    pub fn on_rs485() -> Self {
        Self::new(Parameters { bus: Bus::Rs485, ..Parameters::default() })
    }

    fn collect(&mut self) {
        while let Some(packet) = self.drive.poll_transmit(self.now) {
            self.sent.push((self.now, packet));
        }
        while let Some(event) = self.drive.poll_event() {
            self.events.push(event);
        }
    }

    /// Lets time pass. Calls the drive only at the times that it asks for.
    pub fn run(&mut self, span: Duration) {
        let end = self.now + span;
        while self.now < end {
            self.now = self.drive.poll_at().map_or(end, |at| at.max(self.now).min(end));
            self.collect();
        }
        self.drive.advance(end);
        self.collect();
    }

    /// Puts a packet on the bus.
    pub fn put(&mut self, channel: Channel, data: Data) {
        self.drive.handle_packet(&Packet { channel, data }, self.now);
        self.collect();
    }

    /// Puts a command on the bus and waits 5 ms. Returns the packets that come back in that time.
    pub fn exchange(&mut self, channel: Channel, data: Data) -> Vec<Packet> {
        let before = self.sent.len();
        self.put(channel, data);
        self.run(millis(5));
        self.sent[before..].iter().map(|&(_, packet)| packet).collect()
    }

    /// Sends any command to the drive. Returns the data of its only reply, or `None` if there is no reply.
    pub fn send(&mut self, command: impl Into<AnyCommand>) -> Option<Data> {
        let command = command.into();
        let target = if command.opcode() == Some(Opcode::BusId) { Target::All } else { ID.into() };
        let packet = command.packet(target).unwrap();
        let replies = self.exchange(packet.channel, packet.data);
        assert!(replies.len() <= 1, "{replies:?}");
        replies.first().map(|packet| packet.data)
    }

    /// Sends a command and returns its reply.
    pub fn ask<C: Command + Into<AnyCommand>>(&mut self, command: C) -> C::Reply {
        let data = self.send(command).expect("no reply");
        C::decode_reply(&data).expect("not a reply")
    }

    /// Sends a command that has a reply, and lets `span` pass.
    pub fn go<C: Command + Into<AnyCommand>>(&mut self, command: C, span: Duration) {
        self.ask(command);
        self.run(span);
    }

    /// Sends a command and checks that the drive acknowledges it with the same bytes.
    pub fn write<C: Command + Into<AnyCommand> + Copy>(&mut self, command: C) {
        assert_eq!(self.send(command), Some(command.encode()));
    }

    /// The values of 0x9C.
    pub fn feedback(&mut self) -> Feedback {
        self.ask(ReadStatus2)
    }

    /// The state of the drive, as seen from outside.
    pub fn state(&self) -> State {
        self.drive.state()
    }

    /// Turns the shaft by hand to an angle in degrees.
    pub fn turn_to(&mut self, angle_deg: f64) {
        self.drive.plant_mut().set_angle_deg(angle_deg);
        self.run(millis(1));
    }

    /// The angle of 0x92, in degrees.
    pub fn reported_angle(&mut self) -> f32 {
        self.ask(ReadMultiTurnAngle).angle.degrees()
    }

    /// The true angle, in degrees.
    pub fn angle(&self) -> f64 {
        self.drive.state().angle_deg
    }

    /// The speed, in degrees per second.
    pub fn speed(&self) -> f32 {
        self.drive.state().measurement.speed_dps
    }

    /// The current, in amperes.
    pub fn current(&self) -> f32 {
        self.drive.state().measurement.current_a
    }

    /// Runs for `span` and calls `look` every millisecond.
    pub fn watch(&mut self, span: Duration, mut look: impl FnMut(&State)) {
        for _ in 0..span.as_millis() {
            self.run(millis(1));
            look(&self.drive.state());
        }
    }

    /// Restarts the drive by 0x76.
    pub fn restart(&mut self) {
        assert_eq!(self.send(myactuator_protocol_core::command::Reset), None);
    }

    /// Switches the power off for 100 ms.
    pub fn power_cycle(&mut self) {
        self.drive.power_off(self.now);
        self.run(millis(100));
        self.drive.power_on(self.now);
        self.run(millis(1));
    }

    /// Raises errors by hand.
    pub fn raise(&mut self, errors: ErrorFlags) {
        self.drive.raise_fault(errors);
        self.collect();
    }

    /// Why the last command that was not run was not. Drops all events.
    pub fn not_run(&mut self) -> Option<NotRunReason> {
        let mut reasons = self.events.drain(..).filter_map(|event| match event {
            Event::NotRun { reason, .. } => Some(reason),
            _ => None,
        });
        reasons.next_back()
    }
}
