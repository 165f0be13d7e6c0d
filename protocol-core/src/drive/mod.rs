//! The drive as a state machine: the same frames, seen from the other end.
//!
//! A [`Drive`] does what the manual says that a drive does when it receives a frame. It turns a [`Plant`] and remembers
//! in a [`Memory`]. It owns no bus and reads no clock.
//!
//! # Call order
//!
//! - Pass every packet on the bus to [`handle_packet`](Drive::handle_packet), even those for others: the drive knows
//!   what is meant for it.
//! - Call [`poll_transmit`](Drive::poll_transmit) until it returns `None`, whenever [`poll_at`](Drive::poll_at) has
//!   come or a packet has been handled. Send what it returns on the bus.
//! - [`poll_event`](Drive::poll_event) returns what happened, for a watcher. It may be left out.
//! - On real hardware call [`advance`](Drive::advance) once every [`control_period`](Parameters::control_period). A
//!   simulation need not: every call catches up on its own.
//!
//! ```
//! use myactuator_protocol_core::command::{AbsolutePosition, AnyReply, Command};
//! use myactuator_protocol_core::drive::{Drive, IdealPlant, Parameters, RamMemory};
//! use myactuator_protocol_core::time::Instant;
//! use myactuator_protocol_core::units::{Angle, MaxSpeed};
//! use myactuator_protocol_core::{Firmware, MotorId};
//!
//! let mut now = Instant::ZERO;
//! let mut drive =
//!     Drive::new(Parameters::default(), IdealPlant::default(), RamMemory::default(), now).unwrap();
//!
//! let go = AbsolutePosition { max_speed: MaxSpeed::from_raw(500), angle: Angle::from_raw(36_000) };
//! let packet = go.packet(MotorId::MIN);
//! drive.handle_packet(&packet, now);
//!
//! // Nothing happens before the drive's response delay is over.
//! assert_eq!(drive.poll_transmit(now), None);
//! now = drive.poll_at().unwrap();
//! let reply = drive.poll_transmit(now).unwrap();
//! assert!(matches!(AnyReply::decode(&reply, Firmware::V4_3), Ok(AnyReply::AbsolutePosition(_))));
//!
//! while now < Instant::from_millis(1_500) {
//!     now = drive.poll_at().unwrap();
//!     drive.advance(now);
//! }
//! assert!((drive.state().angle_deg - 360.0).abs() < 0.1);
//! ```
//!
//! The manual leaves much open: [`decisions`] says what this drive does there. [`Quirks`] has what real drives were
//! seen to do that the manual does not describe.

mod answer;
mod brake;
mod control;
pub mod decisions;
mod derating;
mod encoder;
mod event;
mod faults;
mod ideal;
mod life;
mod limits;
mod parameters;
mod plant;
mod print;
mod protection;
mod queue;
mod quirks;
mod random;
mod reply;
mod reporting;
mod settings;
mod state;

pub use derating::Derating;
pub use event::{Event, IgnoreReason, Limit, NotRunReason};
pub use faults::Indicator;
pub use ideal::IdealPlant;
pub use parameters::{Bus, FaultLimits, Parameters};
pub use plant::{Actuation, Measurement, Plant};
pub use quirks::Quirks;
pub use settings::{Accelerations, Gains, Memory, RamMemory, Settings};
pub use state::State;

use crate::command::{AnyCommand, BaudCode, ErrorFlags};
use crate::id::{MotorId, Target};
use crate::opcode::{Buses, LOST_MASTER_BYTE, Opcode};
use crate::packet::{Channel, Packet};
use crate::time::{Duration, Instant};

use brake::Brake;
use control::{Controller, Input};
use encoder::Encoder;
use event::Events;
use faults::Faults;
use life::Life;
use limits::Limits;
use protection::Protection;
use queue::DropOldest;
use random::Random;
use reply::Replies;
use reporting::{Report, Reporting};

/// How often measurements are compared with their limits, if the loops run more often than that.
const JUDGED_EVERY: Duration = Duration::from_millis(1);

/// How many control steps one call runs at most. With the default period that is one second.
pub const MAX_STEPS_PER_CALL: u32 = 10_000;

/// How far the loops may fall behind before [`Drive::poll_at`] asks for a call.
const CATCH_UP: Duration = Duration::from_millis(10);

/// How many packets wait to be sent, and how many events to be polled, at most. Beyond that the oldest
/// are dropped and counted.
pub const QUEUE_LENGTH: usize = 16;

