//! Proves that every example frame of the manual decodes to what the text beside it says and
//! encodes back to the same bytes, on both buses. The rows and their misprints are in `vectors/`.
//!
//! No example of the manual prints a NULL byte other than 0, so no row is excepted.

use embedded_can::{Frame as _, Id, StandardId};
use myactuator_protocol_core::command::{BusId, BusIdReply, Feedback, MotionRanges};
use myactuator_protocol_core::wire::{can, rs485};
use myactuator_protocol_core::{AnyCommand, AnyReply, Data, Packet};
use myactuator_tests::line::Line;
use myactuator_tests::vectors::{Bus, Direction, Row, rows};
use serde_json::{Map, Value, json};

/// Every row about which the manual contradicts itself: section, example, bus, direction, id.
/// `vectors/README.md` tells how each is read.
const MISPRINTS: [(&str, u32, Bus, Direction, &str); 21] = {
    use Bus::{Can, Rs485};
    use Direction::{Command, Reply};
    [
        ("2.15.4", 1, Can, Command, "1"),
        ("2.15.4", 1, Rs485, Command, "1"),
        ("2.22.4", 1, Can, Command, "1"),
        ("2.22.4", 1, Rs485, Command, "1"),
        ("2.22.4", 2, Can, Command, "1"),
        ("2.22.4", 2, Rs485, Command, "1"),
        ("2.31.4", 2, Can, Reply, "1"),
        ("2.31.4", 2, Rs485, Reply, "1"),
        ("2.35.5", 2, Can, Command, "1"),
        ("2.35.5", 2, Rs485, Command, "1"),
        ("3.2", 1, Can, Command, "all"),
        ("3.2", 2, Can, Command, "all"),
        ("4.4", 1, Can, Command, "all"),
        ("4.4", 2, Can, Reply, "all"),
        ("5.4", 1, Can, Command, "1"),
        ("5.4", 1, Can, Reply, "1"),
        ("6.2", 1, Rs485, Command, "all"),
        ("6.2", 2, Rs485, Command, "all"),
        ("6.2", 2, Rs485, Reply, "4"),
        ("7.4", 1, Rs485, Command, "all"),
        ("7.4", 2, Rs485, Reply, "all"),
    ]
};

enum Any {
    Command(AnyCommand),
    Reply(AnyReply),
}

impl Any {
    fn decode(direction: Direction, packet: &Packet, row: &Row) -> Self {
        match direction {
            Direction::Command => AnyCommand::decode(packet, Firmware::V4_3).map(Self::Command),
            Direction::Reply => AnyReply::decode(packet, Firmware::V4_3).map(Self::Reply),
        }
        .unwrap_or_else(|error| panic!("{row}: {error}"))
    }

    fn name(&self) -> &'static str {
        match self {
            Self::Command(command) => command.opcode().name(),
            Self::Reply(reply) => reply.opcode().name(),
        }
    }

    fn encode(&self) -> Data {
        match self {
            Self::Command(command) => command.encode(),
            Self::Reply(reply) => reply.encode(),
        }
    }

    fn fields(&self) -> Map<String, Value> {
        let fields = match self {
            Self::Command(command) => command_fields(command),
            Self::Reply(reply) => reply_fields(reply),
        };
        match fields {
            Value::Object(fields) => fields,
            other => panic!("{other} is no object"),
        }
    }
}

