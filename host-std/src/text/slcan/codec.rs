//! Commands to an adapter and its answers, byte by byte.

use myactuator_protocol_core::wire::can::SimpleFrame;

use super::Rate;
use super::line::{BELL, END, Line, parse_frame, write_frame};

/// A line to an adapter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AdapterCommand {
    /// `S`: the bit rate of the bus, while the channel is closed.
    SetRate(Rate),
    /// `O`: open the channel.
    Open,
    /// `L`: open the channel without sending anything, not even acknowledgements.
    Listen,
    /// `C`: close the channel.
    Close,
    /// `t`, `T`, `r`, `R`: send a frame.
    Transmit(SimpleFrame),
    /// `V`: the version.
    ReadVersion,
    /// `N`: the serial number.
    ReadSerialNumber,
    /// `F`: the status flags.
    ReadStatus,
    /// `Z`: whether time stamps follow received frames.
    TimeStamps(bool),
    /// An empty line, which has no meaning. It ends a line that an interrupted program began.
    Nothing,
    /// Any other line.
    Unknown,
}

/// The lines that are always the same.
const FIXED: [(&[u8], AdapterCommand); 10] = [
    (b"", AdapterCommand::Nothing),
    (b"O", AdapterCommand::Open),
    (b"L", AdapterCommand::Listen),
    (b"C", AdapterCommand::Close),
    (b"V", AdapterCommand::ReadVersion),
    (b"N", AdapterCommand::ReadSerialNumber),
    (b"F", AdapterCommand::ReadStatus),
    (b"Z0", AdapterCommand::TimeStamps(false)),
    (b"Z1", AdapterCommand::TimeStamps(true)),
    (b"?", AdapterCommand::Unknown),
];

impl AdapterCommand {
    /// Appends the line, including its end. [`Unknown`](Self::Unknown) becomes a line that no adapter knows.
    pub fn encode(&self, line: &mut Vec<u8>) {
        match self {
            Self::Transmit(frame) => return write_frame(frame, line),
            Self::SetRate(rate) => line.extend_from_slice(&[b'S', rate.digit()]),
            fixed => {
                let known = FIXED.iter().find(|(_, command)| command == fixed);
                line.extend(known.into_iter().flat_map(|(text, _)| *text));
            }
        }
        line.push(END);
    }

    fn parse(line: &[u8]) -> Self {
        if let Some((_, command)) = FIXED.iter().find(|(text, _)| *text == line) {
            return *command;
        }
        match line {
            [b'S', digit] => Rate::from_digit(*digit).map(Self::SetRate),
            frame => parse_frame(frame).map(Self::Transmit),
        }
        .unwrap_or(Self::Unknown)
    }
}

/// An answer of an adapter. [`Codec`] reads those to [`AdapterCommand::ReadVersion`], `ReadSerialNumber` and
/// `ReadStatus` as [`Junk`](Self::Junk): nothing here asks for them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// A frame was received from the bus.
    Frame(SimpleFrame),
    /// Done: an empty line.
    Done,
    /// The frame is accepted for sending: `z` for a standard one, `Z` for an extended one. Other
    /// adapters answer [`Done`](Self::Done).
    Accepted {
        /// Whether the frame has an extended identifier.
        is_extended: bool,
    },
    /// BEL: not done.
    Refused,
    /// `V`: hardware and firmware version, two digits each.
    Version([u8; 4]),
    /// `N`: the serial number, four characters.
    SerialNumber([u8; 4]),
    /// `F`: the status flags, 0x04 warning, 0x20 error-passive, 0x80 bus error.
    Status(u8),
    /// A line without a meaning, such as one that has lost bytes.
    Junk,
}

impl Answer {
    /// Appends the answer, including its end. [`Junk`](Self::Junk) becomes a line without a meaning.
    pub fn encode(&self, line: &mut Vec<u8>) {
        match self {
            Self::Frame(frame) => return write_frame(frame, line),
            Self::Refused => return line.push(BELL),
            Self::Done => {}
            Self::Accepted { is_extended: false } => line.push(b'z'),
            Self::Accepted { is_extended: true } => line.push(b'Z'),
            Self::Version(digits) => {
                line.push(b'V');
                line.extend_from_slice(digits);
            }
            Self::SerialNumber(characters) => {
                line.push(b'N');
                line.extend_from_slice(characters);
            }
            Self::Status(flags) => line.extend_from_slice(format!("F{flags:02X}").as_bytes()),
            Self::Junk => line.push(b'?'),
        }
        line.push(END);
    }

