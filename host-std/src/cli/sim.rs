//! `myactuator sim`: simulated drives for other programs, in real time.

mod control;
mod folders;
mod log;
mod options;
mod places;
mod serving;
mod short_form;

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use myactuator_host_std::open::BusAddress;
use myactuator_host_std::sim::plant::MotorParameters;
use myactuator_host_std::sim::{PlannedFault, Robot, RobotBus};
use myactuator_host_std::text::slcan::Rate;
use myactuator_protocol_core::command::MotionRanges;
use myactuator_protocol_core::{Firmware, MotorId};

use super::arguments as parse;
use super::{Outcome, Unfinished};
use serving::Served;

/// Options that are refused with a file, because the file says this.
const SAID_BY_A_FILE: [&str; 11] = [
    "count",
    "same_id",
    "model",
    "firmware",
    "ranges",
    "brakes",
    "quirks",
    "faults",
    "bit_rate",
    "rs485_rate",
    "can",
];

/// The words of --fault and --quirk, for the help.
const FAULTS: &str = "\
Faults: KIND[=VALUE][@WHERE][?CONDITION][+TIME]
  lose=0.01                 a frame does not arrive; 0.01 is its chance, from 0 to 1
  corrupt=0.01              a bit is disturbed: CAN repeats the frame, RS485 delivers it
  undetected=0.01           the share of corrupted CAN frames that arrive with a wrong bit
  duplicate=0.01            a frame arrives twice
  delay=0.01:1ms..5ms       a frame arrives late by this much, and those after it wait
  reorder=0.01              a frame arrives after the next one
  babble=10ms               the drive sends random frames at this interval
  slow=2ms                  the drive answers later by this much
  cut, mend                 its wire is cut; cut, slow and babble end
  reset                     its power is cycled
  stall, under-voltage, over-voltage, over-current, over-power, calibration-write,
  over-speed, component-over-temperature, motor-over-temperature,
  encoder-calibration, encoder-data
                            the drive has this error
  clear                     removes the causes of these errors
The first six and babble have the values shown if none is given.
@WHERE: a motor's id, else all; for the first six also to-drives or from-drives,
  or both: lose=0.1@2,from-drives
+TIME: this long after the start: cut@1+5s mend@1+8s. Times in us, ms or s.
?CONDITION: once, as soon as the motor is beyond something, angle (deg), speed (dps),
  current (A), temperature (of the winding, in degrees Celsius) or voltage (V):
  \"cut@1?angle>90\" \"stall@2?speed<-10\", in quotes for the shell

Quirks: behaviour of real drives that differs from the manual
  slow-boot                 hears nothing for 1.1 s after a restart
  slow-brake                the brake opens, and locks, 50 to 150 ms late
  lost-master-heartbeat     0xF1 once a second after a loss of communication, and the
                            first command then is echoed and ignored
  silent-id-change          function 5 has its effect but no reply
  turns-lost                turns are lost at a restart, even with function 4 on
  rom-needs-shutdown        0x20, 0x32 and 0xB4 change nothing unless shut down (0x80)
  repeats-last-reply        an unknown command is answered with the last reply once more
  answers-as-new-id         after function 5 it answers under the new id at once, and hears
                            only the old one until it restarts
  brake-told-by-motion      0x9A says release only while the drive obeys a motion command
  silent-while-reporting    nothing at all is answered while active reply (0xB6) is on
  broadcast-slots           answers to all (RS485, 0xCD) come one after the other
  slow-rom                  replies to commands that store come 15 ms later (an estimate)
  bursts                    adapters hand over what they receive every 16 ms, as many on USB do
  echo                      the RS485 adapter echoes what is sent
  echo-noise                the same, with a random byte now and then";

