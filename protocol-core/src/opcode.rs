//! The table of frame kinds: one row each, and everything that follows from the kind alone.

use core::fmt;

use crate::field::Data;

/// How a drive answers a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub enum ReplyRule {
    /// With the same eight bytes.
    Echo,
    /// With values of its own under the same command byte.
    Values,
    /// As [`Echo`](Self::Echo), but whatever value it carries acknowledges: the manual's own
    /// example of 0xB3 returns zeros (2.31.4).
    Acknowledge,
    /// Not at all (0x76, 0xB6).
    Silent,
    /// With bytes that mean nothing, because the bus has just changed speed (0xB4): never wait.
    Garbled,
}

/// What a second sending of the same command does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub enum Repeat {
    /// Nothing more than the first: reads, stop and shutdown, brake, RAM writes.
    Harmless,
    /// It moves the motor to a set-point that may be stale by then.
    Stale,
    /// It acts once more: a relative move, a reset, a write to ROM, a change of id or bit rate.
    ActsAgain,
}

/// On which buses a command exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub enum Buses {
    /// CAN and RS485.
    Both,
    /// CAN only.
    CanOnly,
}

macro_rules! opcodes {
    ($(
        $(#[doc = $doc:literal])+
        $name:ident = $byte:expr, $kebab:literal, $section:literal, $reply:ident, $key:expr, $repeat:ident, $buses:ident;
    )+) => {
        /// A kind of frame of protocol V4.3. Each variant's documentation ends in its section of the
        /// manual.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        #[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
        pub enum Opcode {
            $($(#[doc = $doc])+ #[doc = concat!("Manual ", $section, ".")] $name,)+
        }

        impl Opcode {
            /// Every kind, in the order of the table.
            pub const ALL: &'static [Self] = &[$(Self::$name),+];

            /// The command byte, which is the first of the data field; `None` for motion mode, which
            /// has none and is known by its identifier.
            #[inline]
            pub const fn byte(self) -> Option<u8> {
                // A match would become a jump table wherever it is inlined.
                const BYTES: [Option<u8>; Opcode::ALL.len()] = [$($byte),+];
                BYTES[self as usize]
            }

            /// The kind with this command byte.
            #[inline]
            pub const fn from_byte(byte: u8) -> Option<Self> {
                let place = byte.wrapping_sub(FIRST_BYTE) as usize;
                if place < KINDS.len() { KINDS[place] } else { None }
            }

            /// Its name in tools: `"read-multi-turn-angle"`.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$name => $kebab,)+ }
            }

            /// The section of the manual that describes it.
            pub const fn section(self) -> &'static str {
                match self { $(Self::$name => $section,)+ }
            }

            /// How a drive answers it.
            pub const fn reply_rule(self) -> ReplyRule {
                match self { $(Self::$name => ReplyRule::$reply,)+ }
            }

            /// The place of the byte that, beside the command byte, must agree between command and
            /// reply: a parameter's index, or read and write of a bus id.
            pub const fn key_byte(self) -> Option<usize> {
                match self { $(Self::$name => $key,)+ }
            }

            /// What a second sending does.
            pub const fn repeat(self) -> Repeat {
                match self { $(Self::$name => Repeat::$repeat,)+ }
            }

            /// On which buses it exists.
            pub const fn buses(self) -> Buses {
                match self { $(Self::$name => Buses::$buses,)+ }
            }
        }
    };
}

const KEY1: Option<usize> = Some(1);
const KEY2: Option<usize> = Some(2);

opcodes! {
    // name, byte, name in tools, section, how the drive replies, key byte, a second sending, buses

    /// One of seven special functions.
    FunctionControl = Some(0x20), "function-control", "2.35", Echo, KEY1, ActsAgain, Both;
    /// Read one gain of a control loop.
    ReadPid = Some(0x30), "read-pid", "2.1", Values, KEY1, Harmless, Both;
    /// Write one gain, until power-off or reset.
    WritePidRam = Some(0x31), "write-pid-ram", "2.2", Echo, KEY1, Harmless, Both;
    /// Write one gain for good.
    WritePidRom = Some(0x32), "write-pid-rom", "2.3", Echo, KEY1, ActsAgain, Both;
    /// Read one of the four planning accelerations.
    ReadAcceleration = Some(0x42), "read-acceleration", "2.4", Values, KEY1, Harmless, Both;
    /// Write one of the four planning accelerations for good.
    WriteAcceleration = Some(0x43), "write-acceleration", "2.5", Echo, KEY1, ActsAgain, Both;
    /// Read the multi-turn encoder position, less its zero offset.
    ReadMultiTurnEncoder = Some(0x60), "read-multi-turn-encoder", "2.6", Values, None, Harmless, Both;
    /// Read the multi-turn encoder position without its zero offset.
    ReadMultiTurnEncoderRaw = Some(0x61), "read-multi-turn-encoder-raw", "2.7", Values, None, Harmless, Both;
    /// Read the zero offset of the multi-turn encoder.
    ReadMultiTurnEncoderOffset = Some(0x62), "read-multi-turn-encoder-offset", "2.8", Values, None, Harmless, Both;
    /// Make a given encoder position the zero, after a restart.
    SetEncoderZero = Some(0x63), "set-encoder-zero", "2.9", Echo, None, ActsAgain, Both;
    /// Make the current position the zero, after a restart.
    SetCurrentPositionZero = Some(0x64), "set-current-position-zero", "2.10", Values, None, ActsAgain, Both;
    /// Read which control loop runs.
    ReadRunningMode = Some(0x70), "read-running-mode", "2.25", Values, None, Harmless, Both;
    /// Restart the drive.
    Reset = Some(0x76), "reset", "2.26", Silent, None, ActsAgain, Both;
    /// Open the brake.
    ReleaseBrake = Some(0x77), "release-brake", "2.27", Echo, None, Harmless, Both;
    /// Close the brake.
    LockBrake = Some(0x78), "lock-brake", "2.28", Echo, None, Harmless, Both;
    /// Read or set the motor id of whatever is connected.
    BusId = Some(0x79), "bus-id", "4", Values, KEY2, ActsAgain, Both;
    /// Switch the output off and leave every control mode.
    Shutdown = Some(0x80), "shutdown", "2.17", Echo, None, Harmless, Both;
    /// Stop and hold still.
    Stop = Some(0x81), "stop", "2.18", Echo, None, Harmless, Both;
    /// Read the single-turn encoder (direct-drive motors).
    ReadSingleTurnEncoder = Some(0x90), "read-single-turn-encoder", "2.11", Values, None, Harmless, Both;
    /// Read the multi-turn angle of the output shaft.
    ReadMultiTurnAngle = Some(0x92), "read-multi-turn-angle", "2.12", Values, None, Harmless, Both;
    /// Read the single-turn angle (direct-drive motors).
    ReadSingleTurnAngle = Some(0x94), "read-single-turn-angle", "2.13", Values, None, Harmless, Both;
    /// Read temperatures, brake, voltage and error flags.
    ReadStatus1 = Some(0x9A), "read-status1", "2.14", Values, None, Harmless, Both;
    /// Read temperature, torque current, speed and angle.
    ReadStatus2 = Some(0x9C), "read-status2", "2.15", Values, None, Harmless, Both;
    /// Read temperature and phase currents.
    ReadStatus3 = Some(0x9D), "read-status3", "2.16", Values, None, Harmless, Both;
    /// Run at a torque current.
    Torque = Some(0xA1), "torque", "2.19", Values, None, Stale, Both;
    /// Run at a speed.
    Speed = Some(0xA2), "speed", "2.20", Values, None, Stale, Both;
    /// Go to a multi-turn angle.
    AbsolutePosition = Some(0xA4), "absolute-position", "2.21", Values, None, Stale, Both;
    /// Go to a single-turn angle in a given direction (direct-drive motors).
    SingleTurnPosition = Some(0xA6), "single-turn-position", "2.22", Values, None, Stale, Both;
    /// Go on by an angle.
    IncrementalPosition = Some(0xA8), "incremental-position", "2.23", Values, None, ActsAgain, Both;
    /// Go to a multi-turn angle with limited torque.
    ForcePosition = Some(0xA9), "force-position", "2.24", Values, None, Stale, Both;
    /// Read how long the drive has run since its last start.
    ReadRunTime = Some(0xB1), "read-run-time", "2.29", Values, None, Harmless, Both;
    /// Read the date of the drive's software.
    ReadVersionDate = Some(0xB2), "read-version-date", "2.30", Values, None, Harmless, Both;
    /// Set after how long without a command the drive stops by itself.
    CommunicationLossProtection = Some(0xB3), "communication-loss-protection", "2.31", Acknowledge, None, ActsAgain, Both;
    /// Set the bit rate of the bus.
    SetBaudRate = Some(0xB4), "set-baud-rate", "2.32", Garbled, None, ActsAgain, Both;
    /// Read the motor's model.
    ReadModel = Some(0xB5), "read-model", "2.33", Values, None, Harmless, Both;
    /// Have a reply sent by itself at an interval.
    ActiveReply = Some(0xB6), "active-reply", "2.34", Silent, KEY1, ActsAgain, CanOnly;
    /// Motion (MIT) mode: position, speed, both gains and torque in one frame.
    Motion = None, "motion", "5", Values, None, Stale, CanOnly;
}

const FIRST_BYTE: u8 = 0x20;
const LAST_BYTE: u8 = 0xB6;

/// The kind of every command byte from the first to the last.
static KINDS: [Option<Opcode>; (LAST_BYTE - FIRST_BYTE) as usize + 1] = {
    let mut kinds = [None; _];
    let mut row = 0;
    while row < Opcode::ALL.len() {
        let opcode = Opcode::ALL[row];
        if let Some(byte) = opcode.byte() {
            kinds[(byte - FIRST_BYTE) as usize] = Some(opcode);
        }
        row += 1;
    }
    kinds
};

impl Opcode {
    /// The kind with this name in tools.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|opcode| opcode.name() == name)
    }

    /// Whether `reply` can be the answer to `command`: the same command byte and, where the kind has
    /// one, the same key byte. Who sent it is the channel's affair.
    #[inline]
    pub fn answers(self, command: &Data, reply: &Data) -> bool {
        let key_agrees = match self.key_byte() {
            Some(at) => command.get(at) == reply.get(at),
            None => true,
        };
        key_agrees && self.byte().is_none_or(|byte| reply[0] == byte)
    }

    /// Whether a drive answers it with bytes that can be waited for.
    pub const fn has_reply(self) -> bool {
        !matches!(self.reply_rule(), ReplyRule::Silent | ReplyRule::Garbled)
    }
}

