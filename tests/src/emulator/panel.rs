//! The button, and ways to break the firmware.

use std::io::{ErrorKind, Read as _, Write as _};
use std::os::unix::net::UnixStream;
use std::thread;
use std::time::Duration;

use super::Failure;

/// The length of a short press.
const SHORT: Duration = Duration::from_millis(80);
/// The length of a long press. The application takes one second for long.
const LONG: Duration = Duration::from_millis(1_300);

/// A way to break the firmware.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Breakage {
    /// It panics.
    Panic,
    /// It raises a fault.
    Fault,
    /// It hangs.
    Hang,
    /// It overflows its stack.
    Overflow,
    /// It raises an exception that has no handler.
    Unexpected,
}

/// The user of the board.
#[derive(Debug)]
pub struct Panel {
    socket: UnixStream,
    is_light_on: bool,
}

impl Panel {
    pub(super) const fn new(socket: UnixStream) -> Self {
        Self { socket, is_light_on: false }
    }

    /// Presses the button and releases it.
    ///
    /// # Errors
    /// If the emulator has ended.
    pub fn press(&mut self) -> Result<(), Failure> {
        self.press_for(SHORT)
    }

    /// Holds the button for a long press, and releases it.
    ///
    /// # Errors
    /// If the emulator has ended.
    pub fn hold(&mut self) -> Result<(), Failure> {
        self.press_for(LONG)
    }

    fn press_for(&mut self, span: Duration) -> Result<(), Failure> {
        self.send(b'B')?;
        thread::sleep(span);
        self.send(b'b')
    }

    /// Breaks the firmware.
    ///
    /// # Errors
    /// If the emulator has ended.
    pub fn break_it(&mut self, how: Breakage) -> Result<(), Failure> {
        self.send(match how {
            Breakage::Panic => b'p',
            Breakage::Fault => b'f',
            Breakage::Hang => b'h',
            Breakage::Overflow => b'o',
            Breakage::Unexpected => b'x',
        })
    }

    fn send(&mut self, byte: u8) -> Result<(), Failure> {
        Ok(self.socket.write_all(&[byte])?)
    }

    /// Whether the light is on now.
    ///
    /// # Errors
    /// If the emulator has ended.
    pub fn is_light_on(&mut self) -> Result<bool, Failure> {
        let mut received = [0; 64];
        loop {
            match self.socket.read(&mut received) {
                Ok(0) => return Err("the emulator has ended".into()),
                Ok(length) => {
                    for byte in received.iter().take(length) {
                        match byte {
                            b'L' => self.is_light_on = true,
                            b'l' => self.is_light_on = false,
                            other => {
                                return Err(format!(
                                    "expected b'L' or b'l' for the light, received {other:#04X}"
                                )
                                .into());
                            }
                        }
                    }
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    return Ok(self.is_light_on);
                }
                Err(error) => return Err(error.into()),
            }
        }
    }
}
