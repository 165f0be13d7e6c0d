//! Simulated drives for tests of subcommands.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use myactuator_host_std::open::AnyMaster;
use myactuator_host_std::sim::bus::Node;
use myactuator_host_std::sim::bus::trace::{Event, Log};
use myactuator_host_std::sim::{CanFleet, Fleet};
use myactuator_protocol_core::command::Speed;
use myactuator_protocol_core::io::{CanMaster, Runner as _, SerialMaster};
use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::{MaxTorque, SpeedTarget};
use myactuator_protocol_core::wire::can::{self, Received, SimpleFrame};
use myactuator_protocol_core::{Channel, Data, MotorId, Packet, Target};

use super::session::Session;

/// A session on these drives, with this configuration and the user's consent.
pub(super) fn with(fleet: &CanFleet, config: Config) -> Session {
    let master = CanMaster::new(fleet.world.port(), fleet.world.clock(), config);
    Session::by(AnyMaster::SimulatedCan(master))
}

/// A session on a drive behind an adapter that does not echo, although the address says so.
pub(super) fn echo_is_missing() -> Session {
    let world = Fleet::new(1).on_rs485(115_200).unwrap().world;
    let config = Config::rs485(115_200, true);
    let master = SerialMaster::new(world.port(), world.clock(), config);
    let mut session = Session::by(AnyMaster::SimulatedRs485(master));
    session.address = "rs485:/dev/ttyUSB0@115200,echo".parse().unwrap();
    session
}

/// A session whose motor 1 turns, after half a second at 180 dps.
pub(super) fn turning(fleet: &CanFleet) -> Session {
    let mut session = Session::on(fleet);
    let (max_torque, speed) = (MaxTorque::NO_LIMIT, SpeedTarget::from_raw(18_000));
    session.ask(MotorId::MIN, Speed { max_torque, speed }).unwrap();
    let later = session.master.now() + Duration::from_millis(500);
    session.wait_until(later).unwrap();
    session
}

/// The arguments of a subcommand from this line.
pub(super) fn typed<A: clap::Args>(line: &str) -> A {
    let words = ["typed"].into_iter().chain(line.split(' '));
    let matches = A::augment_args(clap::Command::new("typed")).get_matches_from(words);
    A::from_arg_matches(&matches).unwrap()
}

/// The packets of masters, and those on the channel of bus ids.
pub(super) fn sent(log: &Log<SimpleFrame>) -> Vec<Packet> {
    let records = log.take();
    let packets = records.iter().filter_map(|record| match &record.event {
        Event::Carried { frame, .. } => match can::decode(frame) {
            Received::Packet(packet) => Some(packet),
            _ => None,
        },
        _ => None,
    });
    let is_reply =
        |packet: &Packet| matches!(packet.channel, Channel::Reply(_) | Channel::MotionReply(_));
    packets.filter(|packet| !is_reply(packet)).collect()
}

/// A command to the motor with id 1.
pub(super) fn to_first(data: Data) -> Packet {
    Packet { channel: Channel::Command(Target::Motor(MotorId::MIN)), data }
}

/// When another program sends its command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sends {
    /// Repeatedly, at this interval.
    Every(Duration),
    /// Every 10 ms, and once more after it has heard the stop (0x81).
    UntilStopped,
    /// Once, this long after the start.
    Once(Duration),
}

/// Another program on the bus, which sends one command.
#[derive(Debug)]
pub(super) struct OtherMaster {
    packet: Packet,
    sends: Sends,
    next: Option<Instant>,
}

impl OtherMaster {
    pub(super) fn attach(fleet: &CanFleet, packet: Packet, sends: Sends) {
        let wait = if let Sends::Once(after) = sends { after } else { Duration::ZERO };
        fleet.world.attach(Self { packet, sends, next: Some(fleet.world.now() + wait) });
    }
}

impl Node<SimpleFrame> for OtherMaster {
    fn handle_frame(&mut self, frame: &SimpleFrame, now: Instant) {
        if let Received::Packet(Packet { channel: Channel::Reply(_), data: [0x81, ..] }) =
            can::decode(frame)
            && self.sends == Sends::UntilStopped
        {
            (self.sends, self.next) = (Sends::Once(Duration::ZERO), Some(now));
        }
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<SimpleFrame> {
        self.next.filter(|next| *next <= now)?;
        self.next = match self.sends {
            Sends::Once(_) => None,
            Sends::Every(span) => Some(now + span),
            Sends::UntilStopped => Some(now + Duration::from_millis(10)),
        };
        can::encode(&self.packet)
    }

    fn poll_at(&self) -> Option<Instant> {
        self.next
    }
}

/// A user who presses Ctrl-C, once.
#[derive(Debug)]
pub(super) struct CtrlC {
    at: Option<Instant>,
    flags: [Arc<AtomicBool>; 2],
}

impl CtrlC {
    pub(super) fn attach(fleet: &CanFleet, session: &Session, after: Duration) {
        let flags = [session.interrupted.clone(), session.again.clone()];
        fleet.world.attach(Self { at: Some(fleet.world.now() + after), flags });
    }
}

impl Node<SimpleFrame> for CtrlC {
    fn handle_frame(&mut self, _: &SimpleFrame, _: Instant) {}

    fn poll_transmit(&mut self, now: Instant) -> Option<SimpleFrame> {
        if self.at.take_if(|at| *at <= now).is_some() {
            for flag in &self.flags {
                flag.store(true, Ordering::Relaxed);
            }
        }
        None
    }

    fn poll_at(&self) -> Option<Instant> {
        self.at
    }
}
