//! Turns arguments into the library's quantities, or into a sentence with the allowed range.

use std::str::FromStr;

use myactuator_host_std::BusKind;
use myactuator_host_std::protocol::command::{BaudCode, Field, MotionLimits, MotionRanges};
use myactuator_host_std::protocol::opcode::Reach;
use myactuator_host_std::protocol::quantity::{Form, OutOfRange, Quantity, Steps};
use myactuator_host_std::protocol::time::Duration;
use myactuator_host_std::protocol::units::{
    Angle, Current, MaxSpeed, MaxTorque, Milliseconds, SpeedTarget,
};
use myactuator_host_std::protocol::{Firmware, Kind, MotorId, Opcode, Target};

/// A value, or one sentence about what is allowed.
type Parsed<T> = Result<T, String>;

/// Why motion mode is not encoded without a firmware.
pub(super) const SCALES_ARE_NOT_GUESSED: &str = "--firmware or --ranges is missing: the scales of motion \
     mode differ between firmwares, and the wrong ones multiply the torque";
pub(super) const RANGES_ARE_MISSING: &str =
    "--ranges is missing: the scales of this firmware's motion mode depend on the motor";

/// A number, decimal or whole with `0x`. One that is too small for a double is refused: it would become 0, which may
/// mean "no limit".
pub(super) fn number(text: &str) -> Option<f64> {
    match integer(text) {
        Some(whole) => Some(whole as f64),
        None => {
            let is_zero = |text: &str| {
                let digits = text.split(['e', 'E']).next().unwrap_or(text);
                !digits.contains(|c: char| matches!(c, '1'..='9'))
            };
            text.parse().ok().filter(|value: &f64| *value != 0.0 || is_zero(text))
        }
    }
}

/// A finite number for a quantity of motion mode.
pub(super) fn single(text: &str) -> Parsed<f32> {
    let value = finite(text)? as f32;
    if value.is_finite() { Ok(value) } else { Err(no_number(text)) }
}

/// A finite number for the physics.
pub(super) fn finite(text: &str) -> Parsed<f64> {
    number(text).filter(|value| value.is_finite()).ok_or_else(|| no_number(text))
}

fn no_number(text: &str) -> String {
    format!("expected a number such as 1.5, found \"{text}\"")
}

/// A whole number, decimal or with `0x`.
fn integer(text: &str) -> Option<i64> {
    match text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
        Some(digits) if !digits.starts_with(['+', '-']) => i64::from_str_radix(digits, 16).ok(),
        Some(_) => None,
        None => text.parse().ok(),
    }
}

/// The number on the wire that is nearest to an amount of a quantity.
fn amount(text: &str, quantity: &'static Quantity) -> Parsed<i64> {
    let given = number(text).ok_or_else(|| format!("{quantity}, but \"{text}\" is no number"))?;
    let raw = quantity.nearest(given).map_err(|error| error.to_string())?;
    match quantity.form {
        // Steps of a whole unit or more: a part of a step is a mistake.
        Form::Steps(Steps { denominator: 1, .. }) if quantity.amount(raw) != given => {
            let (step, unit) = (quantity.amount(1), quantity.unit.symbol());
            Err(format!("{quantity} in steps of {step} {unit}, but {given} {unit} was given"))
        }
        _ => Ok(raw),
    }
}

/// The number on the wire of a field's value: an amount in its unit, a code's name or number, on or
/// off, or a motion value on these scales.
pub(super) fn field(text: &str, field: &Field, ranges: Option<&MotionRanges>) -> Parsed<i64> {
    let quantity = field.quantity;
    match quantity.form {
        Form::Code(_) => {
            let named = quantity.code_of(text).map(i64::from);
            let number = || integer(text).filter(|code| (0..=0xFF).contains(code));
            named.or_else(number).ok_or_else(|| format!("{quantity}, but \"{text}\" was given"))
        }
        Form::Switch => match text {
            "on" | "true" | "1" => Ok(1),
            "off" | "false" | "0" => Ok(0),
            _ => Err(format!("{} must be on or off, but \"{text}\" was given", quantity.name)),
        },
        Form::Motion(scale) => {
            let ranges = ranges.ok_or(RANGES_ARE_MISSING)?;
            let value = number(text).ok_or_else(|| {
                let ((min, max), unit) = (ranges.ends(scale), quantity.unit.symbol());
                format!(
                    "{} must be {min} to {max} {unit}, but \"{text}\" is no number",
                    quantity.name
                )
            })?;
            ranges.step(scale, value).map(i64::from).map_err(|error| error.to_string())
        }
        _ => amount(text, quantity),
    }
}

