//! The direction pin of an RS485 transceiver.

use core::fmt;

use embedded_hal::delay::DelayNs;
use embedded_hal::digital::OutputPin;
use embedded_io::{ErrorKind, ErrorType, Read, ReadReady, Write};

/// A serial port whose transceiver is switched to sending by a pin: high while bytes leave.
///
/// The pin goes high before the first byte is written. It goes low again in `flush`, after the last byte has left; so
/// the port's own `flush` must wait for that. If a write fails or takes nothing, the pin goes low, too: at once if
/// nothing was written before, otherwise after those bytes have left.
///
/// This is a port of embedded-io if `serial` is one and `delay` is embedded-hal's. It is a port of embedded-io-async if
/// `delay` is embedded-hal-async's; there, a `write` or `flush` that is dropped leaves the pin high, and the next
/// `flush` lowers it.
#[derive(Clone, Debug)]
pub struct HalfDuplex<S, P, D> {
    serial: S,
    pin: P,
    delay: D,
    setup_ns: u32,
    hold_ns: u32,
    sending: bool,
}

/// What can go wrong: the port or the pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub enum HalfDuplexError<S, P> {
    /// The serial port.
    #[error("the serial port reports an error: {0:?}")]
    Serial(S),
    /// The direction pin.
    #[error("the direction pin reports an error: {0:?}")]
    Pin(P),
}

impl<S: embedded_io::Error, P: fmt::Debug> embedded_io::Error for HalfDuplexError<S, P> {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Serial(error) => error.kind(),
            Self::Pin(_) => ErrorKind::Other,
        }
    }
}

impl<S, P: OutputPin, D> HalfDuplex<S, P, D> {
    /// A port with its direction pin. `setup_ns` passes between the pin's rise and the first byte, `hold_ns` between
    /// the last byte and the pin's fall.
    ///
    /// # Errors
    /// What the pin reports when it is set to receiving.
    pub fn new(
        serial: S,
        mut pin: P,
        delay: D,
        setup_ns: u32,
        hold_ns: u32,
    ) -> Result<Self, P::Error> {
        pin.set_low()?;
        Ok(Self { serial, pin, delay, setup_ns, hold_ns, sending: false })
    }

    /// Returns the port, the pin and the delay.
    pub fn release(self) -> (S, P, D) {
        (self.serial, self.pin, self.delay)
    }
}

impl<S: ErrorType, P: OutputPin, D> HalfDuplex<S, P, D> {
    /// Returns whether the pin has just been raised, so that the set-up time has to pass.
    fn turn_to_sending(&mut self) -> Result<bool, HalfDuplexError<S::Error, P::Error>> {
        let was_receiving = !self.sending;
        if was_receiving {
            self.pin.set_high().map_err(HalfDuplexError::Pin)?;
            self.sending = true;
        }
        Ok(was_receiving)
    }

    fn turn_to_receiving(&mut self) -> Result<(), HalfDuplexError<S::Error, P::Error>> {
        self.pin.set_low().map_err(HalfDuplexError::Pin)?;
        self.sending = false;
        Ok(())
    }
}

impl<S: ErrorType, P: OutputPin, D> ErrorType for HalfDuplex<S, P, D> {
    type Error = HalfDuplexError<S::Error, P::Error>;
}

impl<S: Read, P: OutputPin, D> Read for HalfDuplex<S, P, D> {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, Self::Error> {
        self.serial.read(buf).map_err(HalfDuplexError::Serial)
    }
}

impl<S: ReadReady, P: OutputPin, D> ReadReady for HalfDuplex<S, P, D> {
    fn read_ready(&mut self) -> Result<bool, Self::Error> {
        self.serial.read_ready().map_err(HalfDuplexError::Serial)
    }
}

impl<S: Write, P: OutputPin, D: DelayNs> Write for HalfDuplex<S, P, D> {
    fn write(&mut self, buf: &[u8]) -> Result<usize, Self::Error> {
        let is_first = self.turn_to_sending()?;
        if is_first {
            self.delay.delay_ns(self.setup_ns);
        }
        let written = self.serial.write(buf).map_err(HalfDuplexError::Serial);
        match written {
            Ok(1..) => {}
            _ if is_first => self.turn_to_receiving()?,
            _ => self.flush()?,
        }
        written
    }

    /// Waits until the last byte has left and turns to receiving, even if the port reports an error: a transceiver that
    /// goes on sending would block the line for all.
    fn flush(&mut self) -> Result<(), Self::Error> {
        let flushed = self.serial.flush().map_err(HalfDuplexError::Serial);
        if self.sending {
            self.delay.delay_ns(self.hold_ns);
            self.turn_to_receiving()?;
        }
        flushed
    }
}

impl<S: embedded_io_async::Read, P: OutputPin, D> embedded_io_async::Read for HalfDuplex<S, P, D> {
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, Self::Error> {
        self.serial.read(buf).await.map_err(HalfDuplexError::Serial)
    }
}

impl<S, P, D> embedded_io_async::Write for HalfDuplex<S, P, D>
where
    S: embedded_io_async::Write,
    P: OutputPin,
    D: embedded_hal_async::delay::DelayNs,
{
    async fn write(&mut self, buf: &[u8]) -> Result<usize, Self::Error> {
        let is_first = self.turn_to_sending()?;
        if is_first {
            self.delay.delay_ns(self.setup_ns).await;
        }
        let written = self.serial.write(buf).await.map_err(HalfDuplexError::Serial);
        match written {
            Ok(1..) => {}
            _ if is_first => self.turn_to_receiving()?,
            _ => self.flush().await?,
        }
        written
    }

    /// As in the blocking port.
    async fn flush(&mut self) -> Result<(), Self::Error> {
        let flushed = self.serial.flush().await.map_err(HalfDuplexError::Serial);
        if self.sending {
            self.delay.delay_ns(self.hold_ns).await;
            self.turn_to_receiving()?;
        }
        flushed
    }
}
