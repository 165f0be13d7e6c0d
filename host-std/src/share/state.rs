//! What lies on the desk of the bus, and what a stop or a restart takes away from it.

use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;
use std::time::{Duration, Instant};

use myactuator_protocol_core::command::AnyReply;
use myactuator_protocol_core::error::RequestError;
use myactuator_protocol_core::io;
use myactuator_protocol_core::master::{Failure, MotorSet, StopKind};
use myactuator_protocol_core::{Kind, MotorId, Opcode, time};

use super::calls::{Order, Question, Untyped, Waiting};
use super::past::Past;
use super::subscription::Subscriber;
use super::watch::Watched;
use super::{LoopError, SharedBusError};

const LONGEST_ROUND: Duration = Duration::from_secs(2);

/// The newest feedback of a motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Latest {
    /// The feedback: a reply to a set-point, to a broadcast, or a report. Its numbers, except those of motion mode:
    /// `Feedback::try_from(reply)`.
    pub reply: AnyReply,
    /// When the thread of the bus heard it. It is older than this says if that thread was held up before, or if the
    /// machine was suspended since then.
    pub heard_at: Instant,
}

/// A set-point on the desk.
#[derive(Debug)]
pub(super) struct LaidDown {
    pub(super) command: Untyped,
    /// When it was laid down; time since the machine started.
    pub(super) laid_at: Duration,
    /// When it was first found, if it has to wait for a question that ends motion: it is at least as old as that.
    pub(super) found_at: Option<time::Instant>,
}

/// What callers have left for a motor, and may find of it.
#[derive(Debug, Default)]
pub(super) struct Slot {
    pub(super) past: Past,
    /// The newest set-point, until it is taken up.
    pub(super) set_point: Option<LaidDown>,
    /// Why an earlier set-point was refused.
    pub(super) refusal: Option<RequestError>,
    pub(super) latest: Option<Latest>,
    /// How many calls open its brake and have not told it to hold yet.
    pub(super) opening: u32,
}

/// Whether the bus still runs.
#[derive(Debug)]
pub(super) enum Life {
    Running,
    /// The last handle was dropped.
    Closing,
    /// The thread has panicked, with this message.
    Panicked(Arc<str>),
}

#[derive(Debug)]
pub(super) struct State<E> {
    pub(super) life: Life,
    pub(super) orders: Vec<Order<E>>,
    pub(super) questions: VecDeque<Question<E>>,
    pub(super) slots: [Slot; MotorId::COUNT],
    stops_all: bool,
    stopped: MotorSet,
    /// How many stops were called for.
    pub(super) stops: u64,
    /// These were switched off by a stop that is in force: a command that holds does not switch them on.
    pub(super) switched_off: MotorSet,
    /// These were reported to have restarted, and were not resumed.
    restarted: MotorSet,
    /// These are being moved, each by one call.
    pub(super) moving: MotorSet,
    /// How many functions that work with one motor wait for the bus.
    pub(super) at_work: u32,
    /// The error of the bus's last round, if that failed.
    pub(super) outage: Option<Arc<E>>,
    /// An error that no caller has got yet.
    pub(super) error: Option<Arc<E>>,
    pub(super) subscribers: Vec<Subscriber>,
    pub(super) watches: Vec<Watched>,
    /// The key of the newest watch.
    last_watch: u64,
    /// How often the thread has taken up what is here.
    pub(super) rounds: u64,
    /// The thread takes up sooner what is laid down, also if it idles; if not, its driver holds it.
    pub(super) longest_round: Duration,
    /// Since when there is something that the thread has not taken up.
    pub(super) news_since: Option<Instant>,
    /// The thread idles, and has to be woken for news.
    pub(super) is_idle: bool,
}

/// What becomes of a question that is put.
#[derive(Debug)]
pub(super) enum Put<E> {
    /// The master has it.
    Accepted,
    /// The master refuses it, and its caller has been told.
    Refused,
    /// Its motor is busy.
    Waits(Question<E>),
}

/// Takes up what is on the desk.
pub(super) trait Clerk<E> {
    fn obey(&mut self, order: Order<E>);

    /// Puts a set-point that was here at `found_at`.
    fn set_point(
        &mut self,
        motor: MotorId,
        set_point: Untyped,
        found_at: time::Instant,
    ) -> Result<(), RequestError>;

