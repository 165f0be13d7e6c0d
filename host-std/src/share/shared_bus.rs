//! The handle.

use std::fmt;
use std::sync::{Arc, Weak};
use std::thread::{self, JoinHandle};

use myactuator_protocol_core::command::SetPoint;
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::master::{Failure, MotorSet, Patience, StopKind};
use myactuator_protocol_core::{Command, Data, MotorId};

use super::calls::{Awaited, Insistence, Order, Untyped};
use super::desk::Desk;
use super::past::Past;
use super::state::Latest;
use super::{SharedBusError, Subscription, Watch, worker};
use crate::open::{AnyMaster, BusAddress, BusError, Wake};

/// As many motors as the protocol has ids for.
const MOTORS: usize = MotorId::COUNT;

/// A handle of a bus that a thread of its own runs; see [the module](super). Clones share the bus. When the last one is
/// dropped, all motors are stopped; the drop waits for that and ends the thread.
///
/// A call waits only for the bus. A question of another caller does not delay it, unless it is to the same motor.
pub struct SharedBus<E = BusError>(Arc<Running<E>>);

/// A handle that does not keep the bus running, for a thread that watches it. A thread that loops over a
/// [`Subscription`] while it holds a [`SharedBus`] would never see the end.
pub struct WeakBus<E = BusError>(Weak<Running<E>>);

impl<E> WeakBus<E> {
    /// A handle, unless the last one was dropped.
    pub fn upgrade(&self) -> Option<SharedBus<E>> {
        self.0.upgrade().map(SharedBus)
    }
}

impl<E> Clone for WeakBus<E> {
    fn clone(&self) -> Self {
        Self(Weak::clone(&self.0))
    }
}

impl<E> fmt::Debug for WeakBus<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("WeakBus").finish_non_exhaustive()
    }
}

/// A stop of all motors that is under way; see [`SharedBus::begin_stop_all`]. If this is dropped, the stop goes on.
/// This is no handle: if the bus has ended meanwhile, waiting for the stop says so.
#[must_use = "those that have not confirmed the stop may still move: cut their power"]
pub struct Stopping<E = BusError> {
    desk: Arc<Desk<E>>,
    stop: Awaited<MotorSet, E>,
}

impl<E> Stopping<E> {
    /// Waits for it, as [`SharedBus::stop_all`] does.
    ///
    /// # Errors
    /// As there.
    pub fn wait(self) -> Result<MotorSet, SharedBusError<E>> {
        self.desk.wait_for_stop(self.stop, MotorSet::ALL)
    }
}

impl<E> fmt::Debug for Stopping<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Stopping").finish_non_exhaustive()
    }
}

/// The thread, for as long as there is a handle.
struct Running<E> {
    desk: Arc<Desk<E>>,
    thread: Option<JoinHandle<()>>,
}

impl<E> Drop for Running<E> {
    fn drop(&mut self) {
        self.desk.close();
        // A thread that its driver holds is not waited for: it stops the motors when the driver returns.
        if let Some(thread) = self.thread.take_if(|thread| self.desk.wait_for_end(thread)) {
            // Its panics were caught, and reported.
            let _ = thread.join();
        }
    }
}

impl<E> Clone for SharedBus<E> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<E> fmt::Debug for SharedBus<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SharedBus").finish_non_exhaustive()
    }
}

impl SharedBus {
    /// Opens the bus that `address` names, for up to 32 motors; a simulated bus runs in real time. When the bus ends,
    /// its motors are stopped as `at_end` says.
    ///
    /// # Errors
    /// [`BusError`] says why it cannot be opened, and what to do.
    ///
    /// # Panics
    /// If the operating system has no thread left.
    pub fn open(address: &BusAddress, at_end: StopKind) -> Result<Self, BusError> {
        let (master, wake) = AnyMaster::<MOTORS>::open_shared(address)?;
        Ok(Self::run(master, Some(wake), at_end))
    }
}

