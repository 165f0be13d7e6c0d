//! What an SLCAN adapter does with what it is told.

use embedded_can::{Frame as _, nb::Can};
use myactuator_protocol_core::wire::can::SimpleFrame;

use crate::sim::bus::can::{ControllerStatus, ErrorState};
use crate::text::slcan::{AdapterCodec, AdapterCommand, Answer, Rate};

/// Hardware version 1.0, software version 1.3: what widespread adapters tell.
const VERSION: [u8; 4] = *b"1013";
const SERIAL_NUMBER: [u8; 4] = *b"SIM1";
/// Error counts from here on are told as a warning.
const WARNING_FROM: u16 = 96;
/// Time stamps start again after so many milliseconds.
const STAMPS_MS: u64 = 60_000;

/// Whether the adapter takes part in the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Channel {
    #[default]
    Closed,
    Open,
    Listening,
}

/// What was left to do of a byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outcome {
    /// Nothing.
    Done,
    /// The bus takes no more frames: [`send`](Adapter::send) this one before the next byte.
    Waiting(SimpleFrame),
    /// A program asked for a bit rate that the bus does not have.
    WrongRate(Rate),
}

/// An SLCAN adapter on a CAN controller. Answers are appended to `out`.
#[derive(Debug)]
pub(super) struct Adapter {
    codec: AdapterCodec,
    channel: Channel,
    has_stamps: bool,
    /// What the bus runs at, in bit/s.
    bit_rate: u32,
}

impl Adapter {
    pub(super) fn new(bit_rate: u32) -> Self {
        Self {
            codec: AdapterCodec::default(),
            channel: Channel::Closed,
            has_stamps: false,
            bit_rate,
        }
    }

    /// Takes a byte from the program.
    pub(super) fn feed<C: Can<Frame = SimpleFrame>>(
        &mut self,
        byte: u8,
        controller: &mut C,
        status: impl FnOnce() -> ControllerStatus,
        out: &mut Vec<u8>,
    ) -> Outcome {
        let Some(command) = self.codec.feed(byte) else { return Outcome::Done };
        let answer = match (command, self.channel) {
            (AdapterCommand::Nothing, _) => Answer::Done,
            (AdapterCommand::Transmit(frame), Channel::Open) => {
                return if self.send(&frame, controller, out) {
                    Outcome::Done
                } else {
                    Outcome::Waiting(frame)
                };
            }
            (AdapterCommand::SetRate(rate), Channel::Closed) => {
                if rate.bits_per_second() != self.bit_rate {
                    Answer::Refused.encode(out);
                    return Outcome::WrongRate(rate);
                }
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
                Answer::Status(flags(&status()))
            }
            (AdapterCommand::ReadVersion, _) => Answer::Version(VERSION),
            (AdapterCommand::ReadSerialNumber, _) => Answer::SerialNumber(SERIAL_NUMBER),
            _ => Answer::Refused,
        };
        answer.encode(out);
        Outcome::Done
    }

    fn turn(&mut self, channel: Channel) -> Answer {
        self.channel = channel;
        Answer::Done
    }

    /// Gives a frame to the controller; false if that has no room now.
    pub(super) fn send<C: Can<Frame = SimpleFrame>>(
        &self,
        frame: &SimpleFrame,
        controller: &mut C,
        out: &mut Vec<u8>,
    ) -> bool {
        let answer = match controller.transmit(frame) {
            Ok(_) => Answer::Accepted { is_extended: frame.is_extended() },
            Err(nb::Error::WouldBlock) => return false,
            Err(nb::Error::Other(_)) => Answer::Refused,
        };
        answer.encode(out);
        true
    }

    /// Tells the program of a frame from the bus, which came so many milliseconds after the start.
    pub(super) fn receive(&self, frame: SimpleFrame, at_ms: u64, out: &mut Vec<u8>) {
        if self.channel == Channel::Closed {
            return;
        }
        Answer::Frame(frame).encode(out);
        if self.has_stamps
            && let Some(end) = out.pop()
        {
            out.extend_from_slice(format!("{:04X}", at_ms % STAMPS_MS).as_bytes());
            out.push(end);
        }
    }
}

