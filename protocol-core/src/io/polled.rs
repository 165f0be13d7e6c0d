//! Ways of working are written once, for tasks. Loops that poll run them through this.

use embassy_futures::yield_now;

use crate::io::async_runner::AsyncRunner;
use crate::io::pump::RETRY_AFTER;
use crate::io::runner::{LONGEST_IDLE, Runner};
use crate::master::{Event, Master};
use crate::time::Instant;

/// A loop that polls, as one for tasks: where a task would wait, it lets its clock idle.
pub(super) struct Polled<'a, R: ?Sized>(pub(super) &'a mut R);

impl<R: Runner<N> + ?Sized, const N: usize> AsyncRunner<N> for Polled<'_, R> {
    type Error = R::Error;

    fn master(&mut self) -> &mut Master<N> {
        self.0.master()
    }

    fn now(&self) -> Instant {
        self.0.now()
    }

    async fn run(&mut self, until: Option<Instant>) -> Result<Option<Event>, R::Error> {
        loop {
            let event = self.0.poll();
            let now = self.0.now();
            match event {
                Ok(None) if until.is_none_or(|until| now < until) => {}
                Ok(event) => return Ok(event),
                Err(error) => {
                    idle(self.0, now + RETRY_AFTER).await;
                    return Err(error);
                }
            }
            let latest = now + LONGEST_IDLE;
            idle(self.0, until.map_or(latest, |until| until.min(latest))).await;
        }
    }
}

/// Lets other loops of this thread send before this one idles.
async fn idle<R: Runner<N> + ?Sized, const N: usize>(runner: &mut R, until: Instant) {
    yield_now().await;
    runner.idle(until);
}
