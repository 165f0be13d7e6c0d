//! The master as a state machine. It keeps as many requests in flight as the bus carries, and never takes an answer for
//! the answer to another question.
//!
//! - [`Master::request`] sends one motor a request and returns a [`Ticket`], which recognizes the answer.
//! - [`Master::set_point`] streams set-points: only the newest of each motor is kept.
//! - [`Master::broadcast`] sends one command to all motors.
//! - [`Master::stop_all`] stops them, before anything else is sent.
//!
//! # How answers find their questions
//! Each motor has at most one command in flight. Its reply is recognized by the motor, the command byte and the index,
//! and comes no sooner than [`Config::shortest_response`].
//!
//! A command that was given up may still be answered. Such a reply is expected for [`Config::late_window`]. Until it
//! has come, or can no longer come, the motor gets no request that would have the same reply. It does get others,
//! unless late replies to three different questions may come: then it gets nothing but stops and commands to all, until
//! one of the three has come or can no longer come.
//!
//! Likewise after a broadcast: a motor that has not answered it gets no request of that kind, and the next broadcast
//! waits for all motors.
//!
//! Every reply is compared with what is in flight and with what may come late. A reply that matches neither is an
//! active report or a stray.
//!
//! # What stops, and what a confirmation means
//! A stop is sent before anything else, on CAN whatever is in flight. Nothing older follows it: what waited is dropped,
//! and so is what a controller hands back.
//!
//! A confirmation counts if both of these hold:
//!
//! - It answers this stop, and not an earlier one.
//! - Nothing that was sent before the stop can move the motor any more. A set-point may be in a mailbox that the stop
//!   overtook, and stays there for as long as the bus is cut.
//!
//! Otherwise the stop is sent once more, when everything sent before it must have arrived. On CAN this also happens
//! after each move of all motors that the motor has not answered, however long ago it was sent.
//!
//! The same holds for the reply to a request that ends motion. Such a request waits for its turn, but not for a move of
//! all motors that was requested after it.
//!
//! # What can still go wrong
//! Two facts cannot be changed from this side of the wire. A reply names the motor, the command and the index, but not
//! which of two equal commands it answers. And a frame that a controller, an adapter or the bus still holds cannot be
//! taken back. No master can prevent what follows from them. Where frames are held back longer than the windows of the
//! [`Config`], swapped, doubled or echoed, or where two motors or two masters pass for one, an answer may be wrong, and
//! a stop may be confirmed before something older moves the motor. Where nothing arrives, nothing can be confirmed. In
//! detail:
//!
//! ## A frame is held back for longer than the late window
//! An answer can be wrong, or a move can arrive after its stop was confirmed.
//!
//! ## The bus swaps a move and the stop after it, and their answers
//! The stop is confirmed, and then the motor moves.
//!
//! ## A frame from before a cut arrives late
//! If an adapter holds a frame from before a cut back for longer than the reply time-out, the bus seems intact. Then a
//! stop may be confirmed while a move is still in a mailbox. The same happens if two such frames are heard apart, and
//! the bus was cut between them.
//!
//! ## A stop stays in a mailbox until no answer to it is expected
//! A stop, or a command to all that ends motion, may then arrive after a later stop of the other kind was confirmed.
//!
//! ## A command that was given up is still in a mailbox
//! If nobody acknowledges a command on CAN, it may stay in the controller's mailbox after it was given up. Unless the
//! controller can be reset, the drive carries it out when the bus is intact again, whenever that is.
//!
//! ## Another frame looks like the answer
//! An answer can be wrong in these cases:
//!
//! - A drive answers twice, or a command reaches it twice. The second reply may be taken for that to the next request
//!   of its kind, whose own reply is then left over. So a drive that answers everything twice is noticed: the replies
//!   that are left over are each an [`Event::Stray`], counted in [`Health::stray`]. Only those that it may also have
//!   sent unasked, such as a status, are an [`Event::Report`].
//! - Two motors have the same id.
//! - Another master sends the same request at the same time. On RS485 its command alone may look like the reply.
//! - A drive reports unasked what it was also asked for: an error, or something whose report was switched off by a
//!   command that the drive has not heard.
//!
//! ## A drive has lost its master, and its message was not heard
//! Such a drive sends the first command back and ignores it. If its message (0xF1) was not heard, the returned command
//! may be taken for an acknowledgement, or for values that are all 0. A read is asked again if the reply that equals it
//! is the first of its motor, or the first after a pause of more than 150 ms; not where an echo is configured.
//!
//! ## An RS485 echo passes for a reply
//! An echo can confirm a stop, pass for values that are all 0, or make it seem that the drive has ignored a move:
//!
//! - An echo that was not configured, if noise has destroyed the echoes of four reads in a row, but neither these reads
//!   nor their answers. Fewer are enough if answers came late or twice while the next read was lost in a cut.
//! - Any echo that comes more than 100 ms after its sending, although the port was found empty in between.
//!
//! ## A restart is not noticed, or seen where there was none
//! No frame announces a restart, which is noticed only by the signs that [`Event::Restarted`] lists. One of them may
//! mislead: at thousands of degrees a second, feedback that comes later and later may look like a jump.
//!
//! ## Another master moves a motor that is stopped here
//! The motor's answer to that is an [`Event::Stray`]. No stop follows automatically.
//!
//! ## A motor's replies do not arrive
//! Then the motor cannot confirm a stop: cut its power.
//!
//! # How the bus is shared
//! The motor that was served least goes first.
//!
//! On a full CAN bus, replies of high ids lose every arbitration against replies of low ids and all commands. So the
//! lead of a motor over one that may still be waiting to answer is limited:
//!
//! - It is two rounds, or one if there are more than 21 motors.
//! - Where a controller hands frames back, it is one round less for each frame beyond the first that may be in its
//!   mailboxes. Otherwise the motor of a frame that was handed back would keep all others waiting.
//!
//! Nobody waits any longer for a reply that must have come by now: the bus was quiet for the time of three frames, or
//! has carried a reply that would have lost the arbitration against it. Where replies come in bursts, because an
//! adapter holds them back, the host looks seldom or the clock goes on in steps, both take longer by the pause between
//! two bursts.
//!
//! Once a motor has not answered three commands in a row, the others wait for it at every eighth only: it may be back,
//! and on a bus that they keep full its replies would lose every arbitration. So on CAN a silent motor costs the others
//! little more than the time of its own commands on the bus.
//!
//! Lost feedback of a stream costs hardly more than its own set-point. The motor's next one goes when the feedback
//! counts as lost: when nobody waits for it any more, and after [`Config::longest_response`] or, if they are longer,
//! three of the motor's usual round trips. At 1 Mbit/s eight motors that lose 5 % each get more than 470 answers a
//! second instead of 520. The third loss in a row, and each after it, is waited for as long as any other reply. A coarse
//! clock, and an adapter that delivers in bursts, make each loss dearer by some steps or bursts.
//!
//! On RS485 there is one exchange at a time, and each command to a silent motor occupies the line for
//! [`Config::reply_timeout`]. Frames that nobody asked for keep no command off the line.

