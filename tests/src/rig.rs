//! Light drives for the simulated buses, and a ledger of what really happened on the wire and in the drives.
//!
//! Every command carries a token in bytes 4 to 7. A drive copies the token to bytes 4 to 7 of its reply, so each reply
//! shows to which request it belongs.

use std::collections::{HashMap, VecDeque};
use std::marker::PhantomData;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use myactuator_host_std::sim::bus::faults::{Direction, FaultPlan};
use myactuator_host_std::sim::bus::trace::{Event, Fault};
use myactuator_host_std::sim::bus::{Node, StationId, World};
use myactuator_protocol_core::command::{
    IncrementalPosition, ReadMultiTurnAngle, ReadStatus1, Speed,
};
use myactuator_protocol_core::error::RequestError;
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::master::{self, Config};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::{Angle, MaxSpeed, MaxTorque, SpeedTarget};
use myactuator_protocol_core::wire::rs485::Receiver;
use myactuator_protocol_core::{
    Channel, Command, Data, DecodeError, Kind, MotorId, Opcode, Packet, Target,
};

use crate::dice::Dice;
use crate::wire::Wire;

/// Marks a set-point of a stream in byte 1 of a speed command. Requests of the same kind have another mark.
pub const STREAM_MARK: u8 = 0;

/// The token in bytes 4 to 7.
pub fn token_of(data: &Data) -> u32 {
    u32::from_le_bytes([data[4], data[5], data[6], data[7]])
}

/// A command with a token in bytes 4 to 7, which it leaves free. The master does not know the token.
#[derive(Clone, Copy, Debug)]
pub struct WithToken<C>(C, u32);

/// The command with this token.
pub const fn with_token<C>(command: C, token: u32) -> WithToken<C> {
    WithToken(command, token)
}

/// 0x92 with a token.
pub const fn angle(token: u32) -> WithToken<ReadMultiTurnAngle> {
    WithToken(ReadMultiTurnAngle, token)
}

/// 0xA8 by the token's angle.
pub const fn step(token: u32) -> IncrementalPosition {
    let (max_speed, angle) = (MaxSpeed::NO_LIMIT, Angle::from_raw(token as i32));
    IncrementalPosition { max_speed, angle }
}

impl<C: Command> Command for WithToken<C> {
    type Reply = C::Reply;

    fn kind(&self) -> Kind {
        self.0.kind()
    }

    fn encode(&self) -> Data {
        let mut data = self.0.encode();
        data[4..].copy_from_slice(&self.1.to_le_bytes());
        data
    }

    fn decode_reply(data: &Data) -> Result<C::Reply, DecodeError> {
        C::decode_reply(data)
    }
}

/// The commands to one motor, as seen on the wire or in the drive.
#[derive(Clone, Debug, Default)]
pub struct Seen {
    /// Commands with a reply, to this motor or to all.
    pub asking: u64,
    /// How often each incremental move came, by its token.
    pub moves: HashMap<u32, u32>,
    /// The number of set-points.
    pub set_points: u64,
    /// The newest set-point.
    pub newest: Option<u32>,
    /// Set-points that came after a newer one.
    pub stale: u64,
    /// When the last set-point or move came.
    pub last_motion: Option<Instant>,
    /// When the first stop came since this was cleared.
    pub first_stop: Option<Instant>,
    /// When the last stop came.
    pub last_stop: Option<Instant>,
}

impl Seen {
    fn note(&mut self, packet: &Packet, at: Instant) {
        self.asking += u64::from(has_reply(packet) && !shows_echo(packet));
        if let Some(number) = set_point_number(packet) {
            self.set_points += 1;
            self.last_motion = Some(at);
            // The numbers of motion mode wrap.
            let ahead = self.newest.map_or(1, |newest| number.wrapping_sub(newest));
            if (1..1 << 31).contains(&ahead) {
                self.newest = Some(number);
            } else {
                self.stale += 1;
            }
        } else if packet.data[0] == 0xA8 {
            *self.moves.entry(token_of(&packet.data)).or_default() += 1;
            self.last_motion = Some(at);
        } else if matches!(packet.data[0], 0x80 | 0x81) {
            self.first_stop.get_or_insert(at);
            self.last_stop = Some(at);
        }
    }
}

/// What is known about one motor.
#[derive(Clone, Debug, Default)]
pub struct Page {
    /// Commands that were complete on the wire.
    pub sent: Seen,
    /// Commands that reached the drive.
    pub heard: Seen,
    /// Its replies that were complete on the wire.
    pub replied: u64,
    /// Its replies that the injector lost on the way to the master.
    pub replies_lost: u64,
}

