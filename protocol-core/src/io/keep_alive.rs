//! Speaks to all motors while a function works with one of them.
//!
//! The communication-loss protection (0xB3) is kept in a drive's ROM, so any motor may let go of its load once it has
//! heard nothing for a while. The caller puts no set-points while a function waits.

use embassy_futures::yield_now;

use crate::command::{ReadRunTime, ReadStatus1};
use crate::id::MotorId;
use crate::io::async_runner::AsyncRunner;
use crate::io::pump::RETRY_AFTER;
use crate::io::runner::LONGEST_IDLE;
use crate::master::{Event, Failure, Master, MotorSet, Patience};
use crate::time::{Duration, Instant};

/// How long a motor may be sent nothing before it is asked while a function waits, which speaks to its motor as often.
const LONGEST_REST: Duration = Duration::from_millis(20);
/// The same for one that is silent, on RS485 while anything but a stop waits for the line, and for as long as motors
/// hold. The line may have been out for a moment, but each question to a dead motor takes a time-out; a load may fall
/// that is to be looked at; and streams of others are not to be held up for long.
const LONGER_REST: Duration = Duration::from_millis(100);
/// A stop that takes no longer than this is over before anybody is asked.
const SHORT_STOP: Duration = Duration::from_millis(5);

/// Questions to motors that were sent nothing for a while, put by a loop that waits for something else: otherwise their
/// communication-loss protection (0xB3) would let their loads go. They are asked for their run time (0xB1), which shows
/// the master whether a motor has restarted; by [`new`](Self::new) also for their errors (0x9A).
///
/// The functions of this crate that wait do this. It is public for loops that wait in their own way: for a stop, as
/// here, for a person, or for another bus to be ready. A motor whose answer is awaited takes no other request: go on
/// until [`is_waiting`](Self::is_waiting) is false.
///
/// ```
/// use myactuator_protocol_core::io::{KeepAlive, Runner, longest_stop};
/// use myactuator_protocol_core::master::{Event, MotorSet, StopKind};
/// use myactuator_protocol_core::time::Duration;
///
/// /// Stops all motors. Returns those that have not confirmed it: cut their power.
/// fn stop<R: Runner<8>>(bus: &mut R) -> Result<MotorSet, R::Error> {
///     // Nobody was named for whom there is no place.
///     let _ = bus.master().stop_all(StopKind::Hold, MotorSet::EMPTY);
///     let (mut stopping, mut unconfirmed) = (bus.master().motors(), MotorSet::EMPTY);
///     let begun = bus.now();
///     let mut keep_alive = KeepAlive::of_stop(begun);
///     while !stopping.is_empty() {
///         let now = bus.now();
///         if now - begun >= longest_stop(bus.master(), stopping, now) {
///             break;
///         }
///         keep_alive.ask(MotorSet::ALL, bus.master(), now);
///         match bus.poll()? {
///             Some(event) if keep_alive.takes(&event, now) => {}
///             Some(Event::StopConfirmed { motor }) => stopping.remove(motor),
///             Some(Event::StopUnconfirmed { motor }) => {
///                 stopping.remove(motor);
///                 unconfirmed.insert(motor);
///             }
///             Some(_) => {}
///             None => bus.idle(now + Duration::from_millis(1)),
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
    waits_for: WaitsFor,
}

/// What the loop waits for.
#[derive(Clone, Copy, Debug)]
enum WaitsFor {
    /// A function, whose caller wants to know nothing of other motors but whether they have restarted.
    Function,
    /// A stop, which is to be reported soon: no answer is waited for longer than for a stop's confirmation.
    Stop,
    /// Anything: motors hold meanwhile. Each is asked for its run time and its errors in turn.
    Anything { errors_next: MotorSet },
}

impl Default for KeepAlive {
    fn default() -> Self {
        Self::new()
    }
}

impl KeepAlive {
    /// For motors that hold, for as long as they do: asks each that was sent nothing for 100 ms.
    pub const fn new() -> Self {
        let errors_next = MotorSet::EMPTY;
        Self::while_waiting_for(WaitsFor::Anything { errors_next }, Instant::ZERO)
    }

    const fn while_waiting_for(waits_for: WaitsFor, rests_until: Instant) -> Self {
        Self { asked: MotorSet::EMPTY, rests_until, waits_for }
    }

    /// For the time in which a stop waits that was called now: asks each that was sent nothing for 20 ms. A stop that
    /// is soon over leaves no motor busy: nobody is asked in its first 5 ms.
    pub fn of_stop(now: Instant) -> Self {
        Self::while_waiting_for(WaitsFor::Stop, now + SHORT_STOP)
    }

    /// Asks those of these motors that were sent nothing for that long, or for 100 ms if they are silent. On RS485,
    /// asks one at a time, and after 100 ms while anything but a stop waits for the line. So call this at least every
    /// five milliseconds or so.
    ///
    /// If a motor may have let go that a stop in force is to hold, it is told again. Then there is another
    /// [`StopConfirmed`](Event::StopConfirmed), or [`StopUnconfirmed`](Event::StopUnconfirmed). That is so when it is
    /// heard after a silence of more than 250 ms in which it was asked, or after a long pause in which nobody spoke to
    /// it; when it has restarted; and when it says that it has lost its master. The same holds without a stop in force
    /// for a motor that has confirmed a hold (0x81), if nothing has ended that since, as far as is known: no move, no
    /// release or lock of its brake, no shutdown and no restart, by this master or by another that is heard. A motor of
    /// which the caller wants something is left alone then. A motor that holds because it has arrived somewhere is not
    /// told again.
    ///
    /// Until a motor that is told again has answered, requests to it are refused as busy, and set-points wait.
    pub fn ask<const N: usize>(&mut self, motors: MotorSet, master: &mut Master<N>, now: Instant) {
        if now < self.rests_until {
            return;
        }
        master.hold_again(motors);
        let is_line = master.config().is_rs485();
        let rest = match self.waits_for {
            WaitsFor::Anything { .. } => LONGER_REST,
            _ if is_line && master.sends_more_than_stops(now) => LONGER_REST,
            WaitsFor::Function | WaitsFor::Stop => LONGEST_REST,
        };
        let once = match self.waits_for {
            WaitsFor::Stop => Patience { reply_timeout: master.stop_timeout(), attempts: 1 },
            WaitsFor::Function | WaitsFor::Anything { .. } => master.patience(1),
        };
        let most = if is_line { 1 } else { N };
        while self.asked.len() < most {
            let resting = master.longest_resting(motors, now, rest, LONGER_REST);
            let Some(motor) = resting else { return };
            let is_put = match self.is_turn_of_errors(motor) {
                true => master.put_request(motor, &ReadStatus1, Some(once)).is_ok(),
                false => master.put_request(motor, &ReadRunTime, Some(once)).is_ok(),
            };
            if !is_put {
                return;
            }
            self.asked.insert(motor);
        }
    }

    /// Whether this motor is to be asked for its errors; then it is the run time's turn.
    fn is_turn_of_errors(&mut self, motor: MotorId) -> bool {
        let WaitsFor::Anything { errors_next } = &mut self.waits_for else { return false };
        let is_turn = errors_next.contains(motor);
        if is_turn {
            errors_next.remove(motor)
        } else {
            errors_next.insert(motor)
        }
        is_turn
    }

    /// Whether this is the outcome of one of its questions, and so for nobody else, except for errors in a status
    /// (0x9A). A motor that has one takes no other request.
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
        let questions = KeepAlive::while_waiting_for(WaitsFor::Function, Instant::ZERO);
        Self { runner, motors, questions }
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