mod arbitration;
mod broadcast;
mod bursts;
mod config;
mod event;
mod health;
mod hold_again;
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
pub(crate) use event::has_errors;
pub use event::{Event, Failure, Ticket, TicketId};
pub use health::{Health, Presence};
pub use motor_set::MotorSet;
pub use stop::StopKind;

use crate::command::AnyReply;
use crate::error::RequestError;
use crate::id::{MotorId, Target};
use crate::kind::Kind;
use crate::opcode::Opcode;
use crate::time::{Duration, Instant};
use arbitration::LastReply;
use broadcast::Broadcast;
use bursts::Bursts;
use motor::deadlines::Hearing;
use motor::{Motor, News, is_before};
use places::Places;
use request::{Request, SHORTEST_TIMEOUT};
use round_trips::RoundTrips;
use schedule::Earliest;
use transmit::{ForAll, Offer};

/// A master at which nobody has looked for this much longer than its configuration makes anything wait was held up.
const HELD_UP: Duration = Duration::from_millis(1_000);
/// For how long a controller that reports an error at each look may keep what it has received.
const LONGEST_KEPT: Duration = Duration::from_millis(100);
/// The latest point in time.
const NEVER: Instant = Instant::from_micros(u64::MAX);

/// The master of one bus with up to `N` motors.
///
/// It does no I/O and reads no clock. Its caller calls, in any order and as often as there is reason:
///
/// 1. [`handle_frame`](Self::handle_frame) (CAN) or [`handle_line`](Self::handle_line) (RS485) with what was received.
///    Each call returns at most one event.
/// 2. [`handle_timeout`](Self::handle_timeout) with the time, after receiving and at least when
///    [`poll_at`](Self::poll_at) says.
/// 3. [`poll_transmit`](Self::poll_transmit) for what to send next, and
///    [`handle_transmitted`](Self::handle_transmitted) once the bus has taken it, until there is nothing more to send
///    or the bus takes no more. Also [`handle_pushed_out`](Self::handle_pushed_out) with what a controller hands back,
///    and [`handle_bus_down`](Self::handle_bus_down) when the bus takes nothing for long.
/// 4. [`poll_event`](Self::poll_event) until it returns nothing more.
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
    /// With what holds now: time-outs, and an echo that was found.
    config: Config,
    /// `None` if the time-outs do not change.
    round_trips: Option<RoundTrips>,
    offer: Option<Offer>,
    /// The stop of all motors that is in force: nothing moves until it is lifted.
    stops_all: Option<StopKind>,
    /// How many stops were called for.
    stop_count: u32,
    /// Motors that were stopped individually.
    stopped: MotorSet,
    /// Motors that a stop in force has switched off: no other stop switches them on.
    switched_off: MotorSet,
    /// Motors that have lost their master and will ignore the next command.
    lost_master: MotorSet,
    /// A stop to all at once that is to be sent before each motor's own.
    stop_to_all: Option<StopKind>,
    /// When a stop to all was sent last.
    stop_to_all_sent: Instant,
    /// The last stop to all that was sent, unless it was handed back, or all motors were moved or told to end their
    /// motion since.
    stop_to_all_was: Option<StopKind>,
    /// CAN: where the last command to all is, a broadcast or a stop.
    for_all: ForAll,
    /// CAN: when the mailboxes of a controller are empty that has handed a frame back for a more urgent one.
    mailboxes_until: Option<Instant>,
    /// The caller has switched a motor off since the last stop to all was sent.
    is_any_off_since: bool,
    /// The last frame sent was a stop that leaves the next turn to others.
    is_turn_of_others: bool,
    /// The current round: that of the motor that is furthest ahead.
    pace: u32,
    last_ticket: u32,
    /// The time of the last call that gave it.
    now: Instant,
    /// The last [`handle_timeout`](Self::handle_timeout).
    looked_at: Instant,
    /// The newest ticket then.
    looked_ticket: u32,
    /// RS485: how often bytes came that are no frame.
    garbled: u32,
    /// Until then the time alone gives no motor anything to do.
    due: Instant,
    /// CAN: until when the frames that were sent keep the bus busy, or when one was last received. RS485: when the line
    /// may be used again.
    busy_until: Instant,
    /// When a frame was last received. Used on CAN only.
    heard_at: Instant,
    /// Used on CAN only.
    last_reply: LastReply,
    /// Used on CAN only.
    bursts: Bursts,
}

