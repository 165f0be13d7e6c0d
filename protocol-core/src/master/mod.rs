//! The master as a state machine: as many requests in flight as the bus carries, and never an answer
//! to the wrong question.
//!
//! - [`Master::request`] asks one motor for something and gives a [`Ticket`] that knows the answer.
//! - [`Master::set_point`] streams set-points: only the newest of each motor waits.
//! - [`Master::broadcast`] asks all motors at once.
//! - [`Master::stop_all`] stops them, before anything else.
//!
//! # How answers find their questions
//! Each motor has at most one command in flight. Its reply is known by the motor, the command byte and
//! the index, and comes no sooner than [`Config::shortest_response`]. What was given up may still be
//! answered: for [`Config::late_window`] such a reply is expected too, and until it has come or cannot come
//! any more, no equal question is put to that motor. Other questions are. After a broadcast, requests of
//! its kind wait likewise for the motors that have not answered it, and the next broadcast waits for all.
//! Every reply is held against this one list; what is not in it is an active report, or a stray.
//!
//! # What stops, and what a confirmation means
//! A stop goes before everything, whatever is in flight, and nothing older follows it: what waited is
//! dropped, and what a controller hands back is, too. A confirmation counts if it answers this stop and
//! not an earlier one, and if nothing that was sent before can move the motor any more: a set-point may
//! wait in a mailbox that the stop overtook, and there for as long as the bus is cut. Otherwise the stop goes once
//! more. So do requests that end motion, which wait for their turn otherwise, but not for moves of all that were
//! asked for later.
//!
//! # What can still go wrong
//! A reply says which motor, which command and which index, and not which of two equal commands it
//! answers. So an answer can be wrong if the bus holds a frame back for longer than the late window, if
//! a drive answers twice or a command reaches it twice (the second reply may be taken for that to the
//! next request of its kind), if two motors have one id, if another master asks the same at the same
//! time, or if a drive reports by itself what it was asked for (an error, or what it was told to report no
//! more and has not heard). A drive that has lost its master sends back the first command and ignores it:
//! if its message of that is lost, this may be taken for the answer. A restart shows by a second in which what the
//! motor is asked stays without an answer, by a run time that has gone back when it is read (0xB1), or by an angle
//! that jumps under a stream, of motion mode excepted: one that shows by none of these is not noticed. Nor is a jump
//! for as long as the feedback may be that to a set-point given up before: until the stream rests. An echo on
//! RS485 that nobody told of confirms a stop if noise has taken all echoes that would have shown it. A frame
//! from before a cut that an adapter holds back for longer than the reply time-out says that the bus is whole,
//! so that a stop may be confirmed before a move that lies in a mailbox. A stop of one motor, or to all, that has
//! lain in one until nobody expected its answer any more may come after a later stop of the other kind is confirmed.
//! And a stop cannot be confirmed by a motor whose replies do not come through: then cut its power. Where a bus swaps a
//! move and the stop behind it, and their answers as well, the stop is confirmed before it moves. And a command that was
//! given up for want of an answer may lie in the mailbox of a controller that nobody acknowledges: it is obeyed when the
//! bus is whole again, whenever that is, unless the controller can be reset. Nothing here can tell more.
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
mod late;
mod motor;
mod motor_set;
mod on_its_way;
mod places;
mod receive;
mod request;
mod restarts;
mod round_trips;
mod schedule;
mod stop;
mod stream;
#[cfg(test)]
mod tests;
mod transmit;

pub use config::{Bus, Config, Patience};
pub use event::{Event, Failure, Ticket, TicketId};
pub use health::{Health, Presence};
pub use motor_set::MotorSet;
pub use stop::StopKind;

use crate::command::{AnyReply, Command, SetPoint};
use crate::data::Data;
use crate::error::RequestError;
use crate::id::{MotorId, Target};
use crate::kind::Kind;
use crate::opcode::{Opcode, Usage};
use crate::time::Instant;
use broadcast::Broadcast;
use late::Question;
use motor::{Motor, News};
use places::Places;
use request::{Asked, Purpose, Request};
use round_trips::RoundTrips;
use schedule::Earliest;
use stream::SetPoint as StreamSetPoint;
use transmit::Offer;

