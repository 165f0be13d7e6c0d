//! Simulated drives in real time, for other programs: on serial ports and CAN interfaces.
//!
//! This module stands above [`sim`](crate::sim), which it runs against the wall clock, and
//! [`port`](crate::port), on whose CAN interface it puts the drives.
//!
//! A [`Server`] takes fleets and opens ways to them:
//!
//! | way | what programs find there |
//! |---|---|
//! | [`serve_line`](Server::serve_line) | a pseudo-terminal that is an RS485 adapter |
//! | [`serve_adapter`](Server::serve_adapter) | a pseudo-terminal that is an SLCAN adapter |
//! | [`serve_interface`](Server::serve_interface) | the drives on a CAN interface of Linux |
//!
//! If an emulator has the other end, a socket replaces either pseudo-terminal:
//! [`serve_line_on`](Server::serve_line_on), [`serve_adapter_on`](Server::serve_adapter_on).
//!
//! An adapter and an interface lead to the same CAN bus: what is sent on one is heard on the other.
//!
//! Bytes take time only on the simulated bus, but the bit rate of a program counts:
//! - **RS485 line:** the rate to which a program sets the pseudo-terminal. Until then that is the line's rate. A socket
//!   has none.
//! - **SLCAN adapter:** the rate at which a program opens the adapter. Its pseudo-terminal may be set to any rate.
//!
//! With another rate than the bus's, the program is a station at that rate. It finds the drives that were set to it
//! (0xB4); with the others there is noise on RS485, and there are errors on CAN.
//!
//! What drives do, and why they do not, is reported as [`Notice::Log`]. With [`control`] programs see the true state,
//! change loads, supplies and faults, and say how far time may go.
//!
//! One thread waits for all programs and for the next event on a bus, and sleeps meanwhile.

mod adapter;
mod claim;
pub mod control;
mod hosted;
mod interface_end;
mod line_end;
mod lock_step;
mod oversleep;
mod pty;

use std::fmt::Debug;
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::master::MotorSet;
use myactuator_protocol_core::time;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

use crate::port::{PortError, SocketCan};
use crate::sim::bus::can::ControllerConfig;
use crate::sim::bus::rs485::{SerialError, TransceiverConfig};
use crate::sim::{CanFleet, LineFleet, LogRecord};

use adapter::AdapterEnd;
use control::{Control, Request, Scene};
use hosted::{Host, Hosted};
use interface_end::InterfaceEnd;
use line_end::LineEnd;
use lock_step::Advance;
use oversleep::Oversleep;
use pty::Pty;

pub use claim::Claim;

/// The longest wait: the drives move, and simulated time must not fall behind.
const LONGEST_WAIT: Duration = Duration::from_millis(100);
/// If a wait takes too long, the drives catch up, unless it is by more than this: then the process was
/// stopped, or the computer is too slow.
const LONGEST_LAG: Duration = Duration::from_millis(500);
/// The controller of a simulated USB adapter, with the frames that it queues for the bus.
const ADAPTER: ControllerConfig =
    ControllerConfig { transmit_queue: 64, ..ControllerConfig::SOCKETCAN };

/// A connection of a port of a simulated bus and another program.
trait End: Debug {
    /// What to wait for, while more of the program's bytes are wanted.
    fn source(&self) -> Option<BorrowedFd<'_>>;

    /// From now on time stands between a client's steps, and what programs write counts only when it was
    /// [taken in](Self::take_in).
    fn hold(&mut self);

    /// Takes in all that programs have written.
    fn take_in(&mut self) -> Result<(), ServeError>;

    /// Whether it answers programs on its own, also while time stands.
    fn answers_at_once(&self) -> bool {
        false
    }

    /// Carries all that waits, both ways.
    fn pump(&mut self, notify: &mut dyn FnMut(Notice)) -> Result<(), ServeError>;

    /// After how long to pump again at the latest; `None` if nothing requires it.
    fn patience(&mut self) -> Option<Duration>;
}

