//! `myactuator encode`: a command as the bytes that carry it.

use std::io;

use clap::{ArgAction, ArgGroup};
use myactuator_host_std::{BusKind, text};
use myactuator_protocol_core::command::{self as c, AnyCommand, check_on_rs485};
use myactuator_protocol_core::units as u;
use myactuator_protocol_core::{MotorId, Opcode, Target};

use super::{DONE, arguments as parse, names, print_line, wrong_usage};

/// Print the frame of a command: 141#A400F401A08C0000 (as candump and cansend write it), or RS485
/// bytes in hexadecimal.
#[derive(Debug, clap::Args)]
#[command(
    subcommand_value_name = "COMMAND",
    subcommand_help_heading = "Commands",
    disable_help_subcommand = true,
    arg_required_else_help = false
)]
pub(super) struct Arguments {
    /// The bus that the frame is for.
    #[arg(long, global = true, value_parser = names::bus(), default_value_t)]
    bus: BusKind,
    /// The motor, 1 to 32, or `all`.
    #[arg(long, global = true, value_parser = parse::target, allow_hyphen_values = true)]
    id: Option<Target>,
    #[command(subcommand)]
    command: Command,
}

/// The commands of the protocol, by their names in the library's table. Flags are the keys that
/// `decode --json` uses, in kebab-case; values are rounded to the nearest step of the frame.
#[derive(Debug, clap::Subcommand)]
enum Command {
    /// One of seven special functions (2.35)
    FunctionControl(FunctionValue),
    /// Read a gain of a control loop (2.1)
    ReadPid(PidIndex),
    /// Write a gain until power-off (2.2)
    WritePidRam(PidValue),
    /// Write a gain for good (2.3)
    WritePidRom(PidValue),
    /// Read a planning acceleration (2.4)
    ReadAcceleration(AccelerationIndex),
    /// Write a planning acceleration for good (2.5)
    WriteAcceleration(AccelerationValue),
    /// Read the multi-turn encoder position (2.6)
    ReadMultiTurnEncoder,
    /// Read the multi-turn encoder position without its zero offset (2.7)
    ReadMultiTurnEncoderRaw,
    /// Read the zero offset of the multi-turn encoder (2.8)
    ReadMultiTurnEncoderOffset,
    /// Make a given encoder position the zero (2.9)
    SetEncoderZero(Offset),
    /// Make the current position the zero (2.10)
    SetCurrentPositionZero,
    /// Read which control loop runs (2.25)
    ReadRunningMode,
    /// Restart the drive (2.26)
    Reset,
    /// Open the brake (2.27)
    ReleaseBrake,
    /// Close the brake (2.28)
    LockBrake,
    /// Read or set the id of whatever is connected (4, 7)
    BusId(BusIdAccess),
    /// Switch the output off (2.17)
    Shutdown,
    /// Stop and hold still (2.18)
    Stop,
    /// Read the single-turn encoder (2.11)
    ReadSingleTurnEncoder,
    /// Read the multi-turn angle of the output shaft (2.12)
    ReadMultiTurnAngle,
    /// Read the single-turn angle (2.13)
    ReadSingleTurnAngle,
    /// Read temperatures, brake, voltage and errors (2.14)
    #[command(name = "read-status1")]
    ReadStatus1,
    /// Read temperature, torque current, speed and angle (2.15)
    #[command(name = "read-status2")]
    ReadStatus2,
    /// Read temperature and phase currents (2.16)
    #[command(name = "read-status3")]
    ReadStatus3,
    /// Run at a torque current (2.19)
    Torque(TorqueTarget),
    /// Run at a speed (2.20)
    Speed(SpeedTarget),
    /// Go to a multi-turn angle (2.21)
    AbsolutePosition(PositionTarget),
    /// Go to an angle within one turn (2.22)
    SingleTurnPosition(SingleTurnTarget),
    /// Go on by an angle (2.23)
    IncrementalPosition(PositionTarget),
    /// Go to a multi-turn angle with limited torque (2.24)
    ForcePosition(ForceTarget),
    /// Read the time since the last start (2.29)
    ReadRunTime,
    /// Read the date of the drive's software (2.30)
    ReadVersionDate,
    /// Set after how long a silence the drive stops by itself (2.31)
    CommunicationLossProtection(Timeout),
    /// Set the bit rate of the bus (2.32)
    SetBaudRate(BaudRate),
    /// Read the motor's model (2.33)
    ReadModel,
    /// Have a reply sent by itself at an interval, CAN only (2.34)
    ActiveReply(Report),
    /// Motion (MIT) mode by the ranges of protocol V4.3, CAN only (5)
    Motion(MotionTarget),
}

