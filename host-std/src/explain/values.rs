//! The fields of a frame as JSON, each under a key that ends in its unit.

use myactuator_protocol_core::Data;
use myactuator_protocol_core::command::{ErrorFlags, Field, ModelName, MotionRanges};
use myactuator_protocol_core::quantity::Form;
use serde_json::{Map, Value};

use crate::text::error_name;

/// Names with units, and values, in the order of the manual's tables.
pub type Values = Map<String, Value>;

/// The values of `fields` in a data field. A code, a set of errors and a motion value also have their number, under a
/// key that ends in `_raw`. A code without a name is null.
pub fn values(fields: &[Field], data: &Data, ranges: Option<&MotionRanges>) -> Values {
    let mut values = Values::new();
    for field in fields.iter().filter(|field| field.is_in(data)) {
        let raw = field.raw(data);
        let (value, with_raw) = value(field, raw, data, ranges);
        values.insert(field.key().to_string(), value);
        if with_raw {
            values.insert(format!("{}_raw", field.name), raw.into());
        }
    }
    values
}

/// A value, and whether its number is added.
fn value(field: &Field, raw: i64, data: &Data, ranges: Option<&MotionRanges>) -> (Value, bool) {
    match field.quantity.form {
        Form::Steps(steps) if steps.denominator == 1 => {
            ((raw * i64::from(steps.numerator)).into(), false)
        }
        Form::Float => (decimal(f32::from_bits(raw as u32)).into(), false),
        Form::Code(_) => (field.quantity.name_of(raw).into(), true),
        Form::Switch => ((raw == 1).into(), false),
        Form::Flags(_) => {
            let errors = ErrorFlags::from_bits_retain(raw as u16);
            (errors.each().map(error_name).collect::<Vec<_>>().into(), true)
        }
        Form::Date | Form::ReplyIdentifier => (raw.into(), false),
        Form::Text => {
            let [_, name @ ..] = *data;
            let name = ModelName::from_bytes(name);
            (name.to_string().into(), name.as_str().is_none())
        }
        Form::Motion(scale) => (ranges.map(|ranges| ranges.value(scale, raw as u16)).into(), true),
        _ => (field.quantity.amount(raw).into(), false),
    }
}

/// A number with few digits, as the double that people mean: 0.1, not 0.100000001.
fn decimal(value: f32) -> f64 {
    value.to_string().parse().unwrap_or_else(|_| f64::from(value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use myactuator_protocol_core::Opcode;

    fn reply(opcode: Opcode, data: Data) -> String {
        let ranges = MotionRanges::V4_3;
        Value::from(values(opcode.reply_fields(), &data, Some(&ranges))).to_string()
    }

    fn command(opcode: Opcode, data: Data) -> String {
        Value::from(values(opcode.command_fields(), &data, None)).to_string()
    }

    #[test]
    fn decimals_print_without_rounding_noise() {
        // 0x0BC2 = 3010, 0x8001 = -32767, 0x0001 = 1, each 0.01 A.
        assert_eq!(
            reply(Opcode::ReadStatus3, [0x9D, 0x80, 0xC2, 0x0B, 0x01, 0x80, 0x01, 0x00]),
            r#"{"temperature_c":-128,"phase_a_current_a":30.1,"phase_b_current_a":-327.67,"phase_c_current_a":0.01}"#
        );
        // 0x7FFFFFFF = 2147483647 hundredths.
        assert_eq!(
            reply(Opcode::ReadMultiTurnAngle, [0x92, 0, 0, 0, 0xFF, 0xFF, 0xFF, 0x7F]),
            r#"{"angle_deg":21474836.47}"#
        );
        // 0.1 as a single: 0x3DCCCCCD.
        assert_eq!(
            reply(Opcode::ReadPid, [0x30, 3, 0, 0, 0xCD, 0xCC, 0xCC, 0x3D]),
            r#"{"index":null,"index_raw":3,"value":0.1}"#
        );
    }

    #[test]
    fn unknown_codes_keep_their_numbers() {
        assert_eq!(
            reply(Opcode::ReadStatus1, [0x9A, 1, 2, 7, 0xE5, 0x01, 0x24, 0x00]),
            r#"{"temperature_c":1,"mosfet_temperature_c":2,"brake":null,"brake_raw":7,"voltage_v":48.5,"errors":["under-voltage","unknown-0x0020"],"errors_raw":36}"#
        );
        assert_eq!(
            reply(Opcode::ReadRunningMode, [0x70, 0, 0, 0, 0, 0, 0, 9]),
            r#"{"mode":null,"mode_raw":9}"#
        );
        assert_eq!(
            reply(Opcode::ReadModel, [0xB5, b'X', 0xFF, 0, 0, 0, 0, 0]),
            r#"{"model":"X......","model_raw":65368}"#
        );
        assert_eq!(
            command(Opcode::ActiveReply, [0xB6, 0x11, 0, 0xFF, 0xFF, 0, 0, 0]),
            r#"{"command":null,"command_raw":17,"enable":false,"interval_ms":655350}"#
        );
    }

    #[test]
    fn function_value_has_the_type_of_its_function() {
        let of = |index, value: u8| {
            command(Opcode::FunctionControl, [0x20, index, 0, 0, value, value, value, value])
        };
        assert_eq!(of(7, 0xFF), r#"{"index":"max-negative-angle","index_raw":7,"value":-1}"#);
        assert_eq!(of(8, 0xFF), r#"{"index":null,"index_raw":8,"value":4294967295}"#);
        assert_eq!(of(1, 0), r#"{"index":"clear-multi-turn","index_raw":1}"#);
        assert_eq!(of(3, 0), r#"{"index":"error-reporting","index_raw":3,"value":false}"#);
    }

    #[test]
    fn motion_values_need_a_scale() {
        let motion = [0x01, 0x80, 0x00, 0x00, 0x0F, 0xFF, 0, 0];
        assert_eq!(
            Value::from(values(Opcode::Motion.reply_fields(), &motion, None)).to_string(),
            r#"{"id_byte":1,"position_rad":null,"position_raw":32768,"velocity_rad_s":null,"velocity_raw":0,"torque_nm":null,"torque_raw":4095}"#
        );
        assert!(reply(Opcode::Motion, motion).contains(r#""torque_nm":24.0,"torque_raw":4095"#));
    }
}
