//! A hot drive gives less current.

use crate::drive::Measurement;

/// How the largest current falls with heat: all of it up to one temperature, none from another on, and linear in
/// between. The motor and the output stage each leave a share, and the smaller one counts. The manual describes no such
/// thing; drives do it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Derating {
    /// Motor temperature from which there is less, °C.
    pub motor_from_c: f32,
    /// Motor temperature from which there is nothing, °C.
    pub motor_to_c: f32,
    /// Temperature of the output stage from which there is less, °C.
    pub mos_from_c: f32,
    /// Temperature of the output stage from which there is nothing, °C.
    pub mos_to_c: f32,
}

impl Derating {
    /// What is left of the largest current, 0 to 1.
    pub(super) fn share(&self, measured: &Measurement) -> f32 {
        let motor = left(self.motor_from_c, self.motor_to_c, measured.motor_temperature_c);
        motor.min(left(self.mos_from_c, self.mos_to_c, measured.mos_temperature_c))
    }
}

fn left(from_c: f32, to_c: f32, temperature_c: f32) -> f32 {
    let share = (to_c - temperature_c) / (to_c - from_c);
    // Exactly at a jump, where both temperatures are the same, or not a number.
    if share.is_nan() { 1.0 } else { share.clamp(0.0, 1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hotter_part_decides() {
        let derating =
            Derating { motor_from_c: 80.0, motor_to_c: 120.0, mos_from_c: 70.0, mos_to_c: 90.0 };
        for (motor_temperature_c, mos_temperature_c, expected) in [
            (25.0, 25.0, 1.0),
            (80.0, 70.0, 1.0),
            (90.0, 25.0, 0.75),
            (90.0, 80.0, 0.5),
            (120.0, 25.0, 0.0),
            (25.0, 300.0, 0.0),
            (f32::NAN, 75.0, 0.75),
        ] {
            let measured =
                Measurement { motor_temperature_c, mos_temperature_c, ..Measurement::default() };
            assert_eq!(derating.share(&measured), expected, "{measured:?}");
        }
    }
}
