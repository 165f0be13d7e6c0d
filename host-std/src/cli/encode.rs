//! `myactuator encode`: a command as the bytes that carry it.

use myactuator_host_std::protocol::command::MotionRanges;
use myactuator_host_std::protocol::{Firmware, Target};
use myactuator_host_std::{BusKind, text};

use super::arguments as parse;
use super::wanted::Wanted;
use super::{Outcome, names, print_line};

/// Print the frame of a command; nothing is sent
///
/// A CAN frame is printed as candump and cansend write it, 141#A400F401A08C0000; an RS485 frame as bytes in
/// hexadecimal.
///
/// Exit status: 0 printed, 2 wrong usage.
#[derive(Debug, clap::Args)]
#[command(arg_required_else_help = false)]
pub(super) struct Arguments {
    /// The bus that the frame is for.
    #[arg(long, global = true, value_parser = names::bus(), default_value = BusKind::Can.name())]
    bus: BusKind,
    /// The motor, 1 to 32, or `all`.
    #[arg(long, global = true, value_parser = parse::target, allow_hyphen_values = true)]
    id: Option<Target>,
    /// The revision of the protocol, v4.3 or v4.4 [default: v4.3; for motion mode there is none].
    #[arg(long, global = true, value_parser = parse::firmware)]
    firmware: Option<Firmware>,
    /// The scales of motion mode, if they differ from the firmware's: the largest position, velocity, kp, kd and
    /// torque, as in 12.566,45,500,5,60.
    #[arg(long, global = true, value_parser = parse::ranges)]
    ranges: Option<MotionRanges>,
    #[command(subcommand)]
    command: Wanted,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let Arguments { bus, id, firmware, ranges, command } = arguments;
    let kind = command.kind()?;
    if let Some(opcode) = command.opcode() {
        parse::check_firmware(opcode, firmware.unwrap_or(Firmware::V4_3))?;
    }
    parse::check_bus(kind, *bus)?;
    let target = parse::whom(kind, *id)?;
    if kind.is_motion() && firmware.is_none() && ranges.is_none() {
        return Err(parse::SCALES_ARE_NOT_GUESSED.to_owned().into());
    }
    let ranges = ranges.or_else(|| firmware.and_then(Firmware::motion_ranges));
    let command = command.command(ranges.as_ref())?;
    let packet = command.packet(target).map_err(|error| format!("--id: {error}"))?;
    let frame = text::packet(*bus, &packet);
    let frame = frame.ok_or_else(|| format!("{kind} has no frame on RS485"))?;
    Ok(print_line(&frame)?)
}
