//! The values of a command or reply as JSON, each under a key that ends in its unit.

use myactuator_protocol_core::command::{
    AccelerationIndex, ActiveReply, AnyCommand, AnyReply, BaudCode, BrakeCommand, BusId,
    BusIdReply, Direction, ErrorFlags, Feedback, FunctionControl, Mode, ModelName, MotionRanges,
    PidIndex, RawMotion, RawMotionFeedback, SingleTurnFeedback, Status1, Switch, U12,
};
use myactuator_protocol_core::units::{Gain, Temperature};
use serde_json::{Map, Value};

/// Names with units, and values, in the order of the manual's tables.
pub type Fields = Map<String, Value>;

/// `fields! { "key": value, … }`, in this order.
macro_rules! fields {
    ($($key:literal: $value:expr),* $(,)?) => {
        Fields::from_iter([$(($key.to_owned(), Value::from($value))),*])
    };
}

/// A number of few digits in the double that people mean: 30.1, not 30.100000381.
fn decimal(value: f32) -> f64 {
    value.to_string().parse().unwrap_or_else(|_| f64::from(value))
}

/// The values of a command.
pub fn command_fields(command: &AnyCommand) -> Fields {
    use AnyCommand as C;
    match command {
        C::FunctionControl(function) => function_control(function),
        C::ReadPid(c) => pid_index(c.index),
        C::WritePidRam(c) => pid(c.index, c.value),
        C::WritePidRom(c) => pid(c.index, c.value),
        C::ReadAcceleration(c) => acceleration_index(c.index),
        C::WriteAcceleration(c) => acceleration(c.index, c.acceleration.raw()),
        C::SetEncoderZero(c) => fields! { "offset_pulses": c.offset.raw() },
        C::BusId(BusId::Read) => fields! { "write": false },
        C::BusId(BusId::Write(id)) => fields! { "write": true, "motor_id": id.get() },
        C::Torque(c) => fields! { "current_a": decimal(c.current.amperes()) },
        C::Speed(c) => fields! {
            "max_torque_pct": c.max_torque.raw(),
            "speed_dps": c.speed.dps_f64(),
        },
        C::AbsolutePosition(c) => fields! {
            "max_speed_dps": c.max_speed.raw(),
            "angle_deg": c.angle.degrees_f64(),
        },
        C::SingleTurnPosition(c) => {
            let mut fields = fields! { "direction": c.direction.name() };
            if let Direction::Unknown(raw) = c.direction {
                fields.insert("direction_raw".into(), raw.into());
            }
            fields.extend(fields! {
                "max_speed_dps": c.max_speed.raw(),
                "angle_deg": decimal(c.angle.degrees()),
            });
            fields
        }
        C::IncrementalPosition(c) => fields! {
            "max_speed_dps": c.max_speed.raw(),
            "angle_deg": c.angle.degrees_f64(),
        },
        C::ForcePosition(c) => fields! {
            "max_torque_pct": c.max_torque.raw(),
            "max_speed_dps": c.max_speed.raw(),
            "angle_deg": c.angle.degrees_f64(),
        },
        C::CommunicationLossProtection(c) => fields! { "timeout_ms": c.timeout.raw() },
        C::SetBaudRate(c) => baud_rate(c.baud_rate),
        C::ActiveReply(c) => active_reply(c),
        C::Motion(motion) => motion_command(motion),
        C::ReadMultiTurnEncoder(_)
        | C::ReadMultiTurnEncoderRaw(_)
        | C::ReadMultiTurnEncoderOffset(_)
        | C::SetCurrentPositionZero(_)
        | C::ReadRunningMode(_)
        | C::Reset(_)
        | C::ReleaseBrake(_)
        | C::LockBrake(_)
        | C::Shutdown(_)
        | C::Stop(_)
        | C::ReadSingleTurnEncoder(_)
        | C::ReadMultiTurnAngle(_)
        | C::ReadSingleTurnAngle(_)
        | C::ReadStatus1(_)
        | C::ReadStatus2(_)
        | C::ReadStatus3(_)
        | C::ReadRunTime(_)
        | C::ReadVersionDate(_)
        | C::ReadModel(_) => Fields::new(),
    }
}

