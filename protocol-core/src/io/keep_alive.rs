//! Speaks to all motors while a function works with one of them.
//!
//! The communication-loss protection (0xB3) is kept in a drive's ROM, so any motor may let go of its load once it has
//! heard nothing for a while. The caller puts no set-points while a function waits.

use crate::command::ReadRunTime;
use crate::io::async_runner::AsyncRunner;
use crate::io::runner::LONGEST_IDLE;
use crate::master::{Event, Failure, Master, MotorSet};
use crate::time::{Duration, Instant};

/// How long a motor may be sent nothing before it is asked. A function that works with a motor speaks to it as often.
const LONGEST_REST: Duration = Duration::from_millis(20);
/// The same for one that is silent. Its line may have been out for a moment, but on RS485 each question to a dead motor
/// takes a time-out.
const LONGEST_REST_OF_SILENT: Duration = Duration::from_millis(100);

/// A loop that asks motors that were sent nothing for a while, while something else is waited for. Their answers are
/// not needed, but a run time shows the master whether a motor has restarted, and no motor sends it as a report (0xB6).
pub(super) struct KeepAlive<'a, R: ?Sized> {
    runner: &'a mut R,
    motors: MotorSet,
    /// The motors that have a question.
    asked: MotorSet,
    /// The bus carries nothing: none is asked until then.
    rests_until: Instant,
}

impl<'a, R: ?Sized> KeepAlive<'a, R> {
    /// Asks these motors.
    pub(super) fn new(runner: &'a mut R, motors: MotorSet) -> Self {
        Self { runner, motors, asked: MotorSet::EMPTY, rests_until: Instant::ZERO }
    }

    /// Does this work. Then waits for the last answer, so that no motor is left busy.
    pub(super) async fn during<T, const N: usize>(
        mut self,
        work: impl AsyncFnOnce(&mut Self) -> T,
    ) -> T
    where
        R: AsyncRunner<N>,
    {
        let result = work(&mut self).await;
        while !self.asked.is_empty() {
            let soon = self.now() + LONGEST_IDLE;
            // Not longer than that: a load may fall that is to be looked at.
            match self.runner.run(Some(soon)).await {
                Ok(Some(event)) => drop(self.takes(&event)),
                Ok(None) => {}
                Err(_) => break,
            }
        }
        result
    }

    /// Asks them until this is so.
    pub(super) async fn until<const N: usize>(self, is_over: impl Fn() -> bool)
    where
        R: AsyncRunner<N>,
    {
        let asking = self.during(async |bus| {
            while !is_over() {
                let soon = bus.now() + LONGEST_IDLE;
                // What the bus has is for nobody, and an error of it ends nothing here.
                let _ = bus.run(Some(soon)).await;
            }
        });
        asking.await;
    }

    /// On RS485, asks one at a time, and none while something else waits for the line: a load may fall that is to be
    /// looked at.
    fn ask<const N: usize>(&mut self, now: Instant)
    where
        R: AsyncRunner<N>,
    {
        let master = self.runner.master();
        let most = match master.config().is_rs485() {
            true if master.has_something_to_send(now) => 0,
            true => 1,
            false => N,
        };
        let once = Some(master.patience(1));
        while self.asked.len() < most {
            let resting =
                master.longest_resting(self.motors, now, LONGEST_REST, LONGEST_REST_OF_SILENT);
            let Some(motor) = resting else { return };
            if master.put_request(motor, &ReadRunTime, once).is_err() {
                return;
            }
            self.asked.insert(motor);
        }
    }

    /// Whether a motor has answered its question, or failed to. Until then it takes no other.
    fn takes<const N: usize>(&mut self, event: &Event) -> bool
    where
        R: AsyncRunner<N>,
    {
        let (Event::Reply { ticket, .. } | Event::Failed { ticket, .. }) = event else {
            return false;
        };
        let is_asked = self.asked.contains(ticket.motor());
        self.asked.remove(ticket.motor());
        if let Event::Failed { failure: Failure::BusDown, .. } = event {
            self.rests_until = self.runner.now() + LONGEST_REST;
        }
        is_asked
    }

    /// An event that the master still has after an error of the bus, which may come back at each look.
    pub(super) fn poll_event<const N: usize>(&mut self) -> Option<Event>
    where
        R: AsyncRunner<N>,
    {
        loop {
            let event = self.runner.master().poll_event()?;
            if !self.takes(&event) {
                return Some(event);
            }
        }
    }
}

impl<R: AsyncRunner<N> + ?Sized, const N: usize> AsyncRunner<N> for KeepAlive<'_, R> {
    type Error = R::Error;

    fn master(&mut self) -> &mut Master<N> {
        self.runner.master()
    }

    fn now(&self) -> Instant {
        self.runner.now()
    }

    async fn run(&mut self, until: Option<Instant>) -> Result<Option<Event>, R::Error> {
        loop {
            let now = self.now();
            if self.rests_until <= now && until.is_none_or(|until| now < until) {
                self.ask(now);
            }
            let soon = now + LONGEST_IDLE;
            let wake_at = until.map_or(soon, |until| until.min(soon));
            let event = self.runner.run(Some(wake_at)).await?;
            let goes_on = match &event {
                Some(event) => self.takes(event),
                None => until.is_none_or(|until| self.now() < until),
            };
            if !goes_on {
                return Ok(event);
            }
        }
    }
}
