//! Proves, field by field, that every command and every reply lies on the bus as the manual's
//! layout tables say: a value with distinct bytes lands in exactly its bytes, nothing leaks into
//! its neighbours, NULL bytes are written 0 and not read.
//!
//! The tables below are the manual's (sections 2.x.2 and 2.x.3, 4, 5, 7), typed by hand with the
//! corrections that its misprints need: 2.9.2 prints `>>8` three times, 2.11.3 and 2.13.3 number the
//! formulas one too low, 2.20.2 and 2.24.2 print DATA[2] for maxTorque in DATA[1], and 4.3 and 7.3
//! print DATA[0] for DATA[1..=3].

use std::collections::BTreeSet;
use std::fmt::Debug;

use myactuator_protocol_core::command::Speed; // the command, not the quantity
use myactuator_protocol_core::command::*;
use myactuator_protocol_core::units::{self, *};
use myactuator_protocol_core::{AnyCommand, AnyReply, Data, DecodeError, MotorId, Opcode};

/// One layout table of the manual.
struct Layout<T> {
    opcode: Opcode,
    section: &'static str,
    /// Each field: its name, its first byte, how many bytes.
    places: &'static [(&'static str, usize, usize)],
    /// Every field 0, or the least that it allows.
    base: (T, Data),
    /// A field and a value for it, all others as in `base`; with the name "" several at once.
    cases: Vec<(&'static str, T, Data)>,
}

fn id(number: u8) -> MotorId {
    MotorId::new(number).expect("1 to 32")
}

fn u12(step: u16) -> U12 {
    U12::new(step).expect("at most 4095")
}

fn gain(bits: u32) -> Gain {
    Gain::new(f32::from_bits(bits)).expect("finite")
}

fn acceleration(raw: u32) -> Acceleration {
    Acceleration::try_from_raw(raw).expect("100 to 60000, or 0")
}

fn target(raw: u16) -> SingleTurnTarget {
    SingleTurnTarget::try_from_raw(raw).expect("0 to 36000")
}

fn circle(raw: u16) -> SingleTurnAngle {
    SingleTurnAngle::try_from_raw(raw).expect("0 to 35999")
}

/// All bits of a signed number, so that distinct bytes can be written down as they are.
const fn i32_of(bits: u32) -> i32 {
    bits as i32
}

const fn i16_of(bits: u16) -> i16 {
    bits as i16
}

const fn i8_of(bits: u8) -> i8 {
    bits as i8
}

/// A command that is nothing but its byte.
fn bare(
    opcode: Opcode,
    section: &'static str,
    command: impl Into<AnyCommand>,
    byte: u8,
) -> Layout<AnyCommand> {
    let base = (command.into(), [byte, 0, 0, 0, 0, 0, 0, 0]);
    Layout { opcode, section, places: &[], base, cases: vec![] }
}

