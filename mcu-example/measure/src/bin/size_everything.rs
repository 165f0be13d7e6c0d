//! What everything takes of the flash: every command and reply, both ways, on both buses, and the
//! master. No panic of protocol-core may be in it.
#![no_std]
#![no_main]

#[path = "../size/mod.rs"]
mod size;

use core::hint::black_box;

use cortex_m_rt::entry;
use myactuator_protocol_core::{
    AnyCommand, AnyReply, Channel, Firmware, MotorId, Packet, Target,
    command::{MotionRanges, MotionSetPoint, ReadMultiTurnAngle, ReadStatus1, Torque},
    master::{Config, Master, MotorSet, StopKind},
    time::Instant,
    units::Current,
    wire::{
        can::{self, SimpleFrame},
        rs485::{Fed, Frame, Receiver},
    },
};

fn use_master(motor: MotorId) {
    let now = Instant::from_micros(black_box(0));
    let mut master = Master::<32>::new(*black_box(&Config::CAN));
    let ticket = master.request(motor, ReadMultiTurnAngle);
    let _ = black_box(master.set_point(motor, Torque { current: Current::from_raw(10) }, now));
    let _ = black_box(master.broadcast(ReadStatus1, MotorSet::from(motor)));
    while let Some(packet) = master.poll_transmit(now) {
        let frame: Option<SimpleFrame> = can::encode(&packet);
        let line = Frame::from_packet(&packet).map(|frame| frame.encode());
        black_box((&frame, &line));
        master.handle_transmitted(now);
    }
    let reply = Packet { channel: Channel::Reply(motor), data: black_box([0; 8]) };
    let frame: Option<SimpleFrame> = black_box(can::encode(&reply));
    let event = frame.and_then(|frame| master.handle_frame(&can::decode(&frame), now));
    black_box(event);
    let event = match black_box(Receiver::new()).feed(black_box(0)) {
        Fed::Frame(frame) => master.handle_line(&frame, now),
        _ => None,
    };
    if let (Ok(ticket), Some(event)) = (ticket, event) {
        black_box(ticket.outcome(&event));
    }
    master.handle_timeout(now);
    master.handle_bus_down(now);
    black_box((master.poll_at(), master.health(motor)));
    let _ = black_box(master.stop_all(StopKind::Off, MotorSet::from(motor)));
    master.lift_stop();
    while let Some(event) = master.poll_event() {
        black_box(event);
    }
}

const SET_POINT: MotionSetPoint =
    MotionSetPoint { position_rad: 1.0, velocity_rad_s: 2.0, kp: 10.0, kd: 1.0, torque_nm: 0.5 };

fn use_codecs(data: [u8; 8], channel: Channel) {
    let packet = Packet { channel, data };
    let (command, reply) =
        (AnyCommand::decode(&packet, Firmware::V4_3), AnyReply::decode(&packet, Firmware::V4_3));
    if let Ok(command) = black_box(command) {
        black_box(command.encode());
        let _ = black_box(command.packet(Target::All));
    }
    if let Ok(reply) = black_box(reply) {
        black_box(reply.encode());
    }
    let frame: Option<SimpleFrame> = can::encode(&packet);
    black_box(black_box(frame).map(|frame| can::decode(&frame)));

    let mut receiver = Receiver::new();
    if let Some(frame) = Frame::from_packet(&packet) {
        for byte in black_box(&frame.encode()) {
            if let Fed::Frame(frame) = black_box(receiver.feed(*byte)) {
                black_box((frame.as_command(), frame.as_reply()));
            }
        }
    }
    if let Ok(raw) = black_box(MotionRanges::V4_3.quantise(black_box(&SET_POINT))) {
        black_box(MotionRanges::V4_3.set_point(&raw));
    }
}

#[entry]
fn main() -> ! {
    let motor = black_box(MotorId::MIN);
    use_codecs(black_box([0x92, 0, 0, 0, 0, 0, 0, 0]), black_box(Channel::Reply(motor)));
    use_master(motor);
    size::finish(true)
}
