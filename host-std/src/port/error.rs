//! What can go wrong with a real bus, in one sentence each.

use std::fmt;
use std::io;
use std::sync::Arc;

/// A real bus that cannot be opened, or that fails while in use.
///
/// `Debug` prints the same sentence as `Display`, so that an `unwrap` and the errors that wrap this
/// one are readable.
#[derive(Clone, thiserror::Error)]
pub enum PortError {
    /// The kernel has no CAN sockets.
    #[error(
        "this machine's Linux has no CAN sockets: load its module with 'sudo modprobe can-raw', or use a kernel that has it"
    )]
    NoCanSupport,
    /// There is no network interface of this name.
    #[error(
        "there is no CAN interface \"{name}\": {}; other buses are named as in sim:4, can0, slcan:/dev/ttyACM0@1000000 or rs485:/dev/ttyUSB0@115200",
        told_of_interfaces(there)
    )]
    NoSuchInterface {
        /// The name that was given.
        name: String,
        /// The CAN interfaces of this machine.
        there: Vec<String>,
    },
    /// The network interface is not a CAN interface.
    #[error(
        "the network interface \"{0}\" is no CAN interface: see 'ip -br link show type can' for those there are"
    )]
    NotCan(String),
    /// The CAN interface is down.
    #[error(
        "the CAN interface \"{0}\" is down: bring it up with 'sudo ip link set {0} up type can bitrate 1000000', a virtual one with 'sudo ip link set {0} up'"
    )]
    InterfaceDown(String),
    /// The CAN interface has gone, for example because the adapter was unplugged.
    #[error("the CAN interface \"{0}\" has gone: plug the adapter in again and restart")]
    InterfaceGone(String),
    /// The controller has left the bus after too many errors (bus-off).
    #[error(
        "the controller of \"{0}\" has left the bus after too many errors: check wiring, termination and bit rate, then restart it with 'sudo ip link set {0} type can restart'"
    )]
    BusOff(String),
    /// Nothing on the bus acknowledges frames.
    #[error(
        "nobody acknowledges frames on \"{0}\": check the motors' power, the wiring and the bit rate; until an answer comes nothing is sent that could move a motor"
    )]
    NotAcknowledged(String),
    /// The SLCAN adapter refuses a command.
    #[error(
        "the SLCAN adapter at \"{0}\" reports an error: check the CAN wiring, the motors' power and the bit rate; until an answer comes nothing is sent that could move a motor"
    )]
    Refused(String),
    /// The serial port takes no more bytes. What it still held was thrown away.
    #[error(
        "the adapter at \"{0}\" takes no more bytes, and what it had not sent was thrown away: check the bus, or plug the adapter in again"
    )]
    Stalled(String),
    /// There is no serial port at this path.
    #[error(
        "there is no serial port \"{0}\": plug the adapter in, and see /dev/serial/by-id for those there are"
    )]
    NoSuchPort(String),
    /// The file at this path is no serial port.
    #[error("\"{0}\" is no serial port: expected one such as /dev/ttyUSB0")]
    NotASerialPort(String),
    /// Another program has the serial port open.
    #[error(
        "another program uses \"{0}\": find it with 'fuser {0}' and end it, by Ctrl-C or SIGTERM so that it can stop its motors; one that is frozen ends by SIGKILL only, and its motors go on then until they are stopped"
    )]
    InUse(String),
    /// The user may not open this.
    #[error(
        "you may not open \"{0}\": for a serial port join its group with 'sudo usermod -aG dialout $USER' and log in anew, in a container give it the device"
    )]
    NotPermitted(String),
    /// The serial port cannot run at this bit rate.
    #[error(
        "the serial port \"{port}\" cannot run at {bit_rate} bit/s: use an adapter that can, or set motors and address to another rate"
    )]
    LineRate {
        /// The serial port.
        port: String,
        /// The bit rate in bit/s.
        bit_rate: u32,
    },
    /// The serial port has gone, for example because the adapter was unplugged.
    #[error("the serial port \"{0}\" has gone: plug the adapter in again and restart")]
    PortGone(String),
    /// Anything else that the operating system reports.
    #[error("\"{bus}\" fails: the operating system reports: {error}")]
    Os {
        /// The bus.
        bus: String,
        /// The error that the operating system reports.
        #[source]
        error: Arc<io::Error>,
    },
}

fn told_of_interfaces(there: &[String]) -> String {
    if there.is_empty() {
        "this machine has none, so plug the CAN adapter in if it is meant".to_owned()
    } else {
        format!("there are {}", there.join(" "))
    }
}

impl PortError {
    pub(crate) fn os(bus: &str, error: io::Error) -> Self {
        Self::Os { bus: bus.to_owned(), error: Arc::new(error) }
    }

    /// Whether the bus itself carries nothing, as opposed to a computer that cannot access it.
    pub const fn is_outage(&self) -> bool {
        matches!(
            self,
            Self::BusOff(_) | Self::NotAcknowledged(_) | Self::Refused(_) | Self::Stalled(_)
        )
    }
}

impl fmt::Debug for PortError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
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
            Self::NoSuchInterface { .. } | Self::NoSuchPort(_) => embedded_io::ErrorKind::NotFound,
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
