//! What the motors that are played here answer.

use myactuator_host_std::open::{AnyMaster, BusAddress, BusError};
use myactuator_protocol_core::command::{Feedback, MultiTurnAngle, ReadMultiTurnAngle};
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::master::{Config, MotorSet, StopKind};
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::Angle;
use myactuator_protocol_core::{
    AnyCommand, AnyReply, Channel, Data, Firmware, MotorId, Packet, Reply, Target,
};

pub(crate) fn motor(id: u8) -> MotorId {
    MotorId::new(id).unwrap()
}

/// A master on the bus of this address. It forgives a machine that is busy or emulated: four seconds in
/// all.
pub(crate) fn open(address: &str) -> Result<AnyMaster<2>, BusError> {
    let address: BusAddress = address.parse().unwrap();
    let config = Config {
        reply_timeout: Duration::from_millis(250),
        attempts: 15,
        // Who plays the drive here answers at once.
        shortest_response: Duration::ZERO,
        ..address.config()
    };
    AnyMaster::open_with(&address, config)
}

/// The angle at which this motor stands: 10 degrees times its id.
fn degrees(id: MotorId) -> f32 {
    f32::from(id.get()) * 10.0
}

/// Asks both motors for their angles so many times, and stops them.
pub(crate) fn ask_and_stop(master: &mut AnyMaster<2>, times: usize) {
    for id in [motor(1), motor(2)].repeat(times) {
        let reading = master.ask(id, ReadMultiTurnAngle).unwrap();
        assert_eq!(reading.angle.degrees(), degrees(id));
    }
    assert_eq!(master.stop_all(StopKind::Hold, MotorSet::EMPTY), MotorSet::EMPTY);
}

/// Motors 1 and 2 answer reads of the angle, stops and torque; there are no others.
pub(crate) fn answer(command: &Packet) -> Option<Packet> {
    const TORQUE_FEEDBACK: Data = [0xA1, 50, 100, 0, 244, 1, 45, 0]; // manual 2.19.4
    let Channel::Command(Target::Motor(id)) = command.channel else { return None };
    if id.get() > 2 {
        return None;
    }
    let reply = match AnyCommand::decode(command, Firmware::V4_3).ok()? {
        AnyCommand::ReadMultiTurnAngle(_) => {
            let angle = Angle::from_degrees(degrees(id)).unwrap();
            AnyReply::ReadMultiTurnAngle(MultiTurnAngle { angle })
        }
        AnyCommand::Stop(stop) => AnyReply::Stop(stop),
        AnyCommand::Torque(_) => AnyReply::Torque(Feedback::decode(&TORQUE_FEEDBACK).unwrap()),
        _ => return None,
    };
    Some(Packet { channel: Channel::Reply(id), data: reply.encode() })
}