impl<const N: usize> Master<N> {
    /// Creates a master that knows no motor yet. A motor takes a place with its first request.
    pub fn new(mut config: Config) -> Self {
        const { assert!(N >= 1 && N <= 32, "a master has 1 to 32 motors") };
        let round_trips = RoundTrips::new(&mut config);
        config.reply_timeout = config.reply_timeout.max(SHORTEST_TIMEOUT);
        // A reply that counts as lost is not waited for.
        config.longest_response = config.longest_response.min(config.reply_timeout);
        Self {
            motors: [Motor::default(); N],
            places: Places::default(),
            broadcast: Broadcast::default(),
            config,
            round_trips,
            offer: None,
            stops_all: None,
            stop_count: 0,
            stopped: MotorSet::EMPTY,
            switched_off: MotorSet::EMPTY,
            lost_master: MotorSet::EMPTY,
            stop_to_all: None,
            stop_to_all_sent: Instant::ZERO,
            stop_to_all_was: None,
            for_all: ForAll::Gone,
            mailboxes_until: None,
            is_any_off_since: false,
            is_turn_of_others: false,
            pace: 0,
            last_ticket: 0,
            now: Instant::ZERO,
            looked_at: Instant::ZERO,
            looked_ticket: 0,
            garbled: 0,
            due: Instant::ZERO,
            busy_until: Instant::ZERO,
            heard_at: Instant::ZERO,
            last_reply: LastReply::NONE,
            bursts: Bursts::default(),
        }
    }