/// What a command says, in the keys of the vectors.
fn command_fields(command: &AnyCommand) -> Value {
    use AnyCommand as C;
    match command {
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
        | C::ReadModel(_) => json!({}),
        C::FunctionControl(function) => {
            json!({"index": function.index(), "value": function.value()})
        }
        C::ReadPid(read) => json!({"index": read.index.raw()}),
        C::WritePidRam(write) => {
            json!({"index": write.index.raw(), "value": write.value.value()})
        }
        C::WritePidRom(write) => {
            json!({"index": write.index.raw(), "value": write.value.value()})
        }
        C::ReadAcceleration(read) => json!({"index": read.index.raw()}),
        C::WriteAcceleration(write) => json!({
            "index": write.index.raw(),
            "acceleration_dps2": write.acceleration.dps2(),
        }),
        C::SetEncoderZero(set) => json!({"offset_pulses": set.offset.raw()}),
        C::BusId(BusId::Read) => json!({"write": false}),
        C::BusId(BusId::Write(id)) => json!({"write": true, "motor_id": id.get()}),
        C::Torque(torque) => json!({"current_a": torque.current.amperes()}),
        C::Speed(speed) => json!({
            "max_torque_pct": speed.max_torque.percent(),
            "speed_dps": speed.speed.dps(),
        }),
        C::AbsolutePosition(go) => json!({
            "max_speed_dps": go.max_speed.dps(),
            "angle_deg": go.angle.degrees(),
        }),
        C::SingleTurnPosition(go) => json!({
            "direction": go.direction.name(),
            "max_speed_dps": go.max_speed.dps(),
            "angle_deg": go.angle.degrees(),
        }),
        C::IncrementalPosition(go) => json!({
            "max_speed_dps": go.max_speed.dps(),
            "angle_deg": go.angle.degrees(),
        }),
        C::ForcePosition(go) => json!({
            "max_torque_pct": go.max_torque.percent(),
            "max_speed_dps": go.max_speed.dps(),
            "angle_deg": go.angle.degrees(),
        }),
        C::CommunicationLossProtection(set) => json!({"timeout_ms": set.timeout.raw()}),
        C::SetBaudRate(set) => json!({"baud_code": set.baud_rate.raw()}),
        C::ActiveReply(report) => json!({
            "command": report.command.raw(),
            "enabled": report.enable.is_on(),
            "interval_ms": report.interval.millis(),
        }),
        C::Motion(raw) => {
            let wanted = MotionRanges::V4_3.set_point(raw);
            json!({
                "position_rad": wanted.position_rad,
                "velocity_rad_s": wanted.velocity_rad_s,
                "kp": wanted.kp,
                "kd": wanted.kd,
                "torque_nm": wanted.torque_nm,
            })
        }
    }
}

/// What a reply says, in the keys of the vectors.
fn reply_fields(reply: &AnyReply) -> Value {
    use AnyReply as R;
    match reply {
        R::FunctionControl(function) => command_fields(&(*function).into()),
        R::WritePidRam(write) => command_fields(&(*write).into()),
        R::WritePidRom(write) => command_fields(&(*write).into()),
        R::WriteAcceleration(write) => command_fields(&(*write).into()),
        R::SetEncoderZero(set) => command_fields(&(*set).into()),
        R::CommunicationLossProtection(set) => command_fields(&(*set).into()),
        R::ReleaseBrake(_) | R::LockBrake(_) | R::Shutdown(_) | R::Stop(_) => json!({}),
        R::ReadPid(gain) => json!({"index": gain.index.raw(), "value": gain.value.value()}),
        R::ReadAcceleration(reading) => json!({
            "index": reading.index.raw(),
            "acceleration_dps2": reading.acceleration.dps2(),
        }),
        R::ReadMultiTurnEncoder(encoder) => json!({"encoder_pulses": encoder.position.raw()}),
        R::ReadMultiTurnEncoderRaw(encoder) => json!({"raw_pulses": encoder.raw.raw()}),
        R::ReadMultiTurnEncoderOffset(zero) | R::SetCurrentPositionZero(zero) => {
            json!({"offset_pulses": zero.offset.raw()})
        }
        R::ReadRunningMode(running) => json!({"mode": running.mode.name()}),
        R::BusId(BusIdReply::Written(id)) => json!({"write": true, "motor_id": id.get()}),
        R::BusId(BusIdReply::OnCan(id) | BusIdReply::OnRs485(id)) => {
            json!({"write": false, "motor_id": id.get()})
        }
        R::ReadSingleTurnEncoder(encoder) => json!({
            "encoder_pulses": encoder.position.raw(),
            "raw_pulses": encoder.raw.raw(),
            "offset_pulses": encoder.offset.raw(),
        }),
        R::ReadMultiTurnAngle(reading) => json!({"angle_deg": reading.angle.degrees()}),
        R::ReadSingleTurnAngle(reading) => json!({"angle_deg": reading.angle.degrees()}),
        R::ReadStatus1(status) => {
            let errors: Vec<_> =
                status.errors.each().map(|e| e.name().unwrap_or("unknown")).collect();
            json!({
                "temperature_c": status.temperature.celsius(),
                "mos_temperature_c": status.mosfet_temperature.celsius(),
                "brake_released": status.brake.raw() == 1,
                "voltage_v": status.voltage.volts(),
                "errors": errors,
                "errors_raw": status.errors.bits(),
            })
        }
        R::ReadStatus2(feedback)
        | R::Torque(feedback)
        | R::Speed(feedback)
        | R::AbsolutePosition(feedback)
        | R::IncrementalPosition(feedback)
        | R::ForcePosition(feedback) => feedback_fields(feedback),
        R::ReadStatus3(status) => json!({
            "temperature_c": status.temperature.celsius(),
            "phase_a_current_a": status.phase_a.amperes(),
            "phase_b_current_a": status.phase_b.amperes(),
            "phase_c_current_a": status.phase_c.amperes(),
        }),
        R::SingleTurnPosition(feedback) => json!({
            "temperature_c": feedback.temperature.celsius(),
            "current_a": feedback.current.amperes(),
            "speed_dps": feedback.speed.dps(),
            "encoder_pulses": feedback.encoder.raw(),
        }),
        R::ReadRunTime(reading) => json!({"run_time_ms": reading.run_time.raw()}),
        R::ReadVersionDate(version) => json!({"version_date": version.date.raw()}),
        R::ReadModel(model) => json!({"model": model.name.as_str()}),
        R::Motion(raw) => {
            let measured = MotionRanges::V4_3.feedback(raw);
            json!({
                "motor_id": measured.id.get(),
                "position_rad": measured.position_rad,
                "velocity_rad_s": measured.velocity_rad_s,
                "torque_nm": measured.torque_nm,
            })
        }
    }
}