/// Serve simulated drives to other programs, in real time
///
/// Without a file there are two buses: an RS485 line on a pseudo-terminal, and a CAN bus on another one, which speaks
/// SLCAN. Each has its own drives, with the same ids. A file has any number of buses, each with its own drives.
/// What drives ignore, refuse or suffer is reported on the standard error. Ctrl-C ends it.
///
/// Exit status: 0 served until a signal, 1 not, 2 wrong usage.
#[derive(Debug, Args)]
#[command(after_help = FAULTS)]
pub(super) struct Arguments {
    /// A robot: its buses, and the motors on each, with their models, loads and faults. README.md shows one; the
    /// documentation of `sim::Robot` lists all keys
    #[arg(value_name = "ROBOT.toml", conflicts_with_all = SAID_BY_A_FILE, conflicts_with = "only")]
    robot: Option<PathBuf>,
    /// How many motors on each bus, with ids from 1
    #[arg(long, value_name = "N", default_value_t = 4,
          value_parser = clap::value_parser!(u8).range(1..=MotorId::COUNT as i64))]
    count: u8,
    /// Give all of them this id instead; new motors have 1
    #[arg(long, value_name = "ID", value_parser = parse::motor_id)]
    same_id: Option<MotorId>,
    /// Their model: a name, or a file of your own whose name ends in .toml [default: RMD-X6-P20-60]
    #[arg(long, value_name = "NAME|FILE.toml", value_parser = options::model)]
    model: Option<MotorParameters>,
    /// The revision of the protocol that they speak: v4.3 or v4.4 [default: the model's]
    #[arg(long, value_name = "REVISION", value_parser = parse::firmware)]
    firmware: Option<Firmware>,
    /// The scales of their motion mode, the largest position, velocity, kp, kd and torque, as in
    /// 12.566,45,500,5,60 [default: the model's or the firmware's; v4.4 has none of its own]
    #[arg(long, value_name = "RANGES", value_parser = parse::ranges)]
    ranges: Option<MotionRanges>,
    /// Give them brakes, which are locked at first
    #[arg(long)]
    brakes: bool,
    /// Behaviour that differs from the manual, see below; may be repeated
    #[arg(long = "quirk", value_name = "NAME", value_parser = options::quirk)]
    quirks: Vec<String>,
    /// Something that goes wrong, see below; may be repeated
    #[arg(long = "fault", value_name = "FAULT")]
    faults: Vec<PlannedFault>,
    /// The seed of all that is random [default: the file's, or 1]
    #[arg(long, value_name = "NUMBER")]
    seed: Option<u64>,
    /// Keep the settings of the drives, and the angles of their shafts, here from one run to the next [default: nowhere]
    #[arg(long, value_name = "FOLDER")]
    memory: Option<PathBuf>,
    /// Bit rate of the CAN bus, bit/s
    #[arg(long, value_name = "RATE", default_value = "1000000")]
    bit_rate: Rate,
    /// Bit rate of the RS485 line, bit/s
    #[arg(long, value_name = "RATE", default_value = "1000000", value_parser = BusAddress::line_rate)]
    rs485_rate: u32,
    /// Serve the CAN bus on this interface as well, such as vcan0; never on one with real motors
    #[arg(long, value_name = "INTERFACE")]
    can: Option<String>,
    /// Serve the drives in this way only
    #[arg(long, value_enum, value_name = "WAY")]
    only: Option<Way>,
    /// Make links to the pseudo-terminals in this folder, with the same names in every run: rs485 and slcan, or the
    /// names of the file's buses. A link that another simulation has is refused
    #[arg(long, value_name = "FOLDER")]
    link: Option<PathBuf>,
    #[command(flatten)]
    control: control::Options,
    /// Print where the drives are, and what happens in them, as one JSON object a line
    #[arg(long)]
    json: bool,
}

/// A way to the drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Way {
    /// RS485 on a pseudo-terminal
    Rs485,
    /// CAN through an SLCAN adapter on a pseudo-terminal
    Slcan,
    /// CAN on the interface of --can
    Can,
}

/// Serves until a signal ends it.
pub(super) fn run(arguments: &Arguments) -> Outcome {
    let served = match &arguments.robot {
        Some(file) => from_file(file, arguments.seed)?,
        None => short_form::buses(arguments)?,
    };
    serving::serve(served, arguments).map_err(|error| Unfinished::Failed(error.to_string()))
}

/// The buses of a file, each on a pseudo-terminal with its name.
fn from_file(file: &Path, seed: Option<u64>) -> Result<Vec<Served>, String> {
    let mut robot = Robot::from_file(file).map_err(|error| error.to_string())?;
    if let Some(seed) = seed {
        robot = robot.seed(seed);
    }
    let served = |bus: RobotBus| Served { link: Some(bus.name().to_owned()), bus };
    Ok(robot.buses.into_iter().map(served).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use myactuator_protocol_core::command::ErrorFlags;

    #[test]
    fn the_help_names_every_quirk_and_every_error() {
        let words: Vec<&str> = FAULTS.split([' ', '\n', ',', '=']).collect();
        for name in options::quirk_names() {
            assert!(words.contains(&name.as_str()), "{name}");
        }
        for error in ErrorFlags::NAMED {
            assert!(words.contains(&error.name().unwrap()), "{error:?}");
        }
    }
}
