//! Where callers lay down what they want, and the thread of the bus takes it up.
//!
//! Everything is under one lock, so what counts is the order of the calls: a stop drops what is older
//! here and now, and refuses what comes after it, whether or not the thread has seen it yet.

use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, RecvTimeoutError::Timeout, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use myactuator_protocol_core::command::AnyReply;
use myactuator_protocol_core::error::RequestError;
use myactuator_protocol_core::master::{Event, Failure, MotorSet, Patience, StopKind};
use myactuator_protocol_core::{Data, Kind, MotorId};

use super::SharedBusError;
use super::calls::{Answer, Awaited, Order, Question, Untyped, Waiting};
use super::subscription::{Subscriber, Subscription};
use crate::open::Wake;

/// What is laid down the thread takes up sooner, also where it idles: else its driver holds it. Tests wait for less.
const LONGEST_ROUND: Duration = Duration::from_millis(if cfg!(test) { 1_000 } else { 2_000 });
/// How often it is looked at meanwhile: a program that is frozen and goes on finds that time is up, and has looked
/// once.
const LOOKS: u32 = 20;

/// The newest feedback of a motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Latest {
    /// What it said, to its set-point stream or by itself.
    pub reply: AnyReply,
    /// When that was heard. On a machine that was suspended since then it is older than this says.
    pub heard_at: Instant,
}

/// What a motor's callers have left and may find.
#[derive(Debug, Default)]
struct Slot {
    /// The newest set-point, until it is taken up.
    set_point: Option<Untyped>,
    /// Why an earlier one was not taken.
    refusal: Option<RequestError>,
    latest: Option<Latest>,
}

/// Whether the bus still runs.
#[derive(Debug)]
enum Life {
    Running,
    /// Nobody has a handle any more.
    Closing,
    /// The thread has panicked, with these words.
    Panicked(Arc<str>),
}

#[derive(Debug)]
struct State<E> {
    life: Life,
    orders: Vec<Order<E>>,
    questions: VecDeque<Question<E>>,
    slots: [Slot; MotorId::COUNT],
    stops_all: bool,
    stopped: MotorSet,
    /// These were told to have restarted, and not resumed.
    restarted: MotorSet,
    /// An error that nobody was told yet.
    error: Option<Arc<E>>,
    subscribers: Vec<Subscriber>,
    /// How often the thread took up what there is.
    rounds: u64,
    /// Since when something lies there that the thread has not taken up.
    news_since: Option<Instant>,
    /// The thread idles, and has to be woken for what is new.
    is_idle: bool,
}

/// Who takes it all up.
pub(super) trait Clerk<E> {
    fn obey(&mut self, order: Order<E>);

    fn set_point(&mut self, motor: MotorId, set_point: Untyped) -> Result<(), RequestError>;

    /// Puts a question; gives it back if it has to wait.
    fn put(&mut self, question: Question<E>) -> Option<Question<E>>;
}

pub(super) struct Desk<E> {
    state: Mutex<State<E>>,
    /// Something was laid down.
    changed: Condvar,
    wake: Option<Wake>,
}

impl<E> Desk<E> {
    pub(super) fn new(wake: Option<Wake>) -> Self {
        let state = State {
            life: Life::Running,
            orders: Vec::new(),
            questions: VecDeque::new(),
            slots: std::array::from_fn(|_| Slot::default()),
            stops_all: false,
            stopped: MotorSet::EMPTY,
            restarted: MotorSet::EMPTY,
            error: None,
            subscribers: Vec::new(),
            rounds: 0,
            news_since: None,
            is_idle: false,
        };
        Self { state: Mutex::new(state), changed: Condvar::new(), wake }
    }

    /// Whether the thread can be woken while it idles.
    pub(super) const fn wakes(&self) -> bool {
        self.wake.is_some()
    }

    fn lock(&self) -> MutexGuard<'_, State<E>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Unlocks it and has the thread look at it.
    fn leave(&self, mut state: MutexGuard<'_, State<E>>) {
        state.news_since.get_or_insert_with(Instant::now);
        let was_idle = std::mem::take(&mut state.is_idle);
        drop(state);
        self.changed.notify_one();
        if let Some(wake) = self.wake.as_ref().filter(|_| was_idle) {
            wake();
        }
    }

    // ---- the callers' side ----

