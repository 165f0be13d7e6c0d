//! The name of a bus, as people type it.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::time::Duration;

use crate::LINE_RATES;
use crate::text::slcan::Rate;
use crate::{BusKind, Unexpected};

/// The longest name that Linux gives to a network interface.
const LONGEST_INTERFACE: usize = 15;
/// As many motors as the protocol has ids for.
const MOST_MOTORS: u8 = 32;
/// How many motors are simulated by default.
const USUAL_MOTORS: u8 = 4;
/// The bit rates of the simulated buses, bit/s: those of new drives.
const SIMULATED_CAN_RATE: u32 = 1_000_000;
const SIMULATED_LINE_RATE: u32 = 115_200;
/// Long enough for twice the 16 ms after which an adapter hands over what it has received.
const LONGEST_REPLY_TIMEOUT: Duration = Duration::from_millis(40);

/// One string that names a bus, the same in every tool and configuration.
///
/// | string | bus |
/// |---|---|
/// | `sim`, `sim:2` | simulated CAN bus at 1 Mbit/s with four motors, or as many as given, 1 to 32 |
/// | `sim:2,rs485` | simulated RS485 line at 115200 bit/s |
/// | `can0`, `can:can0` | SocketCAN interface |
/// | `slcan:/dev/ttyACM0@1000000` | SLCAN adapter on a serial port, bit rate of the CAN bus in bit/s |
/// | `rs485:/dev/ttyUSB0@115200` | RS485 adapter on a serial port, bit rate of the line in bit/s |
/// | `rs485:/dev/ttyUSB0@115200,echo` | RS485 adapter that hands back what it sends |
///
/// Without `echo` the master finds out whether there is one: before it sends the first commands whose echo could pass
/// for the answer, it reads the motor's status, whose echo cannot.
///
/// ```
/// use myactuator_host_std::open::BusAddress;
///
/// let bus: BusAddress = "rs485:/dev/ttyUSB0@115200,echo".parse()?;
/// assert_eq!(bus.to_string(), "rs485:/dev/ttyUSB0@115200,echo");
/// # Ok::<(), myactuator_host_std::Unexpected>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum BusAddress {
    /// A simulated bus.
    Simulated {
        /// How many motors are on it, with ids from 1: 1 to 32.
        motors: u8,
        /// Which of the protocol's two buses it is.
        kind: BusKind,
    },
    /// A CAN interface of Linux.
    SocketCan {
        /// Its name, 1 to 15 characters.
        interface: String,
    },
    /// An SLCAN adapter.
    Slcan {
        /// The serial port.
        path: PathBuf,
        /// The bit rate of the CAN bus.
        rate: Rate,
    },
    /// A serial port with an RS485 transceiver.
    Rs485 {
        /// The serial port.
        path: PathBuf,
        /// The bit rate of the line in bit/s, 1200 to 12000000.
        bit_rate: u32,
        /// Whether the address says that the adapter hands back what it sends.
        echo: bool,
    },
}

impl BusAddress {
    /// Reads the bit rate of an RS485 line as an address has it, in bit/s.
    ///
    /// # Errors
    /// [`Unexpected`]: not a rate that a serial line has.
    pub fn line_rate(text: &str) -> Result<u32, Unexpected> {
        let rate = decimal(text).filter(|rate| LINE_RATES.contains(rate));
        rate.ok_or_else(|| {
            let (slowest, fastest) = LINE_RATES.into_inner();
            let rates = format!("a bit rate from {slowest} to {fastest} bit/s such as 115200");
            Unexpected::new(rates, text)
        })
    }

    /// Whether the motors on it are simulated.
    pub const fn is_simulated(&self) -> bool {
        matches!(self, Self::Simulated { .. })
    }

    /// Which of the protocol's two buses this is.
    pub const fn kind(&self) -> BusKind {
        match self {
            Self::Simulated { kind, .. } => *kind,
            Self::SocketCan { .. } | Self::Slcan { .. } => BusKind::Can,
            Self::Rs485 { .. } => BusKind::Rs485,
        }
    }

    /// The bit rate of the bus in bit/s; `None` for a CAN interface of Linux, whose rate is set
    /// elsewhere.
    pub const fn bit_rate(&self) -> Option<u32> {
        match self {
            Self::Simulated { kind: BusKind::Can, .. } => Some(SIMULATED_CAN_RATE),
            Self::Simulated { kind: BusKind::Rs485, .. } => Some(SIMULATED_LINE_RATE),
            Self::SocketCan { .. } => None,
            Self::Slcan { rate, .. } => Some(rate.bits_per_second()),
            Self::Rs485 { bit_rate, .. } => Some(*bit_rate),
        }
    }