/// Parsers of quantities by their amount.
macro_rules! amounts {
    ($($parser:ident: $quantity:ident($raw:ty);)+) => {$(
        pub(super) fn $parser(text: &str) -> Parsed<$quantity> {
            // `nearest` returns nothing that does not fit.
            amount(text, &$quantity::QUANTITY).map(|raw| $quantity::from_raw(raw as $raw))
        }
    )+};
}

amounts! {
    current: Current(i16);
    speed: SpeedTarget(i32);
    max_speed: MaxSpeed(u16);
    max_torque: MaxTorque(u8);
    angle: Angle(i32);
    milliseconds: Milliseconds(u32);
}

/// A span of time that a command may take.
pub(super) fn seconds(text: &str) -> Parsed<Duration> {
    match number(text) {
        Some(given) if (0.01..=3600.0).contains(&given) => {
            Ok(Duration::from_micros((given * 1e6).round() as u64))
        }
        Some(given) => Err(format!("time must be 0.01 to 3600 s, but {given} s was given")),
        None => Err(format!("time must be 0.01 to 3600 s, but \"{text}\" is no number")),
    }
}

pub(super) fn motor_id(text: &str) -> Parsed<MotorId> {
    let quantity = &MotorId::QUANTITY;
    let given =
        integer(text).ok_or_else(|| format!("{quantity}, but \"{text}\" is no whole number"))?;
    let id = u8::try_from(given).ok().and_then(|id| MotorId::new(id).ok());
    id.ok_or_else(|| OutOfRange { quantity, given: (given as f64).into() }.to_string())
}

pub(super) fn target(text: &str) -> Parsed<Target> {
    if text.eq_ignore_ascii_case("all") {
        return Ok(Target::All);
    }
    motor_id(text)
        .map(Target::Motor)
        .map_err(|_| format!("{}, or all, but \"{text}\" was given", MotorId::QUANTITY))
}

/// The target of a command. One that reaches all connected motors names no motor.
pub(super) fn whom(kind: Kind, id: Option<Target>) -> Parsed<Target> {
    let reaches_all = kind.opcode().is_some_and(|opcode| opcode.reach() == Reach::Connected);
    let target = id.or(reaches_all.then_some(Target::All));
    let target = target.ok_or("--id is missing: say which motor, 1 to 32, or all")?;
    kind.channel_to(target).map_err(|error| format!("--id: {error}"))?;
    Ok(target)
}

pub(super) fn check_bus(kind: Kind, bus: BusKind) -> Parsed<()> {
    match bus {
        BusKind::Can => Ok(()),
        BusKind::Rs485 => kind.check_on_rs485().map_err(|error| format!("--bus: {error}")),
    }
}

/// Refuses a code to which the manual gives no bit rate on this bus (2.32.4). A motor that took it would be lost, and
/// nothing would say so.
pub(super) fn check_baud_rate(code: BaudCode, bus: BusKind) -> Parsed<()> {
    let (bus, rate): (_, fn(BaudCode) -> Option<u32>) = match bus {
        BusKind::Can => ("CAN", BaudCode::can_bits_per_second),
        BusKind::Rs485 => ("RS485", BaudCode::rs485_bits_per_second),
    };
    if rate(code).is_some() {
        return Ok(());
    }
    let named = [BaudCode::CAN_500K_RS485_115200, BaudCode::CAN_1M_RS485_500K, BaudCode::RS485_1M];
    let valid = named.into_iter().filter(|code| rate(*code).is_some());
    let valid: Vec<String> = valid.map(|code| format!("{code} ({})", code.raw())).collect();
    Err(format!(
        "--baud-rate: {} is no bit rate of {bus} by the manual: take {}",
        code.raw(),
        valid.join(" or ")
    ))
}