/// As late as can be.
const NEVER: Instant = Instant::from_micros(u64::MAX);

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
///    nothing more to send or the bus takes no more; with [`handle_pushed_out`](Self::handle_pushed_out) for
///    what a controller hands back, and [`handle_bus_down`](Self::handle_bus_down) when it takes nothing for long;
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
/// assert_eq!(ticket.outcome(&event), Some(Ok(angle)));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Master<const N: usize> {
    motors: [Motor; N],
    places: Places,
    broadcast: Broadcast,
    /// Its time-outs are those of now.
    config: Config,
    /// `None` where these stay.
    round_trips: Option<RoundTrips>,
    offer: Option<Offer>,
    /// All were stopped so: nothing moves until that is lifted.
    stops_all: Option<StopKind>,
    /// These were stopped, each by itself.
    stopped: MotorSet,
    /// These were switched off by a stop that is in force: no other stop switches them on.
    switched_off: MotorSet,
    /// These have lost their master and will ignore the next command.
    lost_master: MotorSet,
    /// A stop to all at once is to be sent before each motor's own.
    stop_to_all: Option<StopKind>,
    /// The round that the motors are in: that of the last one served.
    pace: u32,
    last_ticket: u32,
    /// The last time that was told.
    now: Instant,
    /// No motor has anything to do by itself before this.
    due: Instant,
    /// Until when the frames that were sent keep the bus busy, or when one was last received. On
    /// RS485: when the line may be used again.
    busy_until: Instant,
    /// When a frame was last received. Only CAN looks at it.
    heard_at: Instant,
}

impl<const N: usize> Master<N> {
    const CAPACITY: () = assert!(N >= 1 && N <= 32, "a master has 1 to 32 motors");

    /// A master that knows no motor yet: a place is taken at a motor's first request.
    pub fn new(mut config: Config) -> Self {
        const { Self::CAPACITY };
        let round_trips = RoundTrips::new(&mut config);
        // Nobody waits for what counts as lost.
        config.longest_response = config.longest_response.min(config.reply_timeout);
        Self {
            motors: [Motor::default(); N],
            places: Places::new(),
            broadcast: Broadcast::default(),
            config,
            round_trips,
            offer: None,
            stops_all: None,
            stopped: MotorSet::EMPTY,
            switched_off: MotorSet::EMPTY,
            lost_master: MotorSet::EMPTY,
            stop_to_all: None,
            pace: 0,
            last_ticket: 0,
            now: Instant::ZERO,
            due: Instant::ZERO,
            busy_until: Instant::ZERO,
            heard_at: Instant::ZERO,
        }
    }

