//! CAN frames as text: `ID#DATA` of cansend, and the lines of `candump` and `candump -L`.

use std::fmt;

use embedded_can::{ExtendedId, Frame as _, Id, StandardId};
use myactuator_protocol_core::wire::can::SimpleFrame;

/// The bit that an interface sets in the identifier of its own error reports.
const ERROR_FRAME: u32 = 0x2000_0000;

/// Why a text is not a classic CAN data or remote frame.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotAFrame {
    /// Neither `ID#DATA` nor a line of candump.
    #[error("expected a CAN frame such as 141#A400F401A08C0000, or a line of candump")]
    Notation,
    /// The identifier is neither 3 nor 8 hexadecimal digits, or too large.
    #[error(
        "expected an identifier of 3 hexadecimal digits up to 7FF, or of 8 up to 1FFFFFFF, found \"{0}\""
    )]
    Identifier(String),
    /// The data are not whole bytes in hexadecimal, at most eight.
    #[error("expected up to 8 data bytes of two hexadecimal digits each, found \"{0}\"")]
    Data(String),
    /// candump's length and bytes disagree.
    #[error("the length says {expected} data bytes, but the line has {found}")]
    Length {
        /// The length in the text.
        expected: usize,
        /// The bytes found.
        found: usize,
    },
    /// A CAN FD frame, which the protocol does not use.
    #[error("this is a CAN FD frame, and the protocol uses classic CAN frames only")]
    Fd,
    /// An error report of the CAN interface, not a frame.
    #[error("this is an error report of the CAN interface, no frame from a motor")]
    ErrorReport,
}

/// A frame in candump's notation: `141#A400F401A08C0000`, `141#R` for a remote frame.
pub fn frame(frame: &SimpleFrame) -> String {
    let id = digits(frame.id());
    match (frame.is_remote_frame(), frame.dlc()) {
        (false, _) => format!("{id}#{}", super::joined_hex(frame.data(), "")),
        (true, 0) => format!("{id}#R"),
        (true, length) => format!("{id}#R{length}"),
    }
}

/// An identifier: three digits if it is a standard one, eight if it is extended.
pub(super) fn digits(id: Id) -> String {
    match id {
        Id::Standard(id) => format!("{:03X}", id.as_raw()),
        Id::Extended(id) => format!("{:08X}", id.as_raw()),
    }
}

/// When and where a frame was heard, as far as the log says.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Stamp {
    /// The time as candump wrote it, without the brackets: mostly seconds such as `1436509052.249713`, since 1970 or
    /// since another start that candump was given.
    pub time: Option<String>,
    /// The interface, such as `can0`.
    pub interface: Option<String>,
}

/// As `candump -L` writes it: `(1436509052.249713) can0`.
impl fmt::Display for Stamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let between = if self.time.is_some() && self.interface.is_some() { " " } else { "" };
        let time = self.time.as_ref().map_or(String::new(), |time| format!("({time})"));
        write!(f, "{time}{between}{}", self.interface.as_deref().unwrap_or_default())
    }
}

/// A parsed line of a log: `ID#DATA`, or as `candump` or `candump -L` print it, with or without time stamps, interface
/// and flags.
///
/// ```
/// use myactuator_host_std::text::can::{LogLine, frame};
///
/// for line in [
///     "(1436509052.249713) can0 141#A400F401A08C0000",
///     " (1436509052.249713)  can0  141   [8]  A4 00 F4 01 A0 8C 00 00",
/// ] {
///     let line = LogLine::read(line);
///     assert_eq!(line.stamp.to_string(), "(1436509052.249713) can0");
///     assert_eq!(frame(&line.frame.unwrap()), "141#A400F401A08C0000");
/// }
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct LogLine<'a> {
    /// Time and interface; neither if the line is not from a log.
    pub stamp: Stamp,
    /// The text after them.
    pub rest: &'a str,
    /// The frame in that text, or what was expected and found.
    pub frame: Result<SimpleFrame, NotAFrame>,
}

impl<'a> LogLine<'a> {
    /// Parses a line.
    pub fn read(line: &'a str) -> Self {
        let line = line.trim();
        let (stamp, rest) = stamp(line);
        match stamped_frame(&stamp, rest) {
            Err(NotAFrame::Notation) => {
                Self { stamp: Stamp::default(), rest: line, frame: Err(NotAFrame::Notation) }
            }
            frame => Self { stamp, rest, frame },
        }
    }
}

