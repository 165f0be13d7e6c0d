//! Proves with random bytes, for commands and replies:
//!
//! - Nothing received makes the library panic.
//! - A value that was decoded encodes to a frame that decodes to the same value, over CAN and RS485. So does its JSON.
//! - No NaN and no infinity gets in.

use std::fmt::{Debug, Display};

use embedded_can::{ExtendedId, Frame as _, StandardId};
use myactuator_protocol_core::command::Switch;
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::*;
use myactuator_protocol_core::wire::can::{self, Received, SimpleFrame};
use myactuator_protocol_core::wire::rs485;
use myactuator_protocol_core::{
    AnyCommand, AnyReply, Channel, Data, DecodeError, Firmware, MotorId, Opcode, Packet, Target,
};
use myactuator_tests::dice::any_data;
use proptest::prelude::*;
use proptest::test_runner::Config;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{from_str, to_string};

/// Any standard identifier, mostly one of the protocol's.
fn any_identifier() -> impl Strategy<Value = u16> {
    let base = prop::sample::select(vec![0x140_u16, 0x240, 0x400, 0x500]);
    prop_oneof![
        4 => (base, 0_u16..=40).prop_map(|(base, id)| base + id),
        1 => prop::sample::select(vec![0x280_u16, 0x300]),
        2 => 0_u16..=0x7FF,
    ]
}

fn any_target() -> impl Strategy<Value = Target> {
    prop_oneof![
        4 => (1_u8..=32).prop_map(|id| Target::Motor(MotorId::new(id).expect("1 to 32"))),
        1 => Just(Target::All),
    ]
}

fn standard(identifier: u16) -> StandardId {
    StandardId::new(identifier).expect("11 bits")
}

/// The packet as it arrives over CAN and, if RS485 has it, over RS485.
fn over_the_wires(packet: &Packet) -> Result<Vec<Packet>, TestCaseError> {
    let frame: SimpleFrame = can::encode(packet).expect("SimpleFrame takes eight bytes");
    prop_assert_eq!(SimpleFrame::from_packet(packet), frame);
    let Received::Packet(over_can) = can::decode(&frame) else {
        return Err(TestCaseError::fail(format!("{frame:?} is no packet")));
    };
    let mut over = vec![over_can];
    // See the title of 5, 4.1, and 2.34.1.
    let is_on_can_only = match packet.channel {
        Channel::Motion(_) | Channel::MotionReply(_) => true,
        Channel::BusId => packet.data[0] != 0x79,
        Channel::Command(_) | Channel::Reply(_) => packet.data[0] == 0xB6,
    };
    let on_rs485 = rs485::Frame::from_packet(packet);
    prop_assert_eq!(on_rs485.is_none(), is_on_can_only);
    if let Some(frame) = on_rs485 {
        let mut receiver = rs485::Receiver::new();
        let fed = frame.encode().map(|byte| receiver.feed(byte));
        prop_assert_eq!(fed[12], rs485::Fed::Frame(frame));
        prop_assert_eq!(rs485::Frame::decode(&frame.encode()), Ok(frame));
        if !matches!(packet.channel, Channel::Reply(_)) {
            over.push(frame.as_command());
        }
        if !matches!(packet.channel, Channel::Command(_)) {
            over.extend(frame.as_reply());
        }
    }
    Ok(over)
}

/// Commands, or replies.
struct Side<T> {
    decode: fn(&Packet, Firmware) -> Result<T, DecodeError>,
    encode: fn(&T) -> Data,
    opcode: fn(&T) -> Option<Opcode>,
}

const COMMAND: Side<AnyCommand> =
    Side { decode: AnyCommand::decode, encode: AnyCommand::encode, opcode: AnyCommand::opcode };
const REPLY: Side<AnyReply> =
    Side { decode: AnyReply::decode, encode: AnyReply::encode, opcode: AnyReply::opcode };

