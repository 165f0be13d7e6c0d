//! The thread that runs the bus.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Weak};
use std::time;

use myactuator_protocol_core::command::AnyReply;
use myactuator_protocol_core::error::RequestError;
use myactuator_protocol_core::io::{
    Elapsed, KeepAlive, LONGEST_STOP, LONGEST_TURN, Runner, longest_stop,
};
use myactuator_protocol_core::master::{Event, MotorSet, StopKind, Ticket};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::{Data, MotorId};

use super::SharedBusError;
use super::calls::{Answer, Asker, Insistence, Order, Question, Untyped};
use super::desk::Desk;
use super::state::{Clerk, Put};
use super::told::Told;
use super::watch::Watched;
use crate::open::since_boot;

/// How long a thread idles if nothing can wake it.
const LONGEST_IDLE: Duration = Duration::from_millis(1);
/// After how long a bus that has failed is tried again.
const RETRY_AFTER: time::Duration = time::Duration::from_millis(1);

const NEVER: Instant = Instant::from_micros(u64::MAX);

/// Runs the bus until the last handle was dropped, or its driver panics. Then stops all motors.
pub(super) fn run<R: Runner<N>, const N: usize>(runner: R, desk: &Desk<R::Error>, kind: StopKind) {
    let now = runner.now();
    let mut worker = Worker {
        runner,
        asked: Vec::new(),
        stopping: Vec::new(),
        at_work: None,
        holding: KeepAlive::new(),
        to_forget: MotorSet::EMPTY,
        is_any_waiting: false,
        told: Told::default(),
        waiting: Vec::new(),
        turn_ends: None,
        late_after: None,
        taken_at: now,
        looked_at: now,
        has_failed: false,
        all_stopped: None,
    };
    let outcome = catch_unwind(AssertUnwindSafe(|| while worker.round(desk) {}));
    if let Err(payload) = &outcome {
        desk.has_panicked(words(&**payload));
    }
    let Worker { mut runner, asked, stopping, waiting, all_stopped, .. } = worker;
    // Callers that wait find out now, and need not wait for the stop, unless it is a stop that they wait for. After a
    // panic nothing ends that.
    drop((asked, waiting));
    let stopping = if outcome.is_ok() { stopping } else { Vec::new() };
    let now = runner.now();
    // Whoever has waited for this stop knows what it has reached, and need not wait again.
    let is_known = all_stopped.is_some_and(|(it, over_at)| {
        it.kind == kind && it.asker.has_answer() && now - over_at < LONGEST_STOP
    });
    if outcome.is_ok() && is_known && stopping.is_empty() {
        return desk.end();
    }
    let all = runner.master().motors();
    // A driver that has panicked may do it again: then no motor has confirmed.
    let stopped = catch_unwind(AssertUnwindSafe(|| runner.stop_all(kind, MotorSet::EMPTY)));
    let unconfirmed = stopped.unwrap_or(all);
    for motor in unconfirmed.iter() {
        desk.publish(&Event::StopUnconfirmed { motor });
    }
    for stop in stopping {
        let confirmed = stop.running.without(unconfirmed);
        let _ = stop.answer.send(Ok(stop.unconfirmed.without(confirmed)));
    }
    desk.end();
}

/// The message of a panic.
fn words(payload: &(dyn Any + Send)) -> Arc<str> {
    let text = payload.downcast_ref::<&str>().copied();
    let text = text.or_else(|| payload.downcast_ref::<String>().map(String::as_str));
    Arc::from(text.unwrap_or("it did not say why"))
}

struct Worker<R: Runner<N>, const N: usize> {
    runner: R,
    asked: Vec<Asked<R::Error>>,
    stopping: Vec<Stopping<R::Error>>,
    /// Asks those that were [told nothing](Told::untold) while a stop or a function waits for one motor.
    at_work: Option<KeepAlive>,
    /// Asks those that hold.
    holding: KeepAlive,
    /// These are to be forgotten once they are not spoken to.
    to_forget: MotorSet,
    /// A stop, or a function that works with one motor, waits.
    is_any_waiting: bool,
    told: Told,
    /// Callers that wait for a time.
    waiting: Vec<(Instant, Answer<Instant, R::Error>)>,
    /// The first time at which a question that waits for its turn gives up.
    turn_ends: Option<Instant>,
    /// Until when the first loop that is watched has to look.
    late_after: Option<Instant>,
    /// When the desk was last taken up: what is there now is no older.
    taken_at: Instant,
    /// When that ended, or the idling after it.
    looked_at: Instant,
    /// The last round of the bus has failed.
    has_failed: bool,
    /// The last stop of all motors, and when it was over. Nothing was asked or ordered since it was called for.
    all_stopped: Option<(StopOfAll, Instant)>,
}

