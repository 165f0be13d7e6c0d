//! The loop that runs the master: polled, or async in the world's executor, with futures that may be dropped.

use embassy_futures::select::{Either, select};
use myactuator_host_std::sim::bus::World;
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::SetPoint;
use myactuator_protocol_core::error::RequestError;
use myactuator_protocol_core::io::{AsyncClock as _, AsyncRunner, Runner};
use myactuator_protocol_core::master::{Event, Master};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_tests::dice::Dice;

use super::scenarios::{Loop, Scenario};
use super::world::{Rough, RoughError};

/// A future that is to be dropped is dropped within this time: several frames of either bus.
const DROPPED_WITHIN_US: u64 = 1_000;

/// A loop of any kind.
pub(crate) enum Host<W: Rough> {
    Polled(W::Polled),
    Async {
        bus: W::Async,
        world: World<W>,
        /// Decides which futures are dropped, if any are.
        drops: Option<Dice>,
    },
}

impl<W: Rough> Host<W> {
    /// This async loop. The scenario decides whether its futures are dropped.
    pub(super) fn tasks(bus: W::Async, world: &World<W>, scenario: &Scenario) -> Self {
        let drops = scenario.conditions.runs == Loop::AsyncDropped;
        let drops = drops.then(|| Dice::new(scenario.seed ^ 0xD40B));
        Self::Async { bus, world: world.clone(), drops }
    }

    pub(super) fn master(&mut self) -> &mut Master<32> {
        match self {
            Self::Polled(bus) => bus.master(),
            Self::Async { bus, .. } => bus.master(),
        }
    }

    /// When a polled loop has to run again. `None` for an async loop, whose future may have been dropped anywhere.
    pub(super) fn wakes_at(&mut self) -> Option<Instant> {
        match self {
            Self::Polled(bus) => bus.master().poll_at(),
            Self::Async { .. } => None,
        }
    }

    pub(super) fn now(&self) -> Instant {
        match self {
            Self::Polled(bus) => bus.now(),
            Self::Async { bus, .. } => bus.now(),
        }
    }

    pub(super) fn set_point<C: SetPoint>(
        &mut self,
        motor: MotorId,
        command: C,
    ) -> Result<(), RequestError> {
        let now = self.now();
        self.master().set_point(motor, command, now)
    }

    /// One round.
    pub(super) fn poll(&mut self) -> Result<Option<Event>, RoughError> {
        match self {
            Self::Polled(bus) => bus.poll(),
            Self::Async { .. } => self.run(self.now()),
        }
    }

    /// Waits until then, or until there is something to do. An async loop also does it.
    pub(super) fn wait(&mut self, until: Instant) -> Result<Option<Event>, RoughError> {
        match self {
            Self::Polled(bus) => {
                bus.idle(until);
                Ok(None)
            }
            Self::Async { .. } => self.run(until),
        }
    }

    /// Runs an async loop until then, unless its future is dropped before.
    fn run(&mut self, until: Instant) -> Result<Option<Event>, RoughError> {
        let Self::Async { bus, world, drops } = self else { return Ok(None) };
        let run = bus.run(Some(until));
        let dropped_after = drops.as_mut().and_then(|dice| {
            // Some are dropped as soon as they wait.
            let after = dice.below(2) * dice.below(DROPPED_WITHIN_US);
            (dice.below(2) == 0).then_some(Duration::from_micros(after))
        });
        let Some(after) = dropped_after else { return world.block_on(run) };
        let mut clock = world.clock();
        match world.block_on(select(run, clock.wait_until(world.now() + after))) {
            Either::First(heard) => heard,
            Either::Second(()) => Ok(None),
        }
    }
}