/// A packet that waits for its time.
#[derive(Clone, Copy, Debug)]
struct Outgoing {
    due: Instant,
    packet: Packet,
}

/// A drive with its motor. See the [module](self) for the call order.
#[derive(Clone, Debug)]
pub struct Drive<P, M> {
    parameters: Parameters,
    plant: P,
    memory: M,
    /// What the memory holds.
    stored: Settings,
    /// What acts until the next start.
    active: Settings,
    life: Life,
    /// Up to when the loops have run.
    clock: Instant,
    /// Up to when measurements have been held against their limits.
    judged: Instant,
    measurement: Measurement,
    encoder: Encoder,
    /// What function 1 subtracts from the raw position at the next start.
    turns_to_clear: i64,
    /// The last bus id taken, and when.
    id_taken: Option<(MotorId, Instant)>,
    controller: Controller,
    brake: Brake,
    faults: Faults,
    protection: Protection,
    reporting: Reporting,
    random: Random,
    replies: Replies,
    outgoing: DropOldest<Outgoing, QUEUE_LENGTH>,
    limits: Limits,
    events: Events,
}

impl<P: Plant, M: Memory> Drive<P, M> {
    /// A drive that gets its supply at `now`, with the settings in `memory`, or with factory settings if that is empty.
    ///
    /// # Errors
    /// The memory's error.
    pub fn new(
        parameters: Parameters,
        mut plant: P,
        mut memory: M,
        now: Instant,
    ) -> Result<Self, M::Error> {
        let stored = memory.load()?.unwrap_or_else(|| {
            Settings::factory(parameters.id, parameters.factory_gains, parameters.baud_rate)
        });
        let measurement = plant.advance(&Actuation::default(), Duration::ZERO);
        let mut drive = Self {
            encoder: Encoder::new(&parameters),
            brake: Brake::new(parameters.has_brake),
            random: Random::new(parameters.seed),
            life: Life::Off,
            stored,
            active: stored,
            clock: now,
            judged: now,
            measurement,
            turns_to_clear: 0,
            id_taken: None,
            controller: Controller::new(),
            faults: Faults::default(),
            protection: Protection::default(),
            reporting: Reporting::default(),
            replies: Replies::default(),
            outgoing: DropOldest::new(),
            limits: Limits::default(),
            events: Events::new(now),
            parameters,
            plant,
            memory,
        };
        drive.boot(now);
        Ok(drive)
    }

    /// Whether a packet on this channel is for this drive, as far as identifiers say.
    pub fn is_addressed(&self, channel: Channel) -> bool {
        match channel {
            Channel::Command(Target::All) | Channel::BusId => true,
            Channel::Command(Target::Motor(id)) | Channel::Motion(id) => id == self.id(),
            Channel::Reply(_) | Channel::MotionReply(_) => false,
        }
    }

    /// Takes a packet from the bus. A packet that is not for this drive changes nothing.
    ///
    /// A malformed, unknown or out-of-range command is ignored, as a real drive would, and reported
    /// as [`Event::Ignored`]. Does the work of [`advance`](Self::advance) first.
    pub fn handle_packet(&mut self, packet: &Packet, now: Instant) {
        self.advance(now);
        self.events.now = now;
        if !self.is_addressed(packet.channel) {
            return;
        }
        let to_all = packet.channel == Channel::Command(Target::All);
        match self.life {
            Life::Off | Life::BrownedOut => {
                return self.ignore(packet, IgnoreReason::PoweredOff);
            }
            Life::Booting { .. } => return self.ignore(packet, IgnoreReason::Starting),
            Life::Running { .. } => {}
        }
        // RS485 has no identifiers to filter by.
        if to_all && self.active.can_id_filter && self.parameters.bus == Bus::Can {
            return self.ignore(packet, IgnoreReason::IdFilter);
        }
        let answer = self.known(packet).and_then(|opcode| self.answer(opcode, packet, now));
        match answer {
            Ok(Some(data)) => {
                let channel = match packet.channel {
                    Channel::BusId => Channel::BusId,
                    Channel::Motion(_) => Channel::MotionReply(self.replies_as()),
                    _ => Channel::Reply(self.replies_as()),
                };
                self.reply(Packet { channel, data }, packet.channel, now);
            }
            Ok(None) => {}
            Err(reason) => {
                if reason.is_of_unknown_command() {
                    self.reply_to_unknown(packet.channel, now);
                }
                self.ignore(packet, reason);
            }
        }
        self.follow_reports(now);
    }