    /// Takes note of the time: what is overdue is sent again or given up, and what is too old is dropped.
    ///
    /// If this was not called for a second more than [`Config::restart_time`], the computer was suspended, or the loop
    /// held up. Then commands put before the last call that a stop would refuse (moves, restarts, writes to ROM) are
    /// too old, and not sent any more; see [`withdraw`](Self::withdraw). What was put after it counts as new: put moves
    /// right before the loop runs.
    pub fn handle_timeout(&mut self, now: Instant) {
        self.now = now;
        if now - self.looked_at > self.config.restart_time + HELD_UP {
            self.withdraw_up_to(self.looked_ticket);
        }
        (self.looked_at, self.looked_ticket) = (now, self.last_ticket);
        if self.stops_again_at().is_some_and(|at| at <= now) {
            self.stop_again();
        }
        if self.all_are_told_at().is_some_and(|at| at <= now) {
            self.for_all = ForAll::Gone;
        }
        if now >= self.due {
            let heard = Hearing {
                is_quiet: self.quiet_at() <= now,
                at: self.heard_at_least(),
                last_reply: self.last_reply,
                reply_takes: self.config.frame_time + self.bursts.pause(),
            };
            let under_way = self.places.waiting.or(self.places.in_flight);
            let mut next = Earliest::default();
            for place in self.places.taken.iter() {
                let lingers = || self.motors.get(place).is_some_and(Motor::lingers);
                if under_way.contains(place) || lingers() {
                    self.change_at(place, |motor, config| {
                        motor.handle_timeout(now, &heard, config);
                        // The bus may be quiet sooner than it seems now.
                        motor.poll_at(true, Instant::ZERO, config, &mut next);
                    });
                }
            }
            self.due = next.0.unwrap_or(NEVER);
        }
        self.age_broadcast(now);
    }

    /// Withdraws what was put up to this ticket.
    #[cold]
    fn withdraw_up_to(&mut self, newest: u32) {
        let now = self.now;
        self.change_all(|motor, config| {
            if !is_before(newest, motor.ticket) {
                motor.withdraw(Failure::Dropped, config, now);
            }
        });
        if self.broadcast.is_waiting() && !self.broadcast.is_after(newest) {
            self.broadcast.cancel_what_moves();
        }
    }

    /// Takes note that the bus carries nothing: the controller is off the bus, or nobody acknowledges. Everything that
    /// waits is dropped, so that nothing moves when the bus comes back and no caller waits for ever. Only stops stay.
    pub fn handle_bus_down(&mut self, now: Instant) {
        self.now = now;
        self.offer = None;
        if self.broadcast.is_waiting() {
            self.broadcast.cancel();
        }
        self.broadcast.on_its_way.extend(now, &self.config);
        self.change_all(|motor, config| motor.bus_is_down(now, config));
    }

