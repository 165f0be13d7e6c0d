//! A serial port for one program alone, read and written without blocking.

use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::Path;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{FlockOperation, Mode, OFlags};
use rustix::io::{Errno, retry_on_intr};
use rustix::termios::{
    ControlModes, InputModes, OptionalActions, QueueSelector, tcflush, tcgetattr, tcsetattr,
};

use crate::port::{PortError, latency};

/// A port cannot run at a rate if its clock makes one that is off by more than one part in this many.
const LARGEST_RATE_ERROR: u32 = 40;

#[derive(Debug)]
pub(super) struct Tty {
    port: Arc<OwnedFd>,
    name: String,
}

impl Tty {
    /// Opens a serial port in raw mode, eight data bits, no parity, one stop bit (8N1).
    pub(super) fn open(path: &Path, bit_rate: u32) -> Result<Self, PortError> {
        Self::open_among(Path::new(latency::ADAPTERS), path, bit_rate)
    }

    /// As [`open`](Self::open), with the folder that has one of each USB adapter.
    fn open_among(adapters: &Path, path: &Path, bit_rate: u32) -> Result<Self, PortError> {
        let name = path.display().to_string();
        let failed = |error: Errno| explain(&name, error.into());
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let port = rustix::fs::open(path, flags, Mode::empty()).map_err(failed)?;
        if !rustix::termios::isatty(&port) {
            return Err(PortError::NotASerialPort(name));
        }
        // The lock keeps out programs that lock as well, also those of root. Exclusive mode keeps out all
        // others except root's.
        rustix::fs::flock(&port, FlockOperation::NonBlockingLockExclusive)
            .and_then(|()| rustix::termios::ioctl_tiocexcl(&port))
            .map_err(failed)?;
        let tty = Self { port: Arc::new(port), name };
        tty.configure(bit_rate)?;
        latency::shorten(adapters, path);
        Ok(tty)
    }

    /// Sets the mode at once. Waiting until what the port holds has left may take for ever. That is from a program that
    /// is gone, and is thrown away before the new mode could release what flow control has held back.
    fn configure(&self, bit_rate: u32) -> Result<(), PortError> {
        let failed = |error: Errno| explain(&self.name, error.into());
        let unable = || PortError::LineRate { port: self.name.clone(), bit_rate };
        tcflush(&self.port, QueueSelector::IOFlush).map_err(failed)?;
        let mut wanted = tcgetattr(&self.port).map_err(failed)?;
        wanted.make_raw();
        wanted.input_modes = InputModes::IGNBRK | InputModes::IGNPAR;
        wanted.control_modes.remove(ControlModes::CSTOPB | ControlModes::CRTSCTS);
        // Otherwise the line hangs up without a carrier, which no adapter has.
        wanted.control_modes |= ControlModes::CLOCAL | ControlModes::CREAD;
        wanted.set_speed(bit_rate).map_err(|_| unable())?;
        tcsetattr(&self.port, OptionalActions::Now, &wanted).map_err(|_| unable())?;
        // A driver sets what it can, and reports that.
        let set = tcgetattr(&self.port).map_err(failed)?;
        let frame = ControlModes::CSIZE | ControlModes::CSTOPB | ControlModes::PARENB;
        let is_framed = set.control_modes & frame == wanted.control_modes & frame;
        let rate_is_off_by = set.output_speed().abs_diff(bit_rate);
        if !is_framed || rate_is_off_by > bit_rate / LARGEST_RATE_ERROR {
            return Err(unable());
        }
        tcflush(&self.port, QueueSelector::IOFlush).map_err(failed)
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// Why the port, which was open, fails.
    pub(super) fn failed(&self, error: impl Into<io::Error>) -> PortError {
        match explain(&self.name, error.into()) {
            PortError::NoSuchPort(name) => PortError::PortGone(name),
            other => other,
        }
    }

    /// Reads what has arrived; `None` if nothing has.
    pub(super) fn read(&self, buffer: &mut [u8]) -> Result<Option<usize>, PortError> {
        match retry_on_intr(|| rustix::io::read(&self.port, &mut *buffer)) {
            Ok(0) => Err(PortError::PortGone(self.name.clone())),
            Ok(length) => Ok(Some(length)),
            Err(Errno::AGAIN) => Ok(None),
            Err(error) => Err(self.failed(error)),
        }
    }

    /// Returns how many of these bytes the port takes: none if there is no room.
    pub(super) fn write(&self, bytes: &[u8]) -> Result<usize, PortError> {
        match retry_on_intr(|| rustix::io::write(&self.port, bytes)) {
            Ok(length) => Ok(length),
            Err(Errno::AGAIN) => Ok(0),
            Err(error) => Err(self.failed(error)),
        }
    }

    /// Waits until one of these flags is set, or the port fails; false after the time-out. `None` waits for
    /// ever.
    pub(super) fn wait(
        &self,
        flags: PollFlags,
        timeout: Option<Duration>,
    ) -> Result<bool, PortError> {
        let deadline = timeout.map(|timeout| Instant::now() + timeout);
        let ready = retry_on_intr(|| {
            let left = deadline.map(|deadline| {
                let left = deadline.saturating_duration_since(Instant::now());
                Timespec::try_from(left).unwrap_or_default()
            });
            poll(&mut [PollFd::new(&self.port, flags)], left.as_ref())
        });
        ready.map(|ready| ready > 0).map_err(|error| self.failed(error))
    }

    pub(super) fn discard_output(&self) -> Result<(), PortError> {
        tcflush(&self.port, QueueSelector::OFlush).map_err(|error| self.failed(error))
    }

    pub(super) fn discard_input(&self) -> Result<(), PortError> {
        tcflush(&self.port, QueueSelector::IFlush).map_err(|error| self.failed(error))
    }
}

/// Releases the port. Exclusive mode outlives the program if the terminal does: a pseudo-terminal, or one that another
/// program has open. The lock lives as long as any copy of the file descriptor: that of a clock, or of a wait that was
/// given up.
impl Drop for Tty {
    /// Gives the port back to others. A thread closes it, as that waits until all that was written has left: 30 s where
    /// an adapter takes nothing. Meanwhile a user would not learn that a motor has not confirmed its stop.
    fn drop(&mut self) {
        // For a port that has gone there is nothing to release.
        let _ = rustix::termios::ioctl_tiocnxcl(&self.port);
        let _ = rustix::fs::flock(&self.port, FlockOperation::Unlock);
        let port = Arc::clone(&self.port);
        let closing = thread::Builder::new().name("myactuator-close".to_owned());
        let _ = closing.spawn(move || {
            while Arc::strong_count(&port) > 1 {
                thread::sleep(Duration::from_millis(1));
            }
        });
    }
}

impl AsFd for Tty {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.port.as_fd()
    }
}

