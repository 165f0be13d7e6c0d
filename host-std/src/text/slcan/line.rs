//! Lines of bounded length, and frames in them.

use embedded_can::Frame as _;
use myactuator_protocol_core::wire::can::SimpleFrame;

use crate::text::can::{self, hex_bytes};
use crate::text::joined_hex;

pub(super) const END: u8 = b'\r';
pub(super) const BELL: u8 = 0x07;
/// The longest line: an acknowledgement, `T`, identifier, length, eight bytes and a time stamp.
const LONGEST: usize = 1 + 1 + 8 + 1 + 16 + 4;

/// Collects the bytes of a line.
#[derive(Clone, Debug, Default)]
pub(super) struct Line(Vec<u8>);

impl Line {
    /// Returns the line that this byte completes. If the line is too long to mean anything, returns only as much as
    /// shows that.
    pub(super) fn feed(&mut self, byte: u8) -> Option<Vec<u8>> {
        match byte {
            END => return Some(std::mem::take(&mut self.0)),
            // Some terminals and adapters end lines with both.
            b'\n' => {}
            _ if self.0.len() > LONGEST => {}
            _ => self.0.push(byte),
        }
        None
    }

    /// Drops what was collected.
    pub(super) fn clear(&mut self) {
        self.0.clear();
    }
}

/// The frame of a line, with or without a time stamp after it.
pub(super) fn parse_frame(line: &[u8]) -> Option<SimpleFrame> {
    let (kind, rest) = str::from_utf8(line).ok()?.split_at_checked(1)?;
    let (digits, is_remote) = match kind {
        "t" => (3, false),
        "T" => (8, false),
        "r" => (3, true),
        "R" => (8, true),
        _ => return None,
    };
    let (id, rest) = rest.split_at_checked(digits)?;
    let id = can::identifier(id).ok()?;
    let (length, rest) = rest.split_at_checked(1)?;
    let length = length.parse().ok().filter(|&length| length <= 8)?;
    let (data, stamp) = rest.split_at_checked(if is_remote { 0 } else { 2 * length })?;
    if !matches!(hex_bytes(stamp)?.len(), 0 | 2) {
        return None;
    }
    if is_remote {
        return SimpleFrame::new_remote(id, length);
    }
    SimpleFrame::new(id, &hex_bytes(data)?)
}

/// The line of a frame, including its end.
pub(super) fn write_frame(frame: &SimpleFrame, line: &mut Vec<u8>) {
    let kind = match (frame.is_extended(), frame.is_remote_frame()) {
        (false, false) => 't',
        (false, true) => 'r',
        (true, false) => 'T',
        (true, true) => 'R',
    };
    let (id, data) = (can::digits(frame.id()), joined_hex(frame.data(), ""));
    line.extend_from_slice(format!("{kind}{id}{}{data}\r", frame.dlc()).as_bytes());
}
