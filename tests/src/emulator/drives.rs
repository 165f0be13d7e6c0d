//! The simulated drives: disturbed, and asked what they heard.

use std::fmt;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::thread::{self, JoinHandle};

use myactuator_host_std::serve::{Notice, ServeError, Server};
use myactuator_host_std::sim::bus::faults::{Direction, FaultPlan};
use myactuator_host_std::sim::bus::rs485::TransceiverConfig;
use myactuator_host_std::sim::bus::trace::Event;
use myactuator_host_std::sim::bus::{Medium, StationId, World};
use myactuator_host_std::sim::memory::DriveMemory;
use myactuator_host_std::sim::{BusFleet, CanFleet, DriveHandle, Fleet, LineFleet};
use myactuator_protocol_core::Packet;
use myactuator_protocol_core::command::VersionDate;
use myactuator_protocol_core::drive::{Drive, Parameters};
use myactuator_protocol_core::time::Instant;
use myactuator_protocol_core::wire::can::{self, SimpleFrame};
use myactuator_protocol_core::wire::rs485::{Fed, Receiver};

use super::Failure;
use super::board::Wire;

/// Bits per second, on either wire: what the boards' programs are set to.
const BIT_RATE: u32 = 1_000_000;

/// A command that was on the wire whole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heard {
    /// When it ended.
    pub at: Instant,
    /// The command.
    pub packet: Packet,
}

type Shared<T> = Arc<Mutex<Vec<T>>>;

/// Simulated drives behind a pseudo-terminal, in real time. They stop when this is dropped.
pub struct Drives {
    handles: Vec<DriveHandle>,
    bus: Box<dyn AnyBus>,
    path: PathBuf,
    heard: Shared<Heard>,
    notices: Shared<String>,
    /// Closed, it stops the server.
    stop: Option<UnixStream>,
    server: Option<JoinHandle<()>>,
}

impl fmt::Debug for Drives {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Drives").field("path", &self.path).finish_non_exhaustive()
    }
}

impl Drives {
    /// Serves these on a wire.
    ///
    /// # Errors
    /// They cannot be simulated, or not served.
    pub fn serve(fleet: &Fleet, wire: Wire) -> Result<Self, Failure> {
        match wire {
            Wire::Rs485 => Self::start(fleet.on_rs485(BIT_RATE)?),
            Wire::Slcan => Self::start(fleet.on_can(BIT_RATE)?),
        }
    }

    fn start<B: Served>(fleet: BusFleet<B>) -> Result<Self, Failure>
    where
        BusFleet<B>: Send,
    {
        let (handles, world) = (fleet.drives.clone(), fleet.world.clone());
        let (notices, problems) = (Shared::<String>::default(), Shared::<String>::default());
        let (stop, stopped) = UnixStream::pair()?;
        let (place, placed) = mpsc::channel();
        let (for_notices, for_problems) = (Arc::clone(&notices), Arc::clone(&problems));
        // A server stays in the thread that made it.
        let server = thread::spawn(move || {
            let mut server = Server::new();
            let served = B::serve(&fleet, &mut server).and_then(|path| {
                // Whoever waits for it is there.
                let _ = place.send(path);
                server.run(stopped, |notice| push(&for_notices, told(&notice)))
            });
            if let Err(error) = served {
                push(&for_problems, error.to_string());
                push(&for_notices, error.to_string());
            }
        });
        let path = placed.recv().map_err(|_| problems_of(&problems))?;
        let (stop, server) = (Some(stop), Some(server));
        let heard = Shared::default();
        Ok(Self { handles, bus: Box::new(world), path, heard, notices, stop, server })
    }

    /// Where their serial port is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The drives, in the order of their ids.
    pub fn handles(&self) -> &[DriveHandle] {
        &self.handles
    }

    /// The time on their bus.
    pub fn now(&self) -> Instant {
        self.bus.now()
    }

