//! RS485 framing, `3E id 08 D0..D7 CRClow CRChigh`, and a receiver that takes one byte after the other (manual 1.2, 6).

use crc::{CRC_16_MODBUS, Crc, NoTable};

use crate::data::Data;
use crate::id::{MotorId, Target};
use crate::opcode::{Buses, Opcode};
use crate::packet::{Channel, Packet};

/// Bytes in a frame.
pub const FRAME_LENGTH: usize = 13;
/// The first byte of every frame.
pub const HEADER: u8 = 0x3E;
/// The address of all motors.
pub const ALL: u8 = 0xCD;
const DATA_LENGTH: u8 = 8;
const LAST_PLACE: usize = FRAME_LENGTH - 1;

/// The CRC's initial value.
const CRC_START: u16 = CRC_16_MODBUS.init;
/// The CRC of the first byte of every frame.
const CRC_OF_HEADER: u16 = crc_over(CRC_START, HEADER);
/// The CRC over a whole frame, including its own two bytes.
const CRC_GOOD: u16 = 0;

/// The CRC of each single byte, starting from 0. The manual says "CRC16, low byte first" (1.2.2); drives use that of
/// MODBUS.
static CRC_OF_BYTE: [u16; 256] = {
    let crc = Crc::<u16, NoTable>::new(&CRC_16_MODBUS);
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < table.len() {
        let mut digest = crc.digest_with_initial(0);
        digest.update(&[byte as u8]);
        table[byte] = digest.finalize();
        byte += 1;
    }
    table
};

/// Adds one byte to a CRC.
#[inline(always)]
const fn crc_over(crc: u16, byte: u8) -> u16 {
    CRC_OF_BYTE[(crc as u8 ^ byte) as usize] ^ crc >> 8
}

/// One frame on the line.
///
/// On RS485 a command and its reply look the same: both carry the motor's address. Only the receiver knows which one it
/// is; see [`as_command`](Self::as_command) and [`as_reply`](Self::as_reply).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Frame {
    /// The address: one motor's, or that of all motors.
    pub address: Target,
    /// The eight data bytes.
    pub data: Data,
}

impl Frame {
    /// The frame that carries a packet. `None` for what RS485 does not have: motion mode, active reply (0xB6), and, on
    /// the channel of bus ids, any other command, which would become a command to all.
    #[inline]
    pub const fn from_packet(packet: &Packet) -> Option<Self> {
        let address = match packet.channel {
            Channel::Command(target) => target,
            Channel::Reply(id) => Target::Motor(id),
            Channel::BusId if is_bus_id(&packet.data) => Target::All,
            Channel::BusId | Channel::Motion(_) | Channel::MotionReply(_) => return None,
        };
        match Opcode::from_byte(packet.data[0]) {
            Some(opcode) if matches!(opcode.buses(), Buses::CanOnly) => None,
            _ => Some(Self { address, data: packet.data }),
        }
    }

    /// Decodes 13 bytes that are known to be a frame: from a DMA buffer, or after the `idle` interrupt of a serial
    /// port. If it is not known where frames begin, use a [`Receiver`].
    ///
    /// # Errors
    /// What is wrong with the bytes.
    pub fn decode(line: &[u8; FRAME_LENGTH]) -> Result<Self, Fault> {
        let [header, id, length, data @ .., low, high] = *line;
        if header != HEADER {
            return Err(Fault::Header);
        }
        let address = address(id).ok_or(Fault::Address)?;
        if length != DATA_LENGTH {
            return Err(Fault::Length);
        }
        let frame = Self { address, data };
        let [.., right_low, right_high] = frame.encode();
        if [low, high] == [right_low, right_high] { Ok(frame) } else { Err(Fault::Crc) }
    }

    /// The frame as a drive hears it.
    #[inline]
    pub fn as_command(&self) -> Packet {
        let channel =
            if self.is_bus_id() { Channel::BusId } else { Channel::Command(self.address) };
        Packet { channel, data: self.data }
    }

    /// The frame as a master hears it; `None` for a command to all, which no drive sends.
    #[inline]
    pub fn as_reply(&self) -> Option<Packet> {
        let channel = match self.address {
            Target::Motor(id) => Channel::Reply(id),
            Target::All if self.is_bus_id() => Channel::BusId,
            Target::All => return None,
        };
        Some(Packet { channel, data: self.data })
    }

