//! What can go wrong with a real bus, in one sentence each.

use std::fmt;
use std::io;
use std::sync::Arc;

/// A real bus that cannot be opened, or that fails while in use.
///
/// `Debug` prints the same sentence as `Display`, so that an `unwrap` and the errors that wrap this
/// one are readable.
#[derive(Clone)]
pub enum PortError {
    /// The kernel has no CAN sockets.
    NoCanSupport,
    /// There is no network interface of this name.
    NoSuchInterface(String),
    /// The network interface is not a CAN interface.
    NotCan(String),
    /// The CAN interface is down.
    InterfaceDown(String),
    /// The CAN interface has gone, such as an adapter that was pulled out.
    InterfaceGone(String),
    /// The controller has left the bus after too many errors.
    BusOff(String),
    /// Nobody on the bus acknowledges frames.
    NotAcknowledged(String),
    /// The SLCAN adapter refuses what it was told.
    Refused(String),
    /// The serial port takes no more bytes.
    Stalled(String),
    /// There is no serial port at this path.
    NoSuchPort(String),
    /// The file at this path is no serial port.
    NotASerialPort(String),
    /// Another program has the serial port open.
    InUse(String),
    /// The user may not open this.
    NotPermitted(String),
    /// The serial port cannot run at this bit rate.
    LineRate {
        /// The serial port.
        port: String,
        /// The bit rate in bit/s.
        bit_rate: u32,
    },
    /// The serial port has gone, such as an adapter that was pulled out.
    PortGone(String),
    /// Anything else that the operating system reports.
    Os {
        /// The bus.
        bus: String,
        /// What it reports.
        error: Arc<io::Error>,
    },
}

impl PortError {
    pub(super) fn os(bus: &str, error: io::Error) -> Self {
        Self::Os { bus: bus.to_owned(), error: Arc::new(error) }
    }

    /// Whether the bus itself carries nothing, as opposed to a computer that cannot reach it.
    pub const fn is_outage(&self) -> bool {
        matches!(
            self,
            Self::BusOff(_) | Self::NotAcknowledged(_) | Self::Refused(_) | Self::Stalled(_)
        )
    }
}

impl fmt::Display for PortError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoCanSupport => f.write_str(
                "this machine's Linux has no CAN sockets: load its module with 'sudo modprobe can-raw', or use a kernel that has it",
            ),
            Self::NoSuchInterface(name) => write!(
                f,
                "there is no network interface \"{name}\": plug the CAN adapter in, and see 'ip -br link' for the names there are"
            ),
            Self::NotCan(name) => write!(
                f,
                "the network interface \"{name}\" is no CAN interface: see 'ip -br link show type can' for those there are"
            ),
            Self::InterfaceDown(name) => write!(
                f,
                "the CAN interface \"{name}\" is down: bring it up with 'sudo ip link set {name} up type can bitrate 1000000', a virtual one with 'sudo ip link set {name} up'"
            ),
            Self::InterfaceGone(name) => write!(
                f,
                "the CAN interface \"{name}\" has gone: plug the adapter in again and restart"
            ),
            Self::BusOff(name) => write!(
                f,
                "the controller of \"{name}\" has left the bus after too many errors: check wiring, termination and bit rate, then restart it with 'sudo ip link set {name} type can restart'"
            ),
            Self::NotAcknowledged(name) => write!(
                f,
                "nobody acknowledges frames on \"{name}\": check the motors' power, the wiring and the bit rate; until an answer comes nothing is sent that could move a motor"
            ),
            Self::Refused(port) => write!(
                f,
                "the SLCAN adapter at \"{port}\" reports an error: check the CAN wiring, the motors' power and the bit rate; until an answer comes nothing is sent that could move a motor"
            ),
            Self::Stalled(port) => write!(
                f,
                "the adapter at \"{port}\" takes no more bytes, and what it had not sent was thrown away: check the bus, or plug the adapter in again"
            ),
            Self::NoSuchPort(port) => write!(
                f,
                "there is no serial port \"{port}\": plug the adapter in, and see /dev/serial/by-id for those there are"
            ),
            Self::NotASerialPort(port) => {
                write!(f, "\"{port}\" is no serial port: expected one such as /dev/ttyUSB0")
            }
            Self::InUse(port) => {
                write!(f, "another program uses \"{port}\": find it with 'fuser {port}' and end it")
            }
            Self::NotPermitted(what) => write!(
                f,
                "you may not open \"{what}\": for a serial port join its group with 'sudo usermod -aG dialout $USER' and log in anew, in a container give it the device"
            ),
            Self::LineRate { port, bit_rate } => write!(
                f,
                "the serial port \"{port}\" cannot run at {bit_rate} bit/s: use an adapter that can, or set motors and address to another rate"
            ),
            Self::PortGone(port) => write!(
                f,
                "the serial port \"{port}\" has gone: plug the adapter in again and restart"
            ),
            Self::Os { bus, error } => {
                write!(f, "\"{bus}\" fails: the operating system reports: {error}")
            }
        }
    }
}

impl fmt::Debug for PortError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl std::error::Error for PortError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Os { error, .. } => Some(error.as_ref()),
            _ => None,
        }
    }
}

impl embedded_can::Error for PortError {
    fn kind(&self) -> embedded_can::ErrorKind {
        match self {
            Self::NotAcknowledged(_) => embedded_can::ErrorKind::Acknowledge,
            _ => embedded_can::ErrorKind::Other,
        }
    }
}

impl embedded_io::Error for PortError {
    fn kind(&self) -> embedded_io::ErrorKind {
        match self {
            Self::NoSuchInterface(_) | Self::NoSuchPort(_) => embedded_io::ErrorKind::NotFound,
            Self::NotPermitted(_) => embedded_io::ErrorKind::PermissionDenied,
            Self::InterfaceGone(_) | Self::PortGone(_) => embedded_io::ErrorKind::NotConnected,
            Self::Stalled(_) => embedded_io::ErrorKind::TimedOut,
            Self::NoCanSupport => embedded_io::ErrorKind::Unsupported,
            Self::NotCan(_) | Self::NotASerialPort(_) | Self::LineRate { .. } => {
                embedded_io::ErrorKind::InvalidInput
            }
            _ => embedded_io::ErrorKind::Other,
        }
    }
}