/// Serves fleets of simulated drives to other programs. See the [module](self).
#[derive(Debug, Default)]
pub struct Server {
    hosts: Vec<Box<dyn Hosted>>,
    ends: Vec<Box<dyn End>>,
    /// How often adapters hand over what they hear.
    bursts: time::Duration,
    control: Option<Control>,
    is_in_lock_step: bool,
    advance: Option<Advance>,
    oversleep: Oversleep,
}

/// News for the user of a server.
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Notice {
    /// Something happened in a drive. A server takes the events of its drives, so nothing else can poll them.
    #[error("{0}")]
    Log(LogRecord),
    /// The process was stopped or the computer was busy: simulated time has skipped so much.
    #[error(
        "simulated time stood still for {:.1} s: the program was stopped, or the computer is too slow \
         for so many drives",
        .0.as_secs_f64()
    )]
    LeftOut(Duration),
    /// A program speaks at another bit rate than the bus has.
    #[error(
        "a program speaks at {asked} bit/s, but the simulated bus \"{bus}\" runs at {bit_rate}: only drives \
         that were set to its rate (0xB4) understand it; for the others set it to {bit_rate}"
    )]
    WrongRate {
        /// The name of the bus.
        bus: String,
        /// The program's bit rate, in bit/s.
        asked: u32,
        /// The bus's, in bit/s.
        bit_rate: u32,
    },
    /// A drive remembers a bit rate that is not its bus's.
    #[error(
        "motor {motor} of the bus \"{bus}\" was set to {bit_rate} bit/s (0xB4), and the bus runs at \
         {bus_rate}: it answers only at its own rate"
    )]
    OwnRate {
        /// The name of the bus.
        bus: String,
        /// The drive.
        motor: MotorId,
        /// Its bit rate, in bit/s.
        bit_rate: u32,
        /// What the bus has, in bit/s.
        bus_rate: u32,
    },
    /// The mechanics that move the shafts of a bus have failed.
    #[error("the shafts of bus \"{bus}\" stand: {reason}")]
    ShaftsStand {
        /// The name of the bus.
        bus: String,
        /// Why.
        reason: String,
    },
    /// The bus of the CAN interface carries nothing, so the frames of the drives are lost.
    #[error("replies are lost: {0}")]
    Outage(PortError),
}

/// Why drives cannot be served, or no longer.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The operating system refuses a pseudo-terminal, one fails, or the program of a socket has gone.
    #[error("no pseudo-terminal to serve: the operating system reports: {0}")]
    Terminal(#[from] io::Error),
    /// The CAN interface cannot be opened or has failed.
    #[error("{0}")]
    Interface(#[from] PortError),
    /// These drives could not store what they keep while off: the name of each bus, and its motors.
    #[error(
        "{} could not store their settings and turns: check the folder's permissions and room",
        .0.iter().map(|(bus, motors)| format!("motors {motors} of \"{bus}\"")).collect::<Vec<_>>().join(", ")
    )]
    NotStored(Vec<(String, MotorSet)>),
    /// The control socket cannot be made, or another simulation has it.
    #[error("{0}")]
    Control(String),
}

impl From<SerialError> for ServeError {
    fn from(error: SerialError) -> Self {
        Self::Terminal(io::Error::new(io::ErrorKind::TimedOut, error))
    }
}

impl Server {
    /// A server that serves nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Makes adapters that are served from now on hand over what they hear in bursts, only at multiples of this period,
    /// as USB adapters do.
    pub fn hand_over_every(&mut self, period: time::Duration) {
        self.bursts = period;
    }

    /// Serves drives on an RS485 line, through an adapter with these properties. Returns the path of its
    /// serial port.
    ///
    /// # Errors
    /// [`ServeError::Terminal`].
    pub fn serve_line(
        &mut self,
        fleet: &LineFleet,
        transceiver: TransceiverConfig,
    ) -> Result<PathBuf, ServeError> {
        let (pty, path) = Pty::open(fleet.bit_rate)?;
        self.add_line(fleet, transceiver, pty);
        Ok(path)
    }