impl<E: fmt::Debug + Send + Sync + 'static> SharedBus<E> {
    /// Runs this loop in a thread. When the bus ends, its motors are stopped as `at_end` says.
    ///
    /// The loop's clock cannot be woken, so it takes up to 1 ms until the loop sees a call, unless a
    /// frame comes first; [`with_wake`](Self::with_wake) avoids that. A simulated bus in virtual time
    /// goes on while a call waits for its answer, and stands still otherwise.
    ///
    /// # Panics
    /// If the operating system has no thread left.
    pub fn new<R, const N: usize>(runner: R, at_end: StopKind) -> Self
    where
        R: Runner<N, Error = E> + Send + 'static,
    {
        Self::run(runner, None, at_end)
    }

    /// As [`new`](Self::new), with a function that ends the loop's [`idle`](Runner::idle), or its next one if
    /// it does not idle now. Such functions are [`HostWaker::wake`](crate::port::HostWaker::wake), and
    /// [`World::wake`](crate::sim::bus::World::wake) of a world in real time.
    ///
    /// # Panics
    /// As there.
    pub fn with_wake<R, const N: usize>(
        runner: R,
        wake: impl Fn() + Send + Sync + 'static,
        at_end: StopKind,
    ) -> Self
    where
        R: Runner<N, Error = E> + Send + 'static,
    {
        Self::run(runner, Some(Arc::new(wake)), at_end)
    }

    fn run<R, const N: usize>(runner: R, wake: Option<Wake>, at_end: StopKind) -> Self
    where
        R: Runner<N, Error = E> + Send + 'static,
    {
        let desk = Arc::new(Desk::new(wake));
        let thread = thread::Builder::new().name("myactuator-bus".to_owned()).spawn({
            let desk = Arc::clone(&desk);
            move || worker::run(runner, &desk, at_end)
        });
        let thread = thread.expect("the operating system has a thread left");
        Self(Arc::new(Running { desk, thread: Some(thread) }))
    }

    /// A handle that does not keep the bus running.
    pub fn downgrade(&self) -> WeakBus<E> {
        WeakBus(Arc::downgrade(&self.0))
    }

    pub(super) fn desk(&self) -> &Desk<E> {
        &self.0.desk
    }

    /// Sends a command to one motor and waits for its answer, or, if it has none, until it was sent. Questions of other
    /// threads are under way meanwhile. Questions to one motor are sent in their order; a command that ends motion goes
    /// before everything that waits for the motor, and drops what moves it. While
    /// [`release_brake`](Self::release_brake) opens the motor's brake and has not told it to hold, other questions to
    /// the motor wait, except those that end motion or open its brake.
    ///
    /// # Errors
    /// [`SharedBusError`]. If the command is next and gets no turn within 2 s, for example because a stop waits for a
    /// bus that is down, it is refused as [`Busy`](myactuator_protocol_core::error::RequestError::Busy). If the driver
    /// of the bus keeps its thread for 2 s, the error is [`Held`](SharedBusError::Held).
    pub fn ask<C: Command>(
        &self,
        motor: MotorId,
        command: C,
    ) -> Result<C::Reply, SharedBusError<E>> {
        self.put(motor, &command, Insistence::Usual, None)
    }

    /// As [`ask`](Self::ask), with a patience of its own.
    ///
    /// # Errors
    /// As there.
    pub fn ask_with<C: Command>(
        &self,
        motor: MotorId,
        command: C,
        patience: Patience,
    ) -> Result<C::Reply, SharedBusError<E>> {
        self.put(motor, &command, Insistence::Of(patience), None)
    }

    /// Asks several motors at the same time, which takes as long as the slowest one. Returns one outcome for each
    /// question, in their order.
    ///
    /// ```
    /// # use myactuator_host_std::protocol::MotorId;
    /// # use myactuator_host_std::protocol::command::ReadMultiTurnAngle;
    /// # use myactuator_host_std::protocol::master::StopKind;
    /// # use myactuator_host_std::share::SharedBus;
    /// # let bus = SharedBus::open(&"sim:3".parse()?, StopKind::Hold)?;
    /// let arm = [MotorId::new(1)?, MotorId::new(2)?, MotorId::new(3)?];
    /// for angle in bus.ask_together(arm.map(|motor| (motor, ReadMultiTurnAngle))) {
    ///     assert_eq!(angle?.angle.degrees(), 0.0);
    /// }
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// Each error is that of one question; the others go on. Questions to one motor are sent in their order.
    pub fn ask_together<C: Command, const M: usize>(
        &self,
        questions: [(MotorId, C); M],
    ) -> [Result<C::Reply, SharedBusError<E>>; M] {
        let desk = self.desk();
        let asked = questions.map(|(motor, command)| {
            (motor, desk.ask(motor, Untyped::of(&command), Insistence::Usual, None))
        });
        let mut is_held = false;
        asked.map(|(motor, awaited)| {
            // The driver that holds one of them holds the others, and each would wait for as long again.
            let reply = if is_held { desk.take_answer(awaited) } else { desk.wait(awaited) };
            is_held |= matches!(reply, Err(SharedBusError::Held));
            read::<C, E>(motor, &reply?)
        })
    }

    pub(super) fn put<C: Command>(
        &self,
        motor: MotorId,
        command: &C,
        insistence: Insistence,
        since: Option<Past>,
    ) -> Result<C::Reply, SharedBusError<E>> {
        let desk = self.desk();
        let reply = desk.wait(desk.ask(motor, Untyped::of(command), insistence, since))?;
        read::<C, E>(motor, &reply)
    }

    /// Puts a set-point in a motor's stream. Only the newest set-point waits, whichever thread has put it. Does not
    /// wait.
    ///
    /// So it does not say what becomes of the set-point:
    /// - A motor that has fallen silent may have restarted, but its set-points are refused only after a second.
    /// - A motor that was never heard, such as a wrong id, is refused no set-point.
    ///
    /// Check when the motor was last [heard](Self::latest), or [subscribe](Self::subscribe).
    ///
    /// # Errors
    /// - [`SharedBusError::Refused`]: the motors were stopped, or the set-point before this one was refused, for the
    ///   reasons of [`Master::set_point`](myactuator_protocol_core::master::Master::set_point); then this one was not
    ///   put either.
    /// - [`SharedBusError::Bus`]: the bus fails, or it has failed and no call was told yet.
    /// - [`SharedBusError::Held`]: the thread of the bus has taken up nothing for 2 s.
    pub fn set_point<C: SetPoint>(
        &self,
        motor: MotorId,
        command: C,
    ) -> Result<(), SharedBusError<E>> {
        self.desk().set_point(motor, Untyped::of(&command))
    }

    /// Stops all motors that were spoken to and those of `also`, before anything else is sent. Waits until each has
    /// confirmed it or is known not to, for up to [a second or
    /// three](myactuator_protocol_core::io::longest_stop), on a slow line for longer. Returns those that have not
    /// confirmed it: **cut their power**. If the driver of the bus keeps its thread for 2 s, these are all ids. A motor
    /// that a stop in force has [switched off](Self::switched_off) stays off, also if this one is to hold it, and
    /// confirms that: it holds nothing. Whatever waits that may move a motor is dropped, whichever thread it is from,
    /// and everything of that kind is refused until [`lift_stop`](Self::lift_stop).
    ///
    /// # Errors
    /// [`SharedBusError::Panicked`]: the thread of the bus has ended and cannot stop them. **Cut their power.**
    pub fn stop_all(&self, kind: StopKind, also: MotorSet) -> Result<MotorSet, SharedBusError<E>> {
        self.begin_stop_all(kind, also).wait()
    }

    /// As [`stop_all`](Self::stop_all), but the caller need not wait, or waits later. So several buses are stopped at
    /// the same time.
    ///
    /// ```
    /// # use myactuator_host_std::protocol::master::{MotorSet, StopKind};
    /// # use myactuator_host_std::share::SharedBus;
    /// # let left = SharedBus::open(&"sim:2".parse()?, StopKind::Hold)?;
    /// # let right = SharedBus::open(&"sim:2".parse()?, StopKind::Hold)?;
    /// let stops = [&left, &right].map(|bus| bus.begin_stop_all(StopKind::Hold, MotorSet::EMPTY));
    /// for stop in stops {
    ///     let unconfirmed = stop.wait()?;
    ///     assert!(unconfirmed.is_empty(), "cut the power of motors {unconfirmed}");
    /// }
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn begin_stop_all(&self, kind: StopKind, also: MotorSet) -> Stopping<E> {
        Stopping { desk: Arc::clone(&self.0.desk), stop: self.desk().stop_all(kind, also) }
    }

    /// Stops one motor, as [`stop_all`](Self::stop_all) stops all. Returns it if it has not confirmed the stop: **cut
    /// its power**. A motor that a stop in force has switched off stays off: it confirms [`StopKind::Hold`], too, but
    /// holds nothing.
    ///
    /// # Errors
    /// [`SharedBusError::Refused`] if the master has no place for it, [`SharedBusError::Panicked`].
    pub fn stop(&self, motor: MotorId, kind: StopKind) -> Result<MotorSet, SharedBusError<E>> {
        self.stop_since(motor, kind, None)
    }

    /// Stops one motor for a caller that began to work with it at `since`.
    pub(super) fn stop_since(
        &self,
        motor: MotorId,
        kind: StopKind,
        since: Option<Past>,
    ) -> Result<MotorSet, SharedBusError<E>> {
        let desk = self.desk();
        desk.wait_for_stop(desk.stop(motor, kind, since), motor.into())
    }

    /// Accepts again what is refused since [`stop_all`](Self::stop_all) or [`stop`](Self::stop). Does not
    /// wait.
    ///
    /// **It lifts every stop, of any thread**, also one that came a moment before, for example because somebody has
    /// pressed a button: [`lift_stop_if`](Self::lift_stop_if) does not. Have one place in a program that lifts stops,
    /// and knows of all reasons for them.
    ///
    /// **A control loop that neither looks by a [`Watch`](super::Watch) nor puts a set-point between the stop and this
    /// does not notice the stop**, and moves the motors on. Wait until its thread has left before you lift the stop.
    ///
    /// # Errors
    /// [`SharedBusError::Panicked`].
    pub fn lift_stop(&self) -> Result<(), SharedBusError<E>> {
        self.desk().order(Order::LiftStop)
    }

    /// As [`lift_stop`](Self::lift_stop), unless a stop was called for since [`stop_count`](Self::stop_count) was this.
    /// Returns whether it has lifted all stops.
    ///
    /// ```
    /// # use myactuator_host_std::open::BusAddress;
    /// # use myactuator_host_std::protocol::master::{MotorSet, StopKind};
    /// # use myactuator_host_std::share::SharedBus;
    /// # let bus = SharedBus::open(&"sim:2".parse::<BusAddress>()?, StopKind::Hold)?;
    /// # drop(bus.stop_all(StopKind::Hold, MotorSet::EMPTY)?);
    /// // Somebody says that the robot may go on.
    /// let stops = bus.stop_count();
    /// // Look at the motors here. Meanwhile the button is pressed again.
    /// bus.begin_stop_all(StopKind::Hold, MotorSet::EMPTY);
    /// assert!(!bus.lift_stop_if(stops)?, "it stays stopped");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`SharedBusError::Panicked`].
    pub fn lift_stop_if(&self, stop_count: u64) -> Result<bool, SharedBusError<E>> {
        self.desk().lift_stop_if(stop_count)
    }

    /// Whether a motor is stopped, individually or with all, and that stop was not lifted. Does not wait.
    pub fn is_stopped(&self, motor: MotorId) -> bool {
        self.desk().lock().is_stopped(motor, None)
    }

    /// The motors that a stop in force has switched off: no other stop switches them on. After a stop of all, every id.
    /// Does not wait.
    pub fn switched_off(&self) -> MotorSet {
        self.desk().lock().switched_off
    }

    /// How many stops were called for so far, of one motor or of all, by whatever thread. Does not wait.
    pub fn stop_count(&self) -> u64 {
        self.desk().lock().stops
    }

    /// Accepts again what this motor is refused since [`stop`](Self::stop), **whichever thread has called that**. Only
    /// code that knows why the motor was stopped may lift its stop. Does not wait.
    ///
    /// # Errors
    /// [`SharedBusError::Panicked`].
    pub fn lift_stop_of(&self, motor: MotorId) -> Result<(), SharedBusError<E>> {
        self.desk().order(Order::LiftStopOf(motor))
    }

    /// Accepts set-points and moves again for a motor that
    /// [has restarted](myactuator_protocol_core::master::Event::Restarted). Call it once you know where the motor is.
    ///
    /// # Errors
    /// [`SharedBusError::Panicked`].
    pub fn resume(&self, motor: MotorId) -> Result<(), SharedBusError<E>> {
        self.desk().order(Order::Resume(motor))
    }

    /// Whether set-points and moves are refused because the motor has restarted, or may have: also after a second of
    /// silence, whatever its run time says. Until [`resume`](Self::resume). Does not wait.
    pub fn has_restarted(&self, motor: MotorId) -> bool {
        self.desk().lock().has_restarted_since(motor, None)
    }

    /// Gives up the place of an id without a motor; until then each stop of all waits for that id. If there is a motor
    /// later, no stop of all and no guard reaches it until it is spoken to. If the id is being spoken to, or what was
    /// sent may still move a motor there, this happens when that is over, unless it answers or is spoken to again. Does
    /// not wait.
    ///
    /// # Errors
    /// [`SharedBusError::Panicked`].
    pub fn forget(&self, motor: MotorId) -> Result<(), SharedBusError<E>> {
        self.desk().order(Order::Forget(motor))
    }

    /// The newest feedback of a motor: the reply to a set-point, to a broadcast, or a report. `None` if there is none
    /// yet. Does not wait.
    pub fn latest(&self, motor: MotorId) -> Option<Latest> {
        self.desk().latest(motor)
    }

    /// Watches these motors, which a loop of this thread moves, and that loop. If it hangs, all motors are stopped, as
    /// `kind` says unless others are to be held. See [`Watch`].
    pub fn watch(&self, motors: MotorSet, kind: StopKind) -> Watch<E> {
        Watch::new(Arc::clone(&self.0.desk), motors, kind)
    }

    /// Subscribes to all events of the bus from now on. Up to `room` events wait (at least one). Events that come while
    /// there is no room are lost, and counted.
    pub fn subscribe(&self, room: usize) -> Subscription {
        self.desk().subscribe(room)
    }
}

/// Decodes what a motor has answered to such a command.
fn read<C: Command, E>(motor: MotorId, reply: &Data) -> Result<C::Reply, SharedBusError<E>> {
    C::decode_reply(reply).map_err(|error| {
        let failure = Failure::Unreadable(error);
        SharedBusError::Failed { motor, failure }
    })
}
