//! The values of a frame as a phrase for people.

use myactuator_protocol_core::command::{BaudCode, ErrorFlags, VersionDate};
use serde_json::Value;

use super::fields::Fields;

/// The ends of keys and the units they stand for, longer ends first.
const UNITS: &[(&str, &str)] = &[
    ("_rad_s", "rad/s"),
    ("_pulses", "pulses"),
    ("_dps2", "dps/s"),
    ("_dps", "dps"),
    ("_deg", "deg"),
    ("_pct", "%"),
    ("_rad", "rad"),
    ("_ms", "ms"),
    ("_nm", "N·m"),
    ("_a", "A"),
    ("_c", "°C"),
    ("_v", "V"),
];

/// Motion mode's values: beyond a few decimals they are an accident of the scale.
const MOTION: &[&str] = &["position_rad", "velocity_rad_s", "kp", "kd", "torque_nm"];

/// Fields as a phrase: `max speed 500 dps, angle 360 deg`.
pub fn prose(fields: &Fields) -> String {
    let phrases: Vec<String> =
        fields.iter().filter_map(|(key, value)| phrase(key, value, fields)).collect();
    phrases.join(", ")
}

/// One field as a phrase, `None` for those that only go with another.
fn phrase(key: &str, value: &Value, fields: &Fields) -> Option<String> {
    let number = |key: &str| fields.get(key).and_then(Value::as_u64).unwrap_or_default();
    Some(match key {
        _ if key.ends_with("_raw") || key.ends_with("_name") => return None,
        "index" => format!("index {value} ({})", name_of(fields.get("index_name"))),
        "command" => {
            format!("command 0x{:02X} ({})", number(key), name_of(fields.get("command_name")))
        }
        "enabled" => if value == true { "on" } else { "off" }.to_owned(),
        "write" => if value == true { "write" } else { "read" }.to_owned(),
        "brake_released" => match value.as_bool() {
            Some(true) => "brake released".to_owned(),
            Some(false) => "brake locked".to_owned(),
            None => format!("brake code {} (unknown)", number("brake_raw")),
        },
        "mode" | "direction" if value == "unknown" => {
            format!("{key} code {} (unknown)", number(&format!("{key}_raw")))
        }
        "errors" => errors(number("errors_raw")),
        "version_date" => version_date(number(key)),
        "baud_code" => baud_code(number(key)),
        _ => {
            let (words, unit) = UNITS
                .iter()
                .find_map(|(end, unit)| Some((key.strip_suffix(end)?, *unit)))
                .unwrap_or((key, ""));
            let words = words.replace('_', " ").replace("mos ", "MOSFET ");
            format!("{words} {} {unit}", plain(key, value)).trim_end().to_owned()
        }
    })
}

/// A value without quotes, and a number without a needless `.0`.
fn plain(key: &str, value: &Value) -> String {
    match (value.as_str(), value.as_f64()) {
        (Some(text), _) => text.to_owned(),
        (None, Some(number)) if MOTION.contains(&key) => ((number * 1e4).round() / 1e4).to_string(),
        (None, Some(number)) => number.to_string(),
        _ => value.to_string(),
    }
}

fn name_of(name: Option<&Value>) -> &str {
    name.and_then(Value::as_str).unwrap_or("unknown")
}

fn errors(raw: u64) -> String {
    let errors = ErrorFlags::from_bits_retain(raw as u16);
    match (errors.is_empty(), errors.needs_restart()) {
        (true, _) => errors.to_string(),
        (false, false) => format!("errors: {errors}"),
        (false, true) => format!("errors: {errors} (a restart is needed)"),
    }
}

fn version_date(raw: u64) -> String {
    let date = VersionDate::from_raw(raw as u32);
    match date.year_month_day() {
        Some(_) => format!("version date {raw} ({date})"),
        None => format!("version date {raw}"),
    }
}

fn baud_code(raw: u64) -> String {
    let code = BaudCode::from_raw(raw as u8);
    let rate = |bits_per_second: Option<u32>| match bits_per_second {
        Some(rate) => format!("{rate} bit/s"),
        None => "not defined".to_owned(),
    };
    format!(
        "baud code {raw} (CAN {}, RS485 {})",
        rate(code.can_bits_per_second()),
        rate(code.rs485_bits_per_second())
    )
}

#[cfg(test)]
mod tests {
    use super::super::fields::{command_fields, reply_fields};
    use super::*;
    use myactuator_protocol_core::Opcode;
    use myactuator_protocol_core::command::{AnyCommand, AnyReply};

    fn command(opcode: Opcode, data: [u8; 8]) -> String {
        prose(&command_fields(&AnyCommand::decode_as(opcode, &data).unwrap()))
    }

    fn reply(opcode: Opcode, data: [u8; 8]) -> String {
        prose(&reply_fields(&AnyReply::decode_as(opcode, &data).unwrap()))
    }

    #[test]
    fn phrases_read_well() {
        assert_eq!(
            reply(Opcode::ReadStatus1, [0x9A, 0x32, 0, 1, 0xE5, 0x01, 0x06, 0]),
            "temperature 50 °C, MOSFET temperature 0 °C, brake released, voltage 48.5 V, \
             errors: motor stalled, supply voltage too low (a restart is needed)"
        );
        assert_eq!(
            reply(Opcode::ReadVersionDate, [0xB2, 0, 0, 0, 0x2E, 0x89, 0x34, 0x01]),
            "version date 20220206 (2022-02-06)"
        );
        assert_eq!(
            command(Opcode::SetBaudRate, [0xB4, 0, 0, 0, 0, 0, 0, 2]),
            "baud code 2 (CAN not defined, RS485 1000000 bit/s)"
        );
        assert_eq!(
            command(Opcode::ActiveReply, [0xB6, 0x60, 1, 1, 0, 0, 0, 0]),
            "command 0x60 (read-multi-turn-encoder), on, interval 10 ms"
        );
        assert_eq!(
            command(Opcode::Motion, [0xE6, 0x66, 0x82, 0xE0, 0x52, 0x33, 0x3B, 0x55]),
            "position 10.0002 rad, velocity 1.022 rad/s, kp 10.0122, kd 1, torque 10.0044 N·m"
        );
        assert_eq!(
            command(Opcode::SingleTurnPosition, [0xA6, 9, 1, 0, 0, 0, 0, 0]),
            "direction code 9 (unknown), max speed 1 dps, angle 0 deg"
        );
        assert_eq!(command(Opcode::ReadPid, [0x30, 1, 0, 0, 0, 0, 0, 0]), "index 1 (current-kp)");
    }
}