fn feedback_fields(feedback: &Feedback) -> Value {
    json!({
        "temperature_c": feedback.temperature.celsius(),
        "current_a": feedback.current.amperes(),
        "speed_dps": feedback.speed.dps(),
        "angle_deg": feedback.angle.degrees(),
    })
}

/// Compares numbers by value: whole ones exactly, others to 1e-5, as an `f32` keeps of a motion
/// scale 90 rad/s wide.
fn agree(expected: &Value, found: &Value) -> bool {
    match (expected, found) {
        (Value::Number(expected), Value::Number(found)) => {
            let (Some(a), Some(b)) = (expected.as_f64(), found.as_f64()) else { return false };
            if expected.is_f64() { (a - b).abs() <= 1e-5 * a.abs().max(1.0) } else { a == b }
        }
        _ => expected == found,
    }
}

fn assert_means(row: &Row, any: &Any) {
    assert_eq!(any.name(), row.name, "{row}");
    let found = any.fields();
    let keys = |fields: &Map<String, Value>| {
        let mut keys: Vec<_> = fields.keys().cloned().collect();
        keys.sort();
        keys
    };
    assert_eq!(keys(&found), keys(&row.fields), "{row}");
    for (key, expected) in &row.fields {
        let found = &found[key];
        assert!(agree(expected, found), "{row}: {key} is {expected}, found {found}");
    }
}

#[test]
fn all_examples_are_there() {
    let rows = rows();
    let count = |bus, motion: bool| {
        rows.iter().filter(|row| row.bus == bus && (row.name == "motion") == motion).count()
    };
    assert_eq!(count(Bus::Can, false), 99);
    assert_eq!(count(Bus::Rs485, false), 98);
    assert_eq!(count(Bus::Can, true), 2);
    assert_eq!(count(Bus::Rs485, true), 0);
}

#[test]
fn can_rows_decode_to_their_meaning_and_encode_to_their_bytes() {
    for row in rows().iter().filter(|row| row.bus == Bus::Can) {
        let (identifier, data) = row.can();
        let id = StandardId::new(identifier).expect("11 bits");
        let frame = can::SimpleFrame::new(id, &data).expect("eight bytes");
        let can::Received::Packet(packet) = can::decode(&frame) else {
            panic!("{row}: {:?}", can::decode(&frame))
        };
        assert_eq!(packet, Packet { channel: row.channel(), data }, "{row}");
        let any = Any::decode(row.direction, &packet, row);
        assert_means(row, &any);

        let packet = match &any {
            Any::Command(command) => command.packet(row.target()).expect("a packet"),
            Any::Reply(_) => Packet { channel: row.channel(), data: any.encode() },
        };
        let again: can::SimpleFrame = can::encode(&packet).expect("a frame");
        assert_eq!((again.id(), again.data()), (Id::Standard(id), &data[..]), "{row}");
        assert!(!again.is_remote_frame());
    }
}