    /// The serial port of the adapter, if there is one.
    pub fn serial_port(&self) -> Option<&Path> {
        match self {
            Self::Slcan { path, .. } | Self::Rs485 { path, .. } => Some(path),
            Self::Simulated { .. } | Self::SocketCan { .. } => None,
        }
    }

    /// The master's configuration for this bus. Time-outs are those of its bit rate. On real buses they follow the
    /// measured round trips, up to 40 ms: adapters hold back what they have received for up to 16 ms. A CAN interface
    /// of Linux is assumed to run at 1 Mbit/s.
    pub const fn config(&self) -> Config {
        match self {
            Self::Simulated { kind: BusKind::Can, .. } => Config::CAN,
            Self::Simulated { kind: BusKind::Rs485, .. } => {
                Config::rs485(SIMULATED_LINE_RATE, false)
            }
            Self::SocketCan { .. } => Config::CAN.adapting_up_to(LONGEST_REPLY_TIMEOUT),
            Self::Slcan { rate, .. } => {
                Config::can(rate.bits_per_second()).adapting_up_to(LONGEST_REPLY_TIMEOUT)
            }
            Self::Rs485 { bit_rate, echo, .. } => {
                Config::rs485(*bit_rate, *echo).adapting_up_to(LONGEST_REPLY_TIMEOUT)
            }
        }
    }
}

impl fmt::Display for BusAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Simulated { motors, kind: BusKind::Can } => write!(f, "sim:{motors}"),
            Self::Simulated { motors, kind: BusKind::Rs485 } => write!(f, "sim:{motors},rs485"),
            // An interface may have a name that means something else here.
            Self::SocketCan { interface } if interface == SIMULATED => write!(f, "can:{interface}"),
            Self::SocketCan { interface } => f.write_str(interface),
            Self::Slcan { path, rate } => {
                write!(f, "slcan:{}@{}", path.display(), rate.bits_per_second())
            }
            Self::Rs485 { path, bit_rate, echo } => {
                write!(f, "rs485:{}@{bit_rate}", path.display())?;
                f.write_str(if *echo { ",echo" } else { "" })
            }
        }
    }
}

const SIMULATED: &str = "sim";
const EXAMPLES: &str = "sim:4, can0, slcan:/dev/ttyACM0@1000000 or rs485:/dev/ttyUSB0@115200";

impl FromStr for BusAddress {
    type Err = Unexpected;

    fn from_str(text: &str) -> Result<Self, Unexpected> {
        let not_a_bus = || Unexpected::new(format!("a bus such as {EXAMPLES}"), text);
        match text.split_once(':') {
            None if text == SIMULATED => {
                Ok(Self::Simulated { motors: USUAL_MOTORS, kind: BusKind::Can })
            }
            None if text.is_empty() || text.contains('/') => Err(not_a_bus()),
            None => socket_can(text),
            Some((SIMULATED, motors)) => simulated(motors),
            Some(("can", interface)) => socket_can(interface),
            Some(("slcan", port)) => slcan(port),
            Some(("rs485", port)) => rs485(port),
            Some(_) => Err(not_a_bus()),
        }
    }
}

fn simulated(motors: &str) -> Result<BusAddress, Unexpected> {
    let (motors, kind) = match motors.split_once(',') {
        None => (motors, BusKind::Can),
        Some((motors, "rs485")) => (motors, BusKind::Rs485),
        Some((_, found)) => {
            return Err(Unexpected::new("\"rs485\" or no comma", format!(",{found}")));
        }
    };
    let wrong = || {
        let count = format!("a number of simulated motors from 1 to {MOST_MOTORS} after \"sim:\"");
        Unexpected::new(count, motors)
    };
    let motors = decimal(motors).and_then(|motors| u8::try_from(motors).ok());
    let motors = motors.filter(|motors| (1..=MOST_MOTORS).contains(motors)).ok_or_else(wrong)?;
    Ok(BusAddress::Simulated { motors, kind })
}

/// Accepts the names that the kernel accepts.
fn socket_can(interface: &str) -> Result<BusAddress, Unexpected> {
    let forbidden = |c: char| c == '/' || c == ':' || c.is_whitespace() || c.is_control();
    let known = !interface.is_empty()
        && interface.len() <= LONGEST_INTERFACE
        && !matches!(interface, "." | "..")
        && !interface.contains(forbidden);
    if known {
        Ok(BusAddress::SocketCan { interface: interface.to_owned() })
    } else {
        let name = format!(
            "the name of a CAN interface such as can0, up to {LONGEST_INTERFACE} characters without '/', ':' and spaces"
        );
        Err(Unexpected::new(name, interface))
    }
}

