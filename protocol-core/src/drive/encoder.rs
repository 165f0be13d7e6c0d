//! Turns, zero and angles: what the drive computes from its encoder, as [`decisions`](super::decisions) says.
//!
//! Raw position = pulses − `base`. `base` is a whole number of turns of the shaft whose place is known at a start.
//! Position = raw − zero offset. Angle = position · 360° / pulses in a turn of the output shaft.

use crate::drive::parameters::Parameters;
use crate::round::round_f64;
use crate::units::{Angle, CoarseAngle, EncoderPulses, ReportedSingleTurnAngle, SingleTurnPulses};

#[derive(Clone, Debug)]
pub(super) struct Encoder {
    motor_turn: i64,
    /// Pulses in a turn of the output shaft, exactly: with a gear of 19.612 they are no whole number.
    output_turn: f64,
    /// Pulses in a turn of the shaft whose place is known at a start.
    known_turn: f64,
    pulses: i64,
    base: i64,
    offset: i64,
}

impl Encoder {
    pub(super) fn new(parameters: &Parameters) -> Self {
        let motor_turn = parameters.pulses_per_motor_turn();
        let output_turn = parameters.exact_pulses_per_output_turn();
        Self {
            motor_turn,
            output_turn,
            known_turn: if parameters.output_encoder { output_turn } else { motor_turn as f64 },
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
        // The nearest whole number of turns.
        let away = pulses.saturating_sub(near) as f64;
        let half = self.known_turn / 2.0;
        self.base = round_f64(away + half - rest(away + half, self.known_turn)) as i64;
    }

    pub(super) fn measure(&mut self, pulses: i64) {
        self.pulses = pulses;
    }

    /// Raw position, turns included.
    pub(super) const fn raw(&self) -> i64 {
        self.pulses.saturating_sub(self.base)
    }

    /// The raw position without its turns, 0 to less than one turn of the output shaft.
    pub(super) fn raw_within_turn(&self) -> i64 {
        rest(self.raw() as f64, self.output_turn) as i64
    }

    const fn position(&self) -> i64 {
        self.raw().saturating_sub(self.offset)
    }

    /// Angle of the output shaft from its zero, degrees.
    pub(super) fn angle_deg(&self) -> f64 {
        self.position() as f64 * 360.0 / self.output_turn
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
        let within = rest(self.position() as f64, self.output_turn);
        // In whole steps rounded down, so that a full turn is never reached.
        let steps = (within * 36_000.0 / self.output_turn) as u16;
        ReportedSingleTurnAngle::from_raw(steps.min(35_999))
    }

    /// 0x94 of V4.4: the same place, from half a turn below the zero to half a turn above.
    pub(super) fn half_turn_angle(&self) -> Angle {
        let steps = i32::from(self.single_turn_angle().raw());
        Angle::from_raw(if steps > 18_000 { steps - 36_000 } else { steps })
    }

    /// 0x90: position, raw and offset within a turn of the motor shaft. Of an encoder with more than 16 bits these are
    /// the upper 16.
    pub(super) fn single_turn(&self) -> [SingleTurnPulses; 3] {
        let too_many_bits = self.motor_turn.ilog2().saturating_sub(u16::BITS);
        [self.position(), self.raw(), self.offset].map(|pulses| {
            let within = pulses.checked_rem_euclid(self.motor_turn).unwrap_or(0) >> too_many_bits;
            SingleTurnPulses::from_raw(u16::try_from(within).unwrap_or(u16::MAX))
        })
    }
}

/// What is left of `pulses` beyond whole turns, 0 to less than one.
fn rest(pulses: f64, turn: f64) -> f64 {
    let rest = pulses % turn;
    let rest = if rest < 0.0 { rest + turn } else { rest };
    if rest < turn { rest } else { 0.0 }
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
    fn with_one_encoder_the_angle_is_within_half_a_turn_of_the_motor() {
        let parameters = Parameters { output_encoder: false, ..Parameters::default() };
        let angle_deg = |pulses, offset, saved| {
            let mut encoder = Encoder::new(&parameters);
            encoder.start(pulses, EncoderPulses::from_raw(offset), saved);
            encoder.angle_deg()
        };
        // A turn of the motor is 60 degrees of the output, so that the half of it is 30.
        assert_eq!(angle_deg(16_384 + 4_096, 0, None), 15.0);
        assert_eq!(angle_deg(5 * 16_384 - 4_096, 0, None), -15.0);
        assert_eq!(angle_deg(16_384 / 2, 0, None), -30.0);
        assert_eq!(angle_deg(4_096, 2 * 16_384, None), 15.0);
        // Saved turns are right as long as it was turned by less than that.
        let saved = TURN + 3 * 16_384;
        assert_eq!(
            angle_deg(3 * 16_384 + 8_191, 0, Some(saved)),
            540.0 + 8_191.0 * 60.0 / 16_384.0
        );
        assert_eq!(
            angle_deg(3 * 16_384 + 8_193, 0, Some(saved)),
            480.0 + 8_193.0 * 60.0 / 16_384.0
        );
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
    fn ten_thousand_turns_of_an_uneven_gear_end_where_they_began() {
        let parameters =
            Parameters { gear_ratio: 19.612, encoder_bits: 17, ..Parameters::default() };
        let mut encoder = Encoder::new(&parameters);
        encoder.start(0, EncoderPulses::from_raw(0), None);
        // 19.612 x 131,072 x 10,000.
        encoder.measure(25_705_840_640);
        assert!((encoder.angle_deg() - 3_600_000.0).abs() < 1e-6, "{}", encoder.angle_deg());
        assert_eq!(encoder.single_turn_angle().raw(), 0);
        // A start there finds the shaft at the same place.
        encoder.start(25_705_840_640, EncoderPulses::from_raw(0), None);
        assert!(encoder.angle_deg().abs() < 1e-4, "{}", encoder.angle_deg());
        assert_eq!(encoder.raw_within_turn(), 0);
    }

    #[test]
    fn encoder_with_more_bits_than_the_field_reports_its_upper_bits() {
        for (bits, pulses) in [(17, 98_304), (18, 196_608)] {
            let parameters = Parameters { encoder_bits: bits, ..Parameters::default() };
            let mut encoder = Encoder::new(&parameters);
            encoder.start(pulses, EncoderPulses::from_raw(0), None);
            // Three quarters of a turn.
            assert_eq!(encoder.single_turn()[0].raw(), 49_152);
        }
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
