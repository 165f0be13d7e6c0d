//! Simulated drives under a subcommand, for its tests.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use myactuator_host_std::open::AnyMaster;
use myactuator_host_std::sim::CanFleet;
use myactuator_host_std::sim::bus::trace::{Event, Log};
use myactuator_protocol_core::io::CanMaster;
use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::wire::can::{self, Received, SimpleFrame};
use myactuator_protocol_core::{Channel, MotorId, Packet};

use super::run_for::Span;
use super::session::{Consent, OnBus, Session};

/// A session on these drives, with the user's consent.
pub(super) fn on(fleet: &CanFleet) -> Session {
    with(fleet, Config::can(fleet.bit_rate()))
}

/// The same, with a master of this configuration.
pub(super) fn with(fleet: &CanFleet, config: Config) -> Session {
    let master = CanMaster::new(fleet.world.port(), fleet.world.clock(), config);
    Session {
        master: AnyMaster::SimulatedCan(master),
        address: "sim:1".parse().unwrap(),
        yes: true,
        interrupted: Arc::new(AtomicBool::new(false)),
    }
}

/// Motor 1, for a second.
pub(super) fn span() -> Span {
    Span {
        on: OnBus { bus: "sim:1".parse().unwrap() },
        id: MotorId::MIN,
        for_s: Duration::from_secs(1),
        consent: Consent { yes: true },
    }
}

/// What masters have sent, and what is on the channel of bus ids.
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
