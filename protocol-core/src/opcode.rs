//! The table of frame kinds: one row each, and everything that follows from the kind alone.

use core::fmt::{self, Write as _};
use core::str::FromStr;

use crate::firmware::Firmware;

/// How a drive answers a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum ReplyRule {
    /// With the same eight bytes: an acknowledgement. (An RS485 adapter's echo is something else.)
    Same,
    /// With values of its own under the same command byte.
    Values,
    /// By the manual's text with the same eight bytes, but whatever value the reply carries acknowledges: in the
    /// manual's own example the reply to 0xB3 is zeros (2.31.4).
    Acknowledge,
    /// Not at all (0x76, 0xB6).
    Silent,
    /// With bytes that mean nothing, because the bus has just changed speed (0xB4): never wait for them.
    Garbled,
}

impl ReplyRule {
    /// Whether a drive answers with bytes that can be waited for.
    pub const fn has_reply(self) -> bool {
        !matches!(self, Self::Silent | Self::Garbled)
    }
}

/// What a second sending of the same command does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Repeat {
    /// Nothing beyond the first: reads, stop and shutdown, brake, RAM writes.
    Harmless,
    /// It moves the motor to a set-point that may be stale by then.
    Stale,
    /// It acts once more: a relative move, a reset, a write to ROM, a change of id or bit rate.
    ActsAgain,
}

/// On which buses a command exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Buses {
    /// CAN and RS485.
    Both,
    /// CAN only.
    CanOnly,
}

/// Which motors a command can be sent to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Reach {
    /// To one motor, or to [all](crate::Target::All) at once (2, 3, 6).
    OneOrAll,
    /// To one motor only (5).
    One,
    /// To all that are connected; it names no motor (4, 7).
    Connected,
}

/// What is special about the use of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Usage {
    /// Nothing.
    Plain,
    /// It writes parameters. The manual wants that only while the motor stands, and not when it has just started
    /// (2.2.1, 2.3.1, 2.5.1, 2.9.1, 2.10.1, 2.31.1, 2.35.1).
    AtRest,
    /// The drive can send its reply unasked (0xB6, 2.34.2).
    Report,
    /// It moves the motor on: each one counts, so it is no set-point (0xA8).
    Move,
    /// It moves the motor and replaces the one before it: it can be streamed.
    SetPoint,
}