    fn parse(line: &[u8]) -> Self {
        match *line {
            [] => Self::Done,
            [b'z'] => Self::Accepted { is_extended: false },
            [b'Z'] => Self::Accepted { is_extended: true },
            // Some adapters put the acknowledgement of a sent frame right before the next frame.
            [b'z' | b'Z', ref frame @ ..] => parse_frame(frame).map_or(Self::Junk, Self::Frame),
            ref frame => parse_frame(frame).map_or(Self::Junk, Self::Frame),
        }
    }
}

/// The computer's end: finds answers in what an adapter sends.
///
/// ```
/// use myactuator_host_std::text::slcan::{Answer, Codec};
///
/// let mut codec = Codec::default();
/// let answers: Vec<Answer> =
///     b"\rt24189C32640032000A00\r\x07".iter().filter_map(|&byte| codec.feed(byte)).collect();
/// assert!(matches!(answers[..], [Answer::Done, Answer::Frame(_), Answer::Refused]));
/// ```
#[derive(Clone, Debug, Default)]
pub struct Codec {
    line: Line,
}

impl Codec {
    /// Takes the next byte. BEL counts anywhere, and ends a line that had begun.
    pub fn feed(&mut self, byte: u8) -> Option<Answer> {
        if byte == BELL {
            self.line.clear();
            return Some(Answer::Refused);
        }
        self.line.feed(byte).map(|line| Answer::parse(&line))
    }
}

/// The adapter's end: finds commands in what a computer sends.
#[derive(Clone, Debug, Default)]
pub struct AdapterCodec {
    line: Line,
}

