//! A master's port on an RS485 line.

use embedded_io::{ErrorKind, ErrorType, Read, ReadReady, Write, WriteReady};
use myactuator_protocol_core::time::Duration;

use super::Rs485Line;
use crate::sim::bus::Port;
use crate::sim::bus::kernel::Kernel;
use crate::sim::bus::medium::sealed::Bus as _;
use crate::sim::bus::nanos::from_duration;
use crate::sim::bus::waiting::Awaited;

/// How long calls wait.
const GIVE_UP: Duration = Duration::from_secs(1);

/// The errors of a port's calls.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SerialError {
    /// For a second nothing came, or nothing could be sent.
    #[error(
        "expected bytes on the line, found none within {GIVE_UP}: check that somebody answers, or wait \
         longer"
    )]
    TimedOut,
}

impl embedded_io::Error for SerialError {
    fn kind(&self) -> ErrorKind {
        ErrorKind::TimedOut
    }
}

/// A master's port on a simulated RS485 line, with a transceiver and buffers of its own.
///
/// What one call of `write` takes is one message, which faults strike as a whole. Messages that are
/// written before the line is idle again follow each other without a gap.
///
/// Its blocking calls let time go on until they are done, but for at most a second. The
/// async ones wait for as long as it takes, and may be dropped: what has arrived is left for the next call.
pub type SerialPort = Port<Rs485Line>;

impl SerialPort {
    /// How many received bytes were lost because earlier ones had not been read.
    pub fn overflows(&self) -> u64 {
        self.world.with(|kernel| kernel.received(self.station.0).1)
    }

    fn wait<T>(
        &self,
        done: impl FnMut(&mut Kernel<Rs485Line>) -> Option<T>,
    ) -> Result<T, SerialError> {
        let until = self.world.now_ns().saturating_add(from_duration(GIVE_UP));
        self.world.wait(until, done).ok_or(SerialError::TimedOut)
    }
}

impl ErrorType for SerialPort {
    type Error = SerialError;
}

impl ReadReady for SerialPort {
    fn read_ready(&mut self) -> Result<bool, SerialError> {
        Ok(self.world.with(|kernel| kernel.has_received(self.station.0)))
    }
}

impl WriteReady for SerialPort {
    fn write_ready(&mut self) -> Result<bool, SerialError> {
        Ok(self.world.with(|kernel| kernel.has_room(self.station.0)))
    }
}

impl Read for SerialPort {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, SerialError> {
        let station = self.station.0;
        self.wait(|kernel| read(kernel, station, buf))
    }
}

impl Write for SerialPort {
    fn write(&mut self, buf: &[u8]) -> Result<usize, SerialError> {
        let station = self.station.0;
        self.wait(|kernel| write(kernel, station, buf))
    }

    /// Waits until the last byte has left and the station listens again.
    fn flush(&mut self) -> Result<(), SerialError> {
        self.wait(|kernel| kernel.bus.is_drained(self.station.0).then_some(()))
    }
}

/// Takes what was received, if anything.
fn read(kernel: &mut Kernel<Rs485Line>, station: usize, buf: &mut [u8]) -> Option<usize> {
    let mut count = 0;
    while count < buf.len()
        && let Some(unit) = kernel.read(station)
    {
        // Units are single bytes.
        buf[count] = unit[0];
        count += 1;
    }
    (count > 0 || buf.is_empty()).then_some(count)
}

/// Hands over what there is room for, if any.
fn write(kernel: &mut Kernel<Rs485Line>, station: usize, buf: &[u8]) -> Option<usize> {
    let count = buf.len().min(kernel.bus.room(station));
    // If there is no room, this notes that a caller waits for it. An empty message always has room.
    let message = if count == 0 { buf } else { &buf[..count] };
    kernel.submit(station, message.to_vec()).then_some(count)
}

impl embedded_io_async::Read for SerialPort {
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, SerialError> {
        let attempt = |kernel: &mut _| read(kernel, self.station.0, buf);
        Ok(self.until_done(Kernel::has_received, attempt).await)
    }
}

impl embedded_io_async::Write for SerialPort {
    async fn write(&mut self, buf: &[u8]) -> Result<usize, SerialError> {
        let attempt = |kernel: &mut _| write(kernel, self.station.0, buf);
        Ok(self.until_done(Kernel::has_room, attempt).await)
    }

    /// Waits until the last byte has left and the station listens again.
    async fn flush(&mut self) -> Result<(), SerialError> {
        let is_drained = |kernel: &Kernel<Rs485Line>, station| kernel.bus.is_drained(station);
        self.world.come(Awaited::Station(self.station.0, is_drained)).await;
        Ok(())
    }
}
