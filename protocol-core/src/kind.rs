//! [`Kind`]: a row of the table of opcodes, or what the caller says of a command that is not in it.

use core::fmt;

use crate::data::Data;
use crate::error::RequestError;
use crate::id::Target;
use crate::opcode::{Buses, Opcode, Reach, Repeat, ReplyRule, Usage};
use crate::packet::Channel;

/// What a master has to know of a command to send it and to recognise its answer: a row of the table or, for a command
/// that the table does not have, what the caller says of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub enum Kind {
    /// A row of the table.
    Known(Opcode),
    /// Any other command: see [`RawCommand`](crate::command::RawCommand).
    Raw {
        /// Its command byte.
        byte: u8,
        /// How it is answered.
        reply: ReplyRule,
        /// Whether it may move the motor.
        moves: bool,
    },
}

impl Kind {
    /// The kind, by its bytes, of a command that claims to be of this kind. If the table has the command byte, the
    /// table's row holds, so that no [`Command`](crate::Command) of a caller's own evades a rule by a wrong claim.
    /// Motion mode has no command byte: a claim to be that stands.
    #[must_use]
    pub fn of_bytes(self, data: &Data) -> Self {
        if let Self::Known(Opcode::Motion) = self {
            return self;
        }
        match (self, Opcode::from_byte(data[0])) {
            (Self::Known(opcode), _) if opcode.byte().is_none_or(|byte| byte == data[0]) => self,
            (_, Some(opcode)) => Self::Known(opcode),
            (Self::Raw { reply, moves, .. }, None) => Self::Raw { byte: data[0], reply, moves },
            (Self::Known(_), None) => {
                Self::Raw { byte: data[0], reply: ReplyRule::Values, moves: true }
            }
        }
    }

    /// The row, if it is in the table.
    pub const fn opcode(self) -> Option<Opcode> {
        match self {
            Self::Known(opcode) => Some(opcode),
            Self::Raw { .. } => None,
        }
    }

    /// The command byte; `None` for motion mode.
    #[inline]
    pub const fn byte(self) -> Option<u8> {
        match self {
            Self::Known(opcode) => opcode.byte(),
            Self::Raw { byte, .. } => Some(byte),
        }
    }

    /// Whether a drive answers it with bytes that can be waited for.
    pub const fn has_reply(self) -> bool {
        match self {
            Self::Known(opcode) => opcode.has_reply(),
            Self::Raw { reply, .. } => reply.has_reply(),
        }
    }

    /// What a second sending does. For what the table does not know, the worst is assumed.
    pub const fn repeat(self) -> Repeat {
        match self {
            Self::Known(opcode) => opcode.repeat(),
            Self::Raw { .. } => Repeat::ActsAgain,
        }
    }

    /// Whether it may set the motor in motion, let its load fall, or change the drive for good. While the motors are
    /// stopped, such a command is refused ([`RequestError::Stopped`]).
    ///
    /// In the table these are 0x77 and all whose repeat is not [harmless](Repeat::Harmless): set-points, 0xA8, the
    /// restart, writes to ROM, 0x20, 0x79 (even its read), 0xB3, 0xB4 and 0xB6. All others pass: reads, and 0x31, 0x78,
    /// 0x80 and 0x81, for example. For a raw command its caller decides.
    pub const fn is_refused_while_stopped(self) -> bool {
        match self {
            Self::Known(Opcode::ReleaseBrake) => true,
            Self::Known(opcode) => !matches!(opcode.repeat(), Repeat::Harmless),
            Self::Raw { moves, .. } => moves,
        }
    }

    /// Whether it ends motion: 0x80, 0x81, 0x78 and 0x76. Older set-points never follow it.
    pub const fn ends_motion(self) -> bool {
        use Opcode::{LockBrake, Reset, Shutdown, Stop};
        matches!(self, Self::Known(Shutdown | Stop | LockBrake | Reset))
    }

    /// Whether it lets a motor go, so that a load falls: 0x80 and 0x76.
    pub const fn lets_go(self) -> bool {
        matches!(self, Self::Known(Opcode::Shutdown | Opcode::Reset))
    }

    /// Whether it only asks for values.
    pub(crate) fn is_read(self) -> bool {
        let gives_values = |opcode: Opcode| opcode.reply_rule() == ReplyRule::Values;
        self.repeat() == Repeat::Harmless && self.opcode().is_some_and(gives_values)
    }

    /// Whether it is a motion mode command, which travels on a channel of its own.
    pub const fn is_motion(self) -> bool {
        matches!(self, Self::Known(Opcode::Motion))
    }

