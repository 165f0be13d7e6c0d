//! Any command and any reply, for drives, monitors and tools: made from the table of opcodes.

use core::any::Any;

use crate::packet::{Channel, Packet};
// The table names each kind as the type of its command, but for motion mode.
use crate::command::RawMotion as Motion;
use crate::command::*;
use crate::data::Data;
use crate::error::{DecodeError, RequestError};
use crate::firmware::Firmware;
use crate::id::Target;
use crate::kind::Kind;
use crate::opcode::{Opcode, Reach, opcode_table};

macro_rules! any {
    ($(
        $(#[$doc:meta])+
        $name:ident = $byte:tt, $kebab:literal, $section:literal, $reply:ident, $key:tt, $repeat:ident,
        $buses:ident, $reach:ident, $usage:ident, $firmware:ident;
    )+) => {
        /// Any command, known or not.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        #[non_exhaustive]
        pub enum AnyCommand {
            $($(#[$doc])+ $name($name),)+
            /// A command that the firmware in question does not know.
            Raw(RawCommand),
        }

        /// Any reply, known or not, named for the command that it answers.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        #[non_exhaustive]
        pub enum AnyReply {
            $(
                #[doc = concat!("To [`", stringify!($name), "`](AnyCommand::", stringify!($name), ").")]
                $name(<$name as Command>::Reply),
            )+
            /// A reply to a command that the firmware in question does not know.
            Raw(RawReply),
        }

        impl AnyCommand {
            /// What a master has to know of this command.
            pub fn kind(&self) -> Kind {
                match self {
                    $(Self::$name(_) => Kind::Known(Opcode::$name),)+
                    Self::Raw(command) => command.kind(),
                }
            }

            /// The command of a known kind from its data field.
            ///
            /// # Errors
            /// [`DecodeError`] if the command byte is another's or a field holds what is not allowed.
            pub fn decode_as(opcode: Opcode, data: &Data) -> Result<Self, DecodeError> {
                expect_opcode(data, opcode)?;
                match opcode { $(Opcode::$name => Fields::read(data).map(Self::$name),)+ }
            }
        }

        impl AnyReply {
            /// The reply to a command of a known kind from its data field.
            ///
            /// # Errors
            /// As [`AnyCommand::decode_as`]; [`DecodeError::NoReply`] for kinds that have none.
            pub fn decode_as(opcode: Opcode, data: &Data) -> Result<Self, DecodeError> {
                if !opcode.has_reply() {
                    return Err(DecodeError::NoReply(opcode));
                }
                expect_opcode(data, opcode)?;
                match opcode { $(Opcode::$name => Fields::read(data).map(Self::$name),)+ }
            }

            /// What it holds, whatever its type.
            pub(super) fn fields(&self) -> &dyn Any {
                match self {
                    $(Self::$name(reply) => reply,)+
                    Self::Raw(reply) => reply,
                }
            }
        }

        any!(@both AnyCommand $($name)+);
        any!(@both AnyReply $($name)+);

        impl Opcode {
            /// The fields of the command.
            pub const fn command_fields(self) -> &'static [Field] {
                match self { $(Self::$name => <$name as Fields>::FIELDS,)+ }
            }

            /// The fields of the reply; none where there is no reply.
            pub const fn reply_fields(self) -> &'static [Field] {
                match self { $(Self::$name => <<$name as Command>::Reply as Fields>::FIELDS,)+ }
            }
        }

        $(
            impl From<$name> for AnyCommand {
                fn from(command: $name) -> Self {
                    Self::$name(command)
                }
            }
            any!(@$usage $name);
        )+
    };
    (@both $any:ident $($name:ident)+) => {
        impl $any {
            /// The row in the table of the command, `None` for a raw one.
            #[inline(never)]
            pub const fn opcode(&self) -> Option<Opcode> {
                match self {
                    $(Self::$name(_) => Some(Opcode::$name),)+
                    Self::Raw(_) => None,
                }
            }

            /// The data field.
            pub fn encode(&self) -> Data {
                let mut data = self.opcode().map_or([0; 8], with_opcode);
                match self {
                    $(Self::$name(known) => known.put(&mut data),)+
                    Self::Raw(raw) => raw.put(&mut data),
                }
                data
            }
        }
    };
    (@SetPoint $name:ident) => { impl SetPoint for $name {} };
    (@$other:ident $name:ident) => {};
}

opcode_table!(any);

impl From<RawCommand> for AnyCommand {
    fn from(command: RawCommand) -> Self {
        Self::Raw(command)
    }
}

impl AnyCommand {
    /// The command in a packet, as this firmware reads it.
    ///
    /// # Errors
    /// [`DecodeError`] if the channel carries replies, the kind does not travel on it, or a field holds
    /// what is not allowed.
    pub fn decode(packet: &Packet, firmware: Firmware) -> Result<Self, DecodeError> {
        match packet.channel {
            Channel::Command(_) | Channel::BusId | Channel::Motion(_) => {
                match opcode_on(packet, firmware)? {
                    Some(opcode) => Self::decode_as(opcode, &packet.data),
                    None => Ok(Self::Raw(RawCommand::heard(packet.data))),
                }
            }
            Channel::Reply(_) | Channel::MotionReply(_) => {
                Err(DecodeError::NotACommand(packet.channel))
            }
        }
    }

    /// The command as a packet to `target`.
    ///
    /// # Errors
    /// As [`Kind::channel_to`].
    pub fn packet(&self, target: Target) -> Result<Packet, RequestError> {
        Ok(Packet { channel: self.kind().channel_to(target)?, data: self.encode() })
    }
}

impl AnyReply {
    /// The reply in a packet, as this firmware means it.
    ///
    /// # Errors
    /// [`DecodeError`] if the channel carries commands, the kind does not travel on it or has no
    /// reply, or a field holds what is not allowed.
    pub fn decode(packet: &Packet, firmware: Firmware) -> Result<Self, DecodeError> {
        match packet.channel {
            Channel::MotionReply(_) => Fields::read(&packet.data).map(Self::Motion),
            Channel::Reply(_) | Channel::BusId => match opcode_on(packet, firmware)? {
                Some(opcode) => Self::decode_as(opcode, &packet.data),
                None => Ok(Self::Raw(RawReply(packet.data))),
            },
            Channel::Command(_) | Channel::Motion(_) => Err(DecodeError::NotAReply(packet.channel)),
        }
    }
}

/// The kind of a packet from its channel and command byte, `None` where the firmware knows none.
fn opcode_on(packet: &Packet, firmware: Firmware) -> Result<Option<Opcode>, DecodeError> {
    let channel = packet.channel;
    if let Channel::Motion(_) | Channel::MotionReply(_) = channel {
        return Ok(Some(Opcode::Motion));
    }
    match Opcode::of_firmware(firmware, packet.data[0]) {
        Some(opcode) if (opcode.reach() == Reach::Connected) != (channel == Channel::BusId) => {
            Err(DecodeError::WrongChannel { opcode, channel })
        }
        known_or_not => Ok(known_or_not),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::id::MotorId;

    const M1: MotorId = MotorId::MIN;

    fn command(packet: &Packet) -> Result<AnyCommand, DecodeError> {
        AnyCommand::decode(packet, Firmware::V4_3)
    }

    #[test]
    fn unknown_command_decodes_as_raw_and_keeps_its_bytes() {
        let data = [0xC0, 1, 2, 3, 4, 5, 6, 7];
        let packet = Packet { channel: Channel::Command(M1.into()), data };
        let raw = command(&packet).unwrap();
        assert_eq!((raw.opcode(), raw.encode()), (None, data));
        assert!(raw.kind().is_refused_while_stopped());
        let reply = Packet { channel: Channel::Reply(M1), data };
        assert_eq!(AnyReply::decode(&reply, Firmware::V4_3), Ok(AnyReply::Raw(RawReply(data))));
        // V4.4 has dropped 0x90.
        let packet = ReadSingleTurnEncoder.packet(M1);
        assert_eq!(command(&packet), Ok(ReadSingleTurnEncoder.into()));
        assert_eq!(AnyCommand::decode(&packet, Firmware::V4_4).unwrap().opcode(), None);
    }

    #[test]
    fn a_reply_comes_out_as_its_type() {
        let reply = AnyReply::decode_as(Opcode::Torque, &[0xA1, 50, 100, 0, 0, 0, 0, 0]).unwrap();
        assert_eq!(Feedback::try_from(reply).unwrap().temperature.celsius(), 50.0);
        assert_eq!(Stop::try_from(reply), Err(reply));
    }

    #[test]
    fn a_kind_travels_on_its_own_channel_only() {
        let command = |channel, data| AnyCommand::decode(&Packet { channel, data }, Firmware::V4_3);
        let bus_id = [0x79, 0, 1, 0, 0, 0, 0, 0];
        let on_one = command(Channel::Command(MotorId::MIN.into()), bus_id);
        assert!(matches!(on_one, Err(DecodeError::WrongChannel { .. })));
        for byte in [0x81, 0xA1] {
            let at_0x300 = command(Channel::BusId, [byte, 0, 0, 0, 0, 0, 0, 0]);
            assert!(matches!(at_0x300, Err(DecodeError::WrongChannel { .. })), "{byte:02X}");
        }
    }
}