/// Calls a macro with the rows of the table.
macro_rules! opcode_table {
    ($callback:ident) => {
        $callback! {
    // name, byte, name in tools, section, how the drive replies, key byte, a second sending, buses,
    // which motors it reaches, what is special about its use, which firmware has it

    /// One of seven special functions.
    FunctionControl = 0x20, "function-control", "2.35", Same, 1, ActsAgain, Both, OneOrAll, AtRest, any;
    /// Read one gain of a control loop.
    ReadPid = 0x30, "read-pid", "2.1", Values, 1, Harmless, Both, OneOrAll, Plain, any;
    /// Write one gain, until power-off or reset.
    WritePidRam = 0x31, "write-pid-ram", "2.2", Same, 1, Harmless, Both, OneOrAll, AtRest, any;
    /// Write one gain for good.
    WritePidRom = 0x32, "write-pid-rom", "2.3", Same, 1, ActsAgain, Both, OneOrAll, AtRest, any;
    /// Read one of the four planning accelerations.
    ReadAcceleration = 0x42, "read-acceleration", "2.4", Values, 1, Harmless, Both, OneOrAll, Plain, any;
    /// Write one of the four planning accelerations for good.
    WriteAcceleration = 0x43, "write-acceleration", "2.5", Same, 1, ActsAgain, Both, OneOrAll, AtRest, any;
    /// Read the multi-turn encoder position, less its zero offset.
    ReadMultiTurnEncoder = 0x60, "read-multi-turn-encoder", "2.6", Values, none, Harmless, Both, OneOrAll, Report, any;
    /// Read the multi-turn encoder position without its zero offset.
    ReadMultiTurnEncoderRaw = 0x61, "read-multi-turn-encoder-raw", "2.7", Values, none, Harmless, Both, OneOrAll, Report, any;
    /// Read the zero offset of the multi-turn encoder.
    ReadMultiTurnEncoderOffset = 0x62, "read-multi-turn-encoder-offset", "2.8", Values, none, Harmless, Both, OneOrAll, Report, any;
    /// Make a given encoder position the zero, after a restart.
    SetEncoderZero = 0x63, "set-encoder-zero", "2.9", Same, none, ActsAgain, Both, OneOrAll, AtRest, any;
    /// Make the current position the zero, after a restart.
    SetCurrentPositionZero = 0x64, "set-current-position-zero", "2.10", Values, none, ActsAgain, Both, OneOrAll, AtRest, any;
    /// Read which control loop runs.
    ReadRunningMode = 0x70, "read-running-mode", "2.25", Values, none, Harmless, Both, OneOrAll, Plain, any;
    /// Restart the drive.
    Reset = 0x76, "reset", "2.26", Silent, none, ActsAgain, Both, OneOrAll, Plain, any;
    /// Open the brake.
    ReleaseBrake = 0x77, "release-brake", "2.27", Same, none, Harmless, Both, OneOrAll, Plain, any;
    /// Close the brake.
    LockBrake = 0x78, "lock-brake", "2.28", Same, none, Harmless, Both, OneOrAll, Plain, any;
    /// Read or set the motor id of whatever is connected.
    BusId = 0x79, "bus-id", "4", Values, 2, ActsAgain, Both, Connected, Plain, until_v4_3;
    /// Switch the output off and leave every control mode.
    Shutdown = 0x80, "shutdown", "2.17", Same, none, Harmless, Both, OneOrAll, Plain, any;
    /// Stop and hold still.
    Stop = 0x81, "stop", "2.18", Same, none, Harmless, Both, OneOrAll, Plain, any;
    /// Read the single-turn encoder (direct-drive motors).
    ReadSingleTurnEncoder = 0x90, "read-single-turn-encoder", "2.11", Values, none, Harmless, Both, OneOrAll, Plain, until_v4_3;
    /// Read the multi-turn angle of the output shaft.
    ReadMultiTurnAngle = 0x92, "read-multi-turn-angle", "2.12", Values, none, Harmless, Both, OneOrAll, Report, any;
    /// Read the single-turn angle (direct-drive motors).
    ReadSingleTurnAngle = 0x94, "read-single-turn-angle", "2.13", Values, none, Harmless, Both, OneOrAll, Plain, until_v4_3;
    /// Read the single-turn angle, as V4.4 answers it.
    ReadSingleTurnAngleV4_4 = 0x94, "read-single-turn-angle-v4.4", "2.13", Values, none, Harmless, Both, OneOrAll, Plain, since_v4_4;
    /// Read temperatures, brake, voltage and error flags.
    ReadStatus1 = 0x9A, "read-status1", "2.14", Values, none, Harmless, Both, OneOrAll, Report, any;
    /// Read temperature, torque current, speed and angle.
    ReadStatus2 = 0x9C, "read-status2", "2.15", Values, none, Harmless, Both, OneOrAll, Report, any;
    /// Read temperature and phase currents.
    ReadStatus3 = 0x9D, "read-status3", "2.16", Values, none, Harmless, Both, OneOrAll, Report, any;
    /// Run at a torque current.
    Torque = 0xA1, "torque", "2.19", Values, none, Stale, Both, OneOrAll, SetPoint, any;
    /// Run at a speed.
    Speed = 0xA2, "speed", "2.20", Values, none, Stale, Both, OneOrAll, SetPoint, any;
    /// Go to a multi-turn angle.
    AbsolutePosition = 0xA4, "absolute-position", "2.21", Values, none, Stale, Both, OneOrAll, SetPoint, any;
    /// Go to a single-turn angle in a given direction (direct-drive motors).
    SingleTurnPosition = 0xA6, "single-turn-position", "2.22", Values, none, Stale, Both, OneOrAll, SetPoint, any;
    /// Go on by an angle.
    IncrementalPosition = 0xA8, "incremental-position", "2.23", Values, none, ActsAgain, Both, OneOrAll, Move, any;
    /// Go to a multi-turn angle with limited torque.
    ForcePosition = 0xA9, "force-position", "2.24", Values, none, Stale, Both, OneOrAll, SetPoint, any;
    /// Read how long the drive has run since its last start.
    ReadRunTime = 0xB1, "read-run-time", "2.29", Values, none, Harmless, Both, OneOrAll, Plain, any;
    /// Read the date of the drive's software.
    ReadVersionDate = 0xB2, "read-version-date", "2.30", Values, none, Harmless, Both, OneOrAll, Plain, any;
    /// Set after how long without a command the drive stops by itself.
    CommunicationLossProtection = 0xB3, "communication-loss-protection", "2.31", Acknowledge, none, ActsAgain, Both, OneOrAll, AtRest, any;
    /// Set the bit rate of the bus.
    SetBaudRate = 0xB4, "set-baud-rate", "2.32", Garbled, none, ActsAgain, Both, OneOrAll, Plain, until_v4_3;
    /// Read the motor's model.
    ReadModel = 0xB5, "read-model", "2.33", Values, none, Harmless, Both, OneOrAll, Plain, until_v4_3;
    /// Have a reply sent by itself at an interval.
    ActiveReply = 0xB6, "active-reply", "2.34", Silent, 1, ActsAgain, CanOnly, OneOrAll, Plain, any;
    /// Motion (MIT) mode: position, speed, both gains and torque in one frame.
    Motion = none, "motion", "5", Values, none, Stale, CanOnly, One, SetPoint, any;
        }
    };
}
pub(crate) use opcode_table;