/// The values of a reply.
pub fn reply_fields(reply: &AnyReply) -> Fields {
    use AnyReply as R;
    match reply {
        R::FunctionControl(function) => function_control(function),
        R::ReadPid(r) => pid(r.index, r.value),
        R::WritePidRam(r) => pid(r.index, r.value),
        R::WritePidRom(r) => pid(r.index, r.value),
        R::ReadAcceleration(r) => acceleration(r.index, r.acceleration.raw()),
        R::WriteAcceleration(r) => acceleration(r.index, r.acceleration.raw()),
        R::ReadMultiTurnEncoder(r) => fields! { "encoder_pulses": r.position.raw() },
        R::ReadMultiTurnEncoderRaw(r) => fields! { "raw_pulses": r.raw.raw() },
        R::ReadMultiTurnEncoderOffset(r) | R::SetCurrentPositionZero(r) => {
            fields! { "offset_pulses": r.offset.raw() }
        }
        R::SetEncoderZero(r) => fields! { "offset_pulses": r.offset.raw() },
        R::ReadRunningMode(r) => running_mode(r.mode),
        R::BusId(r) => fields! {
            "write": matches!(r, BusIdReply::Written(_)),
            "motor_id": r.id().get(),
        },
        R::ReadSingleTurnEncoder(r) => fields! {
            "encoder_pulses": r.position.raw(),
            "raw_pulses": r.raw.raw(),
            "offset_pulses": r.offset.raw(),
        },
        R::ReadMultiTurnAngle(r) => fields! { "angle_deg": r.angle.degrees_f64() },
        R::ReadSingleTurnAngle(r) => fields! { "angle_deg": decimal(r.angle.degrees()) },
        R::ReadStatus1(status) => status1(status),
        R::ReadStatus2(r)
        | R::Torque(r)
        | R::Speed(r)
        | R::AbsolutePosition(r)
        | R::IncrementalPosition(r)
        | R::ForcePosition(r) => feedback(r),
        R::ReadStatus3(r) => fields! {
            "temperature_c": r.temperature.raw(),
            "phase_a_current_a": decimal(r.phase_a.amperes()),
            "phase_b_current_a": decimal(r.phase_b.amperes()),
            "phase_c_current_a": decimal(r.phase_c.amperes()),
        },
        R::SingleTurnPosition(r) => single_turn_feedback(r),
        R::ReadRunTime(r) => fields! { "run_time_ms": r.run_time.raw() },
        R::ReadVersionDate(r) => fields! { "version_date": r.date.raw() },
        R::CommunicationLossProtection(r) => fields! { "timeout_ms": r.timeout.raw() },
        R::ReadModel(r) => model(&r.name),
        R::Motion(feedback) => motion_reply(feedback),
        R::ReleaseBrake(_) | R::LockBrake(_) | R::Shutdown(_) | R::Stop(_) => Fields::new(),
    }
}

/// A code's name, null where the manual gives none.
fn name_or_null(name: &'static str) -> Value {
    if name == "unknown" { Value::Null } else { name.into() }
}

fn function_control(function: &FunctionControl) -> Fields {
    let value: Value = match *function {
        FunctionControl::MaxPositiveAngle(angle) | FunctionControl::MaxNegativeAngle(angle) => {
            angle.into()
        }
        _ => function.value().into(),
    };
    fields! {
        "index": function.index(),
        "index_name": name_or_null(function.name()),
        "value": value,
    }
}

fn pid_index(index: PidIndex) -> Fields {
    fields! { "index": index.raw(), "index_name": name_or_null(index.name()) }
}

fn pid(index: PidIndex, value: Gain) -> Fields {
    let mut fields = pid_index(index);
    fields.insert("value".into(), decimal(value.value()).into());
    fields
}

fn acceleration_index(index: AccelerationIndex) -> Fields {
    fields! { "index": index.raw(), "index_name": name_or_null(index.name()) }
}

fn acceleration(index: AccelerationIndex, acceleration_dps2: u32) -> Fields {
    let mut fields = acceleration_index(index);
    fields.insert("acceleration_dps2".into(), acceleration_dps2.into());
    fields
}

fn running_mode(mode: Mode) -> Fields {
    fields! { "mode": mode.name(), "mode_raw": mode.raw() }
}

fn baud_rate(code: BaudCode) -> Fields {
    fields! { "baud_code": code.raw() }
}

fn active_reply(command: &ActiveReply) -> Fields {
    fields! {
        "command": command.command.raw(),
        "command_name": name_or_null(command.command.name()),
        "enabled": command.enable == Switch::On,
        "interval_ms": f64::from(command.interval.millis()) as u64,
    }
}

fn status1(status: &Status1) -> Fields {
    let mut fields = fields! {
        "temperature_c": status.temperature.raw(),
        "mos_temperature_c": status.mos_temperature.raw(),
    };
    fields.extend(match status.brake {
        BrakeCommand::Release => fields! { "brake_released": true },
        BrakeCommand::Lock => fields! { "brake_released": false },
        BrakeCommand::Unknown(raw) => fields! { "brake_released": (), "brake_raw": raw },
    });
    fields.extend(fields! {
        "voltage_v": decimal(status.voltage.volts()),
        "errors": status.errors.each().map(error_name).collect::<Vec<_>>(),
        "errors_raw": status.errors.bits(),
    });
    fields
}

fn error_name(error: ErrorFlags) -> String {
    match error.name() {
        Some(name) => name.to_owned(),
        None => format!("unknown-0x{:04X}", error.bits()),
    }
}

/// What both kinds of feedback begin with (2.15.3, 2.22.3).
fn common_feedback(temperature: Temperature, current_a: f32, speed_dps: f32) -> Fields {
    fields! {
        "temperature_c": temperature.raw(),
        "current_a": decimal(current_a),
        "speed_dps": decimal(speed_dps),
    }
}

fn feedback(reply: &Feedback) -> Fields {
    let mut fields = common_feedback(reply.temperature, reply.current.amperes(), reply.speed.dps());
    fields.insert("angle_deg".into(), decimal(reply.angle.degrees()).into());
    fields
}

