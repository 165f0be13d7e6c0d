//! What everything takes of the flash: every command and reply, both ways, on both buses, and the
//! master. No panic of protocol-core may be in it.
#![no_std]
#![no_main]

#[path = "../size/mod.rs"]
mod size;

use core::convert::Infallible;
use core::hint::black_box;
use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m_rt::entry;
use embedded_can::nb::Can;
use embedded_io::{ErrorType, Read, ReadReady, Write};
use myactuator_protocol_core::{
    AnyCommand, AnyReply, Channel, MotorId, Packet, Target,
    command::{MotionRanges, MotionSetPoint, ReadMultiTurnAngle, ReadStatus1, Reset, Torque},
    io::{CanMaster, Clock, Runner, SerialMaster},
    master::{Config, MotorSet, StopKind},
    time::Instant,
    units::Current,
    wire::{
        can::{self, SimpleFrame},
        rs485::{Fed, Frame, Receiver},
    },
};

/// A bus with nobody on it, which the compiler does not know.
struct Bus;

impl Can for Bus {
    type Frame = SimpleFrame;
    type Error = Infallible;

    fn transmit(&mut self, frame: &SimpleFrame) -> nb::Result<Option<SimpleFrame>, Infallible> {
        black_box(frame);
        Ok(None)
    }

    fn receive(&mut self) -> nb::Result<SimpleFrame, Infallible> {
        black_box(Err(nb::Error::WouldBlock))
    }
}

impl ErrorType for Bus {
    type Error = Infallible;
}

impl Read for Bus {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        black_box(bytes);
        Ok(black_box(0))
    }
}

impl ReadReady for Bus {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(black_box(false))
    }
}

impl Write for Bus {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        Ok(black_box(bytes).len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Each look at it takes a tenth of a millisecond.
struct Ticks(AtomicU32);

impl Clock for Ticks {
    fn now(&self) -> Instant {
        Instant::from_micros(u64::from(self.0.fetch_add(100, Ordering::Relaxed)))
    }
}

fn clock() -> Ticks {
    Ticks(AtomicU32::new(0))
}

fn use_master(arm: &mut impl Runner<32>, motor: MotorId) {
    let _ = black_box(arm.ask(motor, ReadMultiTurnAngle));
    let _ = black_box(arm.call(motor, Reset));
    let now = arm.now();
    let _ = black_box(arm.set_point(motor, Torque { current: Current::from_raw(black_box(10)) }));
    let _ = black_box(arm.master().broadcast(ReadStatus1, MotorSet::from(motor), now));
    let _ = black_box(arm.stop_all(StopKind::Off, MotorSet::from(motor)).is_ok());
    black_box(arm.master().health(motor));
}

fn use_codecs(data: [u8; 8], channel: Channel) {
    let packet = Packet { channel, data };
    let (command, reply) = (AnyCommand::decode(&packet), AnyReply::decode(&packet));
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
    for byte in
        black_box(Frame::from_packet(&packet).map(|frame| frame.encode())).into_iter().flatten()
    {
        if let Fed::Frame(frame) = black_box(receiver.feed(byte)) {
            black_box((frame.as_command(), frame.as_reply()));
        }
    }
    let set_point = black_box(MotionSetPoint::default());
    if let Ok(raw) = black_box(MotionRanges::V4_3.quantise(&set_point)) {
        black_box(MotionRanges::V4_3.set_point(&raw));
    }
}

#[entry]
fn main() -> ! {
    let motor = black_box(MotorId::MIN);
    use_codecs(black_box([0x92, 0, 0, 0, 0, 0, 0, 0]), black_box(Channel::Reply(motor)));
    use_master(&mut CanMaster::new(Bus, clock(), black_box(Config::CAN)), motor);
    use_master(
        &mut SerialMaster::new(Bus, clock(), Config::rs485(black_box(115_200), false)),
        motor,
    );
    size::finish(true)
}
