//! A CAN bus: who may send, how long it takes, and what becomes of errors.
//!
//! What is modelled, on classic CAN with 11 or 29 bit identifiers:
//!
//! - Time in bits by content ([`frame_bits`]); a frame reaches the others at the end of its end of
//!   frame, three bits of intermission before the bus is free again.
//! - Arbitration among whatever waits at the moment the bus is free: the bits of the arbitration
//!   field decide, so the lowest identifier wins and the others try again after the frame.
//! - Two stations that send equal frames at the same time, equal to the last bit: no station can notice that. They are
//!   one frame on the wire, and both stations have sent theirs.
//! - Errors. All stations see a disturbance: there is an error frame of 20 bits (flag and its echo 12, delimiter
//!   8) and the intermission, the sender's count goes up by 8, the receivers' by 1, and the frame is sent
//!   again. A frame that no station acknowledges is sent again, too; the count of its sender then stays at 128,
//!   as ISO 11898-1 says. An error-passive sender waits 8 bits more. Above 255 it is bus-off: what
//!   it has queued waits until 128 sequences of 11 recessive bits have passed.
//! - A station at another bit rate never hears nor acknowledges a frame. If it is
//!   error-active, it breaks the frame: after six of its own bits it signals an error, and the error frame and the
//!   intermission are counted in the bits of the slowest station. It counts 1 for what it cannot read and 8 for the
//!   others' flags after its own. So it is error-passive after 15 frames, and disturbs no more. Until
//!   then the sender, at 8 for each frame, reaches 120, and stays error-active. Simplified: what the station samples is
//!   not looked at. A station whose bits are twice as long or more counts as the others do, though it may not see
//!   their flags, and would disturb longer. And it does not take a busy bus for idle.
//! - A station never receives what it sends.
//!
//! Not modelled: CAN FD, overload frames, disturbances that only some stations see, one-shot mode; bit
//! errors of two stations that send the same identifier with different data at the same time: they send one after the
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
    /// A world with an empty bus of this bit rate in bit/s, at time 0. `seed` determines everything that happens by
    /// chance.
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

    /// The status of a station's controller.
    pub fn controller(&self, station: StationId) -> ControllerStatus {
        let station = station.0;
        self.with(|kernel| kernel.bus.controllers[station].status(kernel.received(station)))
    }
}