/// A question that was put.
struct Asked<E> {
    /// Gone when the caller no longer waits for the answer.
    asker: Weak<Asker>,
    ticket: Ticket<Untyped>,
    answer: Answer<Data, E>,
}

struct StopOfAll {
    kind: StopKind,
    asker: Arc<Asker>,
}

/// A stop that a caller waits for.
struct Stopping<E> {
    /// If it stops all motors, and nothing was asked or ordered since.
    of_all: Option<StopOfAll>,
    /// Those that have not confirmed it so far.
    unconfirmed: MotorSet,
    /// Those of them that still may.
    running: MotorSet,
    elapsed: Elapsed,
    answer: Answer<MotorSet, E>,
}

impl<R: Runner<N>, const N: usize> Worker<R, N> {
    /// One round of the bus. False when it is time to end.
    fn round(&mut self, desk: &Desk<R::Error>) -> bool {
        (self.turn_ends, self.late_after) = (None, None);
        self.withdraw_what_was_given_up();
        self.forget();
        let taken_at = self.runner.now();
        let goes_on = desk.take(self);
        self.taken_at = taken_at;
        self.looked_at = self.runner.now();
        match self.runner.poll() {
            Ok(event) => {
                // An event may be one that the failed round has left.
                if event.is_none() && std::mem::take(&mut self.has_failed) {
                    desk.works();
                }
                match event {
                    Some(event) => self.tell(&event, desk),
                    None if goes_on => self.idle(desk),
                    None => {}
                }
            }
            Err(error) => self.fail(error, desk),
        }
        self.end_stops(desk);
        self.end_waits();
        goes_on
    }

    /// A command that moves a motor, and that its caller gave up while the driver held this thread, is not sent late.
    fn withdraw_what_was_given_up(&mut self) {
        let master = self.runner.master();
        self.asked.retain(|asked| {
            let is_awaited = asked.asker.strong_count() > 0;
            if !is_awaited {
                master.withdraw(asked.ticket.id());
            }
            is_awaited
        });
    }

    fn forget(&mut self) {
        let master = self.runner.master();
        for motor in self.to_forget.iter() {
            if master.forget(motor) {
                self.to_forget.remove(motor);
                self.told.is_forgotten(motor);
            }
        }
    }

    /// Hands an event to all that it concerns.
    fn tell(&mut self, event: &Event, desk: &Desk<R::Error>) {
        // Unless it was resumed already.
        if let Event::Restarted { motor } = *event
            && self.runner.master().has_restarted(motor)
        {
            desk.has_restarted(motor);
        }
        let in_error = self.told.note(event);
        match *event {
            Event::StopConfirmed { motor } => self.to_forget.remove(motor),
            Event::Reply { ticket, .. } => self.to_forget.remove(ticket.motor()),
            _ => {}
        }
        desk.note(event);
        let now = self.runner.now();
        let of_work = self.at_work.as_mut().is_some_and(|it| it.takes(event, now));
        if self.holding.takes(event, now) || of_work {
            // An error concerns everybody.
            if let Some((motor, status)) = in_error {
                desk.publish(&Event::Report { motor, reply: AnyReply::ReadStatus1(status) });
            }
            return;
        }
        // A caller that has its answer and then subscribes gets nothing older.
        desk.publish(event);
        self.answer(event);
    }

    fn answer(&mut self, event: &Event) {
        self.asked.retain(|asked| {
            let Some(outcome) = asked.ticket.outcome(event) else { return true };
            let motor = asked.ticket.id().motor();
            let failed = |failure| SharedBusError::Failed { motor, failure };
            // If the caller has gone, the answer is lost.
            let _ = asked.answer.send(outcome.map(|reply| reply.0).map_err(failed));
            false
        });
        for stop in &mut self.stopping {
            match *event {
                Event::StopConfirmed { motor } => {
                    stop.running.remove(motor);
                    stop.unconfirmed.remove(motor);
                }
                Event::StopUnconfirmed { motor } => stop.running.remove(motor),
                _ => {}
            }
        }
    }