/// 0x04 warning, 0x20 error-passive, 0x80 bus error.
fn flags(status: &ControllerStatus) -> u8 {
    let is_warning = status.transmit_errors.max(status.receive_errors) >= WARNING_FROM;
    let state = match status.state {
        ErrorState::Active => 0,
        ErrorState::Passive => 0x20,
        ErrorState::BusOff => 0xA0,
    };
    state | if is_warning { 0x04 } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::text::can;

    /// A controller with room for so many frames.
    struct Room(usize, Vec<SimpleFrame>);

    impl Can for Room {
        type Frame = SimpleFrame;
        type Error = embedded_can::ErrorKind;

        fn transmit(
            &mut self,
            frame: &SimpleFrame,
        ) -> nb::Result<Option<SimpleFrame>, embedded_can::ErrorKind> {
            if self.1.len() == self.0 {
                return Err(nb::Error::WouldBlock);
            }
            self.1.push(*frame);
            Ok(None)
        }

        fn receive(&mut self) -> nb::Result<SimpleFrame, embedded_can::ErrorKind> {
            Err(nb::Error::WouldBlock)
        }
    }

    fn healthy() -> ControllerStatus {
        ControllerStatus {
            transmit_errors: 0,
            receive_errors: 0,
            state: ErrorState::Active,
            queued: 0,
            received: 0,
            overflows: 0,
        }
    }

    fn told(adapter: &mut Adapter, room: &mut Room, line: &str) -> (String, Outcome) {
        let (mut out, mut last) = (Vec::new(), Outcome::Done);
        for byte in line.bytes().chain([b'\r']) {
            last = adapter.feed(byte, room, healthy, &mut out);
        }
        (String::from_utf8(out).unwrap(), last)
    }

    /// Answers as Lawicel's adapters give them: CR is done, BEL is refused.
    #[test]
    fn an_adapter_is_opened_used_and_closed() {
        let (mut adapter, mut room) = (Adapter::new(500_000), Room(9, Vec::new()));
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
            assert_eq!(
                told(&mut adapter, &mut room, line),
                (answer.into(), Outcome::Done),
                "{line}"
            );
        }
        let sent: Vec<String> = room.1.iter().map(can::frame).collect();
        assert_eq!(sent, ["141#9C00000000000000", "1FFFFFFF#A55A", "141#R8"]);
    }

    #[test]
    fn another_bit_rate_is_refused_and_told() {
        let (mut adapter, mut room) = (Adapter::new(1_000_000), Room(9, Vec::new()));
        let (answer, outcome) = told(&mut adapter, &mut room, "S6");
        assert_eq!((answer.as_str(), outcome), ("\x07", Outcome::WrongRate(Rate::Kbit500)));
        assert_eq!(told(&mut adapter, &mut room, "S8").0, "\r");
    }

    #[test]
    fn a_frame_waits_for_room() {
        let (mut adapter, mut room) = (Adapter::new(1_000_000), Room(0, Vec::new()));
        told(&mut adapter, &mut room, "O");
        let (answer, outcome) = told(&mut adapter, &mut room, "t1410");
        let Outcome::Waiting(frame) = outcome else { panic!("{outcome:?}") };
        assert_eq!((answer.as_str(), can::frame(&frame).as_str()), ("", "141#"));
        let mut out = Vec::new();
        assert!(!adapter.send(&frame, &mut room, &mut out));
        room.0 = 1;
        assert!(adapter.send(&frame, &mut room, &mut out));
        assert_eq!((out.as_slice(), room.1.len()), (&b"z\r"[..], 1));
    }

    #[test]
    fn received_frames_are_told_while_open_with_time_stamps_if_wanted() {
        let (mut adapter, mut room) = (Adapter::new(1_000_000), Room(9, Vec::new()));
        let frame = can::parse_line("241#9C3264").unwrap();
        let mut out = Vec::new();
        adapter.receive(frame, 5, &mut out);
        assert_eq!(out, b"");
        told(&mut adapter, &mut room, "O");
        adapter.receive(frame, 5, &mut out);
        told(&mut adapter, &mut room, "C");
        told(&mut adapter, &mut room, "Z1");
        told(&mut adapter, &mut room, "L");
        // 61.234 s: 1234 ms into the second minute.
        adapter.receive(frame, 61_234, &mut out);
        assert_eq!(String::from_utf8(out).unwrap(), "t24139C3264\rt24139C326404D2\r");
    }

    #[test]
    fn status_flags_follow_the_controller() {
        let with = |transmit_errors, state| {
            flags(&ControllerStatus { transmit_errors, state, ..healthy() })
        };
        assert_eq!(with(95, ErrorState::Active), 0x00);
        assert_eq!(with(96, ErrorState::Active), 0x04);
        assert_eq!(with(128, ErrorState::Passive), 0x24);
        assert_eq!(with(256, ErrorState::BusOff), 0xA4);
    }
}