fn slcan(port: &str) -> Result<BusAddress, Unexpected> {
    let (path, rate) = path_and_rate("slcan", "1000000", port)?;
    Ok(BusAddress::Slcan { path: path.into(), rate: rate.parse()? })
}

fn rs485(port: &str) -> Result<BusAddress, Unexpected> {
    let (path, rate) = path_and_rate("rs485", "115200", port)?;
    let (rate, echo) = match rate.split_once(',') {
        None => (rate, false),
        Some((rate, "echo")) => (rate, true),
        Some((_, found)) => {
            return Err(Unexpected::new("\"echo\" or no comma", format!(",{found}")));
        }
    };
    let bit_rate = BusAddress::line_rate(rate)?;
    Ok(BusAddress::Rs485 { path: path.into(), bit_rate, echo })
}

/// The last `@` divides, since a path may contain one.
fn path_and_rate<'a>(
    kind: &str,
    example: &str,
    port: &'a str,
) -> Result<(&'a str, &'a str), Unexpected> {
    match port.rsplit_once('@') {
        Some((path, rate)) if !path.is_empty() => Ok((path, rate)),
        _ => Err(Unexpected::new(
            format!("a serial port and a bit rate such as {kind}:/dev/ttyUSB0@{example}"),
            format!("{kind}:{port}"),
        )),
    }
}

