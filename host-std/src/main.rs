//! The program `myactuator`: frames of MyActuator servo motors on the command line.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::run()
}
