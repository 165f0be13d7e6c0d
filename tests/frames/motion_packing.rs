//! Proves motion mode's packing and scales (manual 5) exhaustively: every position, every step of
//! each 12-bit field, both directions, against bytes that are put together here as one bit string;
//! and that quantisation takes the nearest step, refuses what is no number and follows its ranges.

use embedded_can::{Frame as _, StandardId};
use myactuator_host_std::explain::Explainer;
use myactuator_protocol_core::command::{
    Command, MotionFeedback, MotionLimits, MotionRanges, MotionSetPoint, RawMotion,
    RawMotionFeedback, U12,
};
use myactuator_protocol_core::master::{Config, Event, Master};
use myactuator_protocol_core::quantity::MotionScale;
use myactuator_protocol_core::time::Instant;
use myactuator_protocol_core::wire::can::{self, Received, SimpleFrame};
use myactuator_protocol_core::{AnyCommand, AnyReply, Channel, Data, Firmware, MotorId, Opcode};
use myactuator_tests::values::id;

const LAST_16: u16 = 65_535;
const LAST_12: u16 = 4_095;

fn u12(step: u16) -> U12 {
    U12::new(step).expect("at most 4095")
}

fn raw([position, velocity, kp, kd, torque]: [u16; 5]) -> RawMotion {
    let [velocity, kp, kd, torque] = [velocity, kp, kd, torque].map(u12);
    RawMotion { position, velocity, kp, kd, torque }
}

fn steps(raw: &RawMotion) -> [u16; 5] {
    [raw.position, raw.velocity.get(), raw.kp.get(), raw.kd.get(), raw.torque.get()]
}

/// 5.2 as one string of 64 bits, the first on the left: p 16, v 12, kp 12, kd 12, t 12.
fn command_bits([p, v, kp, kd, t]: [u16; 5]) -> Data {
    let bits = u64::from(p) << 48
        | u64::from(v) << 36
        | u64::from(kp) << 24
        | u64::from(kd) << 12
        | u64::from(t);
    bits.to_be_bytes()
}

/// 5.3 as one string of 64 bits: id 8, p 16, v 12, t 12, and 16 of NULL.
fn reply_bits([id, p, v, t]: [u16; 4]) -> Data {
    let bits = u64::from(id) << 56 | u64::from(p) << 40 | u64::from(v) << 28 | u64::from(t) << 16;
    bits.to_be_bytes()
}

/// Both directions of a command, by every way that the library offers.
fn check_command(steps: [u16; 5]) {
    let raw = raw(steps);
    let bytes = command_bits(steps);
    assert_eq!(raw.encode(), bytes, "{raw:?}");
    assert_eq!(RawMotion::decode(&bytes), raw);
    assert_eq!(AnyCommand::decode_as(Opcode::Motion, &bytes), Ok(raw.into()));
}

/// Both directions of a reply.
fn check_reply(fields: [u16; 4]) {
    let [id_byte, position, v, t] = fields;
    let id_byte = id_byte as u8;
    let raw = RawMotionFeedback { id_byte, position, velocity: u12(v), torque: u12(t) };
    let bytes = reply_bits(fields);
    assert_eq!(raw.encode(), bytes, "{raw:?}");
    assert_eq!(RawMotionFeedback::decode(&bytes), raw);
    assert_eq!(RawMotion::decode_reply(&bytes), Ok(raw));
    assert_eq!(AnyReply::Motion(raw).encode(), bytes);
}

/// A command of all zeros or all ones but for one field.
fn with(field: usize, step: u16, others_full: bool) -> [u16; 5] {
    let mut steps =
        if others_full { [LAST_16, LAST_12, LAST_12, LAST_12, LAST_12] } else { [0; 5] };
    steps[field] = step;
    steps
}

#[test]
fn every_position_packs_and_unpacks() {
    for position in 0..=LAST_16 {
        for full in [false, true] {
            check_command(with(0, position, full));
            let rest = if full { LAST_12 } else { 0 };
            check_reply([if full { 32 } else { 1 }, position, rest, rest]);
        }
    }
}

