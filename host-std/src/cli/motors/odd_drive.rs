//! A drive for tests that no quirk describes. It stores no other id, and runs on after 0x76. It answers unknown
//! commands with its last reply. Its brake may slip after it has held for a while.

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

#[derive(Debug, Default)]
pub(super) struct OddDrive {
    /// The command bytes that it got, in order.
    pub(super) received: Vec<u8>,
    /// The run time that it reports.
    pub(super) run_time_ms: u32,
    /// The running mode that it reports; `None` if it does not answer that.
    pub(super) mode: Option<u8>,
    /// Whether it draws a current.
    pub(super) draws: bool,
    /// How many releases of its brake it ignores.
    pub(super) ignored_releases: u32,
    /// Whether the last command to its brake was a release.
    pub(super) is_open: bool,
    /// How long after a lock the shaft turns behind the brake.
    pub(super) slips_after: Option<Duration>,
    locked_at: Option<Instant>,
    last: Data,
    waiting: VecDeque<(Instant, Packet)>,
}

/// A drive with id 1, alone on a bus, and access to it.
pub(super) fn alone() -> (CanFleet, Arc<Mutex<OddDrive>>) {
    let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
    // It takes the place of the usual drive.
    fleet.world.cut(fleet.drives[0].station());
    let drive = Arc::new(Mutex::new(OddDrive { run_time_ms: 1_000, ..OddDrive::default() }));
    fleet.world.attach_with(Arc::clone(&drive), ControllerConfig::MAILBOXES);
    (fleet, drive)
}

impl OddDrive {
    fn answer(&mut self, data: Data, now: Instant) -> Option<Data> {
        self.received.push(data[0]);
        match data[0] {
            0x77 if self.ignored_releases > 0 => {
                self.ignored_releases -= 1;
                return None;
            }
            0x77 => (self.is_open, self.locked_at) = (true, None),
            0x78 => (self.is_open, self.locked_at) = (false, Some(now)),
            _ => {}
        }
        match data {
            [0x76, ..] => None,
            [0x77 | 0x78 | 0x80 | 0x81, ..] => Some(data),
            [0x70, ..] if self.mode.is_some() => Some([0x70, 0, 0, 0, 0, 0, 0, self.mode?]),
            // 48 V.
            [0x9A, ..] => Some([0x9A, 25, 0, self.is_open.into(), 0xE0, 1, 0, 0]),
            [0xB2, ..] => {
                let [a, b, c, d] = 2_025_070_202_u32.to_le_bytes();
                Some([0xB2, 0, 0, 0, a, b, c, d])
            }
            [0xB1, ..] => {
                let [a, b, c, d] = self.run_time_ms.to_le_bytes();
                Some([0xB1, 0, 0, 0, a, b, c, d])
            }
            // 50 dps.
            [0x9C, ..] if self.slips(now) => Some([0x9C, 25, 0, 0, 50, 0, 0, 0]),
            // 1 A.
            [0x9C, ..] if self.draws => Some([0x9C, 0, 100, 0, 0, 0, 0, 0]),
            [byte @ (0x92 | 0x9C | 0x9D), ..] => Some([byte, 0, 0, 0, 0, 0, 0, 0]),
            _ => Some(self.last),
        }
    }

    fn slips(&self, now: Instant) -> bool {
        let since = self.locked_at.zip(self.slips_after).map(|(at, after)| at + after);
        since.is_some_and(|since| since <= now)
    }
}

impl Node<SimpleFrame> for OddDrive {
    fn handle_frame(&mut self, frame: &SimpleFrame, now: Instant) {
        let Received::Packet(Packet { channel, data }) = can::decode(frame) else { return };
        if channel == Channel::Command(Target::Motor(MotorId::MIN))
            && let Some(data) = self.answer(data, now)
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