macro_rules! opcodes {
    ($(
        $(#[doc = $doc:literal])+
        $name:ident = $byte:tt, $kebab:literal, $section:literal, $reply:ident, $key:tt, $repeat:ident,
        $buses:ident, $reach:ident, $usage:ident, $firmware:ident;
    )+) => {
        /// A kind of frame: a row of the table.
        ///
        /// | kind | byte | CAN identifier | manual | answered | buses | firmware |
        /// |---|---|---|---|---|---|---|
        $(#[doc = concat!(
            "| [`", $kebab, "`](Self::", stringify!($name), ") | ", stringify!($byte), " | ",
            opcodes!(@identifier $reach), " | ", $section, " | ", stringify!($reply), " | ",
            stringify!($buses), " | ", stringify!($firmware), " |"
        )])+
        ///
        /// Replies come from 0x240 + id, those to 0x300 from 0x300, those to 0x400 + id from
        /// 0x500 + id. On RS485 the address is the motor's id both ways, and 0xCD for all and for
        /// 0x79. How a command is answered is a [`ReplyRule`]. `none`: motion mode has no command byte,
        /// and its identifier alone says what it is. `any`: every [`Firmware`] that is known here.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[non_exhaustive]
        pub enum Opcode {
            $(
                $(#[doc = $doc])+
                #[doc = concat!("Manual ", $section, ".")]
                $name,
            )+
        }

        impl Opcode {
            /// Every kind, in the order of the table.
            pub const ALL: &'static [Self] = &[$(Self::$name),+];

            /// The command byte, which is the first of the data field; `None` for motion mode, which
            /// has none and is known by its identifier.
            #[inline]
            pub const fn byte(self) -> Option<u8> {
                // A match would become a jump table wherever it is inlined.
                const BYTES: [Option<u8>; Opcode::ALL.len()] = [$(opcodes!(@option $byte)),+];
                BYTES[self as usize]
            }

            /// Its name in tools: `"read-multi-turn-angle"`.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$name => $kebab,)+ }
            }

            /// What it does, in a sentence.
            pub const fn meaning(self) -> &'static str {
                match self { $(Self::$name => concat!($($doc),+).trim_ascii(),)+ }
            }

            /// The section of the manual that describes it.
            pub const fn section(self) -> &'static str {
                match self { $(Self::$name => $section,)+ }
            }

            /// How a drive answers it.
            pub const fn reply_rule(self) -> ReplyRule {
                match self { $(Self::$name => ReplyRule::$reply,)+ }
            }

            /// The place of the byte that must agree between command and reply, besides the command byte: a parameter's
            /// index, or read and write of a bus id.
            pub const fn key_byte(self) -> Option<usize> {
                match self { $(Self::$name => opcodes!(@option $key),)+ }
            }

            /// What a second sending does.
            pub const fn repeat(self) -> Repeat {
                match self { $(Self::$name => Repeat::$repeat,)+ }
            }

            /// On which buses it exists.
            pub const fn buses(self) -> Buses {
                match self { $(Self::$name => Buses::$buses,)+ }
            }

            /// Which motors it can be sent to.
            pub const fn reach(self) -> Reach {
                match self { $(Self::$name => Reach::$reach,)+ }
            }

            /// What is special about its use.
            pub const fn usage(self) -> Usage {
                match self { $(Self::$name => Usage::$usage,)+ }
            }

            /// Whether this firmware has it.
            pub const fn is_in(self, firmware: Firmware) -> bool {
                match self { $(Self::$name => opcodes!(@in firmware $firmware),)+ }
            }
        }
    };
    (@option none) => { None };
    (@option $value:literal) => { Some($value) };
    (@in $asked:ident any) => { true };
    (@in $asked:ident until_v4_3) => { $asked as u8 <= Firmware::V4_3 as u8 };
    (@in $asked:ident since_v4_4) => { $asked as u8 >= Firmware::V4_4 as u8 };
    (@identifier OneOrAll) => { "0x140 + id, all 0x280" };
    (@identifier One) => { "0x400 + id" };
    (@identifier Connected) => { "0x300" };
}

opcode_table!(opcodes);

