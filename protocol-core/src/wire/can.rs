//! CAN identifiers, and the conversion to and from the frames of any HAL (manual 1.1, 3, 4, 5).
//!
//! | identifier | carries |
//! |---|---|
//! | 0x140 + id | command to one motor |
//! | 0x240 + id | its reply |
//! | 0x280 | command to all motors whose id filter is off |
//! | 0x300 | bus id setting, both ways |
//! | 0x400 + id | motion mode command |
//! | 0x500 + id | its reply |
//!
//! All are data frames with standard identifiers and eight bytes.

use embedded_can::{Frame, Id, StandardId};

use crate::data::Data;
use crate::id::{MotorId, Target};
use crate::packet::{Channel, Packet};

const COMMAND: u16 = 0x140;
const REPLY: u16 = 0x240;
const COMMAND_ALL: u16 = 0x280;
const BUS_ID: u16 = 0x300;
const MOTION: u16 = 0x400;
const MOTION_REPLY: u16 = 0x500;

/// The identifier of a channel.
#[inline]
pub const fn identifier(channel: Channel) -> u16 {
    match channel {
        Channel::Command(Target::Motor(id)) => COMMAND + id.get() as u16,
        Channel::Command(Target::All) => COMMAND_ALL,
        Channel::Reply(id) => REPLY + id.get() as u16,
        Channel::BusId => BUS_ID,
        Channel::Motion(id) => MOTION + id.get() as u16,
        Channel::MotionReply(id) => MOTION_REPLY + id.get() as u16,
    }
}

/// The channel of an identifier; `None` if the protocol does not use it.
#[inline]
pub const fn channel_at(identifier: u16) -> Option<Channel> {
    match identifier {
        COMMAND_ALL => Some(Channel::Command(Target::All)),
        BUS_ID => Some(Channel::BusId),
        _ => {
            let base = identifier & !0x3F;
            let Ok(id) = MotorId::new((identifier & 0x3F) as u8) else { return None };
            match base {
                COMMAND => Some(Channel::Command(Target::Motor(id))),
                REPLY => Some(Channel::Reply(id)),
                MOTION => Some(Channel::Motion(id)),
                MOTION_REPLY => Some(Channel::MotionReply(id)),
                _ => None,
            }
        }
    }
}

/// What a frame from the bus is. Only [`Packet`](Self::Packet) belongs to the protocol. The others are reported for
/// programs that watch a bus. They are no reason to stop one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Received {
    /// A frame of the protocol.
    Packet(Packet),
    /// An identifier of the protocol, with a length other than eight bytes. Some drives send such frames; their meaning
    /// is not defined.
    WrongLength {
        /// Its channel.
        channel: Channel,
        /// How many data bytes it had.
        length: usize,
        /// Its first byte: the command byte if it has one.
        first: Option<u8>,
    },
    /// A standard identifier that the protocol does not use.
    Foreign(u16),
    /// A frame with an extended identifier.
    Extended(u32),
    /// A remote frame.
    Remote,
}

/// Decodes a frame.
#[inline]
pub fn decode<F: Frame>(frame: &F) -> Received {
    let raw = match frame.id() {
        Id::Standard(id) => id.as_raw(),
        Id::Extended(id) => return Received::Extended(id.as_raw()),
    };
    if frame.is_remote_frame() {
        return Received::Remote;
    }
    let Some(channel) = channel_at(raw) else { return Received::Foreign(raw) };
    match <&Data>::try_from(frame.data()) {
        Ok(data) => Received::Packet(Packet { channel, data: *data }),
        Err(_) => {
            let data = frame.data();
            Received::WrongLength { channel, length: data.len(), first: data.first().copied() }
        }
    }
}

/// The frame that carries a packet. `None` only if a HAL refuses eight bytes.
///
/// ```
/// use myactuator_protocol_core::{Channel, MotorId, Packet, Target, command::Stop, wire::can};
/// # use myactuator_protocol_core::wire::can::SimpleFrame as HalFrame;
/// use embedded_can::Frame;
///
/// let to = Target::Motor(MotorId::new(1)?);
/// let packet = Packet { channel: Channel::Command(to), data: Stop.encode() };
/// let frame: HalFrame = can::encode(&packet).unwrap();
/// assert_eq!(frame.data(), [0x81, 0, 0, 0, 0, 0, 0, 0]);
/// assert_eq!(can::decode(&frame), can::Received::Packet(packet));
/// # Ok::<(), myactuator_protocol_core::OutOfRange>(())
/// ```
#[inline]
pub fn encode<F: Frame>(packet: &Packet) -> Option<F> {
    F::new(StandardId::new(identifier(packet.channel))?, &packet.data)
}