pub(super) fn check_firmware(opcode: Opcode, firmware: Firmware) -> Parsed<()> {
    if opcode.is_in(firmware) {
        return Ok(());
    }
    Err(format!("--firmware: {}", lacks(opcode, firmware)))
}

/// Says that a firmware does not have a command, and which one it has instead.
pub(super) fn lacks(opcode: Opcode, firmware: Firmware) -> String {
    let instead = opcode.byte().and_then(|byte| Opcode::of_firmware(firmware, byte));
    let instead = instead.map_or(String::new(), |other| format!(": take {}", other.name()));
    format!("{firmware} has no {opcode}{instead}")
}

pub(super) fn firmware(text: &str) -> Parsed<Firmware> {
    text.parse().map_err(|error| format!("{error}, but \"{text}\" was given"))
}

/// The scales of motion mode: those of a firmware, or five numbers.
pub(super) fn ranges(text: &str) -> Parsed<MotionRanges> {
    let numbers: Result<Vec<f32>, _> = text.split(',').map(f32::from_str).collect();
    match numbers.as_deref() {
        Ok(&[position_rad, velocity_rad_s, kp, kd, torque_nm]) => {
            MotionRanges::new(MotionLimits { position_rad, velocity_rad_s, kp, kd, torque_nm })
                .map_err(|error| error.to_string())
        }
        _ => Err(format!(
            "expected five numbers such as 12.5,45,500,5,24 (the largest position in rad, \
             velocity in rad/s, kp, kd and torque in N·m), found \"{text}\""
        )),
    }
}

/// Which revision of the protocol frames are of, and the scales of their motion mode.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(super) struct Revision {
    /// The revision of the protocol: v4.3, or v4.4, of which only 0x94 and what it shares with v4.3 are known.
    #[arg(long, global = true, value_parser = firmware, default_value = "v4.3")]
    pub(super) firmware: Firmware,
    /// The scales of motion mode, if they differ from the firmware's: the largest position, velocity, kp, kd and
    /// torque, as in 12.566,45,500,5,60.
    #[arg(long, global = true, value_parser = ranges)]
    pub(super) ranges: Option<MotionRanges>,
}

impl Revision {
    /// The scales that were given, else the firmware's own if it has them.
    pub(super) fn motion_ranges(&self) -> Option<MotionRanges> {
        self.ranges.or(self.firmware.motion_ranges())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_is_never_rounded_to_none() {
        for tiny in ["1e-400", "0.0001e-330", "-1e-999", "0.4"] {
            assert!(max_speed(tiny).is_err() && max_torque(tiny).is_err(), "{tiny}");
        }
        for zero in ["0", "0.0", "-0", "0e5", "0x0"] {
            assert_eq!(max_speed(zero).unwrap().raw(), 0, "{zero}");
        }
        assert_eq!(max_speed("0").unwrap().raw(), 0);
        assert_eq!(
            max_speed("0.4").unwrap_err(),
            "maximum speed must be 1 to 65535 dps (0: no limit in direct tracking), but 0.4 dps was given"
        );
        assert!(max_torque("0.2").is_err());
        assert!(max_torque("-0.2").is_err());
    }

    #[test]
    fn ranges_are_given_number_by_number() {
        assert_eq!(ranges("12.5,45,500,5,24"), Ok(MotionRanges::V4_3));
        assert_ne!(ranges("12.566,45,500,5,60"), Ok(MotionRanges::V4_3));
        let sentence = ranges("v4.3").unwrap_err();
        assert!(sentence.starts_with("expected five numbers"), "{sentence}");
        assert!(ranges("12.5,45").is_err() && ranges("12.5,45,500,5,-24").is_err());
    }
}
