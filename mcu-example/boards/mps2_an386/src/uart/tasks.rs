//! The same UART for tasks: embedded-io-async.

use embedded_io_async::{Read, Write};
use myactuator_protocol_core::io::{AsyncClock as _, Clock as _};
use myactuator_protocol_core::time::Duration;

use super::{Stalled, Uart};
use crate::tasks::until_found;

/// A UART that sends nothing for this long never will. It is less than the time after which the master's loop gives up
/// waiting: then what was written might be sent later.
const LONGEST_STALL: Duration = Duration::from_millis(10);

impl Read for Uart {
    /// Dropping the future loses nothing: bytes leave the queue only when it completes.
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, Stalled> {
        if buf.is_empty() {
            return Ok(0);
        }
        until_found(|| self.received.ready().then_some(())).await;
        Ok(self.take_received(buf))
    }
}

impl Write for Uart {
    async fn write(&mut self, buf: &[u8]) -> Result<usize, Stalled> {
        if buf.is_empty() {
            return Ok(0);
        }
        self.until_sent(|uart| uart.room() > 0).await?;
        Ok(self.try_write(buf))
    }

    /// Waits until the last byte was sent.
    async fn flush(&mut self) -> Result<(), Stalled> {
        self.until_sent(Self::has_sent).await?;
        // The UART's buffer is empty as soon as it begins to send its last byte.
        let until = self.clock.now() + self.byte_time;
        self.clock.wait_until(until).await;
        Ok(())
    }
}

impl Uart {
    /// Waits until bytes are sent, but not forever. After that the rest is dropped, since it is stale.
    async fn until_sent(&mut self, is_over: impl Fn(&Self) -> bool) -> Result<(), Stalled> {
        let (mut left, mut since) = (self.unsent.len(), self.clock.now());
        until_found(|| {
            let now = self.clock.now();
            if self.unsent.len() != left {
                (left, since) = (self.unsent.len(), now);
            }
            if is_over(self) {
                Some(Ok(()))
            } else if now - since > LONGEST_STALL {
                self.discard_unsent();
                Some(Err(Stalled))
            } else {
                self.clock.wake_by(since + LONGEST_STALL);
                None
            }
        })
        .await
    }
}
