//! The simulated drives, with faults to inject, and the commands that they received.

use std::fmt;
use std::os::unix::net::UnixStream;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};

use myactuator_host_std::serve::{Notice, ServeError, Server};
use myactuator_host_std::sim::bus::can::{CanBus, ControllerConfig};
use myactuator_host_std::sim::bus::faults::{Direction, FaultPlan};
use myactuator_host_std::sim::bus::rs485::{Rs485Line, TransceiverConfig};
use myactuator_host_std::sim::bus::trace::Event;
use myactuator_host_std::sim::bus::{Medium, StationId};
use myactuator_host_std::sim::memory::DriveMemory;
use myactuator_host_std::sim::{BusFleet, DriveHandle, Fleet};
use myactuator_protocol_core::Packet;
use myactuator_protocol_core::command::VersionDate;
use myactuator_protocol_core::drive::{Drive, Parameters};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::wire::can::{self, SimpleFrame};
use myactuator_protocol_core::wire::rs485::{Fed, Receiver};

use super::board::Wire;
use super::{Failure, processor};

/// Bits per second on either wire: the setting of the boards' programs.
const BIT_RATE: u32 = 1_000_000;

/// A command that was completely on the wire.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heard {
    /// When it ended.
    pub at: Instant,
    /// The command.
    pub packet: Packet,
}

type Shared<T> = Arc<Mutex<Vec<T>>>;

/// The adapter between the firmware and the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Adapter {
    /// Passes everything on at once, and sends in order.
    Ideal,
    /// Passes on what it receives every 2 ms. On RS485 it echoes what it sends. On CAN it sends by priority from three
    /// mailboxes, and hands a frame back to make room for a more urgent one.
    Adverse,
}

/// The interval of bursts. On RS485 each exchange waits for one. With longer intervals the set-points are so few that
/// shafts move in steps.
const BURSTS: Duration = Duration::from_millis(2);

/// Drives that are simulated in real time. They stop when this is dropped.
pub struct Drives {
    bus: Arc<dyn Bus>,
    heard: Shared<Heard>,
    notices: Shared<String>,
    adapter: Adapter,
    server: Option<Running>,
}

struct Running {
    /// Stops the server when it is closed.
    stop: UnixStream,
    thread: JoinHandle<()>,
}

impl fmt::Debug for Drives {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Drives").field("notices", &self.notices).finish_non_exhaustive()
    }
}

impl Drives {
    /// Creates these drives on a wire that is not connected yet.
    ///
    /// # Errors
    /// If the drives cannot be simulated.
    pub fn new(fleet: &Fleet, wire: Wire) -> Result<Self, Failure> {
        let bus: Arc<dyn Bus> = match wire {
            Wire::Rs485 => Arc::new(fleet.on_rs485(BIT_RATE)?),
            Wire::Slcan => Arc::new(fleet.on_can(BIT_RATE)?),
        };
        Ok(Self {
            bus,
            heard: Shared::default(),
            notices: Shared::default(),
            adapter: Adapter::Ideal,
            server: None,
        })
    }

    /// The same, with this adapter.
    #[must_use]
    pub fn with_adapter(mut self, adapter: Adapter) -> Self {
        self.adapter = adapter;
        self
    }

    /// Connects the stream's other end to the wire: as the serial port of an RS485 line, or of an SLCAN adapter.
    ///
    /// # Errors
    /// The operating system's.
    pub fn serve(&mut self, stream: UnixStream) -> Result<(), Failure> {
        let (stop, stopped) = UnixStream::pair()?;
        let adapter = self.adapter;
        let (bus, notices) = (Arc::clone(&self.bus), Arc::clone(&self.notices));
        // A server cannot leave the thread that created it.
        let thread = thread::spawn(move || {
            processor::take();
            let mut server = Server::new();
            let record = |notice| match notice {
                // It is the firmware's task to handle what drives refuse.
                Notice::Log(_) => {}
                notice => push(&notices, notice.to_string()),
            };
            let served =
                bus.serve(&mut server, adapter, stream).and_then(|()| server.run(stopped, record));
            if let Err(error) = served {
                push(&notices, error.to_string());
            }
        });
        self.server = Some(Running { stop, thread });
        Ok(())
    }

    /// The drives, ordered by id.
    pub fn handles(&self) -> &[DriveHandle] {
        self.bus.handles()
    }

    /// The time on their bus.
    pub fn now(&self) -> Instant {
        self.bus.now()
    }