    /// Lays down a question.
    pub(super) fn ask(
        &self,
        motor: MotorId,
        command: Untyped,
        patience: Option<Patience>,
    ) -> Awaited<Data, E> {
        let (answer, waiting) = call();
        let mut state = self.lock();
        if command.kind.ends_motion() {
            state.slot(motor).set_point = None;
        }
        state.check(motor, command.kind)?;
        let asker = Arc::downgrade(&waiting.asker);
        let question = Question { asker, motor, command, patience, turn_ends: None, answer };
        state.questions.push_back(question);
        self.leave(state);
        Ok(waiting)
    }

    /// Lays down a set-point in place of an older one.
    pub(super) fn set_point(
        &self,
        motor: MotorId,
        command: Untyped,
    ) -> Result<(), SharedBusError<E>> {
        let mut state = self.lock();
        state.check(motor, command.kind)?;
        if state.news_since.is_some_and(|since| since.elapsed() > LONGEST_ROUND) {
            return Err(SharedBusError::Held);
        }
        let slot = state.slot(motor);
        if let Some(refusal) = slot.refusal.take() {
            return Err(refusal.into());
        }
        slot.set_point = Some(command);
        self.leave(state);
        Ok(())
    }

    /// Stops all. The answer is who has not confirmed it.
    pub(super) fn stop_all(&self, kind: StopKind, also: MotorSet) -> Awaited<MotorSet, E> {
        let (answer, waiting) = call();
        let mut state = self.lock();
        state.stops_all = true;
        state.drop_what_is_stopped(MotorSet::ALL);
        state.order(Order::StopAll { kind, also, answer })?;
        self.leave(state);
        Ok(waiting)
    }

    pub(super) fn stop(&self, motor: MotorId, kind: StopKind) -> Awaited<MotorSet, E> {
        let (answer, waiting) = call();
        let mut state = self.lock();
        state.stopped.insert(motor);
        state.drop_what_is_stopped(motor.into());
        state.order(Order::Stop { motor, kind, answer })?;
        self.leave(state);
        Ok(waiting)
    }

    pub(super) fn lift_stop(&self) -> Result<(), SharedBusError<E>> {
        let mut state = self.lock();
        (state.stops_all, state.stopped) = (false, MotorSet::EMPTY);
        state.order(Order::LiftStop)?;
        self.leave(state);
        Ok(())
    }

    pub(super) fn lift_stop_of(&self, motor: MotorId) -> Result<(), SharedBusError<E>> {
        let mut state = self.lock();
        state.stopped.remove(motor);
        state.order(Order::LiftStopOf(motor))?;
        self.leave(state);
        Ok(())
    }

    pub(super) fn resume(&self, motor: MotorId) -> Result<(), SharedBusError<E>> {
        let mut state = self.lock();
        state.slot(motor).refusal = None;
        state.restarted.remove(motor);
        state.order(Order::Resume(motor))?;
        self.leave(state);
        Ok(())
    }

    pub(super) fn forget(&self, motor: MotorId) -> Result<(), SharedBusError<E>> {
        let mut state = self.lock();
        state.restarted.remove(motor);
        state.order(Order::Forget(motor))?;
        self.leave(state);
        Ok(())
    }

    pub(super) fn latest(&self, motor: MotorId) -> Option<Latest> {
        self.lock().slot(motor).latest
    }

    pub(super) fn subscribe(&self, room: usize) -> Subscription {
        let (subscriber, subscription) = Subscriber::new(room);
        let mut state = self.lock();
        // Of what has ended there is nothing to be told.
        if matches!(state.life, Life::Running) {
            state.subscribers.push(subscriber);
        }
        subscription
    }

    /// Nobody has a handle any more.
    pub(super) fn close(&self) {
        let mut state = self.lock();
        if matches!(state.life, Life::Running) {
            state.life = Life::Closing;
        }
        self.leave(state);
    }

    /// Waits for an answer.
    pub(super) fn wait<T>(&self, awaited: Awaited<T, E>) -> Result<T, SharedBusError<E>> {
        self.answer(awaited?).unwrap_or(Err(SharedBusError::Held))
    }

    /// Waits for the end of a stop of these motors, all of which count as unconfirmed when nobody can tell.
    pub(super) fn wait_for_stop(
        &self,
        awaited: Awaited<MotorSet, E>,
        motors: MotorSet,
    ) -> Result<MotorSet, SharedBusError<E>> {
        self.answer(awaited?).unwrap_or(Ok(motors))
    }

