//! The subcommands that work on motors. Those that only read use simulated motors if no bus is named.
//!
//! A command that moves a motor or writes its memory goes through [`session`], which asks first. One that moves also
//! goes through [`moving`], which stops the motor if anything ends the command early.

mod advice;
mod brake;
mod change_id;
mod elsewhere;
mod group;
mod halt;
mod help;
mod hints;
mod motion;
mod move_to;
mod moving;
#[cfg(test)]
mod odd_drive;
mod on_bus;
mod progress;
mod reset;
mod revision;
mod run_for;
mod scan;
mod send;
mod session;
#[cfg(test)]
mod simulated;
mod speed;
mod status;
mod timeout;
mod together;
mod torque;
mod zero;

use super::Outcome;
use help::{HOLDS, OF_ALL, SERIAL, SIGNALS, paragraphs};

/// The subcommands.
#[derive(Debug, clap::Subcommand)]
pub(super) enum Subcommand {
    Scan(scan::Arguments),
    /// Print what motors are: model, software, run time, mode, state and zero
    ///
    /// Exit status: 0 every motor read, 1 not, 2 wrong usage.
    Info(status::Arguments),
    /// Print how motors are: angle, speed, currents, temperatures, voltage, brake and errors
    ///
    /// Exit status: 0 every motor read, 1 not, 2 wrong usage.
    Status(status::Arguments),
    Move(move_to::Arguments),
    Speed(speed::Arguments),
    Torque(torque::Arguments),
    Motion(motion::Arguments),
    /// Stop motors at once (0x81): they hold still
    ///
    /// The motors get the command and must confirm it. For 250 ms after that the program listens whether another program
    /// goes on commanding them; one that sends less often is not noticed. Then it waits until they stand, and asks
    /// whether they hold.
    ///
    /// A motor does not count as stopped if it does not confirm, goes on turning, reports an error, does not answer, or
    /// runs nothing without a locked brake.
    ///
    /// Exit status: 0 stopped, 1 not, 2 wrong usage.
    #[command(after_help = paragraphs([OF_ALL, SERIAL, SIGNALS, HOLDS]))]
    Stop(session::ToStop),
    /// Switch motors off at once (0x80): their shafts are free unless brakes hold them
    ///
    /// The motors get the command and must confirm it. For 250 ms after that the program listens whether another program
    /// commands them, which switches them on again; one that sends less often is not noticed. A motor does not count as
    /// off if it does not confirm, or if another program commands it.
    ///
    /// A brake takes up to 200 ms to lock. Where a load could fall, use 'myactuator stop' and 'myactuator brake lock'
    /// first.
    ///
    /// Exit status: 0 off, 1 not, 2 wrong usage.
    #[command(after_help = paragraphs([OF_ALL, SERIAL, SIGNALS]))]
    Shutdown(session::ToStop),
    Brake(brake::Arguments),
    Zero(zero::Arguments),
    Id(change_id::Arguments),
    Reset(reset::Arguments),
    Timeout(timeout::Arguments),
    Send(send::Arguments),
}

pub(super) fn run(subcommand: &Subcommand) -> Outcome {
    match subcommand {
        Subcommand::Scan(arguments) => scan::run(arguments),
        Subcommand::Info(arguments) => status::info(arguments),
        Subcommand::Status(arguments) => status::status(arguments),
        Subcommand::Move(arguments) => move_to::run(arguments),
        Subcommand::Speed(arguments) => speed::run(arguments),
        Subcommand::Torque(arguments) => torque::run(arguments),
        Subcommand::Motion(arguments) => motion::run(arguments),
        Subcommand::Stop(arguments) => halt::stop(&arguments.motors),
        Subcommand::Shutdown(arguments) => halt::shut_down(&arguments.motors),
        Subcommand::Brake(arguments) => brake::run(arguments),
        Subcommand::Zero(arguments) => zero::run(arguments),
        Subcommand::Id(arguments) => change_id::run(arguments),
        Subcommand::Reset(arguments) => reset::run(arguments),
        Subcommand::Timeout(arguments) => timeout::run(arguments),
        Subcommand::Send(arguments) => send::run(arguments),
    }
}