    fn is_bus_id(&self) -> bool {
        self.address == Target::All && is_bus_id(&self.data)
    }

    /// The bytes on the line.
    ///
    /// ```
    /// use myactuator_protocol_core::{MotorId, Target, wire::rs485::Frame};
    ///
    /// let read_pid = Frame {
    ///     address: Target::Motor(MotorId::new(1)?),
    ///     data: [0x30, 0x01, 0, 0, 0, 0, 0, 0],
    /// };
    /// let line = [0x3E, 0x01, 0x08, 0x30, 0x01, 0, 0, 0, 0, 0, 0, 0xE8, 0xDD];
    /// assert_eq!(read_pid.encode(), line);
    /// # Ok::<(), myactuator_protocol_core::OutOfRange>(())
    /// ```
    #[inline]
    pub const fn encode(&self) -> [u8; FRAME_LENGTH] {
        let address = match self.address {
            Target::Motor(id) => id.get(),
            Target::All => ALL,
        };
        let [a, b, c, d, e, f, g, h] = self.data;
        // Byte by byte, because an array would first have to be written to memory.
        let crc = crc_over(crc_over(CRC_OF_HEADER, address), DATA_LENGTH);
        let crc = crc_over(crc_over(crc_over(crc_over(crc, a), b), c), d);
        let crc = crc_over(crc_over(crc_over(crc_over(crc, e), f), g), h);
        let [low, high] = crc.to_le_bytes();
        [HEADER, address, DATA_LENGTH, a, b, c, d, e, f, g, h, low, high]
    }
}

const fn is_bus_id(data: &Data) -> bool {
    matches!(Opcode::from_byte(data[0]), Some(Opcode::BusId))
}

const fn address(byte: u8) -> Option<Target> {
    match MotorId::new(byte) {
        Ok(id) => Some(Target::Motor(id)),
        Err(_) if byte == ALL => Some(Target::All),
        Err(_) => None,
    }
}

/// The outcome of a byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Fed {
    /// It may be part of a frame, which needs more bytes.
    Wanting,
    /// It completed a frame.
    Frame(Frame),
    /// The bytes held were no frame, and were discarded up to the next possible start.
    Discarded {
        /// How many bytes.
        bytes: usize,
        /// What was wrong with them.
        fault: Fault,
    },
}

/// Why bytes are not a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Fault {
    /// They do not begin with 0x3E.
    #[error("a frame begins with 3E")]
    Header,
    /// The address is neither 1 to 32 nor 0xCD.
    #[error("an address is 1 to 32 or 0xCD")]
    Address,
    /// The length is not 8.
    #[error("the length of every frame is 08")]
    Length,
    /// The CRC is wrong.
    #[error("the CRC is wrong")]
    Crc,
}

/// Finds frames in a stream of bytes.
///
/// After garbage or a bad CRC it searches the bytes it holds for the next possible start, so that no good frame after a
/// bad start is lost.
///
/// ```
/// use myactuator_protocol_core::wire::rs485::{Fed, Receiver};
///
/// let mut receiver = Receiver::new();
/// let noise = [0x00, 0x3E, 0x3E];
/// let line = [0x3E, 0x01, 0x08, 0x30, 0x01, 0, 0, 0, 0, 0, 0, 0xE8, 0xDD];
/// let mut frames = 0;
/// for byte in noise.into_iter().chain(line) {
///     match receiver.feed(byte) {
///         Fed::Frame(frame) => frames += usize::from(frame.data[0] == 0x30),
///         Fed::Wanting | Fed::Discarded { .. } => {}
///     }
/// }
/// assert_eq!(frames, 1);
/// ```
#[derive(Clone, Debug)]
pub struct Receiver {
    held: [u8; FRAME_LENGTH],
    length: usize,
    /// The CRC over the bytes held.
    crc: u16,
    /// The address of the second byte, once that is held.
    address: Target,
}

impl Default for Receiver {
    fn default() -> Self {
        Self::new()
    }
}

impl Receiver {
    /// A receiver that holds nothing.
    pub const fn new() -> Self {
        Self { held: [0; FRAME_LENGTH], length: 0, crc: CRC_START, address: Target::All }
    }

