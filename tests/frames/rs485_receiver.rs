//! Proves that the RS485 receiver never returns a wrong frame and never loses a good one, whatever
//! lies before, between and behind: split and cut-off frames, flipped bits, dice with 0x3E in it,
//! frames inside bad frames. After each byte the bytes fed add up to those discarded, returned and
//! held. Frames and CRC are built here, bit by bit, without the library.

use myactuator_protocol_core::Target;
use myactuator_protocol_core::wire::rs485::{Fault, Fed, Frame, Receiver};
use myactuator_tests::dice::Dice;
use myactuator_tests::line::{
    Line, crc16_modbus, frame_bytes, frames_by_window, is_frame, nasty_byte,
};
use myactuator_tests::values::id;

const START: [u8; 3] = [0x3E, 0x01, 0x08];

/// Good frames of every kind: plain, both ends of the addresses, all ones, and such as hold 0x3E,
/// or what looks like the start of a frame, in their data.
fn good_frames() -> Vec<[u8; 13]> {
    vec![
        // 2.1.5, with the CRC that MODBUS has for it.
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

/// The frames that come out of a line on which these bytes were said.
fn received(bytes: &[u8]) -> Vec<[u8; 13]> {
    Line::after(bytes).frames()
}

/// These bytes are no frame, and every frame behind them comes out.
fn assert_hides_none(bad: &[u8], behind: &[[u8; 13]]) {
    for good in behind {
        let line = Line::after(&[bad, good, bad, good, good].concat());
        assert_eq!(line.frames(), [*good; 3], "behind {bad:02X?}");
        assert_eq!((line.discarded(), line.held()), (2 * bad.len(), 0), "{bad:02X?}");
    }
}

#[test]
fn the_crc_is_modbuss() {
    // The check value that catalogues of CRCs give.
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
fn it_tells_what_was_wrong() {
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
                assert_eq!(line.frames(), sent[..split / 13], "{split} bytes of {count} frames");
                assert_eq!(line.held(), split % 13);
                line.feed(&bytes[split..]);
                assert_eq!(line.frames(), sent, "split at {split}");
                assert_eq!((line.discarded(), line.held()), (0, 0));
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
        line.reset();
        line.feed(&bytes[if split == 0 { 0 } else { 13 }..]);
        assert_eq!(line.frames(), good[usize::from(split > 0)..3], "reset after {split} bytes");
    }
}

#[test]
fn one_flipped_bit_makes_no_frame_and_hides_none() {
    for good in good_frames() {
        for bit in 0..104 {
            let mut bad = good;
            bad[bit / 8] ^= 1 << (bit % 8);
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
                let mut bad = frame;
                bad[first / 8] ^= 1 << (first % 8);
                bad[second / 8] ^= 1 << (second % 8);
                assert!(Frame::decode(&bad).is_err(), "{bad:02X?}");
                assert_hides_none(&bad, &[next]);
            }
        }
    }
}

#[test]
fn a_bad_start_hides_no_frame() {
    // Beginnings that a receiver has to hold on to: it cannot tell yet that they are none.
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
}

#[test]
fn a_cut_off_frame_hides_none_behind_it() {
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
        // What a look at the whole recording finds, and, the seed being fixed, just what was sent.
        assert_eq!(line.frames(), frames_by_window(&bytes));
        assert_eq!(line.frames(), sent);
        assert_eq!(line.discarded() + 13 * sent.len(), bytes.len());
        assert_eq!(line.held(), 0);
    }
}

#[test]
fn noise_alone_is_no_frame() {
    let mut dice = Dice::new(42);
    let bytes: Vec<u8> = (0..200_000).map(|_| nasty_byte(&mut dice)).collect();
    assert_eq!(received(&bytes), frames_by_window(&bytes));
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
            for &bit in &bits[..=dice.below(3) as usize] {
                frame[bit / 8] ^= 1 << (bit % 8);
            }
        } else {
            untouched.push(frame);
        }
        bytes.extend(frame);
    }
    assert_eq!(received(&bytes), untouched);
}
