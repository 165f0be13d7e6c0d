//! Proves motion mode's packing and scales (manual 5):
//!
//! - Packing, exhaustively: every position and every step of each 12-bit field, in both directions, against bytes that
//!   are put together here as one bit string.
//! - Quantisation takes the nearest step, refuses what is no number, and follows its ranges.

use embedded_can::{Frame as _, StandardId};
use myactuator_host_std::explain::Explainer;
use myactuator_protocol_core::command::{
    Command, MotionFeedback, MotionLimits, MotionRanges, MotionSetPoint, RawMotion,
    RawMotionFeedback, U12,
};
use myactuator_protocol_core::quantity::MotionScale;
use myactuator_protocol_core::wire::can::{self, Received, SimpleFrame};
use myactuator_protocol_core::{AnyCommand, AnyReply, Channel, Data, Firmware, MotorId, Opcode};
use myactuator_tests::values::id;

const LAST_16: u16 = 65_535;
const LAST_12: u16 = 4_095;

/// The last step of each field of a command.
const LAST: [u16; 5] = [LAST_16, LAST_12, LAST_12, LAST_12, LAST_12];

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

/// Checks encoding and decoding of a command, in every way that the library offers.
fn check_command(steps: [u16; 5]) {
    let raw = raw(steps);
    let bytes = command_bits(steps);
    assert_eq!(raw.encode(), bytes, "{raw:?}");
    assert_eq!(RawMotion::decode(&bytes), raw);
    assert_eq!(AnyCommand::decode_as(Opcode::Motion, &bytes), Ok(raw.into()));
}

fn feedback([id, position, v, t]: [u16; 4]) -> RawMotionFeedback {
    RawMotionFeedback { id_byte: id as u8, position, velocity: u12(v), torque: u12(t) }
}

/// Checks encoding and decoding of a reply.
fn check_reply(fields: [u16; 4]) {
    let raw = feedback(fields);
    let bytes = reply_bits(fields);
    assert_eq!(raw.encode(), bytes, "{raw:?}");
    assert_eq!(RawMotionFeedback::decode(&bytes), raw);
    assert_eq!(RawMotion::decode_reply(&bytes), Ok(raw));
    assert_eq!(AnyReply::Motion(raw).encode(), bytes);
}

/// A command with one field set and all others zeros, or all others ones.
fn with(field: usize, step: u16, others_full: bool) -> [u16; 5] {
    let mut steps = if others_full { LAST } else { [0; 5] };
    steps[field] = step;
    steps
}

#[test]
fn every_step_of_each_field_packs_and_unpacks() {
    for full in [false, true] {
        let (id, p, other) = if full { (32, LAST_16, LAST_12) } else { (1, 0, 0) };
        for position in 0..=LAST_16 {
            check_command(with(0, position, full));
            check_reply([id, position, other, other]);
        }
        for step in 0..=LAST_12 {
            (1..5).for_each(|field| check_command(with(field, step, full)));
            check_reply([id, p, step, other]);
            check_reply([id, p, other, step]);
        }
    }
    (0..=255).for_each(|id| check_reply([id, 0x1234, 0x567, 0x89A]));
}

/// 5.4 allows the ids 0 to 32 in DATA[0] of the reply on 0x501. In every layer the identifier decides which motor
/// answers. The master has a unit test of it.
#[test]
fn identifier_of_a_motion_reply_decides_which_motor_answers() {
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
    }
}

#[test]
fn a_12_bit_step_has_12_bits() {
    for step in 0..=u16::MAX {
        assert_eq!(U12::new(step).ok().map(U12::get), (step <= LAST_12).then_some(step));
    }
}

fn limits([position_rad, velocity_rad_s, kp, kd, torque_nm]: [f32; 5]) -> MotionLimits {
    MotionLimits { position_rad, velocity_rad_s, kp, kd, torque_nm }
}

fn set_point([position_rad, velocity_rad_s, kp, kd, torque_nm]: [f32; 5]) -> MotionSetPoint {
    MotionSetPoint { position_rad, velocity_rad_s, kp, kd, torque_nm }
}

/// All 0 except one.
fn only<T: Default + Copy>(place: usize, value: T) -> [T; 5] {
    let mut all = [T::default(); 5];
    all[place] = value;
    all
}

/// One value of a set-point: its place among the five, and its scale.
#[derive(Debug)]
struct Scale {
    ranges: MotionRanges,
    scale: MotionScale,
    place: usize,
    min: f32,
    max: f32,
    last: u16,
}