    /// Whether `reply` can be the answer to `command`: it has the same command byte and, if the kind has one, the same
    /// key byte. The channel says who sent it.
    #[inline]
    pub fn answers(self, command: &Data, reply: &Data) -> bool {
        self.key(command) == self.key(reply) && self.byte().is_none_or(|byte| reply[0] == byte)
    }

    /// The key byte, which a command and its reply share besides the command byte, if the kind has one.
    #[inline]
    pub(crate) fn key(self, data: &Data) -> Option<u8> {
        let at = self.opcode()?.key_byte()?;
        data.get(at).copied()
    }

    /// Whether it may set the motor in motion. Such a command is refused to a motor that has restarted
    /// ([`RequestError::Restarted`]).
    // One copy in the firmware: this is asked in many places.
    #[inline(never)]
    pub const fn moves(self) -> bool {
        match self {
            Self::Known(opcode) => matches!(opcode.usage(), Usage::SetPoint | Usage::Move),
            Self::Raw { moves, .. } => moves,
        }
    }

    /// Whether it may set the motor in motion, or open the brake that holds its load.
    #[inline(never)]
    pub const fn may_move(self) -> bool {
        self.moves() || matches!(self, Self::Known(Opcode::ReleaseBrake))
    }

    /// Whether a drive that answers a command with the command's own bytes only hands it back, as a drive that has lost
    /// its master does with a command that it ignores. That is so for commands that move: their feedback never equals
    /// the command, unless all of it is 0. And for a read of the run time: no drive answers in its first millisecond.
    /// For a raw command only its caller knows the answer.
    pub(crate) fn is_handed_back(self, data: &Data) -> bool {
        let [_, _, values @ ..] = data;
        match self {
            Self::Known(Opcode::ReadRunTime) => *values == [0; 6],
            Self::Known(_) => self.moves() && *values != [0; 6],
            _ => false,
        }
    }

    /// The channel on which a command of this kind reaches `target`.
    ///
    /// # Errors
    /// [`RequestError::OneMotorOnly`] for motion mode to all, [`RequestError::AllMotorsOnly`] for a bus
    /// id to one.
    pub const fn channel_to(self, target: Target) -> Result<Channel, RequestError> {
        let Self::Known(opcode) = self else { return Ok(Channel::Command(target)) };
        match (opcode.reach(), target) {
            (Reach::OneOrAll, target) => Ok(Channel::Command(target)),
            (Reach::One, Target::Motor(id)) => Ok(Channel::Motion(id)),
            (Reach::One, Target::All) => Err(RequestError::OneMotorOnly(opcode)),
            (Reach::Connected, Target::All) => Ok(Channel::BusId),
            (Reach::Connected, Target::Motor(_)) => Err(RequestError::AllMotorsOnly(opcode)),
        }
    }

    /// Refuses kinds that RS485 does not have.
    ///
    /// # Errors
    /// [`RequestError::CanOnly`].
    pub const fn check_on_rs485(self) -> Result<(), RequestError> {
        match self {
            Self::Known(opcode) if matches!(opcode.buses(), Buses::CanOnly) => {
                Err(RequestError::CanOnly(opcode))
            }
            _ => Ok(()),
        }
    }
}

impl From<Opcode> for Kind {
    fn from(opcode: Opcode) -> Self {
        Self::Known(opcode)
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Known(opcode) => opcode.fmt(f),
            Self::Raw { byte, .. } => write!(f, "raw 0x{byte:02X}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stop_refuses_and_passes_commands_as_documented() {
        let passes = |opcode: Opcode| !Kind::Known(opcode).is_refused_while_stopped();
        for &opcode in Opcode::ALL {
            if opcode.name().starts_with("read-") {
                assert!(passes(opcode), "{opcode}");
            }
            if opcode.usage() == Usage::SetPoint || opcode.repeat() == Repeat::ActsAgain {
                assert!(!passes(opcode), "{opcode}");
            }
        }
        let of_byte = |byte| Opcode::from_byte(byte).unwrap();
        assert!([0x31, 0x78, 0x80, 0x81].map(of_byte).into_iter().all(passes));
        let refused = [0x77, 0xA8, 0x76, 0x32, 0x43, 0x63, 0x64, 0x20, 0x79, 0xB3, 0xB4, 0xB6];
        assert!(!refused.map(of_byte).into_iter().any(passes));
    }

    #[test]
    fn known_move_but_no_raw_one_is_recognised_as_handed_back() {
        let data = [0xA4, 0, 100, 0, 0, 0, 45, 0];
        assert!(Kind::Known(Opcode::AbsolutePosition).is_handed_back(&data));
        let raw = Kind::Raw { byte: 0xC0, reply: ReplyRule::Values, moves: true };
        assert!(raw.moves() && !raw.is_handed_back(&data));
    }
}