    /// The time on the bus's clock since when something is here that was laid down at `laid_at` after the machine
    /// started.
    fn found_at(&self, laid_at: Duration) -> time::Instant;

    /// Puts a question.
    fn put(&mut self, question: Question<E>) -> Put<E>;

    /// Looks at what is watched. True if its loop is late.
    fn watch(&mut self, watched: &mut Watched) -> bool;

    /// Speaks to motors that were sent nothing for a while: to those that hold, and to others if a function that works
    /// with one motor waits for the bus.
    fn keep_alive(&mut self, is_any_at_work: bool);

    /// Whether a motor holds, or is to, that nobody leads by set-points.
    fn is_any_held(&self) -> bool;
}

impl<E> State<E> {
    pub(super) fn new() -> Self {
        Self {
            life: Life::Running,
            orders: Vec::new(),
            questions: VecDeque::new(),
            slots: std::array::from_fn(|_| Slot::default()),
            stops_all: false,
            stopped: MotorSet::EMPTY,
            stops: 0,
            switched_off: MotorSet::EMPTY,
            restarted: MotorSet::EMPTY,
            moving: MotorSet::EMPTY,
            at_work: 0,
            outage: None,
            error: None,
            subscribers: Vec::new(),
            watches: Vec::new(),
            last_watch: 0,
            rounds: 0,
            longest_round: LONGEST_ROUND,
            news_since: None,
            is_idle: false,
        }
    }

    pub(super) fn slot(&mut self, motor: MotorId) -> &mut Slot {
        &mut self.slots[motor.index()]
    }

    /// The past of a motor until now.
    pub(super) fn past(&self, motor: MotorId) -> Past {
        self.slots[motor.index()].past
    }

    /// Whether a command of a caller that began at `since` is admitted.
    pub(super) fn check(
        &mut self,
        motor: MotorId,
        kind: Kind,
        since: Option<Past>,
    ) -> Result<(), SharedBusError<E>> {
        if let Life::Panicked(_) = self.life {
            return Err(self.last_words());
        }
        let is_stopped = self.is_stopped(motor, since);
        if is_stopped && kind.is_refused_while_stopped() {
            return Err(SharedBusError::Refused { motor, refusal: RequestError::Stopped });
        }
        // An error of another caller keeps no stop from the bus.
        if !kind.ends_motion() {
            let untold = self.error.take();
            if let Some(error) = self.outage.clone().or(untold) {
                return Err(SharedBusError::Bus(error));
            }
        }
        if self.has_restarted_since(motor, since) && kind.moves() {
            return Err(SharedBusError::Refused { motor, refusal: RequestError::Restarted });
        }
        Ok(())
    }

    /// Whether a motor is stopped, or its motion was to be ended since `since`; `None` for a caller that begins now.
    pub(super) fn is_stopped(&self, motor: MotorId, since: Option<Past>) -> bool {
        let was_ended = since.is_some_and(|since| self.past(motor).was_ended_since(since));
        was_ended || self.stops_all || self.stopped.contains(motor)
    }

    /// Whether a motor has restarted and was not resumed, or has restarted since `since`.
    pub(super) fn has_restarted_since(&self, motor: MotorId, since: Option<Past>) -> bool {
        let has_since = since.is_some_and(|since| self.past(motor).has_restarted_since(since));
        has_since || self.restarted.contains(motor)
    }

    /// How a caller that began at `since` stops a motor: one that was let go since then is not switched on again.
    pub(super) fn stop_kind(
        &self,
        motor: MotorId,
        kind: StopKind,
        since: Option<Past>,
    ) -> StopKind {
        match since.is_some_and(|since| self.past(motor).was_let_go_since(since)) {
            true => StopKind::Off,
            false => kind,
        }
    }

    /// Whether a caller that began at `since` may move a motor now.
    pub(super) fn may_move(&self, motor: MotorId, since: Past) -> Result<(), RequestError> {
        match self.is_stopped(motor, Some(since)) {
            true => Err(RequestError::Stopped),
            false if self.has_restarted_since(motor, Some(since)) => Err(RequestError::Restarted),
            false => Ok(()),
        }
    }

    /// Whether a question waits until a motor whose brake opens has been told to hold: its answer, if it is late, would
    /// keep that from being sent while the load falls.
    pub(super) fn waits_for_hold(&self, motor: MotorId, kind: Kind) -> bool {
        let is_opening = self.slots[motor.index()].opening > 0;
        is_opening && !kind.ends_motion() && kind != Opcode::ReleaseBrake.into()
    }

