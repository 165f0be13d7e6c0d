//! How long USB adapters keep what they have received before they hand it over.
//!
//! By default adapters with FTDI chips collect for 16 ms, which is longer than a master waits for a reply. Their driver
//! has a file with this time, which root may write. It keeps what was written until the adapter is unplugged.

use std::fmt;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Where the kernel has a folder for each USB serial adapter.
pub(super) const ADAPTERS: &str = "/sys/bus/usb-serial/devices";
/// The shortest that drivers take, ms.
const SHORTEST_MS: u64 = 1;

/// A USB serial adapter that keeps what it has received for longer than it must. It displays as a sentence
/// that says what to do about it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SlowAdapter {
    timer: Timer,
    ms: u64,
}

impl SlowAdapter {
    /// The adapter of this serial port, if its driver says that it is slow. If the user has the permission, opening the
    /// port has already made it fast.
    pub fn at(port: &Path) -> Option<Self> {
        Self::among(Path::new(ADAPTERS), port)
    }

    /// As [`at`](Self::at), with the folder that has one of each adapter.
    fn among(adapters: &Path, port: &Path) -> Option<Self> {
        Timer::of(adapters, port)?.too_long()
    }
}

impl fmt::Display for SlowAdapter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "the adapter hands over what it received every {} ms only: make that 1 ms with \
             'echo 1 | sudo tee {}'",
            self.ms,
            self.timer.0.display()
        )
    }
}

/// Makes the adapter of this serial port hand over what it has received as soon as it can, if its
/// driver has a timer for that and the user may set it.
pub(super) fn shorten(adapters: &Path, port: &Path) {
    if let Some(slow) = SlowAdapter::among(adapters, port) {
        slow.timer.shorten();
    }
}

/// A driver's file with the time in milliseconds.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Timer(PathBuf);

impl Timer {
    /// The timer of a serial port. The port may be a link, as those in `/dev/serial/by-id` are.
    fn of(adapters: &Path, port: &Path) -> Option<Self> {
        let device = fs::canonicalize(port).ok()?;
        let timer = adapters.join(device.file_name()?).join("latency_timer");
        timer.is_file().then_some(Self(timer))
    }

    fn too_long(self) -> Option<SlowAdapter> {
        let ms = fs::read_to_string(&self.0).ok()?.trim().parse().ok()?;
        (ms > SHORTEST_MS).then_some(SlowAdapter { timer: self, ms })
    }

    /// Sets the shortest time. Without the permission nothing changes.
    fn shorten(&self) {
        let timer = fs::File::options().write(true).truncate(true).open(&self.0);
        let _ = timer.and_then(|mut timer| write!(timer, "{SHORTEST_MS}"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::{PermissionsExt as _, symlink};

    /// A port by name and by link, and the folder of its adapter.
    struct Made {
        _folder: tempfile::TempDir,
        adapters: PathBuf,
        timer: PathBuf,
        port: PathBuf,
        link: PathBuf,
    }

    fn made(timer: &str) -> Made {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let (adapters, port, link) = (path("devices"), path("ttyUSB3"), path("usb-FTDI-if00"));
        fs::create_dir_all(adapters.join("ttyUSB3")).unwrap();
        fs::write(&port, "").unwrap();
        symlink(&port, &link).unwrap();
        let file = adapters.join("ttyUSB3/latency_timer");
        fs::write(&file, timer).unwrap();
        Made { _folder: folder, adapters, timer: file, port, link }
    }

    #[test]
    fn a_slow_adapter_is_made_fast() {
        let made = made("16\n");
        for path in [&made.port, &made.link] {
            let slow = Timer::of(&made.adapters, path).unwrap().too_long().unwrap();
            let remedy = format!("'echo 1 | sudo tee {}'", made.timer.display());
            assert!(slow.to_string().contains("every 16 ms"), "{slow}");
            assert!(slow.to_string().ends_with(&remedy), "{slow}");
        }
        Timer::of(&made.adapters, &made.link).unwrap().shorten();
        assert_eq!(fs::read_to_string(&made.timer).unwrap(), "1");
        assert_eq!(Timer::of(&made.adapters, &made.port).unwrap().too_long(), None);
    }

    #[test]
    fn missing_or_read_only_latency_timer_is_no_error() {
        let made = made("what a driver never says\n");
        assert_eq!(Timer::of(&made.adapters, &made.port).unwrap().too_long(), None);
        fs::set_permissions(&made.timer, fs::Permissions::from_mode(0o444)).unwrap();
        Timer(made.timer.clone()).shorten();
        fs::remove_file(&made.timer).unwrap();
        Timer(made.timer.clone()).shorten();
        assert!(!made.timer.exists(), "nothing is made that no driver has");
        assert_eq!(Timer::of(&made.adapters, &made.port), None);
        assert_eq!(SlowAdapter::at(Path::new("/dev/null")), None);
        shorten(&made.adapters, Path::new("/dev/there-is-no-such-port"));
    }
}
