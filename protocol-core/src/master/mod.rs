//! The master as a state machine: as many requests in flight as the bus carries, and never an answer
//! to the wrong question.
//!
//! - [`Master::request`] asks one motor for something and gives a [`Ticket`] that knows the answer.
//! - [`Master::set_point`] streams set-points: only the newest of each motor waits.
//! - [`Master::broadcast`] asks all motors at once.
//! - [`Master::stop_all`] stops them, before anything else.
//!
//! # How answers find their questions
//! Each motor has at most one command in flight, so that it is never in doubt what a reply is about.
//! A reply is the answer to a request only if it comes from that motor, carries its command byte and
//! index, and comes no sooner than [`Config::shortest_response`]. A request that is given up may
//! still be answered late; until [`Config::late_window`] has passed, or the late reply has surely
//! come, no other request goes to that motor. After a broadcast, requests of its kind wait likewise
//! for the motors that have not answered it, and the next broadcast waits for all. Feedback of a
//! stream looks like the reply to a request of the same kind, so there is one or the other.
//!
//! So an answer can only be wrong if the bus holds a frame back for longer than the late window, or
//! if a command reaches its drive twice and the second reply comes later than
//! [`Config::shortest_response`] after the next request of its kind.
//!
//! # How the bus is shared
//! The motor that was served least goes first. On a full CAN bus replies of high ids lose every
//! arbitration against those of low ids and all commands; so no motor gets more than one round ahead
//! of one that may be waiting for its turn to answer. Whoever was silent before, or had its chance on
//! a quiet bus, is not waited for: on CAN a silent motor costs the others the time of its own commands
//! on the bus and no more. On RS485 there is one exchange at a time, and each command to a silent
//! motor keeps the line for [`Config::reply_timeout`].

mod broadcast;
mod config;
mod event;
mod health;
mod lane;
mod motor_set;
mod receive;
mod schedule;
#[cfg(test)]
mod tests;

pub use config::{Bus, Config, Patience};
pub use event::{Event, Failure, Ticket, TicketId};
pub use health::{Health, Presence};
pub use motor_set::MotorSet;

use crate::command::{Command, FunctionIndex, SetPoint, Shutdown, Stop};
use crate::data::Data;
use crate::error::RequestError;
use crate::id::{MotorId, Target};
use crate::kind::Kind;
use crate::opcode::{Opcode, Usage};
use crate::packet::Packet;
use crate::time::{Duration, Instant};
use broadcast::Broadcast;
use lane::{Flags, Lane, RequestState};
use schedule::Earliest;

/// How motors are to be stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum StopKind {
    /// 0x81: stop and hold still (2.18).
    Hold,
    /// 0x80: switch the outputs off (2.17). The shafts are free to turn unless brakes hold them.
    Off,
}

/// How long a stop's confirmation is waited for at the most before the stop is sent once more.
const LONGEST_STOP_TIMEOUT: Duration = Duration::from_millis(50);

/// What [`Master::poll_transmit`] has offered last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Offer {
    Request(u8),
    SetPoint(u8),
    Broadcast,
}

/// The master of one bus with up to `N` motors.
///
/// It does no I/O and reads no clock. Whoever runs it calls, in any order and as often as there is
/// reason:
///
/// 1. [`handle_frame`](Self::handle_frame) (CAN) or [`handle_line`](Self::handle_line) (RS485) with
///    what was received; each call gives at most one event;
/// 2. [`handle_timeout`](Self::handle_timeout) with the time, after receiving and at least when
///    [`poll_at`](Self::poll_at) says;
/// 3. [`poll_transmit`](Self::poll_transmit) for what to send next, and
///    [`handle_transmitted`](Self::handle_transmitted) once the bus has taken it, until there is
///    nothing more to send or the bus takes no more;
/// 4. [`poll_event`](Self::poll_event) until it gives nothing more.
///
/// The loops of [`io`](crate::io) do just that.
///
/// ```
/// use myactuator_protocol_core::command::{MultiTurnAngle, ReadMultiTurnAngle};
/// use myactuator_protocol_core::master::{Config, Master};
/// use myactuator_protocol_core::time::Instant;
/// use myactuator_protocol_core::units::Angle;
/// use myactuator_protocol_core::wire::can::Received;
/// use myactuator_protocol_core::{Channel, MotorId, Opcode, Packet};
///
/// let elbow = MotorId::new(1)?;
/// let mut master = Master::<8>::new(Config::CAN);
/// let ticket = master.request(elbow, ReadMultiTurnAngle)?;
///
/// // The bus takes the command.
/// let command = master.poll_transmit(Instant::from_millis(0)).unwrap();
/// assert_eq!(command.data[0], 0x92);
/// master.handle_transmitted(Instant::from_millis(0));
///
/// // A millisecond later the drive answers.
/// let angle = MultiTurnAngle { angle: Angle::from_degrees(360.0)? };
/// let reply = Packet {
///     channel: Channel::Reply(elbow),
///     data: angle.encode(Opcode::ReadMultiTurnAngle),
/// };
/// let event = master.handle_frame(&Received::Packet(reply), Instant::from_millis(1)).unwrap();
/// assert_eq!(ticket.outcome(&event), Some(Ok(Some(angle))));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Master<const N: usize> {
    lanes: [Lane; N],
    broadcast: Broadcast,
    config: Config,
    offer: Option<Offer>,
    stopped: bool,
    /// RS485: bytes of the echo that are still to come.
    echo_left: u8,
    /// The round that the motors are in: that of the last one served.
    pace: u8,
    /// Until when the frames that were sent keep the bus busy, or when one was last received. On
    /// RS485: when the line may be used again.
    busy_until: Instant,
}

