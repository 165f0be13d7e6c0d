//! An RS485 line for tests: a CRC of its own, a receiver whose bytes are counted, and bytes that
//! hurt it.

use myactuator_protocol_core::wire::rs485::{Fed, Frame, Receiver};

use crate::dice::Dice;

/// CRC-16/MODBUS a bit at a time: reflected 0x8005, start 0xFFFF, no final xor.
pub fn crc16_modbus(bytes: &[u8]) -> u16 {
    let mut crc = 0xFFFF_u16;
    for &byte in bytes {
        crc ^= u16::from(byte);
        for _ in 0..8 {
            let out = crc & 1;
            crc >>= 1;
            if out == 1 {
                crc ^= 0xA001;
            }
        }
    }
    crc
}

/// The 13 bytes of a frame, built without the library.
pub fn frame_bytes(address: u8, data: [u8; 8]) -> [u8; 13] {
    let mut bytes = [0; 13];
    bytes[..3].copy_from_slice(&[0x3E, address, 8]);
    bytes[3..11].copy_from_slice(&data);
    let crc = crc16_modbus(&bytes[..11]);
    bytes[11] = (crc & 0xFF) as u8;
    bytes[12] = (crc >> 8) as u8;
    bytes
}

/// Whether these 13 bytes are a frame by section 1.2.2, decided without the library.
pub fn is_frame(bytes: &[u8]) -> bool {
    let [0x3E, address, 8, .., low, high] = *bytes else { return false };
    bytes.len() == 13
        && (matches!(address, 1..=32) || address == 0xCD)
        && crc16_modbus(&bytes[..11]) == u16::from(high) << 8 | u16::from(low)
}

/// Every frame in a whole recording: the first one at or after each place, none overlapping.
pub fn frames_by_window(bytes: &[u8]) -> Vec<[u8; 13]> {
    let mut found = Vec::new();
    let mut at = 0;
    while let Some(window) = bytes.get(at..at + 13) {
        if is_frame(window) {
            found.push(window.try_into().expect("13 bytes"));
            at += 13;
        } else {
            at += 1;
        }
    }
    found
}

/// A receiver that is checked after every byte: what it discarded, returned as frames and still
/// holds adds up to what it was fed.
#[derive(Clone, Debug, Default)]
pub struct Line {
    receiver: Receiver,
    fed: usize,
    discarded: usize,
    frames: Vec<Frame>,
}

impl Line {
    /// A line on which these bytes were said.
    pub fn after(bytes: &[u8]) -> Self {
        let mut line = Self::default();
        line.feed(bytes);
        line
    }

    /// Feeds bytes.
    pub fn feed(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.fed += 1;
            match self.receiver.feed(byte) {
                Fed::Wanting => {}
                Fed::Frame(frame) => self.frames.push(frame),
                Fed::Discarded { bytes, .. } => {
                    assert!(bytes > 0, "nothing was discarded at byte {}", self.fed);
                    self.discarded += bytes;
                }
            }
            let held = self.held();
            assert!(held < 13, "holds {held} bytes, a frame has 13");
            assert_eq!(self.receiver.is_within_frame(), held > 0);
            assert_eq!(
                self.discarded + 13 * self.frames.len() + held,
                self.fed,
                "discarded {}, {} frames, holds {held}",
                self.discarded,
                self.frames.len(),
            );
        }
    }

    /// How many bytes the receiver holds.
    pub fn held(&self) -> usize {
        self.receiver.clone().reset()
    }

    /// How many bytes were thrown away.
    pub fn discarded(&self) -> usize {
        self.discarded
    }

    /// The frames that came out, each as 13 bytes again.
    pub fn frames(&self) -> Vec<[u8; 13]> {
        self.frames.iter().map(Frame::encode).collect()
    }

    /// Forgets what the receiver holds.
    pub fn reset(&mut self) {
        self.discarded += self.receiver.reset();
        assert_eq!(self.held(), 0);
    }
}

/// A byte as noise that hurts a receiver most has it: often 0x3E, an address or a length.
pub fn nasty_byte(dice: &mut Dice) -> u8 {
    match dice.below(8) {
        0..=2 => 0x3E,
        3 => 1 + dice.below(32) as u8,
        4 => 0xCD,
        5..=6 => 8,
        _ => dice.byte(),
    }
}