    /// Answers the callers that wait for a stop that is over. A stop whose time is up is no event of the master, so
    /// subscriptions are told here, too.
    fn end_stops(&mut self, desk: &Desk<R::Error>) {
        let now = self.runner.now();
        // The stop to all at once may be the only one for motors that were not named.
        let is_all_sent = !self.runner.master().is_stop_to_all_waiting();
        self.stopping.retain_mut(|stop| {
            let longest = longest_stop(self.runner.master(), stop.running, now);
            let is_late = stop.elapsed.at(now) >= longest;
            let is_over = stop.running.is_empty() && is_all_sent || is_late;
            if is_over {
                for motor in stop.running.iter() {
                    desk.publish(&Event::StopUnconfirmed { motor });
                }
                let _ = stop.answer.send(Ok(stop.unconfirmed));
                if let Some(of_all) = stop.of_all.take() {
                    self.all_stopped = Some((of_all, now));
                }
            }
            !is_over
        });
    }

    /// Answers the callers whose time has come.
    fn end_waits(&mut self) {
        let now = self.runner.now();
        self.waiting.retain(|(until, answer)| {
            let is_over = *until <= now;
            if is_over {
                let _ = answer.send(Ok(now));
            }
            !is_over
        });
    }

    /// When something is to be done that no event triggers.
    fn wake_at(&self) -> Option<Instant> {
        let look_again = self.runner.now() + Elapsed::LOOK_AGAIN;
        let asks = self.at_work.is_some() || !self.told.holding().is_empty();
        let of_others = asks.then_some(look_again);
        let waits = self.waiting.iter().map(|(until, _)| *until);
        waits.chain(of_others).chain(self.turn_ends).min()
    }

    fn idle(&mut self, desk: &Desk<R::Error>) {
        if !desk.may_idle() {
            return;
        }
        let wake_at = self.wake_at();
        if desk.wakes() {
            // A loop is late a moment after that. Otherwise rounds come often enough, and virtual time must not go on
            // because of it.
            let late_at = self.late_after.map(|time| time + Duration::from_micros(1));
            self.runner.idle(wake_at.into_iter().chain(late_at).min().unwrap_or(NEVER));
        } else if self.is_any_waiting
            || !self.waiting.is_empty()
            || self.turn_ends.is_some()
            || !self.asked.is_empty()
            || self.runner.master().poll_at().is_some()
        {
            let until = self.runner.now() + LONGEST_IDLE;
            self.runner.idle(wake_at.map_or(until, |at| at.min(until)));
        } else {
            desk.wait_for_callers(LONGEST_IDLE.into());
        }
        self.looked_at = self.runner.now();
    }

    /// Hands the error to all that wait, and lets the bus rest.
    fn fail(&mut self, error: R::Error, desk: &Desk<R::Error>) {
        self.has_failed = true;
        let error = Arc::new(error);
        let master = self.runner.master();
        let answers = self.asked.drain(..).map(|asked| {
            // A caller that gets the error may ask again.
            master.withdraw(asked.ticket.id());
            asked.answer
        });
        desk.fail(&error, answers);
        // A bus that fails at each round leaves no other occasion.
        while let Some(event) = self.runner.master().poll_event() {
            self.tell(&event, desk);
        }
        desk.wait_for_callers(RETRY_AFTER);
        // Virtual time goes on only here.
        let until = self.runner.now() + RETRY_AFTER.into();
        self.runner.idle(until);
    }

    /// Something is asked or ordered: no stop before it is the last word.
    fn note_work(&mut self) {
        self.all_stopped = None;
        self.stopping.iter_mut().for_each(|stop| stop.of_all = None);
    }

    /// These are told to stop. What is off stays off.
    fn note_stop(&mut self, motors: MotorSet, kind: StopKind) {
        let stay_off = self.runner.master().switched_off();
        for motor in motors.iter() {
            let kind = if stay_off.contains(motor) { StopKind::Off } else { kind };
            self.told.stops(motor, kind);
        }
    }

    fn await_stop(
        &mut self,
        of_all: Option<StopOfAll>,
        running: MotorSet,
        also: MotorSet,
        answer: Answer<MotorSet, R::Error>,
    ) {
        let unconfirmed = running.with(also);
        let elapsed = Elapsed::default();
        self.stopping.push(Stopping { of_all, unconfirmed, running, elapsed, answer });
    }
}

