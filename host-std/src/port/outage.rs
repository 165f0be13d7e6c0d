//! What may still be sent on a bus that carries nothing.

use embedded_can::Frame;
use myactuator_protocol_core::opcode::{Opcode, Repeat};
use myactuator_protocol_core::packet::Channel;
use myactuator_protocol_core::wire::can::{self, Received};

use crate::port::PortError;

/// Whether a bus is known to carry nothing: from the report of that until a frame comes or the controller
/// recovers.
///
/// The kernel or the adapter keeps what it is given meanwhile, and sends it when the bus is back, perhaps
/// minutes later: an arm that was switched off would move on its own. So only what does no harm
/// then is let through: reads, stop, shutdown and locking the brake. Their replies show that the bus is back.
#[derive(Debug, Default)]
pub(super) struct Outage(Option<PortError>);

impl Outage {
    pub(super) fn begin(&mut self, why: PortError) {
        self.0 = Some(why);
    }

    pub(super) fn end(&mut self) {
        self.0 = None;
    }

    /// Whether the outage is an adapter that refuses commands.
    pub(super) const fn is_refusal(&self) -> bool {
        matches!(self.0, Some(PortError::Refused(_)))
    }

    /// Whether this frame may be sent now; if not, why.
    pub(super) fn admit(&self, frame: &impl Frame) -> Result<(), PortError> {
        match &self.0 {
            Some(why) if !is_harmless_later(frame) => Err(why.clone()),
            _ => Ok(()),
        }
    }
}

/// Whether it does no harm if this frame reaches the motors at an unknown later time.
fn is_harmless_later(frame: &impl Frame) -> bool {
    let Received::Packet(packet) = can::decode(frame) else { return false };
    if matches!(packet.channel, Channel::Motion(_)) {
        return false;
    }
    let opcode = Opcode::from_byte(packet.data[0]);
    opcode.is_some_and(|opcode| match opcode {
        // A shaft may fall, and a loop with other gains may oscillate.
        Opcode::ReleaseBrake | Opcode::WritePidRam => false,
        _ => opcode.repeat() == Repeat::Harmless,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_can::StandardId;
    use myactuator_protocol_core::wire::can::SimpleFrame;

    fn frame(id: u16, first: u8) -> SimpleFrame {
        let id = StandardId::new(id).unwrap();
        SimpleFrame::new(id, &[first, 0, 0, 0, 0, 0, 0, 0]).unwrap()
    }

    #[test]
    fn moves_are_not_sent_while_the_bus_is_down() {
        let mut outage = Outage::default();
        let torque = frame(0x141, 0xA1);
        assert!(outage.admit(&torque).is_ok());
        outage.begin(PortError::NotAcknowledged("can0".into()));
        for first in [0xA1, 0xA2, 0xA4, 0xA6, 0xA8, 0xA9, 0x77, 0x31, 0x64, 0x76, 0x20, 0xFF] {
            assert!(outage.admit(&frame(0x141, first)).is_err(), "{first:02X}");
            assert!(outage.admit(&frame(0x280, first)).is_err(), "{first:02X} to all");
        }
        // The first byte of a motion frame is part of a position, not a command.
        assert!(outage.admit(&frame(0x401, 0x9C)).is_err());
        assert!(outage.admit(&frame(0x7FF, 0x9C)).is_err());
        outage.end();
        assert!(outage.admit(&torque).is_ok());
    }

    #[test]
    fn reads_and_stops_are_sent_while_the_bus_is_down() {
        let mut outage = Outage::default();
        outage.begin(PortError::BusOff("can0".into()));
        for first in [0x80, 0x81, 0x78, 0x92, 0x9A, 0x9C, 0x30] {
            assert!(outage.admit(&frame(0x141, first)).is_ok(), "{first:02X}");
        }
        assert!(outage.admit(&frame(0x280, 0x80)).is_ok());
    }
}
