//! Turns what a person typed into the library's quantities, or into a sentence with the range.

use std::fmt::Display;
use std::str::FromStr;

use myactuator_protocol_core::command::{
    AccelerationIndex, BaudCode, Direction, FunctionControl, MotionOutOfRange, MotionRanges,
    MotionSetPoint, PidIndex, ReportedCommand,
};
use myactuator_protocol_core::range::{OutOfRange, Quantity};
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::{
    Acceleration, Angle, Current, EncoderPulses, Gain, MaxSpeed, MaxTorque, Milliseconds,
    ReportInterval, SingleTurnTarget, SpeedTarget,
};
use myactuator_protocol_core::{MotorId, Target};

/// A value, or one sentence about what is allowed.
type Parsed<T> = Result<T, String>;

/// What a quantity allows, in words: `angle must be -10 to 10 deg`.
fn allowed(quantity: &Quantity) -> String {
    let Quantity { name, unit, min, max } = quantity;
    format!("{name} must be {min} to {max} {unit}").trim_end().to_owned()
}

fn not_a_number(allowed: impl Display, text: &str) -> String {
    format!("{allowed}, but \"{text}\" is no number")
}

fn float(text: &str, quantity: &Quantity) -> Parsed<f64> {
    text.parse().map_err(|_| not_a_number(allowed(quantity), text))
}

/// The library's sentence, with the number as it was typed: single precision would show through.
fn refuse(error: OutOfRange, given: f64) -> String {
    OutOfRange { given: given.into(), ..error }.to_string()
}

/// Parsers of quantities with a conversion from `f32` or `f64`.
macro_rules! floats {
    ($($parser:ident: $quantity:ident by $from:ident($float:ty);)+) => {$(
        pub(super) fn $parser(text: &str) -> Parsed<$quantity> {
            let given = float(text, &$quantity::QUANTITY)?;
            $quantity::$from(given as $float).map_err(|error| refuse(error, given))
        }
    )+};
}

floats! {
    current: Current by from_amperes(f32);
    speed: SpeedTarget by from_dps_f64(f64);
    max_speed: MaxSpeed by from_dps(f32);
    max_torque: MaxTorque by from_percent(f32);
    angle: Angle by from_degrees_f64(f64);
    single_turn_angle: SingleTurnTarget by from_degrees(f32);
    acceleration: Acceleration by from_dps2(f32);
    gain: Gain by new(f32);
}

/// A whole number, decimal or with `0x`.
fn integer(text: &str) -> Option<i64> {
    match text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
        Some(digits) if !digits.starts_with(['+', '-']) => i64::from_str_radix(digits, 16).ok(),
        Some(_) => None,
        None => text.parse().ok(),
    }
}

/// A whole number that a quantity without fractions allows.
fn whole<T: TryFrom<i64>>(text: &str, quantity: &'static Quantity) -> Parsed<T> {
    let Some(given) = integer(text) else {
        return Err(format!("{}, but \"{text}\" is no whole number", allowed(quantity)));
    };
    T::try_from(given)
        .map_err(|_| OutOfRange { quantity, given: (given as f64).into() }.to_string())
}

pub(super) fn pulses(text: &str) -> Parsed<EncoderPulses> {
    whole(text, &EncoderPulses::QUANTITY).map(EncoderPulses::from_raw)
}

pub(super) fn milliseconds(text: &str) -> Parsed<Milliseconds> {
    whole(text, &Milliseconds::QUANTITY).map(Milliseconds::from_raw)
}

/// A span of time that a command may take.
pub(super) fn seconds(text: &str) -> Parsed<Duration> {
    const SPAN: Quantity = Quantity { name: "time", unit: "s", min: 0.01, max: 3600.0 };
    let given = float(text, &SPAN)?;
    if (SPAN.min..=SPAN.max).contains(&given) {
        Ok(Duration::from_micros((given * 1e6).round() as u64))
    } else {
        Err(OutOfRange { quantity: &SPAN, given: given.into() }.to_string())
    }
}

/// A multiple of the interval's step: rounding could end at 0.
pub(super) fn interval(text: &str) -> Parsed<ReportInterval> {
    let given = float(text, &ReportInterval::QUANTITY)?;
    let interval =
        ReportInterval::from_millis(given as f32).map_err(|error| refuse(error, given))?;
    if f64::from(interval.millis()) == given {
        Ok(interval)
    } else {
        let allowed = allowed(&ReportInterval::QUANTITY);
        let step = ReportInterval::from_raw(1);
        Err(format!("{allowed} in steps of {step}, but {given} ms was given"))
    }
}

pub(super) fn motor_id(text: &str) -> Parsed<MotorId> {
    let quantity = &MotorId::QUANTITY;
    let given: i64 = whole(text, quantity)?;
    u8::try_from(given)
        .ok()
        .and_then(|id| MotorId::new(id).ok())
        .ok_or_else(|| OutOfRange { quantity, given: (given as f64).into() }.to_string())
}

pub(super) fn target(text: &str) -> Parsed<Target> {
    if text.eq_ignore_ascii_case("all") {
        return Ok(Target::All);
    }
    match integer(text).and_then(|id| u8::try_from(id).ok()).map(MotorId::new) {
        Some(Ok(id)) => Ok(Target::Motor(id)),
        _ => {
            let Quantity { name, min, max, .. } = MotorId::QUANTITY;
            Err(format!("{name} must be {min} to {max}, or all, but \"{text}\" was given"))
        }
    }
}