/// The five scales with these ends. They begin at zero, or as far on the negative side (5.1).
fn scales(maxima: [f32; 5]) -> impl Iterator<Item = Scale> {
    let ranges = MotionRanges::new(limits(maxima)).expect("positive limits");
    let starts = [
        (MotionScale::Position, -1.0),
        (MotionScale::Velocity, -1.0),
        (MotionScale::Kp, 0.0),
        (MotionScale::Kd, 0.0),
        (MotionScale::Torque, -1.0),
    ];
    starts.into_iter().zip(maxima).enumerate().map(move |(place, ((scale, start), max))| Scale {
        ranges,
        scale,
        place,
        min: start * max,
        max,
        last: LAST[place],
    })
}

/// 5.1.
const V4_3: [f32; 5] = [12.5, 45.0, 500.0, 5.0, 24.0];

fn all_ranges() -> [[f32; 5]; 6] {
    [
        V4_3,
        // Scales of other firmware, then odd ones, then a very small and a very large one.
        [12.5, 65.0, 500.0, 5.0, 50.0],
        [95.5, 45.0, 500.0, 5.0, 18.0],
        [std::f32::consts::PI, 0.1, 7.0, 0.3, 123.456],
        [1e-3; 5],
        [1e6; 5],
    ]
}

fn all_scales() -> impl Iterator<Item = Scale> {
    all_ranges().into_iter().flat_map(scales)
}

impl Scale {
    fn quantise(&self, value: f32) -> Option<u16> {
        let raw = self.ranges.quantise(&set_point(only(self.place, value))).ok()?;
        Some(steps(&raw)[self.place])
    }

    fn saturate(&self, value: f32) -> Option<u16> {
        let raw = self.ranges.saturating_quantise(&set_point(only(self.place, value))).ok()?;
        Some(steps(&raw)[self.place])
    }

    fn value(&self, step: u16) -> f32 {
        let MotionSetPoint { position_rad, velocity_rad_s, kp, kd, torque_nm } =
            self.ranges.set_point(&raw(only(self.place, step)));
        [position_rad, velocity_rad_s, kp, kd, torque_nm][self.place]
    }

    /// The width of a step, in double precision.
    fn step(&self) -> f64 {
        (f64::from(self.max) - f64::from(self.min)) / f64::from(self.last)
    }

    /// The value at a place between the steps, in double precision.
    fn exact(&self, place: f64) -> f64 {
        f64::from(self.min) + place * self.step()
    }

    /// How far three roundings to an `f32` (difference, product, quotient) can move a value, in steps. Each is at most
    /// 2^-24 of the result. Together: 0.012 of a step of 65536, 0.0008 of one of 4096.
    fn slack(&self) -> f64 {
        3.1 * f64::from(self.last) / f64::from(1 << 24)
    }
}

#[test]
fn the_ranges_are_those_of_5_1() {
    assert_eq!(MotionRanges::new(limits(V4_3)), Ok(MotionRanges::V4_3));
    assert_eq!(MotionRanges::V4_3.limits(), limits(V4_3));
    assert_eq!(Firmware::V4_3.motion_ranges(), Some(MotionRanges::V4_3));
}

#[test]
fn every_step_means_its_place_on_the_scale_and_comes_back() {
    for scale in all_scales() {
        assert_eq!((scale.value(0), scale.quantise(scale.min)), (scale.min, Some(0)), "{scale:?}");
        assert_eq!(scale.quantise(scale.max), Some(scale.last), "{scale:?}");
        let last = scale.value(scale.last);
        assert!((last - scale.max).abs() <= scale.max * 4.0 * f32::EPSILON, "{scale:?}: {last}");
        let mut before = f32::NEG_INFINITY;
        for step in 0..=scale.last {
            let (value, exact) = (scale.value(step), scale.exact(step.into()));
            // Three roundings, none of a number larger than the span.
            let error = (f64::from(value) - exact).abs() / scale.step();
            assert!(error <= scale.slack(), "{scale:?}, step {step}: {value}");
            assert!(value > before, "{scale:?}, step {step}: not above the step before");
            before = value;
            assert_eq!(scale.quantise(value), Some(step), "{scale:?}: {value}");
            // In double precision, as tools show and take it.
            let shown = scale.ranges.value(scale.scale, step);
            assert!(
                (shown - exact).abs() <= 1e-9 * scale.step(),
                "{scale:?}, step {step}: {shown}"
            );
            assert_eq!(scale.ranges.step(scale.scale, shown), Ok(step), "{scale:?}: {shown}");
        }
    }
}

#[test]
fn a_value_becomes_its_nearest_step() {
    for scale in all_scales() {
        for step in 0..=scale.last {
            // Five places in each step, near both of its edges and in its middle.
            for part in [-0.499, -0.26, 0.0, 0.251, 0.499] {
                let value = scale.exact(f64::from(step) + part) as f32;
                if value < scale.min || value > scale.max {
                    continue;
                }
                let found = scale.quantise(value).expect("within the scale");
                let error = (scale.exact(found.into()) - f64::from(value)).abs() / scale.step();
                assert!(
                    error <= 0.5 + scale.slack(),
                    "{scale:?}: {value} became step {found}, {error} steps away"
                );
            }
        }
    }
}

