//! A half-duplex RS485 line: one pair of wires, for one sender at a time, which nothing enforces.
//!
//! What is modelled:
//!
//! - A byte lasts ten bits (8N1). It arrives when its stop bit is over.
//! - A station needs a time to switch to sending before its first bit, and a time to switch back
//!   after its last, in which its driver still holds the line. Meanwhile it does not listen,
//!   unless it [echoes](TransceiverConfig::echo). What is queued meanwhile follows without a gap.
//! - No station checks whether the line is free. A byte that is on the line while another station's
//!   driver is on as well arrives garbled, as a random byte. For a receiver the ten bits from the
//!   first start bit are one byte, so two overlapping bytes are heard as one. If the line is then in the
//!   middle of a byte, the next byte that is heard is garbled, too, and so on up to a pause.
//! - The bytes of a cut station reach only its own echo, which no fault strikes, and nothing reaches the station.
//! - A station at another bit rate samples a message at its own rate: it reads other bytes, and more or
//!   fewer. Simplified: they come together, with the message's last byte; no fault strikes them; and a
//!   message that has collided is read as it was sent.
//!
//! Not modelled: parity and framing errors (a garbled byte is a wrong byte, and so is one without its stop
//! bit), reflections.

mod line;
mod port;

use myactuator_protocol_core::time::Duration;

use super::{Node, StationId, World};

pub use line::Rs485Line;
pub use port::{SerialError, SerialPort};

/// A world with an RS485 line.
pub type SerialWorld = World<Rs485Line>;

/// A station's transceiver and buffers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TransceiverConfig {
    /// Time from when there is something to send to the first start bit.
    pub switch_to_send: Duration,
    /// Time from the last stop bit until the driver lets go of the line and the station listens.
    pub switch_to_receive: Duration,
    /// Whether it hears the line while it sends, including its own bytes, as many USB adapters do. Separate faults
    /// ([`Direction::Echo`](super::faults::Direction::Echo)) strike these.
    pub echo: bool,
    /// How likely the station hears a random byte that was never sent at each switch of direction,
    /// from 0 to 1.
    pub switch_noise: f32,
    /// How many bytes can wait to be sent, including the one on the line. 0 counts as 1. The
    /// message of a node is taken whole if there is room for its first byte.
    pub transmit_buffer: usize,
    /// How many bytes can wait to be read. Further bytes are lost, and counted. A [`Node`] takes
    /// its bytes at once and needs no such buffer.
    pub receive_buffer: usize,
}

impl Default for TransceiverConfig {
    /// Switches at once, does not hear itself, and buffers 4096 bytes in each direction, as Linux does.
    fn default() -> Self {
        Self {
            switch_to_send: Duration::ZERO,
            switch_to_receive: Duration::ZERO,
            echo: false,
            switch_noise: 0.0,
            transmit_buffer: 4096,
            receive_buffer: 4096,
        }
    }
}

impl World<Rs485Line> {
    /// A world with an empty line of this bit rate in bit/s, at time 0. `seed` determines everything that happens by
    /// chance.
    pub fn new(bit_rate: u32, seed: u64) -> Self {
        Self::with_medium(Rs485Line::new(bit_rate, seed), seed)
    }

    /// Attaches a node that switches direction at once.
    pub fn attach(&self, node: impl Node<Vec<u8>> + 'static) -> StationId {
        self.attach_with(node, TransceiverConfig::default())
    }

    /// A port for a master that switches direction at once and has no echo.
    pub fn port(&self) -> SerialPort {
        self.port_with(TransceiverConfig::default())
    }

    /// A port for a master.
    pub fn port_with(&self, transceiver: TransceiverConfig) -> SerialPort {
        self.attach_port(transceiver, transceiver.receive_buffer)
    }
}