impl<const N: usize> Master<N> {
    const CAPACITY: () = assert!(N >= 1 && N <= 32, "a master has 1 to 32 motors");

    /// A master that knows no motor yet: a place is taken at a motor's first request.
    pub fn new(config: Config) -> Self {
        const { Self::CAPACITY };
        Self {
            lanes: [Lane::default(); N],
            broadcast: Broadcast::default(),
            config,
            offer: None,
            stopped: false,
            echo_left: 0,
            pace: 0,
            busy_until: Instant::ZERO,
        }
    }

    /// Sends one motor a command and waits for its reply, where it has one, with the configuration's
    /// patience. A command that [ends motion](Kind::ends_motion) drops the motor's waiting set-point.
    ///
    /// # Errors
    /// [`RequestError`]: the command does not go to one motor or not over this bus, the motor's
    /// earlier request is under way, the motor follows a stream of this kind, the motors were stopped,
    /// or there is no place for one more.
    pub fn request<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
    ) -> Result<Ticket<C>, RequestError> {
        self.put_request(motor, command, None)
    }

    /// As [`request`](Self::request), with a patience of its own.
    ///
    /// # Errors
    /// As [`request`](Self::request).
    pub fn request_with<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
        patience: Patience,
    ) -> Result<Ticket<C>, RequestError> {
        self.put_request(motor, command, Some(patience))
    }

    /// As [`request`](Self::request), with a patience of its own or the configuration's.
    pub(crate) fn put_request<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
        patience: Option<Patience>,
    ) -> Result<Ticket<C>, RequestError> {
        let data = command.encode();
        let kind = command.kind().of_bytes(&data);
        self.check(kind, motor.into())?;
        let patience = patience.unwrap_or_else(|| self.config.patience(kind));
        let pace = self.pace;
        // What was offered may be a set-point that this ends.
        self.offer = None;
        let lane = self.lane_for(motor)?;
        if lane.request != RequestState::Idle || lane.flags.contains(Flags::TELL_STOPPED) {
            return Err(RequestError::Busy);
        }
        if let Some(opcode) = kind.opcode() {
            if reported_bit(opcode).is_some_and(|bit| lane.reported & bit != 0) {
                return Err(RequestError::Reported(opcode));
            }
            if lane.is_streamed(kind) {
                return Err(RequestError::Streamed(opcode));
            }
        }
        if kind.ends_motion() {
            lane.drop_set_point();
        }
        lane.join(pace);
        lane.put_request(kind, data, patience);
        lane.generation = lane.generation.wrapping_add(1);
        Ok(Ticket::new(TicketId { motor, generation: lane.generation }))
    }

    /// Puts a set-point in a motor's stream. One that still waits is replaced and counted, never
    /// queued up; one that waits for longer than [`Config::set_point_max_age`] is dropped.
    ///
    /// # Errors
    /// [`RequestError`]: the command does not go over this bus, the motors were stopped, a request of
    /// the same kind is under way, or there is no place for one more motor.
    pub fn set_point<C: SetPoint>(
        &mut self,
        motor: MotorId,
        command: C,
        now: Instant,
    ) -> Result<(), RequestError> {
        let data = command.encode();
        let kind = command.kind().of_bytes(&data);
        self.check(kind, motor.into())?;
        match kind {
            Kind::Known(opcode) if opcode.usage() != Usage::SetPoint => {
                return Err(RequestError::NotASetPoint(opcode));
            }
            _ => {}
        }
        let expiry = now + self.config.set_point_max_age;
        // What was offered is older than this.
        self.offer = None;
        let pace = self.pace;
        let lane = self.lane_for(motor)?;
        if lane.request != RequestState::Idle && lane.request_kind == Some(kind) {
            return Err(RequestError::Busy);
        }
        lane.join(pace);
        lane.put_set_point(kind, data, expiry);
        Ok(())
    }

    /// Asks all motors at once (CAN 0x280, RS485 0xCD) and collects the answers of `expected` until
    /// all have come or the time is up. It is sent when no request is in flight, and requests wait
    /// until it is over. On CAN it reaches motors whose id filter (function 2) is off; on RS485 the
    /// answers of several motors are likely to collide. `expected` should name all who answer: the
    /// answers of others come as [`Event::Stray`].
    ///
    /// The next broadcast waits until all motors that have a place have answered this one, or its
    /// answers cannot come any more.
    ///
    /// # Errors
    /// [`RequestError`]: the command has no form for all motors or none on this bus, another
    /// broadcast is under way, or the motors were stopped.
    pub fn broadcast<C: Command>(
        &mut self,
        command: C,
        expected: MotorSet,
    ) -> Result<(), RequestError> {
        let data = command.encode();
        let kind = command.kind().of_bytes(&data);
        self.check(kind, Target::All)?;
        if self.broadcast.is_active() {
            return Err(RequestError::Busy);
        }
        self.broadcast.put(kind, data, expected);
        Ok(())
    }

    /// Stops every motor that this master knows and those of `also`, before anything else is sent
    /// and, on CAN, whatever is in flight. Waiting requests and set-points are dropped. Until
    /// [`lift_stop`](Self::lift_stop) much [is refused](Kind::is_refused_while_stopped): set-points, a
    /// restart and writes to ROM, for example, but not reads.
    ///
    /// Each motor gets its first stop before any gets its second. Its confirmation, or its absence, comes
    /// as an event; a stop that is not confirmed within 50 ms is repeated, however long
    /// [`Config::reply_timeout`] is.
    ///
    /// # Errors
    /// [`RequestError::TooManyMotors`] if there is no place for all of `also`; the others are
    /// stopped all the same.
    pub fn stop_all(&mut self, kind: StopKind, also: MotorSet) -> Result<(), RequestError> {
        let (command, data) = match kind {
            StopKind::Hold => (Kind::Known(Opcode::Stop), Stop.encode()),
            StopKind::Off => (Kind::Known(Opcode::Shutdown), Shutdown.encode()),
        };
        self.stopped = true;
        self.offer = None;
        self.broadcast.cancel();
        let mut result = Ok(());
        for motor in also.iter() {
            result = result.and(self.lane_for(motor).map(|_| ()));
        }
        let timeout = self.config.reply_timeout.min(LONGEST_STOP_TIMEOUT);
        for lane in &mut self.lanes {
            if lane.motor.is_some() {
                lane.put_stop(command, data, timeout);
            }
        }
        result
    }

    /// Accepts again what [`stop_all`](Self::stop_all) made it refuse.
    pub fn lift_stop(&mut self) {
        self.stopped = false;
    }

    /// What to send next. It counts as sent only after [`handle_transmitted`](Self::handle_transmitted);
    /// until then each call chooses anew, so that what was offered is never staler than what waits.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Packet> {
        self.offer = None;
        if self.config.is_rs485() && (self.is_anything_in_flight() || self.busy_until > now) {
            return None;
        }
        let (offer, packet) = self.choose()?;
        self.offer = Some(offer);
        Some(packet)
    }

    /// The bus has taken what [`poll_transmit`](Self::poll_transmit) offered last. On RS485: its
    /// last byte has left.
    pub fn handle_transmitted(&mut self, now: Instant) {
        let config = self.config;
        let mut told_without_reply = false;
        match self.offer.take() {
            Some(Offer::Request(index)) => {
                if let Some(lane) = self.lanes.get_mut(usize::from(index)) {
                    let kind = lane.request_kind;
                    let awaits_reply =
                        kind.is_some_and(|kind| awaits_reply(kind, &lane.request_data));
                    told_without_reply = !awaits_reply;
                    let hold = kind.map_or(Duration::ZERO, |kind| config.hold_after(kind));
                    let data = lane.request_data;
                    note_report(lane, kind, &data);
                    self.pace = lane.round;
                    lane.request_was_sent(now, awaits_reply, hold);
                }
            }
            Some(Offer::SetPoint(index)) => {
                if let Some(lane) = self.lanes.get_mut(usize::from(index)) {
                    self.pace = lane.round;
                    lane.set_point_was_sent(now);
                }
            }
            Some(Offer::Broadcast) => {
                let (kind, data) = self.broadcast.command();
                for lane in &mut self.lanes {
                    note_report(lane, kind, &data);
                }
                self.broadcast.was_sent(now, config.reply_timeout, config.late_window);
            }
            None => return,
        }
        if !config.is_rs485() {
            self.bus_is_busy(now);
        } else {
            self.echo_left = if matches!(config.bus, Bus::Rs485 { echo: true, .. }) {
                crate::wire::rs485::FRAME_LENGTH as u8
            } else {
                0
            };
            // An answer that nobody waits for may come all the same, and must not meet a command.
            let silence = if told_without_reply { config.settle_time } else { Duration::ZERO };
            self.line_is_free_after_turnaround(now + silence);
        }
    }

    /// Takes note of the time: what is overdue is sent again or given up, what is too old is dropped.
    pub fn handle_timeout(&mut self, now: Instant) {
        let Config { late_window, reply_timeout, longest_response, .. } = self.config;
        let is_quiet = self.quiet_at() <= now;
        for lane in &mut self.lanes {
            if lane.motor.is_none() {
                continue;
            }
            lane.age(now, late_window);
            if lane.flags.contains(Flags::SET_POINT_WAITING) && lane.set_point_expiry <= now {
                lane.drop_set_point();
            }
            if is_quiet && lane.is_in_flight() && now - lane.sent >= longest_response {
                lane.flags.insert(Flags::OVERDUE);
            }
            if !lane.is_in_flight() || lane.deadline(reply_timeout) > now {
                continue;
            }
            lane.missed();
            if lane.request != RequestState::InFlight {
                lane.give_set_point_up(now, late_window);
            } else if lane.attempts_left > 0 {
                lane.request = RequestState::Waiting;
            } else {
                let is_stop = lane.flags.contains(Flags::STOP);
                if is_stop {
                    lane.flags.insert(Flags::TELL_UNCONFIRMED);
                }
                let outcome = if is_stop { RequestState::Idle } else { RequestState::NoReply };
                lane.finish_request(outcome, now, late_window);
            }
        }
        self.age_broadcast(now);
    }

    /// The bus carries nothing: the controller is off the bus, or nobody acknowledges. Everything that
    /// waits is dropped, so that nothing moves when the bus comes back and nobody waits for ever. Only
    /// stops go on waiting.
    pub fn handle_bus_down(&mut self, now: Instant) {
        self.offer = None;
        if self.broadcast.is_waiting() {
            self.broadcast.cancel();
        }
        let late_window = self.config.late_window;
        for lane in &mut self.lanes {
            lane.drop_set_point();
            // What is stuck on the way comes later than the window allows: it begins anew.
            if lane.is_late_reply_due() {
                lane.hold_longer(now, late_window);
            }
            if lane.request == RequestState::Waiting && !lane.flags.contains(Flags::STOP) {
                lane.request = RequestState::BusDown;
            }
        }
    }

    /// The next event, apart from those that [`handle_frame`](Self::handle_frame) and
    /// [`handle_line`](Self::handle_line) returned.
    pub fn poll_event(&mut self) -> Option<Event> {
        if let Some(silent) = self.broadcast.take_result() {
            return Some(Event::BroadcastDone { silent });
        }
        self.lanes.iter_mut().find_map(lane_event)
    }

    /// When [`handle_timeout`](Self::handle_timeout) and [`poll_transmit`](Self::poll_transmit) have
    /// something to do by themselves; `None` while only a frame or a request can change anything.
    pub fn poll_at(&self) -> Option<Instant> {
        let mut earliest = Earliest::default();
        for lane in &self.lanes {
            lane.poll_at(self.config.reply_timeout, &mut earliest);
        }
        if self.config.is_rs485() {
            if !self.is_anything_in_flight() && self.choose().is_some() {
                earliest.take(self.busy_until);
            }
        } else if let Some(end) = self.courtesy_ends() {
            earliest.take(end);
        }
        self.broadcast.poll_at(&mut earliest);
        self.broadcast_wait(&mut earliest);
        earliest.0
    }

    /// How well a motor answers.
    pub fn health(&self, motor: MotorId) -> Health {
        let lane = self.lanes.iter().find(|lane| lane.motor == Some(motor));
        lane.map(|lane| lane.health).unwrap_or_default()
    }

    /// The motors that have a place.
    pub fn motors(&self) -> MotorSet {
        self.lanes.iter().filter_map(|lane| lane.motor).collect()
    }

    /// Gives a motor's place and counters up, so that another motor can have it. `false`, and
    /// nothing changes, while it has a request or a set-point under way or an event that was not
    /// polled.
    ///
    /// A late reply that may still come is no longer guarded against: leave the motor alone for
    /// [`Config::late_window`] after a request that was not answered.
    pub fn forget(&mut self, motor: MotorId) -> bool {
        let Some(lane) = self.lane_of(motor) else { return false };
        let idle = lane.is_idle();
        if idle {
            *lane = Lane::default();
        }
        idle
    }

    /// Whether any command waits for its reply.
    pub fn is_anything_in_flight(&self) -> bool {
        self.broadcast.is_in_flight() || self.lanes.iter().any(Lane::is_in_flight)
    }

    fn check(&self, kind: Kind, target: Target) -> Result<(), RequestError> {
        kind.channel_to(target)?;
        if self.config.is_rs485() {
            kind.check_on_rs485()?;
        }
        if self.stopped && kind.is_refused_while_stopped() {
            Err(RequestError::Stopped)
        } else {
            Ok(())
        }
    }

    /// The lane of a motor; for one that has none, a free one.
    #[inline(never)]
    fn lane_for(&mut self, motor: MotorId) -> Result<&mut Lane, RequestError> {
        let place_of = |motor| self.lanes.iter().position(|lane| lane.motor == motor);
        let place = place_of(Some(motor)).or_else(|| place_of(None));
        let found = place.and_then(|place| self.lanes.get_mut(place));
        let lane = found.ok_or(RequestError::TooManyMotors { capacity: N })?;
        lane.motor = Some(motor);
        Ok(lane)
    }

    #[inline(never)]
    fn lane_of(&mut self, motor: MotorId) -> Option<&mut Lane> {
        self.lanes.iter_mut().find(|lane| lane.motor == Some(motor))
    }
}

