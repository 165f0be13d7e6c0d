//! Pseudo-terminals: a serial port at one end, whatever plays the other device at the other.

use std::fs::File;
use std::path::PathBuf;

use rustix::pty::{OpenptFlags, openpt, ptsname, unlockpt};

/// The device's end, and the path of the serial port.
pub(crate) fn open() -> (File, PathBuf) {
    let device = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    unlockpt(&device).unwrap();
    let path = ptsname(&device, Vec::new()).unwrap().into_string().unwrap();
    (File::from(device), path.into())
}
