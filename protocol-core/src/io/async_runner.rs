//! What every async loop offers, on any bus.

use core::fmt;

use embassy_futures::yield_now;

use crate::command::{Command, SetPoint};
use crate::id::MotorId;
use crate::io::asking::{Askings, CallError, outcome_of_set_point};
use crate::io::elapsed::Elapsed;
use crate::io::keep_alive::KeptAlive;
use crate::io::on_drop::OnDrop;
use crate::io::pump::RETRY_AFTER;
use crate::io::runner::longest_stop;
use crate::master::{Event, Master, MotorSet, Patience, StopKind};
use crate::time::Instant;

/// An async loop that runs a [`Master`] on a bus: [`Runner`](crate::io::Runner) for tasks.
///
/// The bus moves only while one of these futures is awaited. Any of them may be dropped, by a `select` or a time-out:
/// no event is lost and no frame is sent twice. What becomes of a request whose [`ask`](Self::ask) is dropped:
///
/// - In general it stays under way, and the next request waits for its end.
/// - One that a stop [would refuse](crate::Kind::is_refused_while_stopped), such as a move or a set-point whose
///   feedback was waited for, is not sent from then on: nobody knows how late the bus moves again.
/// - If the bus has already taken such a command, it is carried out; see [`Master::withdraw`]. Stop the motor.
///
/// As with [`Runner`](crate::io::Runner), a call that waits ignores other events.
#[allow(async_fn_in_trait, reason = "one task runs one bus, so nothing asks for Send")]
pub trait AsyncRunner<const N: usize> {
    /// What the bus driver reports when it fails.
    type Error: fmt::Debug;

    /// The master that this loop runs.
    fn master(&mut self) -> &mut Master<N>;

    /// The time now.
    fn now(&self) -> Instant;

    /// Runs the bus until there is an event, or until `until` if none comes; with `None`, until there is an event. What
    /// can be sent is sent, even if `until` is past.
    ///
    /// # Errors
    /// What the bus driver reports. The master stays sound: call again. The next call begins a millisecond after the
    /// error.
    async fn run(&mut self, until: Option<Instant>) -> Result<Option<Event>, Self::Error>;

    /// Runs the bus until there is an event.
    ///
    /// # Errors
    /// As [`run`](Self::run).
    async fn next_event(&mut self) -> Result<Event, Self::Error> {
        loop {
            if let Some(event) = self.run(None).await? {
                return Ok(event);
            }
        }
    }

    /// As [`Runner::run_until`](crate::io::Runner::run_until). If `until` is past, other tasks get a turn.
    async fn run_until(
        &mut self,
        until: Instant,
        mut on_event: impl FnMut(Event),
    ) -> Result<(), CallError<Self::Error>> {
        let is_late = self.now() >= until;
        // A late loop first receives all that has come. What waits is sent after that.
        while let Some(event) = self.run(Some(until)).await.map_err(CallError::Bus)? {
            on_event(event);
        }
        if is_late {
            // Otherwise a loop that is always late would starve other tasks, such as that of a stop button.
            yield_now().await;
        }
        Ok(())
    }