impl AdapterCodec {
    /// Takes the next byte.
    pub fn feed(&mut self, byte: u8) -> Option<AdapterCommand> {
        self.line.feed(byte).map(|line| AdapterCommand::parse(&line))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::text::can;

    fn frame(text: &str) -> SimpleFrame {
        can::parse_line(text).unwrap()
    }

    fn answers(bytes: &[u8]) -> Vec<Answer> {
        let mut codec = Codec::default();
        bytes.iter().filter_map(|&byte| codec.feed(byte)).collect()
    }

    fn commands(bytes: &[u8]) -> Vec<AdapterCommand> {
        let mut codec = AdapterCodec::default();
        bytes.iter().filter_map(|&byte| codec.feed(byte)).collect()
    }

    /// Lines from the description of Lawicel's adapters, and their meaning.
    #[test]
    fn every_command_goes_both_ways() {
        for (line, command) in [
            (&b"S6\r"[..], AdapterCommand::SetRate(Rate::Kbit500)),
            (b"S8\r", AdapterCommand::SetRate(Rate::Mbit1)),
            (b"S0\r", AdapterCommand::SetRate(Rate::Kbit10)),
            (b"O\r", AdapterCommand::Open),
            (b"L\r", AdapterCommand::Listen),
            (b"C\r", AdapterCommand::Close),
            (b"V\r", AdapterCommand::ReadVersion),
            (b"N\r", AdapterCommand::ReadSerialNumber),
            (b"F\r", AdapterCommand::ReadStatus),
            (b"Z0\r", AdapterCommand::TimeStamps(false)),
            (b"Z1\r", AdapterCommand::TimeStamps(true)),
            (b"\r", AdapterCommand::Nothing),
            (b"t14189C00000000000000\r", AdapterCommand::Transmit(frame("141#9C00000000000000"))),
            (b"t7FF0\r", AdapterCommand::Transmit(frame("7FF#"))),
            (b"T1FFFFFFF2A55A\r", AdapterCommand::Transmit(frame("1FFFFFFF#A55A"))),
            (b"r1418\r", AdapterCommand::Transmit(frame("141#R8"))),
            (b"R000001410\r", AdapterCommand::Transmit(frame("00000141#R"))),
        ] {
            assert_eq!(commands(line), [command]);
            let mut encoded = Vec::new();
            command.encode(&mut encoded);
            assert_eq!(encoded, line);
        }
    }

    #[test]
    fn every_answer_goes_both_ways() {
        for (line, answer) in [
            (&b"\r"[..], Answer::Done),
            (b"z\r", Answer::Accepted { is_extended: false }),
            (b"Z\r", Answer::Accepted { is_extended: true }),
            (b"\x07", Answer::Refused),
            (b"t2412F10A\r", Answer::Frame(frame("241#F10A"))),
        ] {
            assert_eq!(answers(line), [answer]);
            let mut encoded = Vec::new();
            answer.encode(&mut encoded);
            assert_eq!(encoded, line);
        }
    }

    /// As Lawicel describes them. Nothing here asks for them, so they are read as lines without a meaning.
    #[test]
    fn version_serial_number_and_status_are_written_as_described_and_read_as_junk() {
        for (line, answer) in [
            (&b"V1013\r"[..], Answer::Version(*b"1013")),
            (b"NA123\r", Answer::SerialNumber(*b"A123")),
            (b"F00\r", Answer::Status(0)),
            (b"F04\r", Answer::Status(0x04)),
            (b"FA4\r", Answer::Status(0xA4)),
            (b"?\r", Answer::Junk),
        ] {
            let mut encoded = Vec::new();
            answer.encode(&mut encoded);
            assert_eq!(encoded, line);
            assert_eq!(answers(line), [Answer::Junk]);
        }
    }

    /// What begins as a frame and goes on is none, and what ends as one is none either.
    #[test]
    fn line_that_is_too_long_is_no_frame_whatever_it_begins_or_ends_with() {
        let longest = b"ZT1FFFFFFF89C32640032000A00E1F3";
        assert!(matches!(answers(&[&longest[..], b"\r"].concat())[..], [Answer::Frame(_)]));
        for more in [&b"0"[..], b"00", b"E1F3", b"\n0"] {
            assert_eq!(answers(&[&longest[..], more, b"\r"].concat()), [Answer::Junk], "{more:?}");
        }
        for before in 1..100 {
            let line = [&vec![b'?'; before][..], b"t14181000000000000000\r"].concat();
            assert_eq!(answers(&line), [Answer::Junk], "{before}");
            assert_eq!(commands(&line), [AdapterCommand::Unknown], "{before}");
        }
    }

    #[test]
    fn frames_are_read_as_adapters_write_them() {
        let feedback = Answer::Frame(frame("241#9C32640032000A00"));
        assert_eq!(answers(b"t24189c32640032000a00\r"), [feedback]); // small letters
        assert_eq!(answers(b"t24189C32640032000A00E1F3\r"), [feedback]); // time stamp
        assert_eq!(answers(b"zt24189C32640032000A00\r"), [feedback]); // acknowledgement before it
        assert_eq!(answers(b"t24189C32640032000A00\r\n"), [feedback]);
        assert_eq!(answers(b"t24189C32640032000A00\n\r"), [feedback]);
        let longest = Answer::Frame(frame("1FFFFFFF#9C32640032000A00"));
        assert_eq!(answers(b"ZT1FFFFFFF89C32640032000A00E1F3\r"), [longest]);
        assert_eq!(answers(b"r2418BEEF\r"), [Answer::Frame(frame("241#R8"))]);
    }

    #[test]
    fn junk_yields_no_frame_and_does_not_disturb_the_next() {
        for junk in [
            &b"t24189C\r"[..],            // bytes lost
            b"t24189C32640032000A0\r",    // one digit lost
            b"t24189C32640032000A00FF\r", // half a time stamp
            b"t2419000000000000000000\r", // nine bytes
            b"t8000\r",                   // identifier beyond 7FF
            b"T200000000\r",              // identifier beyond 1FFFFFFF
            b"t24\r",
            b"t+410\r",
            b"tG410\r",
            b"t241:\r",
            b"T0000241\r",
            b"FG0\r",
            b"hello\r",
            b"\xFF\x00\r",
            b"t24189C32640t24189C32640032000A00000000\r", // too long
        ] {
            assert_eq!(answers(junk), [Answer::Junk], "{}", String::from_utf8_lossy(junk));
        }
        for junk in [&b"S9\r"[..], b"S\r", b"t1419\r", b"X\r", &[b'x'; 1000], b"\r"] {
            assert!(commands(junk).iter().all(|command| *command == AdapterCommand::Unknown
                || *command == AdapterCommand::Nothing));
        }
        assert_eq!(commands(b"t14189C\rO\r"), [AdapterCommand::Unknown, AdapterCommand::Open]);
        assert_eq!(answers(b"t2418\x07\r"), [Answer::Refused, Answer::Done]);
        let mut endless = vec![b't'; 100_000];
        endless.extend_from_slice(b"\rt2410\r");
        assert_eq!(answers(&endless), [Answer::Junk, Answer::Frame(frame("241#"))]);
    }
}
