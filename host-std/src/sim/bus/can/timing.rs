//! How long a frame is on the wire.
//!
//! A classic CAN frame, in order: start of frame, the arbitration field (identifier, RTR, and for an
//! extended identifier SRR and IDE between its two parts), the control field (IDE or r1, r0, DLC),
//! the data, a CRC of 15 bits; then CRC delimiter, acknowledge slot and delimiter, seven bits end of
//! frame, and three bits intermission before the next one may start. From the start to the end of
//! the CRC a bit of the opposite level is stuffed in after five of the same.

use crc::{CRC_15_CAN, Crc};
use embedded_can::{Frame, Id};

/// Bits after the acknowledge slot: delimiter 1 and end of frame 7.
pub(crate) const AFTER_ACKNOWLEDGE: u32 = 1 + 7;
/// Bits between two frames.
pub(crate) const INTERMISSION: u32 = 3;
/// CRC delimiter, acknowledge slot and what follows, intermission included.
const UNSTUFFED_TAIL: u32 = 1 + 1 + AFTER_ACKNOWLEDGE + INTERMISSION;
const CRC: Crc<u16> = Crc::<u16>::new(&CRC_15_CAN);

/// The length of a frame in bits, from the start of frame through the intermission: the time for which it
/// keeps a bus busy. Stuff bits are counted from the actual content.
///
/// ```
/// use embedded_can::{Frame, StandardId};
/// use myactuator_host_std::sim::bus::can::frame_bits;
/// use myactuator_host_std::protocol::wire::can::SimpleFrame;
///
/// let frame = SimpleFrame::new(StandardId::new(0x141).unwrap(), &[0x55; 8]).unwrap();
/// // Never less than 111 bits for eight data bytes, never more than 135.
/// assert!((111..=135).contains(&frame_bits(&frame)));
/// ```
pub fn frame_bits<F: Frame>(frame: &F) -> u32 {
    let (bits, count) = bits(frame);
    let mut length = count + UNSTUFFED_TAIL;
    let (mut last, mut run) = (true, 0);
    for place in (0..count).rev() {
        let bit = bits >> place & 1 == 1;
        run = if bit == last { run + 1 } else { 1 };
        last = bit;
        if run == 5 {
            length += 1;
            // The stuff bit begins a run of the other level.
            (last, run) = (!bit, 1);
        }
    }
    length
}

/// What arbitration compares, as the bits on the wire: the smaller wins. Frames with the same key differ only after the
/// arbitration field.
pub(crate) fn arbitration_key<F: Frame>(frame: &F) -> u64 {
    let remote = u64::from(frame.is_remote_frame());
    match frame.id() {
        // Identifier, RTR, IDE. Nothing after these meets an extended frame's bits.
        Id::Standard(id) => u64::from(id.as_raw()) << 21 | remote << 20,
        Id::Extended(id) => {
            let raw = u64::from(id.as_raw());
            // SRR and IDE are recessive.
            (raw >> 18) << 21 | 0b11 << 19 | (raw & 0x3_FFFF) << 1 | remote
        }
    }
}

/// The bits from the start of frame through the CRC without stuff bits, and their number. The first bit is the highest.
fn bits<F: Frame>(frame: &F) -> (u128, u32) {
    let arbitration = u128::from(arbitration_key(frame));
    let length = frame.dlc().min(8) as u128;
    // The start of frame is a 0 before everything.
    let (mut bits, mut count) = match frame.id() {
        // The rest of the extended identifier's place: IDE, r0 and the DLC.
        Id::Standard(_) => (arbitration >> 14 | length, 1 + 11 + 7),
        Id::Extended(_) => (arbitration << 6 | length, 1 + 32 + 6),
    };
    // A remote frame has no data, whatever its DLC.
    if !frame.is_remote_frame() {
        for &byte in frame.data() {
            bits = bits << 8 | u128::from(byte);
            count += 8;
        }
    }
    // The CRC starts at 0, so zeros before the frame change nothing.
    let crc = CRC.checksum(&bits.to_be_bytes());
    (bits << 15 | u128::from(crc), count + 15)
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_can::{ExtendedId, StandardId};
    use myactuator_protocol_core::wire::can::SimpleFrame;

    fn standard(id: u16, data: &[u8]) -> SimpleFrame {
        SimpleFrame::new(StandardId::new(id).unwrap(), data).unwrap()
    }

    fn extended(id: u32, data: &[u8]) -> SimpleFrame {
        SimpleFrame::new(ExtendedId::new(id).unwrap(), data).unwrap()
    }

    #[test]
    fn arbitration_goes_bit_by_bit() {
        let key = |frame: SimpleFrame| arbitration_key(&frame);
        let base = 0x141;
        let id = StandardId::new(base).unwrap();
        let data = key(standard(base, &[]));
        let remote = key(SimpleFrame::new_remote(id, 0).unwrap());
        let lowest_extended = key(extended(u32::from(base) << 18, &[]));
        assert!(key(standard(base - 1, &[])) < data);
        assert!(data < remote, "RTR is recessive in a remote frame");
        assert!(remote < lowest_extended, "IDE is recessive in an extended frame");
        assert!(lowest_extended < key(standard(base + 1, &[])));
        assert_eq!(data, key(standard(base, &[1, 2])));
    }
}
