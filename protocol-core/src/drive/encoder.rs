//! Turns, zero and angles: what the drive makes of its encoder, as [`decisions`](super::decisions)
//! says.
//!
//! Raw position = pulses − `base`, which is whole turns of the output shaft; position = raw − zero
//! offset; angle = position · 360° / pulses in a turn of the output shaft.

use crate::drive::parameters::Parameters;
use crate::round::round_f64;
use crate::units::{Angle, CoarseAngle, EncoderPulses, ReportedSingleTurnAngle, SingleTurnPulses};

#[derive(Clone, Debug)]
pub(super) struct Encoder {
    motor_turn: i64,
    output_turn: i64,
    pulses: i64,
    base: i64,
    offset: i64,
}

impl Encoder {
    pub(super) fn new(parameters: &Parameters) -> Self {
        Self {
            motor_turn: parameters.pulses_per_motor_turn(),
            output_turn: parameters.pulses_per_output_turn(),
            pulses: 0,
            base: 0,
            offset: 0,
        }
    }

    /// Starts counting, from `saved` raw position or without turns.
    pub(super) fn start(&mut self, pulses: i64, offset: EncoderPulses, saved: Option<i64>) {
        self.pulses = pulses;
        self.offset = i64::from(offset.raw());
        let near = saved.unwrap_or(self.offset);
        self.base = 0;
        let away = pulses.saturating_sub(near);
        self.base = away.saturating_sub(self.wrapped(away));
    }

    pub(super) fn measure(&mut self, pulses: i64) {
        self.pulses = pulses;
    }

    /// `pulses` brought within half a turn of the output shaft around 0.
    fn wrapped(&self, pulses: i64) -> i64 {
        let within = remainder(pulses, self.output_turn);
        if within * 2 < self.output_turn { within } else { within - self.output_turn }
    }

    /// Raw position, turns included.
    pub(super) const fn raw(&self) -> i64 {
        self.pulses.saturating_sub(self.base)
    }

    /// The raw position without its turns, 0 to less than one turn of the output shaft.
    pub(super) fn raw_within_turn(&self) -> i64 {
        remainder(self.raw(), self.output_turn)
    }

    const fn position(&self) -> i64 {
        self.raw().saturating_sub(self.offset)
    }

    /// Angle of the output shaft from its zero, degrees.
    pub(super) fn angle_deg(&self) -> f64 {
        self.position() as f64 * 360.0 / self.output_turn as f64
    }

    /// 0x61: saturates.
    pub(super) fn raw_reading(&self) -> EncoderPulses {
        saturated(self.raw())
    }

    /// 0x60: saturates.
    pub(super) fn position_reading(&self) -> EncoderPulses {
        saturated(self.position())
    }

    /// 0x62.
    pub(super) fn offset_reading(&self) -> EncoderPulses {
        saturated(self.offset)
    }

    /// 0x92: saturates.
    pub(super) fn angle_reading(&self) -> Angle {
        Angle::saturating_from_degrees_f64(self.angle_deg()).unwrap_or_default()
    }

    /// The angle in feedback: saturates at ±32767 degrees (2.15.3).
    pub(super) fn coarse_reading(&self) -> CoarseAngle {
        let degrees = round_f64(self.angle_deg()).clamp(-32_767.0, 32_767.0);
        CoarseAngle::from_raw(degrees as i16)
    }

    /// 0x94: clockwise from the zero, back to 0 after a turn.
    pub(super) fn single_turn_angle(&self) -> ReportedSingleTurnAngle {
        let within = remainder(self.position(), self.output_turn);
        // In whole steps rounded down, so that a full turn is never reached.
        let steps = (within * 36_000).checked_div(self.output_turn).unwrap_or(0);
        ReportedSingleTurnAngle::from_raw(u16::try_from(steps).unwrap_or(0))
    }

    /// 0x94 of V4.4: the same place, from half a turn below the zero to half a turn above.
    pub(super) fn half_turn_angle(&self) -> Angle {
        let steps = i32::from(self.single_turn_angle().raw());
        Angle::from_raw(if steps > 18_000 { steps - 36_000 } else { steps })
    }

    /// 0x90: position, raw and offset within a turn of the motor shaft. An encoder of more than 16
    /// bits does not fit; its readings end at 65535.
    pub(super) fn single_turn(&self) -> [SingleTurnPulses; 3] {
        [self.position(), self.raw(), self.offset].map(|pulses| {
            let within = remainder(pulses, self.motor_turn);
            SingleTurnPulses::from_raw(u16::try_from(within).unwrap_or(u16::MAX))
        })
    }
}

/// The part of `pulses` within a turn, 0 to less than `turn`.
fn remainder(pulses: i64, turn: i64) -> i64 {
    pulses.checked_rem_euclid(turn).unwrap_or(0)
}

/// The nearest that four bytes hold.
pub(super) fn saturated(pulses: i64) -> EncoderPulses {
    EncoderPulses::from_raw(pulses.clamp(i32::MIN.into(), i32::MAX.into()) as i32)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TURN: i64 = 98_304; // 16384 pulses, gear 6

    fn started(pulses: i64, offset: i32, saved: Option<i64>) -> Encoder {
        let mut encoder = Encoder::new(&Parameters::default());
        encoder.start(pulses, EncoderPulses::from_raw(offset), saved);
        encoder
    }

    #[test]
    fn without_saved_turns_the_angle_is_within_half_a_turn() {
        assert_eq!(started(3 * TURN + 8_192, 0, None).angle_deg(), 30.0);
        assert_eq!(started(TURN - 8_192, 0, None).angle_deg(), -30.0);
        assert_eq!(started(TURN / 2, 0, None).angle_deg(), -180.0);
        assert_eq!(started(-5 * TURN - 1, 0, None).raw(), -1);
        // A zero many turns away is still a zero.
        assert_eq!(started(8_192, 10 * TURN as i32, None).angle_deg(), 30.0);
    }

    #[test]
    fn readings_end_where_their_fields_do() {
        let mut encoder = started(0, 0, None);
        encoder.measure(TURN * 100); // 36000 degrees
        assert_eq!(encoder.coarse_reading().raw(), 32_767);
        assert_eq!(encoder.angle_reading().raw(), 3_600_000);
        encoder.measure(-TURN * 100);
        assert_eq!(encoder.coarse_reading().raw(), -32_767);
        encoder.measure(i64::MAX);
        assert_eq!(encoder.raw_reading().raw(), i32::MAX);
        assert_eq!(encoder.angle_reading().raw(), i32::MAX);
        encoder.measure(i64::MIN);
        assert_eq!(encoder.position_reading().raw(), i32::MIN);
        assert_eq!(encoder.angle_reading().raw(), i32::MIN);
    }

    #[test]
    fn single_turn_readings_are_the_manuals() {
        // 2.11.4: raw 11454 less offset 9355 is 2099.
        let [position, raw, offset] = started(11_454, 9_355, None).single_turn();
        assert_eq!((position.raw(), raw.raw(), offset.raw()), (2_099, 11_454, 9_355));
        let below = started(9_354, 9_355, None);
        assert_eq!(below.single_turn()[0].raw(), 16_383);
        assert_eq!(below.single_turn_angle().raw(), 35_999);
    }
}
