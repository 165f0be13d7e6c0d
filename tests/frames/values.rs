//! Proves about values:
//!
//! - Codes and error flags are the manual's, typed by hand.
//! - A code or a function without a name never equals one with a name.
//! - A value that another field does not allow is refused.

use std::fmt::Debug;

use myactuator_protocol_core::command::*;
use myactuator_protocol_core::{AnyCommand, AnyReply, DecodeError, Opcode};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{from_str, to_string};

#[test]
fn out_of_range_values_that_depend_on_another_field_are_refused() {
    let refused = |opcode, data, given: f64| {
        let error = AnyCommand::decode_as(opcode, &data).expect_err("out of range");
        let reply = AnyReply::decode_as(opcode, &data).expect_err("out of range");
        assert_eq!(error, reply, "{data:02X?}");
        let DecodeError::OutOfRange(error) = error else { panic!("{data:02X?}: {error}") };
        assert_eq!(error.given.value(), given, "{data:02X?}");
    };
    // 2.35.4: 0 or 1.
    for function in [2, 3, 4] {
        refused(Opcode::FunctionControl, [0x20, function, 0, 0, 2, 0, 0, 0], 2.0);
        refused(Opcode::FunctionControl, [0x20, function, 0, 0, 1, 0, 0, 1], 16_777_217.0);
    }
    // 4.1, 7.1 and 2.35.4: an id is 1 to 32, the flag 0 or 1.
    for bad in [0, 33, 0xFF] {
        refused(Opcode::BusId, [0x79, 0, 0, 0, 0, 0, 0, bad], bad.into());
        refused(Opcode::FunctionControl, [0x20, 5, 0, 0, bad, 0, 0, 0], bad.into());
    }
    refused(Opcode::FunctionControl, [0x20, 5, 0, 0, 1, 1, 0, 0], 257.0);
    let thousand = [0x20, 5, 0, 0, 0xE8, 3, 0, 0];
    refused(Opcode::FunctionControl, thousand, 1_000.0);
    let error = AnyCommand::decode_as(Opcode::FunctionControl, &thousand).expect_err("1000");
    assert_eq!(error.to_string(), "motor id must be 1 to 32, but 1000 was given");
    refused(Opcode::BusId, [0x79, 0, 2, 0, 0, 0, 0, 1], 2.0);
    // 4.3 and 7.3: neither a reply identifier nor a bare id.
    for (low, high) in [(0, 0), (0x40, 2), (0x61, 2), (0x41, 1), (33, 0), (0, 33), (1, 1)] {
        let decoded = AnyReply::decode_as(Opcode::BusId, &[0x79, 0, 1, 0, 0, 0, low, high]);
        assert_eq!(decoded, Err(DecodeError::NotABusId(u16::from_le_bytes([low, high]))));
    }
}