fn single_turn_feedback(reply: &SingleTurnFeedback) -> Fields {
    let mut fields = common_feedback(reply.temperature, reply.current.amperes(), reply.speed.dps());
    fields.insert("encoder_pulses".into(), reply.encoder.raw().into());
    fields
}

fn model(name: &ModelName) -> Fields {
    let mut fields = fields! { "model": name.to_string() };
    if name.as_str().is_none() {
        let bytes = name.bytes().map(|byte| format!("{byte:02X}")).concat();
        fields.insert("model_raw".into(), bytes.into());
    }
    fields
}

const LAST_16: u16 = u16::MAX;
const LAST_12: u16 = 0xFFF;

/// The place of a step between `min` and `max`, in double precision: the library's own conversions
/// are in single, for microcontrollers.
fn on_scale(step: u16, last: u16, min: f32, max: f32) -> f64 {
    let (min, max) = (f64::from(min), f64::from(max));
    min + f64::from(step) * (max - min) / f64::from(last)
}

/// The place of a step on a scale that reaches as far to both sides of zero.
fn symmetric(step: u16, last: u16, limit: f32) -> f64 {
    on_scale(step, last, -limit, limit)
}

fn positive(step: U12, limit: f32) -> f64 {
    on_scale(step.get(), LAST_12, 0.0, limit)
}

fn motion_command(raw: &RawMotion) -> Fields {
    let limits = MotionRanges::V4_3.limits();
    fields! {
        "position_rad": symmetric(raw.position, LAST_16, limits.position_rad),
        "velocity_rad_s": symmetric(raw.velocity.get(), LAST_12, limits.velocity_rad_s),
        "kp": positive(raw.kp, limits.kp),
        "kd": positive(raw.kd, limits.kd),
        "torque_nm": symmetric(raw.torque.get(), LAST_12, limits.torque_nm),
        "position_raw": raw.position,
        "velocity_raw": raw.velocity.get(),
        "kp_raw": raw.kp.get(),
        "kd_raw": raw.kd.get(),
        "torque_raw": raw.torque.get(),
    }
}

fn motion_reply(raw: &RawMotionFeedback) -> Fields {
    let limits = MotionRanges::V4_3.limits();
    fields! {
        "motor_id": raw.id.get(),
        "position_rad": symmetric(raw.position, LAST_16, limits.position_rad),
        "velocity_rad_s": symmetric(raw.velocity.get(), LAST_12, limits.velocity_rad_s),
        "torque_nm": symmetric(raw.torque.get(), LAST_12, limits.torque_nm),
        "position_raw": raw.position,
        "velocity_raw": raw.velocity.get(),
        "torque_raw": raw.torque.get(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use myactuator_protocol_core::Opcode;

    fn reply(opcode: Opcode, data: [u8; 8]) -> String {
        Value::from(reply_fields(&AnyReply::decode_as(opcode, &data).unwrap())).to_string()
    }

    fn command(opcode: Opcode, data: [u8; 8]) -> String {
        Value::from(command_fields(&AnyCommand::decode_as(opcode, &data).unwrap())).to_string()
    }

    #[test]
    fn decimals_print_as_people_write_them() {
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
            r#"{"index":3,"index_name":null,"value":0.1}"#
        );
    }

    #[test]
    fn unknown_codes_keep_their_numbers() {
        assert_eq!(
            reply(Opcode::ReadStatus1, [0x9A, 1, 2, 7, 0xE5, 0x01, 0x24, 0x00]),
            r#"{"temperature_c":1,"mos_temperature_c":2,"brake_released":null,"brake_raw":7,"voltage_v":48.5,"errors":["under-voltage","unknown-0x0020"],"errors_raw":36}"#
        );
        assert_eq!(
            reply(Opcode::ReadRunningMode, [0x70, 0, 0, 0, 0, 0, 0, 9]),
            r#"{"mode":"unknown","mode_raw":9}"#
        );
        assert_eq!(
            reply(Opcode::ReadModel, [0xB5, b'X', 0xFF, 0, 0, 0, 0, 0]),
            r#"{"model":"X......","model_raw":"58FF0000000000"}"#
        );
        assert_eq!(
            command(Opcode::SingleTurnPosition, [0xA6, 5, 1, 0, 0, 0, 0, 0]),
            r#"{"direction":"unknown","direction_raw":5,"max_speed_dps":1,"angle_deg":0.0}"#
        );
        assert_eq!(
            command(Opcode::ActiveReply, [0xB6, 0x11, 0, 0xFF, 0xFF, 0, 0, 0]),
            r#"{"command":17,"command_name":null,"enabled":false,"interval_ms":655350}"#
        );
    }

    #[test]
    fn limits_of_angle_have_a_sign() {
        assert_eq!(
            command(Opcode::FunctionControl, [0x20, 7, 0, 0, 0xFF, 0xFF, 0xFF, 0xFF]),
            r#"{"index":7,"index_name":"max-negative-angle","value":-1}"#
        );
    }
}
