//! A hostile world: adapters that deliver in bursts, controllers that refuse, fail and hand frames back, coarse clocks,
//! echoes, and drives that behave like real ones.

mod tasks;

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use embedded_can::{ErrorKind, nb};
use embedded_io::{ErrorType, Read, ReadReady, Write};
use myactuator_host_std::sim::bus::can::{CanBus, CanError, CanPort, ControllerConfig};
use myactuator_host_std::sim::bus::rs485::{Rs485Line, SerialError, SerialPort, TransceiverConfig};
use myactuator_host_std::sim::bus::trace::{Event, Fault};
use myactuator_host_std::sim::bus::{SimClock, StationId, World};
use myactuator_protocol_core::io::{
    AsyncCanMaster, AsyncRunner, AsyncSerialMaster, CanMaster, Clock, Runner, SerialMaster,
};
use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::wire::can::{self, Received, SimpleFrame};
use myactuator_protocol_core::wire::rs485::{Fed, Receiver};
use myactuator_protocol_core::{Channel, MotorId, Packet};
use myactuator_tests::dice::Dice;
use myactuator_tests::wire::Wire;

use super::drives::{BOOT, Drive, Stranger};
use super::hosts::Host;
use super::scenarios::{Echo, Loop, Scenario};
use super::truth::Book;

/// The probability of noise at each switch of direction, if there is noise.
const SWITCH_NOISE: f32 = 0.2;
/// The longest time for which a controller refuses. It is longer than a bus needs to count as dead.
const LONGEST_REFUSAL_US: u64 = 30_000;
/// One call in this many begins a refusal, or fails.
const SELDOM: u64 = 2_000;

/// The errors of a port of this world.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RoughError {
    Made(ErrorKind),
    Can(CanError),
    Serial(SerialError),
}

impl embedded_can::Error for RoughError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Made(kind) => *kind,
            _ => ErrorKind::Other,
        }
    }
}

impl embedded_io::Error for RoughError {
    fn kind(&self) -> embedded_io::ErrorKind {
        embedded_io::ErrorKind::Other
    }
}

impl std::fmt::Display for RoughError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{self:?}")
    }
}

impl std::error::Error for RoughError {}

/// How the master's computer treats its port.
#[derive(Debug)]
struct Manner {
    burst: Duration,
    refuses: bool,
    fails: bool,
    dice: Dice,
    /// Nothing is taken before this time.
    refused_until: Instant,
    /// The last call was refused.
    was_refused: bool,
}

impl Manner {
    /// When bytes or frames that have come by now are handed over.
    fn delivery(&self, now: Instant) -> Instant {
        match self.burst.as_micros() {
            0 => now,
            burst => Instant::from_micros((now.as_micros() / burst + 1) * burst),
        }
    }

    fn refuses(&mut self, now: Instant) -> bool {
        if self.refuses && now >= self.refused_until && self.dice.below(SELDOM) == 0 {
            let refusal = Duration::from_micros(self.dice.below(LONGEST_REFUSAL_US));
            self.refused_until = now + refusal;
        }
        self.was_refused = now < self.refused_until;
        self.was_refused
    }

    fn fails(&mut self) -> Option<RoughError> {
        if !self.fails || self.dice.below(SELDOM) != 0 {
            return None;
        }
        let kinds = [ErrorKind::Overrun, ErrorKind::Other, ErrorKind::Acknowledge];
        Some(RoughError::Made(kinds[self.dice.below(3) as usize]))
    }
}

/// The manner of a port, shared with its clock.
type Shared = Arc<Mutex<Manner>>;

fn with<T>(manner: &Shared, work: impl FnOnce(&mut Manner) -> T) -> T {
    work(&mut manner.lock().unwrap_or_else(PoisonError::into_inner))
}

/// A clock that may have coarse steps, may not start at zero, and may jump.
#[derive(Debug)]
pub(crate) struct RoughClock<W: Wire> {
    clock: SimClock<W>,
    book: Book,
    manner: Shared,
}

impl<W: Wire> Clock for RoughClock<W> {
    fn now(&self) -> Instant {
        self.book.open().tick(self.clock.now())
    }

    fn idle(&self, until: Instant) {
        let now = self.clock.now();
        let mut until = self.book.open().world_time(until);
        with(&self.manner, |manner| {
            if manner.burst > Duration::ZERO {
                until = until.min(manner.delivery(now));
            }
            if manner.was_refused && now < manner.refused_until {
                until = until.min(manner.refused_until);
            }
        });
        self.clock.idle(until);
    }
}

