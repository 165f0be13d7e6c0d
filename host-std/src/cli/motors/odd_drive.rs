//! A drive that no quirk makes, for tests: it keeps no other id, and runs on after 0x76. What it does not know it
//! answers with its last reply.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use myactuator_host_std::sim::CanFleet;
use myactuator_host_std::sim::Fleet;
use myactuator_host_std::sim::bus::Node;
use myactuator_host_std::sim::bus::can::ControllerConfig;
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::wire::can::{self, Received, SimpleFrame};
use myactuator_protocol_core::{Channel, Data, MotorId, Packet, Target};

/// How long it takes to answer.
const RESPONSE: Duration = Duration::from_micros(800);

#[derive(Debug)]
pub(super) struct OddDrive {
    /// What it was told, in order.
    pub(super) told: Vec<u8>,
    /// What it says of that.
    pub(super) run_time_ms: u32,
    last: Data,
    waiting: VecDeque<(Instant, Packet)>,
}

/// One with id 1, alone on a bus, and a hand on it.
pub(super) fn alone() -> (CanFleet, Arc<Mutex<OddDrive>>) {
    let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
    // In place of the usual one.
    fleet.world.cut(fleet.drives[0].station());
    let drive =
        OddDrive { told: Vec::new(), run_time_ms: 0, last: [0; 8], waiting: VecDeque::new() };
    let drive = Arc::new(Mutex::new(drive));
    fleet.world.attach_with(Arc::clone(&drive), ControllerConfig::MAILBOXES);
    (fleet, drive)
}

impl OddDrive {
    fn answer(&mut self, data: Data) -> Option<Data> {
        self.told.push(data[0]);
        match data {
            [0x76, ..] => None,
            [0x80 | 0x81, ..] => Some(data),
            // 48 V.
            [0x9A, ..] => Some([0x9A, 25, 0, 0, 0xE0, 1, 0, 0]),
            [0xB2, ..] => {
                let [a, b, c, d] = 2_025_070_202_u32.to_le_bytes();
                Some([0xB2, 0, 0, 0, a, b, c, d])
            }
            [0xB1, ..] => {
                let [a, b, c, d] = self.run_time_ms.to_le_bytes();
                Some([0xB1, 0, 0, 0, a, b, c, d])
            }
            [byte @ (0x92 | 0x9C | 0x9D), ..] => Some([byte, 0, 0, 0, 0, 0, 0, 0]),
            _ => Some(self.last),
        }
    }
}

impl Node<SimpleFrame> for OddDrive {
    fn handle_frame(&mut self, frame: &SimpleFrame, now: Instant) {
        let Received::Packet(Packet { channel, data }) = can::decode(frame) else { return };
        if channel == Channel::Command(Target::Motor(MotorId::MIN))
            && let Some(data) = self.answer(data)
        {
            self.last = data;
            let answer = Packet { channel: Channel::Reply(MotorId::MIN), data };
            self.waiting.push_back((now + RESPONSE, answer));
        }
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<SimpleFrame> {
        self.waiting.front().filter(|(at, _)| *at <= now)?;
        can::encode(&self.waiting.pop_front()?.1)
    }

    fn poll_at(&self) -> Option<Instant> {
        self.waiting.front().map(|(at, _)| *at)
    }
}