    /// The bus may be down: receiving fails, since then without a pause. What may move a motor is not sent. Questions
    /// are, because the answers show that the bus is intact, and because motors that hold have to be spoken to.
    pub(crate) fn bus_may_be_down(&mut self, since: Instant, now: Instant) {
        self.now = now;
        self.offer = None;
        if self.broadcast.is_waiting() {
            self.broadcast.cancel_what_moves();
        }
        // Answers may be kept back until receiving works again. But not for ever: a driver that only complains keeps
        // nothing back, and a motor that has not answered must be asked again.
        let lasts = now - since;
        let may_be_kept = self.config.reply_timeout <= lasts && lasts < LONGEST_KEPT;
        self.change_all(|motor, config| motor.bus_may_be_down(may_be_kept, now, config));
    }

    /// Returns the next event, apart from those that [`handle_frame`](Self::handle_frame) and
    /// [`handle_line`](Self::handle_line) returned.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.broadcast.take_result().or_else(|| {
            let place = self.places.news.iter().next()?;
            self.change_at(place, take_news)?
        })
    }

    /// Its configuration, with the time-outs that hold now. `echo` is also set if the loop has found an echo.
    pub const fn config(&self) -> &Config {
        &self.config
    }

    /// RS485: how often bytes came that are no frame: noise, or answers that collide, such as those of two motors with
    /// one id, or those of all to a stop.
    pub const fn garbled(&self) -> u32 {
        self.garbled
    }

    /// RS485: whether the adapter echoes, as far as is known.
    pub(crate) fn note_echo(&mut self, echoes: bool) {
        if let Bus::Rs485 { echo, .. } = &mut self.config.bus {
            *echo = echoes;
        }
    }

    pub(crate) fn note_garbled(&mut self) {
        self.garbled = self.garbled.saturating_add(1);
    }

    /// How well a motor answers.
    pub fn health(&self, motor: MotorId) -> Health {
        self.motor(motor).map(|motor| motor.health()).unwrap_or_default()
    }

    /// The newest feedback of a motor's stream, and when it came; `None` before the first. Its numbers, except those of
    /// motion mode: `Feedback::try_from(reply)`.
    pub fn latest_feedback(&self, motor: MotorId) -> Option<(AnyReply, Instant)> {
        self.motor(motor)?.latest
    }

    /// Whether a motor has [lost its master](Event::LostMaster), and has answered nothing sent since.
    pub(crate) const fn has_lost_master(&self, motor: MotorId) -> bool {
        self.lost_master.contains(motor)
    }

    /// The current reply time-out (see [`Config::longest_reply_timeout`]) with this many attempts, 1 to 15.
    pub fn patience(&self, attempts: u8) -> Patience {
        Patience { reply_timeout: self.config.reply_timeout, attempts }
    }

    /// Whether any command waits for its reply.
    pub fn is_anything_in_flight(&self) -> bool {
        self.broadcast.is_in_flight() || !self.places.in_flight.is_empty()
    }

    /// Whether a command of this kind may be sent at all. Inlined, so that what follows from a set-point's kind alone
    /// is known at compile time.
    #[inline(always)]
    pub(crate) fn check(&self, kind: Kind, target: Target) -> Result<(), RequestError> {
        kind.channel_to(target)?;
        if self.config.is_rs485() {
            kind.check_on_rs485()?;
        }
        let is_refused = match target {
            // A command that holds a motor switches it on.
            Target::Motor(motor) if kind == Kind::Known(Opcode::Stop) => {
                self.switched_off.contains(motor)
            }
            Target::Motor(motor) => self.is_stopped(motor) && kind.is_refused_while_stopped(),
            Target::All => self.is_any_stopped() && kind.is_refused_while_stopped(),
        };
        if is_refused { Err(RequestError::Stopped) } else { Ok(()) }
    }
}

/// The next thing to report of a motor.
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
