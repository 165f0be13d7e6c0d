//! Encoder positions and zero offsets, in pulses (manual 2.6 to 2.11).

use crate::units::{EncoderPulses, SingleTurnPulses};

command! {
    /// Read the multi-turn encoder position, less its zero offset: 0x60 (2.6).
    ReadMultiTurnEncoder -> MultiTurnEncoder
}

reply! {
    /// Multi-turn encoder position, the raw position less the zero offset (2.6.3).
    MultiTurnEncoder {
        /// The position.
        position: EncoderPulses => 4,
    }
}

command! {
    /// Read the multi-turn encoder position without its zero offset: 0x61 (2.7).
    ReadMultiTurnEncoderRaw -> MultiTurnEncoderRaw
}

reply! {
    /// Multi-turn encoder position before the zero offset is taken off (2.7.3).
    MultiTurnEncoderRaw {
        /// The raw position.
        raw: EncoderPulses => 4,
    }
}

command! {
    /// Read the zero offset of the multi-turn encoder: 0x62 (2.8).
    ReadMultiTurnEncoderOffset -> MultiTurnEncoderOffset
}

reply! {
    /// Zero offset of the multi-turn encoder: the raw position that counts as zero (2.8.3, 2.10.3).
    MultiTurnEncoderOffset {
        /// The offset.
        offset: EncoderPulses => 4,
    }
}

command! {
    /// Make a given raw position the zero, in ROM: 0x63 (2.9). Not while the motor starts or moves. The reply is the
    /// same frame.
    ///
    /// It takes effect after a restart. From then on targets count from the new zero (2.9.1), so a target that was
    /// right before leads elsewhere.
    SetEncoderZero -> Self {
        /// The raw position that becomes the zero.
        offset: EncoderPulses => 4,
    }
}

command! {
    /// Make the current position the zero, in ROM: 0x64 (2.10). Not while the motor starts or moves. The reply holds
    /// the new offset.
    ///
    /// It takes effect after [`Reset`](crate::command::Reset). From then on targets count from the new zero (2.10.1),
    /// as with [`SetEncoderZero`].
    SetCurrentPositionZero -> MultiTurnEncoderOffset
}

command! {
    /// Read the single-turn encoder of a direct-drive motor: 0x90 (2.11).
    ReadSingleTurnEncoder -> SingleTurnEncoder
}

reply! {
    /// Single-turn encoder position (2.11.3; the left column of its table, the formulas are one
    /// index low).
    SingleTurnEncoder {
        /// The position, the raw position less the zero offset.
        position: SingleTurnPulses => 2,
        /// The raw position.
        raw: SingleTurnPulses => 4,
        /// The zero offset.
        offset: SingleTurnPulses => 6,
    }
}