    /// As [`serve_line`](Self::serve_line), with a socket in place of the serial port, for an emulator.
    /// Serving ends when the other end is closed.
    ///
    /// # Errors
    /// [`ServeError::Terminal`].
    pub fn serve_line_on(
        &mut self,
        fleet: &LineFleet,
        transceiver: TransceiverConfig,
        stream: UnixStream,
    ) -> Result<(), ServeError> {
        self.add_line(fleet, transceiver, Pty::on(stream)?);
        Ok(())
    }

    fn add_line(&mut self, fleet: &LineFleet, transceiver: TransceiverConfig, pty: Pty) {
        let port = fleet.world.port_with(transceiver);
        fleet.world.hand_over_every(port.station(), self.bursts);
        self.hosts.push(Box::new(Host::new(fleet)));
        self.ends.push(Box::new(LineEnd::new(pty, port, fleet)));
    }

    /// Takes drives on a CAN bus, to serve them through adapters and interfaces. They also run without one.
    pub fn host_can(&mut self, fleet: &CanFleet) {
        self.hosts.push(Box::new(Host::new(fleet)));
    }

    /// Serves [hosted](Self::host_can) drives through an SLCAN adapter. Returns the path of its serial port.
    ///
    /// # Errors
    /// [`ServeError::Terminal`].
    pub fn serve_adapter(&mut self, fleet: &CanFleet) -> Result<PathBuf, ServeError> {
        let (pty, path) = Pty::open(fleet.bit_rate)?;
        self.add_adapter(fleet, ADAPTER, pty);
        Ok(path)
    }

    /// As [`serve_adapter`](Self::serve_adapter), through an adapter with this controller, and with a socket in place
    /// of the serial port, for an emulator. Serving ends when the other end is closed.
    ///
    /// # Errors
    /// [`ServeError::Terminal`].
    pub fn serve_adapter_on(
        &mut self,
        fleet: &CanFleet,
        controller: ControllerConfig,
        stream: UnixStream,
    ) -> Result<(), ServeError> {
        self.add_adapter(fleet, controller, Pty::on(stream)?);
        Ok(())
    }

    fn add_adapter(&mut self, fleet: &CanFleet, controller: ControllerConfig, pty: Pty) {
        let port = fleet.world.port_with(controller);
        fleet.world.hand_over_every(port.station(), self.bursts);
        self.ends.push(Box::new(AdapterEnd::new(pty, port, &fleet.name, fleet.bit_rate)));
    }

    /// Serves [hosted](Self::host_can) drives on a CAN interface. On a real interface they answer beside
    /// whatever else is there: make sure that no motor there has the same id.
    ///
    /// # Errors
    /// [`ServeError::Interface`].
    pub fn serve_interface(&mut self, fleet: &CanFleet, interface: &str) -> Result<(), ServeError> {
        let socket = SocketCan::open(interface)?;
        self.ends.push(Box::new(InterfaceEnd::new(socket, fleet.world.port())));
        Ok(())
    }

    /// Lets programs observe the drives and change their surroundings, through a Unix socket at this path; see
    /// [`control`]. The socket is removed at the end.
    ///
    /// # Errors
    /// [`ServeError::Control`]; also if another simulation has the socket.
    pub fn control_at(&mut self, path: &Path) -> Result<(), ServeError> {
        self.control = Some(Control::open(path).map_err(ServeError::Control)?);
        Ok(())
    }

    /// Makes time stand still, except for the steps that a client at the [control socket](Self::control_at)
    /// [asks for](control#lock-step).
    pub fn in_lock_step(&mut self) {
        self.is_in_lock_step = true;
    }