/// The command byte of a frame that drives were seen to send once a second after they lost their
/// master. The manual does not know it; it never answers a request.
pub const LOST_MASTER_BYTE: u8 = 0xF1;

impl fmt::Display for Opcode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.byte() {
            Some(byte) => write!(f, "{} (0x{byte:02X})", self.name()),
            None => f.write_str(self.name()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_byte_leads_back_to_its_row() {
        for &opcode in Opcode::ALL {
            if let Some(byte) = opcode.byte() {
                assert_eq!(Opcode::from_byte(byte), Some(opcode));
            }
            assert_eq!(Opcode::from_name(opcode.name()), Some(opcode));
        }
        assert_eq!(Opcode::from_byte(LOST_MASTER_BYTE), None);
    }

    #[test]
    fn an_answer_has_the_commands_byte_and_key() {
        let command = [0x30, 4, 0, 0, 0, 0, 0, 0];
        assert!(Opcode::ReadPid.answers(&command, &[0x30, 4, 0, 0, 0, 0, 0x80, 0x3F]));
        assert!(!Opcode::ReadPid.answers(&command, &[0x30, 5, 0, 0, 0, 0, 0x80, 0x3F]));
        assert!(!Opcode::ReadPid.answers(&command, &[0x31, 4, 0, 0, 0, 0, 0x80, 0x3F]));
    }
}