#[test]
fn the_manuals_example_is_rounded_not_cut() {
    let quantise =
        |point| steps(&MotionRanges::V4_3.quantise(&set_point(point)).expect("in range"));
    // 5.4: 10 rad lies at 58981.5, kp 10 at 81.9, kd 1 at 819, 10 N·m at 2900.6.
    // 1 rad/s lies at 46 · 4095 / 90 = 2093.0. The manual prints 2094, which is 1.022 rad/s: a
    // misprint, or another speed than the one that its text works out.
    assert_eq!(quantise([10.0, 1.0, 10.0, 1.0, 10.0]), [58_982, 2_093, 82, 819, 2_901]);
    // A symmetric scale has no step at zero: 32767.5 and 2047.5 are ties, which go up.
    assert_eq!(quantise([0.0; 5]), [32_768, 2_048, 0, 0, 2_048]);
}

#[test]
fn nan_and_values_beyond_the_scale_are_refused() {
    for scale in all_scales() {
        let below = if scale.min == 0.0 { -f32::MIN_POSITIVE } else { scale.min.next_down() };
        let beyond = [scale.max.next_up(), below, f32::MAX, f32::MIN];
        let no_numbers = [f32::NAN, -f32::NAN, f32::from_bits(0x7F80_0001)];
        for bad in beyond.into_iter().chain(no_numbers).chain([f32::INFINITY, f32::NEG_INFINITY]) {
            assert_eq!(scale.quantise(bad), None, "{scale:?}: {bad}");
            assert!(scale.ranges.step(scale.scale, bad.into()).is_err(), "{scale:?}: {bad}");
            let nearest = match bad {
                _ if bad.is_nan() => None,
                _ if bad > 0.0 => Some(scale.last),
                _ => Some(0),
            };
            assert_eq!(scale.saturate(bad), nearest, "{scale:?}: {bad}");
        }
    }
}

#[test]
fn a_refusal_names_the_value_its_range_and_its_unit() {
    let refused = |maxima| {
        let refused = MotionRanges::V4_3.quantise(&set_point(maxima));
        refused.expect_err("beyond the range").to_string()
    };
    assert_eq!(refused(only(4, 30.0)), "torque must be -24 to 24 N·m, but 30 N·m was given");
    assert_eq!(
        refused(only(0, f32::NAN)),
        "position must be -12.5 to 12.5 rad, but NaN rad was given"
    );
}

#[test]
fn feedback_lies_on_the_same_scales() {
    for maxima in all_ranges() {
        let [position, velocity, .., torque] = &scales(maxima).collect::<Vec<_>>()[..] else {
            panic!("five scales")
        };
        for step in (0..=LAST_16).step_by(13) {
            let (v, t) = (step >> 4, LAST_12 - (step >> 4));
            let raw = feedback([9, step, v, t]);
            let measured = position.ranges.feedback(&raw);
            let values = [measured.position_rad, measured.velocity_rad_s, measured.torque_nm];
            assert_eq!(values, [position.value(step), velocity.value(v), torque.value(t)]);
            assert_eq!(position.ranges.quantise_feedback(id(9), &measured), Ok(raw));
        }
    }
}

#[test]
fn feedback_ends_with_its_scale_and_is_never_a_nan() {
    let quantise = |[position_rad, velocity_rad_s, torque_nm]: [f32; 3]| {
        let feedback = MotionFeedback { position_rad, velocity_rad_s, torque_nm };
        MotionRanges::V4_3.quantise_feedback(id(1), &feedback)
    };
    let ends = quantise([f32::INFINITY, -1e9, 24.001]).map(|raw| raw.encode());
    assert_eq!(ends, Ok(reply_bits([1, LAST_16, 0, LAST_12])));
    for lost in [[f32::NAN, 0.0, 0.0], [0.0, f32::NAN, 0.0], [0.0, 0.0, f32::NAN]] {
        assert!(quantise(lost).is_err(), "{lost:?}");
    }
}

#[test]
fn ranges_that_are_no_ranges_are_refused() {
    for bad in [0.0, -0.0, -1.0, f32::NAN, f32::INFINITY, 1.1e6, f32::MIN_POSITIVE / 2.0] {
        for place in 0..5 {
            let mut maxima = V4_3;
            maxima[place] = bad;
            assert!(MotionRanges::new(limits(maxima)).is_err(), "{place}: {bad}");
        }
    }
}
