//! What stands in for a serial port: a pseudo-terminal, or a socket.

use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;

use rustix::io::Errno;
use rustix::pty::{OpenptFlags, grantpt, ioctl_tiocgptpeer, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, ioctl_tiocnxcl, tcgetattr, tcsetattr};

/// The device's end of a serial port. Programs open the other end of a pseudo-terminal by its path, one
/// after the other as they like.
#[derive(Debug)]
pub(super) struct Pty {
    device: OwnedFd,
    /// A pseudo-terminal's end for programs, kept open so that the device's end does not fail while no
    /// program is there.
    port: Option<OwnedFd>,
}

impl Pty {
    /// A new one in raw mode and at this bit rate: bytes go through as they are, also of programs that set
    /// nothing. With the path where programs find it.
    pub(super) fn open(bit_rate: u32) -> io::Result<(Self, PathBuf)> {
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let device = openpt(flags)?;
        grantpt(&device)?;
        unlockpt(&device)?;
        let path = ptsname(&device, Vec::new())?;
        let path = PathBuf::from(path.into_string().map_err(io::Error::other)?);
        let port = ioctl_tiocgptpeer(&device, flags)?;
        let mut settings = tcgetattr(&port)?;
        settings.make_raw();
        settings.set_speed(bit_rate)?;
        tcsetattr(&port, OptionalActions::Now, &settings)?;
        rustix::io::ioctl_fionbio(&device, true)?;
        Ok((Self { device, port: Some(port) }, path))
    }

    /// A socket in place of a pseudo-terminal. It ends when the program goes.
    pub(super) fn on(stream: UnixStream) -> io::Result<Self> {
        stream.set_nonblocking(true)?;
        Ok(Self { device: stream.into(), port: None })
    }

    /// Lets the next program in: the port of one that asked to be alone stays locked otherwise, as
    /// long as this end is open.
    pub(super) fn admit_all(&self) -> io::Result<()> {
        Ok(self.port.as_ref().map_or(Ok(()), ioctl_tiocnxcl)?)
    }

    /// The bit rate that programs have set, in bit/s; `None` for a socket, and for a line that is hung up.
    pub(super) fn bit_rate(&self) -> io::Result<Option<u32>> {
        if self.port.is_none() {
            return Ok(None);
        }
        let set = tcgetattr(&self.device)?.output_speed();
        Ok((set > 0).then_some(set))
    }

    /// What a program has written; 0 if nothing. An error if a socket's program has gone.
    pub(super) fn read(&self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            match rustix::io::read(&self.device, &mut *buffer) {
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) => return Ok(0),
                Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
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