#[derive(Debug, clap::Args)]
struct FunctionValue {
    /// Which function: 1 to 7, or its name such as can-id-filter.
    #[arg(long, value_parser = parse::function_index, allow_hyphen_values = true)]
    index: u8,
    /// Its value: 0 or 1 for switches, an id, or a limit of angle; none for clear-multi-turn.
    #[arg(long, allow_hyphen_values = true)]
    value: Option<String>,
}

#[derive(Debug, clap::Args)]
struct PidIndex {
    /// Which gain: its number (1, 2, 4, 5, 7, 8, 9) or its name, such as current-kp.
    #[arg(long, value_parser = parse::pid_index, allow_hyphen_values = true)]
    index: c::PidIndex,
}

#[derive(Debug, clap::Args)]
struct PidValue {
    #[command(flatten)]
    which: PidIndex,
    /// The gain.
    #[arg(long, value_parser = parse::gain, allow_hyphen_values = true)]
    value: u::Gain,
}

#[derive(Debug, clap::Args)]
struct AccelerationIndex {
    /// Which acceleration: 0 to 3, or its name, such as position-acceleration.
    #[arg(long, value_parser = parse::acceleration_index, allow_hyphen_values = true)]
    index: c::AccelerationIndex,
}

#[derive(Debug, clap::Args)]
struct AccelerationValue {
    #[command(flatten)]
    which: AccelerationIndex,
    /// 100 to 60000 dps/s.
    #[arg(long, value_parser = parse::acceleration, allow_hyphen_values = true)]
    acceleration_dps2: u::Acceleration,
}

#[derive(Debug, clap::Args)]
struct Offset {
    /// The raw encoder position that becomes the zero.
    #[arg(long, value_parser = parse::pulses, allow_hyphen_values = true)]
    offset_pulses: u::EncoderPulses,
}

#[derive(Debug, clap::Args)]
#[command(group = ArgGroup::new("access").required(true))]
struct BusIdAccess {
    /// Who is there? Every motor on the bus answers.
    #[arg(long, group = "access", action = ArgAction::SetTrue)]
    read: bool,
    /// Give this id to every motor on the bus.
    #[arg(long, group = "access", value_name = "ID", value_parser = parse::motor_id, allow_hyphen_values = true)]
    write: Option<MotorId>,
}

#[derive(Debug, clap::Args)]
struct TorqueTarget {
    /// The torque current, A.
    #[arg(long, value_parser = parse::current, allow_hyphen_values = true)]
    current_a: u::Current,
}

#[derive(Debug, clap::Args)]
struct SpeedTarget {
    /// The speed of the output shaft, degrees per second.
    #[arg(long, value_parser = parse::speed, allow_hyphen_values = true)]
    speed_dps: u::SpeedTarget,
    /// The largest torque, % of the rated current; 0 for no limit but the stall current.
    #[arg(long, value_parser = parse::max_torque, allow_hyphen_values = true, default_value = "0")]
    max_torque_pct: u::MaxTorque,
}

#[derive(Debug, clap::Args)]
struct PositionTarget {
    /// Where to go, or how far, degrees.
    #[arg(long, value_parser = parse::angle, allow_hyphen_values = true)]
    angle_deg: u::Angle,
    /// The fastest turning on the way, degrees per second; 0 for no limit of this command.
    #[arg(long, value_parser = parse::max_speed, allow_hyphen_values = true)]
    max_speed_dps: u::MaxSpeed,
}

#[derive(Debug, clap::Args)]
struct ForceTarget {
    #[command(flatten)]
    position: PositionTarget,
    /// The largest torque, % of the rated current.
    #[arg(long, value_parser = parse::max_torque, allow_hyphen_values = true)]
    max_torque_pct: u::MaxTorque,
}

