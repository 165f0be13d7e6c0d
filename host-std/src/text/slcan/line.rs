//! Lines of bounded length, and frames in them.

use embedded_can::{ExtendedId, Frame as _, Id, StandardId};
use myactuator_protocol_core::wire::can::SimpleFrame;

use crate::text::can::hex_bytes;
use crate::text::joined_hex;

pub(super) const END: u8 = b'\r';
pub(super) const BELL: u8 = 0x07;
/// The longest line there is: `T`, identifier, length, eight bytes and a time stamp.
const LONGEST: usize = 1 + 8 + 1 + 16 + 4;

/// Gathers the bytes of a line.
#[derive(Clone, Debug, Default)]
pub(super) struct Line {
    bytes: [u8; LONGEST],
    length: usize,
    is_too_long: bool,
}

/// What a byte made of a line.
pub(super) enum Gathered<'a> {
    /// The line goes on.
    Partly,
    /// The line is complete.
    Line(&'a [u8]),
    /// It ends, and was longer than any line there is.
    TooLong,
}

impl Line {
    pub(super) fn feed(&mut self, byte: u8) -> Gathered<'_> {
        match byte {
            END => {
                let length = std::mem::take(&mut self.length);
                if std::mem::take(&mut self.is_too_long) {
                    Gathered::TooLong
                } else {
                    Gathered::Line(&self.bytes[..length])
                }
            }
            // Some terminals and adapters end lines with both.
            b'\n' => Gathered::Partly,
            _ => {
                match self.bytes.get_mut(self.length) {
                    Some(place) => {
                        *place = byte;
                        self.length += 1;
                    }
                    None => self.is_too_long = true,
                }
                Gathered::Partly
            }
        }
    }

    /// Forgets what was gathered.
    pub(super) fn clear(&mut self) {
        self.length = 0;
        self.is_too_long = false;
    }
}

/// The frame on a line, with a time stamp behind it or without.
pub(super) fn parse_frame(line: &[u8]) -> Option<SimpleFrame> {
    let (&kind, rest) = line.split_first()?;
    let (id, rest) = match kind {
        b't' | b'r' => {
            let (digits, rest) = rest.split_at_checked(3)?;
            (Id::from(StandardId::new(u16::try_from(hexadecimal(digits)?).ok()?)?), rest)
        }
        b'T' | b'R' => {
            let (digits, rest) = rest.split_at_checked(8)?;
            (Id::from(ExtendedId::new(hexadecimal(digits)?)?), rest)
        }
        _ => return None,
    };
    let (&length, rest) = rest.split_first()?;
    let length = usize::from(length.checked_sub(b'0').filter(|&length| length <= 8)?);
    let is_remote = matches!(kind, b'r' | b'R');
    let (data, stamp) = rest.split_at_checked(if is_remote { 0 } else { 2 * length })?;
    if !stamp.is_empty() && (stamp.len() != 4 || hexadecimal(stamp).is_none()) {
        return None;
    }
    if is_remote {
        return SimpleFrame::new_remote(id, length);
    }
    SimpleFrame::new(id, &hex_bytes(str::from_utf8(data).ok()?)?)
}

/// The line that carries a frame, its end included.
pub(super) fn write_frame(frame: &SimpleFrame, line: &mut Vec<u8>) {
    let is_remote = frame.is_remote_frame();
    let head = match (frame.id(), is_remote) {
        (Id::Standard(id), false) => format!("t{:03X}", id.as_raw()),
        (Id::Standard(id), true) => format!("r{:03X}", id.as_raw()),
        (Id::Extended(id), false) => format!("T{:08X}", id.as_raw()),
        (Id::Extended(id), true) => format!("R{:08X}", id.as_raw()),
    };
    let tail = format!("{}{}\r", frame.dlc(), joined_hex(frame.data(), ""));
    line.extend_from_slice(head.as_bytes());
    line.extend_from_slice(tail.as_bytes());
}

/// Up to eight hexadecimal digits.
pub(super) fn hexadecimal(digits: &[u8]) -> Option<u32> {
    digits.iter().try_fold(0, |value: u32, &digit| {
        Some(value.checked_mul(16)? | char::from(digit).to_digit(16)?)
    })
}