/// The rows of the table in the documentation of [`command`](crate::command).
macro_rules! command_rows {
    ($(
        $(#[doc = $doc:literal])+
        $name:ident = $byte:tt, $kebab:literal, $section:literal, $reply:ident, $key:tt, $repeat:ident,
        $buses:ident, $reach:ident, $usage:ident, $firmware:ident;
    )+) => {
        concat!($(
            "| [`", $crate::opcode::command_rows!(@type $name), "`] | ", stringify!($byte), " | ",
            $section, " | [`", stringify!($reply), "`](crate::opcode::ReplyRule::",
            stringify!($reply), ") |", $($doc),+, " |\n"
        ),+)
    };
    (@type Motion) => { "RawMotion" };
    (@type $name:ident) => { stringify!($name) };
}
pub(crate) use command_rows;

const FIRST_BYTE: u8 = 0x20;
const LAST_BYTE: u8 = 0xB6;
const BYTES: usize = (LAST_BYTE - FIRST_BYTE) as usize + 1;
type Kinds = [Option<Opcode>; BYTES];

/// The kind of every command byte from the first to the last, in one firmware.
const fn kinds(firmware: Firmware) -> Kinds {
    let mut kinds: Kinds = [None; BYTES];
    let mut row = 0;
    while row < Opcode::ALL.len() {
        let opcode = Opcode::ALL[row];
        if let (true, Some(byte)) = (opcode.is_in(firmware), opcode.byte()) {
            kinds[(byte - FIRST_BYTE) as usize] = Some(opcode);
        }
        row += 1;
    }
    kinds
}

static V4_3: Kinds = kinds(Firmware::V4_3);
static V4_4: Kinds = kinds(Firmware::V4_4);

impl Opcode {
    /// The kind that a firmware knows under this command byte.
    #[inline]
    pub const fn of_firmware(firmware: Firmware, byte: u8) -> Option<Self> {
        let kinds = match firmware {
            Firmware::V4_3 => &V4_3,
            Firmware::V4_4 => &V4_4,
        };
        let place = byte.wrapping_sub(FIRST_BYTE) as usize;
        if place < kinds.len() { kinds[place] } else { None }
    }

    /// The kind under this command byte in the oldest firmware that has it. Two firmwares may lay its
    /// fields out differently, but how it is answered, repeated and used is the same in all.
    #[inline]
    pub const fn from_byte(byte: u8) -> Option<Self> {
        let mut rest = Firmware::ALL;
        while let [firmware, after @ ..] = rest {
            if let Some(opcode) = Self::of_firmware(*firmware, byte) {
                return Some(opcode);
            }
            rest = after;
        }
        None
    }

    /// Whether a drive answers it with bytes that can be waited for.
    pub const fn has_reply(self) -> bool {
        self.reply_rule().has_reply()
    }

    /// Its place among those whose reply can be reported (0xB6), from 0; `None` for all others.
    pub(crate) fn report_place(self) -> Option<u32> {
        let reports = |opcode: &&Self| opcode.usage() == Usage::Report;
        let place = Self::ALL.iter().filter(reports).position(|&opcode| opcode == self)?;
        u32::try_from(place).ok()
    }
}

/// A byte that no firmware known here has for a command, or a name that no command has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no command has this byte or name: see the table of opcodes")]
pub struct UnknownOpcode;

impl TryFrom<u8> for Opcode {
    type Error = UnknownOpcode;
    fn try_from(byte: u8) -> Result<Self, UnknownOpcode> {
        Self::from_byte(byte).ok_or(UnknownOpcode)
    }
}

/// By its name in tools.
impl FromStr for Opcode {
    type Err = UnknownOpcode;
    fn from_str(name: &str) -> Result<Self, UnknownOpcode> {
        Self::ALL.iter().copied().find(|opcode| opcode.name() == name).ok_or(UnknownOpcode)
    }
}

impl fmt::Display for Opcode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.byte() {
            Some(byte) => {
                let mut text = heapless::String::<48>::new();
                write!(text, "{} (0x{byte:02X})", self.name())?;
                f.pad(&text)
            }
            None => f.pad(self.name()),
        }
    }
}

/// By its name in every format: once a row is added, a place in the table would mean another command.
#[cfg(feature = "serde")]
impl serde::Serialize for Opcode {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

#[cfg(feature = "serde")]
impl<'de> serde::Deserialize<'de> for Opcode {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl serde::de::Visitor<'_> for Visitor {
            type Value = Opcode;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a command's name")
            }
            fn visit_str<E: serde::de::Error>(self, name: &str) -> Result<Opcode, E> {
                name.parse().map_err(E::custom)
            }
        }
        deserializer.deserialize_str(Visitor)
    }
}

/// The command byte of a frame that drives were seen to send once a second after they lost their master. The manual
/// does not describe it; it is never the reply to a request.
pub const LOST_MASTER_BYTE: u8 = 0xF1;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn facts_of_a_command_byte_are_the_same_in_every_firmware() {
        for &opcode in Opcode::ALL {
            let Some(first) = opcode.byte().and_then(Opcode::from_byte) else { continue };
            let facts = |o: Opcode| {
                (o.reply_rule(), o.key_byte(), o.repeat(), o.buses(), o.reach(), o.usage())
            };
            assert_eq!(facts(opcode), facts(first), "{opcode:?}");
        }
    }
}
