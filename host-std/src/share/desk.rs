//! Callers lay down here what they want, and the thread of the bus takes it up.
//!
//! Everything is under one lock, so the order of the calls decides: a stop drops what is older
//! at once, and refuses what comes after it, whether or not the thread has seen it yet.

use std::fmt;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use myactuator_protocol_core::error::RequestError;
use myactuator_protocol_core::io;
use myactuator_protocol_core::master::{Event, MotorSet, StopKind};
use myactuator_protocol_core::{Data, MotorId, time};

use super::calls::{Answer, Awaited, Insistence, Order, Question, Untyped, Waiting};
use super::past::Past;
use super::state::{Clerk, LaidDown, Latest, Life, Put, State};
use super::subscription::{Subscriber, Subscription};
use super::{LoopError, SharedBusError};
use crate::open::{Wake, since_boot};

/// So many looks share the longest round: a program that was frozen finds that the time of one look is up, and still
/// has the others.
const LOOKS: u32 = 20;

pub(super) struct Desk<E> {
    state: Mutex<State<E>>,
    /// Something was laid down.
    changed: Condvar,
    wake: Option<Wake>,
}

/// A motor that one call moves. However that call ends, the motor is then free for another.
pub(super) struct Moving<'a, E> {
    desk: &'a Desk<E>,
    motor: MotorId,
}

impl<E> Drop for Moving<'_, E> {
    fn drop(&mut self) {
        self.desk.lock().moving.remove(self.motor);
    }
}

/// A motor whose brake one call opens. Until this is dropped, questions to the motor wait, except those that open its
/// brake or end motion.
pub(super) struct Opening<'a, E> {
    desk: &'a Desk<E>,
    motor: MotorId,
}

impl<E> Drop for Opening<'_, E> {
    fn drop(&mut self) {
        let mut state = self.desk.lock();
        state.slot(self.motor).opening -= 1;
        self.desk.leave(state);
    }
}

/// A function that works with one motor and waits for the bus. Until this is dropped the thread speaks to all motors.
pub(super) struct AtWork<'a, E>(&'a Desk<E>);

impl<E> Drop for AtWork<'_, E> {
    fn drop(&mut self) {
        self.0.lock().at_work -= 1;
    }
}

impl<E> Desk<E> {
    pub(super) fn new(wake: Option<Wake>) -> Self {
        Self { state: Mutex::new(State::new()), changed: Condvar::new(), wake }
    }

    /// Whether the thread can be woken while it idles.
    pub(super) const fn wakes(&self) -> bool {
        self.wake.is_some()
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, State<E>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Unlocks the state and has the thread look at it.
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

    /// Lays down a question of a caller that began to work with that motor at `since`.
    pub(super) fn ask(
        &self,
        motor: MotorId,
        command: Untyped,
        insistence: Insistence,
        since: Option<Past>,
    ) -> Awaited<Data, E> {
        let (answer, waiting) = Waiting::new();
        let mut state = self.lock();
        let stop = StopKind::by(command.kind);
        // A caller that began before the motor was let go does not switch it on by holding it.
        if stop.is_some_and(|kind| state.stop_kind(motor, kind, since) != kind) {
            return Err(SharedBusError::Refused { motor, refusal: RequestError::Stopped });
        }
        state.check(motor, command.kind, since)?;
        if command.kind.ends_motion() {
            state.drop_what_is_ended(motor, command.kind);
        }
        let asker = Arc::downgrade(&waiting.asker);
        let question = Question { asker, motor, command, insistence, turn_ends: None, answer };
        state.put(question);
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
        state.check(motor, command.kind, None)?;
        state.check_taken_up()?;
        let slot = state.slot(motor);
        if let Some(refusal) = slot.refusal.take() {
            return Err(SharedBusError::Refused { motor, refusal });
        }
        slot.set_point = Some(LaidDown { command, laid_at: since_boot(), found_at: None });
        self.leave(state);
        Ok(())
    }

    /// Lays down an order.
    pub(super) fn order(&self, order: Order<E>) -> Result<(), SharedBusError<E>> {
        let mut state = self.lock();
        state.order(order)?;
        self.leave(state);
        Ok(())
    }

    /// Lifts every stop if so many were called for. Returns whether it has.
    pub(super) fn lift_stop_if(&self, stops: u64) -> Result<bool, SharedBusError<E>> {
        let mut state = self.lock();
        let is_newest = state.stops == stops;
        if is_newest {
            state.order(Order::LiftStop)?;
            self.leave(state);
        }
        Ok(is_newest)
    }

    /// Stops all motors. The answer is those that have not confirmed it.
    pub(super) fn stop_all(&self, kind: StopKind, also: MotorSet) -> Awaited<MotorSet, E> {
        let (answer, waiting) = Waiting::new();
        let asker = Arc::clone(&waiting.asker);
        self.order(Order::StopAll { kind, also, asker, answer })?;
        Ok(waiting)
    }

    /// Stops a motor for a caller that began to work with it at `since`.
    pub(super) fn stop(
        &self,
        motor: MotorId,
        kind: StopKind,
        since: Option<Past>,
    ) -> Awaited<MotorSet, E> {
        let (answer, waiting) = Waiting::new();
        let mut state = self.lock();
        let kind = state.stop_kind(motor, kind, since);
        state.order(Order::Stop { motor, kind, answer })?;
        self.leave(state);
        Ok(waiting)
    }

    /// The past of a motor, as it is when a caller begins to work with it.
    pub(super) fn past(&self, motor: MotorId) -> Past {
        self.lock().past(motor)
    }

    /// Whether a caller that began at `since` may move a motor now.
    pub(super) fn may_move(&self, motor: MotorId, since: Past) -> Result<(), RequestError> {
        self.lock().may_move(motor, since)
    }

    /// Takes a motor for a move, until the result is dropped; `None` while another move has it.
    pub(super) fn begin_move(&self, motor: MotorId) -> Option<Moving<'_, E>> {
        let mut state = self.lock();
        let is_free = !state.moving.contains(motor);
        state.moving.insert(motor);
        is_free.then(|| Moving { desk: self, motor })
    }