    /// Waits for an answer. `None` if the thread's driver holds it.
    fn answer<T>(&self, waiting: Waiting<T, E>) -> Option<Result<T, SharedBusError<E>>> {
        let Waiting { answered, asker } = waiting;
        let take = |from: &Receiver<_>, longest| match from.recv_timeout(longest) {
            Err(Timeout) => None,
            answer => Some(answer),
        };
        let answer = self.unless_held(|longest| take(&answered, longest)).or_else(|| {
            // An error of the bus that comes now is told here, or to the next: nobody is told while this is locked.
            let _state = self.lock();
            let last = take(&answered, Duration::ZERO);
            drop((answered, asker));
            last
        });
        // Only a thread that has ended answers nothing, and it has said why.
        answer.map(|answer| answer.unwrap_or_else(|_| Err(self.lock().last_words())))
    }

    /// Waits for the end of the thread. False if its driver holds it.
    pub(super) fn wait_for_end(&self, thread: &JoinHandle<()>) -> bool {
        let ended = self.unless_held(|longest| {
            let begun = Instant::now();
            while !thread.is_finished() && begun.elapsed() < longest {
                thread::sleep(Duration::from_millis(1));
            }
            thread.is_finished().then_some(())
        });
        ended.is_some()
    }

    /// Waits again and again, unless the thread does not come round meanwhile: then its driver holds it, and there is
    /// nothing to wait for.
    fn unless_held<T>(&self, mut wait: impl FnMut(Duration) -> Option<T>) -> Option<T> {
        let mut look = || wait(LONGEST_ROUND / LOOKS);
        // What comes soon costs nobody another round.
        let mut outcome = look();
        while outcome.is_none() {
            let state = self.lock();
            let rounds = state.rounds;
            // One that idles comes round, too.
            self.leave(state);
            outcome = (0..LOOKS).find_map(|_| look());
            if self.lock().rounds == rounds {
                break;
            }
        }
        outcome
    }

    // ---- the thread's side ----

    /// Hands the clerk what is there: orders, then set-points, then questions, then set-points that are newer than
    /// a question which ends motion. False when it is time to end.
    pub(super) fn take(&self, clerk: &mut impl Clerk<E>) -> bool {
        let mut guard = self.lock();
        let state = &mut *guard;
        (state.is_idle, state.news_since) = (false, None);
        state.rounds += 1;
        state.orders.drain(..).for_each(|order| clerk.obey(order));
        state.hand_over_set_points(clerk);
        // What one motor is asked, it is asked in that order.
        let mut busy = MotorSet::EMPTY;
        for question in std::mem::take(&mut state.questions) {
            if question.asker.strong_count() == 0 && !question.command.kind.ends_motion() {
                continue;
            }
            let motor = question.motor;
            let left = if busy.contains(motor) { Some(question) } else { clerk.put(question) };
            if let Some(question) = left {
                busy.insert(motor);
                state.questions.push_back(question);
            }
        }
        state.hand_over_set_points(clerk);
        matches!(state.life, Life::Running)
    }

    /// Says that the thread is going to idle. False if there is something new.
    pub(super) fn may_idle(&self) -> bool {
        let mut state = self.lock();
        state.is_idle = state.news_since.is_none();
        state.is_idle
    }

    /// Waits until something is laid down, but not for longer.
    pub(super) fn wait_for_callers(&self, longest: Duration) {
        let state = self.lock();
        let is_quiet = |state: &mut State<E>| state.news_since.is_none();
        let result = self.changed.wait_timeout_while(state, longest, is_quiet);
        drop(result.unwrap_or_else(PoisonError::into_inner));
    }

    /// Hands an event to whoever wants it.
    pub(super) fn publish(&self, event: &Event) {
        let mut state = self.lock();
        state.subscribers.retain(|subscriber| subscriber.deliver(event));
        if let Event::Restarted { motor } = *event {
            state.restarted.insert(motor);
            state.drop_what_moves(motor);
        }
        let heard = match *event {
            Event::Feedback { motor, reply } => Some((motor, reply)),
            Event::Report { motor, reply } | Event::BroadcastReply { motor, reply } => {
                event.feedback().map(|_| (motor, reply))
            }
            _ => None,
        };
        if let Some((motor, reply)) = heard {
            state.slot(motor).latest = Some(Latest { reply, heard_at: Instant::now() });
        }
    }

