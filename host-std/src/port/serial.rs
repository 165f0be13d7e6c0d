//! RS485 over serial ports.

use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::Path;
use std::time::Duration;

use embedded_io::{ErrorType, Read, ReadReady, Write};
use rustix::event::PollFlags;
use rustix::io::retry_on_intr;
use rustix::termios::tcdrain;

use crate::port::clock::since_boot;
use crate::port::drain::Drain;
use crate::port::tty::Tty;
use crate::port::{HostClock, PortError};

/// How long a port may take no bytes, or keep those that it has taken. At 1200 bit/s a frame of 13 bytes takes 110 ms.
const LONGEST_STALL: Duration = Duration::from_secs(1);

/// A serial port with an RS485 transceiver that switches its direction on its own, as USB adapters do.
/// A port whose transceiver is switched by RTS needs the kernel's RS485 mode, set in the device tree
/// (`linux,rs485-enabled-at-boot-time`).
///
/// It runs 8N1, at any bit rate of the port; a pseudo-terminal will do, too. No other program can open the port
/// meanwhile. [`flush`](Write::flush) waits until the bytes have left the kernel and the port's own
/// send register; it cannot see bytes that a USB adapter still holds.
///
/// Neither writing nor flushing waits for longer than a second. What the port still holds then is thrown away, as
/// far as its driver does that, and nothing more is written before the rest has left. A thread waits for that; it
/// has the scheduling of the thread that opens the port.
///
/// Some USB adapters collect what they receive, for up to 16 ms. They are told not to, if the driver
/// offers that and the user has the permission; otherwise see [`SlowAdapter`](crate::port::SlowAdapter).
#[derive(Debug)]
pub struct Rs485 {
    tty: Tty,
    drain: Drain<OwnedFd>,
    /// `read_ready` has said that there are bytes, and none was read since.
    is_promised: bool,
}

impl Rs485 {
    /// Opens the serial port at this path at `bit_rate` bit/s.
    ///
    /// # Errors
    /// [`PortError`]: there is no such port; it is no serial port; the user may not open it; another
    /// program has it open; or it cannot run at this rate.
    pub fn open(path: impl AsRef<Path>, bit_rate: u32) -> Result<Self, PortError> {
        let tty = Tty::open(path.as_ref(), bit_rate)?;
        let drain = Drain::new(|port: &OwnedFd| retry_on_intr(|| tcdrain(port)));
        let drain = drain.map_err(|error| PortError::os(tty.name(), error))?;
        Ok(Self { tty, drain, is_promised: false })
    }

    /// A clock that waits for this port.
    ///
    /// # Errors
    /// [`PortError::Os`] if the operating system has no file descriptor left.
    pub fn clock(&self) -> Result<HostClock, PortError> {
        HostClock::for_port(self).map_err(|error| PortError::os(self.tty.name(), error))
    }

    /// The port does not send, so what it holds is stale: throws that away.
    fn stalled(&self) -> PortError {
        match self.tty.discard_output() {
            Ok(()) => PortError::Stalled(self.tty.name().to_owned()),
            Err(error) => error,
        }
    }

    /// Writes what has waited since `begun`; time since the machine started.
    fn write_begun(&self, begun: Duration, buf: &[u8]) -> Result<usize, PortError> {
        loop {
            let written = self.tty.write(buf)?;
            if written > 0 {
                return Ok(written);
            }
            let has_room = self.tty.wait(PollFlags::OUT, Some(LONGEST_STALL))?;
            // If the program or the machine was suspended meanwhile, the room may come late.
            if !has_room || since_boot().saturating_sub(begun) > LONGEST_STALL {
                return Err(self.stalled());
            }
        }
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
        self.is_promised = self.tty.wait(PollFlags::IN, Some(Duration::ZERO))?;
        Ok(self.is_promised)
    }
}

impl Read for Rs485 {
    /// Waits until something has come. If [`read_ready`](ReadReady::read_ready) has said that there are bytes, and they
    /// are gone, another program reads the port, which is an error.
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, PortError> {
        if buf.is_empty() {
            return Ok(0);
        }
        let is_promised = std::mem::take(&mut self.is_promised);
        loop {
            if let Some(length) = self.tty.read(buf)? {
                return Ok(length);
            }
            if is_promised {
                return Err(PortError::InUse(self.tty.name().to_owned()));
            }
            self.tty.wait(PollFlags::IN, None)?;
        }
    }
}

impl Write for Rs485 {
    /// Waits for room, for at most a second. Then it throws away what the port holds, since a command that
    /// leaves so late is stale. While the port keeps bytes that were to be flushed, it fails at once.
    fn write(&mut self, buf: &[u8]) -> Result<usize, PortError> {
        if buf.is_empty() {
            return Ok(0);
        }
        if !self.drain.is_over() {
            return Err(self.stalled());
        }
        self.write_begun(since_boot(), buf)
    }

