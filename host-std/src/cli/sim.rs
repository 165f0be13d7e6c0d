//! `myactuator sim`: simulated drives for other programs, in real time.

mod folders;
mod log;
mod options;
mod places;

use std::error::Error;
use std::io;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::sync::Arc;

use clap::{Args, ValueEnum};
use myactuator_host_std::open::{BusAddress, Echo};
use myactuator_host_std::serve::{Notice, PlannedFault, Server};
use myactuator_host_std::sim::Fleet;
use myactuator_host_std::sim::bus::rs485::TransceiverConfig;
use myactuator_host_std::sim::plant::MotorParameters;
use myactuator_host_std::text::slcan::Rate;
use myactuator_protocol_core::command::MotionRanges;
use myactuator_protocol_core::master::MotorSet;
use myactuator_protocol_core::{Firmware, MotorId};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use super::arguments as parse;
use super::{FAILED, Outcome, Unfinished, interrupt, print_line, tell};
use folders::{Links, MemoryFolder};
use log::LogPrinter;
use places::Place;

/// How likely an adapter with `echo-noise` hears a byte that nobody sent, each time it switches.
const ECHO_NOISE: f32 = 0.1;

/// What is wrong can be said in one word, and this is how.
const FAULTS: &str = "\
Faults: KIND[=VALUE][@WHERE][+TIME]
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

Quirks: what drives were seen to do beside the manual
  slow-boot                 deaf for 1.1 s after a restart
  slow-brake                the brake opens 50 to 150 ms late
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
  echo                      the RS485 adapter hands back what is sent
  echo-noise                it does so, and now and then a random byte with it";

/// Serve simulated drives to other programs, in real time
///
/// The drives are on an RS485 line behind a pseudo-terminal, and on a CAN bus behind another one that
/// speaks SLCAN. Those on RS485 and those on CAN are different drives with the same ids. What they
/// ignore, refuse or suffer is told on the standard error. Ends with Ctrl-C.
#[derive(Debug, Args)]
#[command(after_help = FAULTS)]
pub(super) struct Arguments {
    /// How many motors on each bus, with ids from 1
    #[arg(long, value_name = "N", default_value_t = 4,
          value_parser = clap::value_parser!(u8).range(1..=MotorId::COUNT as i64))]
    count: u8,
    /// All with this id instead, as motors come from the factory with 1
    #[arg(long, value_name = "ID", value_parser = parse::motor_id)]
    same_id: Option<MotorId>,
    /// Their model: a name, or a file of your own that ends in .toml [default: RMD-X8-PRO]
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
    /// Where all chance comes from
    #[arg(long, value_name = "NUMBER", default_value_t = 1)]
    seed: u64,
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
    /// Make links rs485 and slcan to the pseudo-terminals in this folder, the same in every run; one
    /// that another simulation has is refused
    #[arg(long, value_name = "FOLDER")]
    link: Option<PathBuf>,
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

type Failure = Box<dyn Error>;

/// Serves until it is told to stop.
pub(super) fn run(arguments: &Arguments) -> Outcome {
    check(arguments)?;
    serve(arguments).map_err(|error| Unfinished::Failed(error.to_string()))
}

fn check(arguments: &Arguments) -> Result<(), String> {
    match (arguments.only, &arguments.can) {
        (Some(Way::Can), None) => Err("--only can needs --can with the interface's name"),
        (Some(Way::Rs485 | Way::Slcan), Some(_)) => {
            Err("--can serves an interface, but --only leaves it out: drop one of them")
        }
        _ => Ok(()),
    }?;
    let has_ranges = |firmware: Firmware| firmware.motion_ranges().or(arguments.ranges).is_some();
    if !arguments.firmware.is_none_or(has_ranges) {
        return Err(parse::RANGES_ARE_MISSING.into());
    }
    let motors = arguments.motors();
    let mut named = arguments.faults.iter().filter_map(|fault| fault.motor);
    match named.find(|&motor| !motors.contains(motor)) {
        Some(motor) => Err(format!("--fault names motor {motor}, but the motors are {motors}")),
        None => Ok(()),
    }
}

impl Arguments {
    /// The ids that there are.
    fn motors(&self) -> MotorSet {
        match self.same_id {
            Some(id) => id.into(),
            None => MotorId::all().take(self.count.into()).collect(),
        }
    }
}

