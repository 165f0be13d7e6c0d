//! Loops that poll, for what is written for tasks. The ways of working are.

use embassy_futures::yield_now;

use crate::io::async_runner::AsyncRunner;
use crate::io::pump::RETRY_AFTER;
use crate::io::runner::{LONGEST_IDLE, Runner};
use crate::master::{Event, Master};
use crate::time::Instant;

/// A loop that polls, as one for tasks: code that is written for an [`AsyncRunner`] runs on it, too, for example on the
/// buses of a Linux host.
///
/// Where a task would wait, this lets the loop's clock idle, which holds up the thread for up to 10 ms. So give each bus
/// a thread of its own. Nothing has to wake the future: any executor runs it that polls it again at once, as
/// `embassy_futures::block_on` does.
///
/// ```no_run
/// use embassy_futures::block_on;
/// use myactuator_protocol_core::MotorId;
/// use myactuator_protocol_core::command::ReadMultiTurnAngle;
/// use myactuator_protocol_core::io::{AsyncRunner, CallError, Polled, Runner};
/// use myactuator_protocol_core::units::Angle;
///
/// /// For a microcontroller's task.
/// async fn where_is<R: AsyncRunner<8>>(
///     bus: &mut R,
///     motor: MotorId,
/// ) -> Result<Angle, CallError<R::Error>> {
///     Ok(bus.ask(motor, ReadMultiTurnAngle).await?.angle)
/// }
///
/// /// The same on any loop that polls.
/// fn look<R: Runner<8>>(bus: &mut R) -> Result<Angle, CallError<R::Error>> {
///     block_on(where_is(&mut Polled(bus), MotorId::MIN))
/// }
/// ```
#[derive(Debug)]
pub struct Polled<'a, R: ?Sized>(pub &'a mut R);

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
