//! An adapter between the firmware's serial port and the bus, less kind than a wire.

use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::thread;
use std::time::{Duration, Instant};

use super::{Failure, urgency};

/// How often it looks for bytes.
const LOOK_EVERY: Duration = Duration::from_micros(200);

/// What it does to what it carries.
#[derive(Clone, Copy, Debug)]
pub struct Adapter {
    /// It hands over what it received this often.
    pub bursts: Duration,
    /// It hands back what the firmware sends.
    pub echo: bool,
}

impl Adapter {
    /// Puts it between the firmware and the drives. Gives the drives' end. It works until either end is closed.
    ///
    /// # Errors
    /// The operating system's.
    pub(super) fn put_between(self, firmware: UnixStream) -> Result<UnixStream, Failure> {
        let (bus, drives_end) = UnixStream::pair()?;
        for stream in [&firmware, &bus, &drives_end] {
            stream.set_nonblocking(true)?;
        }
        thread::spawn(move || {
            urgency::take();
            // Either end was closed, and with that the test is over.
            let _ = self.carry(firmware, bus);
        });
        Ok(drives_end)
    }

    fn carry(self, mut firmware: UnixStream, mut bus: UnixStream) -> io::Result<()> {
        let mut held = Vec::new();
        let mut next = Instant::now();
        loop {
            let sent = received(&mut firmware)?;
            bus.write_all(&sent)?;
            if self.echo {
                held.extend(&sent);
            }
            held.extend(received(&mut bus)?);
            if Instant::now() >= next {
                next = Instant::now() + self.bursts;
                firmware.write_all(&held)?;
                held.clear();
            }
            thread::sleep(LOOK_EVERY);
        }
    }
}

/// What has come.
fn received(stream: &mut UnixStream) -> io::Result<Vec<u8>> {
    let mut chunk = [0; 256];
    match stream.read(&mut chunk) {
        Ok(0) => Err(ErrorKind::UnexpectedEof.into()),
        Ok(count) => Ok(chunk[..count].to_vec()),
        Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(Vec::new()),
        Err(error) => Err(error),
    }
}