    /// Fails if the thread has taken up nothing for too long: then its driver holds it.
    pub(super) fn check_taken_up(&self) -> Result<(), SharedBusError<E>> {
        self.check_taken_up_within(self.longest_round)
    }

    fn check_taken_up_within(&self, longest: Duration) -> Result<(), SharedBusError<E>> {
        match self.news_since {
            Some(since) if since.elapsed() > longest => Err(SharedBusError::Held),
            _ => Ok(()),
        }
    }

    /// The loop of the watch with this key looks; a watch that has none begins.
    pub(super) fn look(
        &mut self,
        key: &mut Option<u64>,
        watch: &io::Watch,
        kind: StopKind,
        is_real_time: bool,
    ) -> Result<(), LoopError<E>>
    where
        E: fmt::Debug + 'static,
    {
        // A watch that has not begun begins at 0. Virtual time may take any time.
        let silence = Duration::from(watch.late_after() - time::Instant::ZERO);
        let longest = if is_real_time { silence } else { self.longest_round };
        self.check_taken_up_within(longest.min(self.longest_round))?;
        let key = *key.get_or_insert_with(|| {
            self.last_watch += 1;
            self.watches.push(Watched::new(self.last_watch, watch, kind));
            self.last_watch
        });
        let watched = self.watches.iter_mut().find(|watched| watched.key == key);
        let watched = watched.expect("it is there until its handle is dropped");
        if self.stops_all {
            watched.end();
        }
        watched.is_looked_at()
    }

    /// Has the clerk look at what is watched, and stops all motors if a loop is late. While a stop of all is in force,
    /// none is: a motor that it holds must not be let go.
    pub(super) fn look_after_loops(&mut self, clerk: &mut impl Clerk<E>) {
        let mut is_any_late = false;
        for watched in &mut self.watches {
            is_any_late |= clerk.watch(watched);
        }
        // A panic may come under a stop.
        if is_any_late && !self.stops_all {
            // What another loop is to hold may fall, and that loop may be late in a moment.
            let is_any_held = self.watches.iter().any(|watched| watched.kind == StopKind::Hold)
                || !self.stopped.without(self.switched_off).is_empty()
                || clerk.is_any_held();
            let kind = if is_any_held { StopKind::Hold } else { StopKind::Off };
            let (answer, Waiting { asker, .. }) = Waiting::new();
            // It is refused only by a bus that has panicked. Nobody waits for it.
            let _ = self.order(Order::StopAll { kind, also: MotorSet::EMPTY, asker, answer });
        }
        self.watches.retain(|watched| !watched.has_panicked());
    }

    /// Hands the clerk the orders.
    pub(super) fn hand_over_orders(&mut self, clerk: &mut impl Clerk<E>) {
        for order in self.orders.drain(..) {
            // A restart from before the order may have been reported meanwhile.
            if let Order::Resume(motor) = order {
                self.restarted.remove(motor);
            }
            clerk.obey(order);
        }
    }

    /// Takes an order. What is changed here is in force at once, before the thread has seen the order.
    pub(super) fn order(&mut self, order: Order<E>) -> Result<(), SharedBusError<E>> {
        match order {
            Order::StopAll { kind, .. } => {
                self.stops_all = true;
                self.stops += 1;
                self.watches.iter_mut().for_each(Watched::end);
                self.drop_what_is_stopped(MotorSet::ALL, kind);
            }
            Order::Stop { motor, kind, .. } => {
                self.stopped.insert(motor);
                self.stops += 1;
                self.watches.iter_mut().for_each(|watched| watched.is_stopped(motor));
                self.drop_what_is_stopped(motor.into(), kind);
            }
            Order::LiftStop => {
                (self.stops_all, self.stopped) = (false, MotorSet::EMPTY);
                self.switched_off = MotorSet::EMPTY;
            }
            Order::LiftStopOf(motor) => {
                self.stopped.remove(motor);
                if !self.stops_all {
                    self.switched_off.remove(motor);
                }
            }
            Order::Resume(motor) => {
                self.slot(motor).refusal = None;
                self.restarted.remove(motor);
            }
            Order::NoteRestart(motor) => self.has_restarted(motor),
            Order::Forget(motor) => self.restarted.remove(motor),
            Order::NoteArrival(_) | Order::Wait { .. } => {}
        }
        if let Life::Panicked(_) = self.life {
            return Err(self.last_words());
        }
        self.orders.push(order);
        Ok(())
    }

