//! The commands of the table as subcommands, and their fields as flags.

use clap::{Arg, ArgMatches, Command};
use myactuator_host_std::protocol::Opcode;
use myactuator_host_std::protocol::command::{AnyCommand, Field, MotionRanges};
use myactuator_host_std::protocol::quantity::{Form, Steps};

use super::arguments as parse;

/// A command of the table, with its fields as they were typed. Each row of the table is a subcommand, and each field a
/// flag. Parts of a unit are rounded to the nearest step of the frame.
#[derive(Clone, Debug)]
pub(super) struct FromTable {
    opcode: Opcode,
    /// Values by their flags.
    given: ArgMatches,
}

impl FromTable {
    pub(super) const fn opcode(&self) -> Opcode {
        self.opcode
    }

    /// The command, or one sentence about why there is none.
    pub(super) fn command(&self, ranges: Option<&MotionRanges>) -> Result<AnyCommand, String> {
        let mut data = [self.opcode.byte().unwrap_or_default(), 0, 0, 0, 0, 0, 0, 0];
        if self.opcode == Opcode::Motion && ranges.is_none() {
            return Err(parse::RANGES_ARE_MISSING.to_owned());
        }
        let fields = self.opcode.command_fields();
        let mut used = Vec::new();
        for field in fields {
            if !field.is_in(&data) {
                continue;
            }
            let flag = flag(field);
            let Some(text) = self.given.get_one::<String>(&flag) else {
                return Err(format!("--{flag} is missing: {}", hint(field)));
            };
            let named = |sentence| format!("--{flag}: {sentence}");
            let raw = parse::field(text, field, ranges).map_err(named)?;
            field.put(&mut data, raw).map_err(|error| named(error.to_string()))?;
            used.push(flag);
        }
        let mut given = fields.iter().map(flag).filter(|flag| self.given.contains_id(flag));
        match given.find(|flag| !used.contains(flag)) {
            Some(flag) => Err(format!("--{flag}: this form of {} takes none", self.opcode)),
            None => AnyCommand::decode_as(self.opcode, &data).map_err(|error| error.to_string()),
        }
    }
}

/// A field's flag: its key with hyphens.
fn flag(field: &Field) -> String {
    field.key().to_string().replace('_', "-")
}

/// What a field means, and what it may be.
fn hint(field: &Field) -> String {
    let Field { meaning, quantity, .. } = field;
    match quantity.form {
        Form::Code(names) => {
            let names: Vec<_> =
                names.iter().map(|name| format!("{} ({})", name.name, name.raw)).collect();
            format!("{meaning} One of {}, or another number up to 255.", names.join(", "))
        }
        Form::Switch => format!("{meaning} Either on or off."),
        Form::Steps(Steps { min, max, .. }) => {
            let (min, max) = (quantity.amount(min), quantity.amount(max));
            format!("{meaning} {min} to {max} {}.", quantity.unit.symbol()).replace(" .", ".")
        }
        _ if quantity.unit.symbol().is_empty() => (*meaning).to_owned(),
        _ => format!("{meaning} In {}.", quantity.unit.symbol()),
    }
}

impl clap::Subcommand for FromTable {
    fn augment_subcommands(command: Command) -> Command {
        let row = |opcode: &Opcode| {
            let about =
                format!("{} ({})", opcode.meaning().trim_end_matches('.'), opcode.section());
            let mut row = Command::new(opcode.name()).about(about);
            let mut flags: Vec<String> = Vec::new();
            for field in opcode.command_fields() {
                let name = flag(field);
                // The meaning of the value depends on the function.
                let same = opcode.command_fields().iter().filter(|other| flag(other) == name);
                let help = if same.count() > 1 {
                    "Its value: on or off, an id, or a number; as the rest decides.".to_owned()
                } else {
                    hint(field)
                };
                if !flags.contains(&name) {
                    let arg = Arg::new(name.clone()).long(name.clone()).help(help);
                    row = row.arg(arg.allow_hyphen_values(true).value_name("VALUE"));
                    flags.push(name);
                }
            }
            row
        };
        command
            .subcommand_value_name("COMMAND")
            .subcommand_help_heading("Commands")
            .disable_help_subcommand(true)
            .subcommand_required(true)
            .subcommands(Opcode::ALL.iter().map(row))
    }

    fn augment_subcommands_for_update(command: Command) -> Command {
        Self::augment_subcommands(command)
    }

    fn has_subcommand(name: &str) -> bool {
        name.parse::<Opcode>().is_ok()
    }
}

impl clap::FromArgMatches for FromTable {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let missing = || clap::Error::raw(clap::error::ErrorKind::MissingSubcommand, "no command");
        let (name, matches) = matches.subcommand().ok_or_else(missing)?;
        let opcode: Opcode = name.parse().map_err(|_| missing())?;
        Ok(Self { opcode, given: matches.clone() })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// It differs between commands whose fields have the same type, so it is not said of the type.
    #[test]
    fn field_whose_0_is_no_amount_says_what_its_0_does() {
        for opcode in Opcode::ALL {
            for field in opcode.command_fields() {
                if let Form::Steps(Steps { zero: Some(zero), .. }) = field.quantity.form {
                    let (meaning, name) = (field.meaning, opcode.name());
                    let mut words = meaning.split([' ', ';', ':']);
                    assert!(words.any(|word| word == "0"), "{name}: {meaning}");
                    assert!(!hint(field).ends_with(&format!("{zero}.")), "{name}: {}", hint(field));
                }
            }
        }
    }

    #[test]
    fn help_has_no_markup_of_the_documentation() {
        for opcode in Opcode::ALL {
            let fields = opcode.command_fields().iter().map(|field| field.meaning);
            for text in fields.chain([opcode.meaning()]) {
                assert!(!text.contains(['[', ']', '`']), "{}: {text}", opcode.name());
            }
        }
    }
}
