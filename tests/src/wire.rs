//! CAN and RS485 under one name, so that one test covers both.

use std::fmt::Debug;

use myactuator_host_std::sim::bus::can::{CanBus, CanPort};
use myactuator_host_std::sim::bus::rs485::{Rs485Line, SerialPort};
use myactuator_host_std::sim::bus::{Medium, Node, SimClock, StationId, World};
use myactuator_host_std::sim::{BusFleet, Fleet, FleetError};
use myactuator_protocol_core::Packet;
use myactuator_protocol_core::io::{CanMaster, Runner, SerialMaster};
use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::wire::can::{self, SimpleFrame};
use myactuator_protocol_core::wire::rs485::{Fed, Frame, Receiver};

/// One of the two simulated buses, at 1 Mbit/s.
pub trait Wire: Medium<Frame: Sync> + Sized + 'static {
    /// The loop that runs a master on this bus.
    type Runner<const N: usize>: Runner<N, Error: Debug + PartialEq>;
    /// Its name in messages.
    const NAME: &'static str;
    /// The library's own configuration for it.
    const CONFIG: Config;

    /// A bus without stations. The seed decides its random faults.
    fn world(seed: u64) -> World<Self>;

    /// A master on the bus, and its place.
    fn runner<const N: usize>(world: &World<Self>, config: Config) -> (Self::Runner<N>, StationId);

    /// Puts simulated drives on it.
    fn drives(fleet: &Fleet) -> Result<BusFleet<Self>, FleetError>;

    /// Puts a node on the bus.
    fn seat(world: &World<Self>, node: impl Node<Self::Frame> + 'static) -> StationId;

    /// The frame of a packet.
    fn frame(packet: &Packet) -> Self::Frame;

    /// The packet in a frame of the master or of a drive. On RS485 the packet may end in these bytes.
    fn packet(receiver: &mut Receiver, frame: &Self::Frame, of_master: bool) -> Option<Packet>;
}

impl Wire for CanBus {
    type Runner<const N: usize> = CanMaster<CanPort, SimClock<CanBus>, N>;
    const NAME: &'static str = "CAN";
    const CONFIG: Config = Config::CAN;

    fn world(seed: u64) -> World<Self> {
        World::<CanBus>::new(1_000_000, seed)
    }

    fn runner<const N: usize>(world: &World<Self>, config: Config) -> (Self::Runner<N>, StationId) {
        let port = world.port();
        let station = port.station();
        (CanMaster::new(port, world.clock(), config), station)
    }

    fn drives(fleet: &Fleet) -> Result<BusFleet<Self>, FleetError> {
        fleet.on_can(1_000_000)
    }

    fn seat(world: &World<Self>, node: impl Node<SimpleFrame> + 'static) -> StationId {
        world.attach(node)
    }

    fn frame(packet: &Packet) -> SimpleFrame {
        can::encode(packet).expect("eight bytes fit")
    }

    fn packet(_: &mut Receiver, frame: &SimpleFrame, _: bool) -> Option<Packet> {
        match can::decode(frame) {
            can::Received::Packet(packet) => Some(packet),
            _ => None,
        }
    }
}

/// Bits per second on RS485.
const LINE_RATE: u32 = 1_000_000;

impl Wire for Rs485Line {
    type Runner<const N: usize> = SerialMaster<SerialPort, SimClock<Rs485Line>, N>;
    const NAME: &'static str = "RS485";
    const CONFIG: Config = Config::rs485(LINE_RATE, false);

    fn world(seed: u64) -> World<Self> {
        World::<Rs485Line>::new(LINE_RATE, seed)
    }

    fn runner<const N: usize>(world: &World<Self>, config: Config) -> (Self::Runner<N>, StationId) {
        let port = world.port();
        let station = port.station();
        (SerialMaster::new(port, world.clock(), config), station)
    }

    fn drives(fleet: &Fleet) -> Result<BusFleet<Self>, FleetError> {
        fleet.on_rs485(LINE_RATE)
    }

    fn seat(world: &World<Self>, node: impl Node<Vec<u8>> + 'static) -> StationId {
        world.attach(node)
    }

    fn frame(packet: &Packet) -> Vec<u8> {
        Frame::from_packet(packet).expect("RS485 has it").encode().to_vec()
    }

    fn packet(receiver: &mut Receiver, bytes: &Vec<u8>, of_master: bool) -> Option<Packet> {
        let mut frames = bytes.iter().filter_map(|&byte| match receiver.feed(byte) {
            Fed::Frame(frame) => Some(frame),
            _ => None,
        });
        let frame = frames.next()?;
        assert_eq!(frames.next(), None, "a message is one frame");
        if of_master { Some(frame.as_command()) } else { frame.as_reply() }
    }
}
