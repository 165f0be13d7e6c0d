//! The CAN bus behind an SLCAN adapter on a pseudo-terminal.

use std::collections::VecDeque;
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use embedded_can::{Frame as _, nb::Can as _};
use myactuator_protocol_core::wire::can::SimpleFrame;

use super::pty::Pty;
use super::{End, Notice, ServeError};
use crate::sim::bus::can::{CanPort, ControllerStatus, ErrorState};
use crate::text::slcan::{AdapterCodec, AdapterCommand, Answer};

/// Hardware version 1.0, software version 1.3, as widespread adapters report.
const VERSION: [u8; 4] = *b"1013";
const SERIAL_NUMBER: [u8; 4] = *b"SIM1";
/// Error counts from here on are reported as a warning.
const WARNING_FROM: u16 = 96;
/// Time stamps start again from 0 after so many milliseconds.
const STAMPS_MS: u64 = 60_000;

/// A serial port at one end, an adapter on the simulated bus at the other.
#[derive(Debug)]
pub(super) struct AdapterEnd {
    pty: Pty,
    /// The name of the bus.
    bus: String,
    adapter: Adapter,
    /// Written by a program, and not decoded yet.
    unread: VecDeque<u8>,
}

impl AdapterEnd {
    pub(super) fn new(pty: Pty, port: CanPort, bus: &str, bit_rate: u32) -> Self {
        Self {
            pty,
            bus: bus.to_owned(),
            adapter: Adapter::new(port, bit_rate),
            unread: VecDeque::new(),
        }
    }

    /// The next byte from the program.
    fn next(&mut self) -> Result<Option<u8>, ServeError> {
        if self.unread.is_empty() {
            let mut chunk = [0; 256];
            let length = self.pty.read(&mut chunk)?;
            self.unread.extend(chunk.iter().take(length));
        }
        Ok(self.unread.pop_front())
    }
}

impl End for AdapterEnd {
    fn source(&self) -> Option<BorrowedFd<'_>> {
        self.adapter.waiting.is_none().then(|| self.pty.as_fd())
    }

    fn hold(&mut self) {
        self.pty.hold();
    }

    fn take_in(&mut self) -> Result<(), ServeError> {
        Ok(self.pty.take_in()?)
    }

    fn answers_at_once(&self) -> bool {
        true
    }

    fn pump(&mut self, notify: &mut dyn FnMut(Notice)) -> Result<(), ServeError> {
        self.pty.admit_all()?;
        while self.adapter.is_ready()
            && let Some(byte) = self.next()?
        {
            if let Some(asked) = self.adapter.feed(byte) {
                let (bus, bit_rate) = (self.bus.clone(), self.adapter.bit_rate);
                notify(Notice::WrongRate { bus, asked, bit_rate });
            }
        }
        self.adapter.receive();
        Ok(self.pty.write(&std::mem::take(&mut self.adapter.answers))?)
    }

    fn patience(&mut self) -> Option<Duration> {
        (self.adapter.status().received > 0).then_some(Duration::ZERO)
    }
}

/// Whether the adapter takes part in the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Channel {
    Closed,
    Open,
    Listening,
}

/// A frame that waits for room in the controller.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Waiting {
    /// The program waits for the answer.
    Unanswered(SimpleFrame),
    /// The program has got the answer that it is taken; then a more urgent frame has pushed it out of its mailbox.
    PushedOut(SimpleFrame),
}

/// What an adapter does with what it is told.
#[derive(Debug)]
struct Adapter {
    port: CanPort,
    /// The bit rate of the bus, in bit/s. A closed adapter runs at it, too, so as not to disturb the bus.
    bit_rate: u32,
    /// The bit rate that the program wants.
    asked: u32,
    codec: AdapterCodec,
    channel: Channel,
    has_stamps: bool,
    /// A frame that the controller has no room for.
    waiting: Option<Waiting>,
    /// What is to be reported to the program.
    answers: Vec<u8>,
}

impl Adapter {
    fn new(port: CanPort, bit_rate: u32) -> Self {
        Self {
            port,
            bit_rate,
            asked: bit_rate,
            codec: AdapterCodec::default(),
            channel: Channel::Closed,
            has_stamps: false,
            waiting: None,
            answers: Vec::new(),
        }
    }

