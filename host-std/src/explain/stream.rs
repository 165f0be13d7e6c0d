//! Frames in a stream of RS485 bytes, and the bytes between them.

use myactuator_protocol_core::wire::rs485::{ALL, FRAME_LENGTH, Fault, Fed, Frame, Receiver};
use myactuator_protocol_core::{MotorId, Target};

use super::explanation::Explanation;
use super::reading::Explainer;
use crate::{BusKind, text};

/// So many discarded bytes are shown at once: on a line that carries nothing but noise, for example because its bit
/// rate is another, no frame comes.
const MOST_NOISE: usize = 256;

/// Explains RS485 bytes as they come.
///
/// Discarded bytes become an explanation with an error: before the next frame, when there are many, or from
/// [`finish`](Self::finish).
///
/// ```
/// use myactuator_host_std::explain::{Explainer, Rs485Stream};
/// use myactuator_host_std::protocol::Firmware;
///
/// let mut stream = Rs485Stream::new(Explainer::new(Firmware::V4_3));
/// let bytes = [0x00, 0x3E, 0x01, 0x08, 0x30, 0x01, 0, 0, 0, 0, 0, 0, 0xE8, 0xDD];
/// let found = stream.feed(&bytes);
/// assert_eq!(found.len(), 2);
/// assert!(!found[0].is_decoded() && found[1].is_decoded());
/// assert!(stream.finish().is_none());
/// ```
#[derive(Debug)]
pub struct Rs485Stream {
    explainer: Explainer,
    receiver: Receiver,
    /// What the receiver holds.
    held: Vec<u8>,
    noise: Vec<u8>,
    /// Why the first byte of `noise` was discarded.
    reason: Option<String>,
}

impl Rs485Stream {
    /// A stream that starts here.
    pub fn new(explainer: Explainer) -> Self {
        let (held, noise) = (Vec::new(), Vec::new());
        Self { explainer, receiver: Receiver::new(), held, noise, reason: None }
    }

    /// Takes the next bytes, and explains what they complete.
    pub fn feed(&mut self, bytes: &[u8]) -> Vec<Explanation> {
        let mut found = Vec::new();
        for &byte in bytes {
            self.held.push(byte);
            match self.receiver.feed(byte) {
                Fed::Wanting => {}
                Fed::Frame(frame) => {
                    self.held.clear();
                    found.extend(self.take_noise());
                    found.push(self.explainer.rs485_frame(&frame));
                }
                Fed::Discarded { bytes, fault } => {
                    self.reason.get_or_insert_with(|| reason(fault, &self.held));
                    self.noise.extend(self.held.drain(..bytes.min(self.held.len())));
                    if self.noise.len() >= MOST_NOISE {
                        found.extend(self.take_noise());
                    }
                }
            }
        }
        found
    }

    /// Ends the stream: what is left is no frame.
    pub fn finish(&mut self) -> Option<Explanation> {
        self.receiver.reset();
        if !self.held.is_empty() {
            let reason = format!(
                "the bytes end within a frame, after {} of {FRAME_LENGTH}",
                self.held.len()
            );
            self.reason.get_or_insert(reason);
            self.noise.append(&mut self.held);
        }
        self.take_noise()
    }

    fn take_noise(&mut self) -> Option<Explanation> {
        let noise = std::mem::take(&mut self.noise);
        let reason = self.reason.take()?;
        let count = noise.len();
        let bytes = if count == 1 { "byte is" } else { "bytes are" };
        Some(Explanation::no_frame(
            BusKind::Rs485,
            text::rs485::bytes(&noise),
            format!("{count} {bytes} no frame: {reason}"),
        ))
    }
}

fn reason(fault: Fault, held: &[u8]) -> String {
    let found = match (fault, held) {
        (Fault::Header, [found, ..])
        | (Fault::Address, [_, found, ..])
        | (Fault::Length, [_, _, found, ..]) => format!(", found {found:02X}"),
        (Fault::Crc, [_, address, _, data @ .., low, high]) => match right_crc(*address, data) {
            Some([right_low, right_high]) => {
                format!(", found {low:02X} {high:02X}, expected {right_low:02X} {right_high:02X}")
            }
            None => format!(", found {low:02X} {high:02X}"),
        },
        _ => String::new(),
    };
    format!("{fault}{found}")
}

/// The CRC that belongs to these bytes, as it is on the line.
fn right_crc(address: u8, data: &[u8]) -> Option<[u8; 2]> {
    let address = match address {
        ALL => Target::All,
        id => Target::Motor(MotorId::new(id).ok()?),
    };
    let frame = Frame { address, data: data.try_into().ok()? };
    let [.., low, high] = frame.encode();
    Some([low, high])
}

#[cfg(test)]
mod tests {
    use super::*;
    use myactuator_protocol_core::Firmware;

    const READ_PID: [u8; 13] = [0x3E, 1, 8, 0x30, 1, 0, 0, 0, 0, 0, 0, 0xE8, 0xDD];

    #[test]
    fn frames_and_noise_come_out_in_order_and_no_byte_is_lost() {
        let mut bad_crc = READ_PID;
        bad_crc[11] = 0xE9;
        let mut bytes = vec![0xFF, 0x3E, 0x3E, 0x00];
        bytes.extend(READ_PID);
        bytes.extend(bad_crc);
        bytes.extend(READ_PID);
        bytes.extend(&READ_PID[..5]);
        for split in 0..bytes.len() {
            let mut stream = Rs485Stream::new(Explainer::new(Firmware::V4_3));
            let (first, second) = bytes.split_at(split);
            let mut found = stream.feed(first);
            found.extend(stream.feed(second));
            found.extend(stream.finish());
            assert_eq!(found.len(), 5, "{found:?}");
            let decoded: Vec<bool> = found.iter().map(Explanation::is_decoded).collect();
            assert_eq!(decoded, [false, true, false, true, false]);
            assert_eq!(found[0].raw, "FF 3E 3E 00");
            assert_eq!(
                found[0].outcome,
                Err("4 bytes are no frame: a frame begins with 3E, found FF".into())
            );
            assert_eq!(
                found[2].outcome,
                Err("13 bytes are no frame: the CRC is wrong, found E9 DD, expected E8 DD".into())
            );
            assert_eq!(
                found[4].outcome,
                Err("5 bytes are no frame: the bytes end within a frame, after 5 of 13".into())
            );
            let raw: Vec<&str> = found.iter().map(|item| item.raw.as_str()).collect();
            assert_eq!(raw.join(" "), text::rs485::bytes(&bytes));
        }
    }

    #[test]
    fn noise_without_a_frame_is_shown_while_it_comes() {
        let mut stream = Rs485Stream::new(Explainer::new(Firmware::V4_3));
        let mut found = stream.feed(&[0; 600]);
        assert_eq!(found.len(), 2, "600 bytes, 256 at a time");
        found.extend(stream.finish());
        let raw: Vec<&str> = found.iter().map(|item| item.raw.as_str()).collect();
        assert_eq!(raw.join(" "), text::rs485::bytes(&[0; 600]));
        let why = "256 bytes are no frame: a frame begins with 3E, found 00";
        assert_eq!(found[1].outcome, Err(why.into()));
    }
}
