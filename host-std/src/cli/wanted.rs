//! A command of the table by its name, or eight raw bytes.

use clap::ValueEnum;
use myactuator_host_std::protocol::command::{AnyCommand, MotionRanges, RawCommand};
use myactuator_host_std::protocol::opcode::ReplyRule;
use myactuator_host_std::protocol::{Data, Kind, Opcode};
use myactuator_host_std::text;

use super::from_table::FromTable;

#[derive(Debug, clap::Subcommand)]
pub(super) enum Wanted {
    Raw(Raw),
    #[command(flatten)]
    Table(FromTable),
}

/// Eight bytes of your own, the command byte first, for commands that this program does not know
///
/// They are sent once, and never again. If the table has the command byte, it overrides --reply and --moves. A reply is
/// explained as one of --firmware, else of v4.3.
#[derive(Debug, clap::Args)]
pub(super) struct Raw {
    /// The bytes, hexadecimal, with spaces or commas or without: C0 01 00 00 00 00 00 00.
    #[arg(value_name = "BYTES", required = true)]
    bytes: Vec<String>,
    /// How a motor replies.
    #[arg(long, value_enum, default_value_t = Answer::Values)]
    reply: Answer,
    /// The command may set the motor in motion, or let its load fall.
    #[arg(long)]
    moves: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Answer {
    /// With values under the same command byte
    Values,
    /// With the same bytes
    Echo,
    /// Not at all
    None,
}

impl Raw {
    fn command(&self) -> Result<RawCommand, String> {
        // With the prefix no byte is read as decimal.
        let pieces = self.bytes.iter().flat_map(|piece| piece.split([' ', ',']));
        let digits = pieces.map(|piece| piece.strip_prefix("0x").unwrap_or(piece));
        let digits = digits.filter(|digits| !digits.is_empty());
        let line: String = digits.map(|digits| format!("0x{digits} ")).collect();
        let bytes = text::rs485::parse_line(&line).map_err(|error| error.to_string())?;
        let data = Data::try_from(bytes)
            .map_err(|bytes| format!("expected eight bytes, found {}", bytes.len()))?;
        let reply = match self.reply {
            Answer::Values => ReplyRule::Values,
            Answer::Echo => ReplyRule::Same,
            Answer::None => ReplyRule::Silent,
        };
        Ok(RawCommand::new(data, reply, self.moves))
    }
}

impl Wanted {
    /// The row of the table, unless it is raw.
    pub(super) const fn opcode(&self) -> Option<Opcode> {
        match self {
            Self::Raw(_) => None,
            Self::Table(table) => Some(table.opcode()),
        }
    }

    /// The command to send; motion mode needs scales.
    pub(super) fn command(&self, ranges: Option<&MotionRanges>) -> Result<AnyCommand, String> {
        match self {
            Self::Raw(raw) => Ok(raw.command()?.into()),
            Self::Table(table) => table.command(ranges),
        }
    }

    /// What is known about it before the scales are.
    pub(super) fn kind(&self) -> Result<Kind, String> {
        match self.opcode() {
            Some(Opcode::Motion) => Ok(Opcode::Motion.into()),
            _ => Ok(self.command(None)?.kind()),
        }
    }
}