#[test]
fn every_step_of_each_12_bit_field_packs_and_unpacks() {
    for step in 0..=LAST_12 {
        for full in [false, true] {
            for field in 1..5 {
                check_command(with(field, step, full));
            }
            let (p, other) = if full { (LAST_16, LAST_12) } else { (0, 0) };
            check_reply([7, p, step, other]);
            check_reply([7, p, other, step]);
        }
    }
}

#[test]
fn every_id_byte_packs_and_unpacks() {
    (0..=255).for_each(|id| check_reply([id, 0x1234, 0x567, 0x89A]));
}

/// 5.4 allows the ids 0 to 32 in DATA[0] of the reply on 0x501. Who answers is told by the identifier,
/// in every layer.
#[test]
fn who_answers_is_told_by_the_identifier() {
    for id_byte in [0, 1, 2, 33, 0xFF] {
        let data = [id_byte, 0xE6, 0x66, 0x82, 0xEB, 0x55, 0, 0];
        let frame = SimpleFrame::new(StandardId::new(0x501).expect("11 bits"), &data);
        let frame = frame.expect("eight bytes");
        let received = can::decode(&frame);
        let Received::Packet(packet) = received else { panic!("{received:?}") };
        assert_eq!(packet.channel, Channel::MotionReply(MotorId::MIN));
        let Ok(AnyReply::Motion(reply)) = AnyReply::decode(&packet, Firmware::V4_3) else {
            panic!("{packet}")
        };
        assert_eq!((reply.id_byte, reply.position), (id_byte, 58_982));
        assert!(packet.to_string().starts_with("motion reply of motor 1: "), "{packet}");

        let explanation = Explainer::new(Firmware::V4_3).can_frame(&frame);
        assert_eq!(explanation.id, Some(MotorId::MIN.into()));
        assert_eq!(explanation.to_json()["fields"]["id_byte"], id_byte);

        let mut master = Master::<1>::new(Config::CAN);
        let now = Instant::from_millis(0);
        master.set_point(MotorId::MIN, RawMotion::decode(&[0; 8]), now).expect("a place");
        assert!(master.poll_transmit(now).is_some());
        master.handle_transmitted(now);
        let event = master.handle_frame(&received, Instant::from_millis(1));
        assert_eq!(
            event,
            Some(Event::Feedback { motor: MotorId::MIN, reply: AnyReply::Motion(reply) })
        );
    }
}

#[test]
fn a_walking_bit_belongs_to_one_field() {
    for place in 0..64 {
        let bytes = (1_u64 << place).to_be_bytes();
        let raw = RawMotion::decode(&bytes);
        // From the right: t 0..12, kd 12..24, kp 24..36, v 36..48, p 48..64.
        let (field, within) = match place {
            0..12 => (4, place),
            12..24 => (3, place - 12),
            24..36 => (2, place - 24),
            36..48 => (1, place - 36),
            _ => (0, place - 48),
        };
        assert_eq!(steps(&raw), with(field, 1 << within, false), "bit {place}");
        assert_eq!(raw.encode(), bytes);

        let hole = !(1_u64 << place);
        assert_eq!(RawMotion::decode(&hole.to_be_bytes()).encode(), hole.to_be_bytes());
    }
}

#[test]
fn null_bytes_of_a_reply_are_written_0_and_not_read() {
    let bytes = reply_bits([1, 0x1234, 0x567, 0x89A]);
    let mut noisy = bytes;
    noisy[6..].copy_from_slice(&[0xA5, 0x5A]);
    let raw = RawMotionFeedback::decode(&noisy);
    assert_eq!(raw, RawMotionFeedback::decode(&bytes));
    assert_eq!(raw.encode(), bytes);
}

#[test]
fn a_12_bit_step_has_12_bits() {
    for step in 0..=u16::MAX {
        assert_eq!(U12::new(step).ok().map(U12::get), (step <= LAST_12).then_some(step));
    }
}

/// One value of a set-point: its place among the five, and the scale that 5.1 gives it.
struct Scale {
    scale: MotionScale,
    place: usize,
    symmetric: bool,
    last: u16,
}

