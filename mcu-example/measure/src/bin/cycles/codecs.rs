//! Frames, in Rust and in C.

use core::hint::black_box;

use myactuator_protocol_core::command::{
    AbsolutePosition, Feedback, MotionFeedback, MotionRanges, MotionSetPoint, RawMotion,
    RawMotionFeedback, ReadStatus2,
};
use myactuator_protocol_core::units::{Angle, MaxSpeed};
use myactuator_protocol_core::wire::rs485::{FRAME_LENGTH, Fed, Frame, Receiver};
use myactuator_protocol_core::{Command, Data, DecodeError, MotorId, Target};

use crate::c;
use crate::counter::{cost, nothing};
use crate::table::{Limit, Table};

#[inline(never)]
fn encode(command: &AbsolutePosition, data: &mut Data) {
    *data = command.encode();
}

#[inline(never)]
fn decode(data: &Data, feedback: &mut Feedback) -> bool {
    let Ok(read) = ReadStatus2::decode_reply(data) else { return false };
    *feedback = read;
    true
}

#[inline(never)]
fn encode_motion(set_point: &MotionSetPoint, data: &mut Data) -> bool {
    let raw = MotionRanges::V4_3.quantise(set_point);
    if let Ok(raw) = &raw {
        *data = raw.encode();
    }
    raw.is_ok()
}

#[inline(never)]
fn decode_motion(data: &Data, feedback: &mut MotionFeedback) {
    *feedback = MotionRanges::V4_3.feedback(&RawMotionFeedback::decode(data));
}

#[inline(never)]
fn encode_line(frame: &Frame, line: &mut [u8; FRAME_LENGTH]) {
    *line = frame.encode();
}

#[inline(never)]
fn feed(receiver: &mut Receiver, byte: u8) -> Fed {
    receiver.feed(byte)
}

/// What feeding is compared to: a function that takes the byte and asks for more.
#[inline(never)]
fn want(_: &mut Receiver, _: u8) -> Fed {
    Fed::Wanting
}

/// Feeds a copy, for a byte changes the receiver. By a pointer, so that it is the same code for all.
#[inline(never)]
fn on_a_copy<R: Clone, T>(start: &(R, u8, fn(&mut R, u8) -> T), receiver: &mut R) {
    let (before, byte, take) = start;
    receiver.clone_from(before);
    black_box(take(receiver, *byte));
}

/// What feeding this byte costs beyond wanting it.
fn feeding<R: Clone, T>(receiver: &R, byte: u8, [feed, want]: [fn(&mut R, u8) -> T; 2]) -> u32 {
    let run = |take: fn(&mut R, u8) -> T| {
        let start = (receiver.clone(), byte, take);
        cost(&start, &mut receiver.clone(), on_a_copy, |_, _| ())
    };
    run(feed).saturating_sub(run(want))
}

const AT_MOST_C: u32 = 10;
/// C's receiver does not search for another frame in what turned out to be none.
const RESYNCHRONISING: u32 = 12;

const fn beside(cost: u32) -> Limit {
    Limit::OfC { cost, tenths: AT_MOST_C }
}

pub(crate) fn measure(table: &mut Table) -> Result<(), DecodeError> {
    command(table);
    reply(table)?;
    motion_command(table);
    motion_reply(table);
    line(table);
    Ok(())
}

fn command(table: &mut Table) {
    let go =
        AbsolutePosition { max_speed: MaxSpeed::from_raw(500), angle: Angle::from_raw(36_000) };
    let mut data = [0; 8];
    let ours = cost(&go, &mut data, encode, nothing());
    let in_c = c::AbsolutePosition { max_speed_dps: 500, angle_centidegrees: 36_000 };
    let mut data_of_c = [0; 8];
    let theirs = cost(&in_c, &mut data_of_c, c::encode, c::nothing);
    assert_eq!(data, data_of_c);
    table.row("encode a command", ours, beside(theirs));
}

fn reply(table: &mut Table) -> Result<(), DecodeError> {
    let reply = [0x9C, 0x32, 0x64, 0x00, 0xF4, 0x01, 0x2D, 0x00]; // 2.15.4
    let mut feedback = ReadStatus2::decode_reply(&[0x9C, 0, 0, 0, 0, 0, 0, 0])?;
    let job = |data: &Data, feedback: &mut Feedback| {
        black_box(decode(data, feedback));
    };
    let ours = cost(&reply, &mut feedback, job, nothing());
    let mut in_c = c::Feedback::default();
    let job = |data: &Data, feedback: &mut c::Feedback| {
        black_box(c::decode(data, feedback));
    };
    let theirs = cost(&reply, &mut in_c, job, c::nothing);
    assert_eq!(feedback.speed.raw(), in_c.speed_dps);
    assert_eq!(feedback.current.raw(), in_c.current_centiamperes);
    assert_eq!(feedback.angle.raw(), in_c.angle_degrees);
    assert_eq!(feedback.temperature.raw(), in_c.temperature_celsius);
    table.row("decode a reply", ours, beside(theirs));
    Ok(())
}