#[test]
fn named_functions_are_never_represented_as_other() {
    for index in 0..=255 {
        let is_named = (1..=7).contains(&index);
        for value in [0, 1, 2, 32, 33, 0x8182_8384] {
            let allowed = match index {
                2..=4 => value <= 1,
                5 => (1..=32).contains(&value),
                _ => true,
            };
            let function = FunctionControl::from_index(index, value);
            assert_eq!(function.is_ok(), allowed, "{index} {value}");
            if let Ok(function) = function {
                let value = if index == 1 { 0 } else { value };
                assert_eq!((function.index(), function.value()), (index, value));
                assert_eq!(matches!(function, FunctionControl::Other(_)), !is_named, "{index}");
            }
            assert_eq!(OtherFunction::try_from((index, value)).is_ok(), !is_named, "{index}");
            let json = from_str::<FunctionControl>(&format!(r#"{{"other":[{index},{value}]}}"#));
            assert_eq!(json.ok(), function.ok().filter(|_| !is_named), "{index} {value}");
        }
    }
}

/// Checks that exactly these codes have names, with these numbers.
fn check_codes<T>(
    make: fn(u8) -> T,
    raw: fn(T) -> u8,
    name: fn(T) -> Option<&'static str>,
    named: &[(T, u8, &str)],
) where
    T: Copy + PartialEq + Debug + ToString + Serialize + DeserializeOwned,
{
    for byte in 0..=255 {
        let code = make(byte);
        assert_eq!(raw(code), byte, "{code:?}");
        let with_name = named.iter().find(|(_, number, _)| *number == byte);
        assert_eq!(name(code), with_name.map(|&(.., name)| name), "{code:?}");
        for &(other, number, _) in named {
            assert_eq!(code == other, byte == number, "{code:?} and {other:?}");
            assert_eq!(code.to_string() == other.to_string(), byte == number, "{code:?}");
        }
        let json = to_string(&code).expect("JSON");
        assert_eq!(json.starts_with('"'), with_name.is_some(), "{json}");
        for json in [json, byte.to_string()] {
            assert_eq!(from_str::<T>(&json).ok(), Some(code), "{json}");
        }
    }
    assert!(from_str::<T>("256").is_err() && from_str::<T>(r#""no-such-code""#).is_err());
}

macro_rules! check_codes {
    ($type:ident: $($code:ident $raw:literal $name:literal),+) => {
        check_codes($type::from_raw, $type::raw, $type::name, &[$(($type::$code, $raw, $name)),+]);
        assert_eq!($type::ALL, [$($type::$code),+]);
    };
}

#[test]
fn codes_are_the_manuals() {
    // 2.1.4
    check_codes!(PidIndex: CURRENT_KP 1 "current-kp", CURRENT_KI 2 "current-ki",
        SPEED_KP 4 "speed-kp", SPEED_KI 5 "speed-ki", POSITION_KP 7 "position-kp",
        POSITION_KI 8 "position-ki", POSITION_KD 9 "position-kd");
    // 2.4.4
    check_codes!(AccelerationIndex: POSITION_ACCELERATION 0 "position-acceleration",
        POSITION_DECELERATION 1 "position-deceleration",
        SPEED_ACCELERATION 2 "speed-acceleration", SPEED_DECELERATION 3 "speed-deceleration");
    // 2.14.3
    check_codes!(BrakeCommand: LOCK 0 "lock", RELEASE 1 "release");
    // 2.22.1
    check_codes!(Direction: CLOCKWISE 0 "clockwise", COUNTER_CLOCKWISE 1 "counter-clockwise");
    // 2.25.3
    check_codes!(Mode: CURRENT 1 "current", SPEED 2 "speed", POSITION 3 "position");
    // 2.32.4
    check_codes!(BaudCode: CAN_500K_RS485_115200 0 "can-500k-rs485-115200",
        CAN_1M_RS485_500K 1 "can-1m-rs485-500k", RS485_1M 2 "rs485-1m");
    // 2.35.4
    check_codes!(FunctionIndex: CLEAR_MULTI_TURN 1 "clear-multi-turn",
        CAN_ID_FILTER 2 "can-id-filter", ERROR_REPORTING 3 "error-reporting",
        SAVE_MULTI_TURN 4 "save-multi-turn", SET_CAN_ID 5 "set-can-id",
        MAX_POSITIVE_ANGLE 6 "max-positive-angle", MAX_NEGATIVE_ANGLE 7 "max-negative-angle");
    // 4.1
    check_codes!(Access: WRITE 0 "write", READ 1 "read");
    // 2.34.2, which names 0x9E too and describes no such command.
    let report = |opcode| ReportedCommand::of(opcode).expect("a report");
    check_codes(
        ReportedCommand::from_raw,
        ReportedCommand::raw,
        ReportedCommand::name,
        &[
            (report(Opcode::ReadMultiTurnEncoder), 0x60, "read-multi-turn-encoder"),
            (report(Opcode::ReadMultiTurnEncoderRaw), 0x61, "read-multi-turn-encoder-raw"),
            (report(Opcode::ReadMultiTurnEncoderOffset), 0x62, "read-multi-turn-encoder-offset"),
            (report(Opcode::ReadMultiTurnAngle), 0x92, "read-multi-turn-angle"),
            (report(Opcode::ReadStatus1), 0x9A, "read-status1"),
            (report(Opcode::ReadStatus2), 0x9C, "read-status2"),
            (report(Opcode::ReadStatus3), 0x9D, "read-status3"),
        ],
    );
}

#[test]
fn bit_rates_are_those_of_2_32_4() {
    let rates = [0, 1, 2, 3].map(|raw| {
        let code = BaudCode::from_raw(raw);
        (code.can_bits_per_second(), code.rs485_bits_per_second())
    });
    assert_eq!(
        rates,
        [
            (Some(500_000), Some(115_200)),
            (Some(1_000_000), Some(500_000)),
            (None, Some(1_000_000)),
            (None, None),
        ]
    );
}

#[test]
fn error_flags_and_levels_are_those_of_2_14_3_and_8_2() {
    use ErrorLevel::{One, Two};
    let manual = [
        (0x0002, ErrorFlags::STALL, Some(One)),
        (0x0004, ErrorFlags::UNDER_VOLTAGE, Some(Two)),
        (0x0008, ErrorFlags::OVER_VOLTAGE, Some(Two)),
        (0x0010, ErrorFlags::OVER_CURRENT, Some(One)),
        (0x0040, ErrorFlags::OVER_POWER, Some(Two)),
        (0x0080, ErrorFlags::CALIBRATION_PARAMETERS, Some(One)),
        (0x0100, ErrorFlags::OVER_SPEED, Some(Two)),
        (0x0800, ErrorFlags::COMPONENT_OVER_TEMPERATURE, None),
        (0x1000, ErrorFlags::MOTOR_OVER_TEMPERATURE, Some(Two)),
        (0x2000, ErrorFlags::ENCODER_CALIBRATION, Some(Two)),
        (0x4000, ErrorFlags::ENCODER_DATA, None),
    ];
    for (bits, flag, level) in manual {
        assert_eq!((flag.bits(), flag.level()), (bits, level), "{flag}");
        assert!(flag.name().is_some() && flag.description().is_some());
        // Only errors that recover on their own need no restart.
        assert_eq!(flag.needs_restart(), level != Some(Two), "{flag}");
    }
    assert_eq!(ErrorFlags::NAMED, manual.map(|(_, flag, _)| flag));
}