    /// The kind of a command, if this drive knows it.
    fn known(&self, packet: &Packet) -> Result<Opcode, IgnoreReason> {
        let command = AnyCommand::decode(packet, self.parameters.firmware)?;
        let opcode = command.opcode().ok_or(IgnoreReason::UnknownCommand)?;
        if self.parameters.bus == Bus::Rs485 && opcode.buses() == Buses::CanOnly {
            return Err(IgnoreReason::CanOnly(opcode));
        }
        Ok(opcode)
    }

    /// Runs the control loops up to `now`, in whole steps of [`control_period`](Parameters::control_period), with
    /// everything that time does to a drive: errors, loss of communication, the end of a start.
    ///
    /// One call runs at most [`MAX_STEPS_PER_CALL`] steps. [`clock`](Self::clock) returns how far it came; if more time
    /// has passed, call again. A `now` before the last one changes nothing.
    pub fn advance(&mut self, now: Instant) {
        let period = self.parameters.control_period.max(Duration::from_micros(1));
        for _ in 0..MAX_STEPS_PER_CALL {
            let end = self.clock + period;
            if end > now || end == self.clock {
                break;
            }
            self.step(end, period);
        }
    }

    /// The next packet to send at `now`: a reply whose delay is over, or a report. Does the work of
    /// [`advance`](Self::advance) first.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Packet> {
        self.advance(now);
        if self.outgoing.first().is_some_and(|outgoing| outgoing.due <= now) {
            return self.outgoing.pop().map(|outgoing| outgoing.packet);
        }
        if !matches!(self.life, Life::Running { .. }) {
            return None;
        }
        let channel = Channel::Reply(self.replies_as());
        let data = match self.reporting.poll(now)? {
            Report::Status1 => self.report(Opcode::ReadStatus1, now)?,
            Report::Heartbeat => [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0],
            Report::Active(opcode) => self.report(opcode, now)?,
        };
        Some(Packet { channel, data })
    }

    /// When [`poll_transmit`](Self::poll_transmit) next has something to do, if no packet comes before:
    ///
    /// - A reply or a report is due, a start ends, or communication is lost.
    /// - The loops are 10 ms behind: a motor moves and errors come at any time.
    /// - While errors are to be reported (function 3), or the supply is too low: whenever measurements are compared
    ///   with their limits, every millisecond.
    ///
    /// `None` only at the end of time.
    pub fn poll_at(&self) -> Option<Instant> {
        let period = self.parameters.control_period;
        let catch_up = if self.reporting.errors_wanted() || self.life == Life::BrownedOut {
            self.judged + period.max(JUDGED_EVERY)
        } else {
            self.clock + period.max(CATCH_UP)
        };
        // The loops see it one step later.
        let silence = self.protection.deadline(self.protection_timeout()).map(|at| at + period);
        let reply = self.outgoing.first().map(|outgoing| outgoing.due);
        let started = if let Life::Booting { until, .. } = self.life { Some(until) } else { None };
        let report = self.reporting.poll_at();
        [reply, started, report, silence, Some(catch_up)].into_iter().flatten().min()
    }

    /// The next thing that happened, oldest first.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.poll_timed_event().map(|(_, event)| event)
    }

    /// As [`poll_event`](Self::poll_event), with when it happened.
    pub fn poll_timed_event(&mut self) -> Option<(Instant, Event)> {
        self.events.pop()
    }

    /// Raises errors by hand, on top of those that measurements cause. Those of level two last until
    /// [`clear_fault`](Self::clear_fault), those of level one until a restart.
    pub fn raise_fault(&mut self, errors: ErrorFlags) {
        self.change_faults(|faults| faults.raise(errors));
    }

    /// Takes away the cause of errors raised by hand. Those of level one stay until a restart, as they
    /// do on a real drive.
    pub fn clear_fault(&mut self, errors: ErrorFlags) {
        self.change_faults(|faults| faults.take_away(errors));
    }

    /// Up to when the loops have run.
    pub const fn clock(&self) -> Instant {
        self.clock
    }

    /// The id that the drive listens to. A change acts after a restart.
    pub const fn id(&self) -> MotorId {
        self.active.id
    }

    /// The bit rate that the drive speaks at. A change (0xB4) acts
    /// [after a restart](decisions#bit-rate).
    pub const fn baud_rate(&self) -> BaudCode {
        self.active.baud_rate
    }

    /// The same in bit/s; `None` where the manual gives that code no rate on the drive's bus.
    pub const fn bit_rate(&self) -> Option<u32> {
        self.parameters.bus.bits_per_second(self.active.baud_rate)
    }

    /// The settings that act now.
    pub const fn settings(&self) -> &Settings {
        &self.active
    }

    /// The settings that the memory holds, which act after a restart.
    pub const fn stored_settings(&self) -> &Settings {
        &self.stored
    }

    /// What no command changes.
    pub const fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// What the drive turns.
    pub const fn plant(&self) -> &P {
        &self.plant
    }

    /// What the drive turns, to load or push it.
    pub const fn plant_mut(&mut self) -> &mut P {
        &mut self.plant
    }

    /// The memory in which the drive remembers.
    pub const fn memory(&self) -> &M {
        &self.memory
    }

    /// How many packets and events were dropped because nobody polled them in time.
    pub const fn dropped(&self) -> (u32, u32) {
        (self.outgoing.dropped(), self.events.dropped())
    }

    /// Measures at once, and not only at the next control step: for use after a change of the
    /// [plant](Self::plant_mut).
    pub fn measure(&mut self) {
        self.act(&Actuation::default(), Duration::ZERO);
    }

    fn act(&mut self, actuation: &Actuation, span: Duration) {
        self.measurement = self.plant.advance(actuation, span);
        self.encoder.measure(self.measurement.encoder_pulses);
    }

    /// One control step, up to `end`.
    fn step(&mut self, end: Instant, period: Duration) {
        self.events.now = end;
        let input = self.input();
        let brake_released = self.follow_brake(self.clock);
        let mut actuation = Actuation { brake_released, ..Actuation::default() };
        if matches!(self.life, Life::Running { .. }) {
            let (gains, accelerations) = (&self.active.gains, &self.active.accelerations);
            let dt = period.as_secs_f32();
            if let Some(current_a) = self.controller.step(&input, gains, accelerations, dt) {
                actuation.output_on = true;
                actuation.current_a = current_a;
            }
        }
        self.act(&actuation, period);
        self.clock = end;
        let unjudged = end - self.judged;
        let is_time = unjudged >= JUDGED_EVERY;
        if is_time {
            self.judged = end;
            self.follow_supply();
        }
        match self.life {
            Life::Off | Life::BrownedOut => {}
            Life::Booting { since, until } => {
                if until <= end {
                    self.start(since);
                }
            }
            Life::Running { .. } => {
                if is_time {
                    self.watch_limits(&actuation, unjudged);
                    let (measurement, parameters) = (self.measurement, self.parameters);
                    self.change_faults(|faults| {
                        faults.observe(&measurement, &parameters, unjudged)
                    });
                }
                if self.protection.check(end, self.protection_timeout()) {
                    self.cut_output();
                    self.events.push(Event::ProtectionTripped);
                    self.follow_reports(end);
                }
            }
        }
    }

    fn input(&self) -> Input {
        Input {
            angle_deg: self.encoder.angle_deg(),
            speed_dps: self.measurement.speed_dps,
            current_a: self.measurement.current_a,
            stall_current_a: self.largest_a(),
            torque_constant_nm_per_a: self.parameters.torque_constant_nm_per_a,
            max_speed_dps: self.parameters.max_speed_dps,
        }
    }

    fn change_faults(&mut self, change: impl FnOnce(&mut Faults)) {
        let before = self.faults.all();
        change(&mut self.faults);
        let after = self.faults.all();
        let (came, went) = (after - before, before - after);
        if !came.is_empty() {
            self.cut_output();
            self.events.push(Event::FaultRaised(came));
        }
        if !went.is_empty() {
            self.events.push(Event::FaultCleared(went));
        }
        if before != after {
            self.follow_reports(self.clock);
        }
    }

    /// Output off, no mode, brake locked.
    fn cut_output(&mut self) {
        self.controller.shut_down();
        let at = self.brake_moves_at(self.clock);
        self.brake.lock(at, self.clock);
    }

    fn follow_reports(&mut self, now: Instant) {
        let error = !self.faults.all().is_empty();
        let lost = self.protection.is_tripped() && self.parameters.quirks.lost_master_heartbeat;
        self.reporting.follow(error, lost, now);
    }

    fn protection_timeout(&self) -> Duration {
        Duration::from_millis(self.active.protection_timeout.raw().into())
    }

    fn ignore(&mut self, packet: &Packet, reason: IgnoreReason) {
        self.events.push(Event::Ignored { packet: *packet, reason });
    }
}
