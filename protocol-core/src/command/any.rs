//! Any command and any reply, for drives, monitors and tools.

use crate::channel::{Channel, Packet};
use crate::command::layout::Fields;
use crate::command::{self, expect_opcode};
use crate::error::{DecodeError, RequestError};
use crate::field::Data;
use crate::id::Target;
use crate::opcode::{Buses, Opcode};

macro_rules! any {
    (
        answered { $($opcode:ident: $command:ident => $reply:ty,)+ }
        silent { $($silent:ident,)+ }
    ) => {
        /// Any command of protocol V4.3.
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        #[allow(missing_docs, reason = "each variant is its type, which is documented")]
        pub enum AnyCommand {
            $($opcode(command::$command),)+
            $($silent(command::$silent),)+
        }

        /// Any reply of protocol V4.3, named for the command that it answers.
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        #[allow(missing_docs, reason = "each variant is its command's reply, which is documented")]
        pub enum AnyReply {
            $($opcode($reply),)+
        }

        impl AnyCommand {
            /// Its row in the table.
            #[inline(never)]
            pub const fn opcode(&self) -> Opcode {
                match self {
                    $(Self::$opcode(_) => Opcode::$opcode,)+
                    $(Self::$silent(_) => Opcode::$silent,)+
                }
            }

            /// The data field.
            pub fn encode(&self) -> Data {
                let mut data = with_opcode(self.opcode());
                match self {
                    $(Self::$opcode(command) => command.put(&mut data),)+
                    $(Self::$silent(command) => command.put(&mut data),)+
                }
                data
            }

            /// The command of a known kind from its data field.
            ///
            /// # Errors
            /// As [`Command::decode`](command::Command::decode).
            pub fn decode_as(opcode: Opcode, data: &Data) -> Result<Self, DecodeError> {
                expect_opcode(data, opcode)?;
                match opcode {
                    $(Opcode::$opcode => Fields::read(data).map(Self::$opcode),)+
                    $(Opcode::$silent => Fields::read(data).map(Self::$silent),)+
                }
            }
        }

        impl AnyReply {
            /// The row in the table of the command that it answers.
            #[inline(never)]
            pub const fn opcode(&self) -> Opcode {
                match self { $(Self::$opcode(_) => Opcode::$opcode,)+ }
            }

            /// The data field.
            pub fn encode(&self) -> Data {
                let mut data = with_opcode(self.opcode());
                match self { $(Self::$opcode(reply) => reply.put(&mut data),)+ }
                data
            }

            /// The reply to a command of a known kind from its data field.
            ///
            /// # Errors
            /// As [`Command::decode_reply`](command::Command::decode_reply); [`DecodeError::NoReply`] for kinds that have none.
            pub fn decode_as(opcode: Opcode, data: &Data) -> Result<Self, DecodeError> {
                if !opcode.has_reply() {
                    return Err(DecodeError::NoReply(opcode));
                }
                expect_opcode(data, opcode)?;
                match opcode {
                    $(Opcode::$opcode => Fields::read(data).map(Self::$opcode),)+
                    $(Opcode::$silent => Err(DecodeError::NoReply(opcode)),)+
                }
            }
        }

        $(impl From<command::$command> for AnyCommand {
            fn from(command: command::$command) -> Self {
                Self::$opcode(command)
            }
        })+
        $(impl From<command::$silent> for AnyCommand {
            fn from(command: command::$silent) -> Self {
                Self::$silent(command)
            }
        })+
    };
}

any! {
    answered {
        FunctionControl: FunctionControl => command::FunctionControl,
        ReadPid: ReadPid => command::PidGain,
        WritePidRam: WritePidRam => command::WritePidRam,
        WritePidRom: WritePidRom => command::WritePidRom,
        ReadAcceleration: ReadAcceleration => command::AccelerationReading,
        WriteAcceleration: WriteAcceleration => command::WriteAcceleration,
        ReadMultiTurnEncoder: ReadMultiTurnEncoder => command::MultiTurnEncoder,
        ReadMultiTurnEncoderRaw: ReadMultiTurnEncoderRaw => command::MultiTurnEncoderRaw,
        ReadMultiTurnEncoderOffset: ReadMultiTurnEncoderOffset => command::MultiTurnEncoderOffset,
        SetEncoderZero: SetEncoderZero => command::SetEncoderZero,
        SetCurrentPositionZero: SetCurrentPositionZero => command::MultiTurnEncoderOffset,
        ReadRunningMode: ReadRunningMode => command::RunningMode,
        ReleaseBrake: ReleaseBrake => command::ReleaseBrake,
        LockBrake: LockBrake => command::LockBrake,
        BusId: BusId => command::BusIdReply,
        Shutdown: Shutdown => command::Shutdown,
        Stop: Stop => command::Stop,
        ReadSingleTurnEncoder: ReadSingleTurnEncoder => command::SingleTurnEncoder,
        ReadMultiTurnAngle: ReadMultiTurnAngle => command::MultiTurnAngle,
        ReadSingleTurnAngle: ReadSingleTurnAngle => command::CircleAngle,
        ReadStatus1: ReadStatus1 => command::Status1,
        ReadStatus2: ReadStatus2 => command::Feedback,
        ReadStatus3: ReadStatus3 => command::Status3,
        Torque: Torque => command::Feedback,
        Speed: Speed => command::Feedback,
        AbsolutePosition: AbsolutePosition => command::Feedback,
        SingleTurnPosition: SingleTurnPosition => command::SingleTurnFeedback,
        IncrementalPosition: IncrementalPosition => command::Feedback,
        ForcePosition: ForcePosition => command::Feedback,
        ReadRunTime: ReadRunTime => command::RunTime,
        ReadVersionDate: ReadVersionDate => command::Version,
        CommunicationLossProtection: CommunicationLossProtection => command::CommunicationLossProtection,
        ReadModel: ReadModel => command::Model,
        Motion: RawMotion => command::RawMotionFeedback,
    }
    silent { Reset, SetBaudRate, ActiveReply, }
}

