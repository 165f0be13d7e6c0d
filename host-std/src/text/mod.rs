//! Frames as text, as people and other tools write them.
//!
//! [`can`] reads `ID#DATA` (cansend), `candump` and `candump -L` lines; [`rs485`] reads bytes;
//! [`slcan`] is the text that CAN adapters on serial ports speak. [`packet`] writes a packet for people.
//!
//! The lowest layer: nothing here opens anything or knows what a frame means, but for the names of errors.

pub mod can;
#[cfg(any(feature = "explain", all(feature = "port", feature = "sim")))]
mod error_name;
pub mod rs485;
pub mod slcan;

use myactuator_protocol_core::Packet;
use myactuator_protocol_core::wire::can::SimpleFrame;
use myactuator_protocol_core::wire::rs485::Frame;

use crate::BusKind;
#[cfg(any(feature = "explain", all(feature = "port", feature = "sim")))]
pub(crate) use error_name::error_name;

/// A packet as text: `141#A400F401A08C0000` on CAN, all 13 bytes as hexadecimal on RS485.
///
/// `None` for what RS485 cannot carry (motion mode, manual 5).
///
/// ```
/// use myactuator_host_std::{BusKind, text};
/// use myactuator_host_std::protocol::command::{AnyCommand, ReadStatus1};
/// use myactuator_host_std::protocol::{MotorId, Target};
///
/// let read = AnyCommand::from(ReadStatus1);
/// let packet = read.packet(Target::Motor(MotorId::new(1)?)).unwrap();
/// assert_eq!(text::packet(BusKind::Can, &packet).unwrap(), "141#9A00000000000000");
/// # Ok::<(), myactuator_host_std::protocol::OutOfRange>(())
/// ```
pub fn packet(bus: BusKind, packet: &Packet) -> Option<String> {
    match bus {
        BusKind::Can => Some(can::frame(&SimpleFrame::from_packet(packet))),
        BusKind::Rs485 => Frame::from_packet(packet).map(|frame| rs485::bytes(&frame.encode())),
    }
}

/// Bytes as upper-case hexadecimal.
fn joined_hex(bytes: &[u8], separator: &str) -> String {
    bytes.iter().map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(separator)
}