fn explain(name: &str, error: io::Error) -> PortError {
    let port = || name.to_owned();
    match Errno::from_io_error(&error) {
        // A device file without a device behind it reports an input/output error.
        Some(Errno::NOENT | Errno::NXIO | Errno::NODEV | Errno::IO) => {
            PortError::NoSuchPort(port())
        }
        Some(Errno::ACCESS | Errno::PERM) => PortError::NotPermitted(port()),
        Some(Errno::BUSY | Errno::AGAIN) => PortError::InUse(port()),
        Some(Errno::NOTTY | Errno::ISDIR | Errno::NOTDIR) => PortError::NotASerialPort(port()),
        _ => PortError::os(name, error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::{self, File};

    use rustix::pty::{OpenptFlags, openpt, ptsname, unlockpt};
    use rustix::termios::{LocalModes, OutputModes, SpecialCodeIndex};

    /// The device's end of a line, and the path of the serial port.
    fn line() -> (OwnedFd, String) {
        let line = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        unlockpt(&line).unwrap();
        let path = ptsname(&line, Vec::new()).unwrap().into_string().unwrap();
        (line, path)
    }

    #[test]
    fn opening_a_port_makes_its_adapter_fast() {
        let (_line, path) = line();
        let path = Path::new(&path);
        let adapters = tempfile::tempdir().unwrap();
        let adapter = adapters.path().join(path.file_name().unwrap());
        fs::create_dir(&adapter).unwrap();
        let timer = adapter.join("latency_timer");
        fs::write(&timer, "16\n").unwrap();
        Tty::open_among(adapters.path(), path, 115_200).unwrap();
        assert_eq!(fs::read_to_string(&timer).unwrap(), "1");
    }

    #[test]
    fn open_port_replaces_all_settings_of_an_earlier_program() {
        let (_line, path) = line();
        // Which keeps them, as a serial port does from one program to the next.
        let earlier = File::options().read(true).write(true).open(&path).unwrap();
        let mut settings = tcgetattr(&earlier).unwrap();
        settings.control_modes.remove(ControlModes::CLOCAL);
        settings.control_modes |= ControlModes::CSTOPB | ControlModes::CRTSCTS;
        settings.input_modes |= InputModes::IXON | InputModes::IXOFF | InputModes::ISTRIP;
        settings.special_codes[SpecialCodeIndex::VMIN] = 5;
        settings.set_speed(9600).unwrap();
        tcsetattr(&earlier, OptionalActions::Now, &settings).unwrap();
        // A rate that has no name.
        let tty = Tty::open(Path::new(&path), 1_234_567).unwrap();
        let settings = tcgetattr(&tty).unwrap();
        let modes = settings.control_modes;
        assert!(modes.contains(ControlModes::CLOCAL | ControlModes::CREAD | ControlModes::CS8));
        let others = ControlModes::CSTOPB | ControlModes::CRTSCTS | ControlModes::PARENB;
        assert!(!modes.intersects(others), "{modes:?}");
        let modes = settings.input_modes;
        assert_eq!(modes, InputModes::IGNBRK | InputModes::IGNPAR, "{modes:?}");
        assert_eq!(settings.output_modes & OutputModes::OPOST, OutputModes::empty());
        let modes = settings.local_modes;
        assert!(!modes.intersects(LocalModes::ICANON | LocalModes::ECHO | LocalModes::ISIG));
        assert_eq!(settings.special_codes[SpecialCodeIndex::VMIN], 1);
        assert_eq!((settings.input_speed(), settings.output_speed()), (1_234_567, 1_234_567));
    }
}
