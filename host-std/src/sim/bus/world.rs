//! The world: a clock, a bus and all that is on it.

use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::task::Waker;

use myactuator_protocol_core::io::{AsyncClock, Clock};
use myactuator_protocol_core::time::{Duration, Instant};

use super::faults::{Babble, Direction, FaultPlan};
use super::kernel::{Kernel, Planned};
use super::medium::Medium;
use super::nanos::{NEVER, Nanos, from_duration, from_instant, to_instant};
use super::node::{Node, StationId, lock};
use super::port::Port;
use super::trace::{Log, Record};
use super::waiting::{Awaited, Waiting};

pub(super) struct State<B: Medium> {
    pub(super) kernel: Kernel<B>,
    /// Tasks.
    pub(super) waiting: Waiting<B>,
    /// Time 0 on the wall clock; `None` in virtual time, which its callers advance.
    pub(super) wall_zero: Option<std::time::Instant>,
}

impl<B: Medium> State<B> {
    /// In real time, lets everything up to now happen.
    fn catch_up(&mut self) {
        let Some(zero) = self.wall_zero else { return };
        let passed = zero.elapsed();
        let wall = u64::try_from(passed.as_nanos()).unwrap_or(NEVER);
        while self.kernel.next_event() <= wall {
            self.kernel.step(self.kernel.next_event());
            if zero.elapsed() > passed + LONGEST_CATCH_UP {
                return self.follow_wall_clock();
            }
        }
        self.kernel.run_until(wall);
    }

    /// Goes on with the wall clock from here.
    fn follow_wall_clock(&mut self) {
        let passed = std::time::Duration::from_nanos(self.kernel.around.now);
        let now = std::time::Instant::now();
        self.wall_zero = Some(now.checked_sub(passed).unwrap_or(now));
    }
}

/// The most that is caught up with. A world slower than the wall clock would otherwise have more and more to catch up.
const LONGEST_CATCH_UP: std::time::Duration = std::time::Duration::from_millis(500);

struct Shared<B: Medium> {
    state: Mutex<State<B>>,
    /// Something has changed for which a thread may be sleeping in real time.
    changed: Condvar,
}

/// A simulated bus with a clock of its own and everything that is on it. This is a handle: clones share the
/// world.
///
/// In virtual time, which is the default, nothing happens between calls: the world goes on only in
/// [`run_until`](Self::run_until) and [`step`](Self::step), in [`SimClock::idle`](Clock::idle), in the
/// blocking calls of serial ports, and in [`block_on`](Self::block_on) while every task waits. Several
/// masters may share it in one thread; if several threads wait, each advances time for all.
///
/// After [`in_real_time`](Self::in_real_time) it follows the wall clock, catches up with it in every
/// call, and may be used from any number of threads. If catching up takes longer than half a second, the
/// rest is skipped: a simulation that is too slow goes on slowly.
///
/// Methods that take a [`StationId`] panic on one of another world that has more stations.
pub struct World<B: Medium>(Arc<Shared<B>>);

impl<B: Medium> Clone for World<B> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<B: Medium> fmt::Debug for World<B> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("World").field("bus", &self.lock().kernel.bus).finish_non_exhaustive()
    }
}