/// A frame in memory, for code without a HAL: tests, simulated buses, loggers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SimpleFrame {
    id: Id,
    remote: bool,
    length: u8,
    data: Data,
}

impl SimpleFrame {
    /// The frame that carries a packet: [`encode`] at compile time.
    pub const fn from_packet(packet: &Packet) -> Self {
        let id = match StandardId::new(identifier(packet.channel)) {
            Some(id) => id,
            None => StandardId::MAX, // no channel has more than eleven bits
        };
        Self { id: Id::Standard(id), remote: false, length: 8, data: packet.data }
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for SimpleFrame {
    fn format(&self, f: defmt::Formatter<'_>) {
        let (id, extended) = match self.id {
            Id::Standard(id) => (u32::from(id.as_raw()), false),
            Id::Extended(id) => (id.as_raw(), true),
        };
        defmt::write!(
            f,
            "{=u32:x} extended {} remote {} {=[u8]:x}",
            id,
            extended,
            self.remote,
            self.data()
        );
    }
}

impl Frame for SimpleFrame {
    fn new(id: impl Into<Id>, data: &[u8]) -> Option<Self> {
        let mut bytes = [0; 8];
        bytes.get_mut(..data.len())?.copy_from_slice(data);
        Some(Self { id: id.into(), remote: false, length: data.len() as u8, data: bytes })
    }

    fn new_remote(id: impl Into<Id>, dlc: usize) -> Option<Self> {
        let length = u8::try_from(dlc).ok().filter(|&dlc| dlc <= 8)?;
        Some(Self { id: id.into(), remote: true, length, data: [0; 8] })
    }

    fn is_extended(&self) -> bool {
        matches!(self.id, Id::Extended(_))
    }

    fn is_remote_frame(&self) -> bool {
        self.remote
    }

    fn id(&self) -> Id {
        self.id
    }

    fn dlc(&self) -> usize {
        self.length.into()
    }

    fn data(&self) -> &[u8] {
        if self.remote {
            return &[];
        }
        self.data.get(..self.length.into()).unwrap_or(&self.data)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_made_at_compile_time() {
        const STOP: SimpleFrame =
            SimpleFrame::from_packet(&crate::command::Stop.packet(MotorId::MIN));
        assert_eq!(Some(STOP), encode(&crate::command::Stop.packet(MotorId::MIN)));
        assert_eq!(STOP.data(), [0x81, 0, 0, 0, 0, 0, 0, 0]);
    }

    #[test]
    fn each_channel_has_its_identifier() {
        let motor = MotorId::new(32).unwrap();
        for (channel, expected) in [
            (Channel::Command(Target::Motor(motor)), 0x160),
            (Channel::Reply(motor), 0x260),
            (Channel::Command(Target::All), 0x280),
            (Channel::BusId, 0x300),
            (Channel::Motion(motor), 0x420),
            (Channel::MotionReply(motor), 0x520),
        ] {
            assert_eq!(identifier(channel), expected);
            assert_eq!(channel_at(expected), Some(channel));
        }
    }

    #[test]
    fn a_remote_frame_has_a_length_and_no_data() {
        let remote = |length| SimpleFrame::new_remote(StandardId::ZERO, length);
        let frame = remote(8).unwrap();
        assert!(frame.is_remote_frame() && frame.dlc() == 8 && frame.data().is_empty());
        assert_eq!(remote(9), None);
    }

    #[test]
    fn frame_reports_whether_its_identifier_is_standard_or_extended() {
        let extended = SimpleFrame::new(embedded_can::ExtendedId::ZERO, &[]).unwrap();
        assert!(extended.is_extended() && !extended.is_standard());
        let standard = SimpleFrame::new(StandardId::ZERO, &[]).unwrap();
        assert!(standard.is_standard() && !standard.is_extended());
    }
}