fn serve(arguments: &Arguments) -> Result<(), Failure> {
    // First of all, so that no signal finds half a simulation.
    let stop = stop_signal()?;
    let wanted = |way| arguments.only.is_none_or(|only| only == way);
    let memory = arguments.memory.as_deref().map(MemoryFolder::open).transpose()?;
    let fleet = |bus| -> Result<Fleet, Failure> {
        let mut fleet = Fleet::new(arguments.count)
            .quirks(options::drives_quirks(&arguments.quirks)?)
            .seed(arguments.seed)
            .brakes(arguments.brakes);
        if let Some(id) = arguments.same_id {
            fleet = fleet.all_with_id(id);
        }
        if let Some(model) = &arguments.model {
            fleet = fleet.model(model.clone());
        }
        if let Some(firmware) = arguments.firmware {
            fleet = fleet.firmware(firmware);
        }
        if let Some(ranges) = arguments.ranges {
            fleet = fleet.motion_ranges(ranges);
        }
        match &memory {
            Some(memory) => Ok(fleet.memory_folder(memory.of(bus)?)),
            None => Ok(fleet),
        }
    };
    let mut server = Server::new();
    server.plan(arguments.faults.iter().copied());
    let mut links = Links::in_folder(arguments.link.as_deref())?;
    let mut places = Vec::new();
    if wanted(Way::Rs485) {
        let bit_rate = arguments.rs485_rate;
        let line = fleet("rs485")?.on_rs485(bit_rate)?;
        let adapter = transceiver(&arguments.quirks);
        let path = server.serve_line(&line, adapter)?;
        let link = links.add("rs485", &path)?;
        let echo = if adapter.echo { Echo::Present } else { Echo::Unknown };
        let address = |path| BusAddress::Rs485 { path, bit_rate, echo };
        places.push(Place::on_terminal(address, path, link, bit_rate));
    }
    let interface = arguments.can.as_ref().filter(|_| wanted(Way::Can));
    if wanted(Way::Slcan) || interface.is_some() {
        let rate = arguments.bit_rate;
        let bit_rate = rate.bits_per_second();
        let bus = fleet("can")?.on_can(bit_rate)?;
        server.host_can(&bus);
        if wanted(Way::Slcan) {
            let path = server.serve_adapter(&bus)?;
            let link = links.add("slcan", &path)?;
            let address = |path| BusAddress::Slcan { path, rate };
            places.push(Place::on_terminal(address, path, link, bit_rate));
        }
        if let Some(interface) = interface {
            server.serve_interface(&bus, interface)?;
            places.push(Place::on_interface(interface, bit_rate));
        }
    }
    for line in places::lines(&places, arguments.motors(), arguments.json) {
        match print_line(&line) {
            // Whoever reads may leave; the drives stay.
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => break,
            printed => printed?,
        }
    }
    let mut log = LogPrinter::new(arguments.json);
    server.run(stop, |notice| {
        let remedy = match notice {
            Notice::Log(record) => return log.print(&record),
            Notice::WrongRate { asked, .. } => {
                format!(", or start with --bit-rate {}", asked.bits_per_second())
            }
            _ => String::new(),
        };
        tell("note", format_args!("{notice}{remedy}"));
    })?;
    Ok(())
}

fn transceiver(quirks: &[String]) -> TransceiverConfig {
    let has = |name: &str| quirks.iter().any(|quirk| quirk == name);
    let has_noise = has(options::ECHO_NOISE);
    TransceiverConfig {
        echo: has_noise || has(options::ECHO),
        switch_noise: if has_noise { ECHO_NOISE } else { 0.0 },
        ..TransceiverConfig::default()
    }
}

/// Something that can be read as soon as the program is told to stop. Who tells it twice means at
/// once.
fn stop_signal() -> io::Result<UnixStream> {
    let (told, tell) = UnixStream::pair()?;
    let is_told = interrupt::flag();
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        let now = i32::from(FAILED);
        signal_hook::flag::register_conditional_shutdown(signal, now, Arc::clone(&is_told))?;
        signal_hook::flag::register(signal, Arc::clone(&is_told))?;
        signal_hook::low_level::pipe::register(signal, tell.try_clone()?)?;
    }
    Ok(told)
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
