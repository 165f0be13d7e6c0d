//! Waiting as a task: what the async programs have beside the others.

use core::future::poll_fn;
use core::sync::atomic::{AtomicBool, Ordering};
use core::task::Poll;

use cortex_m::asm::wfi;
use embassy_futures::yield_now;
use embassy_sync::waitqueue::AtomicWaker;
use embedded_can::nb::Can;
use myactuator_protocol_core::io::{AsyncCan, AsyncClock, Clock as _};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::wire::can::SimpleFrame;

use crate::clock::Clock;
use crate::slcan::{self, Slcan};

/// The one task that waits, for a byte, for room or for the time: whatever interrupt comes wakes it,
/// and it looks at everything that it waits for again.
static TASK: AtomicWaker = AtomicWaker::new();
/// It was woken since this was last looked at.
static IS_WOKEN: AtomicBool = AtomicBool::new(false);

/// For interrupts.
pub(crate) fn wake() {
    IS_WOKEN.store(true, Ordering::Relaxed);
    TASK.wake();
}

/// Waits until a look finds something. The task looks whenever something has happened.
pub(crate) async fn until_found<T>(mut look: impl FnMut() -> Option<T>) -> T {
    poll_fn(|context| {
        // Before the look, so that nothing falls between the two.
        TASK.register(context.waker());
        look().map_or(Poll::Pending, Poll::Ready)
    })
    .await
}

/// Sleeps whenever nobody else has anything to do. Spawn it beside the application: embassy's executor
/// itself waits by an instruction (WFE) that the emulator passes over, and would keep it busy.
#[embassy_executor::task]
pub async fn sleep() -> ! {
    loop {
        // With interrupts off, so that none falls between the look and the sleep: a pending one ends
        // the sleep all the same.
        let is_woken = critical_section::with(|_| {
            let is_woken = IS_WOKEN.swap(false, Ordering::Relaxed);
            if !is_woken {
                wfi();
            }
            is_woken
        });
        yield_now().await;
        if is_woken {
            // In the executor's round that begins now, the one that was woken may come after this one.
            yield_now().await;
        }
    }
}

impl AsyncClock for Clock {
    async fn wait_until(&mut self, until: Instant) {
        let clock = *self;
        until_found(|| {
            let is_time = clock.now() >= until;
            if !is_time {
                clock.wake_by(until);
            }
            is_time.then_some(())
        })
        .await;
    }
}

/// How soon the adapter is asked again that took nothing: some of what it waits for is over by time
/// alone.
const ASK_AGAIN_AFTER: Duration = Duration::from_millis(1);

impl AsyncCan for Slcan {
    type Frame = SimpleFrame;
    type Error = slcan::Stalled;

    async fn transmit(
        &mut self,
        frame: &SimpleFrame,
    ) -> Result<Option<SimpleFrame>, slcan::Stalled> {
        until_found(|| match Can::transmit(self, frame) {
            Ok(pushed_out) => Some(Ok(pushed_out)),
            Err(nb::Error::Other(error)) => Some(Err(error)),
            Err(nb::Error::WouldBlock) => {
                self.clock().wake_by(self.clock().now() + ASK_AGAIN_AFTER);
                None
            }
        })
        .await
    }

    async fn receive(&mut self) -> Result<SimpleFrame, slcan::Stalled> {
        until_found(|| match Can::receive(self) {
            Ok(frame) => Some(Ok(frame)),
            Err(nb::Error::Other(error)) => Some(Err(error)),
            Err(nb::Error::WouldBlock) => None,
        })
        .await
    }
}