    fn flush(&mut self) -> Result<(), PortError> {
        let port = self.tty.as_fd().try_clone_to_owned();
        let port = port.map_err(|error| self.tty.failed(error))?;
        match self.drain.wait(port, LONGEST_STALL) {
            Ok(true) => Ok(()),
            Ok(false) => Err(self.stalled()),
            Err(error) => Err(self.tty.failed(error)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;
    use std::sync::mpsc::sync_channel;

    use rustix::pty::{OpenptFlags, openpt, ptsname, unlockpt};

    /// A pseudo-terminal passes everything on at once, so bytes that do not leave are simulated.
    #[test]
    fn flush_of_a_stalled_port_fails_and_nothing_follows_its_bytes() {
        let (mut line, path) = line();
        let mut port = Rs485::open(path, 115_200).unwrap();
        let (leave, left) = sync_channel::<()>(1);
        let wait = move |_: &OwnedFd| {
            let _ = left.recv();
            Ok(())
        };
        port.drain = Drain::new(wait).unwrap();

        port.write_all(b"stop").unwrap();
        let error = port.flush().unwrap_err();
        assert!(matches!(error, PortError::Stalled(_)), "{error}");
        let error = port.write_all(b"move").unwrap_err();
        assert!(matches!(error, PortError::Stalled(_)), "{error}");
        // It goes on when the adapter does.
        drop(leave);
        port.flush().unwrap();
        port.write_all(b"read").unwrap();
        port.flush().unwrap();
        let mut heard = [0; 8];
        std::io::Read::read_exact(&mut line, &mut heard).unwrap();
        assert_eq!(&heard, b"stopread");
    }

    #[test]
    fn room_that_comes_after_a_suspension_takes_nothing_stale() {
        let (mut line, path) = line();
        let port = Rs485::open(path, 115_200).unwrap();
        let fill = || while port.tty.write(&[0; 256]).unwrap() > 0 {};
        fill();
        // The terminal passes some of it on, and has room once more.
        std::thread::sleep(Duration::from_millis(50));
        fill();
        let device = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(20));
            let mut heard = [0; 4_096];
            std::iter::from_fn(|| std::io::Read::read(&mut line, &mut heard).ok()).count()
        });
        let begun = since_boot() - 2 * LONGEST_STALL;
        let error = port.write_begun(begun, b"move").unwrap_err();
        assert!(matches!(error, PortError::Stalled(_)), "{error}");
        drop(port);
        device.join().unwrap();
    }

    /// The device's end of a line, and the path of the serial port.
    fn line() -> (File, String) {
        let line = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        unlockpt(&line).unwrap();
        let path = ptsname(&line, Vec::new()).unwrap().into_string().unwrap();
        (File::from(line), path)
    }

    #[test]
    fn dropped_port_is_free_though_its_drain_still_waits() {
        let (_line, path) = line();
        let mut port = Rs485::open(&path, 115_200).unwrap();
        let (_leave, left) = sync_channel::<()>(1);
        port.drain = Drain::new(move |_: &OwnedFd| {
            let _ = left.recv();
            Ok(())
        })
        .unwrap();
        port.write_all(b"stop").unwrap();
        assert!(matches!(port.flush(), Err(PortError::Stalled(_))));
        drop(port);
        Rs485::open(&path, 115_200).unwrap();
    }

    #[test]
    fn read_whose_bytes_another_program_took_fails_instead_of_blocking() {
        let (mut line, path) = line();
        // It had the port open before, as those have that look at each new adapter.
        let mut thief = File::options().read(true).write(true).open(&path).unwrap();
        let mut port = Rs485::open(&path, 115_200).unwrap();
        std::io::Write::write_all(&mut line, b"reply").unwrap();
        assert!(port.tty.wait(PollFlags::IN, Some(Duration::from_secs(5))).unwrap());
        assert!(port.read_ready().unwrap());
        std::io::Read::read_exact(&mut thief, &mut [0; 5]).unwrap();
        let (sender, receiver) = sync_channel(1);
        std::thread::spawn(move || sender.send(port.read(&mut [0; 16])));
        let error = receiver.recv_timeout(Duration::from_secs(5)).expect("an end").unwrap_err();
        assert!(matches!(error, PortError::InUse(_)), "{error}");
    }

    #[test]
    fn port_that_is_gone_during_a_flush_is_reported_as_gone() {
        let (line, path) = line();
        let mut port = Rs485::open(&path, 115_200).unwrap();
        drop(line);
        let error = port.flush().unwrap_err();
        assert!(matches!(error, PortError::PortGone(_)), "{error}");
    }
}
