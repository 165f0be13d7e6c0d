//! Stops all motors, however a control loop is left.

use core::cell::Cell;
use core::ops::{Deref, DerefMut};

use embassy_futures::block_on;
use embassy_futures::join::join_array;

use crate::io::async_runner::AsyncRunner;
use crate::io::keep_alive::KeptAlive;
use crate::io::on_drop::OnDrop;
use crate::io::polled::Polled;
use crate::io::runner::Runner;
use crate::master::{Event, Master, MotorSet, StopKind};
use crate::time::Instant;

/// A loop that stops all motors when it is left: by `?`, `break`, `return`, a panic that unwinds, or at its end. It is
/// a [`Runner`] itself.
///
/// ```no_run
/// # use myactuator_protocol_core::command::{RawMotion, ReadMultiTurnAngle};
/// # use myactuator_protocol_core::io::{Guard, Runner};
/// # use myactuator_protocol_core::{MotorId, master::StopKind};
/// # fn control<R: Runner<8>>(bus: &mut R, motor: MotorId) -> Result<(), Box<dyn std::error::Error>>
/// # where R::Error: 'static {
/// let mut bus = Guard::new(bus, StopKind::Hold);
/// loop {
///     let angle = bus.ask(motor, ReadMultiTurnAngle).map_err(|error| error.to_string())?.angle;
///     if angle.degrees() > 90.0 {
///         break;
///     }
/// }
/// let unconfirmed = bus.finish();
/// assert!(unconfirmed.is_empty(), "cut the power of motors {unconfirmed}");
/// # Ok(()) }
/// ```
///
/// The motors are [those that have a place](crate::master::Master::motors): each that was asked, moved or
/// [found](crate::io::bring_up::scan), or that a [broadcast](crate::master::Master::broadcast) was expected to move.
///
/// The guard waits for them as long as [a stop](crate::io::longest_stop) is tried. With one guard for each of two buses
/// in one thread, the second bus is stopped only after that if the first is cut; [`Guards`] stop several at the same
/// time.
///
/// If the watchdog of your firmware does not wait that long, stop the motors [without waiting](Runner::stop_all).
///
/// **A motor that has not confirmed may obey a frame that still lies in a controller** when the motor's power or cable
/// comes back. Cut the motor's power. Before that power comes back, go on running the bus with the stop in force, or
/// reset the controller (Linux: `ip link set can0 down`).
///
/// The guard cannot stop the motors if it is never dropped: in a program that is killed, aborts, calls `exit`, is
/// ended by a signal (Ctrl-C) that it does not handle, or returns from `main` while the guard lives in another thread.
/// For those cases set the motors' communication-loss protection (0xB3). It switches a motor off when nobody speaks to
/// it any more, even one that a stop holds.
#[derive(Debug)]
#[must_use = "the motors are stopped when it is dropped"]
pub struct Guard<'a, R: Runner<N>, const N: usize> {
    bus: &'a mut R,
    kind: StopKind,
}

impl<'a, R: Runner<N>, const N: usize> Guard<'a, R, N> {
    /// Guards this loop.
    pub const fn new(bus: &'a mut R, kind: StopKind) -> Self {
        Self { bus, kind }
    }

    /// Stops all motors now and returns those that have not confirmed: **cut their power**.
    #[must_use = "those that have not confirmed the stop may still move: cut their power"]
    pub fn finish(self) -> MotorSet {
        let mut guard = core::mem::ManuallyDrop::new(self);
        let kind = guard.kind;
        guard.bus.stop_all(kind, MotorSet::EMPTY)
    }
}

impl<R: Runner<N>, const N: usize> Drop for Guard<'_, R, N> {
    /// To learn which motors have not confirmed, call [`finish`](Self::finish).
    fn drop(&mut self) {
        let _unconfirmed = self.bus.stop_all(self.kind, MotorSet::EMPTY);
    }
}

impl<R: Runner<N>, const N: usize> Runner<N> for Guard<'_, R, N> {
    type Error = R::Error;

    fn master(&mut self) -> &mut Master<N> {
        self.bus.master()
    }

    fn now(&self) -> Instant {
        self.bus.now()
    }

    fn poll(&mut self) -> Result<Option<Event>, R::Error> {
        self.bus.poll()
    }

    fn idle(&mut self, until: Instant) {
        self.bus.idle(until);
    }
}