    /// Takes a byte from the program, if it [can](Self::is_ready). If the program opens the adapter at another bit
    /// rate than the bus's, returns that.
    fn feed(&mut self, byte: u8) -> Option<u32> {
        let command = self.codec.feed(byte)?;
        let before = self.channel;
        let answer = match (command, self.channel) {
            (AdapterCommand::Nothing, _) => Answer::Done,
            (AdapterCommand::Transmit(frame), Channel::Open) => {
                self.waiting = Some(Waiting::Unanswered(frame));
                self.is_ready();
                return None;
            }
            (AdapterCommand::SetRate(rate), Channel::Closed) => {
                self.asked = rate.bits_per_second();
                Answer::Done
            }
            (AdapterCommand::Open, Channel::Closed) => self.turn(Channel::Open),
            (AdapterCommand::Listen, Channel::Closed) => self.turn(Channel::Listening),
            (AdapterCommand::Close, Channel::Open | Channel::Listening) => {
                self.turn(Channel::Closed)
            }
            (AdapterCommand::TimeStamps(has_stamps), Channel::Closed) => {
                self.has_stamps = has_stamps;
                Answer::Done
            }
            (AdapterCommand::ReadStatus, Channel::Open | Channel::Listening) => {
                let status = self.status();
                let errors = status.transmit_errors.max(status.receive_errors);
                Answer::Status(flags(errors, status.state))
            }
            (AdapterCommand::ReadVersion, _) => Answer::Version(VERSION),
            (AdapterCommand::ReadSerialNumber, _) => Answer::SerialNumber(SERIAL_NUMBER),
            _ => Answer::Refused,
        };
        answer.encode(&mut self.answers);
        let is_opened = before == Channel::Closed && self.channel != before;
        (is_opened && self.is_stranger()).then_some(self.asked)
    }

    fn turn(&mut self, channel: Channel) -> Answer {
        self.channel = channel;
        // A station that only listens signals no errors, at any rate.
        let bit_rate = if channel == Channel::Open { self.asked } else { self.bit_rate };
        self.port.world().set_bit_rate(self.port.station(), bit_rate);
        Answer::Done
    }

    /// Whether the program wants another bit rate than the bus has.
    const fn is_stranger(&self) -> bool {
        self.asked != self.bit_rate
    }

    fn status(&self) -> ControllerStatus {
        self.port.world().controller(self.port.station())
    }

    /// Hands a waiting frame to the controller, if that has room now; returns whether none waits any more. If nothing
    /// leaves the controller, a frame that finds no room is refused.
    fn is_ready(&mut self) -> bool {
        while let Some(Waiting::Unanswered(frame) | Waiting::PushedOut(frame)) = self.waiting {
            let (answer, next) = match self.port.transmit(&frame) {
                Ok(pushed_out) => {
                    let answer = Answer::Accepted { is_extended: frame.is_extended() };
                    (answer, pushed_out.map(Waiting::PushedOut))
                }
                Err(nb::Error::WouldBlock) if self.status().state == ErrorState::Active => {
                    return false;
                }
                Err(_) => (Answer::Refused, None),
            };
            if matches!(self.waiting, Some(Waiting::Unanswered(_))) {
                answer.encode(&mut self.answers);
            }
            self.waiting = next;
        }
        true
    }

    /// Reports the frames from the bus to the program.
    fn receive(&mut self) {
        // What comes meanwhile waits for the next call: on a slow computer there would be no end of it.
        for _ in 0..self.status().received {
            let Ok(frame) = self.port.receive() else { break };
            let hears = match self.channel {
                Channel::Closed => false,
                Channel::Listening => !self.is_stranger(),
                Channel::Open => true,
            };
            if !hears {
                continue;
            }
            Answer::Frame(frame).encode(&mut self.answers);
            if self.has_stamps
                && let Some(end) = self.answers.pop()
            {
                let at_ms = self.port.world().now().as_micros() / 1_000;
                self.answers.extend(format!("{:04X}", at_ms % STAMPS_MS).into_bytes());
                self.answers.push(end);
            }
        }
    }
}

