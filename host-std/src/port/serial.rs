//! RS485 over serial ports.

use std::os::fd::{AsFd, BorrowedFd};
use std::path::Path;
use std::time::Duration;

use embedded_io::{ErrorType, Read, ReadReady, Write};
use rustix::event::PollFlags;

use crate::port::clock::since_boot;
use crate::port::tty::Tty;
use crate::port::{HostClock, PortError};

/// How long a port may take no byte. At 1200 bit/s a frame of 13 bytes takes 110 ms.
const LONGEST_STALL: Duration = Duration::from_secs(1);

/// A serial port with an RS485 transceiver that switches its direction by itself, as USB adapters do.
/// Ports of boards whose transceiver hangs on RTS need the kernel's RS485 mode, set in the device tree
/// (`linux,rs485-enabled-at-boot-time`).
///
/// 8N1, any bit rate that the port can run at, pseudo-terminals included; no other program can open it
/// meanwhile. [`flush`](Write::flush) waits until the bytes have left the kernel and the port's own
/// send register; those that a USB adapter still holds it cannot see.
///
/// A USB adapter that collects what it receives, up to 16 ms for some, is told not to, where its driver
/// offers that and the user may: otherwise see [`SlowAdapter`](crate::port::SlowAdapter).
#[derive(Debug)]
pub struct Rs485 {
    tty: Tty,
}

impl Rs485 {
    /// Opens the serial port at this path at `bit_rate` bit/s.
    ///
    /// # Errors
    /// [`PortError`]: there is no such port, it is no serial port, the user may not open it, another
    /// program has it open, or it cannot run at this rate.
    pub fn open(path: impl AsRef<Path>, bit_rate: u32) -> Result<Self, PortError> {
        Ok(Self { tty: Tty::open(path.as_ref(), bit_rate)? })
    }

    /// A clock that waits for this port.
    ///
    /// # Errors
    /// [`PortError::Os`] when the operating system has no file descriptor left.
    pub fn clock(&self) -> Result<HostClock, PortError> {
        HostClock::for_port(self).map_err(|error| PortError::os(self.tty.name(), error))
    }
}

impl AsFd for Rs485 {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.tty.as_fd()
    }
}

impl ErrorType for Rs485 {
    type Error = PortError;
}

impl ReadReady for Rs485 {
    fn read_ready(&mut self) -> Result<bool, PortError> {
        self.tty.wait(PollFlags::IN, Some(Duration::ZERO))
    }
}

impl Read for Rs485 {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, PortError> {
        if buf.is_empty() {
            return Ok(0);
        }
        loop {
            if let Some(length) = self.tty.read(buf)? {
                return Ok(length);
            }
            self.tty.wait(PollFlags::IN, None)?;
        }
    }
}

impl Write for Rs485 {
    /// Waits for room, a second at the most; then throws away what the port holds, for a command that
    /// leaves so late is stale.
    fn write(&mut self, buf: &[u8]) -> Result<usize, PortError> {
        if buf.is_empty() {
            return Ok(0);
        }
        let begun = since_boot();
        loop {
            let written = self.tty.write(buf)?;
            if written > 0 {
                return Ok(written);
            }
            let has_room = self.tty.wait(PollFlags::OUT, Some(LONGEST_STALL))?;
            // Room may come late to a program or a machine that was held meanwhile.
            if !has_room || since_boot().saturating_sub(begun) > LONGEST_STALL {
                self.tty.discard_output()?;
                return Err(PortError::Stalled(self.tty.name().to_owned()));
            }
        }
    }

    fn flush(&mut self) -> Result<(), PortError> {
        self.tty.drain()
    }
}
