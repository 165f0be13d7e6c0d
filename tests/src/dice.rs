//! Seeded random numbers and bytes.

use myactuator_protocol_core::{Data, Opcode};
use proptest::prelude::*;

/// Eight bytes: mostly of a known kind, and small numbers as often as large ones.
pub fn any_data() -> impl Strategy<Value = Data> {
    let known: Vec<u8> = Opcode::ALL.iter().filter_map(|opcode| opcode.byte()).collect();
    let first = prop_oneof![4 => prop::sample::select(known), 1 => any::<u8>()];
    let byte = prop_oneof![2 => Just(0), 2 => 0_u8..=40, 2 => any::<u8>(), 1 => Just(0xFF)];
    (first, prop::array::uniform7(byte))
        .prop_map(|(a, [b, c, d, e, f, g, h])| [a, b, c, d, e, f, g, h])
}

/// A seeded stream of random numbers (SplitMix64).
#[derive(Clone, Debug)]
pub struct Dice(u64);

impl Dice {
    /// The stream of a seed.
    pub const fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Any number.
    pub fn draw(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// A number below `bound`.
    pub fn below(&mut self, bound: u64) -> u64 {
        self.draw() % bound
    }

    /// Any byte.
    pub fn byte(&mut self) -> u8 {
        self.draw() as u8
    }
}
