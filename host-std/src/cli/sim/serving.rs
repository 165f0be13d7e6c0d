//! Serves buses until a signal ends it.

use std::error::Error;
use std::io;
use std::os::unix::net::UnixStream;
use std::sync::Arc;

use myactuator_host_std::BusKind;
use myactuator_host_std::open::BusAddress;
use myactuator_host_std::port::PortError;
use myactuator_host_std::serve::{Notice, ServeError, Server};
use myactuator_host_std::sim::RobotBus;
use myactuator_host_std::text::slcan::Rate;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use super::Arguments;
use super::folders::{Links, MemoryFolder};
use super::log::LogPrinter;
use super::places::{self, Place};
use crate::cli::{FAILED, interrupt, print_line, report};

type Failure = Box<dyn Error>;

/// A bus, and how it is offered.
#[derive(Debug)]
pub(super) struct Served {
    pub(super) bus: RobotBus,
    /// The name of the link to its pseudo-terminal; `None` if it has none.
    pub(super) link: Option<String>,
}

pub(super) fn serve(buses: Vec<Served>, arguments: &Arguments) -> Result<(), Failure> {
    // This comes first, so that no signal ends half a simulation.
    let stop = stop_signal()?;
    let is_file = arguments.robot.is_some();
    let memory = arguments.memory.as_deref().map(MemoryFolder::open).transpose()?;
    let mut server = Server::new();
    let mut links = Links::in_folder(arguments.link.as_deref())?;
    let mut places = Vec::new();
    for Served { mut bus, link } in buses {
        if let Some(memory) = &memory {
            bus.fleet = bus.fleet.clone().memory_folder(memory.of(bus.name())?);
        }
        server.hand_over_every(bus.bursts);
        places.extend(match bus.kind {
            BusKind::Rs485 => serve_line(&mut server, &bus, link, &mut links)?,
            BusKind::Can => serve_can(&mut server, &bus, link, &mut links)?,
        });
    }
    let control = arguments.control.apply(&mut server, arguments.json)?;
    let in_lock_step = arguments.control.is_in_lock_step();
    let lines = places::lines(&places, is_file, in_lock_step, arguments.json);
    for line in control.into_iter().chain(lines) {
        match print_line(&line) {
            // The reader may leave; the drives go on.
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => break,
            printed => printed?,
        }
    }
    let mut log = LogPrinter::new(arguments.json);
    server.run(stop, |notice| {
        let remedy = match &notice {
            Notice::Log(record) => return log.print(record),
            Notice::WrongRate { asked, .. } if is_file => {
                format!(", or give the bus bit_rate = {asked} in the file")
            }
            Notice::WrongRate { bus, asked, .. } if bus == "rs485" => {
                format!(", or start with --rs485-rate {asked}")
            }
            Notice::WrongRate { asked, .. } => format!(", or start with --bit-rate {asked}"),
            _ => String::new(),
        };
        report("note", format_args!("{notice}{remedy}"));
    })?;
    Ok(())
}

fn serve_line(
    server: &mut Server,
    bus: &RobotBus,
    link: Option<String>,
    links: &mut Links,
) -> Result<Vec<Place>, Failure> {
    let Some(link) = link else { return Ok(Vec::new()) };
    let adapter = bus.adapter.transceiver();
    let path = server.serve_line(&bus.on_rs485()?, adapter)?;
    let link = links.add(&link, &path)?;
    let (bit_rate, echo) = (bus.bit_rate, adapter.echo);
    let address = |path| BusAddress::Rs485 { path, bit_rate, echo };
    Ok(vec![Place::on_terminal(bus, address, path, link)])
}

fn serve_can(
    server: &mut Server,
    bus: &RobotBus,
    link: Option<String>,
    links: &mut Links,
) -> Result<Vec<Place>, Failure> {
    let fleet = bus.on_can()?;
    server.host_can(&fleet);
    let mut places = Vec::new();
    if let Some(link) = link {
        let rate: Rate = bus
            .bit_rate
            .to_string()
            .parse()
            .map_err(|error| format!("bus \"{}\": bit_rate: {error}", bus.name()))?;
        let path = server.serve_adapter(&fleet)?;
        let link = links.add(&link, &path)?;
        let address = |path| BusAddress::Slcan { path, rate };
        places.push(Place::on_terminal(bus, address, path, link));
    }
    if let Some(interface) = &bus.interface {
        let served = server.serve_interface(&fleet, interface);
        served.map_err(|error| format!("bus \"{}\": {}", bus.name(), not_on_interface(&error)))?;
        places.push(Place::on_interface(bus, interface));
    }
    Ok(places)
}

/// Why a bus is not served on an interface. If it does not exist, says how to make a virtual one.
fn not_on_interface(error: &ServeError) -> String {
    let ServeError::Interface(PortError::NoSuchInterface { name, there }) = error else {
        return error.to_string();
    };
    let there = if there.is_empty() { "none".to_owned() } else { there.join(" ") };
    format!(
        "there is no CAN interface \"{name}\" to serve it on (this machine has {there}): make a virtual one with \
         'sudo ip link add dev {name} type vcan' and 'sudo ip link set {name} up'"
    )
}

/// A stream that becomes readable when a signal asks the program to stop. A second signal ends it at once.
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
