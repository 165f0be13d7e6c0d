//! A drive with an ideal motor on a bench: commands go in, replies come out, time is virtual.
#![allow(dead_code, reason = "each test file uses its own part")]

use myactuator_protocol_core::command::{Command, ErrorFlags, Feedback, ReadStatus2};
use myactuator_protocol_core::drive::{
    Bus, Drive, Event, IdealPlant, NotRunReason, Parameters, RamMemory, State,
};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::{Angle, Current, MaxSpeed, MaxTorque, SpeedTarget};
use myactuator_protocol_core::{AnyCommand, Channel, Data, MotorId, Opcode, Packet, Target};

pub(crate) struct Bench {
    pub(crate) drive: Drive<IdealPlant, RamMemory>,
    pub(crate) now: Instant,
    /// Everything that the drive sent, and when.
    pub(crate) sent: Vec<(Instant, Packet)>,
    pub(crate) events: Vec<Event>,
}

pub(crate) const ID: MotorId = MotorId::MIN;

pub(crate) fn millis(millis: u64) -> Duration {
    Duration::from_millis(millis)
}

impl Default for Bench {
    fn default() -> Self {
        Self::new(Parameters::default())
    }
}

impl Bench {
    pub(crate) fn new(parameters: Parameters) -> Self {
        Self::with(parameters, IdealPlant::default())
    }

    pub(crate) fn with(parameters: Parameters, plant: IdealPlant) -> Self {
        let now = Instant::from_millis(1_000);
        let drive = Drive::new(parameters, plant, RamMemory::default(), now).unwrap();
        let mut bench = Self { drive, now, sent: Vec::new(), events: Vec::new() };
        bench.collect();
        bench
    }

    pub(crate) fn with_brake() -> Self {
        Self::new(Parameters { has_brake: true, ..Parameters::default() })
    }

    pub(crate) fn on_rs485() -> Self {
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

    /// Lets time pass, waking the drive only when it asks for it.
    pub(crate) fn run(&mut self, span: Duration) {
        let end = self.now + span;
        while self.now < end {
            self.now = self.drive.poll_at().map_or(end, |at| at.max(self.now).min(end));
            self.collect();
        }
        self.drive.advance(end);
        self.collect();
    }

    /// Puts a packet on the bus.
    pub(crate) fn put(&mut self, channel: Channel, data: Data) {
        self.drive.handle_packet(&Packet { channel, data }, self.now);
        self.collect();
    }

    /// Puts a command on the bus and waits 5 ms: the data of whatever comes back in that time.
    pub(crate) fn exchange(&mut self, channel: Channel, data: Data) -> Vec<Packet> {
        let before = self.sent.len();
        self.put(channel, data);
        self.run(millis(5));
        self.sent[before..].iter().map(|&(_, packet)| packet).collect()
    }

    /// Sends any command to the drive; the data of its only reply, `None` if there is none.
    pub(crate) fn send(&mut self, command: impl Into<AnyCommand>) -> Option<Data> {
        let command = command.into();
        let target = if command.opcode() == Opcode::BusId { Target::All } else { ID.into() };
        let packet = command.packet(target).unwrap();
        let replies = self.exchange(packet.channel, packet.data);
        assert!(replies.len() <= 1, "{replies:?}");
        replies.first().map(|packet| packet.data)
    }

    /// Sends a command that is answered.
    pub(crate) fn ask<C: Command + Into<AnyCommand>>(&mut self, command: C) -> C::Reply {
        let data = self.send(command).expect("no reply");
        C::decode_reply(&data).expect("not a reply")
    }

    /// Sends a command that a drive echoes, and checks that it does.
    pub(crate) fn write<C: Command + Into<AnyCommand> + Copy>(&mut self, command: C) {
        assert_eq!(self.send(command), Some(command.encode()));
    }

    pub(crate) fn feedback(&mut self) -> Feedback {
        self.ask(ReadStatus2)
    }

    pub(crate) fn state(&self) -> State {
        self.drive.state()
    }

    pub(crate) fn angle(&self) -> f64 {
        self.drive.state().angle_deg
    }

    pub(crate) fn speed(&self) -> f32 {
        self.drive.state().measurement.speed_dps
    }

    pub(crate) fn current(&self) -> f32 {
        self.drive.state().measurement.current_a
    }

    /// Runs for `span` and looks every millisecond.
    pub(crate) fn watch(&mut self, span: Duration, mut look: impl FnMut(&State)) {
        for _ in 0..span.as_millis() {
            self.run(millis(1));
            look(&self.drive.state());
        }
    }

    pub(crate) fn restart(&mut self) {
        assert_eq!(self.send(myactuator_protocol_core::command::Reset), None);
    }

    pub(crate) fn power_cycle(&mut self) {
        self.drive.power_off(self.now);
        self.run(millis(100));
        self.drive.power_on(self.now);
        self.run(millis(1));
    }

    pub(crate) fn raise(&mut self, errors: ErrorFlags) {
        self.drive.raise_fault(errors);
        self.collect();
    }

    /// The reason why the last command was not run, if it was not; forgets older events.
    pub(crate) fn not_run(&mut self) -> Option<NotRunReason> {
        let mut reasons = self.events.drain(..).filter_map(|event| match event {
            Event::NotRun { reason, .. } => Some(reason),
            _ => None,
        });
        reasons.next_back()
    }
}

pub(crate) fn amperes(amperes: f32) -> Current {
    Current::from_amperes(amperes).unwrap()
}

pub(crate) fn dps(dps: f32) -> SpeedTarget {
    SpeedTarget::from_dps(dps).unwrap()
}

pub(crate) fn degrees(degrees: f32) -> Angle {
    Angle::from_degrees(degrees).unwrap()
}

pub(crate) fn up_to(dps: u16) -> MaxSpeed {
    MaxSpeed::from_raw(dps)
}

pub(crate) fn percent(percent: u8) -> MaxTorque {
    MaxTorque::from_raw(percent)
}