impl<T> Side<T>
where
    T: PartialEq + Copy + Debug + Display + Serialize + DeserializeOwned,
{
    /// What a packet means to a firmware. Encoded and decoded again, it means the same.
    fn decode_twice(&self, packet: &Packet, firmware: Firmware) -> Result<T, DecodeError> {
        let value = (self.decode)(packet, firmware)?;
        let again = Packet { data: (self.encode)(&value), ..*packet };
        assert_eq!((self.decode)(&again, firmware), Ok(value));
        Ok(value)
    }

    /// Checks that the value of a packet comes back over every wire and from JSON, and prints with its name. If the
    /// packet has no value, returns why.
    fn check(
        &self,
        packet: &Packet,
        firmware: Firmware,
    ) -> Result<Option<DecodeError>, TestCaseError> {
        let value = match self.decode_twice(packet, firmware) {
            Ok(value) => value,
            Err(error) => {
                let text = error.to_string();
                prop_assert!(!text.is_empty() && !text.contains(['{', '[']), "{}", text);
                return Ok(Some(error));
            }
        };
        let kind = (self.opcode)(&value);
        prop_assert!(kind.is_none_or(|opcode| opcode.is_in(firmware)), "{}", value);
        let again = Packet { data: (self.encode)(&value), ..*packet };
        for again in over_the_wires(&again)? {
            // On RS485 the command byte shows what is about the bus id, not the channel.
            let is_on_channel = again.channel == packet.channel;
            prop_assert!(is_on_channel || kind.is_none(), "{} {}", again, packet);
            prop_assert!(
                !is_on_channel || (self.decode)(&again, firmware) == Ok(value),
                "{}",
                again
            );
        }
        let json = to_string(&value).expect("JSON");
        prop_assert_eq!(from_str::<T>(&json).ok(), Some(value), "{}", json);
        let text = format!("{value:?}");
        prop_assert!(!text.contains("NaN") && !text.contains("inf"), "{}", text);
        let name = kind.map_or("raw".to_owned(), |opcode| opcode.to_string());
        prop_assert!(value.to_string().starts_with(&name), "{}", value);
        Ok(None)
    }
}

fn check_packet(packet: &Packet) -> Result<(), TestCaseError> {
    for &firmware in Firmware::ALL {
        let text = packet.as_of(firmware).to_string();
        prop_assert!(text.len() > format!("{}: ", packet.channel).len(), "{}", text);
        let command = COMMAND.check(packet, firmware)?;
        let reply = REPLY.check(packet, firmware)?;
        // Each end refuses the other's frames.
        match packet.channel {
            Channel::Command(_) | Channel::Motion(_) => {
                prop_assert_eq!(reply, Some(DecodeError::NotAReply(packet.channel)));
            }
            Channel::Reply(_) | Channel::MotionReply(_) => {
                prop_assert_eq!(command, Some(DecodeError::NotACommand(packet.channel)));
            }
            Channel::BusId => {}
        }
    }
    Ok(())
}

proptest! {
    // Enough cases to meet every kind of frame many times, few enough to stay within seconds.
    #![proptest_config(Config { cases: 4_000, failure_persistence: None, ..Config::default() })]

    #[test]
    fn any_bytes_on_any_identifier_decode(identifier in any_identifier(), data in any_data()) {
        let frame = SimpleFrame::new(standard(identifier), &data).expect("eight bytes");
        match can::decode(&frame) {
            Received::Packet(packet) => {
                prop_assert_eq!(packet.data, data);
                prop_assert_eq!(can::identifier(packet.channel), identifier);
                check_packet(&packet)?;
            }
            Received::Foreign(raw) => {
                prop_assert_eq!(raw, identifier);
                prop_assert_eq!(can::channel_at(identifier), None);
            }
            other => prop_assert!(false, "{:?}", other),
        }
    }

    #[test]
    fn any_bytes_on_the_bus_id_channel_decode(rest in prop::array::uniform7(prop_oneof![0_u8..=3, any::<u8>()])) {
        let [b, c, d, e, f, g, h] = rest;
        check_packet(&Packet { channel: Channel::BusId, data: [0x79, b, c, d, e, f, g, h] })?;
    }

    #[test]
    fn any_rs485_frame_decodes(address in any_target(), data in any_data()) {
        let frame = rs485::Frame { address, data };
        check_packet(&frame.as_command())?;
        if let Some(packet) = frame.as_reply() {
            check_packet(&packet)?;
        }
        let json = to_string(&frame).expect("JSON");
        prop_assert_eq!(from_str::<rs485::Frame>(&json).ok(), Some(frame));
    }

    #[test]
    fn a_gain_is_a_finite_number(bits in any::<u32>(), exponent_full in any::<bool>()) {
        // Every other case is an infinity or a NaN with some payload.
        let bits = if exponent_full { bits | 0x7F80_0000 } else { bits };
        let value = f32::from_bits(bits);
        let [e, f, g, h] = bits.to_le_bytes();
        prop_assert_eq!(Gain::new(value).is_ok(), value.is_finite());
        let data = [0x30, 1, 0, 0, e, f, g, h];
        let reply = AnyReply::decode_as(Opcode::ReadPid, &data);
        prop_assert_eq!(reply.is_ok(), value.is_finite());
        if let Ok(reply) = reply {
            prop_assert_eq!(reply.encode(), data); // bit by bit, -0 and the smallest included
        }
    }

    #[test]
    fn a_quantity_takes_no_number_that_it_cannot_hold(bits in any::<u32>(), small in -1e6_f32..1e6) {
        // Fractions of a step, too, of either sign.
        for value in [f32::from_bits(bits), small, small / 1e6, 0.0, -0.0] {
            check_quantities(value)?;
        }
        let span = Duration::from_micros(bits.into());
        let protection = Milliseconds::try_from(span).map(Milliseconds::raw);
        prop_assert_eq!(protection.ok() == Some(0), span == Duration::ZERO);
    }
}