impl<B: Medium> World<B> {
    pub(super) fn with_medium(bus: B, seed: u64) -> Self {
        let kernel = Kernel::new(bus, seed);
        let state = State { kernel, waiting: Waiting::default(), wall_zero: None };
        Self(Arc::new(Shared { state: Mutex::new(state), changed: Condvar::new() }))
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, State<B>> {
        lock(&self.0.state)
    }

    /// Works on the world as it is now.
    pub(super) fn with<T>(&self, work: impl FnOnce(&mut Kernel<B>) -> T) -> T {
        self.with_state(|state| work(&mut state.kernel))
    }

    /// As [`with`](Self::with), with the waiting tasks, too.
    pub(super) fn with_state<T>(&self, work: impl FnOnce(&mut State<B>) -> T) -> T {
        let mut state = self.lock();
        state.catch_up();
        let result = work(&mut state);
        self.leave(state);
        result
    }

    /// Unlocks the world, and wakes the tasks and threads that wait for what has come.
    fn leave(&self, mut guard: MutexGuard<'_, State<B>>) {
        let state = &mut *guard;
        let woken = state.waiting.take_ready(&state.kernel);
        let may_anybody_sleep = state.wall_zero.is_some();
        drop(guard);
        // This is a system call even if none waits.
        if may_anybody_sleep {
            self.0.changed.notify_all();
        }
        woken.into_iter().for_each(Waker::wake);
    }

    /// Lets time go on until `done` has a result, but not beyond `until`. In virtual time `None`
    /// also if nothing can happen any more and `until` is `NEVER`.
    pub(super) fn wait<T>(
        &self,
        until: Nanos,
        mut done: impl FnMut(&mut Kernel<B>) -> Option<T>,
    ) -> Option<T> {
        let mut state = self.lock();
        let result = loop {
            state.catch_up();
            if let Some(result) = done(&mut state.kernel) {
                break Some(result);
            }
            let next = state.kernel.next_event();
            match state.wall_zero {
                None if next > until || next == NEVER => {
                    if until != NEVER {
                        state.kernel.run_until(until);
                    }
                    break None;
                }
                None => state.kernel.step(next),
                Some(_) if state.kernel.around.now >= until => break None,
                Some(zero) => {
                    let wake = std::time::Duration::from_nanos(next.min(until));
                    let ahead = wake.saturating_sub(zero.elapsed());
                    let sleep = self.0.changed.wait_timeout(state, ahead);
                    (state, _) = sleep.unwrap_or_else(PoisonError::into_inner);
                }
            }
        };
        self.leave(state);
        result
    }

    /// Makes the world follow the wall clock from now on, for all its handles.
    pub fn in_real_time(self) -> Self {
        self.lock().follow_wall_clock();
        self
    }

    /// The time now, rounded up to microseconds.
    pub fn now(&self) -> Instant {
        self.with(|kernel| to_instant(kernel.around.now))
    }

    /// The time now in nanoseconds.
    pub fn now_ns(&self) -> u64 {
        self.with(|kernel| kernel.around.now)
    }

    /// When something happens next on its own, rounded up to microseconds; `None` for never.
    pub fn next_event(&self) -> Option<Instant> {
        let next = self.with(|kernel| kernel.next_event());
        (next != NEVER).then(|| to_instant(next))
    }

    /// Lets time go on to `at`. In real time this sleeps.
    pub fn run_until(&self, at: Instant) {
        self.wait(from_instant(at), |_| None::<()>);
    }

    /// Lets time go on by `span`. In real time this sleeps.
    pub fn run_for(&self, span: Duration) {
        self.run_until(self.now() + span);
    }

    /// Goes on to the next event. False if there is none. In real time this sleeps.
    pub fn step(&self) -> bool {
        let next = self.with(|kernel| kernel.next_event());
        if next != NEVER {
            self.wait(next, |_| None::<()>);
        }
        next != NEVER
    }

    /// Ends the idling of this world's clocks, in every thread, as an arrival does.
    pub fn wake(&self) {
        self.with(|kernel| kernel.arrivals += 1);
    }

    /// A clock for masters in this world.
    pub fn clock(&self) -> SimClock<B> {
        SimClock { world: self.clone(), seen: AtomicU64::new(self.with(|kernel| kernel.arrivals)) }
    }

    /// Attaches a node with a controller or transceiver of its own kind.
    pub fn attach_with(
        &self,
        node: impl Node<B::Frame> + 'static,
        attachment: B::Attachment,
    ) -> StationId {
        self.with(|kernel| StationId(kernel.attach(Some(Box::new(node)), attachment, 0)))
    }

    pub(super) fn attach_port(&self, attachment: B::Attachment, receive_queue: usize) -> Port<B> {
        let station = self.with(|kernel| StationId(kernel.attach(None, attachment, receive_queue)));
        Port { world: self.clone(), station }
    }

    /// Brings a node's own time up to now, and sends what it has to send.
    pub(in crate::sim) fn serve(&self, node: StationId) {
        self.with(|kernel| kernel.serve_now(node.0));
    }

    /// Sets what chance does to the frames of one direction from now on.
    pub fn set_faults(&self, direction: Direction, plan: FaultPlan) {
        self.with(|kernel| kernel.around.injector.set(direction, plan));
    }

    /// Sets what chance does to the frames to or from one node from now on, in place of the direction's
    /// plan; `None` for the direction's plan again.
    pub fn set_node_faults(&self, node: StationId, direction: Direction, plan: Option<FaultPlan>) {
        self.with(|kernel| kernel.around.injector.set_own(node.0, direction, plan));
    }

    /// Cuts a station's wire: it is then alone on its stub. A CAN frame that it is sending ends in an
    /// error frame; a byte on RS485 is garbled. Does nothing if the wire is cut already.
    pub fn cut(&self, station: StationId) {
        self.with(|kernel| kernel.cut(station.0, true));
    }

    /// Mends a station's wire. The station hears what begins after that. Does nothing if the wire is not cut.
    pub fn mend(&self, station: StationId) {
        self.with(|kernel| kernel.cut(station.0, false));
    }

    /// Whether a station's wire is cut.
    pub fn is_cut(&self, station: StationId) -> bool {
        self.with(|kernel| kernel.is_cut(station.0))
    }

    /// Cycles a station's power: empties its controller, clears its error counters and calls [`Node::reset`]. A
    /// simulated drive is off the bus for a millisecond.
    pub fn reset(&self, station: StationId) {
        self.with(|kernel| kernel.reset(station.0));
    }

    /// Sets the bit rate of a station, in bit/s; at first it is the bus's. If the rate changes,
    /// its controller starts anew. A node with a [rate of its own](Node::bit_rate) keeps that.
    pub fn set_bit_rate(&self, station: StationId, bit_rate: u32) {
        self.with(|kernel| kernel.set_bit_rate(station.0, bit_rate));
    }

    /// Slows a node down: all that it sends reaches its controller that much later.
    /// [`Duration::ZERO`] restores its own speed.
    pub fn slow_down(&self, node: StationId, by: Duration) {
        self.with(|kernel| kernel.slow_down(node.0, by));
    }

    /// Makes a station get what it hears in bursts, only at multiples of this period, as USB adapters hand it over;
    /// [`Duration::ZERO`] for at once again.
    pub fn hand_over_every(&self, station: StationId, period: Duration) {
        self.with(|kernel| kernel.hand_over_every(station.0, period));
    }

    /// Lets a station babble from now on; `None` silences it.
    pub fn babble(&self, station: StationId, babble: Option<Babble<B::Frame>>) {
        self.with(|kernel| kernel.babble(station.0, babble));
    }

    /// From now on calls `work` once per period of this world's time (at least a microsecond), before the nodes have
    /// their turn. It must not use the world, which is in the middle of something.
    pub fn every(&self, period: Duration, mut work: impl FnMut(Instant) + Send + 'static) {
        let period = period.max(Duration::from_micros(1));
        self.plan(period, move |_, now| {
            work(now);
            Some(period)
        });
    }

    /// Has `work` done so long from now, before the nodes have their turn, and again so long after as it gives
    /// each time, until it gives `None`.
    pub(in crate::sim) fn plan(
        &self,
        after: Duration,
        work: impl FnMut(&mut Kernel<B>, Instant) -> Option<Duration> + Send + 'static,
    ) {
        self.with(|kernel| {
            let at = kernel.around.now.saturating_add(from_duration(after));
            kernel.planned.push(Planned { at, work: Box::new(work) });
        });
    }

    /// How many works are planned: faults that wait, and work that is done [every](Self::every) period.
    pub fn planned(&self) -> usize {
        self.with(|kernel| kernel.planned.len())
    }

    /// Calls `observer` for everything that happens from now on. It must not use the world, which
    /// is in the middle of something.
    pub fn observe(&self, observer: impl FnMut(&Record<B::Frame>) + Send + 'static) {
        self.with(|kernel| kernel.around.observers.push(Box::new(observer)));
    }

    /// Notes everything that happens from now on.
    pub fn log(&self) -> Log<B::Frame> {
        let records = Arc::new(Mutex::new(Vec::new()));
        let log = Log(Arc::clone(&records));
        self.observe(move |record| {
            lock(&records).push(record.clone());
        });
        log
    }
}

/// A world's clock, for masters.
///
/// In virtual time [`idle`](Clock::idle) lets the world go on; in real time it sleeps. In both cases it ends early
/// if, since this clock last looked, something has arrived at one of the world's ports, or one of them has room again
/// for what it had refused. Each master has a clock of its own.
///
/// Tasks wait with [`wait_until`](AsyncClock::wait_until), within [`World::block_on`].
#[derive(Debug)]
pub struct SimClock<B: Medium> {
    world: World<B>,
    /// What had come to the ports when it last looked.
    seen: AtomicU64,
}

impl<B: Medium> Clock for SimClock<B> {
    fn now(&self) -> Instant {
        self.world.now()
    }

    fn idle(&self, until: Instant) {
        let seen = self.seen.load(Ordering::Relaxed);
        let come = |kernel: &mut Kernel<B>| (kernel.arrivals != seen).then_some(kernel.arrivals);
        if let Some(arrivals) = self.world.wait(from_instant(until), come) {
            self.seen.store(arrivals, Ordering::Relaxed);
        }
    }
}

impl<B: Medium> AsyncClock for SimClock<B> {
    async fn wait_until(&mut self, until: Instant) {
        self.world.come(Awaited::Time(from_instant(until))).await;
    }
}
