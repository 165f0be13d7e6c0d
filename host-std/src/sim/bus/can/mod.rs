//! A CAN bus: who may send, how long it takes, and what becomes of errors.
//!
//! What is modelled, on classic CAN with 11 or 29 bit identifiers:
//!
//! - Time in bits by content ([`frame_bits`]); a frame reaches the others at the end of its end of
//!   frame, three bits of intermission before the bus is free again.
//! - Arbitration among whatever waits at the moment the bus is free: the bits of the arbitration
//!   field decide, so the lowest identifier wins and the others try again after the frame.
//! - Two stations that send frames at once that are equal to the last bit: nobody can notice; they are
//!   one frame on the wire, and both have sent theirs.
//! - Errors. A disturbance is seen by all: an error frame of 20 bits (flag and its echo 12, delimiter
//!   8) and the intermission, the sender's count up by 8, the receivers' by 1, and the frame is sent
//!   again. A frame that nobody acknowledges is sent again too; its sender's count stays at 128 then,
//!   as ISO 11898-1 has it. An error-passive sender waits 8 bits more. Above 255 it is bus-off: what
//!   it has queued waits until 128 sequences of 11 recessive bits have passed.
//! - A station at another bit rate, a stranger to the frame, never hears nor acknowledges it. An
//!   error-active one breaks it: after six of its own bits it signals an error, and the error frame and the
//!   intermission are counted in the bits of the slowest. It counts 1 for what it cannot read and 8 for the
//!   others' flags behind its own, so that it is error-passive after 15 frames and disturbs no more; until
//!   then the sender, at 8 each, comes to 120, and stays error-active. Simplified: what it samples is not
//!   looked at, and one whose bits are twice as long or more counts as the others do, though it may not see
//!   their flags, and would disturb longer; nor does it take a bus for idle that is not.
//! - A station never receives what it sends.
//!
//! Not modelled: CAN FD, overload frames, disturbances seen by some stations only, one-shot mode; bit
//! errors of two stations that send one identifier with different data at once: they go one after the
//! other.

mod bus;
mod controller;
mod port;
mod timing;

use myactuator_protocol_core::wire::can::SimpleFrame;

use super::{Node, StationId, World};

pub use bus::CanBus;
pub use controller::{ControllerConfig, ControllerStatus, ErrorState, QueueOrder};
pub use port::{CanError, CanPort};
pub use timing::frame_bits;

/// A world with a CAN bus.
pub type CanWorld = World<CanBus>;

impl World<CanBus> {
    /// A world with an empty bus of this bit rate in bit/s, at time 0. All chance in it comes from
    /// `seed`.
    pub fn new(bit_rate: u32, seed: u64) -> Self {
        Self::with_medium(CanBus::new(bit_rate), seed)
    }

    /// Attaches a node with a microcontroller's usual controller.
    pub fn attach(&self, node: impl Node<SimpleFrame> + 'static) -> StationId {
        self.attach_with(node, ControllerConfig::MAILBOXES)
    }

    /// A port for a master, with SocketCAN's usual queues.
    pub fn port(&self) -> CanPort {
        self.port_with(ControllerConfig::SOCKETCAN)
    }

    /// A port for a master.
    pub fn port_with(&self, controller: ControllerConfig) -> CanPort {
        self.attach_port(controller, controller.receive_queue)
    }

    /// How a station's controller stands.
    pub fn controller(&self, station: StationId) -> ControllerStatus {
        let station = station.0;
        self.with(|kernel| kernel.bus.controllers[station].status(kernel.received(station)))
    }
}