const SCALES: [Scale; 5] = [
    Scale { scale: MotionScale::Position, place: 0, symmetric: true, last: LAST_16 },
    Scale { scale: MotionScale::Velocity, place: 1, symmetric: true, last: LAST_12 },
    Scale { scale: MotionScale::Kp, place: 2, symmetric: false, last: LAST_12 },
    Scale { scale: MotionScale::Kd, place: 3, symmetric: false, last: LAST_12 },
    Scale { scale: MotionScale::Torque, place: 4, symmetric: true, last: LAST_12 },
];

fn limits([position_rad, velocity_rad_s, kp, kd, torque_nm]: [f32; 5]) -> MotionLimits {
    MotionLimits { position_rad, velocity_rad_s, kp, kd, torque_nm }
}

fn maxima(limits: &MotionLimits) -> [f32; 5] {
    [limits.position_rad, limits.velocity_rad_s, limits.kp, limits.kd, limits.torque_nm]
}

fn set_point([position_rad, velocity_rad_s, kp, kd, torque_nm]: [f32; 5]) -> MotionSetPoint {
    MotionSetPoint { position_rad, velocity_rad_s, kp, kd, torque_nm }
}

fn values(of: &MotionSetPoint) -> [f32; 5] {
    [of.position_rad, of.velocity_rad_s, of.kp, of.kd, of.torque_nm]
}

/// All 0 but one.
fn only<T: Default + Copy>(place: usize, value: T) -> [T; 5] {
    let mut all = [T::default(); 5];
    all[place] = value;
    all
}

impl std::fmt::Display for Scale {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:?}", self.scale)
    }
}

impl Scale {
    fn ends(&self, ranges: &MotionRanges) -> (f32, f32) {
        let max = maxima(&ranges.limits())[self.place];
        (if self.symmetric { -max } else { 0.0 }, max)
    }

    fn quantise(&self, ranges: &MotionRanges, value: f32) -> Option<u16> {
        let raw = ranges.quantise(&set_point(only(self.place, value))).ok()?;
        Some(steps(&raw)[self.place])
    }

    fn saturate(&self, ranges: &MotionRanges, value: f32) -> Option<u16> {
        let raw = ranges.saturating_quantise(&set_point(only(self.place, value))).ok()?;
        Some(steps(&raw)[self.place])
    }

    fn value(&self, ranges: &MotionRanges, step: u16) -> f32 {
        values(&ranges.set_point(&raw(only(self.place, step))))[self.place]
    }

    /// Where `value` lies on this scale, in steps, in double precision.
    fn place(&self, ranges: &MotionRanges, value: f32) -> f64 {
        let (min, max) = self.ends(ranges);
        let (min, max) = (f64::from(min), f64::from(max));
        (f64::from(value) - min) * f64::from(self.last) / (max - min)
    }

    /// What three roundings to an `f32` (difference, product, quotient), each of at most 2^-24 of
    /// the result, can move a step on this scale: 0.012 of a step of 65536, 0.0008 of one of 4096.
    fn slack(&self) -> f64 {
        3.1 * f64::from(self.last) / f64::from(1 << 24)
    }
}

fn all_ranges() -> Vec<MotionRanges> {
    let other = [
        // Scales of other firmware, then odd ones, then a very small and a very large one.
        [12.5, 65.0, 500.0, 5.0, 50.0],
        [95.5, 45.0, 500.0, 5.0, 18.0],
        [std::f32::consts::PI, 0.1, 7.0, 0.3, 123.456],
        [1e-3, 1e-3, 1e-3, 1e-3, 1e-3],
        [1e6, 1e6, 1e6, 1e6, 1e6],
    ]
    .map(|maxima| MotionRanges::new(limits(maxima)).expect("positive limits"));
    [MotionRanges::V4_3].into_iter().chain(other).collect()
}

#[test]
fn the_ranges_are_those_of_5_1() {
    assert_eq!(maxima(&MotionRanges::V4_3.limits()), [12.5, 45.0, 500.0, 5.0, 24.0]);
    assert_eq!(Firmware::V4_3.motion_ranges(), Some(MotionRanges::V4_3));
}

