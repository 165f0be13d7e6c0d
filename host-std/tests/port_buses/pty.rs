//! Pseudo-terminals: a serial port at one end, whatever plays the other device at the other.

use std::fs::File;
use std::path::PathBuf;

use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::time::Duration;
use rustix::pty::{OpenptFlags, openpt, ptsname, unlockpt};

/// The device's end, and the path of the serial port.
pub(crate) fn open() -> (File, PathBuf) {
    let device = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    unlockpt(&device).unwrap();
    let path = ptsname(&device, Vec::new()).unwrap().into_string().unwrap();
    (File::from(device), path.into())
}

/// A configuration that forgives a machine that is busy with other things: four seconds in all.
pub(crate) fn forgiving(config: Config) -> Config {
    Config {
        reply_timeout: Duration::from_millis(250),
        attempts: 15,
        // Who plays the drive here answers at once.
        shortest_response: Duration::ZERO,
        ..config
    }
}