/// Digits only: `u32`'s own parser takes a plus sign as well.
fn decimal(text: &str) -> Option<u32> {
    text.bytes().all(|byte| byte.is_ascii_digit()).then(|| text.parse().ok())?
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<BusAddress, Unexpected> {
        text.parse()
    }

    #[test]
    fn every_form_is_read() {
        let can = |interface: &str| Ok(BusAddress::SocketCan { interface: interface.to_owned() });
        let sim = |motors, kind| Ok(BusAddress::Simulated { motors, kind });
        assert_eq!(parse("sim"), sim(4, BusKind::Can));
        assert_eq!(parse("sim:1"), sim(1, BusKind::Can));
        assert_eq!(parse("sim:32"), sim(32, BusKind::Can));
        assert_eq!(parse("sim:2,rs485"), sim(2, BusKind::Rs485));
        assert_eq!(parse("can0"), can("can0"));
        assert_eq!(parse("can:can0"), can("can0"));
        assert_eq!(parse("can:sim"), can("sim"));
        assert_eq!(parse("slcan0"), can("slcan0"));
        assert_eq!(parse("left-arm@2"), can("left-arm@2"));
        assert_eq!(
            parse("slcan:/dev/ttyACM0@500000"),
            Ok(BusAddress::Slcan { path: "/dev/ttyACM0".into(), rate: Rate::Kbit500 })
        );
        let rs485 = |path: &str, bit_rate, echo| {
            Ok(BusAddress::Rs485 { path: path.into(), bit_rate, echo })
        };
        assert_eq!(parse("rs485:/dev/ttyUSB0@115200"), rs485("/dev/ttyUSB0", 115_200, false));
        let (fast, slow) = ("rs485:/dev/ttyS1@2500000,echo", "rs485:/dev/ttyS1@1200");
        assert_eq!(parse(fast), rs485("/dev/ttyS1", 2_500_000, true));
        assert_eq!(parse(slow), rs485("/dev/ttyS1", 1_200, false));
        let by_path = "/dev/serial/by-path/pci@1:0,usb";
        assert_eq!(parse(&format!("rs485:{by_path}@9600")), rs485(by_path, 9_600, false));
    }

    #[test]
    fn each_address_prints_as_it_was_read_with_its_kind_and_rate() {
        for (text, kind, rate) in [
            ("sim:4", BusKind::Can, Some(1_000_000)),
            ("sim:2,rs485", BusKind::Rs485, Some(115_200)),
            ("can0", BusKind::Can, None),
            ("can:sim", BusKind::Can, None),
            ("slcan:/dev/ttyACM0@500000", BusKind::Can, Some(500_000)),
            ("rs485:/dev/ttyUSB0@115200", BusKind::Rs485, Some(115_200)),
            ("rs485:/dev/ttyUSB0@2500000,echo", BusKind::Rs485, Some(2_500_000)),
            ("rs485:/dev/ttyUSB0@9600", BusKind::Rs485, Some(9_600)),
        ] {
            let bus = parse(text).unwrap();
            assert_eq!(bus.to_string(), text);
            assert_eq!((bus.kind(), bus.bit_rate()), (kind, rate), "{text}");
            assert_eq!(bus.is_simulated(), text.starts_with("sim"));
        }
        assert_eq!(parse("can:can0").unwrap().to_string(), "can0");
    }

    /// Longest frame times by hand: 135 bits on CAN, 130 on RS485.
    #[test]
    fn time_outs_are_those_of_the_bit_rate() {
        for (text, frame_us, expected) in [
            ("slcan:/dev/ttyACM0@1000000", 136, Config::can(1_000_000)),
            ("slcan:/dev/ttyACM0@500000", 271, Config::can(500_000)),
            ("slcan:/dev/ttyACM0@10000", 13_501, Config::can(10_000)),
            ("can0", 136, Config::CAN),
            ("rs485:/dev/ttyUSB0@115200", 1_129, Config::rs485(115_200, false)),
            ("rs485:/dev/ttyUSB0@1000000,echo", 131, Config::rs485(1_000_000, true)),
        ] {
            let config = parse(text).unwrap().config();
            let expected = expected.adapting_up_to(LONGEST_REPLY_TIMEOUT);
            assert_eq!((config.frame_time.as_micros(), config), (frame_us, expected), "{text}");
        }
    }

    #[test]
    fn echo_is_configured_only_where_the_address_names_it() {
        for (text, is_configured) in [("", false), (",echo", true)] {
            let bus = parse(&format!("rs485:/dev/ttyUSB0@115200{text}")).unwrap();
            let expected = Config::rs485(115_200, is_configured).bus;
            assert_eq!(bus.config().bus, expected, "{text}");
        }
    }

    #[test]
    fn text_that_names_no_bus_is_refused() {
        const BUS: &str = "a bus such as sim:4, can0, slcan";
        const MOTORS: &str = "a number of simulated motors from 1 to 32 ";
        const INTERFACE: &str = "the name of a CAN interface such as can0, up to 15 characters ";
        const SLCAN: &str = "a serial port and a bit rate such as slcan:/dev/ttyUSB0@1000000";
        const RS485: &str = "a serial port and a bit rate such as rs485:/dev/ttyUSB0@115200";
        const CAN_RATE: &str = "a bit rate that SLCAN adapters know (10000, 20000, 50000, 100000, \
                                125000, 250000, 500000, 800000, 1000000)";
        const ECHO: &str = "\"echo\" or no comma";
        const LINE_RATE: &str = "a bit rate from 1200 to 12000000 bit/s";
        for (text, expected, found) in [
            ("", BUS, ""),
            ("/dev/ttyUSB0", BUS, "/dev/ttyUSB0"),
            ("usb:can0", BUS, "usb:can0"),
            ("sim:", MOTORS, ""),
            ("sim:0", MOTORS, "0"),
            ("sim:33", MOTORS, "33"),
            ("sim:+4", MOTORS, "+4"),
            ("sim:260", MOTORS, "260"),
            ("sim:,rs485", MOTORS, ""),
            ("sim:4,echo", "\"rs485\" or no comma", ",echo"),
            ("can:", INTERFACE, ""),
            ("can 0", INTERFACE, "can 0"),
            ("..", INTERFACE, ".."),
            ("sixteen-letters0", INTERFACE, "sixteen-letters0"),
            ("slcan:/dev/ttyACM0", SLCAN, "slcan:/dev/ttyACM0"),
            ("rs485:@115200", RS485, "rs485:@115200"),
            ("slcan:/dev/ttyACM0@1500000", CAN_RATE, "1500000"),
            ("slcan:/dev/ttyACM0@500000,echo", CAN_RATE, "500000,echo"),
            ("rs485:/dev/ttyUSB0@", LINE_RATE, ""),
            ("rs485:/dev/ttyUSB0@1199", LINE_RATE, "1199"),
            ("rs485:/dev/ttyUSB0@12000001", LINE_RATE, "12000001"),
            ("rs485:/dev/ttyUSB0@115200 ", LINE_RATE, "115200 "),
            ("rs485:/dev/ttyUSB0@115200,", ECHO, ","),
            ("rs485:/dev/ttyUSB0@115200,8n1", ECHO, ",8n1"),
            ("rs485:/dev/ttyUSB0@115200,noecho", ECHO, ",noecho"),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.expected.starts_with(expected), "{text:?}: {error}");
            assert_eq!(error.found, found, "{text:?}");
        }
    }
}