/// What really happened.
#[derive(Clone, Debug, Default)]
pub struct Ledger(Arc<Mutex<Vec<Page>>>);

impl Ledger {
    /// An empty ledger.
    pub fn new() -> Self {
        Self(Arc::new(Mutex::new(vec![Page::default(); MotorId::COUNT])))
    }

    /// All pages, by [`MotorId::index`].
    pub fn pages(&self) -> MutexGuard<'_, Vec<Page>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A copy of one motor's page.
    pub fn page(&self, motor: MotorId) -> Page {
        self.pages()[motor.index()].clone()
    }

    fn carried_command(&self, packet: &Packet, at: Instant) {
        let mut pages = self.pages();
        match packet.channel {
            Channel::Command(Target::Motor(motor)) | Channel::Motion(motor) => {
                pages[motor.index()].sent.note(packet, at);
            }
            Channel::Command(Target::All) => {
                pages.iter_mut().for_each(|page| page.sent.note(packet, at));
            }
            _ => {}
        }
    }
}

fn has_reply(packet: &Packet) -> bool {
    matches!(packet.channel, Channel::Motion(_))
        || Opcode::from_byte(packet.data[0]).is_some_and(Opcode::has_reply)
}

/// A read of the status, or its answer. Here only the loop sends this read, to find out whether the adapter echoes.
fn shows_echo(packet: &Packet) -> bool {
    !matches!(packet.channel, Channel::MotionReply(_)) && packet.data[0] == 0x9A
}

/// Whether the command moves a motor. Such a command is answered with feedback, never with its own bytes.
fn moves(packet: &Packet) -> bool {
    Opcode::from_byte(packet.data[0]).is_some_and(|opcode| Kind::from(opcode).moves())
}

/// The number of a set-point of the tests' streams. Absolute positions and marked speeds carry it as their token.
/// Motion mode commands carry its low 16 bits as their position.
fn set_point_number(packet: &Packet) -> Option<u32> {
    match (packet.channel, packet.data) {
        (Channel::Motion(_), [high, low, ..]) => Some(u32::from_be_bytes([high, low, 0, 0])),
        (_, [0xA4, ..] | [0xA2, STREAM_MARK, ..]) => Some(token_of(&packet.data)),
        _ => None,
    }
}

/// A drive that answers every command after 0.7 to 0.9 ms, in order, with the command's own token.
struct Teller<W> {
    wire: PhantomData<W>,
    motor: MotorId,
    receiver: Receiver,
    replies: VecDeque<(Instant, Packet)>,
    dice: Dice,
    ledger: Ledger,
}

impl<W> Teller<W> {
    fn hear(&mut self, packet: &Packet, now: Instant) {
        let channel = match packet.channel {
            Channel::Command(Target::Motor(motor)) if motor == self.motor => Channel::Reply(motor),
            Channel::Command(Target::All) => Channel::Reply(self.motor),
            Channel::Motion(motor) if motor == self.motor => Channel::MotionReply(motor),
            _ => return,
        };
        self.ledger.pages()[self.motor.index()].heard.note(packet, now);
        if !has_reply(packet) {
            return;
        }
        let mut data = packet.data;
        if let Channel::MotionReply(_) = channel {
            data[0] = self.motor.get();
        } else if shows_echo(packet) || moves(packet) {
            data[1] = 25; // degrees
        }
        let due = now + Duration::from_micros(700 + self.dice.below(201));
        let due = self.replies.back().map_or(due, |(before, _)| due.max(*before));
        self.replies.push_back((due, Packet { channel, data }));
    }
}

