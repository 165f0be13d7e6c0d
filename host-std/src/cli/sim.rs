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

/// What a file says, and so no option beside it.
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

/// What is wrong can be said in one word, and this is how.
const FAULTS: &str = "\
Faults: KIND[=VALUE][@WHERE][?CONDITION][+TIME]
  lose=0.01                 a frame does not arrive; 0.01 is its chance, from 0 to 1
  corrupt=0.01              a bit is disturbed: CAN repeats the frame, RS485 delivers it
  undetected=0.01           the share of corrupted CAN frames that arrive with a wrong bit
  duplicate=0.01            a frame arrives twice
  delay=0.01:1ms..5ms       a frame arrives late, by so much
  reorder=0.01              a frame arrives behind the next one
  babble=10ms               the drive sends random frames, so far apart
  slow=2ms                  the drive answers so much later
  cut, mend                 its wire is cut; all is well again (cut, slow and babble)
  reset                     its power is cycled
  stall, under-voltage, over-voltage, over-current, over-power, calibration-write,
  over-speed, component-over-temperature, motor-over-temperature,
  encoder-calibration, encoder-data
                            the drive has this error
  clear                     takes the causes of these errors away
The first six have the values shown unless told otherwise; so has babble.
@WHERE: a motor's id, else all; for the first six also to-drives or from-drives,
  or both: lose=0.1@2,from-drives
+TIME: so long after the start: cut@1+5s mend@1+8s. Times in us, ms or s.
?CONDITION: once, as soon as the motor is beyond something, angle (deg), speed (dps),
  current (A), temperature (of the winding, in degrees Celsius) or voltage (V):
  \"cut@1?angle>90\" \"stall@2?speed<-10\", in quotes for the shell

Quirks: what drives were seen to do beside the manual
  slow-boot                 deaf for 1.1 s after a restart
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
  slow-rom                  replies to what is stored come 15 ms later (an estimate)
  bursts                    adapters hand over what they hear every 16 ms, as many USB adapters do
  echo                      the RS485 adapter hands back what is sent
  echo-noise                it does so, and now and then a random byte with it";

/// Serve simulated drives to other programs, in real time
///
/// Without a file the drives are on an RS485 line behind a pseudo-terminal, and on a CAN bus behind another
/// one that speaks SLCAN. Those on RS485 and those on CAN are different drives with the same ids. A file has
/// any number of buses, each with its own drives. What drives ignore, refuse or suffer is reported on the standard
/// error. Ends with Ctrl-C.
#[derive(Debug, Args)]
#[command(after_help = FAULTS)]
pub(super) struct Arguments {
    /// A robot: its buses, and the motors on each, with their models, loads and faults. README.md shows one, and the
    /// documentation of `sim::Robot` has all keys
    #[arg(value_name = "ROBOT.toml", conflicts_with_all = SAID_BY_A_FILE, conflicts_with = "only")]
    robot: Option<PathBuf>,
    /// How many motors on each bus, with ids from 1
    #[arg(long, value_name = "N", default_value_t = 4,
          value_parser = clap::value_parser!(u8).range(1..=MotorId::COUNT as i64))]
    count: u8,
    /// All with this id instead, as motors come from the factory with 1
    #[arg(long, value_name = "ID", value_parser = parse::motor_id)]
    same_id: Option<MotorId>,
    /// Their model: a name, or a file of your own that ends in .toml [default: RMD-X6-P20-60]
    #[arg(long, value_name = "NAME|FILE.toml", value_parser = options::model)]
    model: Option<MotorParameters>,
    /// The revision of the protocol that they speak: v4.3 or v4.4 [default: the model's]
    #[arg(long, value_name = "REVISION", value_parser = parse::firmware)]
    firmware: Option<Firmware>,
    /// The scales of their motion mode, the largest position, velocity, kp, kd and torque, as in
    /// 12.566,45,500,5,60 [default: the model's or the firmware's; v4.4 has none of its own]
    #[arg(long, value_name = "RANGES", value_parser = parse::ranges)]
    ranges: Option<MotionRanges>,
    /// With brakes, locked at first
    #[arg(long)]
    brakes: bool,
    /// Behaviour beside the manual, see below; as often as you like
    #[arg(long = "quirk", value_name = "NAME", value_parser = options::quirk)]
    quirks: Vec<String>,
    /// What goes wrong, see below; as often as you like
    #[arg(long = "fault", value_name = "FAULT")]
    faults: Vec<PlannedFault>,
    /// Where all chance comes from [default: the file's, or 1]
    #[arg(long, value_name = "NUMBER")]
    seed: Option<u64>,
    /// Where drives keep their settings, and where their shafts are, from one run to the next [default: nowhere]
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
    /// Serve one way only
    #[arg(long, value_enum, value_name = "WAY")]
    only: Option<Way>,
    /// Make links to the pseudo-terminals in this folder, the same in every run: rs485 and slcan, or the names
    /// of the file's buses; one that another simulation has is refused
    #[arg(long, value_name = "FOLDER")]
    link: Option<PathBuf>,
    #[command(flatten)]
    control: control::Options,
    /// Tell where they are, and what happens in them, as one JSON object a line
    #[arg(long)]
    json: bool,
}

/// A way to the drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Way {
    /// RS485 on a pseudo-terminal
    Rs485,
    /// CAN behind an SLCAN adapter on a pseudo-terminal
    Slcan,
    /// CAN on the interface of --can
    Can,
}

/// Serves until it is told to stop.
pub(super) fn run(arguments: &Arguments) -> Outcome {
    let served = match &arguments.robot {
        Some(file) => from_file(file, arguments.seed)?,
        None => short_form::buses(arguments)?,
    };
    serving::serve(served, arguments).map_err(|error| Unfinished::Failed(error.to_string()))
}

/// The buses of a file, all behind pseudo-terminals with their names.
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