#[test]
fn rs485_rows_decode_to_their_meaning_and_encode_to_their_bytes() {
    for row in rows().iter().filter(|row| row.bus == Bus::Rs485) {
        let bytes = row.rs485();
        let mut receiver = rs485::Receiver::new();
        let fed = bytes.map(|byte| receiver.feed(byte));
        assert!(fed[..12].iter().all(|fed| *fed == rs485::Fed::Wanting), "{row}: {fed:?}");
        let rs485::Fed::Frame(frame) = fed[12] else { panic!("{row}: {:?}", fed[12]) };
        let packet = match row.direction {
            Direction::Command => frame.as_command(),
            Direction::Reply => frame.as_reply().expect("a reply"),
        };
        assert_eq!(packet, Packet { channel: row.channel(), data: row.data() }, "{row}");
        let any = Any::decode(row.direction, &packet, row);
        assert_means(row, &any);

        let packet = Packet { channel: row.channel(), data: any.encode() };
        let again = rs485::Frame::from_packet(&packet).expect("a frame");
        assert_eq!(again.encode(), bytes, "{row}");
        if let Any::Command(command) = &any {
            assert_eq!(command.packet(row.target()), Ok(packet), "{row}");
        }
    }
}

#[test]
fn all_rs485_rows_behind_each_other_are_received_in_order() {
    let frames: Vec<[u8; 13]> =
        rows().iter().filter(|row| row.bus == Bus::Rs485).map(Row::rs485).collect();
    let line = Line::after(&frames.concat());
    assert_eq!(line.frames(), frames);
    assert_eq!(line.discarded(), 0);
}

#[test]
fn the_two_buses_have_the_same_examples() {
    let rows = rows();
    let twin_section = |section: &str| match section {
        "3.2" => "6.2".to_owned(),
        "4.4" => "7.4".to_owned(),
        same => same.to_owned(),
    };
    let key =
        |row: &Row| (twin_section(&row.section), row.example, row.direction, row.id.to_string());
    let mut alone = Vec::new();
    for can in rows.iter().filter(|row| row.bus == Bus::Can) {
        let twins: Vec<_> =
            rows.iter().filter(|row| row.bus == Bus::Rs485 && key(row) == key(can)).collect();
        let [twin] = twins[..] else {
            assert!(twins.is_empty(), "{can}: several RS485 rows");
            alone.push(can.section.as_str());
            continue;
        };
        assert_eq!((&can.name, &can.fields), (&twin.name, &twin.fields), "{can} and {twin}");
        // 4.4 tells the id as a reply identifier, 7.4 as the bare number.
        let told_apart = can.section == "4.4"
            && can.direction == Direction::Reply
            && can.fields["write"] == json!(false);
        assert_eq!(can.data() == twin.data(), !told_apart, "{can} and {twin}");
        if can.section == twin.section {
            assert_eq!(can.text, twin.text, "{can}");
            assert_eq!(can.misprint, twin.misprint, "{can}");
        }
    }
    assert_eq!(alone, ["2.34.4", "5.4", "5.4"], "CAN rows without an RS485 row");
}

#[test]
fn the_misprints_are_the_listed_ones() {
    let rows = rows();
    let found: Vec<_> = rows
        .iter()
        .filter(|row| row.misprint.is_some())
        .map(|row| {
            let id = row.id.as_str().map_or_else(|| row.id.to_string(), str::to_owned);
            (row.section.as_str(), row.example, row.bus, row.direction, id)
        })
        .collect();
    let listed: Vec<_> = MISPRINTS
        .iter()
        .map(|&(s, example, bus, d, id)| (s, example, bus, d, id.to_owned()))
        .collect();
    assert_eq!(found, listed);
}