impl<R: Runner<N>, const N: usize> Clerk<R::Error> for Worker<R, N> {
    fn obey(&mut self, order: Order<R::Error>) {
        self.note_work();
        let master = self.runner.master();
        match order {
            Order::StopAll { kind, also, asker, answer } => {
                // Motors without a place in the master are not stopped, and count as unconfirmed.
                let _ = master.stop_all(kind, also);
                let running = master.motors();
                self.note_stop(running, kind);
                self.to_forget = MotorSet::EMPTY;
                self.await_stop(Some(StopOfAll { kind, asker }), running, also, answer);
            }
            Order::Stop { motor, kind, answer } => match master.stop(motor, kind) {
                Ok(()) => {
                    self.note_stop(motor.into(), kind);
                    self.to_forget.remove(motor);
                    self.await_stop(None, motor.into(), MotorSet::EMPTY, answer);
                }
                Err(refusal) => {
                    let _ = answer.send(Err(SharedBusError::Refused { motor, refusal }));
                }
            },
            Order::LiftStop => master.lift_stop(),
            Order::LiftStopOf(motor) => master.lift_stop_of(motor),
            Order::Resume(motor) => master.resume(motor),
            Order::NoteRestart(motor) => master.note_restart(motor),
            Order::NoteArrival(motor) => self.told.has_arrived(motor),
            Order::Wait { until, answer } => self.waiting.push((until, answer)),
            Order::Forget(motor) => {
                // While it is spoken to it keeps its place.
                self.to_forget.insert(motor);
                self.forget();
            }
        }
    }

    fn watch(&mut self, watched: &mut Watched) -> bool {
        let now = self.runner.now();
        let is_late = watched.look(self.runner.master(), now);
        self.late_after = self.late_after.into_iter().chain(watched.late_after()).min();
        is_late
    }

    fn is_any_held(&self) -> bool {
        self.told.is_any_held()
    }

    fn keep_alive(&mut self, is_any_at_work: bool) {
        self.is_any_waiting = is_any_at_work || !self.stopping.is_empty();
        let (now, master) = (self.runner.now(), self.runner.master());
        if self.is_any_waiting {
            let at_work = self.at_work.get_or_insert(KeepAlive::of_stop(now));
            at_work.ask(self.told.untold(), master, now);
        } else {
            // What is still to come of these questions is for nobody.
            self.at_work.take_if(|it| !it.is_waiting());
        }
        self.holding.ask(self.told.holding(), master, now);
    }

    fn set_point(
        &mut self,
        motor: MotorId,
        set_point: Untyped,
        found_at: Instant,
    ) -> Result<(), RequestError> {
        self.note_work();
        self.to_forget.remove(motor);
        self.runner.master().set_point(motor, set_point, found_at)?;
        self.told.follows(motor);
        Ok(())
    }

    fn found_at(&self, laid_at: time::Duration) -> Instant {
        // Since then the driver may have been busy for long, and the program may have been suspended while it waited.
        let now = self.runner.now();
        let age = Duration::from(since_boot().saturating_sub(laid_at));
        let laid_at = now - age;
        self.looked_at.min(laid_at).max(self.taken_at)
    }

    fn put(&mut self, mut question: Question<R::Error>) -> Put<R::Error> {
        self.note_work();
        let now = self.runner.now();
        let turn_ends = *question.turn_ends.get_or_insert(now + LONGEST_TURN);
        let Question { motor, command, insistence, .. } = question;
        self.to_forget.remove(motor);
        let master = self.runner.master();
        let ticket = match insistence {
            // Its turn comes too late: the program may have been suspended.
            _ if now >= turn_ends && !command.kind.ends_motion() => Err(RequestError::Busy),
            Insistence::Usual => master.request(motor, command),
            Insistence::Attempts(attempts) => {
                master.request_with(motor, command, master.patience(attempts))
            }
            Insistence::Of(patience) => master.request_with(motor, command, patience),
        };
        match ticket {
            Ok(ticket) => {
                if command.kind.moves() {
                    self.told.moves(motor);
                }
                if command.kind.ends_motion() {
                    self.told.ends_motion(motor, command.kind);
                }
                let Question { asker, answer, .. } = question;
                self.asked.push(Asked { asker, ticket, answer });
                Put::Accepted
            }
            Err(RequestError::Busy) if now < turn_ends => {
                self.turn_ends =
                    Some(self.turn_ends.map_or(turn_ends, |first| first.min(turn_ends)));
                Put::Waits(question)
            }
            Err(refusal) => {
                let _ = question.answer.send(Err(SharedBusError::Refused { motor, refusal }));
                Put::Refused
            }
        }
    }
}