#[derive(Debug, clap::Args)]
struct SingleTurnTarget {
    /// Where to go, 0 to 360 degrees.
    #[arg(long, value_parser = parse::single_turn_angle, allow_hyphen_values = true)]
    angle_deg: u::SingleTurnTarget,
    /// Which way to turn: clockwise or counter-clockwise.
    #[arg(long, value_parser = parse::direction, allow_hyphen_values = true)]
    direction: c::Direction,
    /// The fastest turning on the way, degrees per second; 0 for no limit of this command.
    #[arg(long, value_parser = parse::max_speed, allow_hyphen_values = true)]
    max_speed_dps: u::MaxSpeed,
}

#[derive(Debug, clap::Args)]
struct Timeout {
    /// The longest silence, ms; 0 switches the protection off.
    #[arg(long, value_parser = parse::milliseconds, allow_hyphen_values = true)]
    timeout_ms: u::Milliseconds,
}

#[derive(Debug, clap::Args)]
struct BaudRate {
    /// 0 (CAN 500k, RS485 115200), 1 (CAN 1M, RS485 500k), 2 (RS485 1M), or another code.
    #[arg(long, value_parser = parse::baud_code, allow_hyphen_values = true)]
    baud_code: c::BaudCode,
}

#[derive(Debug, clap::Args)]
struct Report {
    /// Whose reply: 0x60, 0x61, 0x62, 0x92, 0x9A, 0x9C, 0x9D, or the command's name.
    #[arg(long, value_parser = parse::reported_command, allow_hyphen_values = true)]
    command: c::ReportedCommand,
    /// Start (true) or end (false).
    #[arg(long, action = ArgAction::Set)]
    enabled: bool,
    /// How often, in steps of 10 ms.
    #[arg(long, value_parser = parse::interval, allow_hyphen_values = true)]
    interval_ms: u::ReportInterval,
}

#[derive(Debug, clap::Args)]
struct MotionTarget {
    /// Wanted position, -12.5 to 12.5 rad.
    #[arg(long, value_parser = parse::position, allow_hyphen_values = true)]
    position_rad: f32,
    /// Wanted velocity, -45 to 45 rad/s.
    #[arg(long, value_parser = parse::velocity, allow_hyphen_values = true)]
    velocity_rad_s: f32,
    /// Gain on the position error, 0 to 500 N·m/rad.
    #[arg(long, value_parser = parse::kp, allow_hyphen_values = true)]
    kp: f32,
    /// Gain on the velocity error, 0 to 5 N·m·s/rad.
    #[arg(long, value_parser = parse::kd, allow_hyphen_values = true)]
    kd: f32,
    /// Torque added to both, -24 to 24 N·m.
    #[arg(long, value_parser = parse::torque, allow_hyphen_values = true)]
    torque_nm: f32,
}

/// Prints the frame, or one sentence about why there is none.
pub(super) fn run(arguments: &Arguments) -> u8 {
    let line = match frame(arguments) {
        Ok(line) => line,
        Err(sentence) => return wrong_usage(&sentence),
    };
    match print_line(&mut io::stdout().lock(), &line) {
        Ok(_) => DONE,
        Err(error) => wrong_usage(&format!("cannot write: {error}")),
    }
}

fn frame(arguments: &Arguments) -> Result<String, String> {
    let command = any_command(&arguments.command)?;
    let opcode = command.opcode();
    if arguments.bus == BusKind::Rs485 {
        check_on_rs485(opcode).map_err(|error| format!("--bus: {error}"))?;
    }
    let target = match arguments.id {
        Some(target) => target,
        // It names no motor anyway.
        None if opcode == Opcode::BusId => Target::All,
        None => return Err("--id is missing: tell which motor, 1 to 32, or all".to_owned()),
    };
    let packet = command.packet(target).map_err(|error| format!("--id: {error}"))?;
    text::packet(arguments.bus, &packet).ok_or_else(|| format!("{opcode} has no frame on RS485"))
}