    /// A call that began at `since` has moved this motor, and it has arrived. That says nothing if others have told it
    /// to move meanwhile.
    pub(super) fn note_arrival(&self, motor: MotorId, since: Past) {
        let mut state = self.lock();
        // If the thread has ended, nobody is asked any more.
        if !state.past(motor).was_moved_since(since)
            && state.order(Order::NoteArrival(motor)).is_ok()
        {
            self.leave(state);
        }
    }

    pub(super) fn begin_work(&self) -> AtWork<'_, E> {
        self.lock().at_work += 1;
        AtWork(self)
    }

    /// A call is going to open this motor's brake.
    pub(super) fn begin_opening(&self, motor: MotorId) -> Opening<'_, E> {
        self.lock().slot(motor).opening += 1;
        Opening { desk: self, motor }
    }

    /// Waits until `until`, on the clock of the bus. The answer is the time then.
    pub(super) fn wait_until(&self, until: time::Instant) -> Awaited<time::Instant, E> {
        let (answer, waiting) = Waiting::new();
        self.order(Order::Wait { until, answer })?;
        Ok(waiting)
    }

    pub(super) fn latest(&self, motor: MotorId) -> Option<Latest> {
        self.lock().slot(motor).latest
    }

    pub(super) fn subscribe(&self, room: usize) -> Subscription {
        let (subscriber, subscription) = Subscriber::new(room);
        let mut state = self.lock();
        // A bus that has ended has nothing to report.
        if matches!(state.life, Life::Running) {
            state.subscribers.push(subscriber);
        }
        subscription
    }

    /// The loop of a watch looks. The first look lays the watch down, and sets its key.
    pub(super) fn look(
        &self,
        key: &mut Option<u64>,
        watch: &io::Watch,
        kind: StopKind,
    ) -> Result<(), LoopError<E>>
    where
        E: fmt::Debug + 'static,
    {
        let mut state = self.lock();
        if !matches!(state.life, Life::Running) {
            return Err(state.last_words().into());
        }
        let found = state.look(key, watch, kind, self.wakes());
        self.leave(state);
        found
    }

    pub(super) fn end_watch(&self, key: u64) {
        self.lock().watches.retain(|watched| watched.key != key);
    }

    /// The loop of the watch with this key has panicked.
    pub(super) fn loop_panics(&self, key: u64) {
        let mut state = self.lock();
        if let Some(watched) = state.watches.iter_mut().find(|watched| watched.key == key) {
            watched.panics();
        }
        self.leave(state);
    }

    /// The last handle was dropped.
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

    /// Waits for the end of a stop of these motors. All of them count as unconfirmed if the thread does not answer.
    pub(super) fn wait_for_stop(
        &self,
        awaited: Awaited<MotorSet, E>,
        motors: MotorSet,
    ) -> Result<MotorSet, SharedBusError<E>> {
        self.answer(awaited?).unwrap_or(Ok(motors))
    }

    /// The answer, if it is there already. After this the call no longer waits for it.
    pub(super) fn take_answer<T>(&self, awaited: Awaited<T, E>) -> Result<T, SharedBusError<E>> {
        self.last_answer(awaited?).unwrap_or(Err(SharedBusError::Held))
    }

    /// Waits for an answer. `None` if the thread's driver holds it.
    fn answer<T>(&self, waiting: Waiting<T, E>) -> Option<Result<T, SharedBusError<E>>> {
        let last_words = || self.lock().last_words();
        let answer = self.unless_held(|longest| waiting.take(longest, last_words));
        answer.or_else(|| self.last_answer(waiting))
    }

    fn last_answer<T>(&self, waiting: Waiting<T, E>) -> Option<Result<T, SharedBusError<E>>> {
        // An error of the bus that comes now goes to this call or to the next: none is handed out while this is locked.
        let state = self.lock();
        let last = waiting.take(Duration::ZERO, || state.last_words());
        drop(waiting);
        drop(state);
        last
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

    /// Waits again and again, for as long as the thread makes rounds meanwhile. If it makes none, its driver holds it,
    /// and there is nothing to wait for.
    fn unless_held<T>(&self, mut wait: impl FnMut(Duration) -> Option<T>) -> Option<T> {
        let longest_look = self.lock().longest_round / LOOKS;
        let mut look = || wait(longest_look);
        // An answer that comes soon costs no extra round.
        let mut outcome = look();
        while outcome.is_none() {
            let state = self.lock();
            let rounds = state.rounds;
            // A thread that idles makes a round, too.
            self.leave(state);
            outcome = (0..LOOKS).find_map(|_| look());
            if self.lock().rounds == rounds {
                break;
            }
        }
        outcome
    }

    // ---- the thread's side ----

    /// Hands everything to the clerk: orders, then set-points, then questions, then set-points that are newer than
    /// a question which ends motion. False when it is time to end.
    pub(super) fn take(&self, clerk: &mut impl Clerk<E>) -> bool {
        let mut guard = self.lock();
        let state = &mut *guard;
        (state.is_idle, state.news_since) = (false, None);
        state.rounds += 1;
        state.look_after_loops(clerk);
        state.hand_over_orders(clerk);
        state.hand_over_set_points(clerk);
        // Questions to one motor keep their order.
        let mut busy = MotorSet::EMPTY;
        for question in std::mem::take(&mut state.questions) {
            let (motor, kind) = (question.motor, question.command.kind);
            if question.asker.strong_count() == 0 && !question.outlives_its_caller() {
                continue;
            }
            if state.waits_for_hold(motor, kind) {
                state.questions.push_back(question);
                continue;
            }
            let is_busy = busy.contains(motor);
            match if is_busy { Put::Waits(question) } else { clerk.put(question) } {
                Put::Accepted => state.slot(motor).past.note_command(kind),
                Put::Refused => {}
                Put::Waits(question) => {
                    busy.insert(motor);
                    state.questions.push_back(question);
                }
            }
        }
        state.hand_over_set_points(clerk);
        clerk.keep_alive(state.at_work > 0);
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

    /// The master says that a motor has restarted.
    pub(super) fn has_restarted(&self, motor: MotorId) {
        self.lock().has_restarted(motor);
    }

    /// Hands an event to all watches.
    pub(super) fn note(&self, event: &Event) {
        self.lock().watches.iter_mut().for_each(|watched| watched.note(event));
    }

    /// Hands an event to all subscribers.
    pub(super) fn publish(&self, event: &Event) {
        let mut state = self.lock();
        state.subscribers.retain(|subscriber| subscriber.deliver(event));
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

    /// The bus has failed. The error goes to the callers that wait for these answers, to all whose questions wait here,
    /// and, until the bus [works](Self::works) again, to all that come. If none is there to get it, the next caller
    /// does. A question that ends motion stays if its caller has gone, since nothing would ask it again.
    pub(super) fn fail(&self, error: &Arc<E>, asked: impl IntoIterator<Item = Answer<Data, E>>) {
        let mut state = self.lock();
        let tell = |answer: &Answer<Data, E>| {
            answer.send(Err(SharedBusError::Bus(Arc::clone(error)))).is_ok()
        };
        let mut told = asked.into_iter().filter(|answer| tell(answer)).count();
        state.questions.retain(|question| {
            let is_told = tell(&question.answer);
            told += usize::from(is_told);
            !is_told && question.outlives_its_caller()
        });
        // While the bus goes on failing, each caller gets the error.
        if told == 0 && state.outage.is_none() {
            state.error = Some(Arc::clone(error));
        }
        state.outage = Some(Arc::clone(error));
    }

    /// The bus works again.
    pub(super) fn works(&self) {
        self.lock().outage = None;
    }

    /// The thread has panicked, with this message, and has a last stop to send.
    pub(super) fn has_panicked(&self, words: Arc<str>) {
        let mut state = self.lock();
        state.life = Life::Panicked(words);
        // This wakes the callers that wait.
        state.orders.clear();
        state.questions.clear();
    }

    /// The thread ends: no subscriber gets anything any more.
    pub(super) fn end(&self) {
        self.lock().subscribers.clear();
    }
}
