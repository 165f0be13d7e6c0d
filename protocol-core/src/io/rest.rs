//! How a task waits between two rounds.

use core::future::poll_fn;
use core::pin::{Pin, pin};
use core::task::Poll;

use crate::io::clock::AsyncClock;
use crate::time::Instant;

/// Waits until something is received, which is kept in `received`, or until the time `until`. If a controller refuses
/// what it is offered, waits only until anything wakes the task: that may be the controller.
///
/// Other tasks get a turn in any case, even on a bus that babbles.
pub(super) async fn rest<T>(
    mut receive: Pin<&mut impl Future<Output = T>>,
    received: &mut Option<T>,
    clock: &mut impl AsyncClock,
    until: Option<Instant>,
    is_refused: bool,
) {
    let mut timer = pin!(wait(clock, until));
    let (mut has_waited, mut is_over) = (false, false);
    poll_fn(|context| {
        is_over |= has_waited && is_refused;
        if !is_over {
            if let Poll::Ready(it) = receive.as_mut().poll(context) {
                *received = Some(it);
                is_over = true;
            } else {
                is_over = timer.as_mut().poll(context).is_ready();
            }
        }
        match (is_over, has_waited) {
            (true, true) => return Poll::Ready(()),
            (true, false) => context.waker().wake_by_ref(),
            (false, _) => {}
        }
        has_waited = true;
        Poll::Pending
    })
    .await;
}

/// Waits until `until`, or for ever.
async fn wait(clock: &mut impl AsyncClock, until: Option<Instant>) {
    match until {
        Some(until) => clock.wait_until(until).await,
        None => core::future::pending().await,
    }
}