    /// Takes the next byte from the line.
    pub fn feed(&mut self, byte: u8) -> Fed {
        match self.push(byte) {
            Ok(false) => Fed::Wanting,
            Ok(true) => self.complete(),
            Err(fault) => self.resume_after(fault),
        }
    }

    /// Drops a frame that has begun, and returns how many bytes were held. For masters that start a new exchange after
    /// a silence.
    pub fn reset(&mut self) -> usize {
        self.crc = CRC_START;
        core::mem::take(&mut self.length)
    }

    /// Whether a frame has begun.
    pub const fn is_within_frame(&self) -> bool {
        self.length > 0
    }

    /// Holds one more byte. Returns whether the frame is complete, or why this cannot become one.
    #[inline(always)]
    fn push(&mut self, byte: u8) -> Result<bool, Fault> {
        let place = self.length;
        // There is always room: 13 bytes are a frame, or are cut down before the next byte.
        let Some(room) = self.held.get_mut(place) else { return Ok(false) };
        *room = byte;
        self.length = place + 1;
        self.crc = crc_over(self.crc, byte);
        match place {
            // Most bytes of a frame are not checked.
            3..LAST_PLACE => return Ok(false),
            0 if byte != HEADER => return Err(Fault::Header),
            1 => self.address = address(byte).ok_or(Fault::Address)?,
            2 if byte != DATA_LENGTH => return Err(Fault::Length),
            LAST_PLACE if self.crc != CRC_GOOD => return Err(Fault::Crc),
            _ => {}
        }
        Ok(place == LAST_PLACE)
    }

    #[inline(always)]
    fn complete(&mut self) -> Fed {
        self.reset();
        let [_, _, _, data @ .., _, _] = &self.held;
        Fed::Frame(Frame { address: self.address, data: *data })
    }

    /// Discards what cannot be the start of a frame.
    #[cold]
    fn resume_after(&mut self, fault: Fault) -> Fed {
        let before = self.reset();
        let held = self.held;
        let held = held.get(..before).unwrap_or(&held);
        // What is left is shorter than a frame, so it can only be incomplete or wrong again.
        for start in 1..before {
            let rest = held.get(start..).unwrap_or(&[]);
            if rest.iter().all(|&byte| self.push(byte).is_ok()) {
                break;
            }
            self.reset();
        }
        Fed::Discarded { bytes: before - self.length, fault }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_drive_sends_a_command_to_all() {
        let to_all = Frame { address: Target::All, data: [0x80, 0, 0, 0, 0, 0, 0, 0] };
        assert_eq!(to_all.as_command().channel, Channel::Command(Target::All));
        assert_eq!(to_all.as_reply(), None);
    }

    #[test]
    fn a_bus_id_goes_to_all_or_is_a_command_like_another() {
        let motor = MotorId::MIN.into();
        let to_one = Frame { address: motor, data: [0x79, 0, 0, 0, 0, 0, 0, 2] };
        assert_eq!(to_one.as_command().channel, Channel::Command(motor));
        let to_all = Frame { address: Target::All, ..to_one };
        assert_eq!(to_all.as_command().channel, Channel::BusId);
    }

    #[test]
    fn the_crc_is_that_of_modbus() {
        // The check value from catalogues of CRCs.
        let crc = b"123456789".iter().fold(CRC_START, |crc, &byte| crc_over(crc, byte));
        assert_eq!(crc, 0x4B37);
    }

    #[test]
    fn only_0x79_has_a_frame_on_the_channel_of_bus_ids() {
        let packet = |byte| Packet { channel: Channel::BusId, data: [byte, 0, 1, 0, 0, 0, 0, 0] };
        let frame = Frame::from_packet(&packet(0x79)).unwrap();
        assert_eq!(frame.address, Target::All);
        assert_eq!(Frame::from_packet(&packet(0x80)), None);
    }

    #[test]
    fn a_frame_of_another_length_is_refused_at_its_length() {
        let mut receiver = Receiver::new();
        assert!(!receiver.is_within_frame());
        assert_eq!([0x3E, 1].map(|byte| receiver.feed(byte)), [Fed::Wanting; 2]);
        assert!(receiver.is_within_frame());
        assert_eq!(receiver.feed(7), Fed::Discarded { bytes: 3, fault: Fault::Length });
        assert!(!receiver.is_within_frame());
    }
}
