//! Simulated drives under a subcommand, for its tests.

use myactuator_host_std::sim::bus::trace::{Event, Log};
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::wire::can::{self, Received, SimpleFrame};
use myactuator_protocol_core::{Channel, MotorId, Packet};

use super::run_for::Span;
use super::session::{Consent, OnBus, OneMotor};

/// Motor 1, for a second.
pub(super) fn span() -> Span {
    Span {
        motor: OneMotor {
            on: OnBus { bus: "sim:1".parse().unwrap() },
            id: MotorId::MIN,
            consent: Consent { yes: true },
        },
        for_s: Duration::from_secs(1),
    }
}

/// What masters have sent.
pub(super) fn sent(log: &Log<SimpleFrame>) -> Vec<Packet> {
    let records = log.take();
    let packets = records.iter().filter_map(|record| match &record.event {
        Event::Carried { frame, .. } => match can::decode(frame) {
            Received::Packet(packet) => Some(packet),
            _ => None,
        },
        _ => None,
    });
    let is_command =
        |packet: &Packet| matches!(packet.channel, Channel::Command(_) | Channel::Motion(_));
    packets.filter(is_command).collect()
}
