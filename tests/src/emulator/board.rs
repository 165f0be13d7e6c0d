//! The emulated boards, how QEMU emulates them, and where their wires are.

use std::fmt;
use std::str::FromStr;

/// A board that QEMU emulates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Board {
    /// A Cortex-M4F with CMSDK peripherals, by Arm.
    Mps2An386,
    /// An STM32F405.
    NetduinoPlus2,
}

/// The connection from a board to the motors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wire {
    /// An RS485 line.
    Rs485,
    /// CAN, through an SLCAN adapter.
    Slcan,
}

/// What a serial port of a board is connected to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Port {
    Bus,
    Panel,
    Nothing,
}

impl Board {
    /// All boards.
    pub const ALL: [Self; 2] = [Self::Mps2An386, Self::NetduinoPlus2];

    /// The name of its package.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mps2An386 => "mps2_an386",
            Self::NetduinoPlus2 => "netduinoplus2",
        }
    }

    /// QEMU's name for the board.
    pub(super) const fn machine(self) -> &'static str {
        match self {
            Self::Mps2An386 => "mps2-an386",
            Self::NetduinoPlus2 => "netduinoplus2",
        }
    }

    /// What the serial ports are connected to, in QEMU's order. `None` if the board has no such wire.
    pub(super) const fn ports(self, wire: Wire) -> Option<&'static [Port]> {
        match (self, wire) {
            (Self::Mps2An386, Wire::Rs485) => Some(&[Port::Bus, Port::Nothing, Port::Panel]),
            (Self::Mps2An386, Wire::Slcan) => Some(&[Port::Nothing, Port::Bus, Port::Panel]),
            (Self::NetduinoPlus2, Wire::Rs485) => Some(&[Port::Bus, Port::Panel]),
            (Self::NetduinoPlus2, Wire::Slcan) => None,
        }
    }
}

impl fmt::Display for Board {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Board {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|board| board.name() == name).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            format!("there is no emulated board \"{name}\"; the emulated boards are: {names}")
        })
    }
}

impl Wire {
    /// The wire of a program, which is named after its bus.
    ///
    /// # Errors
    /// A sentence, if the name does not begin with a bus.
    pub fn of_program(name: &str) -> Result<Self, String> {
        match name.split('_').next() {
            Some("rs485") => Ok(Self::Rs485),
            Some("can") => Ok(Self::Slcan),
            _ => Err(format!(
                "a board's program is named after its bus, as rs485… or can…, but this is \"{name}\""
            )),
        }
    }
}

impl fmt::Display for Wire {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Rs485 => "an RS485 line",
            Self::Slcan => "a CAN bus with an SLCAN adapter",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_parsed() {
        for board in Board::ALL {
            assert_eq!(board.name().parse(), Ok(board));
        }
        assert!("nucleo_f446re".parse::<Board>().unwrap_err().contains("mps2_an386, netduino"));
        assert_eq!(Wire::of_program("rs485_async"), Ok(Wire::Rs485));
        assert_eq!(Wire::of_program("can"), Ok(Wire::Slcan));
        assert!(Wire::of_program("canvas").is_err());
    }
}
