//! The rules of the master, one test a rule. Times are chosen by hand: the reply time-out of
//! [`Config::CAN`] is 20.4 ms, its late window 40.8 ms.

mod after_a_stop;
mod answers;
mod by_priority;
mod doubts;
mod every_cycle;
mod held_up;
mod last_word;
mod line;
mod lost_master;
mod mailboxes;
mod odd_orders;
mod pushed_out;
mod reports;
mod restarts;
mod seldom;
mod steady;
mod stopped_twice;
mod stops;
mod streams;
mod to_all;
mod turns;
mod unconfirmed;
mod unnamed;

use std::vec::Vec;

use super::*;
use crate::command::{
    AbsolutePosition, ActiveReply, AnyReply, BaudCode, BusId, Command, FunctionControl,
    IncrementalPosition, LockBrake, NoReply, PidIndex, RawCommand, RawMotion, RawReply, ReadModel,
    ReadMultiTurnAngle, ReadPid, ReadRunTime, ReadStatus1, ReleaseBrake, ReportedCommand, Reset,
    SetBaudRate, SetPoint, Shutdown, Stop, Switch, Torque,
};
use crate::data::Data;
use crate::opcode::{LOST_MASTER_BYTE, Opcode, ReplyRule};
use crate::packet::{Channel, Packet};
use crate::units::{Angle, Current, MaxSpeed, ReportInterval};
use crate::wire::can::Received;
use crate::wire::rs485::Frame;

const ANGLE_REPLY: [u8; 8] = [0x92, 0, 0, 0, 0xA0, 0x8C, 0, 0];
/// A status without errors (2.14).
const STATUS_REPLY: [u8; 8] = [0x9A, 50, 30, 1, 0xE5, 0x01, 0, 0];
/// Feedback of a torque (2.19).
const TORQUE_REPLY: [u8; 8] = [0xA1, 30, 0, 0, 0, 0, 7, 0];

fn id(id: u8) -> MotorId {
    MotorId::new(id).unwrap()
}

fn ms(millis: u64) -> Instant {
    Instant::from_millis(millis)
}

fn torque(amperes: f32) -> Torque {
    Torque { current: Current::from_amperes(amperes).unwrap() }
}

fn step() -> IncrementalPosition {
    IncrementalPosition { max_speed: MaxSpeed::from_raw(100), angle: Angle::from_raw(9_000) }
}

/// Everything that the master sends at this time, after it has taken note of the time.
fn sent<const N: usize>(master: &mut Master<N>, now: Instant) -> Vec<Packet> {
    master.handle_timeout(now);
    let mut packets = Vec::new();
    while let Some(packet) = master.poll_transmit(now) {
        master.handle_transmitted(now);
        packets.push(packet);
    }
    packets
}

fn events<const N: usize>(master: &mut Master<N>, now: Instant) -> Vec<Event> {
    master.handle_timeout(now);
    core::iter::from_fn(|| master.poll_event()).collect()
}

fn reply<const N: usize>(
    master: &mut Master<N>,
    motor: u8,
    data: [u8; 8],
    now: Instant,
) -> Option<Event> {
    let packet = Packet { channel: Channel::Reply(id(motor)), data };
    master.handle_frame(&Received::Packet(packet), now)
}

/// A motor says this on a line.
fn says<const N: usize>(
    master: &mut Master<N>,
    motor: u8,
    data: Data,
    at: Instant,
) -> Option<Event> {
    master.handle_line(&Frame { address: Target::Motor(id(motor)), data }, at)
}

/// Makes a request and sends it.
fn ask<C: Command, const N: usize>(
    master: &mut Master<N>,
    motor: u8,
    command: C,
    now: Instant,
) -> Ticket<C> {
    let ticket = master.request(id(motor), command).unwrap();
    sent(master, now);
    ticket
}

/// One attempt with this time-out.
fn once(millis: u64) -> Patience {
    Patience { attempts: 1, reply_timeout: Duration::from_millis(millis) }
}

/// This motor has answered commands before, so that the first answer to a hold counts.
fn obeys<const N: usize>(master: &mut Master<N>, motor: u8) {
    master.place_for(id(motor)).unwrap();
    master.change(id(motor), |motor, _| (0..3).for_each(|_| motor.note_there()));
}

/// Motor 1 is asked at these times, and answers half a millisecond later.
fn answers<const N: usize>(master: &mut Master<N>, times: impl IntoIterator<Item = u64>) {
    for now in times {
        let read = ask(master, 1, ReadStatus1, ms(now));
        let event = reply(master, 1, STATUS_REPLY, half_past(now)).unwrap();
        assert!(read.outcome(&event).is_some_and(|outcome| outcome.is_ok()));
    }
}

fn half_past(now: u64) -> Instant {
    ms(now) + Duration::from_micros(500)
}

/// This motor was stopped and confirms no attempt from then on. Returns when that was reported.
fn is_given_up<const N: usize>(master: &mut Master<N>, motor: u8, from: u64) -> u64 {
    let unconfirmed = [Event::StopUnconfirmed { motor: id(motor) }];
    let mut times = from..from + 1_000;
    let reported = times.find(|&now| {
        sent(master, ms(now));
        events(master, ms(now)) == unconfirmed
    });
    reported.expect("after fifteen attempts")
}

#[test]
fn fits_its_budget() {
    assert!(size_of::<Master<8>>() <= 2_456, "{}", size_of::<Master<8>>());
    assert!(size_of::<Master<32>>() <= 8_600, "{}", size_of::<Master<32>>());
}

/// Switches reports of the angle every 10 ms on or off.
fn report_angle(enable: Switch) -> ActiveReply {
    ActiveReply {
        command: ReportedCommand::of(Opcode::ReadMultiTurnAngle).unwrap(),
        enable,
        interval: ReportInterval::from_raw(1),
    }
}

fn feedback_of_all<const N: usize>(
    master: &mut Master<N>,
    motors: core::ops::RangeInclusive<u8>,
    now: Instant,
) {
    for motor in motors {
        let answer = reply(master, motor, [0xA4, 0, 0, 0, 0, 0, 0, 0], now);
        assert!(matches!(answer, Some(Event::Feedback { .. })), "{answer:?}");
    }
}

fn stream_to<const N: usize>(
    master: &mut Master<N>,
    motors: core::ops::RangeInclusive<u8>,
    now: Instant,
) {
    let go = AbsolutePosition { max_speed: MaxSpeed::from_raw(1), angle: Angle::from_raw(0) };
    for motor in motors {
        master.set_point(id(motor), go, now).unwrap();
    }
}

fn motion() -> RawMotion {
    RawMotion::decode(&[0xE6, 0x66, 0x82, 0xE0, 0x52, 0x33, 0x3B, 0x55])
}

fn motion_feedback(master: &mut Master<2>, now: Instant) -> Option<Event> {
    let data = [1, 0x80, 0, 0x80, 0x08, 0, 0, 0];
    let packet = Packet { channel: Channel::MotionReply(id(1)), data };
    master.handle_frame(&Received::Packet(packet), now)
}

fn packet_to_all(data: [u8; 8]) -> Packet {
    Packet { channel: Channel::Command(Target::All), data }
}

fn packet_to(motor: u8, data: [u8; 8]) -> Packet {
    Packet { channel: Channel::Command(id(motor).into()), data }
}

fn confirmed(motor: u8) -> Option<Event> {
    Some(Event::StopConfirmed { motor: id(motor) })
}