/// The frame of a [`LogLine`] alone.
///
/// # Errors
/// [`NotAFrame`] says what was expected and found.
pub fn parse_line(line: &str) -> Result<SimpleFrame, NotAFrame> {
    LogLine::read(line).frame
}

/// Splits off time and interface.
fn stamp(line: &str) -> (Stamp, &str) {
    // candump can also write date and time, separated by a space.
    let (time, line) = match line.strip_prefix('(').and_then(|line| line.split_once(')')) {
        Some((time, rest)) => (Some(time.to_owned()), rest.trim_start()),
        None => (None, line),
    };
    let (interface, rest) = match line.split_once(char::is_whitespace) {
        Some((word, rest)) if !word.contains('#') && !rest.trim_start().starts_with('[') => {
            (Some(word.to_owned()), rest.trim_start())
        }
        _ => (None, line),
    };
    (Stamp { time, interface }, rest)
}

/// The frame after this stamp.
fn stamped_frame(stamp: &Stamp, text: &str) -> Result<SimpleFrame, NotAFrame> {
    let words: Vec<&str> = text.split_whitespace().collect();
    if let Some(at) = words.iter().position(|word| word.starts_with('[') && word.ends_with(']')) {
        let (before, rest) = words.split_at(at);
        return match (before, rest) {
            ([.., id], [length, data @ ..]) => from_columns(id, length, data),
            _ => Err(NotAFrame::Notation),
        };
    }
    match (stamp, words.as_slice()) {
        (Stamp { time: None, interface: None }, [notation]) => from_notation(notation),
        // Flags may follow it (candump -L -x).
        (Stamp { time: Some(_), interface: Some(_) }, [notation, flags @ ..])
            if flags.iter().all(|flag| flag.len() == 1) =>
        {
            from_notation(notation)
        }
        _ => Err(NotAFrame::Notation),
    }
}

/// `141#A400F401A08C0000`, `141#R`, `141##1…`. Dots between bytes are allowed, as for cansend.
fn from_notation(text: &str) -> Result<SimpleFrame, NotAFrame> {
    let (id, data) = text.split_once('#').ok_or(NotAFrame::Notation)?;
    let parsed_id = identifier(id)?;
    if data.starts_with('#') {
        return Err(NotAFrame::Fd);
    }
    let wrong = || NotAFrame::Data(data.to_owned());
    if let Some(length) = data.strip_prefix(['R', 'r']) {
        let length = if length.is_empty() { 0 } else { length.parse().map_err(|_| wrong())? };
        return SimpleFrame::new_remote(parsed_id, length).ok_or_else(wrong);
    }
    // `_9` after eight bytes is a length code beyond 8; there are still eight bytes.
    let bytes = data.split_once('_').map_or(data, |(bytes, _)| bytes).replace('.', "");
    let bytes = hex_bytes(&bytes).ok_or_else(wrong)?;
    SimpleFrame::new(parsed_id, &bytes).ok_or_else(wrong)
}

/// The columns of `candump`: identifier, length in brackets, bytes, and perhaps characters.
fn from_columns(id: &str, length: &str, data: &[&str]) -> Result<SimpleFrame, NotAFrame> {
    let id = identifier(id)?;
    let length = length.trim_matches(['[', ']']);
    if length.len() != 1 {
        return Err(NotAFrame::Fd); // candump writes its lengths with two digits
    }
    let expected: usize = length.parse().map_err(|_| NotAFrame::Notation)?;
    if data.first() == Some(&"remote") {
        return SimpleFrame::new_remote(id, expected).ok_or(NotAFrame::Notation);
    }
    // The bytes may be followed by the same as characters in quotes (candump -a).
    let mut bytes = Vec::new();
    for word in data.iter().take_while(|word| !word.starts_with('\'')) {
        match hex_bytes(word).as_deref() {
            Some([byte]) => bytes.push(*byte),
            _ => return Err(NotAFrame::Data((*word).to_owned())),
        }
    }
    if bytes.len() != expected {
        return Err(NotAFrame::Length { expected, found: bytes.len() });
    }
    SimpleFrame::new(id, &bytes).ok_or(NotAFrame::Notation)
}

/// Reads what [`digits`] writes.
pub(super) fn identifier(text: &str) -> Result<Id, NotAFrame> {
    let wrong = || NotAFrame::Identifier(text.to_owned());
    if !text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return Err(wrong());
    }
    let raw = u32::from_str_radix(text, 16).map_err(|_| wrong())?;
    match text.len() {
        3 => u16::try_from(raw).ok().and_then(StandardId::new).map(Id::from),
        8 if raw & ERROR_FRAME != 0 => return Err(NotAFrame::ErrorReport),
        8 => ExtendedId::new(raw).map(Id::from),
        _ => None,
    }
    .ok_or_else(wrong)
}