/// Several loops whose motors are all stopped when they are left, as by a [`Guard`] of each, but at the same time.
///
/// - A bus that is cut does not delay the others, whose motors go on holding meanwhile. A driver that blocks its loop
///   does, such as a serial port that takes nothing: name it last, or give it a thread.
/// - `Guards` are used as the array of the loops. A loop that is swapped for another is no longer guarded.
///
/// A bus sends only while it is run. So in each cycle let all loops send before any of them waits; otherwise all but
/// the first are a cycle late. RS485 lines of several motors, which carry one exchange at a time, need a thread or a
/// task each.
///
/// ```no_run
/// # use myactuator_protocol_core::command::Torque;
/// # use myactuator_protocol_core::io::{CallError, Guards, Runner};
/// # use myactuator_protocol_core::{MotorId, master::StopKind, time::Duration};
/// # fn walk<R: Runner<4>>(legs: [&mut R; 3], motor: MotorId, torque: Torque) -> Result<(), CallError<R::Error>> {
/// let mut legs = Guards::new(legs, [StopKind::Hold; 3]);
/// // A cycle. Each has its own clock.
/// let next = legs.each_ref().map(|leg| leg.now() + Duration::from_millis(2));
/// for leg in legs.iter_mut() {
///     leg.set_point(motor, torque)?;
///     let now = leg.now();
///     leg.run_until(now, |_event| {})?;
/// }
/// // The first waits, and the others hear what has come meanwhile.
/// for (leg, next) in legs.iter_mut().zip(next) {
///     leg.run_until(next, |_event| {})?;
/// }
/// for (leg, unconfirmed) in legs.finish().into_iter().enumerate() {
///     assert!(unconfirmed.is_empty(), "cut the power of motors {unconfirmed} of leg {leg}");
/// }
/// # Ok(()) }
/// ```
#[derive(Debug)]
#[must_use = "the motors are stopped when they are dropped"]
pub struct Guards<'a, R: Runner<N>, const M: usize, const N: usize> {
    buses: [&'a mut R; M],
    kinds: [StopKind; M],
}

impl<'a, R: Runner<N>, const M: usize, const N: usize> Guards<'a, R, M, N> {
    /// Guards these loops, each of which has its own kind of stop: an arm is held, and its gripper let go, for example.
    pub const fn new(buses: [&'a mut R; M], kinds: [StopKind; M]) -> Self {
        Self { buses, kinds }
    }

    /// Stops all motors of all buses now and returns, for each bus, those that have not confirmed: **cut their power**.
    #[must_use = "those that have not confirmed the stop may still move: cut their power"]
    pub fn finish(self) -> [MotorSet; M] {
        core::mem::ManuallyDrop::new(self).stop()
    }

    fn stop(&mut self) -> [MotorSet; M] {
        // There is one for each bus.
        let mut kinds = self.kinds.into_iter();
        // In force on every bus before any driver is used, because a driver may panic.
        let buses = self.buses.each_mut().map(|bus| {
            let kind = kinds.next().unwrap_or(StopKind::Hold);
            let _ = bus.master().stop_all(kind, MotorSet::EMPTY);
            (bus, kind)
        });
        let stopping = Cell::new(M);
        let is_over = || stopping.get() == 0;
        block_on(join_array(buses.map(async |(bus, kind): (&mut &mut R, StopKind)| {
            let mut bus = Polled(&mut **bus);
            let unconfirmed = bus.stop_all(kind, MotorSet::EMPTY).await;
            stopping.set(stopping.get() - 1);
            // Its motors go on holding while another bus is waited for.
            KeptAlive::of_stop(&mut bus).until(is_over).await;
            unconfirmed
        })))
    }
}

impl<R: Runner<N>, const M: usize, const N: usize> Drop for Guards<'_, R, M, N> {
    /// To learn which motors have not confirmed, call [`finish`](Self::finish).
    fn drop(&mut self) {
        let _unconfirmed = self.stop();
    }
}

impl<'a, R: Runner<N>, const M: usize, const N: usize> Deref for Guards<'a, R, M, N> {
    type Target = [&'a mut R; M];

    fn deref(&self) -> &[&'a mut R; M] {
        &self.buses
    }
}

impl<R: Runner<N>, const M: usize, const N: usize> DerefMut for Guards<'_, R, M, N> {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.buses
    }
}

/// Runs `work` on an async loop and then stops all motors, however it ends. Returns the result of `work` and the motors
/// that have not confirmed the stop: **cut their power**.
///
/// If this future is dropped halfway, or left by a panic that unwinds, it can neither wait nor send any more. The stop
/// is then in force, and is the first thing that any other future of this loop sends. **Until one runs, the motors go
/// on**: call [`stop_all`](AsyncRunner::stop_all) afterwards, which also returns those that have not confirmed.
///
/// ```no_run
/// # use myactuator_protocol_core::io::{AsyncRunner, guarded};
/// # use myactuator_protocol_core::master::{MotorSet, StopKind};
/// use embassy_futures::select::{Either, select};
///
/// # async fn work<R: AsyncRunner<8>>(_: &mut R) {}
/// # async fn button() {}
/// # async fn task<R: AsyncRunner<8>>(mut bus: R) -> MotorSet {
/// let working = guarded(&mut bus, StopKind::Hold, async |bus| work(bus).await);
/// match select(working, button()).await {
///     Either::First((_, unconfirmed)) => unconfirmed,
///     // `working` was dropped: this sends the stop.
///     Either::Second(()) => bus.stop_all(StopKind::Hold, MotorSet::EMPTY).await,
/// }
/// # }
/// ```
pub async fn guarded<R: AsyncRunner<N>, T, const N: usize>(
    bus: &mut R,
    kind: StopKind,
    work: impl AsyncFnOnce(&mut R) -> T,
) -> (T, MotorSet) {
    let working = OnDrop::new(bus, |bus: &mut &mut R| {
        // `also` is empty, so every motor to be stopped has a place.
        let _ = bus.master().stop_all(kind, MotorSet::EMPTY);
    });
    let result = work(working.it).await;
    let unconfirmed = working.it.stop_all(kind, MotorSet::EMPTY).await;
    working.end();
    (result, unconfirmed)
}
