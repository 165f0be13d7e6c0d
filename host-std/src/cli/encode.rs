//! `myactuator encode`: a command as the bytes that carry it.

use myactuator_host_std::protocol::Target;
use myactuator_host_std::{BusKind, text};

use super::arguments::{self as parse, Revision};
use super::from_table::FromTable;
use super::{Outcome, names, print_line};

/// Print the frame of a command: 141#A400F401A08C0000 (as candump and cansend write it), or RS485
/// bytes in hexadecimal.
#[derive(Debug, clap::Args)]
#[command(arg_required_else_help = false)]
pub(super) struct Arguments {
    /// The bus that the frame is for.
    #[arg(long, global = true, value_parser = names::bus(), default_value = BusKind::Can.name())]
    bus: BusKind,
    /// The motor, 1 to 32, or `all`.
    #[arg(long, global = true, value_parser = parse::target, allow_hyphen_values = true)]
    id: Option<Target>,
    #[command(flatten)]
    revision: Revision,
    #[command(subcommand)]
    command: FromTable,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let Arguments { bus, id, revision, command } = arguments;
    let opcode = command.opcode();
    parse::check_firmware(opcode, revision.firmware)?;
    parse::check_bus(opcode.into(), *bus)?;
    let target = parse::whom(opcode.into(), *id)?;
    let command = command.command(revision.motion_ranges().as_ref())?;
    let packet = command.packet(target).map_err(|error| format!("--id: {error}"))?;
    let frame = text::packet(*bus, &packet);
    let frame = frame.ok_or_else(|| format!("{opcode} has no frame on RS485"))?;
    Ok(print_line(&frame)?)
}
