//! Proves that the RS485 receiver never returns a wrong frame and never loses a good one, whatever comes before,
//! between and after frames: split and cut-off frames, flipped bits, random bytes with many 0x3E, frames inside bad
//! frames. After each byte, the bytes discarded, returned and held add up to the bytes fed. Frames and CRC are built
//! here, bit by bit, without the library.

use myactuator_protocol_core::Target;
use myactuator_protocol_core::wire::rs485::{Fault, Fed, Frame, Receiver};
use myactuator_tests::dice::Dice;
use myactuator_tests::values::id;

/// CRC-16/MODBUS a bit at a time: reflected 0x8005, start 0xFFFF, no final xor.
fn crc16_modbus(bytes: &[u8]) -> u16 {
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
fn frame_bytes(address: u8, data: [u8; 8]) -> [u8; 13] {
    let mut bytes = [0; 13];
    bytes[..3].copy_from_slice(&[0x3E, address, 8]);
    bytes[3..11].copy_from_slice(&data);
    let crc = crc16_modbus(&bytes[..11]);
    bytes[11] = (crc & 0xFF) as u8;
    bytes[12] = (crc >> 8) as u8;
    bytes
}

/// Whether these 13 bytes are a frame by section 1.2.2, decided without the library.
fn is_frame(bytes: &[u8]) -> bool {
    let [0x3E, address, 8, .., low, high] = *bytes else { return false };
    bytes.len() == 13
        && (matches!(address, 1..=32) || address == 0xCD)
        && crc16_modbus(&bytes[..11]) == u16::from(high) << 8 | u16::from(low)
}

/// Every frame in a whole recording: the first one at or after each place, none overlapping.
fn frames_by_window(bytes: &[u8]) -> Vec<[u8; 13]> {
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

/// A receiver that is checked after every byte.
#[derive(Default)]
struct Line {
    receiver: Receiver,
    fed: usize,
    discarded: usize,
    /// The frames that came out, each as 13 bytes again.
    frames: Vec<[u8; 13]>,
}

impl Line {
    /// The line after these bytes.
    fn after(bytes: &[u8]) -> Self {
        let mut line = Self::default();
        line.feed(bytes);
        line
    }

    fn feed(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.fed += 1;
            match self.receiver.feed(byte) {
                Fed::Wanting => {}
                Fed::Frame(frame) => self.frames.push(frame.encode()),
                Fed::Discarded { bytes, .. } => {
                    assert!(bytes > 0, "nothing was discarded at byte {}", self.fed);
                    self.discarded += bytes;
                }
            }
            let held = self.held();
            assert!(held < 13, "holds {held} bytes, a frame has 13");
            assert_eq!(self.receiver.is_within_frame(), held > 0);
            let out = self.discarded + 13 * self.frames.len();
            assert_eq!(out + held, self.fed, "{out} came out, holds {held}");
        }
    }

    /// How many bytes the receiver holds.
    fn held(&self) -> usize {
        self.receiver.clone().reset()
    }
}

/// A random byte of the kind that confuses a receiver most: often 0x3E, an address or a length.
fn nasty_byte(dice: &mut Dice) -> u8 {
    match dice.below(8) {
        0..=2 => 0x3E,
        3 => 1 + dice.below(32) as u8,
        4 => 0xCD,
        5..=6 => 8,
        _ => dice.byte(),
    }
}

const START: [u8; 3] = [0x3E, 0x01, 0x08];

/// Good frames of every kind: plain ones, both ends of the addresses, all ones, and frames with 0x3E or what looks like
/// the start of a frame in their data.
fn good_frames() -> Vec<[u8; 13]> {
    vec![
        // 2.1.5, with the CRC of MODBUS.
        [0x3E, 0x01, 0x08, 0x30, 0x01, 0, 0, 0, 0, 0, 0, 0xE8, 0xDD],
        frame_bytes(32, [0xA4, 0x00, 0xF4, 0x01, 0xA0, 0x8C, 0x00, 0x00]),
        frame_bytes(0xCD, [0x80, 0, 0, 0, 0, 0, 0, 0]),
        frame_bytes(2, [0xFF; 8]),
        frame_bytes(8, [0x3E; 8]),
        frame_bytes(1, [0x3E, 0x01, 0x08, 0x3E, 0x01, 0x08, 0x3E, 0x01]),
        frame_bytes(3, [0x9C, 0x3E, 0x01, 0x08, 0x30, 0x01, 0x00, 0x3E]),
        frame_bytes(0x20, [0x60, 0, 0, 0, 0x3E, 0xCD, 0x08, 0x80]),
    ]
}

/// The frames that come out of these bytes.
fn received(bytes: &[u8]) -> Vec<[u8; 13]> {
    Line::after(bytes).frames
}

/// The frame with these bits flipped.
fn flipped(mut frame: [u8; 13], bits: &[usize]) -> [u8; 13] {
    bits.iter().for_each(|bit| frame[bit / 8] ^= 1 << (bit % 8));
    frame
}

/// Checks that these bytes are no frame and that every frame after them comes out.
fn assert_hides_none(bad: &[u8], behind: &[[u8; 13]]) {
    for good in behind {
        let line = Line::after(&[bad, good, bad, good, good].concat());
        assert_eq!(line.frames, [*good; 3], "after {bad:02X?}");
        assert_eq!((line.discarded, line.held()), (2 * bad.len(), 0), "{bad:02X?}");
    }
}

#[test]
fn the_crc_is_modbuss() {
    // The check value in catalogues of CRCs.
    assert_eq!(crc16_modbus(b"123456789"), 0x4B37);
    // The example of section 2.1.5: E8 DD follows.
    assert_eq!(crc16_modbus(&good_frames()[0][..11]), 0xDDE8);
}

#[test]
fn the_librarys_frames_are_the_bitwise_ones() {
    let mut dice = Dice::new(0x1357_9BDF);
    for byte in (1..=32).chain([0xCD]) {
        let address = if byte == 0xCD { Target::All } else { id(byte).into() };
        for _ in 0..200 {
            let data = [(); 8].map(|()| dice.byte());
            let (frame, bytes) = (Frame { address, data }, frame_bytes(byte, data));
            assert!(is_frame(&bytes));
            assert_eq!(frame.encode(), bytes);
            assert_eq!(Frame::decode(&bytes), Ok(frame));
            assert_eq!(received(&bytes), [bytes]);
        }
    }
}

#[test]
fn only_the_protocols_addresses_and_length_make_a_frame() {
    let check = |bytes: [u8; 13], is_frame: bool| {
        assert_eq!(received(&bytes).len(), usize::from(is_frame), "{bytes:02X?}");
        assert_eq!(Frame::decode(&bytes).is_ok(), is_frame, "{bytes:02X?}");
    };
    for byte in 0..=255 {
        let is_address = (1..=32).contains(&byte) || byte == 0xCD;
        check(frame_bytes(byte, [0x9C, 0, 0, 0, 0, 0, 0, 0]), is_address);
        for (place, right) in [(0, 0x3E), (2, 8)] {
            let mut bytes = good_frames()[0];
            bytes[place] = byte;
            let crc = crc16_modbus(&bytes[..11]).to_le_bytes();
            bytes[11..].copy_from_slice(&crc);
            check(bytes, byte == right);
        }
    }
}

#[test]
fn receiver_reports_the_fault_of_discarded_bytes() {
    let feed_all = |bytes: &[u8]| {
        let mut receiver = Receiver::new();
        bytes.iter().map(|&byte| receiver.feed(byte)).last()
    };
    let mut bad = good_frames()[0];
    bad[12] ^= 0x80;
    for (start, bytes, fault) in [
        (&[0x3F][..], 1, Fault::Header),
        (&[0x3E, 0x3E], 1, Fault::Address),
        (&[0x3E, 33], 2, Fault::Address),
        (&[0x3E, 1, 9], 3, Fault::Length),
        // 0x3E at the place of the length is the next start.
        (&[0x3E, 1, 0x3E], 2, Fault::Length),
        (&bad, 13, Fault::Crc),
    ] {
        assert_eq!(feed_all(start), Some(Fed::Discarded { bytes, fault }), "{start:02X?}");
        let mut line = good_frames()[0];
        line[..start.len()].copy_from_slice(start);
        assert_eq!(Frame::decode(&line), Err(fault), "{start:02X?}");
    }
}

#[test]
fn frames_may_be_split_anywhere() {
    let good = good_frames();
    for first in 0..good.len() {
        for count in 1..=3 {
            let sent: Vec<[u8; 13]> = (first..).take(count).map(|i| good[i % good.len()]).collect();
            let bytes = sent.concat();
            for split in 0..=bytes.len() {
                let mut line = Line::after(&bytes[..split]);
                assert_eq!(line.frames, sent[..split / 13], "{split} bytes of {count} frames");
                assert_eq!(line.held(), split % 13);
                line.feed(&bytes[split..]);
                assert_eq!(line.frames, sent, "split at {split}");
                assert_eq!((line.discarded, line.held()), (0, 0));
            }
        }
    }
}

#[test]
fn a_reset_costs_the_frame_that_it_cuts_and_no_other() {
    let good = good_frames();
    let bytes = good[..3].concat();
    for split in 0..13 {
        let mut line = Line::after(&bytes[..split]);
        line.discarded += line.receiver.reset();
        assert_eq!(line.held(), 0);
        line.feed(&bytes[if split == 0 { 0 } else { 13 }..]);
        assert_eq!(line.frames, good[usize::from(split > 0)..3], "reset after {split} bytes");
    }
}

#[test]
fn one_flipped_bit_makes_no_frame_and_hides_none() {
    for good in good_frames() {
        for bit in 0..104 {
            let bad = flipped(good, &[bit]);
            assert!(received(&bad).is_empty() && Frame::decode(&bad).is_err(), "{bad:02X?}");
            assert_hides_none(&bad, &good_frames());
        }
    }
}

#[test]
fn two_flipped_bits_make_no_frame_and_hide_none() {
    let good = good_frames();
    for (frame, next) in [(good[0], good[5]), (good[5], good[0])] {
        for first in 0..104 {
            for second in 0..first {
                let bad = flipped(frame, &[first, second]);
                assert!(Frame::decode(&bad).is_err(), "{bad:02X?}");
                assert_hides_none(&bad, &[next]);
            }
        }
    }
}

#[test]
fn a_bad_start_or_a_cut_off_frame_hides_none_after_it() {
    // Bytes that a receiver has to hold, because a frame may begin with them.
    for start in [START, [0x3E, 0x20, 0x08], [0x3E, 0xCD, 0x08], [0x3E; 3]] {
        for length in 0..=3 {
            for repeated in 1..=20 {
                assert_hides_none(&start[..length].repeat(repeated), &good_frames());
            }
        }
    }
    for fill in [0x00, 0x08, 0x3E, 0x01, 0xFF] {
        for filled in 0..30 {
            assert_hides_none(&[&START[..], &vec![fill; filled]].concat(), &good_frames());
        }
    }
    for cut in good_frames() {
        for length in 0..13 {
            assert_hides_none(&cut[..length], &good_frames());
            assert_hides_none(&cut[13 - length..], &good_frames());
        }
    }
}

#[test]
fn a_good_frame_inside_a_bad_one_is_found() {
    for outer in good_frames() {
        for inner in good_frames() {
            for offset in 0..=13 {
                let bytes = [&outer[..offset], &inner, &outer[offset..], &inner].concat();
                let mut expected = vec![inner, inner];
                match offset {
                    0 => expected.insert(1, outer),
                    13 => expected.insert(0, outer),
                    _ => {}
                }
                assert_eq!(received(&bytes), expected, "{inner:02X?} at {offset} in {outer:02X?}");
            }
        }
    }
}

#[test]
fn noise_between_frames_makes_no_frame_and_hides_none() {
    let mut dice = Dice::new(0x00C0_FFEE);
    for byte in [Dice::byte, nasty_byte] {
        let mut bytes = Vec::new();
        let mut sent = Vec::new();
        for _ in 0..4000 {
            for _ in 0..dice.below(30) {
                bytes.push(byte(&mut dice));
            }
            let data = [(); 8].map(|()| byte(&mut dice));
            let frame = frame_bytes(1 + dice.below(32) as u8, data);
            bytes.extend(frame);
            sent.push(frame);
        }
        let line = Line::after(&bytes);
        // The frames that a search of the whole recording finds. With this seed they are exactly those sent.
        assert_eq!(line.frames, frames_by_window(&bytes));
        assert_eq!(line.frames, sent);
        assert_eq!(line.discarded + 13 * sent.len(), bytes.len());
        assert_eq!(line.held(), 0);
    }
}

#[test]
fn frames_with_scattered_flips_never_make_a_wrong_one() {
    let mut dice = Dice::new(7);
    let good = good_frames();
    let mut bytes = Vec::new();
    let mut untouched = Vec::new();
    for _ in 0..4000 {
        let mut frame = good[dice.below(good.len() as u64) as usize];
        if dice.below(3) == 0 {
            // One to three different bits: fewer than the CRC's code distance at this length.
            let first = dice.below(104) as usize;
            let bits = [first, (first + 11) % 104, (first + 53) % 104];
            frame = flipped(frame, &bits[..=dice.below(3) as usize]);
        } else {
            untouched.push(frame);
        }
        bytes.extend(frame);
    }
    assert_eq!(received(&bytes), untouched);
}