    /// Serves until there is something to read from `stop`, or it is closed. Then switches the supply of the drives
    /// off.
    ///
    /// # Errors
    /// [`ServeError`] as soon as a connection is gone for good, or [`ServeError::NotStored`] at the end.
    pub fn run(
        mut self,
        stop: impl AsFd,
        mut notify: impl FnMut(Notice),
    ) -> Result<(), ServeError> {
        let served = self.serve(stop.as_fd(), &mut notify);
        let mut not_stored = Vec::new();
        for host in &self.hosts {
            let motors: MotorSet = host.power_off().into_iter().collect();
            if !motors.is_empty() {
                not_stored.push((host.name().to_owned(), motors));
            }
        }
        match served {
            Ok(()) if !not_stored.is_empty() => Err(ServeError::NotStored(not_stored)),
            served => served,
        }
    }

    fn serve(
        &mut self,
        stop: BorrowedFd<'_>,
        notify: &mut dyn FnMut(Notice),
    ) -> Result<(), ServeError> {
        for host in &self.hosts {
            host.report_rates(notify);
        }
        if self.control.is_some() {
            self.hosts.iter().for_each(|host| host.count_traffic());
        }
        if self.is_in_lock_step {
            return self.serve_in_steps(stop, notify);
        }
        self.follow_wall_clock();
        loop {
            let round = Instant::now();
            self.pump(notify)?;
            self.report_log(notify);
            self.answer_requests(notify)?;
            let wait = self.patience();
            if self.wait(stop, wait)? {
                return Ok(());
            }
            let lag = round.elapsed().saturating_sub(wait);
            if lag > LONGEST_LAG {
                self.follow_wall_clock();
                notify(Notice::LeftOut(lag));
            }
        }
    }

    fn follow_wall_clock(&self) {
        for host in &self.hosts {
            host.follow_wall_clock();
        }
    }

    /// The time of the drives.
    fn now(&self) -> time::Instant {
        self.hosts.first().map_or(time::Instant::ZERO, |host| host.now())
    }

    fn pump(&mut self, notify: &mut dyn FnMut(Notice)) -> Result<(), ServeError> {
        self.ends.iter_mut().try_for_each(|end| end.pump(notify))
    }

    fn report_log(&mut self, notify: &mut dyn FnMut(Notice)) {
        for host in &mut self.hosts {
            if let Some(reason) = host.poll_mechanics_failure() {
                notify(Notice::ShaftsStand { bus: host.name().to_owned(), reason });
            }
        }
        for record in self.hosts.iter_mut().flat_map(|host| host.poll_log()) {
            if let Some(control) = &mut self.control {
                control.report(&record);
            }
            notify(Notice::Log(record));
        }
    }

    /// Carries out the next request of each program at the control socket.
    fn answer_requests(&mut self, notify: &mut dyn FnMut(Notice)) -> Result<(), ServeError> {
        let Some(mut control) = self.control.take() else { return Ok(()) };
        control.admit();
        let requests = control.next_requests();
        if !requests.is_empty() && self.is_in_lock_step {
            self.take_in(notify)?;
        }
        for (client, request) in requests {
            let mut scene = Scene { hosts: &mut self.hosts };
            let answer = match request {
                Ok(Request::Advance { us, until_us }) => {
                    match self.begin_advance(client, us, until_us) {
                        Ok(()) => continue,
                        Err(sentence) => Err(sentence),
                    }
                }
                Ok(request) => {
                    if request == (Request::Log {}) {
                        control.report_log_to(client);
                    }
                    scene.carry_out(request)
                }
                Err(sentence) => Err(sentence),
            };
            control.answer(client, answer);
        }
        self.control = Some(control);
        Ok(())
    }

    /// How long to wait for programs at most.
    fn patience(&mut self) -> Duration {
        // In this order: what a port gets after it was asked is an event before the next known one.
        let events = self.hosts.iter().filter_map(|host| host.until_next_event()).min();
        let ends = self.ends.iter_mut().filter_map(|end| end.patience()).min();
        let asked = self.is_asked().then_some(Duration::ZERO);
        [ends, events, asked].into_iter().flatten().fold(LONGEST_WAIT, Duration::min)
    }

    /// Whether a program has asked something already.
    fn is_asked(&self) -> bool {
        self.control.as_ref().is_some_and(Control::is_ready)
    }

