//! A pseudo-terminal that stands in for a serial port.

use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::{Path, PathBuf};

use rustix::io::Errno;
use rustix::pty::{OpenptFlags, grantpt, ioctl_tiocgptpeer, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, ioctl_tiocnxcl, tcgetattr, tcsetattr};

/// The device's end of a serial port. Programs open the other end by its path, one after the other
/// as they like.
#[derive(Debug)]
pub(super) struct Pty {
    device: OwnedFd,
    /// The programs' end, kept open so that the device's end does not fail while no program is there.
    port: OwnedFd,
    path: PathBuf,
}

impl Pty {
    /// A new one in raw mode: bytes go through as they are, also of programs that set nothing.
    pub(super) fn open() -> io::Result<Self> {
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let device = openpt(flags)?;
        grantpt(&device)?;
        unlockpt(&device)?;
        let path = ptsname(&device, Vec::new())?;
        let path = PathBuf::from(path.into_string().map_err(io::Error::other)?);
        let port = ioctl_tiocgptpeer(&device, flags)?;
        let mut settings = tcgetattr(&port)?;
        settings.make_raw();
        tcsetattr(&port, OptionalActions::Now, &settings)?;
        rustix::io::ioctl_fionbio(&device, true)?;
        Ok(Self { device, port, path })
    }

    /// Where programs find it.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Lets the next program in: the port of one that asked to be alone stays locked otherwise, as
    /// long as this end is open.
    pub(super) fn admit_all(&self) -> io::Result<()> {
        Ok(ioctl_tiocnxcl(&self.port)?)
    }

    /// What a program has written; 0 if nothing.
    pub(super) fn read(&self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            match rustix::io::read(&self.device, &mut *buffer) {
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) => return Ok(0),
                done => return Ok(done?),
            }
        }
    }

    /// Hands bytes to whoever reads. What finds no room because nobody does is lost.
    pub(super) fn write(&self, mut bytes: &[u8]) -> io::Result<()> {
        while !bytes.is_empty() {
            match rustix::io::write(&self.device, bytes) {
                Err(Errno::INTR) => {}
                Ok(0) | Err(Errno::AGAIN) => return Ok(()),
                done => bytes = bytes.get(done?..).unwrap_or_default(),
            }
        }
        Ok(())
    }
}

impl AsFd for Pty {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.device.as_fd()
    }
}
