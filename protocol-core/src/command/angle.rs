//! Angles of the output shaft (manual 2.12 and 2.13).

use crate::units::{Angle, ReportedSingleTurnAngle};

command! {
    /// Read the multi-turn angle of the output shaft: 0x92 (2.12).
    ReadMultiTurnAngle -> MultiTurnAngle
}

reply! {
    /// Multi-turn angle of the output shaft, from its zero (2.12.3).
    ///
    /// After a restart a drive that does not save its turns (function 4) counts again from an angle within half a turn
    /// of zero.
    MultiTurnAngle {
        /// The angle.
        angle: Angle => 4,
    }
}

command! {
    /// Read the angle within one turn of a direct-drive motor: 0x94 (2.13). Firmware V4.4 answers the same bytes with
    /// another layout: see [`ReadSingleTurnAngleV4_4`].
    ReadSingleTurnAngle -> SingleTurnAngle
}

reply! {
    /// Angle within one turn, clockwise from the encoder's zero (2.13.3; the left column of its
    /// table, the formulas are one index low).
    SingleTurnAngle {
        /// The angle.
        angle: ReportedSingleTurnAngle => 6,
    }
}

command! {
    /// Read the angle within one turn: 0x94 of firmware V4.4, which answers with another layout.
    ReadSingleTurnAngleV4_4 -> SingleTurnAngleV4_4
}

reply! {
    /// Angle within one turn as firmware V4.4 reports it: -180 to 180 degrees from the zero.
    SingleTurnAngleV4_4 {
        /// The angle.
        angle: Angle => 4,
    }
}
