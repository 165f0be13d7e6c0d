//! Speaks to all motors while a function works with one of them.
//!
//! The communication-loss protection (0xB3) is kept in a drive's ROM, so any motor may let go of its load once it has
//! heard nothing for a while. The caller puts no set-points while a function waits.

use crate::command::ReadRunTime;
use crate::id::MotorId;
use crate::io::async_runner::AsyncRunner;
use crate::io::runner::LONGEST_IDLE;
use crate::master::{Event, Master, MotorSet};
use crate::time::{Duration, Instant};

/// How long a motor may be sent nothing before it is asked. A function that works with a motor speaks to it as often.
const LONGEST_REST: Duration = Duration::from_millis(20);

/// A loop that asks motors that were sent nothing for a while, while something else is waited for. Their answers are
/// not needed, but a run time shows the master whether a motor has restarted, and no motor sends it as a report (0xB6).
pub(super) struct KeepAlive<'a, R: ?Sized> {
    runner: &'a mut R,
    motors: MotorSet,
    /// The motors that have a question.
    asked: MotorSet,
}

impl<'a, R: ?Sized> KeepAlive<'a, R> {
    /// Asks these motors.
    pub(super) fn new(runner: &'a mut R, motors: MotorSet) -> Self {
        Self { runner, motors, asked: MotorSet::EMPTY }
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
        self.motors = MotorSet::EMPTY;
        while !self.asked.is_empty() {
            let soon = self.now() + LONGEST_IDLE;
            if self.run(Some(soon)).await.is_err() {
                break;
            }
        }
        result
    }

    /// On RS485, asks one at a time: what is waited for, such as a look at a load that may fall, waits for their
    /// answers.
    fn ask<const N: usize>(&mut self, now: Instant)
    where
        R: AsyncRunner<N>,
    {
        let master = self.runner.master();
        let most = if master.config().is_rs485() { 1 } else { N };
        let once = Some(master.patience(1));
        while self.asked.len() < most {
            let resting = master.longest_resting(self.motors, now, LONGEST_REST);
            let Some(motor) = resting else { return };
            if master.put_request(motor, &ReadRunTime, once).is_err() {
                return;
            }
            self.asked.insert(motor);
        }
    }

    /// The motor that has answered its question, or failed to. Until then it takes no other.
    fn answered(&self, event: &Event) -> Option<MotorId> {
        let (Event::Reply { ticket, .. } | Event::Failed { ticket, .. }) = event else {
            return None;
        };
        Some(ticket.motor()).filter(|motor| self.asked.contains(*motor))
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
            if until.is_none_or(|until| now < until) {
                self.ask(now);
            }
            let soon = now + LONGEST_IDLE;
            let wake_at = until.map_or(soon, |until| until.min(soon));
            let event = self.runner.run(Some(wake_at)).await?;
            match event.as_ref().and_then(|event| self.answered(event)) {
                Some(motor) => self.asked.remove(motor),
                None if event.is_none() && until.is_none_or(|until| self.now() < until) => {}
                None => return Ok(event),
            }
        }
    }
}