impl<W: Wire> Node<W::Frame> for Teller<W> {
    fn handle_frame(&mut self, frame: &W::Frame, now: Instant) {
        if let Some(packet) = W::packet(&mut self.receiver, frame, true) {
            self.hear(&packet, now);
        }
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<W::Frame> {
        self.replies.pop_front_if(|(due, _)| *due <= now).map(|(_, packet)| W::frame(&packet))
    }

    fn poll_at(&self) -> Option<Instant> {
        self.replies.front().map(|(due, _)| *due)
    }

    fn reset(&mut self, _: Instant) {
        self.replies.clear();
        self.receiver.reset();
    }
}

/// Puts a set-point of a stream of speeds.
pub fn put(runner: &mut impl Runner<32>, motor: MotorId, number: u32) -> Result<(), RequestError> {
    let max_torque = MaxTorque::from_raw(STREAM_MARK);
    let speed = SpeedTarget::from_raw(number as i32);
    let now = runner.now();
    runner.master().set_point(motor, Speed { max_torque, speed }, now)
}

/// A bus with light drives, a master and the ledger.
#[derive(Debug)]
pub struct Rig<W: Wire> {
    /// The bus.
    pub world: World<W>,
    /// The master.
    pub runner: W::Runner<32>,
    /// The master's place on the bus.
    pub port: StationId,
    /// The drives' places, in the order of their ids.
    pub nodes: Vec<StationId>,
    /// What really happened.
    pub ledger: Ledger,
}

impl<W: Wire> Rig<W> {
    /// Motors 1 to `motors`, and a master with the library's configuration.
    pub fn new(motors: u8, seed: u64) -> Self {
        Self::with_config(motors, seed, W::CONFIG)
    }

    /// As [`Self::new`], but the master has this configuration.
    pub fn with_config(motors: u8, seed: u64, config: Config) -> Self {
        let world = W::world(seed);
        let ledger = Ledger::new();
        let (runner, port) = W::runner(&world, config);
        let nodes: Vec<StationId> = MotorId::all()
            .take(motors.into())
            .map(|motor| {
                let teller = Teller::<W> {
                    wire: PhantomData,
                    motor,
                    receiver: Receiver::new(),
                    replies: VecDeque::new(),
                    dice: Dice::new(seed ^ u64::from(motor.get()) << 32),
                    ledger: ledger.clone(),
                };
                W::seat(&world, teller)
            })
            .collect();
        let (first, book, count) = (nodes[0].index(), ledger.clone(), nodes.len());
        let mut shows = false;
        world.observe(move |record| match &record.event {
            Event::Carried { frame, .. } => {
                let of_master = record.station == port;
                let packet = W::packet(&mut Receiver::new(), frame, of_master);
                let Some(packet) = packet else { return };
                shows = shows_echo(&packet);
                match packet.channel {
                    Channel::Reply(_) if shows => {}
                    Channel::Reply(motor) | Channel::MotionReply(motor) => {
                        book.pages()[motor.index()].replied += 1;
                    }
                    _ if of_master => book.carried_command(&packet, record.at()),
                    _ => {}
                }
            }
            Event::Faulted { from, fault: Fault::Lost } if record.station == port && !shows => {
                let motor = from.index().checked_sub(first).filter(|motor| *motor < count);
                if let Some(motor) = motor {
                    book.pages()[motor].replies_lost += 1;
                }
            }
            _ => {}
        });
        Self { world, runner, port, nodes, ledger }
    }

    /// The number of answers of the first motor that show that the adapter does not echo.
    pub const SHOWN: u32 = 4;

    /// Gets these answers, so that each acknowledgement counts from now on.
    pub fn shows_no_echo(&mut self) {
        for _ in 0..Self::SHOWN {
            self.runner.ask(MotorId::MIN, ReadStatus1).expect("the bus is whole");
        }
    }

    /// Sets the faults of the bus from now on, in both directions.
    pub fn strike(&self, plan: FaultPlan) {
        for direction in [Direction::ToNodes, Direction::ToPorts] {
            self.world.set_faults(direction, plan);
        }
    }

    /// Puts a set-point of a stream of speeds.
    pub fn put(&mut self, motor: MotorId, number: u32) -> Result<(), RequestError> {
        put(&mut self.runner, motor, number)
    }

    /// Puts a set-point for every motor.
    pub fn put_all(&mut self, number: u32) {
        for motor in self.motors() {
            self.put(motor, number).expect("there is a place");
        }
    }

    /// Runs the master for this long and returns its events. Ignores errors of the bus.
    pub fn run_for(&mut self, span: Duration) -> Vec<master::Event> {
        let until = self.world.now() + span;
        let mut events = Vec::new();
        while self.world.now() < until {
            match self.runner.poll() {
                Ok(Some(event)) => events.push(event),
                Ok(None) => self.runner.idle(until),
                Err(_) => self.world.run_for(Duration::from_micros(200)),
            }
        }
        events
    }

    /// The ids of the drives.
    pub fn motors(&self) -> impl Iterator<Item = MotorId> + use<W> {
        MotorId::all().take(self.nodes.len())
    }
}