/// 0x04 warning, 0x20 error-passive, 0x80 bus error.
fn flags(errors: u16, state: ErrorState) -> u8 {
    let state = match state {
        ErrorState::Active => 0,
        ErrorState::Passive => 0x20,
        ErrorState::BusOff => 0xA0,
    };
    state | if errors >= WARNING_FROM { 0x04 } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::bus::can::{CanWorld, ControllerConfig};
    use crate::sim::bus::faults::Babble;
    use crate::text::can;
    use myactuator_protocol_core::time::{Duration, Instant};

    /// An adapter with room for so many frames, and another station on its bus.
    fn adapter(bit_rate: u32, transmit_queue: usize) -> (CanWorld, Adapter, CanPort) {
        let world = CanWorld::new(bit_rate, 1);
        let controller = ControllerConfig { transmit_queue, ..ControllerConfig::SOCKETCAN };
        let adapter = Adapter::new(world.port_with(controller), bit_rate);
        (world.clone(), adapter, world.port())
    }

    fn reported(adapter: &mut Adapter) -> String {
        String::from_utf8(std::mem::take(&mut adapter.answers)).unwrap()
    }

    /// The answer to a line, and the bit rate at which it opens the adapter where the bus has another.
    fn say(adapter: &mut Adapter, line: &str) -> (String, Option<u32>) {
        let bytes = line.bytes().chain([b'\r']);
        let wrong = bytes.filter_map(|byte| adapter.feed(byte)).last();
        (reported(adapter), wrong)
    }

    /// Answers as Lawicel's adapters give them: CR is done, BEL is refused.
    #[test]
    fn an_adapter_is_opened_used_and_closed() {
        let (world, mut adapter, mut other) = adapter(500_000, 9);
        let dialogue = [
            ("", "\r"),
            ("C", "\x07"),
            ("V", "V1013\r"),
            ("N", "NSIM1\r"),
            ("F", "\x07"),
            ("t14189C00000000000000", "\x07"),
            ("S6", "\r"),
            ("Z0", "\r"),
            ("O", "\r"),
            ("O", "\x07"),
            ("S6", "\x07"),
            ("Z1", "\x07"),
            ("t14189C00000000000000", "z\r"),
            ("T1FFFFFFF2A55A", "Z\r"),
            ("r1418", "z\r"),
            ("F", "F00\r"),
            ("nonsense", "\x07"),
            ("C", "\r"),
            ("L", "\r"),
            ("t14189C00000000000000", "\x07"),
        ];
        for (line, answer) in dialogue {
            assert_eq!(say(&mut adapter, line), (answer.into(), None), "{line}");
        }
        world.run_for(Duration::from_millis(2));
        let sent: Vec<_> =
            std::iter::from_fn(|| other.receive().ok()).map(|frame| can::frame(&frame)).collect();
        assert_eq!(sent, ["141#9C00000000000000", "1FFFFFFF#A55A", "141#R8"]);
    }

    #[test]
    fn adapter_at_another_bit_rate_disturbs_the_bus_and_reports_that() {
        let (world, mut adapter, mut other) = adapter(1_000_000, 2);
        let mut hears = |adapter: &mut Adapter| {
            other.transmit(&can::parse_line("241#9C").unwrap()).unwrap();
            world.run_for(Duration::from_millis(20));
            adapter.receive();
            (!reported(adapter).is_empty(), world.controller(other.station()).transmit_errors)
        };
        say(&mut adapter, "S6");
        assert_eq!(say(&mut adapter, "L"), ("\r".into(), Some(500_000)));
        // It only listens: nobody is disturbed, and it makes out nothing.
        assert_eq!(hears(&mut adapter), (false, 0));
        say(&mut adapter, "C");
        assert_eq!(say(&mut adapter, "O"), ("\r".into(), Some(500_000)));
        // It breaks 15 frames; after that nobody acknowledges them, up to error-passive.
        assert_eq!(hears(&mut adapter), (false, 128));
        // Its own frames stay where they are: there is room for two.
        for answer in ["z\r", "z\r", "\x07"] {
            world.run_for(Duration::from_millis(20));
            assert_eq!(say(&mut adapter, "t1410"), (answer.into(), None));
        }
        for line in ["C", "S8", "O"] {
            assert_eq!(say(&mut adapter, line), ("\r".into(), None));
        }
        assert!(hears(&mut adapter).0);
    }

    #[test]
    fn a_frame_waits_for_room() {
        let (world, mut adapter, _other) = adapter(1_000_000, 1);
        say(&mut adapter, "O");
        assert_eq!(say(&mut adapter, "t1410").0, "z\r");
        assert_eq!(say(&mut adapter, "t1420").0, "");
        assert!(!adapter.is_ready());
        world.run_for(Duration::from_millis(1));
        assert!(adapter.is_ready() && adapter.waiting.is_none());
        assert_eq!(reported(&mut adapter), "z\r");
        assert_eq!(adapter.status().queued, 1);
    }

    #[test]
    fn a_frame_that_a_more_urgent_one_pushes_out_waits_and_is_answered_once() {
        let world = CanWorld::new(1_000_000, 1);
        let port = world.port_with(ControllerConfig::MAILBOXES);
        let (mut adapter, mut other) = (Adapter::new(port, 1_000_000), world.port());
        say(&mut adapter, "O");
        // Three mailboxes, of which one is on the wire; 141 takes the place of 403.
        for line in ["t4010", "t4020", "t4030"] {
            assert_eq!(say(&mut adapter, line).0, "z\r");
        }
        world.run_for(Duration::from_micros(10));
        assert_eq!(say(&mut adapter, "t1410").0, "z\r");
        assert!(!adapter.is_ready());
        world.run_for(Duration::from_micros(100));
        assert!(adapter.is_ready());
        world.run_for(Duration::from_millis(1));
        let heard = std::iter::from_fn(|| other.receive().ok());
        let heard: Vec<_> = heard.map(|frame| can::frame(&frame)).collect();
        assert_eq!(heard, ["401#", "141#", "402#", "403#"]);
        assert_eq!(reported(&mut adapter), "");
    }

    #[test]
    fn open_adapter_reports_received_frames_with_optional_time_stamps() {
        let (world, mut adapter, mut other) = adapter(1_000_000, 9);
        let mut hear_until = |adapter: &mut Adapter, at_ms| {
            other.transmit(&can::parse_line("241#9C3264").unwrap()).unwrap();
            world.run_until(Instant::ZERO + Duration::from_millis(at_ms));
            adapter.receive();
            reported(adapter)
        };
        assert_eq!(hear_until(&mut adapter, 5), "");
        say(&mut adapter, "O");
        assert_eq!(hear_until(&mut adapter, 10), "t24139C3264\r");
        for line in ["C", "Z1", "L"] {
            say(&mut adapter, line);
        }
        // 61.234 s: 1234 ms into the second minute.
        assert_eq!(hear_until(&mut adapter, 61_234), "t24139C326404D2\r");
    }

    #[test]
    fn status_flags_follow_the_controller() {
        assert_eq!(flags(95, ErrorState::Active), 0x00);
        assert_eq!(flags(96, ErrorState::Active), 0x04);
        assert_eq!(flags(128, ErrorState::Passive), 0x24);
        assert_eq!(flags(256, ErrorState::BusOff), 0xA4);
    }

    /// Each look at the bus takes longer than the interval to the next.
    #[test]
    fn adapter_is_not_blocked_by_a_bus_too_slow_for_real_time() {
        let (world, mut adapter, other) = adapter(500_000, 9);
        let frame = can::parse_line("123#00").unwrap();
        let babble = Babble { interval: Duration::from_millis(1), frame: Some(frame) };
        world.babble(other.station(), Some(babble));
        let begun = std::time::Instant::now();
        world.every(Duration::from_micros(100), move |_| {
            std::thread::sleep(std::time::Duration::from_micros(200));
            // For ever, that is: a machine that does other things is late, too.
            assert!(begun.elapsed().as_secs() < 60, "it is held up");
        });
        let _world = world.in_real_time();
        std::thread::sleep(std::time::Duration::from_millis(3));
        adapter.receive();
    }
}
