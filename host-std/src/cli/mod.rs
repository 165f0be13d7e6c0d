//! The command line: one module a subcommand.

mod arguments;
mod dbc;
mod decode;
mod demo;
mod encode;
mod from_table;
mod interrupt;
mod motors;
mod names;
mod outcome;
mod printer;
mod sim;
mod sim_control;
mod wanted;

use std::error::Error as _;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook};
use std::process::ExitCode;

use clap::Parser;
use clap::error::{ContextKind, ErrorKind};

use outcome::{
    FAILED, Outcome, Unfinished, WRONG_USAGE, print_line, printable, report, say, unwritten,
};

/// Talk to MyActuator servo motors (protocol V4.3), and explain what is on their bus.
#[derive(Debug, Parser)]
#[command(name = "myactuator", version, infer_long_args = true)]
struct Cli {
    #[command(subcommand)]
    subcommand: Subcommand,
}

#[derive(Debug, clap::Subcommand)]
enum Subcommand {
    Demo(demo::Arguments),
    Encode(encode::Arguments),
    Decode(decode::Arguments),
    Dbc(dbc::Arguments),
    Sim(Box<sim::Arguments>),
    SimControl(sim_control::Arguments),
    #[command(flatten)]
    Motors(motors::Subcommand),
}

pub(crate) fn run() -> ExitCode {
    // A panic unwinds, and so stops motors. It must not wait for a halted terminal before that.
    set_hook(Box::new(|panic| {
        report("error", format_args!("this program has a fault, please report it: {panic}"));
    }));
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return ExitCode::from(stop_parsing(&error)),
    };
    let work = || match &cli.subcommand {
        Subcommand::Demo(arguments) => demo::run(arguments),
        Subcommand::Encode(arguments) => encode::run(arguments),
        Subcommand::Decode(arguments) => decode::run(arguments),
        Subcommand::Dbc(arguments) => dbc::run(arguments),
        Subcommand::Sim(arguments) => sim::run(arguments),
        Subcommand::SimControl(arguments) => sim_control::run(arguments),
        Subcommand::Motors(subcommand) => motors::run(subcommand),
    };
    let status = match catch_unwind(AssertUnwindSafe(work)) {
        Ok(outcome) => outcome::end(outcome),
        Err(_told) => outcome::end_of_panic(),
    };
    ExitCode::from(interrupt::end_by_it().unwrap_or(status))
}

/// Prints the help if the user asked for it, else one sentence about what is wrong. Returns the exit status.
fn stop_parsing(error: &clap::Error) -> u8 {
    match error.kind() {
        ErrorKind::DisplayHelp
        | ErrorKind::DisplayVersion
        | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            // If the terminal is gone there is nobody to tell.
            let _ = error.print();
            if error.use_stderr() { WRONG_USAGE } else { 0 }
        }
        _ => outcome::end(Err(Unfinished::Usage(parse_sentence(error)))),
    }
}

/// The message of the parser, without the usage below it.
fn parse_sentence(error: &clap::Error) -> String {
    if let (ErrorKind::ValueValidation, Some(argument), Some(cause)) =
        (error.kind(), error.get(ContextKind::InvalidArg), error.source())
    {
        let argument = argument.to_string();
        let name = argument.split_whitespace().next().unwrap_or_default();
        return format!("{name}: {cause}");
    }
    let text = error.to_string();
    let told = text.split("\n\nUsage:").next().unwrap_or(&text);
    let told = told.split("\n\nFor more information").next().unwrap_or(told);
    let words: Vec<&str> = told.split_whitespace().collect();
    let sentence = words.join(" ").trim_start_matches("error: ").replace(" tip: ", "; ");
    let stray = error.get(ContextKind::InvalidArg).map(ToString::to_string);
    match error.kind() {
        ErrorKind::InvalidSubcommand => format!("{sentence}; --help lists them"),
        ErrorKind::UnknownArgument if stray.is_some_and(|it| arguments::target(&it).is_ok()) => {
            format!("{sentence}; if a motor is meant, --id names it")
        }
        _ => sentence,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        use clap::CommandFactory;
        Cli::command().debug_assert();
    }

    #[test]
    fn the_help_of_each_subcommand_ends_with_its_exit_status() {
        use clap::CommandFactory;
        for subcommand in Cli::command().get_subcommands() {
            let (name, help) = (subcommand.get_name(), subcommand.get_long_about());
            let help = help.map(ToString::to_string).unwrap_or_default();
            let last = help.lines().last().unwrap_or_default();
            let is_status =
                last.starts_with("Exit status: 0 ") && last.ends_with(", 2 wrong usage.");
            assert!(is_status, "{name}: {last}");
        }
    }
}