/// A code by its number or by its name, from a list of those that the manual names.
fn code<T: Copy>(
    text: &str,
    what: &str,
    all: impl Iterator<Item = (T, u8, &'static str)> + Clone,
) -> Parsed<T> {
    let number = integer(text);
    let found = all.clone().find(|&(_, raw, name)| number == Some(raw.into()) || name == text);
    found.map(|(code, _, _)| code).ok_or_else(|| {
        let list: Vec<String> = all.map(|(_, raw, name)| format!("{raw} ({name})")).collect();
        format!("{what} must be one of {}, but \"{text}\" was given", list.join(", "))
    })
}

/// Parsers of codes that the manual names one by one.
macro_rules! codes {
    ($($parser:ident: $code:ident $what:literal;)+) => {$(
        pub(super) fn $parser(text: &str) -> Parsed<$code> {
            code(text, $what, $code::ALL.iter().map(|&code| (code, code.raw(), code.name())))
        }
    )+};
}

codes! {
    pid_index: PidIndex "gain index";
    acceleration_index: AccelerationIndex "acceleration index";
    direction: Direction "direction";
}

pub(super) fn reported_command(text: &str) -> Parsed<ReportedCommand> {
    let all = ReportedCommand::ALL.iter();
    let number = integer(text);
    let found = all.clone().find(|code| number == Some(code.raw().into()) || code.name() == text);
    found.copied().ok_or_else(|| {
        let list: Vec<String> =
            all.map(|code| format!("0x{:02X} ({})", code.raw(), code.name())).collect();
        format!("reported command must be one of {}, but \"{text}\" was given", list.join(", "))
    })
}

/// Any code: the manual names three and leaves those of the faster RS485 rates open (2.32.4).
pub(super) fn baud_code(text: &str) -> Parsed<BaudCode> {
    const CODE: Quantity = Quantity { name: "baud code", unit: "", min: 0.0, max: 255.0 };
    if let Some(code) = BaudCode::ALL.iter().find(|code| code.name() == text) {
        return Ok(*code);
    }
    whole(text, &CODE).map(BaudCode::from_raw)
}

/// The index of a special function (2.35).
pub(super) fn function_index(text: &str) -> Parsed<u8> {
    // Every function with its smallest value that is allowed everywhere: 1.
    let all = (1..=u8::MAX)
        .map_while(|index| FunctionControl::from_index(index, 1).ok())
        .take_while(|function| !matches!(function, FunctionControl::Unknown { .. }))
        .map(|function| (function.index(), function.index(), function.name()));
    code(text, "function index", all)
}

/// A special function with its value (2.35).
pub(super) fn function(index: u8, value: Option<&str>) -> Parsed<FunctionControl> {
    const SIGNED: Quantity =
        Quantity { name: "angle limit", unit: "", min: i32::MIN as f64, max: i32::MAX as f64 };
    const UNSIGNED: Quantity = Quantity { name: "value", unit: "", min: 0.0, max: u32::MAX as f64 };
    let Some(text) = value else {
        return match FunctionControl::from_index(index, 0) {
            Ok(function @ FunctionControl::ClearMultiTurn) => Ok(function),
            _ => Err(format!("--value is missing: function {index} needs one")),
        };
    };
    let named = |sentence: String| format!("--value: {sentence}");
    let function = match FunctionControl::from_index(index, 1) {
        Ok(FunctionControl::MaxPositiveAngle(_)) => {
            FunctionControl::MaxPositiveAngle(whole(text, &SIGNED).map_err(named)?)
        }
        Ok(FunctionControl::MaxNegativeAngle(_)) => {
            FunctionControl::MaxNegativeAngle(whole(text, &SIGNED).map_err(named)?)
        }
        Ok(FunctionControl::ClearMultiTurn) if integer(text) != Some(0) => {
            let name = FunctionControl::ClearMultiTurn.name();
            return Err(named(format!("{name} takes no value but 0, but \"{text}\" was given")));
        }
        _ => {
            let raw: u32 = whole(text, &UNSIGNED).map_err(named)?;
            FunctionControl::from_index(index, raw)
                .map_err(|error| named(refuse(error, f64::from(raw))))?
        }
    };
    Ok(function)
}

/// Parsers of motion mode's values, each by the same check that encodes them all.
macro_rules! motion {
    ($($parser:ident: $field:ident;)+) => {$(
        pub(super) fn $parser(text: &str) -> Parsed<f32> {
            motion_value(text, |$field| MotionSetPoint { $field, ..MotionSetPoint::default() })
        }
    )+};
}

motion! {
    position: position_rad;
    velocity: velocity_rad_s;
    kp: kp;
    kd: kd;
    torque: torque_nm;
}

fn motion_value(text: &str, set_point: impl Fn(f32) -> MotionSetPoint) -> Parsed<f32> {
    let number = f32::from_str(text);
    match MotionRanges::V4_3.quantise(&set_point(number.clone().unwrap_or(f32::NAN))) {
        Ok(_) => Ok(number.unwrap_or_default()),
        Err(MotionOutOfRange { name, unit, min, max, .. }) if number.is_err() => {
            Err(not_a_number(format_args!("{name} must be {min} to {max} {unit}"), text))
        }
        Err(error) => Err(error.to_string()),
    }
}
