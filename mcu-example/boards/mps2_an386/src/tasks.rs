//! Waiting as a task, for the async programs.

use core::future::poll_fn;
use core::task::Poll;

use embassy_sync::waitqueue::AtomicWaker;
use embedded_can::nb::Can;
use myactuator_protocol_core::io::{AsyncCan, AsyncClock, Clock as _};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::wire::can::SimpleFrame;

use crate::clock::Clock;
use crate::slcan::{self, Slcan};

/// The one task that waits for a byte, for room or for the time. Any interrupt wakes it, and it checks again everything
/// that it waits for.
static TASK: AtomicWaker = AtomicWaker::new();

/// Wakes it. For interrupts.
pub(crate) fn wake() {
    TASK.wake();
}

/// Waits until a check finds something. The task checks whenever something has happened.
pub(crate) async fn until_found<T>(mut look: impl FnMut() -> Option<T>) -> T {
    poll_fn(|context| {
        // Before the check, so that nothing falls between the two.
        TASK.register(context.waker());
        look().map_or(Poll::Pending, Poll::Ready)
    })
    .await
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

/// How soon to try again with an adapter that took nothing: some of what it waits for ends only with time.
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
