//! The command line: one module a subcommand.

mod arguments;
mod dbc;
mod decode;
mod demo;
mod encode;
mod from_table;
mod motors;
mod names;
mod sim;

use std::error::Error as _;
use std::fmt::Display;
use std::io::{self, Write};
use std::process::ExitCode;

use clap::Parser;
use clap::error::{ContextKind, ErrorKind};

/// Everything was done.
const DONE: u8 = 0;
/// Some frames were not understood.
const NOT_ALL_DECODED: u8 = 1;
/// What was asked for could not be done.
const FAILED: u8 = 1;
/// The program was used wrongly.
const WRONG_USAGE: u8 = 2;
/// Ctrl-C, or the like, ended what was under way.
const INTERRUPTED: u8 = 130;

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
    #[command(flatten)]
    Motors(motors::Subcommand),
}

/// Runs the program with the arguments that it was started with.
pub(crate) fn run() -> ExitCode {
    ExitCode::from(match Cli::try_parse() {
        Ok(cli) => match cli.subcommand {
            Subcommand::Demo(arguments) => demo::run(&arguments),
            Subcommand::Encode(arguments) => encode::run(&arguments),
            Subcommand::Decode(arguments) => decode::run(&arguments),
            Subcommand::Dbc(arguments) => dbc::run(&arguments),
            Subcommand::Sim(arguments) => sim::run(&arguments),
            Subcommand::Motors(subcommand) => motors::run(&subcommand),
        },
        Err(error) => stop_parsing(&error),
    })
}

/// Prints help where it was asked for, else one sentence about what is wrong.
fn stop_parsing(error: &clap::Error) -> u8 {
    match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => {
            // Nobody is left to tell if the terminal is gone.
            let _ = error.print();
            DONE
        }
        ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            let _ = error.print();
            WRONG_USAGE
        }
        _ => wrong_usage(&parse_sentence(error)),
    }
}

/// Tells that the program was used wrongly, and how.
fn wrong_usage(sentence: &str) -> u8 {
    tell("error", sentence);
    WRONG_USAGE
}

/// Prints one sentence beside the output: an `error` or a `note`.
fn tell(kind: &str, sentence: impl Display) {
    // Nobody is left to tell if that fails.
    let _ = writeln!(io::stderr(), "{kind}: {}", printable(&sentence.to_string()));
}

/// A line without control characters, which may come from whatever is decoded or named, and could
/// steer a terminal. They are written as in JSON, so that JSON keeps its meaning.
fn printable(line: &str) -> String {
    let mut shown = String::with_capacity(line.len());
    for character in line.chars() {
        if character.is_control() {
            shown.push_str(&format!("\\u{:04x}", u32::from(character)));
        } else {
            shown.push(character);
        }
    }
    shown
}

/// What the parser found, without the usage that it prints below.
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
    words.join(" ").trim_start_matches("error: ").replace(" tip: ", "; ")
}

/// Prints a line. `Ok(false)` if whoever reads it has left, which is no error: `… | head`.
fn print_line(out: &mut impl Write, line: &str) -> io::Result<bool> {
    match writeln!(out, "{}", printable(line)).and_then(|()| out.flush()) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(false),
        Err(error) => Err(error),
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
}
