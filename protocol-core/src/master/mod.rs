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
//! Every reply is held against what is in flight and what may come late; what is neither is an active report, or a stray.
//!
//! # What stops, and what a confirmation means
//! A stop goes before everything, whatever is in flight, and nothing older follows it: what waited is
//! dropped, and so is what a controller hands back. A confirmation counts if it answers this stop and
//! not an earlier one, and if nothing that was sent before can move the motor any more: a set-point may
//! wait in a mailbox that the stop overtook, and there for as long as the bus is cut. Otherwise the stop goes once
//! more, when what was sent before must have come. So it does on CAN, too, after each move of all that the motor has
//! not answered, however long ago that was. The same holds for requests that end motion, which wait for their turn,
//! though not for moves of all that were asked for later.
//!
//! # What can still go wrong
//! A reply says which motor, which command and which index, but not which of two equal commands it answers; and
//! nothing on this side of the wire takes back a frame that a controller, an adapter or the bus still holds. What
//! follows from these two no master can prevent. If a frame is held back for longer than the late window, an answer
//! can be wrong, or a move can come behind the stop that was confirmed; so, too, where a bus swaps a move and the stop
//! behind it, and their answers as well. A frame from before a cut that an adapter holds back for longer than the
//! reply time-out says that the bus is whole, so that a stop may be confirmed before a move that lies in a mailbox; so
//! do two such frames that are heard apart while the bus was cut between them. A stop, or what ends the motion of all,
//! that has lain in a mailbox until nobody expected its answer any more may come after a later stop of the other kind
//! was confirmed. A command that was given up for want of an answer may lie in the mailbox of a controller that
//! nobody acknowledges: it is obeyed when the bus is whole again, whenever that is, unless the controller can be
//! reset. An answer can also be wrong if a drive answers twice or a command reaches it twice (the second reply may be
//! taken for that to the next request of its kind), if two motors have one id, if another master asks the same at the
//! same time (on a line its command alone may look like the reply), or if a drive reports by itself what it was asked
//! for (an error, or what it was told to report no more and has not heard). A drive that has lost its master sends back
//! the first command and ignores it: if its message of that was not heard, this may be taken for the acknowledgement of
//! a command, or for values that are all 0. On RS485 an echo that nobody configured confirms a stop, passes for values
//! that are all 0, or for a move that its drive has ignored, if noise has taken the echoes of four reads in a row, and
//! neither these reads nor their answers, or fewer, where answers came late or twice while the next read went into a
//! cut; and any echo does that comes more than 100 ms after its sending although the port was found empty meanwhile. A
//! restart shows by a second in which nothing is heard of the motor and an answer that does not come, or a move that is
//! to go then, by a run time that is shorter than it must be when it is read (0xB1), or by an angle that jumps under a
//! stream; one that shows by none of these is not noticed. Feedback that comes later and later may be taken for such a
//! jump, at thousands of degrees a second. Another master may move a motor that is stopped here: its answer to that is an
//! [`Event::Stray`], and no stop follows by itself. And a stop cannot be confirmed by a motor whose replies do not come
//! through: then cut its power.
//!
//! # How the bus is shared
//! The motor that was served least goes first. On a full CAN bus replies of high ids lose every
//! arbitration against those of low ids and all commands; so no motor gets more than two rounds ahead of one that may
//! be waiting for its turn to answer, or one round where there are more than 21; where a controller hands frames back,
//! one round fewer for each frame beyond the first that may lie there: the motor of one that is pushed out would keep all
//! waiting. Whoever was silent before, or had its chance on a quiet bus, is not waited for: on CAN a silent motor costs
//! the others the time of its own commands on the bus and no more. On RS485 there is one exchange at a time, and each command to a silent
//! motor keeps the line for [`Config::reply_timeout`]. Who speaks without being asked keeps nobody off it.

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

use crate::command::AnyReply;
use crate::error::RequestError;
use crate::id::{MotorId, Target};
use crate::kind::Kind;
use crate::opcode::Opcode;
use crate::time::Instant;
use broadcast::Broadcast;
use motor::{Motor, News};
use places::Places;
use request::{Request, SHORTEST_TIMEOUT};
use round_trips::RoundTrips;
use schedule::Earliest;
use transmit::{ForAll, Offer};

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
    /// When one was sent last.
    stop_to_all_sent: Instant,
    /// The last one that was sent, unless it was handed back, or all were moved or told to end their motion since.
    stop_to_all_was: Option<StopKind>,
    /// CAN: where that is which all were told last, by a broadcast or to stop.
    for_all: ForAll,
    /// CAN: when the mailboxes are empty of a controller that has handed a frame back for a more urgent one.
    mailboxes_until: Option<Instant>,
    /// The caller has switched somebody off since the last one was sent.
    is_any_off_since: bool,
    /// What was sent last was a stop that had been called for again.
    was_called_again: bool,
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
        config.reply_timeout = config.reply_timeout.max(SHORTEST_TIMEOUT);
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
            stop_to_all_sent: Instant::ZERO,
            stop_to_all_was: None,
            for_all: ForAll::Gone,
            mailboxes_until: None,
            is_any_off_since: false,
            was_called_again: false,
            pace: 0,
            last_ticket: 0,
            now: Instant::ZERO,
            due: Instant::ZERO,
            busy_until: Instant::ZERO,
            heard_at: Instant::ZERO,
        }
    }

    /// Takes note of the time: what is overdue is sent again or given up, what is too old is dropped.
    pub fn handle_timeout(&mut self, now: Instant) {
        self.now = now;
        if self.stops_again_at().is_some_and(|at| at <= now) {
            self.stop_again();
        }
        if self.all_are_told_at().is_some_and(|at| at <= now) {
            self.for_all = ForAll::Gone;
        }
        if now >= self.due {
            let heard_at = self.heard_at_least();
            let in_flight = self.places.in_flight;
            let is_quiet = self.quiet_at() <= now;
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
        self.motor(motor).map(|motor| motor.health()).unwrap_or_default()
    }

    /// The newest feedback of a motor's stream, and when it came; `None` before the first.
    pub fn latest_feedback(&self, motor: MotorId) -> Option<(AnyReply, Instant)> {
        self.motor(motor)?.latest
    }

    /// The patience of now (see [`Config::longest_reply_timeout`]) with so many attempts, 1 to 15.
    pub fn patience(&self, attempts: u8) -> Patience {
        Patience { reply_timeout: self.config.reply_timeout, attempts }
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
        let is_refused = match target {
            // What holds a motor switches it on.
            Target::Motor(motor) if kind == Kind::Known(Opcode::Stop) => {
                self.switched_off.contains(motor)
            }
            Target::Motor(motor) => self.is_stopped(motor) && kind.is_refused_while_stopped(),
            Target::All => self.is_any_stopped() && kind.is_refused_while_stopped(),
        };
        if is_refused { Err(RequestError::Stopped) } else { Ok(()) }
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
            News::STOPPED_AGAIN => Event::Failed { ticket, failure: Failure::StopUnconfirmed },
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
