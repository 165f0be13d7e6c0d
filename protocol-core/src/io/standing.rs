//! Whether a motor turns.

use crate::units::CoarseSpeed;

/// Up to this speed a shaft stands, degrees per second: feedback may flicker by a step.
const STANDS_DPS: u16 = 2;

/// Whether a motor that says this speed turns: up to 2 dps it stands, since feedback may flicker by a step.
pub(super) fn turns(speed: CoarseSpeed) -> bool {
    speed.raw().unsigned_abs() > STANDS_DPS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_flickers_by_a_step_stands() {
        for (raw, is_turning) in [(0, false), (2, false), (-2, false), (3, true), (i16::MIN, true)]
        {
            assert_eq!(turns(CoarseSpeed::from_raw(raw)), is_turning, "{raw}");
        }
    }
}