    /// As [`Runner::ask_with`](crate::io::Runner::ask_with).
    async fn ask_with<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
        patience: Option<Patience>,
        on_event: impl FnMut(Event),
    ) -> Result<C::Reply, CallError<Self::Error>> {
        let [outcome] = ask_all(self, [(motor, command)], patience, on_event).await;
        outcome
    }

    /// As [`Runner::ask`](crate::io::Runner::ask).
    async fn ask<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
    ) -> Result<C::Reply, CallError<Self::Error>> {
        self.ask_with(motor, command, None, |_| {}).await
    }

    /// As [`Runner::ask_together`](crate::io::Runner::ask_together).
    async fn ask_together<C: Command, const M: usize>(
        &mut self,
        questions: [(MotorId, C); M],
    ) -> [Result<C::Reply, CallError<Self::Error>>; M] {
        ask_all(self, questions, None, |_| {}).await
    }

    /// Puts a set-point in a motor's stream; see [`Master::set_point`]. It is sent at the next [`run`](Self::run).
    ///
    /// # Errors
    /// [`CallError::Refused`] for what [`Master::set_point`] refuses.
    fn set_point<C: SetPoint>(
        &mut self,
        motor: MotorId,
        command: C,
    ) -> Result<(), CallError<Self::Error>> {
        let now = self.now();
        self.master().set_point(motor, command, now).map_err(CallError::refused(motor))
    }

    /// As [`Runner::set_point_and_wait`](crate::io::Runner::set_point_and_wait).
    async fn set_point_and_wait<C: SetPoint>(
        &mut self,
        motor: MotorId,
        command: C,
    ) -> Result<C::Reply, CallError<Self::Error>> {
        self.set_point(motor, command)?;
        // Nobody else can use this loop while it waits, so this is the newest set-point.
        let waiting = OnDrop::new(self, |runner: &mut &mut Self| {
            runner.master().withdraw_set_point(motor);
        });
        loop {
            let event = waiting.it.next_event().await.map_err(CallError::Bus)?;
            if let Some(outcome) = outcome_of_set_point::<C, N>(waiting.it.master(), motor, &event)
            {
                waiting.end();
                return outcome.map_err(|failure| CallError::Failed { motor, failure });
            }
        }
    }

    /// As [`Runner::stop`](crate::io::Runner::stop). The stop is in force from the first poll of this future.
    #[must_use = "a motor that has not confirmed the stop may still move: cut its power"]
    async fn stop(&mut self, motor: MotorId, kind: StopKind) -> bool {
        self.master().stop(motor, kind).is_ok() && unconfirmed(self, motor.into()).await.is_empty()
    }

    /// As [`Runner::stop_all`](crate::io::Runner::stop_all). The stop is in force from the first poll of this future.
    /// If this future is dropped, any other future of this loop goes on with the stop.
    #[must_use = "those that have not confirmed the stop may still move: cut their power"]
    async fn stop_all(&mut self, kind: StopKind, also: MotorSet) -> MotorSet {
        // Motors that the master has no place for are not stopped, and stay unconfirmed.
        let _ = self.master().stop_all(kind, also);
        let motors = self.master().motors().with(also);
        unconfirmed(self, motors).await
    }
}

/// Runs the bus until each of these motors has confirmed its stop or has failed to. Returns those that have not
/// confirmed. Motors that have go on holding meanwhile.
async fn unconfirmed<R: AsyncRunner<N> + ?Sized, const N: usize>(
    runner: &mut R,
    motors: MotorSet,
) -> MotorSet {
    let mut elapsed = Elapsed::default();
    let mut confirmed = MotorSet::EMPTY;
    let waiting = KeptAlive::of_stop(runner).during(async |bus| {
        // Those whose stop was given up, and goes once more from time to time.
        let mut given_up = motors.without(bus.master().motors());
        loop {
            let now = bus.now();
            let master = bus.master();
            confirmed = confirmed.with(master.stops_confirmed());
            given_up = given_up.with(master.stops_given_up());
            let waiting = motors.without(confirmed).without(given_up);
            let look_again = match waiting.is_empty() {
                false => Elapsed::LOOK_AGAIN,
                true if master.is_stop_to_all_waiting() => RETRY_AFTER,
                true => break,
            };
            if elapsed.at(now) >= longest_stop(master, waiting, now) {
                break;
            }
            // An event may be the answer to a question, and an error of the bus may go.
            let _ = bus.run(Some(now + look_again)).await;
        }
    });
    waiting.await;
    motors.without(confirmed).without(runner.master().stops_confirmed())
}

/// Asks, and waits for the outcome of each question. If this future is dropped, the questions are withdrawn.
async fn ask_all<R: AsyncRunner<N> + ?Sized, C: Command, const M: usize, const N: usize>(
    runner: &mut R,
    questions: [(MotorId, C); M],
    patience: Option<Patience>,
    mut on_event: impl FnMut(Event),
) -> [Result<C::Reply, CallError<R::Error>>; M] {
    let askings = Askings::new(questions, patience, runner.now());
    let mut work = OnDrop::new((runner, askings), |(runner, askings): &mut (&mut R, _)| {
        Askings::withdraw(askings, runner.master());
    });
    let (runner, askings) = &mut work.it;
    loop {
        let now = runner.now();
        if !askings.put(runner.master(), now) {
            return askings.outcomes();
        }
        match runner.run(askings.next_turn(now)).await {
            Ok(Some(event)) if !askings.note(&event) => on_event(event),
            Ok(_) => {}
            Err(error) => askings.bus_has_failed(error),
        }
    }
}