    /// The bus has failed. Tells those whose answers these are, and all who wait here; if none of them is there any
    /// more, whoever comes next. What ends motion and has nobody to put it again stays.
    pub(super) fn fail(&self, error: &Arc<E>, asked: impl IntoIterator<Item = Answer<Data, E>>) {
        let mut state = self.lock();
        let tell = |answer: &Answer<Data, E>| {
            answer.send(Err(SharedBusError::Bus(Arc::clone(error)))).is_ok()
        };
        let mut told = asked.into_iter().filter(|answer| tell(answer)).count();
        state.questions.retain(|question| {
            let is_told = tell(&question.answer);
            told += usize::from(is_told);
            !is_told && question.command.kind.ends_motion()
        });
        if told == 0 {
            state.error = Some(Arc::clone(error));
        }
    }

    /// The thread ends: by a panic with these words, or because nobody has a handle.
    pub(super) fn end(&self, panicked: Option<Arc<str>>) {
        let mut state = self.lock();
        if let Some(words) = panicked {
            state.life = Life::Panicked(words);
        }
        // Whoever waits is told by that.
        state.orders.clear();
        state.questions.clear();
        state.subscribers.clear();
    }
}

/// Where an answer goes, and where it is waited for.
fn call<T, E>() -> (Answer<T, E>, Waiting<T, E>) {
    let (answer, answered) = sync_channel(1);
    (answer, Waiting { answered, asker: Arc::default() })
}

impl<E> State<E> {
    fn slot(&mut self, motor: MotorId) -> &mut Slot {
        &mut self.slots[motor.index()]
    }

    /// Whether a command may be laid down.
    fn check(&mut self, motor: MotorId, kind: Kind) -> Result<(), SharedBusError<E>> {
        if let Life::Panicked(_) = self.life {
            return Err(self.last_words());
        }
        // An error that is somebody else's keeps no stop from the bus.
        if !kind.ends_motion()
            && let Some(error) = self.error.take()
        {
            return Err(SharedBusError::Bus(error));
        }
        let is_stopped = self.stops_all || self.stopped.contains(motor);
        if is_stopped && kind.is_refused_while_stopped() {
            return Err(RequestError::Stopped.into());
        }
        if self.restarted.contains(motor) && kind.moves() {
            return Err(RequestError::Restarted.into());
        }
        Ok(())
    }

    fn order(&mut self, order: Order<E>) -> Result<(), SharedBusError<E>> {
        if let Life::Panicked(_) = self.life {
            return Err(self.last_words());
        }
        self.orders.push(order);
        Ok(())
    }

    /// Hands the clerk the set-points, but for those of motors that are still to be asked to end their motion: what
    /// is there for one of these is newer than that, which would drop it.
    fn hand_over_set_points(&mut self, clerk: &mut impl Clerk<E>) {
        let ends_motion = |question: &&Question<E>| question.command.kind.ends_motion();
        let ending: MotorSet =
            self.questions.iter().filter(ends_motion).map(|question| question.motor).collect();
        for motor in MotorSet::ALL.without(ending).iter() {
            let slot = self.slot(motor);
            if let Some(set_point) = slot.set_point.take()
                && let Err(refusal) = clerk.set_point(motor, set_point)
            {
                slot.refusal = Some(refusal);
            }
        }
    }

    /// A stop drops whatever is older than it.
    fn drop_what_is_stopped(&mut self, motors: MotorSet) {
        for motor in motors.iter() {
            self.slot(motor).set_point = None;
        }
        self.drop_questions(|motor, kind| {
            let is_dropped = motors.contains(motor) && kind.is_refused_while_stopped();
            is_dropped.then_some(SharedBusError::Failed(Failure::Stopped))
        });
    }

    /// A restart drops what moves and is older than the word of it.
    fn drop_what_moves(&mut self, restarted: MotorId) {
        let slot = self.slot(restarted);
        if slot.set_point.take().is_some() {
            slot.refusal = Some(RequestError::Restarted);
        }
        self.drop_questions(|motor, kind| {
            let is_dropped = motor == restarted && kind.moves();
            is_dropped.then_some(SharedBusError::Request(RequestError::Restarted))
        });
    }

    /// Drops the questions of which this gives why.
    fn drop_questions(&mut self, why: impl Fn(MotorId, Kind) -> Option<SharedBusError<E>>) {
        self.questions.retain(|question| {
            let why = why(question.motor, question.command.kind);
            why.is_none_or(|error| {
                let _ = question.answer.send(Err(error));
                false
            })
        });
    }

    fn last_words(&self) -> SharedBusError<E> {
        SharedBusError::Panicked(match &self.life {
            Life::Panicked(words) => Arc::clone(words),
            Life::Running | Life::Closing => Arc::from("nobody is there any more"),
        })
    }
}