/// Bytes of two hexadecimal digits each, without separators.
pub(super) fn hex_bytes(text: &str) -> Option<Vec<u8>> {
    let digits: Vec<u8> =
        text.chars().map(|c| Some(c.to_digit(16)? as u8)).collect::<Option<_>>()?;
    let (pairs, rest) = digits.as_chunks::<2>();
    rest.is_empty().then(|| pairs.iter().map(|[high, low]| high << 4 | low).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn normal(line: &str) -> Result<String, NotAFrame> {
        parse_line(line).map(|parsed| frame(&parsed))
    }

    #[test]
    fn every_notation_of_can_utils_is_read() {
        for line in [
            "141#A400F401A08C0000",
            "141#a4.00.f4.01.a0.8c.00.00",
            "  can0  141   [8]  A4 00 F4 01 A0 8C 00 00",
            " (1436509052.249713)  can0  141   [8]  A4 00 F4 01 A0 8C 00 00   '........'",
            "  can0  RX - -  141   [8]  A4 00 F4 01 A0 8C 00 00",
            "(1436509052.249713) can0 141#A400F401A08C0000",
            "(1436509052.249713) can0 141#A400F401A08C0000 R",
            "(1436509052.249713) vcan0 141#A400F401A08C0000 T",
        ] {
            assert_eq!(normal(line).as_deref(), Ok("141#A400F401A08C0000"), "{line}");
        }
        assert_eq!(normal("141#F1").as_deref(), Ok("141#F1"));
        assert_eq!(normal("can0 241 [0]").as_deref(), Ok("241#"));
        assert_eq!(normal("241#R").as_deref(), Ok("241#R"));
        assert_eq!(normal("can0  241   [8]  remote request").as_deref(), Ok("241#R8"));
        assert_eq!(normal("00000141#01").as_deref(), Ok("00000141#01"));
    }

    #[test]
    fn time_and_interface_stand_before_the_frame() {
        let read = |line| {
            let LogLine { stamp, rest, frame } = LogLine::read(line);
            (stamp.time, stamp.interface, rest, frame.is_ok())
        };
        let (time, can0) = (Some("1.5".to_owned()), Some("can0".to_owned()));
        assert_eq!(read("(1.5) can0 141#00 T"), (time.clone(), can0.clone(), "141#00 T", true));
        assert_eq!(read("can0 RX - - 141 [0]"), (None, can0.clone(), "RX - - 141 [0]", true));
        assert_eq!(read("(1.5) 141 [0]"), (time.clone(), None, "141 [0]", true));
        assert_eq!(read("141 [0]"), (None, None, "141 [0]", true));
        assert_eq!(read("(1.5) can0 141##1"), (time, can0, "141##1", false));
        for line in ["(1.5) 141#00", "can0 141#00", "(1.5 can0 141#00", "(1.5) can0 x", "141#00 T"]
        {
            assert_eq!(read(line), (None, None, line, false));
        }
    }

    #[test]
    fn lines_that_are_no_frame_are_refused_with_the_reason() {
        assert_eq!(normal("141##1AABB"), Err(NotAFrame::Fd));
        assert_eq!(normal("can0  141  [08]  A4 00 F4 01 A0 8C 00 00"), Err(NotAFrame::Fd));
        assert_eq!(normal("1#00"), Err(NotAFrame::Identifier("1".into())));
        assert_eq!(normal("8FF#00"), Err(NotAFrame::Identifier("8FF".into())));
        assert_eq!(normal("+41#00"), Err(NotAFrame::Identifier("+41".into())));
        assert_eq!(normal("141#0"), Err(NotAFrame::Data("0".into())));
        assert_eq!(normal("141#é0"), Err(NotAFrame::Data("é0".into())));
        assert!(matches!(normal("141#000000000000000000"), Err(NotAFrame::Data(_))));
        assert_eq!(normal("can0 141 [3] 01 02"), Err(NotAFrame::Length { expected: 3, found: 2 }));
        assert_eq!(
            normal("can0  20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME"),
            Err(NotAFrame::ErrorReport)
        );
        for line in ["hello", "see 141#00 there", "[8]", "141#00 142#00"] {
            assert_eq!(normal(line), Err(NotAFrame::Notation), "{line}");
        }
    }
}