#[test]
fn the_ends_of_a_scale_are_its_first_and_last_step() {
    for ranges in all_ranges() {
        for scale in &SCALES {
            let (min, max) = scale.ends(&ranges);
            assert_eq!(scale.quantise(&ranges, min), Some(0), "{scale}");
            assert_eq!(scale.quantise(&ranges, max), Some(scale.last), "{scale}");
            assert_eq!(scale.value(&ranges, 0), min, "{scale}");
            let last = scale.value(&ranges, scale.last);
            assert!((last - max).abs() <= max * 4.0 * f32::EPSILON, "{scale}: {last}");
        }
    }
}

#[test]
fn every_step_means_its_place_on_the_scale_and_comes_back() {
    for ranges in all_ranges() {
        for scale in &SCALES {
            let (min, max) = scale.ends(&ranges);
            let span = f64::from(max) - f64::from(min);
            let mut before = f32::NEG_INFINITY;
            for step in 0..=scale.last {
                let value = scale.value(&ranges, step);
                let exact = f64::from(min) + f64::from(step) * span / f64::from(scale.last);
                let error = (f64::from(value) - exact).abs();
                // In double precision, as tools show and take it.
                assert!((ranges.value(scale.scale, step) - exact).abs() <= 1e-15 * span);
                assert_eq!(ranges.step(scale.scale, exact), Ok(step), "{scale}: {exact}");
                // Three roundings, none of a number larger than the span.
                assert!(error <= 3.1 * span / f64::from(1 << 24), "{scale} {step}: {value}");
                assert!(value > before, "{scale} {step}: not above the step before");
                before = value;
                let back = scale.quantise(&ranges, value);
                assert_eq!(back, Some(step), "{scale}: {value}");
            }
        }
    }
}

#[test]
fn a_value_becomes_its_nearest_step() {
    for ranges in all_ranges() {
        for scale in &SCALES {
            let (min, max) = scale.ends(&ranges);
            let check = |value: f32| {
                let step = scale.quantise(&ranges, value).expect("within the scale");
                let error = (f64::from(step) - scale.place(&ranges, value)).abs();
                assert!(
                    error <= 0.5 + scale.slack(),
                    "{scale}: {value} became step {step}, {error} steps away"
                );
            };
            // Five places in each step, near both of its edges and in its middle.
            let width = (f64::from(max) - f64::from(min)) / f64::from(scale.last);
            for step in 0..=scale.last {
                for part in [-0.499, -0.26, 0.0, 0.251, 0.499] {
                    let value = (f64::from(min) + (f64::from(step) + part) * width) as f32;
                    if value >= min && value <= max {
                        check(value);
                    }
                }
            }
        }
    }
}

#[test]
fn steps_never_fall_while_values_rise() {
    for scale in &SCALES {
        let (min, max) = scale.ends(&MotionRanges::V4_3);
        let mut before = 0;
        for i in 0..=200_000 {
            let value = (f64::from(min) + f64::from(i) * f64::from(max - min) / 200_000.0) as f32;
            let step = scale.saturate(&MotionRanges::V4_3, value).expect("a number");
            assert!(step >= before, "{scale}: {value} became {step} after {before}");
            before = step;
        }
        assert_eq!(before, scale.last);
    }
}

#[test]
fn the_manuals_example_is_rounded_not_cut() {
    // 5.4: 10 rad lies at 58981.5, kp 10 at 81.9, kd 1 at 819, 10 N·m at 2900.6.
    // 1 rad/s lies at 46 · 4095 / 90 = 2093.0. The manual prints 2094, which is 1.022 rad/s: a
    // misprint, or another speed than the one that its text works out.
    let raw = MotionRanges::V4_3.quantise(&set_point([10.0, 1.0, 10.0, 1.0, 10.0]));
    let raw = raw.expect("within the ranges");
    assert_eq!(steps(&raw), [58_982, 2_093, 82, 819, 2_901]);
    assert_eq!(raw.encode(), command_bits([58_982, 2_093, 82, 819, 2_901]));
}