    /// What the server had to say: simulated time that was left out because the machine was busy.
    pub fn notices(&self) -> Vec<String> {
        self.notices.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Takes note of all commands from now on.
    pub fn listen(&self) {
        let drives = self.handles.iter().map(DriveHandle::station).collect();
        self.bus.listen(drives, Arc::clone(&self.heard));
    }

    /// The commands since then that were [noted](Self::listen), oldest first.
    pub fn heard_since(&self, since: Instant) -> Vec<Heard> {
        // What is over by now has happened.
        self.now();
        let heard = self.heard.lock().unwrap_or_else(PoisonError::into_inner);
        heard.iter().filter(|heard| heard.at >= since).copied().collect()
    }

    /// What chance does to frames both ways from now on.
    pub fn disturb(&self, plan: FaultPlan) {
        self.bus.disturb(plan);
    }

    /// Cuts the wires of these drives.
    pub fn cut(&self, drives: &[DriveHandle]) {
        drives.iter().for_each(|drive| self.bus.cut(drive.station()));
    }

    /// Mends the wires of these drives.
    pub fn mend(&self, drives: &[DriveHandle]) {
        drives.iter().for_each(|drive| self.bus.mend(drive.station()));
    }

    /// Cycles a drive's power.
    pub fn restart(&self, drive: &DriveHandle) {
        self.bus.reset(drive.station());
    }

    /// Puts another drive in a drive's place, as it came from the factory but for the date of its
    /// software.
    ///
    /// # Errors
    /// Its memory fails.
    pub fn replace(&self, drive: &DriveHandle, version_date: VersionDate) -> Result<(), Failure> {
        let now = self.now();
        drive.with(|drive| {
            let parameters = Parameters { version_date, ..*drive.parameters() };
            let (plant, memory) = (drive.plant().clone(), DriveMemory::Process(None));
            *drive = Drive::new(parameters, plant, memory, now)?;
            Ok(())
        })
    }
}

impl Drop for Drives {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(server) = self.server.take() {
            // A panic there has been told already.
            let _ = server.join();
        }
    }
}

fn push<T>(list: &Shared<T>, item: T) {
    list.lock().unwrap_or_else(PoisonError::into_inner).push(item);
}

fn problems_of(problems: &Shared<String>) -> Failure {
    problems.lock().unwrap_or_else(PoisonError::into_inner).join(", ").into()
}

fn told(notice: &Notice) -> String {
    notice.to_string()
}

/// A bus of either kind.
trait AnyBus: Send + Sync {
    fn now(&self) -> Instant;
    fn disturb(&self, plan: FaultPlan);
    fn cut(&self, station: StationId);
    fn mend(&self, station: StationId);
    fn reset(&self, station: StationId);
    fn listen(&self, drives: Vec<StationId>, heard: Shared<Heard>);
}

impl<B: Served> AnyBus for World<B> {
    fn now(&self) -> Instant {
        World::now(self)
    }

    fn disturb(&self, plan: FaultPlan) {
        self.set_faults(Direction::ToNodes, plan);
        self.set_faults(Direction::ToPorts, plan);
    }

    fn cut(&self, station: StationId) {
        World::cut(self, station);
    }

    fn mend(&self, station: StationId) {
        World::mend(self, station);
    }

    fn reset(&self, station: StationId) {
        World::reset(self, station);
    }

    fn listen(&self, drives: Vec<StationId>, heard: Shared<Heard>) {
        let mut ear = B::Ear::default();
        self.observe(move |record| {
            let Event::Carried { frame, .. } = &record.event else { return };
            if !drives.contains(&record.station) {
                let note = |packet| push(&heard, Heard { at: record.at(), packet });
                B::hear(&mut ear, frame, note);
            }
        });
    }
}

/// A bus that can be served on a pseudo-terminal and listened to.
trait Served: Medium + Sized {
    /// What was heard of a command so far.
    type Ear: Default + Send + 'static;

    fn serve(fleet: &BusFleet<Self>, server: &mut Server) -> Result<PathBuf, ServeError>;
    fn hear(ear: &mut Self::Ear, frame: &Self::Frame, note: impl FnMut(Packet));
}

impl Served for myactuator_host_std::sim::bus::rs485::Rs485Line {
    type Ear = Receiver;

    fn serve(fleet: &LineFleet, server: &mut Server) -> Result<PathBuf, ServeError> {
        server.serve_line(fleet, TransceiverConfig::default())
    }

    fn hear(ear: &mut Receiver, bytes: &Vec<u8>, mut note: impl FnMut(Packet)) {
        for &byte in bytes {
            if let Fed::Frame(frame) = ear.feed(byte) {
                note(frame.as_command());
            }
        }
    }
}

impl Served for myactuator_host_std::sim::bus::can::CanBus {
    type Ear = ();

    fn serve(fleet: &CanFleet, server: &mut Server) -> Result<PathBuf, ServeError> {
        server.host_can(fleet);
        server.serve_adapter(fleet)
    }

    fn hear((): &mut (), frame: &SimpleFrame, mut note: impl FnMut(Packet)) {
        if let can::Received::Packet(packet) = can::decode(frame) {
            note(packet);
        }
    }
}
