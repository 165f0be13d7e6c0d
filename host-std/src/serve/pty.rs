//! Replacements of a serial port: a pseudo-terminal, or a socket.

use std::collections::VecDeque;
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
    held: Option<Held>,
}

/// The bytes on their way in lock-step, where nothing may depend on when they are read.
#[derive(Debug, Default)]
struct Held {
    /// Written by programs, and taken in.
    taken: VecDeque<u8>,
    /// For programs, as soon as there is room.
    unsent: VecDeque<u8>,
}

/// So much of what a program has written is taken in while time stands, bytes. The rest waits in the pseudo-terminal,
/// which holds the program up.
const MOST_TAKEN: usize = 1 << 20;
/// More than this is not kept for programs that do not read, bytes.
const MOST_UNSENT: usize = 1 << 20;

impl Pty {
    /// Opens a new pseudo-terminal in raw mode and at this bit rate: bytes pass unchanged, also for programs that set
    /// nothing. Returns also the path where programs find it.
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
        Ok((Self { device, port: Some(port), held: None }, path))
    }

    /// A socket in place of a pseudo-terminal. It ends when the program goes.
    pub(super) fn on(stream: UnixStream) -> io::Result<Self> {
        stream.set_nonblocking(true)?;
        Ok(Self { device: stream.into(), port: None, held: None })
    }

    /// Lets the next program in. Otherwise the port stays locked after a program that has asked to be alone, for as
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

    /// From now on, what programs write is read only when it was [taken in](Self::take_in), and what they have
    /// no room for is kept for them.
    pub(super) fn hold(&mut self) {
        self.held = Some(Held::default());
    }

    /// Takes in what programs have written.
    pub(super) fn take_in(&mut self) -> io::Result<()> {
        let mut chunk = [0; 4096];
        while self.held.as_ref().is_some_and(|held| held.taken.len() < MOST_TAKEN) {
            let length = self.read_device(&mut chunk)?;
            match &mut self.held {
                Some(held) if length > 0 => held.taken.extend(&chunk[..length]),
                _ => break,
            }
        }
        self.write(&[])
    }

    /// What a program has written; 0 if nothing. An error if a socket's program has gone.
    pub(super) fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match &mut self.held {
            Some(held) => io::Read::read(&mut held.taken, buffer),
            None => self.read_device(buffer),
        }
    }

    fn read_device(&self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            match rustix::io::read(&self.device, &mut *buffer) {
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) => return Ok(0),
                Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
                done => return Ok(done?),
            }
        }
    }

    /// Hands bytes to the program. If there is no room because it does not read, they are lost.
    pub(super) fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        let Some(Held { unsent, .. }) = &mut self.held else {
            return write_device(&self.device, bytes).map(|_| ());
        };
        if unsent.len() + bytes.len() <= MOST_UNSENT {
            unsent.extend(bytes);
        }
        let sent = write_device(&self.device, unsent.make_contiguous())?;
        unsent.drain(..sent);
        Ok(())
    }
}

/// Returns for how many bytes there was room.
fn write_device(device: &OwnedFd, bytes: &[u8]) -> io::Result<usize> {
    let mut sent = 0;
    while let Some(rest) = bytes.get(sent..).filter(|rest| !rest.is_empty()) {
        match rustix::io::write(device, rest) {
            Err(Errno::INTR) => {}
            Ok(0) | Err(Errno::AGAIN) => break,
            done => sent += done?,
        }
    }
    Ok(sent)
}

impl AsFd for Pty {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.device.as_fd()
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;

    #[test]
    fn endless_writer_is_held_up_while_time_stands_and_loses_nothing() {
        let (mut program, device) = UnixStream::pair().unwrap();
        program.set_nonblocking(true).unwrap();
        let mut pty = Pty::on(device).unwrap();
        pty.hold();
        let taken = |pty: &Pty| pty.held.as_ref().unwrap().taken.len();
        let (mut sent, mut before) = (0, 0);
        loop {
            while let Ok(length) = program.write(&[7; 4096]) {
                sent += length;
            }
            pty.take_in().unwrap();
            if taken(&pty) == before {
                break;
            }
            before = taken(&pty);
            assert!(before < MOST_TAKEN + 4096, "{before}");
        }
        assert!(sent > MOST_TAKEN, "{sent}");
        let (mut got, mut chunk) = (0, [0; 4096]);
        loop {
            let length = pty.read(&mut chunk).unwrap();
            got += length;
            pty.take_in().unwrap();
            if length == 0 && taken(&pty) == 0 {
                break;
            }
        }
        assert_eq!(got, sent);
    }

    #[test]
    fn one_mebibyte_of_unread_output_is_kept_in_order_while_time_stands() {
        let (mut program, device) = UnixStream::pair().unwrap();
        program.set_nonblocking(true).unwrap();
        let mut pty = Pty::on(device).unwrap();
        pty.hold();
        for number in 0_u16..4_000 {
            pty.write(&number.to_le_bytes().repeat(512)).unwrap();
            assert!(pty.held.as_ref().unwrap().unsent.len() <= 1 << 20);
        }
        assert_eq!(pty.held.as_ref().unwrap().unsent.len(), 1 << 20);
        let (mut got, mut chunk) = (Vec::new(), [0; 4096]);
        while let Ok(length) = io::Read::read(&mut program, &mut chunk) {
            got.extend_from_slice(&chunk[..length]);
            pty.take_in().unwrap();
        }
        assert!(got.len() > 1 << 20);
        for (place, bytes) in got.chunks(1024).enumerate() {
            assert_eq!(bytes, (place as u16).to_le_bytes().repeat(512));
        }
    }
}