    /// Waits for programs; true if it is time to stop. May end a little early.
    fn wait(&mut self, stop: BorrowedFd<'_>, patience: Duration) -> Result<bool, ServeError> {
        let patience = self.oversleep.shorten(patience);
        let began = Instant::now();
        let mut sources = vec![PollFd::from_borrowed_fd(stop, PollFlags::IN)];
        // In lock-step the others are taken in when a program asks something.
        let ends = self.ends.iter().filter(|end| !self.is_in_lock_step || end.answers_at_once());
        let ends = ends.filter_map(|end| end.source());
        sources.extend(ends.map(|end| PollFd::from_borrowed_fd(end, PollFlags::IN)));
        let control = self.control.iter().flat_map(Control::sources);
        sources.extend(control.map(|(file, flags)| PollFd::from_borrowed_fd(file, flags)));
        let timeout = Timespec::try_from(patience).unwrap_or_default();
        match poll(&mut sources, Some(&timeout)) {
            Ok(0) => {
                self.oversleep.learn(patience, began.elapsed());
                Ok(false)
            }
            Ok(_) => Ok(sources.first().is_some_and(|stop| !stop.revents().is_empty())),
            Err(Errno::INTR) => Ok(false),
            Err(error) => Err(ServeError::Terminal(error.into())),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read as _, Write as _};

    use super::*;
    use crate::sim::Fleet;
    use myactuator_protocol_core::command::{FunctionControl, ReadMultiTurnAngle, Reset, Switch};
    use myactuator_protocol_core::io::Runner as _;
    use myactuator_protocol_core::wire::rs485::Frame;

    #[test]
    fn settings_that_could_not_be_stored_are_reported_with_their_bus() {
        let folder = tempfile::tempdir().unwrap();
        let fleets = ["left", "right", "tool"].map(|name| {
            let of_bus = folder.path().join(name);
            std::fs::create_dir(&of_bus).unwrap();
            Fleet::new(2).name(name).memory_folder(of_bus).on_can(1_000_000).unwrap()
        });
        // Function 4, which acts after a restart: turns are saved at power-off.
        let keep_turns = FunctionControl::SaveMultiTurn(Switch::On);
        for fleet in &fleets {
            let mut master = fleet.master::<2>();
            for motor in MotorId::all().take(2) {
                master.ask(motor, keep_turns).unwrap();
                master.ask(motor, Reset).unwrap();
            }
            fleet.world.run_for(time::Duration::from_secs(2));
        }
        let mut server = Server::new();
        fleets.iter().for_each(|fleet| server.host_can(fleet));
        for name in ["left", "tool"] {
            std::fs::remove_dir_all(folder.path().join(name)).unwrap();
        }
        let (nobody, stop) = UnixStream::pair().unwrap();
        drop(nobody);
        let message = server.run(stop, |_| {}).unwrap_err().to_string();
        let expected = "motors 1 2 of \"left\", motors 1 2 of \"tool\" could not store ";
        assert!(message.starts_with(expected), "{message}");
    }

    #[test]
    fn a_socket_stands_in_for_a_serial_port_until_it_is_closed() {
        let line = Fleet::new(1).on_rs485(1_000_000).unwrap();
        let (mut program, device) = UnixStream::pair().unwrap();
        let mut server = Server::new();
        server.serve_line_on(&line, TransceiverConfig::default(), device).unwrap();
        let asking = std::thread::spawn(move || {
            let ask = Frame::from_packet(&ReadMultiTurnAngle.packet(MotorId::MIN)).unwrap();
            program.write_all(&ask.encode()).unwrap();
            let mut answer = [0; 13];
            program.read_exact(&mut answer).unwrap();
            Frame::decode(&answer).unwrap().data
        });
        let (_nobody_stops_it, stop) = UnixStream::pair().unwrap();
        let end = server.run(stop, |_| {}).unwrap_err();
        let ServeError::Terminal(error) = end else { panic!("{end}") };
        assert_eq!(error.kind(), io::ErrorKind::UnexpectedEof);
        assert_eq!(asking.join().unwrap()[0], 0x92);
    }
}
