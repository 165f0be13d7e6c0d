//! Tasks that wait for something in a world.

use std::collections::BTreeMap;
use std::pin::Pin;
use std::task::{Context, Poll, Waker};

use super::kernel::Kernel;
use super::medium::Medium;
use super::nanos::{NEVER, Nanos};
use super::world::{State, World};

/// What a task waits for.
pub(crate) enum Awaited<B: Medium> {
    /// The clock to reach this time.
    Time(Nanos),
    /// This condition of this station.
    Station(usize, fn(&Kernel<B>, usize) -> bool),
}

impl<B: Medium> Clone for Awaited<B> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<B: Medium> Copy for Awaited<B> {}

impl<B: Medium> Awaited<B> {
    fn has_come(self, kernel: &Kernel<B>) -> bool {
        match self {
            Self::Time(at) => kernel.around.now >= at,
            Self::Station(station, is_so) => is_so(kernel, station),
        }
    }
}

/// The waiting tasks, in the order in which they began to wait.
pub(super) struct Waiting<B: Medium> {
    tasks: BTreeMap<u64, (Awaited<B>, Waker)>,
    next: u64,
}

impl<B: Medium> Default for Waiting<B> {
    fn default() -> Self {
        Self { tasks: BTreeMap::new(), next: 0 }
    }
}

impl<B: Medium> Waiting<B> {
    /// The next time that a task waits for; `NEVER` if there is none.
    pub(super) fn next_time(&self) -> Nanos {
        let times = self.tasks.values().map(|(awaited, _)| match awaited {
            Awaited::Time(at) => *at,
            Awaited::Station(..) => NEVER,
        });
        times.min().unwrap_or(NEVER)
    }

    /// Removes the tasks that have what they wait for.
    pub(super) fn take_ready(&mut self, kernel: &Kernel<B>) -> Vec<Waker> {
        let mut ready = Vec::new();
        self.tasks.retain(|_, (awaited, waker)| {
            let has_come = awaited.has_come(kernel);
            if has_come {
                ready.push(waker.clone());
            }
            !has_come
        });
        ready
    }
}

/// A future that completes once something has come. It may be dropped and made anew at any time.
pub(crate) struct Come<'a, B: Medium> {
    world: &'a World<B>,
    awaited: Awaited<B>,
    /// Its number among the waiting tasks.
    number: Option<u64>,
}

impl<B: Medium> World<B> {
    /// Waits for this.
    pub(crate) const fn come(&self, awaited: Awaited<B>) -> Come<'_, B> {
        Come { world: self, awaited, number: None }
    }
}

impl<B: Medium> Future for Come<'_, B> {
    type Output = ();

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<()> {
        let (awaited, earlier) = (self.awaited, self.number);
        let number = self.world.with_state(|State { kernel, waiting, .. }| {
            earlier.into_iter().for_each(|number| {
                waiting.tasks.remove(&number);
            });
            if awaited.has_come(kernel) {
                return None;
            }
            let number = waiting.next;
            waiting.next += 1;
            waiting.tasks.insert(number, (awaited, context.waker().clone()));
            Some(number)
        });
        self.number = number;
        if number.is_some() { Poll::Pending } else { Poll::Ready(()) }
    }
}

impl<B: Medium> Drop for Come<'_, B> {
    fn drop(&mut self) {
        if let Some(number) = self.number {
            self.world.with_state(|state| state.waiting.tasks.remove(&number));
        }
    }
}