/// A CAN port with such a manner. It notes the frames that pass.
#[derive(Debug)]
pub(crate) struct RoughCan {
    port: CanPort,
    book: Book,
    manner: Shared,
    arrived: VecDeque<(Instant, SimpleFrame)>,
}

fn packet_of(frame: &SimpleFrame) -> Option<Packet> {
    match can::decode(frame) {
        Received::Packet(packet) => Some(packet),
        _ => None,
    }
}

impl RoughCan {
    fn note_offered(&self, frame: &SimpleFrame) {
        let mut truth = self.book.open();
        truth.tick(self.port.world().now());
        truth.offered(packet_of(frame).as_ref());
    }

    fn note_taken(&self, frame: &SimpleFrame, back: Option<&SimpleFrame>) {
        let mut truth = self.book.open();
        truth.tick(self.port.world().now());
        if let Some(packet) = packet_of(frame) {
            truth.taken(&packet);
        }
        if let Some(packet) = back.and_then(packet_of) {
            truth.handed_back(&packet);
        }
    }
}

impl nb::Can for RoughCan {
    type Frame = SimpleFrame;
    type Error = RoughError;

    fn transmit(&mut self, frame: &SimpleFrame) -> ::nb::Result<Option<SimpleFrame>, RoughError> {
        let now = self.port.world().now();
        self.note_offered(frame);
        let refuses = with(&self.manner, |manner| manner.refuses(now));
        let result = if refuses {
            Err(::nb::Error::WouldBlock)
        } else if let Some(error) = with(&self.manner, Manner::fails) {
            Err(::nb::Error::Other(error))
        } else {
            nb::Can::transmit(&mut self.port, frame).map_err(|error| error.map(RoughError::Can))
        };
        if let Err(error) = &result {
            let mut truth = self.book.open();
            truth.port_has_failed();
            match error {
                ::nb::Error::WouldBlock if !refuses => truth.port_is_full(),
                _ => truth.bus_has_failed(),
            }
        }
        let back = result?;
        self.note_taken(frame, back.as_ref());
        Ok(back)
    }

    fn receive(&mut self) -> ::nb::Result<SimpleFrame, RoughError> {
        let now = self.port.world().now();
        let delivery = with(&self.manner, |manner| manner.delivery(now));
        while let Ok(frame) = nb::Can::receive(&mut self.port) {
            self.arrived.push_back((delivery, frame));
        }
        if let Some(error) = with(&self.manner, Manner::fails) {
            self.book.open().receiving_has_failed();
            return Err(::nb::Error::Other(error));
        }
        let next = self.arrived.pop_front_if(|(at, _)| *at <= now);
        let (_, frame) = next.ok_or(::nb::Error::WouldBlock)?;
        let mut truth = self.book.open();
        truth.tick(now);
        match can::decode(&frame) {
            Received::Packet(packet) => truth.delivered(&packet),
            // Some drives report in a shorter frame that they have lost their master.
            Received::WrongLength { channel: Channel::Reply(motor), first: Some(0xF1), .. } => {
                truth.pages[motor.index()].lost_master_delivered += 1;
            }
            _ => {}
        }
        drop(truth);
        Ok(frame)
    }
}

/// A serial port with such a manner. It notes the frames that pass.
#[derive(Debug)]
pub(crate) struct RoughSerial {
    port: SerialPort,
    world: World<Rs485Line>,
    book: Book,
    manner: Shared,
    arrived: VecDeque<(Instant, u8)>,
    received: Receiver,
    /// Futures of the loop are dropped.
    is_dropped: bool,
}

/// The command of a whole frame.
fn frame_of(buf: &[u8]) -> Option<Packet> {
    let mut receiver = Receiver::new();
    buf.iter().find_map(|&byte| match receiver.feed(byte) {
        Fed::Frame(frame) => Some(frame.as_command()),
        _ => None,
    })
}

impl RoughSerial {
    fn fails(&mut self) -> Result<(), RoughError> {
        let Some(error) = with(&self.manner, Manner::fails) else { return Ok(()) };
        self.book.open().receiving_has_failed();
        Err(error)
    }

