//! The subcommands that work on motors: those that only read take simulated ones unless a bus is named.
//!
//! What moves a motor or writes its memory goes through [`session`], which asks first, and through
//! [`moving`], which stops the motor whatever ends the command early.

mod brake;
mod change_id;
mod elsewhere;
mod group;
mod halt;
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
use super::interrupt::ENDS_LATER;

/// What can be done with motors.
#[derive(Debug, clap::Subcommand)]
pub(super) enum Subcommand {
    Scan(scan::Arguments),
    /// Tell what motors are: model, software, run time, mode, state and zero
    Info(status::Arguments),
    /// Tell how motors do: angle, speed, currents, temperatures, voltage, brake and errors
    Status(status::Arguments),
    Move(move_to::Arguments),
    Speed(speed::Arguments),
    Torque(torque::Arguments),
    Motion(motion::Arguments),
    /// Stop motors at once (0x81): they hold still
    ///
    /// For 250 ms after that it is seen whether another program goes on commanding them: one that does so less often
    /// than that passes unnoticed. Exit status: 1 if one of them has not confirmed, goes on turning, or does not hold:
    /// it reports an error, runs nothing, or does not tell.
    #[command(after_help = format!("{}\n\n{ENDS_LATER}\n\n{}", halt::OF_ALL, moving::HOLDS))]
    Stop(session::Motors),
    /// Switch motors off at once (0x80): their shafts are free unless brakes hold them
    ///
    /// A brake takes some 50 to 150 ms to lock: where a load could fall, 'myactuator stop' and 'myactuator brake lock' come
    /// before it. For 250 ms after that it is seen whether another program commands them, which switches them on again:
    /// one that does so less often than that passes unnoticed.
    #[command(after_help = format!("{}\n\n{ENDS_LATER}", halt::OF_ALL))]
    Shutdown(session::Motors),
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
        Subcommand::Stop(arguments) => halt::stop(arguments),
        Subcommand::Shutdown(arguments) => halt::shut_down(arguments),
        Subcommand::Brake(arguments) => brake::run(arguments),
        Subcommand::Zero(arguments) => zero::run(arguments),
        Subcommand::Id(arguments) => change_id::run(arguments),
        Subcommand::Reset(arguments) => reset::run(arguments),
        Subcommand::Timeout(arguments) => timeout::run(arguments),
        Subcommand::Send(arguments) => send::run(arguments),
    }
}