#[test]
fn a_symmetric_scale_has_no_step_at_zero() {
    let still = MotionRanges::V4_3.quantise(&MotionSetPoint::default()).expect("within");
    // 32767.5 and 2047.5: ties, which go up.
    assert_eq!(still.encode(), command_bits([32_768, 2_048, 0, 0, 2_048]));
}

#[test]
fn what_is_no_number_or_beyond_the_scale_is_refused() {
    for ranges in all_ranges() {
        for scale in &SCALES {
            let (min, max) = scale.ends(&ranges);
            let below = if min == 0.0 { -f32::MIN_POSITIVE } else { min.next_down() };
            for bad in [
                f32::NAN,
                -f32::NAN,
                f32::from_bits(0x7F80_0001),
                f32::INFINITY,
                f32::NEG_INFINITY,
                max.next_up(),
                below,
                f32::MAX,
                f32::MIN,
            ] {
                assert_eq!(scale.quantise(&ranges, bad), None, "{scale}: {bad}");
                let nearest = match bad {
                    _ if bad.is_nan() => None,
                    _ if bad > 0.0 => Some(scale.last),
                    _ => Some(0),
                };
                assert_eq!(scale.saturate(&ranges, bad), nearest, "{scale}: {bad}");
            }
        }
    }
}

#[test]
fn a_refusal_names_the_value_its_range_and_its_unit() {
    let zero = MotionSetPoint::default();
    let refused = |wanted: MotionSetPoint| {
        MotionRanges::V4_3.quantise(&wanted).expect_err("beyond the range").to_string()
    };
    assert_eq!(
        refused(MotionSetPoint { torque_nm: 30.0, ..zero }),
        "torque must be -24 to 24 N·m, but 30 N·m was given"
    );
    assert_eq!(
        refused(MotionSetPoint { position_rad: f32::NAN, ..zero }),
        "position must be -12.5 to 12.5 rad, but NaN rad was given"
    );
}

#[test]
fn feedback_lies_on_the_same_scales() {
    for ranges in all_ranges() {
        for step in (0..=LAST_16).step_by(13) {
            let twelve = step >> 4;
            let raw = RawMotionFeedback {
                id_byte: 9,
                position: step,
                velocity: u12(twelve),
                torque: u12(LAST_12 - twelve),
            };
            let measured = ranges.feedback(&raw);
            let values = [measured.position_rad, measured.velocity_rad_s, measured.torque_nm];
            let expected = [
                SCALES[0].value(&ranges, step),
                SCALES[1].value(&ranges, twelve),
                SCALES[4].value(&ranges, LAST_12 - twelve),
            ];
            assert_eq!(values, expected);
            assert_eq!(ranges.quantise_feedback(id(9), &measured), Ok(raw));
        }
    }
}

#[test]
fn feedback_ends_with_its_scale_and_is_never_a_nan() {
    let quantise =
        |feedback: &MotionFeedback| MotionRanges::V4_3.quantise_feedback(id(1), feedback);
    let far =
        MotionFeedback { position_rad: f32::INFINITY, velocity_rad_s: -1e9, torque_nm: 24.001 };
    let raw = quantise(&far).expect("numbers");
    assert_eq!(raw.encode(), reply_bits([1, LAST_16, 0, LAST_12]));
    for (position_rad, velocity_rad_s, torque_nm) in
        [(f32::NAN, 0.0, 0.0), (0.0, f32::NAN, 0.0), (0.0, 0.0, f32::NAN)]
    {
        let lost = MotionFeedback { position_rad, velocity_rad_s, torque_nm };
        assert!(quantise(&lost).is_err(), "{lost:?}");
    }
}

#[test]
fn ranges_that_are_no_ranges_are_refused() {
    let good = MotionRanges::V4_3.limits();
    for bad in [0.0, -0.0, -1.0, f32::NAN, f32::INFINITY, 1.1e6, f32::MIN_POSITIVE / 2.0] {
        for place in 0..5 {
            let mut maxima = maxima(&good);
            maxima[place] = bad;
            assert!(MotionRanges::new(limits(maxima)).is_err(), "{place}: {bad}");
        }
    }
}