/// Conversions from and to the unit of a quantity.
macro_rules! check_quantity {
    ($value:ident, $type:ident, $from:ident, $saturating:ident, $to:ident) => {
        let (made, near) = ($type::$from($value), $type::$saturating($value));
        let (min, max) = (f64::from($type::MIN.$to()), f64::from($type::MAX.$to()));
        let quantity = const { &$type::QUANTITY };
        let (value, step) = (f64::from($value), quantity.amount(1));
        // Types whose 0 means no limit (2.20.1, 2.21.1) or no planning (2.20.2, 2.21.1).
        let is_limit = ["MaxSpeed", "MaxTorque", "Acceleration"].contains(&stringify!($type));
        prop_assert_eq!(near.is_ok(), !value.is_nan(), "{:?}", near);
        if let Ok(near) = near {
            let amount = f64::from(near.$to());
            prop_assert!(min <= amount && amount <= max, "{} {}", value, near);
        }
        match made {
            // Both conversions agree. The result is within half a step of the value and what an f32 keeps of it.
            Ok(made) => {
                prop_assert_eq!(near, Ok(made));
                let error = (f64::from(made.$to()) - value).abs();
                prop_assert!(error <= step / 2.0 + 1e-6 * value.abs(), "{}", value);
            }
            // Only values outside the range are refused, give or take half a step.
            Err(error) => {
                let inside = value > min + step / 2.0 && value < max - step / 2.0;
                let at_end = value.abs() >= 2e7; // where an f32 no longer holds every step
                prop_assert!(!inside || at_end, "{} refused: {}", value, error);
                prop_assert!(error.given.value().is_nan() == value.is_nan());
            }
        }
        // As tools convert it.
        let nearest = quantity.nearest(value).ok();
        if let Some(steps) = nearest {
            let error = (steps as f64 * step - value).abs();
            prop_assert!(error <= step / 2.0 + 1e-9 * value.abs(), "{} {}", value, steps);
        }
        // No amount becomes a 0 with a meaning of its own.
        for raw in [made.ok().map($type::raw), near.ok().map($type::raw)] {
            prop_assert!(!is_limit || raw != Some(0), "{} {:?}", value, raw);
        }
        // People may write it.
        prop_assert!(!is_limit || (nearest == Some(0)) == (value == 0.0), "{}", value);
    };
}

