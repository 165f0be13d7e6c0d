//! Simulated drives under a subcommand, for its tests.

use myactuator_host_std::open::AnyMaster;
use myactuator_host_std::sim::CanFleet;
use myactuator_host_std::sim::bus::trace::{Event, Log};
use myactuator_protocol_core::io::CanMaster;
use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::wire::can::{self, Received, SimpleFrame};
use myactuator_protocol_core::{Channel, Packet};

use super::session::Session;

/// A session on these drives by a master of this configuration, with the user's consent.
pub(super) fn with(fleet: &CanFleet, config: Config) -> Session {
    let master = CanMaster::new(fleet.world.port(), fleet.world.clock(), config);
    Session { master: AnyMaster::SimulatedCan(master), ..Session::on(fleet) }
}

/// The arguments of a subcommand, typed like this.
pub(super) fn typed<A: clap::Args>(line: &str) -> A {
    let words = ["typed"].into_iter().chain(line.split(' '));
    let matches = A::augment_args(clap::Command::new("typed")).get_matches_from(words);
    A::from_arg_matches(&matches).unwrap()
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
