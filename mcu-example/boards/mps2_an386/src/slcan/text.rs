//! The lines to the adapter and from it.

use embedded_can::{ExtendedId, Frame as _, Id, StandardId};
use heapless::Vec;
use myactuator_protocol_core::wire::can::SimpleFrame;

const END: u8 = b'\r';
const BELL: u8 = 0x07;
/// The longest line: `T`, identifier, length, eight bytes, a time stamp, and its end.
pub(super) const LONGEST_LINE: usize = 1 + 8 + 1 + 16 + 4 + 1;

type Line = Vec<u8, LONGEST_LINE>;

/// The line that sends a frame, including its end.
pub(crate) fn line(frame: &SimpleFrame) -> Line {
    let mut line = Line::new();
    // None of these fails, because the longest frame fits.
    let mut put = |byte| {
        let _ = line.push(byte);
    };
    let (data_kind, remote_kind, id, digits) = match frame.id() {
        Id::Standard(id) => (b't', b'r', u32::from(id.as_raw()), 3),
        Id::Extended(id) => (b'T', b'R', id.as_raw(), 8),
    };
    put(if frame.is_remote_frame() { remote_kind } else { data_kind });
    (0..digits).rev().for_each(|place| put(digit(id >> (4 * place))));
    put(digit(frame.dlc() as u32));
    for &byte in frame.data() {
        put(digit(u32::from(byte >> 4)));
        put(digit(u32::from(byte)));
    }
    put(END);
    line
}

/// The digit of the lowest four bits.
fn digit(value: u32) -> u8 {
    const DIGITS: [u8; 16] = *b"0123456789ABCDEF";
    DIGITS[(value & 0xF) as usize]
}

/// A message of the adapter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Answer {
    /// A frame came from the bus.
    Frame(SimpleFrame),
    /// A command was carried out, or a frame accepted.
    Done,
    /// A command or frame was refused.
    Refused,
    /// A line without a meaning, such as one that has lost bytes.
    Junk,
}

/// Finds answers among the bytes that come from the adapter.
#[derive(Debug)]
pub(super) struct Reader {
    line: Line,
    /// The line is longer than any line may be.
    is_too_long: bool,
}

impl Reader {
    pub(super) const fn new() -> Self {
        Self { line: Line::new(), is_too_long: false }
    }

    /// Takes the next byte. BEL counts anywhere, and ends a line that had begun.
    pub(super) fn feed(&mut self, byte: u8) -> Option<Answer> {
        let answer = match byte {
            BELL => Answer::Refused,
            END if self.is_too_long => Answer::Junk,
            END => parse(&self.line),
            // Some adapters end lines with both.
            b'\n' => return None,
            _ => {
                self.is_too_long |= self.line.push(byte).is_err();
                return None;
            }
        };
        *self = Self::new();
        Some(answer)
    }
}

fn parse(line: &[u8]) -> Answer {
    match line {
        [] | [b'z' | b'Z'] => Answer::Done,
        line => parse_frame(line).map_or(Answer::Junk, Answer::Frame),
    }
}

/// The frame of a line, with or without a time stamp after it.
fn parse_frame(line: &[u8]) -> Option<SimpleFrame> {
    let (&kind, rest) = line.split_first()?;
    let (id, rest) = match kind {
        b't' | b'r' => {
            let (digits, rest) = rest.split_at_checked(3)?;
            (Id::from(StandardId::new(number(digits)? as u16)?), rest)
        }
        b'T' | b'R' => {
            let (digits, rest) = rest.split_at_checked(8)?;
            (Id::from(ExtendedId::new(number(digits)?)?), rest)
        }
        _ => return None,
    };
    let (&length, rest) = rest.split_first()?;
    let length = usize::from(length.checked_sub(b'0').filter(|&length| length <= 8)?);
    let is_remote = matches!(kind, b'r' | b'R');
    let (digits, stamp) = rest.split_at_checked(if is_remote { 0 } else { 2 * length })?;
    if !stamp.is_empty() && (stamp.len() != 4 || number(stamp).is_none()) {
        return None;
    }
    if is_remote {
        return SimpleFrame::new_remote(id, length);
    }
    let mut data = [0; 8];
    let (pairs, _) = digits.as_chunks::<2>();
    for (byte, pair) in data.iter_mut().zip(pairs) {
        *byte = number(pair)? as u8;
    }
    SimpleFrame::new(id, data.get(..length)?)
}

/// Up to eight hexadecimal digits.
fn number(digits: &[u8]) -> Option<u32> {
    digits
        .iter()
        .try_fold(0, |value: u32, &digit| Some(value << 4 | char::from(digit).to_digit(16)?))
}