fn check_quantities(value: f32) -> Result<(), TestCaseError> {
    check_quantity!(value, Temperature, from_celsius, saturating_from_celsius, celsius);
    check_quantity!(value, Current, from_amperes, saturating_from_amperes, amperes);
    check_quantity!(value, CoarseSpeed, from_dps, saturating_from_dps, dps);
    check_quantity!(value, SpeedTarget, from_dps, saturating_from_dps, dps);
    check_quantity!(value, MaxSpeed, from_dps, saturating_from_dps, dps);
    check_quantity!(value, MaxTorque, from_percent, saturating_from_percent, percent);
    check_quantity!(value, Angle, from_degrees, saturating_from_degrees, degrees);
    check_quantity!(value, CoarseAngle, from_degrees, saturating_from_degrees, degrees);
    check_quantity!(value, ReportedSingleTurnAngle, from_degrees, saturating_from_degrees, degrees);
    check_quantity!(value, SingleTurnTarget, from_degrees, saturating_from_degrees, degrees);
    check_quantity!(value, Voltage, from_volts, saturating_from_volts, volts);
    check_quantity!(value, Acceleration, from_dps2, saturating_from_dps2, dps2);
    check_quantity!(value, ReportedAcceleration, from_dps2, saturating_from_dps2, dps2);
    check_quantity!(value, ReportInterval, from_millis, saturating_from_millis, millis);
    let limit = MaxSpeed::from_radians_per_second(value).map(MaxSpeed::raw);
    prop_assert!(limit.ok() != Some(0));
    Ok(())
}

#[test]
fn every_identifier_takes_every_first_byte() {
    assert!(SimpleFrame::new(standard(0x141), &[0; 9]).is_none(), "nine bytes are no CAN frame");
    for identifier in 0..=0x7FF {
        for first in 0..=255 {
            for rest in [0x00, 0x01, 0xFF] {
                let data = [first, rest, rest, rest, rest, rest, rest, rest];
                let frame = SimpleFrame::new(standard(identifier), &data).expect("eight bytes");
                if let Received::Packet(packet) = can::decode(&frame) {
                    for &firmware in Firmware::ALL {
                        let command = COMMAND.decode_twice(&packet, firmware);
                        let reply = REPLY.decode_twice(&packet, firmware);
                        let may_be_either = packet.channel == Channel::BusId;
                        assert!(may_be_either || command.is_err() || reply.is_err(), "{packet}");
                    }
                }
            }
        }
    }
}

#[test]
fn short_remote_and_extended_frames_are_distinguished() {
    for identifier in 0..=0x7FF {
        let id = standard(identifier);
        for length in 0..=8 {
            let remote = SimpleFrame::new_remote(id, length).expect("at most eight bytes");
            assert_eq!(can::decode(&remote), Received::Remote);
        }
        for length in 0..8 {
            let data = [identifier as u8; 7];
            let frame = SimpleFrame::new(id, &data[..length]).expect("at most eight bytes");
            let first = data[..length].first().copied();
            let expected = match can::channel_at(identifier) {
                Some(channel) => Received::WrongLength { channel, length, first },
                None => Received::Foreign(identifier),
            };
            assert_eq!(can::decode(&frame), expected);
        }
        // Extended frames, including those with a number of the protocol's.
        for raw in [u32::from(identifier), u32::from(identifier) << 18 | 0x155] {
            let id = ExtendedId::new(raw).expect("29 bits");
            for length in [1, 8] {
                let frame = SimpleFrame::new(id, &[0x9A, 0, 0, 0, 0, 0, 0, 0][..length]);
                let remote = SimpleFrame::new_remote(id, length);
                for frame in [frame, remote] {
                    let frame = frame.expect("at most eight bytes");
                    assert_eq!(can::decode(&frame), Received::Extended(raw));
                }
            }
        }
    }
}

#[test]
fn json_is_checked_like_a_constructor() {
    fn takes<T: DeserializeOwned>(good: &[&str], bad: &[&str]) {
        assert!(good.iter().all(|json| from_str::<T>(json).is_ok()), "{good:?}");
        assert!(bad.iter().all(|json| from_str::<T>(json).is_err()), "{bad:?}");
    }
    takes::<MotorId>(&["1", "32"], &["0", "33"]);
    takes::<Acceleration>(&["0", "100", "60000"], &["0.4", "99", "60001"]);
    takes::<MaxSpeed>(&["0", "1"], &["0.4", "-1", "65536"]);
    takes::<SingleTurnTarget>(&["360"], &["360.01", "-0.01"]);
    // JSON has no NaN and no infinity. Instead: null, and a number too large for an f32.
    takes::<Gain>(&["1.5"], &["null", "1e39"]);
    takes::<Switch>(&[r#""on""#], &["2", r#""2""#]);
}
