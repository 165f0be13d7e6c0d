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
/// The same for one that is silent, and on RS485 while anything but a stop waits for the line. The line may have been out
/// for a moment, but each question to a dead motor takes a time-out; and a load may fall that is to be looked at.
const LONGER_REST: Duration = Duration::from_millis(100);
/// A stop that takes no longer than this is over before anybody is asked.
const SHORT_STOP: Duration = Duration::from_millis(5);

/// Questions to motors that were sent nothing for a while, put by a loop that waits for something else: otherwise their
/// communication-loss protection (0xB3) would let their loads go. Their answers are not needed, but a run time shows
/// the master whether a motor has restarted, and no motor sends it as a report (0xB6).
///
/// The functions of this crate that wait do this. It is public for loops that wait for a stop in their own way.
///
/// ```
/// use myactuator_protocol_core::io::{KeepAlive, LONGEST_STOP, Runner};
/// use myactuator_protocol_core::master::{Event, MotorSet, StopKind};
///
/// /// Stops all motors. Returns those that have not confirmed it: cut their power.
/// fn stop<R: Runner<8>>(bus: &mut R) -> Result<MotorSet, R::Error> {
///     // Nobody was named for whom there is no place.
///     let _ = bus.master().stop_all(StopKind::Hold, MotorSet::EMPTY);
///     let (mut stopping, mut unconfirmed) = (bus.master().motors(), MotorSet::EMPTY);
///     let begun = bus.now();
///     let mut keep_alive = KeepAlive::of_stop(begun);
///     while !stopping.is_empty() && bus.now() - begun < LONGEST_STOP {
///         let now = bus.now();
///         keep_alive.ask(MotorSet::ALL, bus.master(), now);
///         match bus.poll()? {
///             Some(event) if keep_alive.takes(&event, now) => {}
///             Some(Event::StopConfirmed { motor }) => stopping.remove(motor),
///             Some(Event::StopUnconfirmed { motor }) => {
///                 stopping.remove(motor);
///                 unconfirmed.insert(motor);
///             }
///             _ => {}
///         }
///     }
///     Ok(unconfirmed.with(stopping))
/// }
/// ```
#[derive(Clone, Copy, Debug)]
pub struct KeepAlive {
    /// The motors that have a question.
    asked: MotorSet,
    /// None is asked until then: a stop has just begun, or the bus carries nothing.
    rests_until: Instant,
    /// A stop waits, and is to be reported soon: no answer is waited for longer than for a stop's confirmation.
    is_stopping: bool,
}

impl KeepAlive {
    const NEW: Self =
        Self { asked: MotorSet::EMPTY, rests_until: Instant::ZERO, is_stopping: false };

    /// For the time in which a stop waits that was called now. A stop that is soon over leaves no motor busy: nobody is
    /// asked in its first 5 ms.
    pub fn of_stop(now: Instant) -> Self {
        Self { rests_until: now + SHORT_STOP, is_stopping: true, ..Self::NEW }
    }

    /// Asks those of these motors that were sent nothing for 20 ms, or for 100 ms if they are silent. On RS485, asks
    /// one at a time, also after 100 ms while anything but a stop waits for the line.
    pub fn ask<const N: usize>(&mut self, motors: MotorSet, master: &mut Master<N>, now: Instant) {
        if now < self.rests_until {
            return;
        }
        let (most, rest) = match master.config().is_rs485() {
            true if master.sends_more_than_stops(now) => (1, LONGER_REST),
            true => (1, LONGEST_REST),
            false => (N, LONGEST_REST),
        };
        let once = match self.is_stopping {
            true => Patience { reply_timeout: master.stop_timeout(), attempts: 1 },
            false => master.patience(1),
        };
        while self.asked.len() < most {
            let resting = master.longest_resting(motors, now, rest, LONGER_REST);
            let Some(motor) = resting else { return };
            if master.put_request(motor, &ReadRunTime, Some(once)).is_err() {
                return;
            }
            self.asked.insert(motor);
        }
    }

    /// Whether this is the outcome of one of its questions, and so for nobody else. A motor that has one takes no other
    /// request.
    pub fn takes(&mut self, event: &Event, now: Instant) -> bool {
        let (Event::Reply { ticket, .. } | Event::Failed { ticket, .. }) = event else {
            return false;
        };
        let is_asked = self.asked.contains(ticket.motor());
        self.asked.remove(ticket.motor());
        if let Event::Failed { failure: Failure::BusDown, .. } = event {
            self.rest(now);
        }
        is_asked
    }

    /// Whether the outcome of a question is still to come.
    pub fn is_waiting(&self) -> bool {
        !self.asked.is_empty()
    }

    /// The bus carries nothing.
    fn rest(&mut self, now: Instant) {
        self.rests_until = now + LONGEST_REST;
    }
}

/// A loop that [keeps motors alive](KeepAlive) while something else is waited for.
pub(super) struct KeptAlive<'a, R: ?Sized> {
    runner: &'a mut R,
    motors: MotorSet,
    questions: KeepAlive,
}

impl<'a, R: ?Sized> KeptAlive<'a, R> {
    /// Asks these motors.
    pub(super) fn new(runner: &'a mut R, motors: MotorSet) -> Self {
        Self { runner, motors, questions: KeepAlive::NEW }
    }

    /// Asks all motors while a stop waits.
    pub(super) fn of_stop<const N: usize>(runner: &'a mut R) -> Self
    where
        R: AsyncRunner<N>,
    {
        let questions = KeepAlive::of_stop(runner.now());
        Self { runner, motors: MotorSet::ALL, questions }
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
        while self.questions.is_waiting() {
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
                if bus.questions.rests_until <= now {
                    bus.ask(now);
                    // What the bus has is for nobody. After an error it would idle.
                    if bus.run(Some(now)).await.is_err() {
                        bus.questions.rest(now);
                    }
                }
                yield_now().await;
            }
        });
        asking.await;
    }

    fn ask<const N: usize>(&mut self, now: Instant)
    where
        R: AsyncRunner<N>,
    {
        self.questions.ask(self.motors, self.runner.master(), now);
    }

    fn takes<const N: usize>(&mut self, event: &Event) -> bool
    where
        R: AsyncRunner<N>,
    {
        self.questions.takes(event, self.runner.now())
    }
}

impl<R: AsyncRunner<N> + ?Sized, const N: usize> AsyncRunner<N> for KeptAlive<'_, R> {
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