fn any_command(command: &Command) -> Result<AnyCommand, String> {
    Ok(match command {
        Command::FunctionControl(a) => parse::function(a.index, a.value.as_deref())?.into(),
        Command::ReadPid(a) => c::ReadPid { index: a.index }.into(),
        Command::WritePidRam(a) => c::WritePidRam { index: a.which.index, value: a.value }.into(),
        Command::WritePidRom(a) => c::WritePidRom { index: a.which.index, value: a.value }.into(),
        Command::ReadAcceleration(a) => c::ReadAcceleration { index: a.index }.into(),
        Command::WriteAcceleration(a) => {
            c::WriteAcceleration { index: a.which.index, acceleration: a.acceleration_dps2 }.into()
        }
        Command::ReadMultiTurnEncoder => c::ReadMultiTurnEncoder.into(),
        Command::ReadMultiTurnEncoderRaw => c::ReadMultiTurnEncoderRaw.into(),
        Command::ReadMultiTurnEncoderOffset => c::ReadMultiTurnEncoderOffset.into(),
        Command::SetEncoderZero(a) => c::SetEncoderZero { offset: a.offset_pulses }.into(),
        Command::SetCurrentPositionZero => c::SetCurrentPositionZero.into(),
        Command::ReadRunningMode => c::ReadRunningMode.into(),
        Command::Reset => c::Reset.into(),
        Command::ReleaseBrake => c::ReleaseBrake.into(),
        Command::LockBrake => c::LockBrake.into(),
        Command::BusId(a) => a.write.map_or(c::BusId::Read, c::BusId::Write).into(),
        Command::Shutdown => c::Shutdown.into(),
        Command::Stop => c::Stop.into(),
        Command::ReadSingleTurnEncoder => c::ReadSingleTurnEncoder.into(),
        Command::ReadMultiTurnAngle => c::ReadMultiTurnAngle.into(),
        Command::ReadSingleTurnAngle => c::ReadSingleTurnAngle.into(),
        Command::ReadStatus1 => c::ReadStatus1.into(),
        Command::ReadStatus2 => c::ReadStatus2.into(),
        Command::ReadStatus3 => c::ReadStatus3.into(),
        Command::Torque(a) => c::Torque { current: a.current_a }.into(),
        Command::Speed(a) => c::Speed { max_torque: a.max_torque_pct, speed: a.speed_dps }.into(),
        Command::AbsolutePosition(a) => {
            c::AbsolutePosition { max_speed: a.max_speed_dps, angle: a.angle_deg }.into()
        }
        Command::SingleTurnPosition(a) => c::SingleTurnPosition {
            direction: a.direction,
            max_speed: a.max_speed_dps,
            angle: a.angle_deg,
        }
        .into(),
        Command::IncrementalPosition(a) => {
            c::IncrementalPosition { max_speed: a.max_speed_dps, angle: a.angle_deg }.into()
        }
        Command::ForcePosition(a) => c::ForcePosition {
            max_torque: a.max_torque_pct,
            max_speed: a.position.max_speed_dps,
            angle: a.position.angle_deg,
        }
        .into(),
        Command::ReadRunTime => c::ReadRunTime.into(),
        Command::ReadVersionDate => c::ReadVersionDate.into(),
        Command::CommunicationLossProtection(a) => {
            c::CommunicationLossProtection { timeout: a.timeout_ms }.into()
        }
        Command::SetBaudRate(a) => c::SetBaudRate { baud_rate: a.baud_code }.into(),
        Command::ReadModel => c::ReadModel.into(),
        Command::ActiveReply(a) => c::ActiveReply {
            command: a.command,
            enable: c::Switch::from_bool(a.enabled),
            interval: a.interval_ms,
        }
        .into(),
        Command::Motion(a) => {
            let set_point = c::MotionSetPoint {
                position_rad: a.position_rad,
                velocity_rad_s: a.velocity_rad_s,
                kp: a.kp,
                kd: a.kd,
                torque_nm: a.torque_nm,
            };
            let raw = c::MotionRanges::V4_3.quantise(&set_point);
            raw.map_err(|error| error.to_string())?.into()
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_of_the_table_has_its_command() {
        let command = <Command as clap::Subcommand>::augment_subcommands(clap::Command::new("x"));
        let mut names: Vec<&str> = command.get_subcommands().map(clap::Command::get_name).collect();
        let mut table: Vec<&str> = Opcode::ALL.iter().map(|opcode| opcode.name()).collect();
        names.sort_unstable();
        table.sort_unstable();
        assert_eq!(names, table);
    }
}