    /// The part that it takes of these bytes, which may be all.
    fn part_of<'a>(&mut self, buf: &'a [u8]) -> Result<&'a [u8], RoughError> {
        self.fails()?;
        let is_part = with(&self.manner, |manner| manner.refuses && manner.dice.below(8) == 0);
        let most = if is_part { 1 + buf.len() / 2 } else { buf.len() };
        Ok(&buf[..most.min(buf.len())])
    }

    fn note_offered(&self, buf: &[u8]) {
        let mut truth = self.book.open();
        truth.tick(self.world.now());
        truth.offered(frame_of(buf).as_ref());
    }

    /// A frame counts as taken with its first byte, whatever happens to the other bytes.
    fn note_taken(&self, buf: &[u8]) {
        if let Some(packet) = frame_of(buf) {
            let mut truth = self.book.open();
            truth.tick(self.world.now());
            truth.taken(&packet);
        }
    }
}

impl ErrorType for RoughSerial {
    type Error = RoughError;
}

impl ReadReady for RoughSerial {
    fn read_ready(&mut self) -> Result<bool, RoughError> {
        let now = self.world.now();
        let delivery = with(&self.manner, |manner| manner.delivery(now));
        let mut bytes = [0; 64];
        while self.port.read_ready().map_err(RoughError::Serial)? {
            let count = self.port.read(&mut bytes).map_err(RoughError::Serial)?;
            self.arrived.extend(bytes[..count].iter().map(|&byte| (delivery, byte)));
        }
        self.fails()?;
        Ok(self.arrived.front().is_some_and(|(at, _)| *at <= now))
    }
}

impl Read for RoughSerial {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, RoughError> {
        self.fails()?;
        let now = self.world.now();
        let mut count = 0;
        for place in buf {
            let Some((_, byte)) = self.arrived.pop_front_if(|(at, _)| *at <= now) else { break };
            (*place, count) = (byte, count + 1);
            let Fed::Frame(frame) = self.received.feed(byte) else { continue };
            let mut truth = self.book.open();
            truth.tick(now);
            match frame.as_reply() {
                Some(packet) => truth.delivered(&packet),
                None => truth.doubt.has_echoed(),
            }
        }
        Ok(count)
    }
}

impl Write for RoughSerial {
    fn write(&mut self, buf: &[u8]) -> Result<usize, RoughError> {
        self.note_offered(buf);
        let part = self.part_of(buf)?;
        let count = self.port.write(part).map_err(RoughError::Serial)?;
        self.note_taken(buf);
        Ok(count)
    }

    fn flush(&mut self) -> Result<(), RoughError> {
        self.port.flush().map_err(RoughError::Serial)?;
        self.fails()
    }
}

/// A bus that this world can make rough.
pub(crate) trait Rough: Wire {
    type Polled: Runner<32, Error = RoughError>;
    type Async: AsyncRunner<32, Error = RoughError>;

    fn host(
        world: &World<Self>,
        scenario: &Scenario,
        book: &Book,
        config: Config,
    ) -> (Host<Self>, StationId);
}

fn manners<W: Wire>(world: &World<W>, scenario: &Scenario, book: &Book) -> (Shared, RoughClock<W>) {
    let conditions = &scenario.conditions;
    let manner = Arc::new(Mutex::new(Manner {
        burst: Duration::from_millis(conditions.burst_ms),
        refuses: conditions.refuses,
        fails: conditions.fails,
        dice: Dice::new(scenario.seed ^ 0xABCD),
        refused_until: Instant::ZERO,
        was_refused: false,
    }));
    let clock =
        RoughClock { clock: world.clock(), book: book.clone(), manner: Arc::clone(&manner) };
    (manner, clock)
}

impl Rough for CanBus {
    type Polled = CanMaster<RoughCan, RoughClock<Self>, 32>;
    type Async = AsyncCanMaster<RoughCan, RoughClock<Self>, 32>;

    fn host(
        world: &World<Self>,
        scenario: &Scenario,
        book: &Book,
        config: Config,
    ) -> (Host<Self>, StationId) {
        let (manner, clock) = manners(world, scenario, book);
        let controller = if scenario.conditions.mailboxes {
            ControllerConfig { receive_queue: 1024, ..ControllerConfig::MAILBOXES }
        } else {
            ControllerConfig::SOCKETCAN
        };
        let port = world.port_with(controller);
        let station = port.station();
        let port = RoughCan { port, book: book.clone(), manner, arrived: VecDeque::new() };
        let host = match scenario.conditions.runs {
            Loop::Polled => Host::Polled(CanMaster::new(port, clock, config)),
            _ => Host::tasks(AsyncCanMaster::new(port, clock, config), world, scenario),
        };
        (host, station)
    }
}