    /// Hands the set-points to the clerk, except for motors with a pending question that ends motion. A set-point of
    /// such a motor is newer than the question, which would drop it.
    pub(super) fn hand_over_set_points(&mut self, clerk: &mut impl Clerk<E>) {
        let ends_motion = |question: &&Question<E>| question.command.kind.ends_motion();
        let ending: MotorSet =
            self.questions.iter().filter(ends_motion).map(|question| question.motor).collect();
        for motor in MotorId::all() {
            let slot = self.slot(motor);
            let Some(LaidDown { command, laid_at, found_at }) = slot.set_point.take() else {
                continue;
            };
            let found_at = found_at.unwrap_or_else(|| clerk.found_at(laid_at));
            if ending.contains(motor) {
                slot.set_point = Some(LaidDown { command, laid_at, found_at: Some(found_at) });
                continue;
            }
            let kind = command.kind;
            match clerk.set_point(motor, command, found_at) {
                Ok(()) => self.slot(motor).past.note_command(kind),
                Err(refusal) => slot.refusal = Some(refusal),
            }
        }
    }

    /// A stop drops what is older and would be refused now, and what would end motion in another way.
    fn drop_what_is_stopped(&mut self, motors: MotorSet, by: StopKind) {
        let is_over = |kind: Kind| kind.is_refused_while_stopped() || kind.ends_motion();
        if by == StopKind::Off {
            motors.iter().for_each(|motor| self.switched_off.insert(motor));
        }
        self.end_motion(motors, Some(by), is_over);
    }

    /// A command that ends motion drops what may move the motor, but not other commands that end motion.
    pub(super) fn drop_what_is_ended(&mut self, motor: MotorId, by: Kind) {
        let by = if by.lets_go() { Some(StopKind::Off) } else { StopKind::by(by) };
        self.end_motion(motor.into(), by, Kind::may_move);
    }

    fn end_motion(
        &mut self,
        motors: MotorSet,
        by: Option<StopKind>,
        is_over: impl Fn(Kind) -> bool,
    ) {
        for motor in motors.iter() {
            let stays_off = self.switched_off.contains(motor);
            let Slot { set_point, past, .. } = self.slot(motor);
            *set_point = None;
            past.note_end(by, stays_off);
        }
        self.drop_questions(|motor, kind| {
            let is_dropped = motors.contains(motor) && is_over(kind);
            is_dropped.then_some(SharedBusError::Failed { motor, failure: Failure::Stopped })
        });
    }

    /// Queues a question after the older ones; one that ends motion goes before all others of its motor that do not.
    pub(super) fn put(&mut self, question: Question<E>) {
        let is_overtaken = |other: &Question<E>| {
            other.motor == question.motor && !other.command.kind.ends_motion()
        };
        let ends_motion = question.command.kind.ends_motion();
        let overtaken = self.questions.iter().position(|other| ends_motion && is_overtaken(other));
        self.questions.insert(overtaken.unwrap_or(self.questions.len()), question);
    }

    /// A motor has restarted: what moves it and is older than this report is dropped.
    pub(super) fn has_restarted(&mut self, restarted: MotorId) {
        self.restarted.insert(restarted);
        let Slot { set_point, past, .. } = self.slot(restarted);
        *set_point = None;
        past.note_restart();
        self.drop_questions(|motor, kind| {
            let is_dropped = motor == restarted && kind.moves();
            let refusal = RequestError::Restarted;
            is_dropped.then_some(SharedBusError::Refused { motor, refusal })
        });
    }

    /// Drops the questions for which `why` returns an error.
    fn drop_questions(&mut self, why: impl Fn(MotorId, Kind) -> Option<SharedBusError<E>>) {
        self.questions.retain(|question| {
            let why = why(question.motor, question.command.kind);
            why.is_none_or(|error| {
                let _ = question.answer.send(Err(error));
                false
            })
        });
    }

    pub(super) fn last_words(&self) -> SharedBusError<E> {
        SharedBusError::Panicked(match &self.life {
            Life::Panicked(words) => Arc::clone(words),
            Life::Running | Life::Closing => Arc::from("its last handle was dropped"),
        })
    }
}