impl AnyCommand {
    /// The command in a packet.
    ///
    /// # Errors
    /// [`DecodeError`] if the channel carries replies, the kind does not travel on it, the command
    /// byte is unknown, or a field holds what is not allowed.
    pub fn decode(packet: &Packet) -> Result<Self, DecodeError> {
        match packet.channel {
            Channel::Command(_) | Channel::BusId | Channel::Motion(_) => {
                Self::decode_as(opcode_on(packet)?, &packet.data)
            }
            Channel::Reply(_) | Channel::MotionReply(_) => {
                Err(DecodeError::NotACommand(packet.channel))
            }
        }
    }

    /// The command as a packet to `target`.
    ///
    /// # Errors
    /// As [`channel_of`].
    pub fn packet(&self, target: Target) -> Result<Packet, RequestError> {
        Ok(Packet { channel: channel_of(self.opcode(), target)?, data: self.encode() })
    }
}

impl AnyReply {
    /// The reply in a packet.
    ///
    /// # Errors
    /// [`DecodeError`] if the channel carries commands, the kind does not travel on it or has no
    /// reply, the command byte is unknown, or a field holds what is not allowed.
    pub fn decode(packet: &Packet) -> Result<Self, DecodeError> {
        match packet.channel {
            Channel::Reply(_) | Channel::BusId | Channel::MotionReply(_) => {
                Self::decode_as(opcode_on(packet)?, &packet.data)
            }
            Channel::Command(_) | Channel::Motion(_) => Err(DecodeError::NotAReply(packet.channel)),
        }
    }
}

/// A data field that holds nothing but its command byte.
fn with_opcode(opcode: Opcode) -> Data {
    [opcode.byte().unwrap_or(0), 0, 0, 0, 0, 0, 0, 0]
}

/// The kind of a packet from its channel and command byte.
fn opcode_on(packet: &Packet) -> Result<Opcode, DecodeError> {
    let channel = packet.channel;
    if let Channel::Motion(_) | Channel::MotionReply(_) = channel {
        return Ok(Opcode::Motion);
    }
    let opcode =
        Opcode::from_byte(packet.data[0]).ok_or(DecodeError::UnknownOpcode(packet.data[0]))?;
    if (opcode == Opcode::BusId) == (channel == Channel::BusId) {
        Ok(opcode)
    } else {
        Err(DecodeError::WrongChannel { opcode, channel })
    }
}

/// The channel on which a command of this kind reaches `target`.
///
/// # Errors
/// [`RequestError::OneMotorOnly`] for motion mode to all, [`RequestError::AllMotorsOnly`] for a bus
/// id to one.
pub const fn channel_of(opcode: Opcode, target: Target) -> Result<Channel, RequestError> {
    match (opcode, target) {
        (Opcode::BusId, Target::All) => Ok(Channel::BusId),
        (Opcode::BusId, Target::Motor(_)) => Err(RequestError::AllMotorsOnly(opcode)),
        (Opcode::Motion, Target::Motor(id)) => Ok(Channel::Motion(id)),
        (Opcode::Motion, Target::All) => Err(RequestError::OneMotorOnly(opcode)),
        (_, target) => Ok(Channel::Command(target)),
    }
}

/// Refuses kinds that RS485 does not have.
///
/// # Errors
/// [`RequestError::CanOnly`].
pub const fn check_on_rs485(opcode: Opcode) -> Result<(), RequestError> {
    match opcode.buses() {
        Buses::Both => Ok(()),
        Buses::CanOnly => Err(RequestError::CanOnly(opcode)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::id::MotorId;

    const M1: MotorId = MotorId::MIN;

    #[test]
    fn a_kind_travels_on_its_own_channel_only() {
        let bus_id = [0x79, 0, 1, 0, 0, 0, 0, 0];
        let on_one = Packet { channel: Channel::Command(Target::Motor(M1)), data: bus_id };
        assert!(matches!(AnyCommand::decode(&on_one), Err(DecodeError::WrongChannel { .. })));
        let stop = [0x81, 0, 0, 0, 0, 0, 0, 0];
        let on_bus_id = Packet { channel: Channel::BusId, data: stop };
        assert!(matches!(AnyCommand::decode(&on_bus_id), Err(DecodeError::WrongChannel { .. })));
        let reply = Packet { channel: Channel::Reply(M1), data: stop };
        assert!(matches!(AnyCommand::decode(&reply), Err(DecodeError::NotACommand(_))));
        assert_eq!(AnyReply::decode(&reply), Ok(AnyReply::Stop(command::Stop)));
    }

    #[test]
    fn some_kinds_go_to_one_motor_only_or_to_all_only() {
        let read = AnyCommand::from(command::BusId::Read);
        assert_eq!(read.packet(M1.into()), Err(RequestError::AllMotorsOnly(Opcode::BusId)));
        assert_eq!(read.packet(Target::All).unwrap().channel, Channel::BusId);
        let motion = AnyCommand::from(command::RawMotion::from_data(&[0; 8]));
        assert_eq!(motion.packet(Target::All), Err(RequestError::OneMotorOnly(Opcode::Motion)));
        assert_eq!(motion.packet(M1.into()).unwrap().channel, Channel::Motion(M1));
    }
}