impl Rough for Rs485Line {
    type Polled = SerialMaster<RoughSerial, RoughClock<Self>, 32>;
    type Async = AsyncSerialMaster<RoughSerial, RoughClock<Self>, 32>;

    fn host(
        world: &World<Self>,
        scenario: &Scenario,
        book: &Book,
        config: Config,
    ) -> (Host<Self>, StationId) {
        let (manner, clock) = manners(world, scenario, book);
        let echo = scenario.conditions.echo != Echo::None;
        let switch_noise = if scenario.conditions.noise { SWITCH_NOISE } else { 0.0 };
        let transceiver = TransceiverConfig { echo, switch_noise, ..TransceiverConfig::default() };
        book.open().echoes = echo;
        let port = world.port_with(transceiver);
        let station = port.station();
        let port = RoughSerial {
            port,
            world: world.clone(),
            book: book.clone(),
            manner,
            arrived: VecDeque::new(),
            received: Receiver::new(),
            is_dropped: scenario.conditions.runs == Loop::AsyncDropped,
        };
        let host = match scenario.conditions.runs {
            Loop::Polled => Host::Polled(SerialMaster::new(port, clock, config)),
            _ => Host::tasks(AsyncSerialMaster::new(port, clock, config), world, scenario),
        };
        (host, station)
    }
}

/// A bus with a master, drives and other stations.
pub(crate) struct Stage<W: Rough> {
    pub(crate) world: World<W>,
    pub(crate) host: Host<W>,
    /// The drives, in the order of their ids.
    pub(crate) drives: Vec<Arc<Mutex<Drive<W>>>>,
    pub(crate) stations: Vec<StationId>,
    /// The master's place.
    pub(crate) port: StationId,
    pub(crate) book: Book,
}

impl<W: Rough> Stage<W> {
    pub(crate) fn new(scenario: &Scenario) -> Self {
        let conditions = &scenario.conditions;
        let world = W::world(scenario.seed);
        let book = Book::new(&scenario.longest::<W>());
        {
            let mut truth = book.open();
            truth.clock_step =
                Duration::from_micros(if conditions.coarse_clock { 1_000 } else { 1 });
            truth.clock_ahead = Duration::from_millis(conditions.clock_start_ms);
            truth.twin = conditions.twins.then_some(MotorId::MIN);
        }
        let (host, port) = W::host(&world, scenario, &book, scenario.config::<W>());
        let mut drives = Vec::new();
        let mut stations = Vec::new();
        let mut seat = |motor: MotorId, number: u64| {
            let seed = scenario.seed ^ number << 32;
            let mut drive = Drive::<W>::new(motor, seed, book.clone());
            drive.boot = if conditions.restarts { BOOT } else { Duration::ZERO };
            if conditions.have_run {
                drive.has_run(&mut Dice::new(seed ^ 0xB007));
            }
            drive.repeats = if conditions.repeats { 50 } else { 0 };
            drive.is_deaf_to_all = conditions.deaf_to_all && Dice::new(seed).below(2) == 0;
            let drive = Arc::new(Mutex::new(drive));
            stations.push(W::seat(&world, Arc::clone(&drive)));
            drives.push(drive);
        };
        for motor in MotorId::all().take(scenario.motors.into()) {
            seat(motor, motor.get().into());
        }
        if conditions.twins {
            seat(MotorId::MIN, 99);
        }
        if conditions.stranger {
            W::seat(&world, Stranger::<W>::new(scenario));
        }
        let (first, count, noted) = (stations[0].index(), scenario.motors, book.clone());
        world.observe(move |record| {
            let Event::Faulted { from, fault: Fault::Duplicated } = record.event else { return };
            let drive = if from == port { record.station } else { from };
            // The twin comes after the others.
            let place = drive.index().checked_sub(first).map(|place| place % usize::from(count));
            if let Some(motor) = place.and_then(|place| MotorId::new(place as u8 + 1).ok()) {
                let mut truth = noted.open();
                truth.tick(record.at());
                truth.was_doubled(motor);
            }
        });
        Self { world, host, drives, stations, port, book }
    }

    pub(crate) fn drive<T>(&self, index: usize, work: impl FnOnce(&mut Drive<W>) -> T) -> T {
        work(&mut self.drives[index].lock().unwrap_or_else(PoisonError::into_inner))
    }
}
