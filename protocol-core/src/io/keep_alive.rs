//! Speaks to all motors while a function works with one of them.
//!
//! The communication-loss protection (0xB3) is kept in a drive's ROM, so any motor may let go of its load once it has
//! heard nothing for a while. The caller puts no set-points while a function waits.

use embassy_futures::yield_now;

use crate::command::ReadRunTime;
use crate::io::async_runner::AsyncRunner;
use crate::io::pump::RETRY_AFTER;
use crate::io::runner::LONGEST_IDLE;
use crate::master::{Event, Failure, Master, MotorSet, Patience};
use crate::time::{Duration, Instant};

/// How long a motor may be sent nothing before it is asked. A function that works with a motor speaks to it as often.
const LONGEST_REST: Duration = Duration::from_millis(20);
/// The same for one that is silent. Its line may have been out for a moment, but on RS485 each question to a dead motor
/// takes a time-out.
const LONGEST_REST_OF_SILENT: Duration = Duration::from_millis(100);
/// A stop that takes no longer than this is over before anybody is asked.
const SHORT_STOP: Duration = Duration::from_millis(5);

/// A loop that asks motors that were sent nothing for a while, while something else is waited for. Their answers are
/// not needed, but a run time shows the master whether a motor has restarted, and no motor sends it as a report (0xB6).
pub(super) struct KeepAlive<'a, R: ?Sized> {
    runner: &'a mut R,
    motors: MotorSet,
    /// The motors that have a question.
    asked: MotorSet,
    /// None is asked until then: a stop has just begun, or the bus carries nothing.
    rests_until: Instant,
    /// A stop waits, and is to be reported soon: no answer is waited for longer than for a stop's confirmation.
    is_stopping: bool,
}

impl<'a, R: ?Sized> KeepAlive<'a, R> {
    /// Asks these motors.
    pub(super) fn new(runner: &'a mut R, motors: MotorSet) -> Self {
        let (asked, rests_until) = (MotorSet::EMPTY, Instant::ZERO);
        Self { runner, motors, asked, rests_until, is_stopping: false }
    }

    /// Asks all motors while a stop waits.
    pub(super) fn of_stop<const N: usize>(runner: &'a mut R) -> Self
    where
        R: AsyncRunner<N>,
    {
        let rests_until = runner.now() + SHORT_STOP;
        let all = Self::new(runner, MotorSet::ALL);
        Self { rests_until, is_stopping: true, ..all }
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
            let soon = self.now() + RETRY_AFTER;
            // Not longer than that: a load may fall that is to be looked at, or another bus be stopped.
            match self.runner.run(Some(soon)).await {
                Ok(Some(event)) => drop(self.takes(&event)),
                Ok(None) => {}
                Err(_) => break,
            }
        }
        result
    }

    /// Asks them until this is so. Never idles: other buses of this thread are still being stopped.
    pub(super) async fn until<const N: usize>(self, is_over: impl Fn() -> bool)
    where
        R: AsyncRunner<N>,
    {
        let asking = self.during(async |bus| {
            while !is_over() {
                let now = bus.now();
                if bus.rests_until <= now {
                    bus.ask(now);
                    // What the bus has is for nobody. After an error it would idle.
                    if bus.run(Some(now)).await.is_err() {
                        bus.rests_until = now + LONGEST_REST;
                    }
                }
                yield_now().await;
            }
        });
        asking.await;
    }

    /// On RS485, asks one at a time, and none while anything else but a stop waits for the line: a load may fall that
    /// is to be looked at.
    fn ask<const N: usize>(&mut self, now: Instant)
    where
        R: AsyncRunner<N>,
    {
        let master = self.runner.master();
        let most = match master.config().is_rs485() {
            true if master.sends_more_than_stops(now) => 0,
            true => 1,
            false => N,
        };
        let once = match self.is_stopping {
            true => Patience { reply_timeout: master.stop_timeout(), attempts: 1 },
            false => master.patience(1),
        };
        while self.asked.len() < most {
            let resting =
                master.longest_resting(self.motors, now, LONGEST_REST, LONGEST_REST_OF_SILENT);
            let Some(motor) = resting else { return };
            if master.put_request(motor, &ReadRunTime, Some(once)).is_err() {
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