fn lane_event(lane: &mut Lane) -> Option<Event> {
    let motor = lane.motor?;
    let ticket = TicketId { motor, generation: lane.generation };
    let flag_event = |flag: Flags| match flag {
        Flags::TELL_STOPPED => Event::Failed { ticket, failure: Failure::Stopped },
        Flags::TELL_UNCONFIRMED => Event::StopUnconfirmed { motor },
        Flags::TELL_DROPPED => Event::SetPointDropped { motor },
        _ => Event::SetPointUnanswered { motor },
    };
    let tellable =
        [Flags::TELL_STOPPED, Flags::TELL_UNCONFIRMED, Flags::TELL_DROPPED, Flags::TELL_UNANSWERED];
    if let Some(flag) = tellable.into_iter().find(|&flag| lane.flags.contains(flag)) {
        lane.flags.remove(flag);
        return Some(flag_event(flag));
    }
    let event = match lane.request {
        RequestState::Idle | RequestState::Waiting | RequestState::InFlight => return None,
        RequestState::Sent => Event::Sent { ticket },
        RequestState::NoReply => Event::Failed { ticket, failure: Failure::NoReply },
        RequestState::NotExecuted => Event::Failed { ticket, failure: Failure::NotExecuted },
        RequestState::BusDown => Event::Failed { ticket, failure: Failure::BusDown },
    };
    lane.request = RequestState::Idle;
    Some(event)
}

/// The bit of a command that a drive can report by itself (2.34.2).
fn reported_bit(opcode: Opcode) -> Option<u8> {
    opcode.report_place().map(|place| 1 << place)
}

/// Whether a command is over only when its reply has come. Function 5 is over when it is sent: drives
/// were seen to obey it without the acknowledgement that 2.35.3 promises. One that comes is a stray.
fn awaits_reply(kind: Kind, data: &Data) -> bool {
    let sets_id =
        kind == Kind::Known(Opcode::FunctionControl) && data[1] == FunctionIndex::SET_CAN_ID.raw();
    kind.has_reply() && !sets_id
}

/// Keeps track of what a motor reports by itself, from the commands that switch it.
fn note_report(lane: &mut Lane, sent: Option<Kind>, data: &Data) {
    match sent.and_then(Kind::opcode) {
        Some(Opcode::Reset) => lane.reported = 0,
        Some(Opcode::ActiveReply) => {
            let [_, command, enable, ..] = *data;
            let bit = Opcode::from_byte(command).and_then(reported_bit).unwrap_or(0);
            if enable == 0 { lane.reported &= !bit } else { lane.reported |= bit }
        }
        _ => {}
    }
}