fn motion_command(table: &mut Table) {
    let wanted = MotionSetPoint {
        position_rad: 10.0,
        velocity_rad_s: 1.0,
        kp: 10.0,
        kd: 1.0,
        torque_nm: 10.0,
    };
    let mut data = [0; 8];
    let job = |set_point: &MotionSetPoint, data: &mut Data| {
        black_box(encode_motion(set_point, data));
    };
    let ours = cost(&wanted, &mut data, job, nothing());
    let MotionSetPoint { position_rad, velocity_rad_s, kp, kd, torque_nm } = wanted;
    let in_c = c::MotionSetPoint { position_rad, velocity_rad_s, kp, kd, torque_nm };
    let mut data_of_c = [0; 8];
    let job = |set_point: &c::MotionSetPoint, data: &mut Data| {
        black_box(c::encode_motion(set_point, data));
    };
    let theirs = cost(&in_c, &mut data_of_c, job, c::nothing);
    assert_eq!(data, data_of_c);
    assert_eq!(RawMotion::decode(&data).position, 58_982); // 5.4
    table.row("quantise and encode a motion command", ours, beside(theirs));
}

fn motion_reply(table: &mut Table) {
    let reply = [0x01, 0xE6, 0x66, 0x82, 0xEB, 0x55, 0, 0]; // 5.4
    let mut motion = MotionFeedback { position_rad: 0.0, velocity_rad_s: 0.0, torque_nm: 0.0 };
    let ours = cost(&reply, &mut motion, decode_motion, nothing());
    let mut in_c = c::MotionFeedback::default();
    let theirs = cost(&reply, &mut in_c, c::decode_motion, c::nothing);
    assert!((motion.position_rad - 10.0).abs() < 0.001);
    assert_eq!(motion.position_rad, in_c.position_rad);
    assert_eq!(motion.velocity_rad_s, in_c.velocity_rad_s);
    assert_eq!(motion.torque_nm, in_c.torque_nm);
    table.row("decode and scale a motion reply", ours, beside(theirs));
}

fn line(table: &mut Table) {
    let go =
        AbsolutePosition { max_speed: MaxSpeed::from_raw(500), angle: Angle::from_raw(36_000) };
    let frame = Frame { address: Target::Motor(MotorId::MIN), data: go.encode() };
    let mut line = [0; FRAME_LENGTH];
    let ours = cost(&frame, &mut line, encode_line, nothing());
    let mut line_of_c = [0; FRAME_LENGTH];
    let job = |data: &Data, line: &mut [u8; FRAME_LENGTH]| c::encode_line(1, data, line);
    let theirs = cost(&frame.data, &mut line_of_c, job, c::nothing);
    assert_eq!(line, [0x3E, 1, 8, 0xA4, 0x00, 0xF4, 0x01, 0xA0, 0x8C, 0x00, 0x00, 0x3B, 0xDD]);
    assert_eq!(line, line_of_c);
    table.row("encode an RS485 frame", ours, beside(theirs));

    let mut receiver = Receiver::new();
    let each = line.map(|byte| {
        let spent = feeding(&receiver, byte, [feed, want]);
        feed(&mut receiver, byte);
        spent
    });
    assert!(!receiver.is_within_frame(), "the frame is complete");

    let mut receiver = c::Receiver::new();
    let each_of_c = line.map(|byte| {
        let spent = feeding(&receiver, byte, [c::feed, c::want]);
        (spent, c::feed(&mut receiver, byte))
    });
    assert_eq!(each_of_c[FRAME_LENGTH - 1].1, 1, "the frame is complete");

    let mean = |sum: u32| sum.div_ceil(FRAME_LENGTH as u32);
    let theirs = mean(each_of_c.iter().map(|&(spent, _)| spent).sum());
    let limit = Limit::OfC { cost: theirs, tenths: RESYNCHRONISING };
    table.row("receive an RS485 byte, on average", mean(each.iter().sum()), limit);
    let worst = each.into_iter().max().unwrap_or(0);
    table.row("receive an RS485 byte, at worst", worst, Limit::Budget(45));
}
