//! Runs async code on simulated buses: time goes on while every task waits.

use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll, Wake, Waker};

use super::medium::Medium;
use super::nanos::{NEVER, Nanos};
use super::world::World;
use sealed::Passing;

/// This many consecutive turns take no time.
const FREE_TURNS: u32 = 100;
/// How long each further turn takes, so that a task that yields over and over sees time pass.
const TURN: Nanos = 10_000;
/// The longest sleep in real time: another thread may have used the world meanwhile.
const LONGEST_SLEEP: Nanos = 1_000_000;

/// A simulated bus of any kind, on which [`block_on`] lets time go on. Only this library implements it.
pub trait Timeline: Passing {}

mod sealed {
    use super::Nanos;

    pub trait Passing {
        /// How long until something is due, for the world or for a task that waits for a time; `None` if nothing ever
        /// is.
        fn until_next(&self) -> Option<Nanos>;

        /// Lets this much time pass.
        fn pass(&self, span: Nanos);
    }
}

impl<B: Medium> Timeline for World<B> {}

impl<B: Medium> Passing for World<B> {
    fn until_next(&self) -> Option<Nanos> {
        let state = self.lock();
        let now = state.kernel.around.now;
        let limit = state.wall_zero.map_or(NEVER, |_| now.saturating_add(LONGEST_SLEEP));
        let next = state.kernel.next_event().min(state.waiting.next_time()).min(limit);
        (next != NEVER).then(|| next.saturating_sub(now))
    }

    fn pass(&self, span: Nanos) {
        let until = self.now_ns().saturating_add(span);
        self.wait(until, |_| None::<()>);
    }
}

impl<B: Medium> World<B> {
    /// Runs async code in this world, which may be several joined tasks. While any task has something
    /// to do, no time passes. When all wait, time goes on to the next event, or to the next time that a task
    /// waits for. So every run is the same.
    ///
    /// A task that does not wait but yields over and over still sees time pass: after a hundred
    /// turns, 10 us with each.
    ///
    /// In real time this sleeps instead.
    ///
    /// A task that waits for another world waits for ever, since time stands still there: run it in [`block_on`] with
    /// both worlds.
    ///
    /// # Panics
    /// If every task waits for something that cannot come, since nothing is left to happen in the world.
    pub fn block_on<F: Future>(&self, future: F) -> F::Output {
        block_on(&[self], future)
    }
}

/// As [`World::block_on`], in several worlds: the same time passes in all of them.
///
/// # Panics
/// As there.
pub fn block_on<F: Future>(worlds: &[&dyn Timeline], future: F) -> F::Output {
    let mut future = pin!(future);
    let woken = Arc::new(Woken::default());
    let waker = Waker::from(Arc::clone(&woken));
    let mut context = Context::from_waker(&waker);
    let mut turns = 0;
    loop {
        if let Poll::Ready(output) = future.as_mut().poll(&mut context) {
            return output;
        }
        if woken.take() {
            turns += 1;
            if turns > FREE_TURNS {
                worlds.iter().for_each(|world| world.pass(TURN));
            }
            continue;
        }
        turns = 0;
        while !woken.take() {
            let next = worlds.iter().filter_map(|world| world.until_next()).min();
            let span = next.expect("every task waits, and nothing is left to happen in the world");
            worlds.iter().for_each(|world| world.pass(span));
        }
    }
}

/// Whether a task has something to do.
#[derive(Default)]
struct Woken(AtomicBool);

impl Woken {
    fn take(&self) -> bool {
        self.0.swap(false, Ordering::AcqRel)
    }
}

impl Wake for Woken {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::Release);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::bus::can::CanWorld;
    use crate::sim::bus::rs485::SerialWorld;
    use embassy_futures::join::join;
    use embassy_futures::select::{Either, select};
    use embassy_futures::yield_now;
    use myactuator_protocol_core::io::{AsyncClock, Clock};
    use myactuator_protocol_core::time::{Duration, Instant};
    use std::cell::RefCell;

    fn world() -> CanWorld {
        CanWorld::new(1_000_000, 1)
    }

    fn at(millis: u64) -> Instant {
        Instant::from_millis(millis)
    }

    #[test]
    fn virtual_time_stands_while_a_task_has_work() {
        let world = world();
        world.block_on(async {
            for _ in 0..100 {
                yield_now().await;
            }
            assert_eq!(world.now(), Instant::ZERO);
            // A task that polls until a time has come sees it come.
            for _ in 0..30 {
                yield_now().await;
            }
            assert_eq!(world.now(), Instant::from_micros(300));
        });
    }

    #[test]
    fn virtual_time_jumps_from_one_awaited_event_to_the_next() {
        let (world, log) = (world(), RefCell::new(Vec::new()));
        let sleeper = async |name, times: [u64; 2]| {
            let mut clock = world.clock();
            for time in times {
                clock.wait_until(at(time)).await;
                log.borrow_mut().push((name, clock.now()));
            }
        };
        world.block_on(join(sleeper('a', [3, 4]), sleeper('b', [1, 9])));
        assert_eq!(log.take(), [('b', at(1)), ('a', at(3)), ('a', at(4)), ('b', at(9))]);
    }

    #[test]
    fn dropped_wait_does_not_hold_back_the_world() {
        let world = world();
        let (mut long, mut short) = (world.clock(), world.clock());
        let first = world.block_on(select(long.wait_until(at(1_000)), short.wait_until(at(1))));
        assert!(matches!(first, Either::Second(())));
        assert_eq!((world.now(), World::until_next(&world)), (at(1), None));
    }

    #[test]
    fn time_passes_alike_in_worlds_that_run_together() {
        let (can, line) = (world(), SerialWorld::new(115_200, 1));
        line.run_for(Duration::from_millis(5));
        let (mut of_can, mut of_line) = (can.clock(), line.clock());
        let both = join(of_can.wait_until(at(2)), of_line.wait_until(at(9)));
        block_on(&[&can, &line], both);
        assert_eq!((can.now(), line.now()), (at(4), at(9)));
    }

    #[test]
    fn in_real_time_it_sleeps() {
        let world = world().in_real_time();
        let mut clock = world.clock();
        let (start, wall) = (clock.now(), std::time::Instant::now());
        world.block_on(clock.wait_until(start + Duration::from_millis(3)));
        assert!(wall.elapsed() >= std::time::Duration::from_millis(2));
    }

    #[test]
    #[should_panic = "nothing is left to happen"]
    fn wait_that_cannot_end_panics() {
        world().block_on(std::future::pending::<()>());
    }
}