fn commands() -> Vec<Layout<AnyCommand>> {
    const INDEX: (&str, usize, usize) = ("index", 1, 1);
    const VALUE: (&str, usize, usize) = ("value", 4, 4);
    let mut all = vec![
        bare(Opcode::ReadMultiTurnEncoder, "2.6.2", ReadMultiTurnEncoder, 0x60),
        bare(Opcode::ReadMultiTurnEncoderRaw, "2.7.2", ReadMultiTurnEncoderRaw, 0x61),
        bare(Opcode::ReadMultiTurnEncoderOffset, "2.8.2", ReadMultiTurnEncoderOffset, 0x62),
        bare(Opcode::SetCurrentPositionZero, "2.10.2", SetCurrentPositionZero, 0x64),
        bare(Opcode::ReadSingleTurnEncoder, "2.11.2", ReadSingleTurnEncoder, 0x90),
        bare(Opcode::ReadMultiTurnAngle, "2.12.2", ReadMultiTurnAngle, 0x92),
        bare(Opcode::ReadSingleTurnAngle, "2.13.2", ReadSingleTurnAngle, 0x94),
        bare(Opcode::ReadStatus1, "2.14.2", ReadStatus1, 0x9A),
        bare(Opcode::ReadStatus2, "2.15.2", ReadStatus2, 0x9C),
        bare(Opcode::ReadStatus3, "2.16.2", ReadStatus3, 0x9D),
        bare(Opcode::Shutdown, "2.17.2", Shutdown, 0x80),
        bare(Opcode::Stop, "2.18.2", Stop, 0x81),
        bare(Opcode::ReadRunningMode, "2.25.2", ReadRunningMode, 0x70),
        bare(Opcode::Reset, "2.26.2", Reset, 0x76),
        bare(Opcode::ReleaseBrake, "2.27.2", ReleaseBrake, 0x77),
        bare(Opcode::LockBrake, "2.28.2", LockBrake, 0x78),
        bare(Opcode::ReadRunTime, "2.29.2", ReadRunTime, 0xB1),
        bare(Opcode::ReadVersionDate, "2.30.2", ReadVersionDate, 0xB2),
        bare(Opcode::ReadModel, "2.33.2", ReadModel, 0xB5),
    ];

    let read = |index| AnyCommand::from(ReadPid { index });
    all.push(Layout {
        opcode: Opcode::ReadPid,
        section: "2.1.2",
        places: &[INDEX],
        base: (read(PidIndex::from_raw(0)), [0x30, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("index", read(PidIndex::POSITION_KD), [0x30, 0x09, 0, 0, 0, 0, 0, 0]),
            ("index", read(PidIndex::from_raw(0xFE)), [0x30, 0xFE, 0, 0, 0, 0, 0, 0]),
        ],
    });
    // 0x44332211 and 0x81828384 are the floats 716.53 and -4.8e-38.
    let write = |index, bits| AnyCommand::from(WritePidRam { index, value: gain(bits) });
    all.push(Layout {
        opcode: Opcode::WritePidRam,
        section: "2.2.2",
        places: &[INDEX, VALUE],
        base: (write(PidIndex::from_raw(0), 0), [0x31, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("index", write(PidIndex::SPEED_KI, 0), [0x31, 0x05, 0, 0, 0, 0, 0, 0]),
            (
                "value",
                write(PidIndex::from_raw(0), 0x4433_2211),
                [0x31, 0, 0, 0, 0x11, 0x22, 0x33, 0x44],
            ),
            (
                "value",
                write(PidIndex::from_raw(0), 0x8182_8384),
                [0x31, 0, 0, 0, 0x84, 0x83, 0x82, 0x81],
            ),
            (
                "",
                write(PidIndex::CURRENT_KI, 0x4433_2211),
                [0x31, 0x02, 0, 0, 0x11, 0x22, 0x33, 0x44],
            ),
        ],
    });
    let write = |index, bits| AnyCommand::from(WritePidRom { index, value: gain(bits) });
    all.push(Layout {
        opcode: Opcode::WritePidRom,
        section: "2.3.2",
        places: &[INDEX, VALUE],
        base: (write(PidIndex::from_raw(0), 0), [0x32, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("index", write(PidIndex::POSITION_KP, 0), [0x32, 0x07, 0, 0, 0, 0, 0, 0]),
            (
                "value",
                write(PidIndex::from_raw(0), 0x4433_2211),
                [0x32, 0, 0, 0, 0x11, 0x22, 0x33, 0x44],
            ),
            (
                "",
                write(PidIndex::SPEED_KP, 0x8182_8384),
                [0x32, 0x04, 0, 0, 0x84, 0x83, 0x82, 0x81],
            ),
        ],
    });
    let read = |index| AnyCommand::from(ReadAcceleration { index });
    all.push(Layout {
        opcode: Opcode::ReadAcceleration,
        section: "2.4.2",
        places: &[INDEX],
        base: (read(AccelerationIndex::POSITION_ACCELERATION), [0x42, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("index", read(AccelerationIndex::SPEED_DECELERATION), [0x42, 3, 0, 0, 0, 0, 0, 0]),
            ("index", read(AccelerationIndex::from_raw(0xA5)), [0x42, 0xA5, 0, 0, 0, 0, 0, 0]),
        ],
    });
    let write =
        |index, raw| AnyCommand::from(WriteAcceleration { index, acceleration: acceleration(raw) });
    // 60000 is 0xEA60: the upper two bytes of a valid acceleration are always 0.
    all.push(Layout {
        opcode: Opcode::WriteAcceleration,
        section: "2.5.2",
        places: &[INDEX, ("acceleration", 4, 4)],
        base: (write(AccelerationIndex::POSITION_ACCELERATION, 0), [0x43, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("index", write(AccelerationIndex::SPEED_ACCELERATION, 0), [0x43, 2, 0, 0, 0, 0, 0, 0]),
            (
                "acceleration",
                write(AccelerationIndex::POSITION_ACCELERATION, 60_000),
                [0x43, 0, 0, 0, 0x60, 0xEA, 0, 0],
            ),
            (
                "acceleration",
                write(AccelerationIndex::POSITION_ACCELERATION, 100),
                [0x43, 0, 0, 0, 0x64, 0, 0, 0],
            ),
            (
                "",
                write(AccelerationIndex::POSITION_DECELERATION, 0x1234),
                [0x43, 1, 0, 0, 0x34, 0x12, 0, 0],
            ),
        ],
    });
    let set =
        |bits| AnyCommand::from(SetEncoderZero { offset: EncoderPulses::from_raw(i32_of(bits)) });
    all.push(Layout {
        opcode: Opcode::SetEncoderZero,
        section: "2.9.2",
        places: &[("offset", 4, 4)],
        base: (set(0), [0x63, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("offset", set(0x0403_0201), [0x63, 0, 0, 0, 1, 2, 3, 4]),
            ("offset", set(0x8182_8384), [0x63, 0, 0, 0, 0x84, 0x83, 0x82, 0x81]),
        ],
    });
    all.push(Layout {
        opcode: Opcode::BusId,
        section: "4.2",
        places: &[("flag", 2, 1), ("id", 7, 1)],
        base: (BusId::Write(id(1)).into(), [0x79, 0, 0, 0, 0, 0, 0, 1]),
        cases: vec![
            ("id", BusId::Write(id(0x1E)).into(), [0x79, 0, 0, 0, 0, 0, 0, 0x1E]),
            ("", BusId::Read.into(), [0x79, 0, 1, 0, 0, 0, 0, 0]),
        ],
    });
    let torque = |bits| AnyCommand::from(Torque { current: Current::from_raw(i16_of(bits)) });
    all.push(Layout {
        opcode: Opcode::Torque,
        section: "2.19.2",
        places: &[("current", 4, 2)],
        base: (torque(0), [0xA1, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("current", torque(0x0102), [0xA1, 0, 0, 0, 2, 1, 0, 0]),
            ("current", torque(0x8182), [0xA1, 0, 0, 0, 0x82, 0x81, 0, 0]),
        ],
    });
    let speed = |max, bits| {
        AnyCommand::from(Speed {
            max_torque: MaxTorque::from_raw(max),
            speed: SpeedTarget::from_raw(i32_of(bits)),
        })
    };
    all.push(Layout {
        opcode: Opcode::Speed,
        section: "2.20.2",
        places: &[("max_torque", 1, 1), ("speed", 4, 4)],
        base: (speed(0, 0), [0xA2, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("max_torque", speed(0xFD, 0), [0xA2, 0xFD, 0, 0, 0, 0, 0, 0]),
            ("speed", speed(0, 0x0403_0201), [0xA2, 0, 0, 0, 1, 2, 3, 4]),
            ("", speed(5, 0x8182_8384), [0xA2, 5, 0, 0, 0x84, 0x83, 0x82, 0x81]),
        ],
    });
    let go = |max, bits| {
        AnyCommand::from(AbsolutePosition {
            max_speed: MaxSpeed::from_raw(max),
            angle: Angle::from_raw(i32_of(bits)),
        })
    };
    all.push(Layout {
        opcode: Opcode::AbsolutePosition,
        section: "2.21.2",
        places: &[("max_speed", 2, 2), ("angle", 4, 4)],
        base: (go(0, 0), [0xA4, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("max_speed", go(0xF1F2, 0), [0xA4, 0, 0xF2, 0xF1, 0, 0, 0, 0]),
            ("angle", go(0, 0x0403_0201), [0xA4, 0, 0, 0, 1, 2, 3, 4]),
            ("", go(0x1516, 0x8182_8384), [0xA4, 0, 0x16, 0x15, 0x84, 0x83, 0x82, 0x81]),
        ],
    });
    let go = |direction, max, angle| {
        AnyCommand::from(SingleTurnPosition {
            direction,
            max_speed: MaxSpeed::from_raw(max),
            angle: target(angle),
        })
    };
    all.push(Layout {
        opcode: Opcode::SingleTurnPosition,
        section: "2.22.2",
        places: &[("direction", 1, 1), ("max_speed", 2, 2), ("angle", 4, 2)],
        base: (go(Direction::CLOCKWISE, 0, 0), [0xA6, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("direction", go(Direction::COUNTER_CLOCKWISE, 0, 0), [0xA6, 1, 0, 0, 0, 0, 0, 0]),
            ("direction", go(Direction::from_raw(0xFE), 0, 0), [0xA6, 0xFE, 0, 0, 0, 0, 0, 0]),
            ("max_speed", go(Direction::CLOCKWISE, 0xF1F2, 0), [0xA6, 0, 0xF2, 0xF1, 0, 0, 0, 0]),
            ("angle", go(Direction::CLOCKWISE, 0, 0x8182), [0xA6, 0, 0, 0, 0x82, 0x81, 0, 0]),
            ("angle", go(Direction::CLOCKWISE, 0, 36_000), [0xA6, 0, 0, 0, 0xA0, 0x8C, 0, 0]),
            (
                "",
                go(Direction::COUNTER_CLOCKWISE, 0x1516, 0x0203),
                [0xA6, 1, 0x16, 0x15, 3, 2, 0, 0],
            ),
        ],
    });
    let go = |max, bits| {
        AnyCommand::from(IncrementalPosition {
            max_speed: MaxSpeed::from_raw(max),
            angle: Angle::from_raw(i32_of(bits)),
        })
    };
    all.push(Layout {
        opcode: Opcode::IncrementalPosition,
        section: "2.23.2",
        places: &[("max_speed", 2, 2), ("angle", 4, 4)],
        base: (go(0, 0), [0xA8, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("max_speed", go(0xF1F2, 0), [0xA8, 0, 0xF2, 0xF1, 0, 0, 0, 0]),
            ("angle", go(0, 0x0403_0201), [0xA8, 0, 0, 0, 1, 2, 3, 4]),
            ("", go(0x1516, 0x8182_8384), [0xA8, 0, 0x16, 0x15, 0x84, 0x83, 0x82, 0x81]),
        ],
    });
    let go = |torque, max, bits| {
        AnyCommand::from(ForcePosition {
            max_torque: MaxTorque::from_raw(torque),
            max_speed: MaxSpeed::from_raw(max),
            angle: Angle::from_raw(i32_of(bits)),
        })
    };
    all.push(Layout {
        opcode: Opcode::ForcePosition,
        section: "2.24.2",
        places: &[("max_torque", 1, 1), ("max_speed", 2, 2), ("angle", 4, 4)],
        base: (go(0, 0, 0), [0xA9, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("max_torque", go(0xFD, 0, 0), [0xA9, 0xFD, 0, 0, 0, 0, 0, 0]),
            ("max_speed", go(0, 0xF1F2, 0), [0xA9, 0, 0xF2, 0xF1, 0, 0, 0, 0]),
            ("angle", go(0, 0, 0x0403_0201), [0xA9, 0, 0, 0, 1, 2, 3, 4]),
            ("", go(0x17, 0x1516, 0x8182_8384), [0xA9, 0x17, 0x16, 0x15, 0x84, 0x83, 0x82, 0x81]),
        ],
    });
    let set = |raw| {
        AnyCommand::from(CommunicationLossProtection { timeout: Milliseconds::from_raw(raw) })
    };
    all.push(Layout {
        opcode: Opcode::CommunicationLossProtection,
        section: "2.31.2",
        places: &[("timeout", 4, 4)],
        base: (set(0), [0xB3, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("timeout", set(0x0403_0201), [0xB3, 0, 0, 0, 1, 2, 3, 4]),
            ("timeout", set(0x8182_8384), [0xB3, 0, 0, 0, 0x84, 0x83, 0x82, 0x81]),
        ],
    });
    let set = |baud_rate| AnyCommand::from(SetBaudRate { baud_rate });
    all.push(Layout {
        opcode: Opcode::SetBaudRate,
        section: "2.32.2",
        places: &[("baud_rate", 7, 1)],
        base: (set(BaudCode::CAN_500K_RS485_115200), [0xB4, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("baud_rate", set(BaudCode::RS485_1M), [0xB4, 0, 0, 0, 0, 0, 0, 2]),
            ("baud_rate", set(BaudCode::from_raw(0xFE)), [0xB4, 0, 0, 0, 0, 0, 0, 0xFE]),
        ],
    });
    let report = |command, enable, raw| {
        AnyCommand::from(ActiveReply { command, enable, interval: ReportInterval::from_raw(raw) })
    };
    let nothing = ReportedCommand::from_raw(0);
    all.push(Layout {
        opcode: Opcode::ActiveReply,
        section: "2.34.2",
        places: &[("command", 1, 1), ("enable", 2, 1), ("interval", 3, 2)],
        base: (report(nothing, Switch::Off, 0), [0xB6, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            (
                "command",
                report(ReportedCommand::of(Opcode::ReadStatus3).unwrap(), Switch::Off, 0),
                [0xB6, 0x9D, 0, 0, 0, 0, 0, 0],
            ),
            ("enable", report(nothing, Switch::On, 0), [0xB6, 0, 1, 0, 0, 0, 0, 0]),
            ("interval", report(nothing, Switch::Off, 0xF1F2), [0xB6, 0, 0, 0xF2, 0xF1, 0, 0, 0]),
            (
                "",
                report(
                    ReportedCommand::of(Opcode::ReadMultiTurnAngle).unwrap(),
                    Switch::On,
                    0x0203,
                ),
                [0xB6, 0x92, 1, 3, 2, 0, 0, 0],
            ),
        ],
    });
    all.push(Layout {
        opcode: Opcode::FunctionControl,
        section: "2.35.2",
        places: &[INDEX, VALUE],
        base: (FunctionControl::Unknown { index: 0, value: 0 }.into(), [0x20, 0, 0, 0, 0, 0, 0, 0]),
        cases: function_cases().into_iter().map(|(f, case, data)| (f, case.into(), data)).collect(),
    });
    let motion = |position, [velocity, kp, kd, torque]: [u16; 4]| {
        AnyCommand::from(RawMotion {
            position,
            velocity: u12(velocity),
            kp: u12(kp),
            kd: u12(kd),
            torque: u12(torque),
        })
    };
    all.push(Layout {
        opcode: Opcode::Motion,
        section: "5.2",
        places: &[
            ("position", 0, 2),
            ("velocity", 2, 2),
            ("kp", 3, 2),
            ("kd", 5, 2),
            ("torque", 6, 2),
        ],
        base: (motion(0, [0; 4]), [0; 8]),
        cases: vec![
            ("position", motion(0xF1F2, [0; 4]), [0xF1, 0xF2, 0, 0, 0, 0, 0, 0]),
            ("velocity", motion(0, [0xABC, 0, 0, 0]), [0, 0, 0xAB, 0xC0, 0, 0, 0, 0]),
            ("kp", motion(0, [0, 0xABC, 0, 0]), [0, 0, 0, 0x0A, 0xBC, 0, 0, 0]),
            ("kd", motion(0, [0, 0, 0xABC, 0]), [0, 0, 0, 0, 0, 0xAB, 0xC0, 0]),
            ("torque", motion(0, [0, 0, 0, 0xABC]), [0, 0, 0, 0, 0, 0, 0x0A, 0xBC]),
            (
                "",
                motion(0x1234, [0x567, 0x89A, 0xBCD, 0xEF0]),
                [0x12, 0x34, 0x56, 0x78, 0x9A, 0xBC, 0xDE, 0xF0],
            ),
        ],
    });
    all
}

/// 2.35.4: index and value of each function.
fn function_cases() -> Vec<(&'static str, FunctionControl, Data)> {
    use FunctionControl as F;
    vec![
        ("index", F::Unknown { index: 0xA5, value: 0 }, [0x20, 0xA5, 0, 0, 0, 0, 0, 0]),
        ("value", F::Unknown { index: 0, value: 0x0403_0201 }, [0x20, 0, 0, 0, 1, 2, 3, 4]),
        ("", F::Unknown { index: 8, value: 0x8182_8384 }, [0x20, 8, 0, 0, 0x84, 0x83, 0x82, 0x81]),
        ("", F::ClearMultiTurn, [0x20, 1, 0, 0, 0, 0, 0, 0]),
        ("", F::CanIdFilter(Switch::Off), [0x20, 2, 0, 0, 0, 0, 0, 0]),
        ("", F::CanIdFilter(Switch::On), [0x20, 2, 0, 0, 1, 0, 0, 0]),
        ("", F::ErrorReporting(Switch::Off), [0x20, 3, 0, 0, 0, 0, 0, 0]),
        ("", F::ErrorReporting(Switch::On), [0x20, 3, 0, 0, 1, 0, 0, 0]),
        ("", F::SaveMultiTurn(Switch::Off), [0x20, 4, 0, 0, 0, 0, 0, 0]),
        ("", F::SaveMultiTurn(Switch::On), [0x20, 4, 0, 0, 1, 0, 0, 0]),
        ("", F::SetCanId(id(0x1E)), [0x20, 5, 0, 0, 0x1E, 0, 0, 0]),
        ("", F::MaxPositiveAngle(0x0403_0201), [0x20, 6, 0, 0, 1, 2, 3, 4]),
        ("", F::MaxNegativeAngle(i32_of(0x8182_8384)), [0x20, 7, 0, 0, 0x84, 0x83, 0x82, 0x81]),
    ]
}

/// The replies that the manual calls the same as their command: 2.2.3, 2.3.3, 2.5.3, 2.9.3, 2.17.3,
/// 2.18.3, 2.27.3, 2.28.3, 2.31.3, 2.35.3.
fn echo(command: &AnyCommand) -> Option<AnyReply> {
    Some(match *command {
        AnyCommand::WritePidRam(same) => AnyReply::WritePidRam(same),
        AnyCommand::WritePidRom(same) => AnyReply::WritePidRom(same),
        AnyCommand::WriteAcceleration(same) => AnyReply::WriteAcceleration(same),
        AnyCommand::SetEncoderZero(same) => AnyReply::SetEncoderZero(same),
        AnyCommand::Shutdown(same) => AnyReply::Shutdown(same),
        AnyCommand::Stop(same) => AnyReply::Stop(same),
        AnyCommand::ReleaseBrake(same) => AnyReply::ReleaseBrake(same),
        AnyCommand::LockBrake(same) => AnyReply::LockBrake(same),
        AnyCommand::CommunicationLossProtection(same) => {
            AnyReply::CommunicationLossProtection(same)
        }
        AnyCommand::FunctionControl(same) => AnyReply::FunctionControl(same),
        _ => return None,
    })
}

/// 2.15.3, 2.19.3, 2.20.3, 2.21.3, 2.23.3, 2.24.3: the same table six times.
fn feedback(
    opcode: Opcode,
    section: &'static str,
    byte: u8,
    wrap: fn(Feedback) -> AnyReply,
) -> Layout<AnyReply> {
    let of = |temperature, current, speed, angle| {
        wrap(Feedback {
            temperature: Temperature::from_raw(i8_of(temperature)),
            current: Current::from_raw(i16_of(current)),
            speed: units::CoarseSpeed::from_raw(i16_of(speed)),
            angle: CoarseAngle::from_raw(i16_of(angle)),
        })
    };
    Layout {
        opcode,
        section,
        places: &[("temperature", 1, 1), ("current", 2, 2), ("speed", 4, 2), ("angle", 6, 2)],
        base: (of(0, 0, 0, 0), [byte, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("temperature", of(0xF1, 0, 0, 0), [byte, 0xF1, 0, 0, 0, 0, 0, 0]),
            ("current", of(0, 0x8182, 0, 0), [byte, 0, 0x82, 0x81, 0, 0, 0, 0]),
            ("speed", of(0, 0, 0x8384, 0), [byte, 0, 0, 0, 0x84, 0x83, 0, 0]),
            ("angle", of(0, 0, 0, 0x8586), [byte, 0, 0, 0, 0, 0, 0x86, 0x85]),
            (
                "",
                of(0x11, 0x2223, 0x3334, 0x4445),
                [byte, 0x11, 0x23, 0x22, 0x34, 0x33, 0x45, 0x44],
            ),
        ],
    }
}

/// A signed 32-bit number in DATA[4..8].
fn pulses(
    opcode: Opcode,
    section: &'static str,
    byte: u8,
    wrap: fn(EncoderPulses) -> AnyReply,
) -> Layout<AnyReply> {
    let of = |bits| wrap(EncoderPulses::from_raw(i32_of(bits)));
    Layout {
        opcode,
        section,
        places: &[("pulses", 4, 4)],
        base: (of(0), [byte, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("pulses", of(0x0403_0201), [byte, 0, 0, 0, 1, 2, 3, 4]),
            ("pulses", of(0x8182_8384), [byte, 0, 0, 0, 0x84, 0x83, 0x82, 0x81]),
        ],
    }
}

fn replies() -> Vec<Layout<AnyReply>> {
    use AnyReply as R;
    let mut all: Vec<Layout<AnyReply>> = commands()
        .into_iter()
        .filter_map(|command| {
            let (base, data) = command.base;
            let base = (echo(&base)?, data);
            let same = |(field, case, data)| (field, echo(&case).expect("an echo"), data);
            let cases = command.cases.into_iter().map(same).collect();
            let Layout { opcode, section, places, .. } = command;
            Some(Layout { opcode, section, places, base, cases })
        })
        .collect();
    assert_eq!(all.len(), 10, "kinds whose reply is the same as the command");

    all.extend([
        feedback(Opcode::ReadStatus2, "2.15.3", 0x9C, R::ReadStatus2),
        feedback(Opcode::Torque, "2.19.3", 0xA1, R::Torque),
        feedback(Opcode::Speed, "2.20.3", 0xA2, R::Speed),
        feedback(Opcode::AbsolutePosition, "2.21.3", 0xA4, R::AbsolutePosition),
        feedback(Opcode::IncrementalPosition, "2.23.3", 0xA8, R::IncrementalPosition),
        feedback(Opcode::ForcePosition, "2.24.3", 0xA9, R::ForcePosition),
        pulses(Opcode::ReadMultiTurnEncoder, "2.6.3", 0x60, |position| {
            R::ReadMultiTurnEncoder(MultiTurnEncoder { position })
        }),
        pulses(Opcode::ReadMultiTurnEncoderRaw, "2.7.3", 0x61, |raw| {
            R::ReadMultiTurnEncoderRaw(MultiTurnEncoderRaw { raw })
        }),
        pulses(Opcode::ReadMultiTurnEncoderOffset, "2.8.3", 0x62, |offset| {
            R::ReadMultiTurnEncoderOffset(MultiTurnEncoderOffset { offset })
        }),
        pulses(Opcode::SetCurrentPositionZero, "2.10.3", 0x64, |offset| {
            R::SetCurrentPositionZero(MultiTurnEncoderOffset { offset })
        }),
    ]);

    let pid = |index, bits| R::ReadPid(PidGain { index, value: gain(bits) });
    all.push(Layout {
        opcode: Opcode::ReadPid,
        section: "2.1.3",
        places: &[("index", 1, 1), ("value", 4, 4)],
        base: (pid(PidIndex::from_raw(0), 0), [0x30, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("index", pid(PidIndex::POSITION_KI, 0), [0x30, 8, 0, 0, 0, 0, 0, 0]),
            (
                "value",
                pid(PidIndex::from_raw(0), 0x4433_2211),
                [0x30, 0, 0, 0, 0x11, 0x22, 0x33, 0x44],
            ),
            ("", pid(PidIndex::CURRENT_KP, 0x8182_8384), [0x30, 1, 0, 0, 0x84, 0x83, 0x82, 0x81]),
        ],
    });
    let reading = |index, raw| {
        R::ReadAcceleration(AccelerationReading {
            index,
            acceleration: ReportedAcceleration::from_raw(raw),
        })
    };
    all.push(Layout {
        opcode: Opcode::ReadAcceleration,
        section: "2.4.3",
        places: &[("index", 1, 1), ("acceleration", 4, 4)],
        base: (reading(AccelerationIndex::POSITION_ACCELERATION, 0), [0x42, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            (
                "index",
                reading(AccelerationIndex::SPEED_DECELERATION, 0),
                [0x42, 3, 0, 0, 0, 0, 0, 0],
            ),
            (
                "acceleration",
                reading(AccelerationIndex::POSITION_ACCELERATION, 0x0403_0201),
                [0x42, 0, 0, 0, 1, 2, 3, 4],
            ),
            (
                "",
                reading(AccelerationIndex::SPEED_ACCELERATION, 0x8182_8384),
                [0x42, 2, 0, 0, 0x84, 0x83, 0x82, 0x81],
            ),
        ],
    });
    let single = |position, raw, offset| {
        R::ReadSingleTurnEncoder(SingleTurnEncoder {
            position: SingleTurnPulses::from_raw(position),
            raw: SingleTurnPulses::from_raw(raw),
            offset: SingleTurnPulses::from_raw(offset),
        })
    };
    all.push(Layout {
        opcode: Opcode::ReadSingleTurnEncoder,
        section: "2.11.3",
        places: &[("position", 2, 2), ("raw", 4, 2), ("offset", 6, 2)],
        base: (single(0, 0, 0), [0x90, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("position", single(0x8182, 0, 0), [0x90, 0, 0x82, 0x81, 0, 0, 0, 0]),
            ("raw", single(0, 0x8384, 0), [0x90, 0, 0, 0, 0x84, 0x83, 0, 0]),
            ("offset", single(0, 0, 0x8586), [0x90, 0, 0, 0, 0, 0, 0x86, 0x85]),
            ("", single(0x0203, 0x0405, 0x0607), [0x90, 0, 3, 2, 5, 4, 7, 6]),
        ],
    });
    let angle =
        |bits| R::ReadMultiTurnAngle(MultiTurnAngle { angle: Angle::from_raw(i32_of(bits)) });
    all.push(Layout {
        opcode: Opcode::ReadMultiTurnAngle,
        section: "2.12.3",
        places: &[("angle", 4, 4)],
        base: (angle(0), [0x92, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("angle", angle(0x0403_0201), [0x92, 0, 0, 0, 1, 2, 3, 4]),
            ("angle", angle(0x8182_8384), [0x92, 0, 0, 0, 0x84, 0x83, 0x82, 0x81]),
        ],
    });
    let angle = |raw| R::ReadSingleTurnAngle(SingleTurnAngle { angle: circle(raw) });
    all.push(Layout {
        opcode: Opcode::ReadSingleTurnAngle,
        section: "2.13.3",
        places: &[("angle", 6, 2)],
        base: (angle(0), [0x94, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("angle", angle(0x8182), [0x94, 0, 0, 0, 0, 0, 0x82, 0x81]),
            ("angle", angle(35_999), [0x94, 0, 0, 0, 0, 0, 0x9F, 0x8C]),
        ],
    });
    let status = |temperature, mos, brake, voltage, errors| {
        R::ReadStatus1(Status1 {
            temperature: Temperature::from_raw(i8_of(temperature)),
            mosfet_temperature: Temperature::from_raw(i8_of(mos)),
            brake,
            voltage: Voltage::from_raw(voltage),
            errors: ErrorFlags::from_bits_retain(errors),
        })
    };
    let lock = BrakeCommand::LOCK;
    all.push(Layout {
        opcode: Opcode::ReadStatus1,
        section: "2.14.3",
        places: &[
            ("temperature", 1, 1),
            ("mos_temperature", 2, 1),
            ("brake", 3, 1),
            ("voltage", 4, 2),
            ("errors", 6, 2),
        ],
        base: (status(0, 0, lock, 0, 0), [0x9A, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("temperature", status(0xF1, 0, lock, 0, 0), [0x9A, 0xF1, 0, 0, 0, 0, 0, 0]),
            ("mos_temperature", status(0, 0xF2, lock, 0, 0), [0x9A, 0, 0xF2, 0, 0, 0, 0, 0]),
            ("brake", status(0, 0, BrakeCommand::RELEASE, 0, 0), [0x9A, 0, 0, 1, 0, 0, 0, 0]),
            (
                "brake",
                status(0, 0, BrakeCommand::from_raw(0xF3), 0, 0),
                [0x9A, 0, 0, 0xF3, 0, 0, 0, 0],
            ),
            ("voltage", status(0, 0, lock, 0x8182, 0), [0x9A, 0, 0, 0, 0x82, 0x81, 0, 0]),
            ("errors", status(0, 0, lock, 0, 0x8384), [0x9A, 0, 0, 0, 0, 0, 0x84, 0x83]),
            ("", status(1, 2, BrakeCommand::RELEASE, 0x0405, 0x0607), [0x9A, 1, 2, 1, 5, 4, 7, 6]),
        ],
    });
    let status = |temperature, a, b, c| {
        R::ReadStatus3(Status3 {
            temperature: Temperature::from_raw(i8_of(temperature)),
            phase_a: Current::from_raw(i16_of(a)),
            phase_b: Current::from_raw(i16_of(b)),
            phase_c: Current::from_raw(i16_of(c)),
        })
    };
    all.push(Layout {
        opcode: Opcode::ReadStatus3,
        section: "2.16.3",
        places: &[("temperature", 1, 1), ("phase_a", 2, 2), ("phase_b", 4, 2), ("phase_c", 6, 2)],
        base: (status(0, 0, 0, 0), [0x9D, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("temperature", status(0xF1, 0, 0, 0), [0x9D, 0xF1, 0, 0, 0, 0, 0, 0]),
            ("phase_a", status(0, 0x8182, 0, 0), [0x9D, 0, 0x82, 0x81, 0, 0, 0, 0]),
            ("phase_b", status(0, 0, 0x8384, 0), [0x9D, 0, 0, 0, 0x84, 0x83, 0, 0]),
            ("phase_c", status(0, 0, 0, 0x8586), [0x9D, 0, 0, 0, 0, 0, 0x86, 0x85]),
            ("", status(1, 0x0203, 0x0405, 0x0607), [0x9D, 1, 3, 2, 5, 4, 7, 6]),
        ],
    });
    let single = |temperature, current, speed, encoder| {
        R::SingleTurnPosition(SingleTurnFeedback {
            temperature: Temperature::from_raw(i8_of(temperature)),
            current: Current::from_raw(i16_of(current)),
            speed: units::CoarseSpeed::from_raw(i16_of(speed)),
            encoder: SingleTurnPulses::from_raw(encoder),
        })
    };
    all.push(Layout {
        opcode: Opcode::SingleTurnPosition,
        section: "2.22.3",
        places: &[("temperature", 1, 1), ("current", 2, 2), ("speed", 4, 2), ("encoder", 6, 2)],
        base: (single(0, 0, 0, 0), [0xA6, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("temperature", single(0xF1, 0, 0, 0), [0xA6, 0xF1, 0, 0, 0, 0, 0, 0]),
            ("current", single(0, 0x8182, 0, 0), [0xA6, 0, 0x82, 0x81, 0, 0, 0, 0]),
            ("speed", single(0, 0, 0x8384, 0), [0xA6, 0, 0, 0, 0x84, 0x83, 0, 0]),
            ("encoder", single(0, 0, 0, 0x8586), [0xA6, 0, 0, 0, 0, 0, 0x86, 0x85]),
            ("", single(1, 0x0203, 0x0405, 0x0607), [0xA6, 1, 3, 2, 5, 4, 7, 6]),
        ],
    });
    let running = |mode| R::ReadRunningMode(RunningMode { mode });
    all.push(Layout {
        opcode: Opcode::ReadRunningMode,
        section: "2.25.3",
        places: &[("mode", 7, 1)],
        base: (running(Mode::from_raw(0)), [0x70, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("mode", running(Mode::SPEED), [0x70, 0, 0, 0, 0, 0, 0, 2]),
            ("mode", running(Mode::from_raw(0xFE)), [0x70, 0, 0, 0, 0, 0, 0, 0xFE]),
        ],
    });
    let time = |raw| R::ReadRunTime(RunTime { run_time: Milliseconds::from_raw(raw) });
    all.push(Layout {
        opcode: Opcode::ReadRunTime,
        section: "2.29.3",
        places: &[("run_time", 4, 4)],
        base: (time(0), [0xB1, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![("run_time", time(0x8182_8384), [0xB1, 0, 0, 0, 0x84, 0x83, 0x82, 0x81])],
    });
    let date = |raw| R::ReadVersionDate(Version { date: VersionDate::from_raw(raw) });
    all.push(Layout {
        opcode: Opcode::ReadVersionDate,
        section: "2.30.3",
        places: &[("date", 4, 4)],
        base: (date(0), [0xB2, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![("date", date(0x8182_8384), [0xB2, 0, 0, 0, 0x84, 0x83, 0x82, 0x81])],
    });
    let model = |name| R::ReadModel(Model { name: ModelName::from_bytes(name) });
    all.push(Layout {
        opcode: Opcode::ReadModel,
        section: "2.33.3",
        places: &[("name", 1, 7)],
        base: (model([0; 7]), [0xB5, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("name", model(*b"ABCDEFG"), [0xB5, 0x41, 0x42, 0x43, 0x44, 0x45, 0x46, 0x47]),
            ("name", model([1, 2, 3, 4, 5, 6, 0xFF]), [0xB5, 1, 2, 3, 4, 5, 6, 0xFF]),
        ],
    });
    // 4.3: a write is echoed.
    all.push(Layout {
        opcode: Opcode::BusId,
        section: "4.3",
        places: &[("flag", 2, 1), ("id", 7, 1)],
        base: (R::BusId(BusIdReply::Written(id(1))), [0x79, 0, 0, 0, 0, 0, 0, 1]),
        cases: vec![(
            "id",
            R::BusId(BusIdReply::Written(id(0x1E))),
            [0x79, 0, 0, 0, 0, 0, 0, 0x1E],
        )],
    });
    // 4.4 and 7.4: a read tells the reply identifier in DATA[6..8], or the bare id.
    all.push(Layout {
        opcode: Opcode::BusId,
        section: "4.4",
        places: &[("flag", 2, 1), ("id", 6, 2)],
        base: (R::BusId(BusIdReply::OnCan(id(1))), [0x79, 0, 1, 0, 0, 0, 0x41, 2]),
        cases: vec![
            ("id", R::BusId(BusIdReply::OnCan(id(32))), [0x79, 0, 1, 0, 0, 0, 0x60, 2]),
            ("id", R::BusId(BusIdReply::OnRs485(id(0x1E))), [0x79, 0, 1, 0, 0, 0, 0, 0x1E]),
        ],
    });
    let motion = |number, position, velocity, torque| {
        R::Motion(RawMotionFeedback {
            id: id(number),
            position,
            velocity: u12(velocity),
            torque: u12(torque),
        })
    };
    all.push(Layout {
        opcode: Opcode::Motion,
        section: "5.3",
        places: &[("id", 0, 1), ("position", 1, 2), ("velocity", 3, 2), ("torque", 4, 2)],
        base: (motion(1, 0, 0, 0), [1, 0, 0, 0, 0, 0, 0, 0]),
        cases: vec![
            ("id", motion(32, 0, 0, 0), [0x20, 0, 0, 0, 0, 0, 0, 0]),
            ("position", motion(1, 0xF1F2, 0, 0), [1, 0xF1, 0xF2, 0, 0, 0, 0, 0]),
            ("velocity", motion(1, 0, 0xABC, 0), [1, 0, 0, 0xAB, 0xC0, 0, 0, 0]),
            ("torque", motion(1, 0, 0, 0xABC), [1, 0, 0, 0, 0x0A, 0xBC, 0, 0]),
            ("", motion(2, 0x3456, 0x789, 0xABC), [2, 0x34, 0x56, 0x78, 0x9A, 0xBC, 0, 0]),
        ],
    });
    all
}

impl<T> Layout<T> {
    fn is_field(&self, byte: usize) -> bool {
        self.places.iter().any(|&(_, first, length)| (first..first + length).contains(&byte))
    }

    /// The bytes that the manual calls NULL.
    fn nulls(&self) -> Vec<usize> {
        let first = usize::from(self.opcode.byte().is_some());
        (first..8).filter(|&byte| !self.is_field(byte)).collect()
    }

    /// The tables above hold what they say: each field has a case, which differs from the base in
    /// bytes of that field only.
    fn check_table(&self) {
        let Self { opcode, section, .. } = self;
        for &(field, first, length) in self.places {
            let mut of_field = self.cases.iter().filter(|(name, ..)| *name == field).peekable();
            // The flag of 0x79 says which other bytes there are, so it has no case of its own.
            assert!(of_field.peek().is_some() || field == "flag", "{section} {opcode}: {field}");
            for (_, _, data) in of_field {
                for byte in (0..8).filter(|byte| !(first..first + length).contains(byte)) {
                    assert_eq!(data[byte], self.base.1[byte], "{section} {opcode}: {field}");
                }
                assert_ne!(*data, self.base.1, "{section} {opcode}: {field}");
            }
        }
        for (name, _, data) in &self.cases {
            assert!(name.is_empty() || self.places.iter().any(|(field, ..)| field == name));
            assert!(self.nulls().iter().all(|&byte| data[byte] == 0), "{section} {opcode}: {name}");
        }
        assert_eq!(self.places.is_empty(), self.cases.is_empty());
    }

    fn all(&self) -> impl Iterator<Item = (&str, &T, Data)> {
        let cases = self.cases.iter().map(|(field, value, data)| (*field, value, *data));
        std::iter::once(("base", &self.base.0, self.base.1)).chain(cases)
    }

    fn check(&self, encode: fn(&T) -> Data, decode: fn(Opcode, &Data) -> Result<T, DecodeError>)
    where
        T: PartialEq + Debug,
    {
        self.check_table();
        for (field, value, data) in self.all() {
            let Self { opcode, section, .. } = self;
            let what = format!("{section} {opcode}, {field}: {data:02X?}");
            assert_eq!(encode(value), data, "{what}");
            assert_eq!(decode(*opcode, &data).as_ref(), Ok(value), "{what}");

            // NULL bytes are not read, one by one and all together.
            let nulls = self.nulls();
            let mut noisy = data;
            for (place, &null) in nulls.iter().enumerate() {
                let mut one = data;
                one[null] = 0xFF;
                assert_eq!(decode(*opcode, &one).as_ref(), Ok(value), "{what}, NULL {null}");
                noisy[null] = 0xA0 + place as u8;
            }
            assert_eq!(decode(*opcode, &noisy).as_ref(), Ok(value), "{what}, all NULLs");

            // The command byte is read.
            if let Some(byte) = opcode.byte() {
                let mut other = data;
                other[0] = !byte;
                let error = DecodeError::WrongOpcode { expected: *opcode, found: !byte };
                assert_eq!(decode(*opcode, &other), Err(error), "{what}");
            }
        }
    }
}

#[test]
fn every_field_of_every_command_has_its_bytes() {
    for layout in commands() {
        assert!(layout.all().all(|(_, value, _)| value.opcode() == layout.opcode));
        layout.check(AnyCommand::encode, AnyCommand::decode_as);
    }
}

#[test]
fn every_field_of_every_reply_has_its_bytes() {
    for layout in replies() {
        assert!(layout.all().all(|(_, value, _)| value.opcode() == layout.opcode));
        layout.check(AnyReply::encode, AnyReply::decode_as);
    }
}

#[test]
fn every_kind_is_covered() {
    let all: BTreeSet<Opcode> = Opcode::ALL.iter().copied().collect();
    // 2.26.3 and 2.34.3: no reply; 2.32.3: a reply that means nothing.
    let without_reply = [Opcode::Reset, Opcode::SetBaudRate, Opcode::ActiveReply];

    let covered: BTreeSet<Opcode> = commands().iter().map(|layout| layout.opcode).collect();
    assert_eq!(covered, all);
    let covered: BTreeSet<Opcode> = replies().iter().map(|layout| layout.opcode).collect();
    assert_eq!(covered, all.into_iter().filter(|o| !without_reply.contains(o)).collect());

    for opcode in without_reply {
        let data = [opcode.byte().expect("a command byte"), 0, 0, 0, 0, 0, 0, 0];
        assert_eq!(AnyReply::decode_as(opcode, &data), Err(DecodeError::NoReply(opcode)));
        assert!(!opcode.has_reply());
    }
}

#[test]
fn a_read_of_the_bus_id_does_not_look_at_the_id() {
    let data = [0x79, 0, 1, 0, 0, 0, 0xA5, 0x5A];
    assert_eq!(AnyCommand::decode_as(Opcode::BusId, &data), Ok(BusId::Read.into()));
    // 7.3's table has the bare id in DATA[6], 7.4's example in DATA[7].
    let data = [0x79, 0, 1, 0, 0, 0, 0x1E, 0];
    let told = AnyReply::BusId(BusIdReply::OnRs485(id(0x1E)));
    assert_eq!(AnyReply::decode_as(Opcode::BusId, &data), Ok(told));
}

/// Every code that the manual names, with its number, and no other.
macro_rules! assert_codes {
    ($type:ident { $($code:ident = $raw:literal,)+ }) => {
        let named = [$(($type::$code, $raw)),+];
        for (code, raw) in named {
            assert_eq!(code.raw(), raw);
            assert_eq!($type::from_raw(raw), code);
        }
        for raw in 0..=255 {
            if named.iter().all(|(_, named)| *named != raw) {
                assert_eq!($type::from_raw(raw), $type::Unknown(raw));
                assert_eq!($type::Unknown(raw).raw(), raw);
            }
        }
        assert_eq!($type::ALL.len(), named.len());
    };
}

#[test]
fn codes_are_the_manuals() {
    // 2.1.4
    assert_codes!(PidIndex {
        CurrentKp = 1, CurrentKi = 2, SpeedKp = 4, SpeedKi = 5,
        PositionKp = 7, PositionKi = 8, PositionKd = 9,
    });
    // 2.4.4
    assert_codes!(AccelerationIndex {
        PositionAcceleration = 0, PositionDeceleration = 1,
        SpeedAcceleration = 2, SpeedDeceleration = 3,
    });
    // 2.14.3
    assert_codes!(BrakeCommand { Lock = 0, Release = 1, });
    // 2.22.1
    assert_codes!(Direction { Clockwise = 0, CounterClockwise = 1, });
    // 2.25.3
    assert_codes!(Mode { Current = 1, Speed = 2, Position = 3, });
    // 2.32.4
    assert_codes!(BaudCode { Can500kRs485At115200 = 0, Can1MRs485At500k = 1, Rs485At1M = 2, });
    // 2.34.2
    assert_codes!(ReportedCommand {
        MultiTurnEncoder = 0x60, MultiTurnEncoderRaw = 0x61, MultiTurnEncoderOffset = 0x62,
        MultiTurnAngle = 0x92, Status1 = 0x9A, Status2 = 0x9C, Status3 = 0x9D,
        Undescribed9E = 0x9E,
    });
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
        // Only what recovers by itself needs no restart.
        assert_eq!(flag.needs_restart(), level != Some(Two), "{flag}");
    }
    assert_eq!(ErrorFlags::NAMED, manual.map(|(_, flag, _)| flag));
}

#[test]
fn steps_have_the_size_that_the_manual_gives() {
    assert_eq!(Temperature::from_raw(-40).celsius(), -40.0); // 1 °C, 2.14.3
    assert_eq!(Voltage::from_raw(485).volts(), 48.5); // 0.1 V, 2.14.3
    assert_eq!(Current::from_raw(-125).amperes(), -1.25); // 0.01 A, 2.15.3
    assert_eq!(units::CoarseSpeed::from_raw(-500).dps(), -500.0); // 1 dps, 2.15.3
    assert_eq!(CoarseAngle::from_raw(-45).degrees(), -45.0); // 1 degree, 2.15.3
    assert_eq!(Angle::from_raw(-36_025).degrees(), -360.25); // 0.01 degree, 2.12.3
    assert_eq!(circle(35_950).degrees(), 359.5); // 0.01 degree, 2.13.3
    assert_eq!(target(36_000).degrees(), 360.0); // 0.01 degree, 2.22.1
    assert_eq!(SpeedTarget::from_raw(-150).dps(), -1.5); // 0.01 dps, 2.20.1
    assert_eq!(MaxSpeed::from_raw(500).dps(), 500.0); // 1 dps, 2.21.1
    assert_eq!(MaxTorque::from_raw(60).percent(), 60.0); // 1 % of rated current, 2.20.1
    assert_eq!(acceleration(60_000).dps2(), 60_000.0); // 1 dps/s, 2.5.1
    assert_eq!(ReportedAcceleration::from_raw(7).dps2(), 7.0); // 1 dps/s, 2.4.3
    assert_eq!(ReportInterval::from_raw(3).millis(), 30.0); // 10 ms, 2.34.2
}

#[test]
fn values_beyond_their_range_are_refused() {
    let refused = |data: Data| {
        let opcode = Opcode::from_byte(data[0]).expect("a command byte");
        matches!(AnyCommand::decode_as(opcode, &data), Err(DecodeError::OutOfRange(_)))
    };
    // 2.5.1: 100 to 60000 (and 0, which means no planning).
    assert!(refused([0x43, 0, 0, 0, 99, 0, 0, 0]));
    assert!(refused([0x43, 0, 0, 0, 0x61, 0xEA, 0, 0])); // 60001
    assert!(refused([0x43, 0, 0, 0, 0x64, 0, 1, 0])); // 65636
    // 2.22: 0 to 36000.
    assert!(refused([0xA6, 0, 0, 0, 0xA1, 0x8C, 0, 0]));
    // 2.34.2 and 2.35.4: 0 or 1.
    assert!(refused([0xB6, 0x60, 2, 1, 0, 0, 0, 0]));
    for function in [2, 3, 4] {
        assert!(refused([0x20, function, 0, 0, 2, 0, 0, 0]));
        assert!(refused([0x20, function, 0, 0, 1, 0, 0, 1]));
    }
    // 4.1, 7.1 and 2.35.4: an id is 1 to 32, the flag 0 or 1.
    for bad in [0, 33, 0xFF] {
        assert!(refused([0x79, 0, 0, 0, 0, 0, 0, bad]));
        assert!(refused([0x20, 5, 0, 0, bad, 0, 0, 0]));
    }
    assert!(refused([0x20, 5, 0, 0, 1, 1, 0, 0]));
    assert!(refused([0x79, 0, 2, 0, 0, 0, 0, 1]));
    // 2.13.3: 0 to 35999.
    let angle =
        AnyReply::decode_as(Opcode::ReadSingleTurnAngle, &[0x94, 0, 0, 0, 0, 0, 0xA0, 0x8C]);
    assert!(matches!(angle, Err(DecodeError::OutOfRange(_))), "{angle:?}");
}