    /// The server's notices: simulated time that it skipped because the machine was busy.
    pub fn notices(&self) -> Vec<String> {
        self.notices.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Records all commands from now on.
    pub fn listen(&self) {
        self.bus.listen(Arc::clone(&self.heard));
    }

    /// The [recorded](Self::listen) commands since then, oldest first.
    pub fn heard_since(&self, since: Instant) -> Vec<Heard> {
        // Brings the simulation up to the present.
        self.now();
        let heard = self.heard.lock().unwrap_or_else(PoisonError::into_inner);
        heard.iter().filter(|heard| heard.at >= since).copied().collect()
    }

    /// Sets the random faults of frames in both directions from now on.
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

    /// Power-cycles a drive.
    pub fn restart(&self, drive: &DriveHandle) {
        self.bus.restart(drive.station());
    }

    /// Replaces a drive by one in factory state, with this date of its software.
    ///
    /// # Errors
    /// If the memory of the new drive fails.
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
        if let Some(Running { stop, thread }) = self.server.take() {
            drop(stop);
            // A panic there has been reported already.
            let _ = thread.join();
        }
    }
}

fn push<T>(list: &Shared<T>, item: T) {
    list.lock().unwrap_or_else(PoisonError::into_inner).push(item);
}

/// Drives on a bus of either kind.
trait Bus: Send + Sync {
    fn serve(
        &self,
        server: &mut Server,
        adapter: Adapter,
        stream: UnixStream,
    ) -> Result<(), ServeError>;
    fn handles(&self) -> &[DriveHandle];
    fn now(&self) -> Instant;
    fn disturb(&self, plan: FaultPlan);
    fn cut(&self, station: StationId);
    fn mend(&self, station: StationId);
    fn restart(&self, station: StationId);
    fn listen(&self, heard: Shared<Heard>);
}

impl<B: Served> Bus for BusFleet<B> {
    fn serve(
        &self,
        server: &mut Server,
        adapter: Adapter,
        stream: UnixStream,
    ) -> Result<(), ServeError> {
        if adapter == Adapter::Adverse {
            server.hand_over_every(BURSTS);
        }
        B::serve(self, server, adapter, stream)
    }

    fn handles(&self) -> &[DriveHandle] {
        &self.drives
    }

    fn now(&self) -> Instant {
        self.world.now()
    }

    fn disturb(&self, plan: FaultPlan) {
        self.world.set_faults(Direction::ToNodes, plan);
        self.world.set_faults(Direction::ToPorts, plan);
    }

    fn cut(&self, station: StationId) {
        self.world.cut(station);
    }

    fn mend(&self, station: StationId) {
        self.world.mend(station);
    }

    fn restart(&self, station: StationId) {
        self.world.reset(station);
    }

    fn listen(&self, heard: Shared<Heard>) {
        let drives: Vec<StationId> = self.drives.iter().map(DriveHandle::station).collect();
        let mut decoder = B::Decoder::default();
        self.world.observe(move |record| {
            let Event::Carried { frame, .. } = &record.event else { return };
            if !drives.contains(&record.station) {
                let report = |packet| push(&heard, Heard { at: record.at(), packet });
                B::decode(&mut decoder, frame, report);
            }
        });
    }
}

/// A bus that can be served and listened to.
trait Served: Medium + Sized {
    /// The received part of a command.
    type Decoder: Default + Send + 'static;

    fn serve(
        fleet: &BusFleet<Self>,
        server: &mut Server,
        adapter: Adapter,
        stream: UnixStream,
    ) -> Result<(), ServeError>;
    fn decode(decoder: &mut Self::Decoder, frame: &Self::Frame, report: impl FnMut(Packet));
}

impl Served for Rs485Line {
    type Decoder = Receiver;

    fn serve(
        fleet: &BusFleet<Self>,
        server: &mut Server,
        adapter: Adapter,
        stream: UnixStream,
    ) -> Result<(), ServeError> {
        let echo = adapter == Adapter::Adverse;
        server.serve_line_on(fleet, TransceiverConfig { echo, ..Default::default() }, stream)
    }

    fn decode(decoder: &mut Receiver, bytes: &Vec<u8>, mut report: impl FnMut(Packet)) {
        for &byte in bytes {
            if let Fed::Frame(frame) = decoder.feed(byte) {
                report(frame.as_command());
            }
        }
    }
}

impl Served for CanBus {
    type Decoder = ();

    fn serve(
        fleet: &BusFleet<Self>,
        server: &mut Server,
        adapter: Adapter,
        stream: UnixStream,
    ) -> Result<(), ServeError> {
        server.host_can(fleet);
        let controller = match adapter {
            Adapter::Ideal => {
                ControllerConfig { transmit_queue: 64, ..ControllerConfig::SOCKETCAN }
            }
            Adapter::Adverse => ControllerConfig::MAILBOXES,
        };
        server.serve_adapter_on(fleet, controller, stream)
    }

    fn decode((): &mut (), frame: &SimpleFrame, mut report: impl FnMut(Packet)) {
        if let can::Received::Packet(packet) = can::decode(frame) {
            report(packet);
        }
    }
}