    /// Sends one motor a command and waits for its reply, where it has one, with the configuration's
    /// patience. A command that [ends motion](Kind::ends_motion) drops the motor's waiting set-point and a
    /// waiting command to all that may move it, and its reply counts only once nothing that was sent before it
    /// can move the motor any more.
    ///
    /// # Errors
    /// [`RequestError`]: the command does not go to one motor or not over this bus, the motor's
    /// earlier request is under way, the motor follows a stream of this kind, the motors were stopped, the
    /// command moves a motor that has [restarted](Event::Restarted), or there is no place for one more.
    pub fn request<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
    ) -> Result<Ticket<C>, RequestError> {
        self.put_request(motor, &command, None)
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
        self.put_request(motor, &command, Some(patience))
    }

    /// As [`request`](Self::request), with a patience of its own or the configuration's.
    pub(crate) fn put_request<C: Command>(
        &mut self,
        motor: MotorId,
        command: &C,
        patience: Option<Patience>,
    ) -> Result<Ticket<C>, RequestError> {
        let data = command.encode();
        let ticket = self.put(motor, command.kind().of_bytes(&data), data, patience)?;
        Ok(Ticket::new(ticket))
    }

    /// As [`put_request`](Self::put_request), in one piece of code for all types.
    #[inline(never)]
    fn put(
        &mut self,
        motor: MotorId,
        kind: Kind,
        data: Data,
        patience: Option<Patience>,
    ) -> Result<TicketId, RequestError> {
        self.check(kind, motor.into())?;
        let patience = patience.unwrap_or_else(|| self.config.patience(kind));
        let question = Question::of(kind, &data);
        // What was offered may be a set-point that this ends.
        self.offer = None;
        let (pace, now, number) = (self.pace, self.now, self.last_ticket.wrapping_add(1));
        let place = self.place_for(motor)?;
        self.change_at(place, |motor, config| {
            if !motor.request.is_none() || motor.news.contains(News::STOPPED) {
                return Err(RequestError::Busy);
            }
            if motor.has_restarted && kind.moves() {
                return Err(RequestError::Restarted);
            }
            if let Some(opcode) = kind.opcode() {
                if reported_bit(opcode).is_some_and(|bit| motor.reports(bit, now)) {
                    return Err(RequestError::Reported(opcode));
                }
                if motor.stream.is_of(question) {
                    return Err(RequestError::Streamed(opcode));
                }
            }
            let asked = Asked::new(Purpose::Caller, question, data, patience);
            if kind.ends_motion() {
                motor.drop_waiting_set_point();
                motor.let_other_stop_come_first(&asked, config, now);
            }
            motor.join(pace);
            motor.request = Request::Waiting(asked);
            motor.ticket = number;
            Ok(())
        })
        .unwrap_or(Err(RequestError::TooManyMotors { capacity: N }))?;
        if kind.ends_motion() {
            self.let_line_answer();
            self.broadcast.cancel_what_moves();
            if let Some(by) = StopKind::by(kind) {
                self.overtakes_broadcast(motor, by);
            }
        }
        self.last_ticket = number;
        Ok(TicketId { motor, number })
    }

    /// Nobody waits for the outcome of this request any more, so what a stop would refuse, a move say, must not be
    /// sent, or sent again, at any later time. One that waits fails ([`Failure::Dropped`]). One that is on the wire, or
    /// lies in a controller's mailbox, is not called back: it is carried out, its answer still comes, and only a
    /// [stop](Self::stop) ends what it does; if it is lost or handed back it is not sent once more. What reads, writes
    /// or ends motion goes on. One that is over is left alone. The `ask` of the [loops](crate::io) does this when it is
    /// left.
    pub fn withdraw(&mut self, TicketId { motor, number }: TicketId) {
        let now = self.now;
        self.due = now;
        self.change(motor, |motor, config| match &mut motor.request {
            _ if motor.ticket != number => {}
            Request::Waiting(asked) | Request::InFlight(asked) | Request::Sent(asked)
                if !asked.kind().is_refused_while_stopped() => {}
            Request::InFlight(asked) | Request::Sent(asked) => asked.withdraw(),
            Request::Waiting(_) => {
                motor.finish_request(Request::Failed(Failure::Dropped), config, now);
            }
            Request::None | Request::Failed(_) => {}
        });
    }

    /// Puts a set-point in a motor's stream. One that still waits is replaced and counted, never
    /// queued up; one that waits for longer than [`Config::set_point_max_age`] is dropped.
    ///
    /// # Errors
    /// [`RequestError`]: the command does not go over this bus, the motors were stopped, the motor has
    /// [restarted](Event::Restarted), a request of the same kind is under way, or there is no place for one
    /// more motor.
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
        let set_point = StreamSetPoint { question: Question::of(kind, &data), data };
        let expiry = now + self.config.set_point_max_age;
        // What was offered is older than this.
        self.offer = None;
        self.due = self.due.min(expiry);
        let pace = self.pace;
        let place = self.place_for(motor)?;
        self.change_at(place, |motor, _| {
            if motor.has_restarted {
                return Err(RequestError::Restarted);
            }
            let is_same = |asked: &Asked| asked.question == set_point.question;
            if motor.request.under_way().is_some_and(is_same) {
                return Err(RequestError::Busy);
            }
            motor.join(pace);
            motor.put_set_point(set_point, expiry);
            Ok(())
        })
        .unwrap_or(Err(RequestError::TooManyMotors { capacity: N }))
    }

    /// Asks all motors at once (CAN 0x280, RS485 0xCD) and collects the answers of `expected` until all have come or
    /// the time is up. It is sent when no request is in flight, and requests wait until it is over, but for those that
    /// end motion while it waits. On CAN it reaches motors whose id filter (function 2) is off; on RS485 the answers of
    /// several motors are likely to collide. `expected` should name all who answer: the answers of others come as
    /// [`Event::Stray`].
    ///
    /// To end motion at once use [`stop_all`](Self::stop_all): this one waits for what is in flight, and for a stop for
    /// as long as a motor does not confirm that.
    ///
    /// Name in it all whom a command that moves, or opens brakes, may reach: each takes a place, so that
    /// [`stop_all`](Self::stop_all) stops it by a stop of its own, which it confirms.
    ///
    /// The next broadcast waits until all motors that have a place have answered this one, or its
    /// answers cannot come any more. One that [ends motion](Kind::ends_motion) drops the set-points and moves that
    /// wait, and where one lets go (0x80, 0x76) a Stop (0x81) of one motor that is under way becomes a Shutdown of it,
    /// which is confirmed as a stop. But an answer to it, other than to a [stop](Self::stop_all), does not say that
    /// nothing sent before can move the motor any more. If a motor is [stopped](Self::stop) by itself while it waits,
    /// or before a controller hands it back, and it would undo that, the others that have a place get it each by
    /// itself, as a stop, and this one is over: nobody without a place gets it then, and a restart goes to nobody.
    ///
    /// # Errors
    /// [`RequestError`]: the command has no form for all motors or none on this bus, another
    /// broadcast is under way, the motors were stopped, or it moves them and one has
    /// [restarted](Event::Restarted) or there is no place for all of `expected`: then nothing is sent.
    pub fn broadcast<C: Command>(
        &mut self,
        command: C,
        expected: MotorSet,
    ) -> Result<(), RequestError> {
        let data = command.encode();
        let kind = command.kind().of_bytes(&data);
        let now = self.now;
        self.check(kind, Target::All)?;
        if kind.moves() && self.has_any_restarted() {
            return Err(RequestError::Restarted);
        }
        if self.broadcast.is_active() {
            return Err(RequestError::Busy);
        }
        if kind.may_move() {
            self.give_places(expected)?;
        }
        self.broadcast.put(kind, data, expected);
        if kind.ends_motion() {
            // What was offered may be a set-point that this ends.
            self.offer = None;
            self.due = now;
            let off = self.stop_that_lets_go(kind);
            if off.is_some() {
                self.let_line_answer();
            }
            for place in self.places.taken.iter() {
                self.change_at(place, |motor, config| motor.end_with_all(off, config, now));
            }
        }
        Ok(())
    }

    /// Takes note of the time: what is overdue is sent again or given up, what is too old is dropped.
    pub fn handle_timeout(&mut self, now: Instant) {
        self.now = now;
        if now >= self.due {
            let heard_at = self.heard_at_least();
            let in_flight = self.places.in_flight;
            let is_can = !self.config.is_rs485();
            let is_quiet = !in_flight.is_empty() && is_can && self.quiet_at() <= now;
            let under_way = self.places.waiting.or(in_flight);
            let mut next = Earliest::default();
            for place in self.places.taken.iter() {
                let lingers = || self.motors.get(place).is_some_and(Motor::lingers);
                if under_way.contains(place) || lingers() {
                    self.change_at(place, |motor, config| {
                        motor.handle_timeout(now, is_quiet, heard_at, config);
                        motor.due(config, &mut next);
                    });
                }
            }
            self.due = next.0.unwrap_or(NEVER);
        }
        self.age_broadcast(now);
    }

    /// The bus carries nothing: the controller is off the bus, or nobody acknowledges. Everything that
    /// waits is dropped, so that nothing moves when the bus comes back and nobody waits for ever. Only
    /// stops go on waiting.
    pub fn handle_bus_down(&mut self, now: Instant) {
        self.now = now;
        self.offer = None;
        if self.broadcast.is_waiting() {
            self.broadcast.cancel();
        }
        self.broadcast.on_its_way.extend(now + self.config.late_window);
        self.due = now;
        for place in self.places.taken.iter() {
            self.change_at(place, |motor, config| motor.bus_is_down(now, config));
        }
    }

    /// The next event, apart from those that [`handle_frame`](Self::handle_frame) and
    /// [`handle_line`](Self::handle_line) returned.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.broadcast.take_result().or_else(|| {
            let place = self.places.news.iter().next()?;
            self.change_at(place, take_news)?
        })
    }

    /// How it behaves.
    pub const fn config(&self) -> &Config {
        &self.config
    }

    /// How well a motor answers.
    pub fn health(&self, motor: MotorId) -> Health {
        self.motor(motor).map(|motor| motor.health.health()).unwrap_or_default()
    }

    /// The newest feedback of a motor's stream, and when it came; `None` before the first.
    pub fn latest_feedback(&self, motor: MotorId) -> Option<(AnyReply, Instant)> {
        let motor = self.motor(motor)?;
        Some((motor.latest?, motor.latest_at))
    }

    /// The patience of now (see [`Config::longest_reply_timeout`]) with so many attempts, 1 to 15.
    pub fn patience(&self, attempts: u8) -> Patience {
        Patience { reply_timeout: self.config.reply_timeout, attempts }
    }

    /// Whether a motor's newest set-point was dropped before it was sent.
    pub(crate) fn is_newest_set_point_dropped(&self, motor: MotorId) -> bool {
        self.motor(motor).is_some_and(|motor| motor.is_newest_dropped)
    }

    /// Whether a motor's newest set-point is still to be sent, or to be answered.
    pub(crate) fn has_set_point_under_way(&self, motor: MotorId) -> bool {
        let stream = self.motor(motor).map(|motor| &motor.stream);
        stream.is_some_and(|stream| stream.waiting().or(stream.in_flight()).is_some())
    }

    /// Whether any command waits for its reply.
    pub fn is_anything_in_flight(&self) -> bool {
        self.broadcast.is_in_flight() || !self.places.in_flight.is_empty()
    }

    /// Whether such a command may be sent at all. Inlined, so that what follows from a set-point's kind alone
    /// is known when it is compiled.
    #[inline(always)]
    pub(crate) fn check(&self, kind: Kind, target: Target) -> Result<(), RequestError> {
        kind.channel_to(target)?;
        if self.config.is_rs485() {
            kind.check_on_rs485()?;
        }
        let is_stopped = match target {
            Target::Motor(motor) => self.is_stopped(motor),
            Target::All => self.is_any_stopped(),
        };
        if is_stopped && kind.is_refused_while_stopped() {
            Err(RequestError::Stopped)
        } else {
            Ok(())
        }
    }
}

/// The next thing that is to be reported of a motor.
fn take_news(motor: &mut Motor, _: &Config) -> Option<Event> {
    let id = motor.id?;
    let ticket = TicketId { motor: id, number: motor.ticket };
    let first = motor.news.iter().next();
    if let Some(news) = first {
        motor.news.remove(news);
        return Some(match news {
            News::STOPPED => Event::Failed { ticket, failure: Failure::Stopped },
            News::UNCONFIRMED => Event::StopUnconfirmed { motor: id },
            News::DROPPED => Event::SetPointDropped { motor: id },
            News::RESTARTED => Event::Restarted { motor: id },
            _ => Event::SetPointUnanswered { motor: id },
        });
    }
    let event = match motor.request {
        Request::Sent(asked) => Event::Sent { ticket, data: asked.data },
        Request::Failed(failure) => Event::Failed { ticket, failure },
        Request::None | Request::Waiting(_) | Request::InFlight(_) => return None,
    };
    motor.request = Request::None;
    Some(event)
}

/// The bit of a command that a drive can report by itself (2.34.2).
fn reported_bit(opcode: Opcode) -> Option<u8> {
    opcode.report_place().map(|place| 1 << place)
}
